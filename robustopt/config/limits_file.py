"""Joint limits from a file in the format of MoveIt's `joint_limits.yaml`."""

from __future__ import annotations

from dataclasses import replace

from robustopt.config.document import Document, read_file
from robustopt.config.model import Config, JointLimitOverride
from robustopt.config.words import found
from robustopt.errors import ConfigError, ConfigProblem

KEY, ROOT = "robot.limits_file", "joint_limits"
"""The key of the file's name, and the key of its limits."""

KINDS = {
    "velocity": ("has_velocity_limits", "max_velocity"),
    "acceleration": ("has_acceleration_limits", "max_acceleration"),
    "jerk": ("has_jerk_limits", "max_jerk"),
}
"""Limits that are read: our kind, MoveIt's key of whether there is one, and of its value."""


def with_limits_file(config: Config) -> Config:
    """Return a configuration with the limits of `robot.limits_file` in `robot.limits`, where none are given.

    Args:
        config: the configuration.

    Raises:
        ConfigError: the file cannot be read, or has mistakes; the error lists all of them.
    """
    robot = config.robot
    if robot.limits_file is None:
        return config
    document = _read(config, robot.limits_file)
    if document.problems:
        raise ConfigError(document.problems)
    values, problems = _limits(document)
    if problems:
        raise ConfigError(problems)
    every, limits = robot.limits.joints.get("all", JointLimitOverride()), robot.limits.joints
    for joint, given in values.items():
        own = limits.get(joint, JointLimitOverride())
        kept = {kind: value for kind, value in given.items() if getattr(own, kind) is getattr(every, kind) is None}
        if kept:
            limits[joint] = own.model_copy(update=kept)
    update = {"limits": robot.limits.model_copy(update=limits), "limits_file": None}
    return config.model_copy(update={"robot": robot.model_copy(update=update)})


def _read(config: Config, name: str) -> Document:
    try:
        return read_file(config.folder / name)
    except ConfigError as error:
        raise ConfigError([replace(problem, key=KEY) for problem in error.problems]) from None


def _limits(document: Document) -> tuple[dict[str, dict[str, float]], list[ConfigProblem]]:
    """Return the limits of a file by joint and kind, and the mistakes in it."""
    joints = document.data.get(ROOT) if isinstance(document.data, dict) else None
    if not isinstance(joints, dict) or not joints:
        message = f"found {found(joints)}; expected limits by joint name, as in MoveIt's joint_limits.yaml"
        return {}, [document.problem((ROOT,), message)]
    limits: dict[str, dict[str, float]] = {}
    problems = []
    for joint, entry in joints.items():
        if not isinstance(entry, dict):
            problems.append(document.problem((ROOT, joint), f"found {found(entry)}; expected a section"))
            continue
        for kind, (flag, key) in KINDS.items():
            has, value = entry.get(flag, False), entry.get(key)
            if not isinstance(has, bool):
                problems.append(document.problem((ROOT, joint, flag), f"found {found(has)}; expected true or false"))
            elif has and isinstance(value, (int, float)) and not isinstance(value, bool) and value > 0:
                limits.setdefault(joint, {})[kind] = float(value)
            elif has:
                message = f"found {found(value)}; expected a number above 0, or .inf for none"
                problems.append(document.problem((ROOT, joint, key), message))
    return limits, problems
