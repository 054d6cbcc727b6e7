"""The paper's Figure 8 with our runs: the plane of two parameters after 5, 10, 20 and 40 executions.

python experiments/figure_8.py [--out results/tables]
"""

from __future__ import annotations

from dataclasses import replace
from math import log
from pathlib import Path

import numpy as np
from learned import Bench
from reproduce import run_alone
from several import LEARNERS, Problem, runs
from table_3 import WAITER
from table_4 import FRICTIONS

from robustopt.learning.cost_map import CostMap
from robustopt.learning.parameters import Parameter
from robustopt.plotting import style
from robustopt.plotting.plane import TICKS, Plane, plane_figure
from robustopt.runs.campaign import cost_of
from robustopt.runs.records import LearningRecord

AFTER = (5, 10, 20, 40)
SIDE = 33
HOPELESS = 10.0
"""Factor on the shortest duration from which interpolated durations stand for no plan."""


def write(out: Path, place: Bench) -> list[Path]:
    """Draw a figure for each task, from the runs of its table."""
    out.mkdir(parents=True, exist_ok=True)
    paths = []
    for name, table, problem in (("waiter", "table_3", WAITER), ("humanoid", "table_4", FRICTIONS)):
        found = runs(problem, replace(place, work=place.work.parent / table))
        durations = guide(problem)
        planes = [(learner, plane_of(problem, run, durations)) for learner, run in found.items()]
        after = [count for count in AFTER if count <= problem.budget]
        with style.house_style():
            paths += style.save(plane_figure(planes, after), out, f"figure_8_{name}")
    return paths


def guide(problem: Problem) -> np.ndarray:
    """Return f* on a square grid of the unit square, as the learners interpolate it, (SIDE, SIDE) [s]."""
    config = problem.config(LEARNERS[0])
    assert config.learning is not None
    costs = CostMap(problem.parameters, cost_of(config, config.learning), problem.plans)
    side = np.linspace(0.0, 1.0, SIDE)
    places = np.stack(np.meshgrid(side, side, indexing="ij"), axis=-1).reshape(-1, 2)
    durations = costs.guide(places).reshape(SIDE, SIDE)
    durations[durations > HOPELESS * durations.min()] = np.inf
    return durations


def plane_of(problem: Problem, run: LearningRecord, durations: np.ndarray) -> Plane:
    """Return the drawn part of a run; `durations` are from `guide`."""
    first, second = problem.parameters
    ticks = np.array([[parameter.value(t) for t in TICKS] for parameter in (first, second)])
    done = [row for row in run.rows if row.result in ("success", "failure")]
    points = np.array([[_place(p, row.parameters[p.key]) for p in (first, second)] for row in done]).reshape(-1, 2)
    succeeded = np.array([row.result == "success" for row in done], dtype=bool)
    labels = (_label(first.key), _label(second.key))
    return Plane(labels, ticks, durations, points, succeeded)


def _place(parameter: Parameter, value: float) -> float:
    """Return the coordinate of a value between the ends of its parameter, the inverse of `Parameter.value`."""
    a, b = parameter.optimistic, parameter.conservative
    return log(value / a) / log(b / a) if a * b > 0 else (value - a) / (b - a)


def _label(key: str) -> str:
    return key.removesuffix(".2").split(".", 1)[-1].replace("_", " ").replace(".", " ")


if __name__ == "__main__":
    run_alone("figure_8", write)
