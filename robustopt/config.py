"""The configuration: models, and (below) what reads, changes and writes them."""

from __future__ import annotations

from robustopt.config_model import (
    AccelerationError,
    Collision,
    Config,
    ContactConfig,
    JointLimitOverride,
    ObjectConfig,
    PathConfig,
    PathTolerance,
    Pose,
    RobotConfig,
    SolverConfig,
    TrayConfig,
    TrayPose,
    UncertaintyConfig,
)

__all__ = [
    "AccelerationError",
    "Collision",
    "Config",
    "ContactConfig",
    "JointLimitOverride",
    "ObjectConfig",
    "PathConfig",
    "PathTolerance",
    "Pose",
    "RobotConfig",
    "SolverConfig",
    "TrayConfig",
    "TrayPose",
    "UncertaintyConfig",
]
