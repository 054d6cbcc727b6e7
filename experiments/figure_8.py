"""The paper's Figure 8 with our runs: the plane of two parameters after 5, 10, 20 and 40 executions.

python experiments/figure_8.py [--out results/tables]
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from learned import Bench
from reproduce import run_alone
from several import Problem, runs
from table_3 import WAITER
from table_4 import FRICTIONS

from robustopt.plotting import style
from robustopt.plotting.plane import TICKS, Plane, plane_figure
from robustopt.runs.campaign import Learned

AFTER = (5, 10, 20, 40)
SIDE = 33
HOPELESS = 10.0
"""Durations so many times the shortest stand for no plan in the interpolation of f*."""


def write(out: Path, place: Bench) -> list[Path]:
    """Draw a figure for each task, from the runs of its table."""
    out.mkdir(parents=True, exist_ok=True)
    paths = []
    for name, table, problem in (("waiter", "table_3", WAITER), ("humanoid", "table_4", FRICTIONS)):
        found = runs(problem, replace(place, work=place.work.parent / table))
        planes = [(learner, plane_of(problem, run)) for learner, run in found.items()]
        after = [count for count in AFTER if count <= problem.budget]
        with style.house_style():
            paths += style.save(plane_figure(planes, after), out, f"figure_8_{name}")
    return paths


def plane_of(problem: Problem, run: Learned) -> Plane:
    """What is drawn of a run."""
    first, second = problem.parameters
    ticks = np.array([[parameter.value(t) for t in TICKS] for parameter in (first, second)])
    side = np.linspace(0.0, 1.0, SIDE)
    places = np.stack(np.meshgrid(side, side, indexing="ij"), axis=-1).reshape(-1, 2)
    durations = run.learner.map.guide(places).reshape(SIDE, SIDE)
    durations[durations > HOPELESS * durations.min()] = np.inf
    done = [i for i, row in enumerate(run.rows) if row.result.value in ("success", "failure")]
    points = np.array([run.state.points[i] for i in done]).reshape(-1, 2)
    succeeded = np.array([run.rows[i].result.value == "success" for i in done], dtype=bool)
    labels = (_label(first.key), _label(second.key))
    return Plane(labels, ticks, durations, points, succeeded)


def _label(key: str) -> str:
    return key.removesuffix(".2").split(".", 1)[-1].replace("_", " ").replace(".", " ")


if __name__ == "__main__":
    run_alone("figure_8", write)
