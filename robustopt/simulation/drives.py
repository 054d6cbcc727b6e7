"""The robot in the simulated world: its joints with limits and friction, and a motor with its controller on each."""

from __future__ import annotations

import mujoco
import numpy as np

from robustopt.arrays import Array
from robustopt.config import Config
from robustopt.robot import Robot
from robustopt.robot.joint_limits import JointLimits, joint_limits
from robustopt.robot.model_file import USUAL
from robustopt.robot.preparation import load_model
from robustopt.simulation.controller import Gains
from robustopt.simulation.physics import PREFIX


def frictional_limits(config: Config, robot: Robot) -> JointLimits:
    """Return the limits of the joints with a motor, with their friction even if the planner does not count it.

    Args:
        config: the configuration.
        robot: the robot.

    Raises:
        RobotError: the robot cannot be used.
    """
    frictional = config.model_copy(update={"robot": config.robot.model_copy(update={"joint_friction": True})})
    return joint_limits(frictional, load_model(config), robot.joint_names[robot.motors])


def add_drives(spec: mujoco.MjSpec, robot: Robot, limits: JointLimits, gains: Gains, compensated: float) -> None:
    """Give the joints their limits and friction, and each a motor with its controller.

    Args:
        spec: specification of the world, which is changed.
        robot: the robot.
        limits: limits of the joints with a motor.
        gains: gains of their controllers.
        compensated: fraction of the robot's weight that the controller compensates.
    """
    for item in [*spec.actuators, *spec.sensors]:
        spec.delete(item)
    for body in spec.bodies[1:]:
        body.gravcomp = compensated
    for i, name in enumerate(robot.joint_names[robot.motors]):
        _set_joint(spec, name, limits, i, robot.hinges[robot.base + i], robot.ranges[robot.base + i])
        actuator = spec.add_actuator(USUAL.default, name=PREFIX + name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        actuator.set_to_pid(kp=gains.kp[i], kv=gains.kd[i], ki=gains.ki[i], ctrlspec=gains.inputs)


def _set_joint(spec: mujoco.MjSpec, name: str, limits: JointLimits, i: int, hinge: bool, range_: Array) -> None:
    joint, torque = spec.joint(name), limits.torque[i]
    joint.actfrclimited, joint.actfrcrange = bool(np.isfinite(torque)), [-torque, torque]
    joint.actgravcomp = True
    unit = np.pi / 180 if spec.compiler.degree and hinge else 1.0
    if np.any(joint.range):  # files can be put together from parts with units of their own
        end = int(np.argmax(np.abs(joint.range)))
        unit = range_[end] / joint.range[end]
    joint.range, joint.margin = np.array([limits.lower[i], limits.upper[i]]) / unit, 0.0
    joint.limited = bool(np.isfinite(joint.range).all())
    joint.frictionloss = limits.dry_friction[i]
    joint.damping = [limits.viscous_friction[i], 0.0, 0.0]


def release(spec: mujoco.MjSpec) -> None:
    """Keep all parts of the robot from touching anything.

    Args:
        spec: specification of the world, which is changed.
    """
    for pair in [*spec.pairs, *spec.excludes]:
        spec.delete(pair)
    for geom in spec.geoms:
        geom.contype = geom.conaffinity = 0
