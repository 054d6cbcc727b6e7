"""Limits from a file in the format of MoveIt's `joint_limits.yaml` or `pilz_cartesian_limits.yaml`."""

from __future__ import annotations

from dataclasses import replace
from typing import TypeGuard

import numpy as np

from robustopt.config.document import Document, read_file
from robustopt.config.model import TOOL, CartesianLimit, Config, JointLimitOverride, RobotLimits
from robustopt.config.words import found
from robustopt.errors import ConfigError, ConfigProblem

KEY, ROOT, CARTESIAN = "robot.limits_file", "joint_limits", "cartesian_limits"
"""The key of the file's name, and the keys of its limits, of joints and of the tool."""

KINDS = {
    "velocity": ("has_velocity_limits", "max_velocity"),
    "acceleration": ("has_acceleration_limits", "max_acceleration"),
    "jerk": ("has_jerk_limits", "max_jerk"),
}
"""Limits that are read: our kind, MoveIt's key of whether there is one, and of its value."""

TOOL_KINDS = {"speed": ("max_trans_vel",), "acceleration": ("max_trans_acc", "max_trans_dec")}
"""Limits of the tool that are read: our kind, and MoveIt's keys, of which the smallest value counts."""


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
    limits = robot.limits
    for name in (robot.limits_file,) if isinstance(robot.limits_file, str) else robot.limits_file:
        limits = _completed(limits, _read(config, name))
    return config.model_copy(update={"robot": robot.model_copy(update={"limits": limits, "limits_file": None})})


def _read(config: Config, name: str) -> Document:
    try:
        return read_file(config.folder / name)
    except ConfigError as error:
        raise ConfigError([replace(problem, key=KEY) for problem in error.problems]) from None


def _completed(given: RobotLimits, document: Document) -> RobotLimits:
    """Return limits with those of a file where none are given."""
    has_tool = isinstance(document.data, dict) and CARTESIAN in document.data
    limits, problems = given, list(document.problems)
    if not problems and (not has_tool or ROOT in document.data):
        limits, problems = _with_joints(limits, document)
    if not problems and has_tool:
        limits, problems = _with_tool(limits, document)
    if problems:
        raise ConfigError(problems)
    return limits


def _with_joints(given: RobotLimits, document: Document) -> tuple[RobotLimits, list[ConfigProblem]]:
    """Return limits completed by those of the joints in a file, and the mistakes in it."""
    values, problems = _limits(document)
    every, limits = given.joints.get("all", JointLimitOverride()), given.joints
    for joint, read in values.items():
        own = limits.get(joint, JointLimitOverride())
        kept = {kind: value for kind, value in read.items() if getattr(own, kind) is getattr(every, kind) is None}
        if kept:
            limits[joint] = own.model_copy(update=kept)
    return given.model_copy(update=limits), problems


def _with_tool(given: RobotLimits, document: Document) -> tuple[RobotLimits, list[ConfigProblem]]:
    """Return limits completed by those of the tool in a file, and the mistakes in it."""
    section = document.data[CARTESIAN]
    if not isinstance(section, dict):
        message = f"found {found(section)}; expected a section, as in MoveIt's pilz_cartesian_limits.yaml"
        return given, [document.problem((CARTESIAN,), message)]
    own = (given.cartesian or {}).get(TOOL, CartesianLimit())
    kept: dict[str, float] = {}
    problems = []
    for kind, keys in TOOL_KINDS.items():
        for key in keys:
            value = section.get(key, np.inf)
            if not _is_limit(value):
                message = f"found {found(value)}; expected a number above 0, or .inf for none"
                problems.append(document.problem((CARTESIAN, key), message))
            elif getattr(own, kind) is None and value < kept.get(kind, np.inf):
                kept[kind] = float(value)
    tool = {TOOL: own.model_copy(update=kept)} if kept else {}
    return given.model_copy(update={"cartesian": (given.cartesian or {}) | tool or None}), problems


def _is_limit(value: object) -> TypeGuard[float]:
    """Return whether a value of a file is a limit."""
    return isinstance(value, (int, float)) and not isinstance(value, bool) and value > 0


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
            elif has and _is_limit(value):
                limits.setdefault(joint, {})[kind] = float(value)
            elif has:
                message = f"found {found(value)}; expected a number above 0, or .inf for none"
                problems.append(document.problem((ROOT, joint, key), message))
    return limits, problems
