"""Check that a configuration beside a plan is of the same task."""

from __future__ import annotations

from robustopt.config import Config
from robustopt.errors import ConfigError
from robustopt.solvers.plan import Plan

PLACE = ("shape", "size", "radius", "height", "on", "held_by", "at", "yaw")
"""Keys of an object that say its shape and place."""


def require_same_task(config: Config, plan: Plan) -> None:
    """Check that a plan is of this robot, path and scene; nominal values and intervals may differ.

    Args:
        config: the configuration.
        plan: the plan.

    Raises:
        ConfigError: the plan is of another task.
    """
    planned = plan.problem.config
    if config is planned:
        return
    same = {
        "robot": config.robot == planned.robot,
        "tray": _tray(config) == _tray(planned),
        "path": config.path == planned.path,
        "gravity": config.gravity == planned.gravity,
        "objects": _places(config) == _places(planned),
    }
    other = [key for key, equal in same.items() if not equal]
    if other:
        raise ConfigError(
            f"the plan is of another task, {planned.name}: {', '.join(other)} differ{'s' if len(other) == 1 else ''}; "
            "expected a plan of this configuration",
            key=other[0],
        )


def _tray(config: Config) -> tuple[object, ...]:
    """Return shape and place of the tray, if there is one."""
    return () if config.tray is None else (config.tray.size, config.tray.pose)


def _places(config: Config) -> list[tuple[object, ...]]:
    """Return shapes and places of the objects."""
    return [(name, *(getattr(body, key) for key in PLACE)) for name, body in config.objects.items()]
