"""The model file of a robot on its feet: read, checked, and its floating base turned into six coordinates.

For planning the free joint of the base becomes three slides along x, y, z and three hinges about z, y, x, so that the
robot has plain coordinates q (n,) with q' and q'' like an arm's. Execution takes the file as it is.
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from robustopt.config import FEET, Config
from robustopt.errors import RobotError
from robustopt.geometry import rectangle
from robustopt.robot.model_file import (
    USUAL,
    RobotModel,
    compile_spec,
    model_file,
    read_model,
    require_open_chain,
    tendon_notes,
)

BASE_JOINTS = ("base_x", "base_y", "base_z", "base_yaw", "base_pitch", "base_roll")
"""Coordinates of the floating base in their order: position in the world, then turns about z, y and x."""


@dataclass(frozen=True)
class Sole:
    """Contact points of a foot or hand, (k, 3) in the frame of its site [m], in the plane z = 0, counter-clockwise."""

    points: np.ndarray


def load_walker_model(config: Config) -> tuple[RobotModel, np.ndarray, dict[str, Sole]]:
    """The robot with base coordinates in place of its free joint, its posture q (n,), and its contacts by name: both
    feet, and the hand that it has on a rail.

    Raises RobotError if the file has no floating base, foot, hand, contact point or keyframe, or has springs
    or couplings.
    """
    file = model_file(config)
    spec, limits, notes = read_model(file)
    original = compile_spec(spec, file)
    free = np.flatnonzero(original.jnt_type == mujoco.mjtJoint.mjJNT_FREE)
    if list(free) != [0]:
        found = "no free joint" if not len(free) else "a free joint that is not its first"
        raise RobotError(f"{file.name} has {found}; a robot on its feet has a free joint first", key="robot.model")
    require_open_chain(spec, file)
    _require_no_springs(original, file.name)
    if original.nkey == 0:
        raise RobotError(f"{file.name} has no keyframe; expected the posture of the robot", key="robot.model")
    posture = _posture(original)
    contacts = {name: _foot(original, name, file.name) for name in FEET}
    if config.path.rail is not None:
        _require_site(original, config.path.rail.contact, "palm", file.name)
        contacts[config.path.rail.contact] = Sole(_palm(config.path.rail.size))
    notes += tendon_notes(spec, original)
    _replace_free_joint(spec, original)
    for key in list(spec.keys):
        spec.delete(key)
    return RobotModel(spec=spec, original=original, file=file, urdf_limits=limits, notes=notes), posture, contacts


def _require_no_springs(model: mujoco.MjModel, file: str) -> None:
    sprung = [model.joint(k).name for k in np.flatnonzero(model.jnt_stiffness)]
    sprung += [model.tendon(k).name for k in np.flatnonzero(model.tendon_stiffness)]
    if sprung:
        raise RobotError(
            f"{file} has springs in {', '.join(sprung)}, which are not counted for a robot on its feet; expected none "
            "(stiffness 0)",
            key="robot.model",
        )


def _posture(model: mujoco.MjModel) -> np.ndarray:
    """Base coordinates and joints of the first keyframe, the base upright, (n,)."""
    key = model.key_qpos[0]
    return np.concatenate([key[:3], np.zeros(3), key[7:]])


def _require_site(model: mujoco.MjModel, name: str, place: str, file: str) -> None:
    if name not in [model.site(k).name for k in range(model.nsite)]:
        raise RobotError(f"{file} has no site {name!r} in the middle of a {place}", key="robot.model")


def _palm(size: tuple[float, float]) -> np.ndarray:
    """Corners of the part of a palm that touches a rail, (4, 3) in the frame of its site [m]."""
    return np.column_stack([rectangle(np.zeros(2), np.array(size)), np.zeros(4)])


def _foot(model: mujoco.MjModel, name: str, file: str) -> Sole:
    _require_site(model, name, "sole", file)
    site = model.site(name)
    body = int(site.bodyid[0])
    spheres = [
        k
        for k in range(model.ngeom)
        if model.geom_bodyid[k] == body
        and model.geom_type[k] == mujoco.mjtGeom.mjGEOM_SPHERE
        and model.geom_contype[k] | model.geom_conaffinity[k]
    ]
    if len(spheres) < 3:
        raise RobotError(
            f"{file} has {len(spheres)} spheres that can touch on the body of {name}; expected at least 3, its contact "
            "points",
            key="robot.model",
        )
    into_site = np.zeros(9)
    mujoco.mju_quat2Mat(into_site, site.quat)
    centers = (model.geom_pos[spheres] - site.pos) @ into_site.reshape(3, 3)
    points = centers - model.geom_size[spheres, :1] * np.array([0.0, 0.0, 1.0])
    if np.abs(points[:, 2]).max() > 1e-6:
        raise RobotError(f"{file}: the contact points of {name} are not in the plane of its site", key="robot.model")
    middle = points.mean(axis=0)
    order = np.argsort(np.arctan2(points[:, 1] - middle[1], points[:, 0] - middle[0]))
    return Sole(points[order])


def _replace_free_joint(spec: mujoco.MjSpec, original: mujoco.MjModel) -> None:
    name = original.joint(0).name
    body = spec.joint(name).parent
    spec.delete(spec.joint(name))
    body.pos, body.quat = np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0])
    slide, hinge = mujoco.mjtJoint.mjJNT_SLIDE, mujoco.mjtJoint.mjJNT_HINGE
    axes = np.eye(3)
    kinds = [(slide, axes[0]), (slide, axes[1]), (slide, axes[2]), (hinge, axes[2]), (hinge, axes[1]), (hinge, axes[0])]
    for joint, (kind, axis) in zip(BASE_JOINTS, kinds, strict=True):
        body.add_joint(
            USUAL.default, name=joint, type=kind, axis=axis, armature=0.0, damping=0.0, frictionloss=0.0, stiffness=0.0,
            limited=mujoco.mjtLimited.mjLIMITED_FALSE,
        )  # fmt: skip
