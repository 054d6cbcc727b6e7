"""The floating base of a walking robot as six plain coordinates.

For planning, the free joint of the base becomes three slides along x, y, z and three hinges about z, y, x. The robot
then has coordinates q (n,) with q' and q'' like the joints of an arm. A simulation keeps the free joint.
"""

from __future__ import annotations

import mujoco
import numpy as np

from robustopt.arrays import Array
from robustopt.config import BASE_COORDINATES as BASE
from robustopt.errors import RobotError
from robustopt.robot.model_file import USUAL

BASE_JOINTS = ("base_x", "base_y", "base_z", "base_yaw", "base_pitch", "base_roll")
"""Coordinates of the floating base in their order: position in the world, then rotations about z, y and x."""

FREE_JOINT = 7
"""Number of positions of a free joint: three coordinates and a quaternion."""


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


def keyframe_posture(model: mujoco.MjModel, file: str) -> Array:
    """Return the coordinates of a walking robot in its first keyframe, with the base upright, (n,) [m and rad].

    Args:
        model: the model as in its file.
        file: name of the model file, for messages.

    Raises:
        RobotError: the model has no keyframe.
    """
    if model.nkey == 0:
        raise RobotError(f"{file} has no keyframe; expected the posture of the robot", key="robot.model")
    key = model.key_qpos[0]
    return np.concatenate([key[:3], np.zeros(3), key[FREE_JOINT:]])


def require_no_springs(model: mujoco.MjModel, file: str) -> None:
    """Check that a walking robot has no springs, which its dynamics do not include.

    Args:
        model: the model as in its file.
        file: name of the model file, for messages.

    Raises:
        RobotError: a joint or tendon has a stiffness.
    """
    sprung = [model.joint(k).name for k in np.flatnonzero(model.jnt_stiffness)]
    sprung += [model.tendon(k).name for k in np.flatnonzero(model.tendon_stiffness)]
    if sprung:
        raise RobotError(
            f"{file} has springs in {', '.join(sprung)}, which are not counted for a walking robot; expected none "
            "(stiffness 0)",
            key="robot.model",
        )


def replace_free_joint(spec: mujoco.MjSpec, original: mujoco.MjModel) -> None:
    """Put three slides and three hinges in place of the free joint of the model.

    Args:
        spec: specification of the model, which is changed.
        original: the compiled model as in its file; its first joint is the free one.
    """
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


def free_joint_positions(q: Array) -> Array:
    """Return the positions of a robot whose base is a free joint.

    Args:
        q: coordinates, with the six of the base first (P, n).

    Returns:
        Positions qpos (P, n + 1), with position and quaternion w, x, y, z of the base first.
    """
    half = 0.5 * q[:, 3:6]
    (cz, cy, cx), (sz, sy, sx) = np.cos(half).T, np.sin(half).T
    w, x = cz * cy * cx + sz * sy * sx, cz * cy * sx - sz * sy * cx
    y, z = cz * sy * cx + sz * cy * sx, sz * cy * cx - cz * sy * sx
    return np.column_stack([q[:, :3], w, x, y, z, q[:, BASE:]])


def base_to_wrench(jacobian: Array) -> Array:
    """Return the matrix from generalised forces of the base's coordinates to the wrench about the world's origin.

    Every body moves with the base like a rigid body, so the base columns of the Jacobian of any body at the world's
    origin give the power of the base coordinates.

    Args:
        jacobian: Jacobian of a point at the world's origin that is fixed to any body (P, 6, n).

    Returns:
        The matrices (P, 6, 6).
    """
    return np.asarray(np.linalg.inv(np.swapaxes(jacobian[:, :, :BASE], 1, 2)))
