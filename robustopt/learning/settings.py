"""Checks of the settings that learners share; each names the key of the configuration."""

from __future__ import annotations

from robustopt.errors import ConfigError


def require_friction(friction: tuple[float, float]) -> None:
    low, high = friction
    if not 0 <= low < high:
        raise ConfigError(f"found [{low:g}, {high:g}]; expected 0 <= low < high", key="learning.friction")


def require_positive(**values: float) -> None:
    for key, value in values.items():
        if not value > 0:
            raise ConfigError(f"found {value:g}; expected a number over 0", key=f"learning.{key}")


def require_level(**values: float) -> None:
    for key, value in values.items():
        if not 0 < value < 1:
            raise ConfigError(f"found {value:g}; expected a number between 0 and 1", key=f"learning.{key}")
