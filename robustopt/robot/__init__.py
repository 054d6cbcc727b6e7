"""The robot: model file, kinematics, dynamics, and joint limits."""

from robustopt.robot.joint_limits import JointLimits
from robustopt.robot.robot import ArmDynamics, Links, Robot, load_robot

__all__ = ["ArmDynamics", "JointLimits", "Links", "Robot", "load_robot"]
