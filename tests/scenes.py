"""Small tasks for the tests: a tray on one or two slides, a lift or a turntable, and the shipped waiter tasks."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from robustopt.config import Config
from robustopt.config import Config as Model
from robustopt.config.load import load_config, with_values
from robustopt.limits import TimeScalingProblem
from robustopt.solvers import Plan, Status, build_problem, solve

FIXTURES = Path(__file__).parent / "fixtures"
CONFIGS = Path(__file__).parents[1] / "configs"
G = 9.81

WAITERS = ("one_block", "two_blocks", "side_by_side", "bridge", "heavy")
"""Shipped waiter configurations that need no extra package."""

BOX = {"shape": "box", "size": [0.1, 0.1, 0.1], "mass": 0.5}
FLAT = {"shape": "box", "size": [0.2, 0.2, 0.02], "mass": 0.5}
"""An object that slips long before it tips."""


def scene(robot: str = "slide", objects: dict[str, Any] | None = None, length: float = 1.0, **sections: Any) -> Config:
    """A checked configuration: a robot of the fixtures moves its joints in a straight line from 0 to `length`.

    Keyword arguments are sections, merged with the defaults here; `joints` replaces the waypoints.
    """
    joints = sections.pop("joints", None)
    if joints is None:
        joints = [[0.0], [length]] if robot != "two_slides" else [[0.0, 0.0], [length, 0.0]]
    data: dict[str, Any] = {
        "name": "test",
        "robot": {
            "model": f"{robot}.xml",
            "tool": "tool",
            "collision": {"check": False},
            **sections.pop("robot_keys", {}),
        },
        "tray": {"size": [0.6, 0.6, 0.01], "mass": 1.0, **sections.pop("tray", {})},
        "objects": objects or {},
        "path": {"joints": joints},
        "solver": {"method": "reachability", "collocation_points": 100, **sections.pop("solver", {})},
        **sections,
    }
    return with_values(Model.model_validate({**data, "folder": FIXTURES}), {})


def waiter(name: str, *overrides: str) -> Config:
    return load_config(CONFIGS / f"waiter_{name}.yaml", overrides=list(overrides))


def plan_of(config: Config, method: str | None = None) -> Plan:
    return solve(build_problem(config), method)


def duration(config: Config, method: str | None = None) -> float:
    """Duration of a plan that must exist [s]."""
    plan = plan_of(config, method)
    assert plan.status is Status.SOLVED, plan.message
    return plan.duration


def bang_bang(length: float, speeding: float, braking: float | None = None) -> float:
    """Shortest time over a length with bounded acceleration and braking [s]: v^2 = 2 a s on both sides."""
    braking = speeding if braking is None else braking
    fastest = np.sqrt(2 * length * speeding * braking / (speeding + braking))
    return float(fastest / speeding + fastest / braking)


def residual(problem: TimeScalingProblem, x: np.ndarray, u: np.ndarray) -> float:
    """Largest value of any row at both ends of all intervals that have a length; rows are fractions of their limit."""
    moving = np.flatnonzero(problem.ds > 0)
    worst = -np.inf
    for end in (0, 1):
        a, b, c = (array[moving + end] for array in (problem.a, problem.b, problem.c))
        worst = max(worst, float((a * u[moving, None] + b * x[moving + end, None] + c).max(initial=-np.inf)))
    return worst
