"""Draw the picture of the README: the two-block waiter task at the start, in the middle and at the end of a sweep.

    MUJOCO_GL=egl .venv/bin/python experiments/readme_picture.py

writes docs/waiter.png. The three poses are rendered one by one and laid over each other, the first and the last pale.
A dot marks the place of the tray every 50 ms of the plan: where dots are far apart the robot is fast.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import mujoco
import numpy as np
from PIL import Image
from scipy.spatial.transform import Rotation

import robustopt as ro
from robustopt.arrays import Array, Flags
from robustopt.scene.placement import placements

ROOT = Path(__file__).parents[1]
WIDTH, HEIGHT = 880, 500
OVERSAMPLING = 2
"""The scenes are rendered larger by this factor, so that edges are smooth in the picture."""

SWEEPS = 3
"""The task sweeps to and fro; the picture shows the first sweep."""

PERIOD = 0.05
"""Time between two dots [s]."""

PALE = 0.38
"""Opacity of the robot at the start and at the end."""

WHITE = (1.0, 1.0, 1.0)
FLOOR, TRAY = (0.95, 0.95, 0.94, 1.0), (0.25, 0.27, 0.31, 1.0)
DOT = (0.0, 0.62, 0.45, 1.0)
BLOCKS = {"lower": (0.0, 0.45, 0.70, 1.0), "upper": (0.84, 0.37, 0.0, 1.0)}
LOOKAT, DISTANCE, AZIMUTH, ELEVATION = (0.5, 0.0, 0.44), 1.9, 189.0, -24.0


class Layer(NamedTuple):
    """A rendered scene: its colours (H, W, 3) and the pixels of the robot and its load (H, W)."""

    colours: Array
    robot: Flags


def main() -> None:
    """Plan the task, render the poses and write the picture."""
    config = ro.load_config(ROOT / "configs" / "waiter_two_blocks.yaml")
    plan = ro.solve(ro.build_problem(config))
    trajectory = ro.Trajectory.from_plan(plan)
    samples = trajectory.every(PERIOD)
    first = samples.s <= 1.0 / SWEEPS
    dots, _ = plan.problem.robot.carrier_pose(samples.q[first])
    poses = plan.problem.path(np.array([0.0, 0.5, 1.0]) / SWEEPS - 1e-9)
    start, middle, end = (render(scene(config, plan, q), q) for q in poses)
    save(blend(render(ground(dots), np.zeros(0), shadows=False), [(start, PALE), (end, PALE), (middle, 1.0)]))


def add_surroundings(spec: mujoco.MjSpec) -> None:
    """Add a floor, a light and a white background."""
    kind, gradient = mujoco.mjtTexture.mjTEXTURE_SKYBOX, mujoco.mjtBuiltin.mjBUILTIN_GRADIENT
    spec.add_texture(type=kind, builtin=gradient, rgb1=WHITE, rgb2=WHITE, width=8, height=48)
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[1.5, 1.5, 1], rgba=FLOOR)
    sun = mujoco.mjtLightType.mjLIGHT_DIRECTIONAL
    spec.worldbody.add_light(type=sun, pos=[0.2, -0.6, 4.0], dir=[0.05, 0.15, -1.0], diffuse=[0.5] * 3)


def ground(dots: Array) -> mujoco.MjSpec:
    """Return the scene without a robot: the dots (m, 3) [m] alone."""
    spec = mujoco.MjSpec()
    add_surroundings(spec)
    for dot in dots:
        spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, pos=dot, size=[0.009, 0, 0], rgba=DOT)
    return spec


def scene(config: ro.Config, plan: ro.Plan, q: Array) -> mujoco.MjSpec:
    """Return the robot with its tray and blocks as they are at the joint positions `q` (n,) [rad]."""
    robot = plan.problem.robot
    position, rotation = (pose[0] for pose in robot.carrier_pose(q[None]))
    spec = robot.spec.copy()
    add_surroundings(spec)
    add_box(spec, config.tray.size, position, rotation, TRAY)
    for name, placed in placements(config).items():
        place = position + rotation @ placed.position
        add_box(spec, config.objects[name].size, place, rotation @ placed.rotation, BLOCKS[name])
    return spec


def add_box(
    spec: mujoco.MjSpec, size: Sequence[float], position: Array, rotation: Array, colour: Sequence[float]
) -> None:
    """Add a box of edge lengths `size` (3,) [m] to the world, with a body of its own to tell it from the floor."""
    quaternion = Rotation.from_matrix(rotation).as_quat(scalar_first=True)
    body = spec.worldbody.add_body(pos=position, quat=quaternion)
    body.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=np.array(size) / 2, rgba=colour)


def render(spec: mujoco.MjSpec, q: Array, shadows: bool = True) -> Layer:
    """Render a scene with the robot at the joint positions `q` (n,)."""
    width, height = OVERSAMPLING * WIDTH, OVERSAMPLING * HEIGHT
    spec.visual.global_.offwidth, spec.visual.global_.offheight = width, height
    spec.visual.headlight.ambient, spec.visual.headlight.diffuse = [0.5] * 3, [0.3] * 3
    spec.visual.quality.shadowsize = 8192
    model = spec.compile()
    data, camera = mujoco.MjData(model), mujoco.MjvCamera()
    data.qpos[:] = q
    mujoco.mj_forward(model, data)
    camera.lookat[:], camera.distance, camera.azimuth, camera.elevation = LOOKAT, DISTANCE, AZIMUTH, ELEVATION
    with mujoco.Renderer(model, height, width) as renderer:
        renderer.update_scene(data, camera)
        renderer.scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = shadows
        colours = renderer.render().astype(float)
        renderer.enable_segmentation_rendering()
        renderer.update_scene(data, camera)
        geom = renderer.render()[:, :, 0]
    return Layer(colours, (geom >= 0) & (model.geom_bodyid[np.maximum(geom, 0)] > 0))


def blend(below: Layer, layers: Sequence[tuple[Layer, float]]) -> Array:
    """Lay the robots and their shadows over the ground, each with its opacity; return the picture (H, W, 3)."""
    picture = below.colours
    for layer, opacity in layers:
        shadow = 1.0 - opacity * (1.0 - layer.colours / np.maximum(below.colours, 1.0))
        pale = (1.0 - opacity) * picture + opacity * layer.colours
        picture = np.where(layer.robot[:, :, None], pale, picture * np.minimum(shadow, 1.0))
    return picture


def save(picture: Array) -> None:
    """Write the picture in its final size."""
    image = Image.fromarray(picture.round().astype(np.uint8))
    image.resize((WIDTH, HEIGHT), Image.Resampling.LANCZOS).save(ROOT / "docs" / "waiter.png", optimize=True)


if __name__ == "__main__":
    main()
