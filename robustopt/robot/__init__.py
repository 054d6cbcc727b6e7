"""The robot: model file, kinematics, dynamics, and joint limits."""

from robustopt.robot.cartesian import LimitedPoint, PointMotion
from robustopt.robot.dynamics import BodyMotion, CarrierMotion, Dynamics
from robustopt.robot.joint_limits import JointLimits
from robustopt.robot.robot import Robot, load_robot
from robustopt.robot.soles import Sole

__all__ = [
    "BodyMotion",
    "CarrierMotion",
    "Dynamics",
    "JointLimits",
    "LimitedPoint",
    "PointMotion",
    "Robot",
    "Sole",
    "load_robot",
]
