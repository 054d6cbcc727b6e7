"""Joints that `robot.locked` holds at a position: they become fixed, and everything that needs them is deleted."""

from __future__ import annotations

from collections.abc import Mapping

import mujoco
import numpy as np

from robustopt.arrays import Array
from robustopt.errors import RobotError
from robustopt.robot.model_file import joint_names


def lock_joints(spec: mujoco.MjSpec, original: mujoco.MjModel, locked: Mapping[str, float], file: str) -> None:
    """Fix joints at their positions by folding their motion into the pose of their body.

    Args:
        spec: specification, which is changed.
        original: the model with all its joints.
        locked: position by joint name [rad or m].
        file: name of the model file, for messages.

    Raises:
        RobotError: a joint does not exist, no joint would be left, or a body would keep one of its several joints.
    """
    names = joint_names(original)
    unknown = [name for name in locked if name not in names]
    if unknown:
        raise RobotError(
            f"{file} has no joint {', '.join(unknown)}; its joints are: {', '.join(names)}", "robot.locked"
        )
    if locked and set(locked) == set(names):
        raise RobotError("every joint is locked; at least one must move", key="robot.locked")
    data = mujoco.MjData(original)
    for name, value in locked.items():
        data.qpos[original.joint(name).qposadr[0]] = value
    mujoco.mj_kinematics(original, data)
    for body in {spec.joint(name).parent.name: spec.joint(name).parent for name in locked}.values():
        _require_all_locked(body, locked, file)
        if body.frame is not None:
            body.set_frame(body.parent.add_frame())
        body.pos, body.quat = _pose_in_parent(original, data, original.body(body.name).id)
        body.alt.type = mujoco.mjtOrientation.mjORIENTATION_QUAT
    _delete_joints(spec, set(locked))


def followers(original: mujoco.MjModel, locked: Mapping[str, float]) -> dict[str, float]:
    """Return the positions of joints that mimic a locked joint, directly or through others [rad or m].

    Args:
        original: the model with all its joints.
        locked: position by joint name [rad or m].
    """
    held, found = dict(locked), dict[str, float]()
    couplings = np.flatnonzero((original.eq_type == mujoco.mjtEq.mjEQ_JOINT) & (original.eq_obj2id >= 0))
    for k in np.tile(couplings, len(couplings)):
        follower, leader = (original.joint(int(joint[k])) for joint in (original.eq_obj1id, original.eq_obj2id))
        if original.eq_active0[k] and leader.name in held and follower.name not in held:
            change = held[leader.name] - original.qpos0[leader.qposadr[0]]
            offset = np.polynomial.polynomial.polyval(change, original.eq_data[k, :5])
            held[follower.name] = found[follower.name] = float(original.qpos0[follower.qposadr[0]] + offset)
    return found


def _require_all_locked(body: mujoco.MjsBody, locked: Mapping[str, float], file: str) -> None:
    moving = [joint.name for joint in body.joints if joint.name not in locked]
    if moving:
        raise RobotError(
            f"the body {body.name} of {file} moves in several joints; lock {', '.join(moving)} too, or none",
            key="robot.locked",
        )


def _pose_in_parent(model: mujoco.MjModel, data: mujoco.MjData, body: int) -> tuple[Array, Array]:
    """Return position (3,) [m] and quaternion (4,) of a body in the frame of its parent."""
    parent = model.body_parentid[body]
    position, inverse, quaternion = np.zeros(3), np.zeros(4), np.zeros(4)
    mujoco.mju_negQuat(inverse, data.xquat[parent])
    mujoco.mju_rotVecQuat(position, data.xpos[body] - data.xpos[parent], inverse)
    mujoco.mju_mulQuat(quaternion, inverse, data.xquat[body])
    return position, quaternion


def _delete_joints(spec: mujoco.MjSpec, joints: set[str]) -> None:
    """Delete joints, and the tendons, couplings, actuators and sensors that depend on them."""
    target, trn, eq, obj = mujoco.mjtWrap.mjWRAP_JOINT, mujoco.mjtTrn, mujoco.mjtEq, mujoco.mjtObj
    tendons = {
        tendon.name
        for tendon in spec.tendons
        if any(wrap.type == target and wrap.target.name in joints for wrap in tendon.path)
    }
    gone = {"joint": joints, "tendon": tendons}
    driven = {trn.mjTRN_JOINT: "joint", trn.mjTRN_JOINTINPARENT: "joint", trn.mjTRN_TENDON: "tendon"}
    coupled = {eq.mjEQ_JOINT: "joint", eq.mjEQ_TENDON: "tendon"}
    sensed = {obj.mjOBJ_JOINT: "joint", obj.mjOBJ_TENDON: "tendon", obj.mjOBJ_ACTUATOR: "actuator"}
    actuators = [item for item in spec.actuators if item.target in gone.get(driven.get(item.trntype, ""), ())]
    gone["actuator"] = {item.name for item in actuators}
    couplings = [
        item for item in spec.equalities if {item.name1, item.name2} & set(gone.get(coupled.get(item.type, ""), ()))
    ]
    sensors = [item for item in spec.sensors if item.objname in gone.get(sensed.get(item.objtype, ""), ())]
    for item in [*sensors, *couplings, *actuators]:
        spec.delete(item)
    for name in tendons:
        spec.delete(spec.tendon(name))
    for name in joints:
        spec.delete(spec.joint(name))
