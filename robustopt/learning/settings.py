"""Checks of settings that several learners have; each error names the key in the configuration."""

from __future__ import annotations

from robustopt.errors import ConfigError


def require_friction(friction: tuple[float, float]) -> None:
    """Check that an interval of the coefficient of friction has 0 <= low < high.

    Args:
        friction: the two ends.

    Raises:
        ConfigError: the ends violate this condition.
    """
    low, high = friction
    if not 0 <= low < high:
        raise ConfigError(f"found [{low:g}, {high:g}]; expected 0 <= low < high", key="learning.friction")


def require_positive(**values: float) -> None:
    """Check that settings are positive.

    Args:
        **values: the settings by their keys in the section `learning`.

    Raises:
        ConfigError: one of them is not positive.
    """
    for key, value in values.items():
        if not value > 0:
            raise ConfigError(f"found {value:g}; expected a number over 0", key=f"learning.{key}")


def require_level(**values: float) -> None:
    """Check that settings are probabilities between 0 and 1, both excluded.

    Args:
        **values: the settings by their keys in the section `learning`.

    Raises:
        ConfigError: one of them is not between 0 and 1.
    """
    for key, value in values.items():
        if not 0 < value < 1:
            raise ConfigError(f"found {value:g}; expected a number between 0 and 1", key=f"learning.{key}")
