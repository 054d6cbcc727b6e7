"""The configuration: models of its sections, reading, checking, and writing."""

from robustopt.config.execution_model import (
    DisturbanceConfig,
    ExecutionConfig,
    FailureConfig,
    TruthConfig,
    VariationConfig,
)
from robustopt.config.learning_model import FirstBelief, LearningConfig
from robustopt.config.load import dump, load_config, located, resolved, with_values
from robustopt.config.model import (
    BASE_COORDINATES,
    FEET,
    HANDS,
    Config,
    ObjectConfig,
    PathConfig,
    PathTolerance,
    RailConfig,
    StanceConfig,
    TrayConfig,
    TrayPose,
    UncertaintyConfig,
)
from robustopt.config.section import AccelerationError, Pose

__all__ = [
    "BASE_COORDINATES",
    "FEET",
    "HANDS",
    "AccelerationError",
    "Config",
    "DisturbanceConfig",
    "ExecutionConfig",
    "FailureConfig",
    "FirstBelief",
    "LearningConfig",
    "ObjectConfig",
    "PathConfig",
    "PathTolerance",
    "Pose",
    "RailConfig",
    "StanceConfig",
    "TrayConfig",
    "TrayPose",
    "TruthConfig",
    "UncertaintyConfig",
    "VariationConfig",
    "dump",
    "load_config",
    "located",
    "resolved",
    "with_values",
]
