"""The floating base of a walking robot as six plain coordinates.

For planning, the free joint of the base becomes three slides along x, y, z and three hinges about z, y, x. The robot
then has coordinates q (n,) with q' and q'' like the joints of an arm. A simulation keeps the free joint.
"""

from __future__ import annotations

import mujoco
import numpy as np

from robustopt.arrays import Array
from robustopt.config import BASE_COORDINATES as BASE
from robustopt.config import Config
from robustopt.errors import RobotError
from robustopt.robot.model_file import USUAL, joint_names

BASE_JOINTS = ("base_x", "base_y", "base_z", "base_yaw", "base_pitch", "base_roll")
"""Coordinates of the floating base in their order: position in the world, then rotations about z, y and x."""


def base_coordinates(model: mujoco.MjModel, file: str) -> int:
    """Return the number of coordinates of the floating base: 6 if the first joint is a free one, else 0.

    Args:
        model: the model as in its file.
        file: name of the model file, for messages.

    Raises:
        RobotError: the other joints are not all hinges and slides, or there are none.
    """
    free, ball = int(mujoco.mjtJoint.mjJNT_FREE), int(mujoco.mjtJoint.mjJNT_BALL)
    kinds = [int(kind) for kind in model.jnt_type]
    first = 1 if kinds[:1] == [free] else 0
    other = {free: "free", ball: "ball"}
    wrong = [
        f"{other[kind]} joint {model.joint(i).name!r}" for i, kind in enumerate(kinds) if kind in other and i >= first
    ]
    if wrong or len(kinds) == first:
        found = ", ".join(wrong) or (f"no joint but the free joint {model.joint(0).name!r}" if first else "no joint")
        allowed = "hinge and slide joints only, and before them a free joint if it walks"
        raise RobotError(f"{file} has {found}; a robot has {allowed}", key="robot.model")
    return BASE if first else 0


def posture_of(model: mujoco.MjModel, base: int) -> dict[str, float]:
    """Return the coordinates of a robot in its first keyframe, with the base upright, by name [m and rad].

    Args:
        model: the model as in its file; without a keyframe its joints are at their default positions.
        base: number of base coordinates.
    """
    first = [*model.key_qpos, model.qpos0][0]
    names = [*BASE_JOINTS[:base], *joint_names(model)[base // BASE :]]
    upright = np.zeros(base // 2)
    return dict(zip(names, [*first[: base // 2], *upright, *first[base + base // BASE :]], strict=True))


def require_walker(config: Config, model: mujoco.MjModel, file: str) -> None:
    """Check that a walking robot has steps and a posture, and no springs, which its dynamics do not include.

    Args:
        config: the configuration.
        model: the model as in its file.
        file: name of the model file, for messages.

    Raises:
        RobotError: the path has no steps, the model has no keyframe, or a joint or tendon has a stiffness.
    """
    if config.path.steps is None:
        raise RobotError(
            f"{file} has the free joint {model.joint(0).name!r}, so it is a walking robot, whose path is path.steps; "
            "give path.steps, or a model without a free joint",
            key="robot.model",
        )
    if model.nkey == 0:
        raise RobotError(f"{file} has no keyframe; expected the posture of the robot", key="robot.model")
    sprung = [model.joint(k).name for k in np.flatnonzero(model.jnt_stiffness)]
    sprung += [model.tendon(k).name for k in np.flatnonzero(model.tendon_stiffness)]
    if sprung:
        raise RobotError(
            f"{file} has springs in {', '.join(sprung)}, which are not counted for a walking robot; expected none "
            "(stiffness 0)",
            key="robot.model",
        )


def replace_free_joints(spec: mujoco.MjSpec) -> None:
    """Put three slides and three hinges in place of each free joint of a model.

    Args:
        spec: specification of the model, which is changed.
    """
    slide, hinge = mujoco.mjtJoint.mjJNT_SLIDE, mujoco.mjtJoint.mjJNT_HINGE
    axes = np.eye(3)
    kinds = [(slide, axes[0]), (slide, axes[1]), (slide, axes[2]), (hinge, axes[2]), (hinge, axes[1]), (hinge, axes[0])]
    for free in [joint for joint in spec.joints if joint.type == mujoco.mjtJoint.mjJNT_FREE]:
        body = free.parent
        spec.delete(free)
        body.pos, body.quat = np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0])
        for name, (kind, axis) in zip(BASE_JOINTS, kinds, strict=True):
            body.add_joint(
                USUAL.default, name=name, type=kind, axis=axis, armature=0.0, damping=0.0, frictionloss=0.0,
                stiffness=0.0, limited=mujoco.mjtLimited.mjLIMITED_FALSE,
            )  # fmt: skip


def free_joint_positions(q: Array, base: int) -> Array:
    """Return the positions of a robot whose base, if it has one, is a free joint.

    Args:
        q: coordinates, with those of the base first (P, n).
        base: number of base coordinates.

    Returns:
        Positions qpos (P, n + base / 6), with position and quaternion w, x, y, z of the base first.
    """
    half = 0.5 * q[:, base // 2 : base].reshape(len(q), base // BASE, 3)
    (cz, cy, cx), (sz, sy, sx) = np.moveaxis(np.cos(half), 2, 0), np.moveaxis(np.sin(half), 2, 0)
    w, x = cz * cy * cx + sz * sy * sx, cz * cy * sx - sz * sy * cx
    y, z = cz * sy * cx + sz * cy * sx, sz * cy * cx - cz * sy * sx
    return np.column_stack([q[:, : base // 2], w, x, y, z, q[:, base:]])


def base_to_wrench(jacobian: Array, base: int) -> Array:
    """Return the matrix from generalised forces of the base's coordinates to the wrench about the world's origin.

    Every body moves with the base like a rigid body, so the base columns of the Jacobian of any body at the world's
    origin give the power of the base coordinates.

    Args:
        jacobian: Jacobian of a point at the world's origin that is fixed to any body (P, 6, n).
        base: number of base coordinates.

    Returns:
        The matrices (P, base, base).
    """
    return np.asarray(np.linalg.inv(np.swapaxes(jacobian[:, :base, :base], 1, 2)))
