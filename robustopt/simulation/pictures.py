"""Light, floor and camera for pictures of a world."""

from __future__ import annotations

import mujoco
import numpy as np

from robustopt.arrays import Array
from robustopt.config import FEET, Config
from robustopt.path.footsteps import footsteps
from robustopt.robot import Robot
from robustopt.robot.model_file import USUAL
from robustopt.simulation.ground import FLOOR, RAIL

AWAY, AROUND, ABOVE = 0.6, 215.0, -18.0
"""Camera of an arm: distance beyond the path length [m], angles about the vertical and above the horizon [deg]."""

WALKING_AWAY, WALKING_AROUND, WALKING_ABOVE = 3.2, 110.0, -14.0
"""Camera of a walking robot: distance in heights of the pelvis, beyond the length of the walk; angle about the vertical
and above the horizon [deg], on the side of the hand that is on a rail, else on the right."""

_SKY = (0.93, 0.95, 0.97)


def view_of(config: Config, robot: Robot, q: Array) -> mujoco.MjvCamera:
    """Return a camera that sees the whole path of a robot.

    Args:
        config: the configuration.
        robot: the robot.
        q: coordinates along the path (P, n) [rad or m].
    """
    if not robot.contacts:
        carrier, _ = robot.carrier_pose(q)
        return _camera(carrier.mean(axis=0), AWAY + float(np.ptp(carrier, axis=0).max()), AROUND, ABOVE)
    feet = np.array([[standing[foot].position[:2] for foot in FEET] for standing in footsteps(config).places])
    height, way = float(robot.posture[2]), float(np.ptp(feet.mean(axis=1), axis=0).max())
    azimuth = -WALKING_AROUND if "left_hand" in robot.contacts else WALKING_AROUND
    return _camera(np.append(feet.mean(axis=(0, 1)), height), WALKING_AWAY * height + way, azimuth, WALKING_ABOVE)


def _camera(lookat: Array, distance: float, azimuth: float, elevation: float) -> mujoco.MjvCamera:
    camera = mujoco.MjvCamera()
    camera.lookat[:] = lookat
    camera.distance, camera.azimuth, camera.elevation = distance, azimuth, elevation
    return camera


def add_scenery(spec: mujoco.MjSpec, config: Config, robot: Robot) -> None:
    """Add a light background, and for a walking robot tiles, footprints and the posts of a rail.

    Args:
        spec: specification of the world, which is changed.
        config: the configuration.
        robot: the robot.
    """
    kind, gradient = mujoco.mjtTexture.mjTEXTURE_SKYBOX, mujoco.mjtBuiltin.mjBUILTIN_GRADIENT
    spec.add_texture(type=kind, builtin=gradient, rgb1=_SKY, rgb2=_SKY, width=8, height=48)
    if robot.contacts:
        _add_tiles(spec)
        _add_footprints(spec, config, robot)
        _add_posts(spec)


def _add_tiles(spec: mujoco.MjSpec) -> None:
    pattern = spec.add_texture(
        name=FLOOR, type=mujoco.mjtTexture.mjTEXTURE_2D, builtin=mujoco.mjtBuiltin.mjBUILTIN_CHECKER,
        rgb1=(0.97, 0.97, 0.97), rgb2=(0.9, 0.91, 0.92), width=128, height=128,
    )  # fmt: skip
    material = spec.add_material(name=FLOOR, texrepeat=[5.0, 5.0], texuniform=True, emission=0.5)
    material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = pattern.name
    floor = spec.geom(FLOOR)
    floor.material, floor.rgba = FLOOR, (1.0, 1.0, 1.0, 1.0)


def _add_footprints(spec: mujoco.MjSpec, config: Config, robot: Robot) -> None:
    """Show the planned places of the feet, so that slips can be seen."""
    places = footsteps(config).places
    for k, standing in enumerate(places):
        pale = 0.35 * (len(places) - 1 - k) / max(len(places) - 1, 1)
        for name in FEET:
            points = robot.contacts[name].points[:, :2]
            middle = standing[name].position[:2] + 0.5 * (points.min(axis=0) + points.max(axis=0))
            size = [*(0.5 * np.ptp(points, axis=0) - 0.01), 1e-3]
            spec.worldbody.add_geom(
                USUAL.default, type=mujoco.mjtGeom.mjGEOM_BOX, size=size, pos=[*middle, 0.0], contype=0, conaffinity=0,
                rgba=(0.45 + pale, 0.85, 0.55 + pale, 1.0), mass=0.0,
            )  # fmt: skip


def _add_posts(spec: mujoco.MjSpec) -> None:
    """Add posts under the ends of a rail, if there is one."""
    for rail in [geom for geom in spec.geoms if geom.name == RAIL]:
        axes = np.zeros(9)
        mujoco.mju_quat2Mat(axes, np.asarray(rail.quat, dtype=float))
        for side in (-1.0, 1.0):
            top = rail.pos + side * 0.95 * rail.size[0] * axes.reshape(3, 3)[:, 0]
            if top[2] > 0.0:
                spec.worldbody.add_geom(
                    USUAL.default, type=mujoco.mjtGeom.mjGEOM_CAPSULE, fromto=[*top, *top[:2], 0.0],
                    size=[0.01, 0.0, 0.0], rgba=rail.rgba, contype=0, conaffinity=0, mass=0.0,
                )  # fmt: skip
