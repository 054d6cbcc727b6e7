"""Problems of robots on their feet, for the tests."""

from __future__ import annotations

from typing import Any

from robustopt.config.load import with_values
from robustopt.limits import TimeScalingProblem
from robustopt.robot import Robot
from robustopt.solvers import build_rows


def walker_of(problem: TimeScalingProblem) -> Robot:
    return problem.robot


def believing(problem: TimeScalingProblem, values: dict[str, Any]) -> TimeScalingProblem:
    """The problem with other values of its configuration, along the same path."""
    return build_rows(with_values(problem.config, values), problem.robot, problem.path)
