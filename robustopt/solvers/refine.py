"""A grid that follows the path, refined where a plan loses time or violates limits between grid points.

On an interval u is constant and satisfies the rows at both ends. So the shortest duration on a grid exceeds the limit
of ever finer grids by a part that is proportional to the spacing. The plans of a grid and of the same grid with every
interval halved differ by half of it: the sum over the intervals of the absolute changes of their durations estimates
the loss of the halved grid, and each change says where it arises. The plan of the coarse grid at the middles of its
intervals also shows the violation between grid points, which shrinks with the square of the spacing because the grid
contains the kinks of the path. Both estimates are ours.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from robustopt.arrays import Array, Indices
from robustopt.config import Config
from robustopt.limits import TimeScalingProblem
from robustopt.limits.grid import Accuracy, Grid, first_grid
from robustopt.limits.track import Track
from robustopt.path import Path
from robustopt.solvers.plan import Plan, Status
from robustopt.solvers.solve import solve

MOST_ERROR = 9e-4
"""Largest estimated loss of a grid, as a part of the duration. The estimate was low by up to a tenth, and 0.1 % is
promised."""

MOST_VIOLATION = 5e-3
"""Largest estimated violation between grid points, as a share of the limit: half of what a certificate accepts."""

AIM = 0.9
"""The intervals are split for this part of the largest loss, so that one round is mostly enough."""

MOST_PARTS = 8
"""Largest number of parts of an interval in one round: the estimates do not reach further."""

PARTS_GROWTH = 1.01
"""Ratio of neighbouring numbers of parts that are tried."""

MOST_ROUNDS = 8
MOST_INTERVALS = 10_000
"""Bounds of the search: one plan of 10,000 intervals takes seconds by `reachability`, and minutes by `ipopt`."""

ENOUGH_IF_INFEASIBLE = 300
"""Number of intervals on which an infeasible problem is believed to be infeasible: a coarse grid can be the reason."""


def adapted_track(path: Path, problem_on: Callable[[Grid], TimeScalingProblem]) -> Track:
    """Return the track of a path on a grid that is fine enough.

    Args:
        path: the path.
        problem_on: function that returns the problem on a grid.
    """
    coarse = _shortest(problem_on(first_grid(path)))
    predicted = np.inf
    for rounds in range(1, MOST_ROUNDS + 1):
        grid = _grid(coarse)
        fine = _shortest(problem_on(grid.split(2)))
        if coarse.status is not Status.SOLVED or fine.status is not Status.SOLVED:
            if _grid(fine).intervals > ENOUGH_IF_INFEASIBLE:
                break
            coarse = fine
            continue
        change, excess = _changes(coarse, fine)
        loss = float(change.sum() / fine.duration)
        for plan, error, violation in ((coarse, 2.0 * loss, excess.max()), (fine, loss, excess.max() / 4.0)):
            if error <= MOST_ERROR and violation <= MOST_VIOLATION:
                return _with_accuracy(plan, Accuracy(error, float(violation), True))
        aim = AIM * min(1.0, predicted / loss) if loss > 0.0 else AIM
        parts = _parts(change, excess, aim * MOST_ERROR * fine.duration)
        if rounds == MOST_ROUNDS or (parts == 1).all():
            return _with_accuracy(fine, Accuracy(loss, float(excess.max() / 4.0), False))
        predicted = float((change / parts).sum() / fine.duration)
        coarse = _shortest(problem_on(grid.split(parts)))
    return _with_accuracy(fine, Accuracy(np.nan, np.nan, False))


def for_time(config: Config) -> Config:
    """Return a configuration with time as its cost, on which neither feasibility nor the grid depends.

    Args:
        config: the configuration.
    """
    return config.model_copy(update={"solver": config.solver.model_copy(update={"cost": "time", "weight": 0.0})})


def _shortest(problem: TimeScalingProblem) -> Plan:
    return solve(replace(problem, config=for_time(problem.config)), "reachability", jerk=False)


def _grid(plan: Plan) -> Grid:
    return plan.problem.limits.track.grid


def _with_accuracy(plan: Plan, accuracy: Accuracy) -> Track:
    track = plan.problem.limits.track
    return replace(track, grid=replace(track.grid, accuracy=accuracy))


def _changes(coarse: Plan, fine: Plan) -> tuple[Array, Array]:
    """Return the absolute change of the duration of each interval [s] and its violation in the middle, (P - 1,).

    Args:
        coarse: plan of a grid with P points.
        fine: plan of the same grid with every interval halved.
    """
    moving = coarse.problem.ds > 0
    first = np.concatenate([[0], np.cumsum(np.where(moving, 2, 1))])
    change = np.abs(_durations(coarse) - np.add.reduceat(_durations(fine), first[:-1]))
    middle, u = first[:-1][moving] + 1, coarse.u[moving, None]
    x = 0.5 * (coarse.x[:-1] + coarse.x[1:])[moving]
    rows = fine.problem
    beyond = (rows.a[middle] * u + rows.b[middle] * x[:, None] + rows.c[middle]).max(axis=1, initial=0.0)
    excess = np.zeros(len(moving))
    excess[moving] = np.maximum(beyond, np.sqrt(x / rows.x_max[middle]) - 1.0)
    return change, excess


def _durations(plan: Plan) -> Array:
    """Return the duration of each interval (P - 1,) [s]."""
    speed = np.sqrt(plan.x)
    both = speed[:-1] + speed[1:]
    return np.divide(2.0 * plan.problem.ds, both, out=np.zeros_like(both), where=plan.problem.ds > 0)


def _parts(change: Array, excess: Array, most: float) -> Indices:
    """Return the number of parts of each interval (P - 1,) after which the changes sum to at most `most` [s].

    The change of an interval of m parts is 1/m of its change now. So the fewest intervals have parts in proportion to
    the square roots of the changes. Violations shrink with m^2. If the grid became too long, there are fewer parts.
    """
    share = np.sqrt(change / max(float(change.max()), np.finfo(float).tiny))
    needed = np.ceil(np.sqrt(excess / (4.0 * MOST_VIOLATION)))
    parts, size = np.ones(len(change), dtype=np.intp), 1.0
    wanted = np.clip(needed, 1, MOST_PARTS).astype(np.intp)
    while 2 * wanted.sum() <= MOST_INTERVALS:
        parts = wanted
        if (change / parts).sum() <= most or (parts[change > 0] == MOST_PARTS).all():
            break
        size *= PARTS_GROWTH
        wanted = np.clip(np.maximum(needed, np.rint(size * share)), 1, MOST_PARTS).astype(np.intp)
    return parts
