"""The configuration: models of its sections; `load` reads, checks and writes it."""

from robustopt.config.execution_model import (
    DisturbanceConfig,
    ExecutionConfig,
    FailureConfig,
    TruthConfig,
    VariationConfig,
)
from robustopt.config.learning_model import FirstBelief, LearnedParameter, LearningConfig
from robustopt.config.model import BASE_COORDINATES, FEET, HANDS, ROBOT_SOURCES, TOOL, Config, UncertaintyConfig
from robustopt.config.object_model import GripConfig, ObjectConfig, SuctionConfig, TrayConfig
from robustopt.config.path_model import FramePose, PathConfig, PathTolerance, RailConfig, StanceConfig
from robustopt.config.section import AccelerationError, Pose

__all__ = [
    "BASE_COORDINATES",
    "FEET",
    "HANDS",
    "ROBOT_SOURCES",
    "TOOL",
    "AccelerationError",
    "Config",
    "DisturbanceConfig",
    "ExecutionConfig",
    "FailureConfig",
    "FirstBelief",
    "FramePose",
    "GripConfig",
    "LearnedParameter",
    "LearningConfig",
    "ObjectConfig",
    "PathConfig",
    "PathTolerance",
    "Pose",
    "RailConfig",
    "StanceConfig",
    "SuctionConfig",
    "TrayConfig",
    "TruthConfig",
    "UncertaintyConfig",
    "VariationConfig",
]
