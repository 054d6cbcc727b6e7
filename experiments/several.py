"""Common parts of the tables of several learned parameters: tasks, learners, runs, lines and columns."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from learned import Bench, recorded, success, task
from scan import Found, fastest

from robustopt.config import Config
from robustopt.learning.learner import Belief
from robustopt.learning.parameters import Parameter
from robustopt.runs.records import LearningRecord
from robustopt.tables import Column

LEARNERS = ("bnb-midpoint", "bnb-diagonal", "bnb-informed")


@dataclass(frozen=True)
class Problem:
    """A task whose parameters are learned.

    Attributes:
        name: name of the problem.
        path: the configuration.
        overrides: overrides of the configuration.
        parameters: the learned parameters.
        budget: largest number of executions.
        side: number of plans along each side of the grid of brute force.
        executions_per_plan: successes in a row that a plan needs.
        plans: largest number of evaluations of f* that guide the search.
    """

    name: str
    path: Path
    overrides: tuple[str, ...]
    parameters: tuple[Parameter, ...]
    budget: int
    side: int
    executions_per_plan: int = 1
    plans: int = 1000

    def config(self, algorithm: str) -> Config:
        """Return the task with a learner."""
        parameters = [
            {"key": p.key, "optimistic": p.optimistic, "conservative": p.conservative} for p in self.parameters
        ]
        learner = {
            "algorithm": algorithm, "parameters": parameters, "budget": self.budget, "delta": 0.02, "gap": 0.005,
            "executions_per_plan": self.executions_per_plan, "plans": self.plans, "judged": "result",
        }  # fmt: skip
        return task((*self.overrides, f"learning={json.dumps(learner)}"), self.path)

    @property
    def grid(self) -> list[Belief]:
        """Beliefs on a grid over the box of the parameters, evenly spaced as the learners see them."""
        places = np.linspace(0.0, 1.0, self.side)
        return [
            Belief(parameters=tuple((p.key, p.value(float(t))) for p, t in zip(self.parameters, point, strict=True)))
            for point in product(places, repeat=len(self.parameters))
        ]


def runs(problem: Problem, place: Bench) -> dict[str, LearningRecord]:
    """Return the run of every learner."""
    return {name: recorded(problem.config(name), f"{problem.name}-{name}", place) for name in LEARNERS}


def brute_force(problem: Problem, place: Bench) -> Found:
    """Return the fastest plan on the grid that succeeds as often in a row as the learners require."""
    config, times = problem.config(LEARNERS[0]), problem.executions_per_plan
    return fastest(config, problem.grid, [1.0], times, f"{problem.name}-grid", place)[0]


def columns(problems: Sequence[Problem]) -> tuple[Column, ...]:
    """Return the columns of the table of some problems."""
    keys = dict.fromkeys(p.key for problem in problems for p in problem.parameters)
    return (
        Column("problem", "parameters"),
        Column("learner", "learner"),
        Column("executions", "executions"),
        *(Column(key, key, ".4g") for key in keys),
        Column("duration", "time [s]", ".3f"),
        Column("lower_bound", "lower bound [s]", ".3f"),
        Column("gap", "gap [%]", ".1f"),
        Column("to_best", "executions to within 5 % of the fastest", "g"),
        Column("fastest", "fastest on the grid [s]", ".3f"),
        Column("slower", "slower than that [%]", ".1f"),
        Column("fresh", "100 fresh trials, successes [%]"),
    )


def line(problem: Problem, name: str, found: LearningRecord, quickest: Found) -> dict[str, Any]:
    """Return the line of a learner's run."""
    best = found.best
    if best is None:
        return {"problem": problem.name, "learner": name, "executions": found.executions}
    last, duration = found.rows[-1], best.duration
    return {
        **best.parameters,
        "problem": problem.name,
        "learner": name,
        "executions": found.executions,
        "duration": duration,
        "lower_bound": last.lower_bound,
        "gap": None if last.gap is None else 100 * last.gap,
        "to_best": _executions_to(found, 1.05 * quickest.duration),
        "fastest": quickest.duration,
        "slower": 100 * (duration / quickest.duration - 1),
        "fresh": success(best),
    }


def _executions_to(found: LearningRecord, duration: float) -> int | None:
    """Return the number of executions until a plan of at most this duration [s] succeeded."""
    done = 0
    for row in found.rows:
        done += row.executions
        if row.result == "success" and row.duration <= duration:
            return done
    return None
