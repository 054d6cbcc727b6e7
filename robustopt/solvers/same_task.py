"""Check that a configuration and a plan belong to the same task."""

from __future__ import annotations

from robustopt.config import Config
from robustopt.errors import ConfigError
from robustopt.scene.placement import solids
from robustopt.solvers.plan import Plan


def require_same_task(config: Config, plan: Plan, other_limits: bool = False) -> None:
    """Check that a configuration has the robot, path, tray, objects and gravity of a plan.

    Frictions, masses and intervals may differ.

    Args:
        config: the configuration.
        plan: the plan.
        other_limits: whether `robot.limits` may differ too.

    Raises:
        ConfigError: the plan is of another task; the error names the keys that differ.
    """
    theirs = plan.problem.config
    if config is theirs:
        return
    robot = config.robot
    if other_limits:
        robot = robot.model_copy(update={key: getattr(theirs.robot, key) for key in ("limits", "limits_file")})
    same = {
        "robot": robot == theirs.robot,
        "tray": _tray(config) == _tray(theirs),
        "path": config.path == theirs.path,
        "gravity": config.gravity == theirs.gravity,
        "objects": solids(config) == solids(theirs),
    }
    other = [key for key, equal in same.items() if not equal]
    if other:
        keys = ", ".join(other)
        raise ConfigError(
            f"the plan is of another task, {theirs.name}: {keys} differ{'s' if len(other) == 1 else ''}; "
            "expected a plan of this configuration",
            key=other[0],
        )


def _tray(config: Config) -> tuple[object, ...]:
    """Return shape and place of the tray, if there is one."""
    return () if config.tray is None else (config.tray.size, config.tray.pose)
