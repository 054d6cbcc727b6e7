"""The tasks of tables 3 and 4 as problems in the unit cube: f* from a table of plans, success from MuJoCo.

Nothing is random in these worlds: an execution always has the same outcome, and is run once.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from learned import Bench
from scipy.interpolate import RegularGridInterpolator
from several import Problem
from table_3 import WAITER
from table_4 import FRICTIONS, WITH_ERROR

from robustopt.arrays import Array
from robustopt.config.load import dump
from robustopt.learning.learner import Belief
from robustopt.learning.parameters import values
from robustopt.runs.beliefs import Planner, learned_from
from robustopt.runs.executors import Simulated
from robustopt.solvers.batch import BatchPlanner

STILL = "execution.disturbance.force_deviation=[0, 0, 0]"

RESOLUTION = 0.002
"""Relative difference by which brute force improves on the best plan so far."""

FINE = 8
"""Number of columns of the second pass of brute force on either side of the best, within one step of the first."""

ALONG = 401
"""Number of points of a column among which the slowest improvement is taken."""


@dataclass(frozen=True)
class Task:
    """A task of table 3 or 4.

    Attributes:
        name: name of the task.
        words: the learned parameters in words.
        problem: the problem.
        nodes: number of nodes of the table of f* along each axis.
        columns: number of columns of brute force along each axis but the last.
        seeds: number of seeds of the random methods, and of the slow ones among them.
    """

    name: str
    words: str
    problem: Problem
    nodes: int
    columns: int
    seeds: tuple[int, int]

    @property
    def k(self) -> int:
        return len(self.problem.parameters)


TASKS = (
    Task(
        "waiter: friction, height",
        "the waiter's friction and the height of a centre of mass",
        replace(WAITER, overrides=(*WAITER.overrides, STILL), executions_per_plan=1),
        nodes=25, columns=33, seeds=(10, 2),
    ),
    Task(
        "humanoid: frictions", "the humanoid's frictions, one per foot", FRICTIONS,
        nodes=17, columns=33, seeds=(3, 1),
    ),
    Task(
        "humanoid: frictions, error",
        "these and the bound of the acceleration error, with an offset of a centre of mass that no parameter describes",
        WITH_ERROR, nodes=9, columns=13, seeds=(3, 1),
    ),
)  # fmt: skip


class RealProblem:
    """The world of a learner: `cost` for choosing a point, `execute` and `duration` for the chosen one."""

    def __init__(self, task: Task, place: Bench) -> None:
        config = task.problem.config("bnb-midpoint")  # the task is the same for all learners
        self._parameters = task.problem.parameters
        self._batch = BatchPlanner(learned_from(config, self._keys), place.workers)
        self._planner, self._executor = Planner(config, certified=False), Simulated(config)
        self._executed: dict[tuple[float, ...], tuple[bool, float]] = {}
        self._table = self._interpolation(task, place)

    @property
    def _keys(self) -> list[str]:
        return [parameter.key for parameter in self._parameters]

    @property
    def executions(self) -> int:
        """Number of different plans that were executed so far."""
        return len(self._executed)

    @property
    def longest(self) -> float:
        """Duration of the slowest plan of the table [s]: the plan of b, if there is one."""
        return float(np.exp(self._table.values[np.isfinite(self._table.values)].max()))

    def cost(self, points: Array) -> Array:
        """Return f* of points (m, k), (m,) [s], by interpolation of its logarithm; inf beside a node without a plan."""
        with np.errstate(invalid="ignore"):  # infinity times a weight of 0
            found = np.exp(self._table(np.atleast_2d(points)))
        return np.where(np.isfinite(found), found, np.inf)

    def exact(self, points: Array) -> Array:
        """Return the exact f* of points (m, k), (m,) [s]."""
        return self._batch.durations([dict(zip(self._keys, row, strict=True)) for row in self._values(points)])

    def execute(self, point: Array) -> bool:
        """Return whether the plan of a point succeeds; a point without a plan does not."""
        return self._outcome(point)[0]

    def duration(self, point: Array) -> float:
        """Return the duration of the plan of an executed point [s]."""
        return self._outcome(point)[1]

    def _outcome(self, point: Array) -> tuple[bool, float]:
        key = tuple(np.asarray(point).tolist())
        if key not in self._executed:
            belief = Belief(parameters=tuple(zip(self._keys, self._values(np.array([key]))[0], strict=True)))
            planned = self._planner.plan(belief)
            solved = bool(np.isfinite(planned.plan.duration))
            success = solved and self._executor.run(planned, [0], 1.0)[0].outcome.success
            self._executed[key] = success, planned.plan.duration
        return self._executed[key]

    def _values(self, points: Array) -> list[list[float]]:
        found: list[list[float]] = values(self._parameters, points).tolist()
        return found

    def _interpolation(self, task: Task, place: Bench) -> RegularGridInterpolator:
        """Return log f* over the unit cube; its nodes are kept in a file, because they take long."""
        axes = [np.linspace(0, 1, task.nodes)] * task.k
        digest = hashlib.sha256(dump(self._batch.config).encode()).hexdigest()[:12]
        file = place.work / f"{task.problem.name}-{task.nodes}-plans-{digest}.npy"
        if not file.exists():
            place.say(f"{task.name}: {task.nodes**task.k} plans")
            nodes = self.exact(np.array(list(product(*axes))))
            file.parent.mkdir(parents=True, exist_ok=True)
            partly = file.with_suffix(".partial.npy")
            np.save(partly, nodes)
            partly.rename(file)
        return RegularGridInterpolator(axes, np.log(np.load(file)).reshape((task.nodes,) * task.k))


def optimum(cost: Callable[[Array], Array], execute: Callable[[Array], bool], k: int, columns: int) -> Array:
    """Return the cheapest point that succeeds, (k,), by brute force over columns along the last parameter.

    In every column, the most conservative point that would be an improvement by `RESOLUTION` is executed. If it fails,
    so do all cheaper points of this column, which is the only use of monotony; otherwise the column is bisected. A
    second pass searches columns within a step of the best. It is assumed that the conservative corner succeeds.
    """
    step = 1 / (columns - 1)
    best = _swept(cost, execute, np.ones(k), np.zeros(k - 1), np.linspace(0, 1, columns))
    return _swept(cost, execute, best, best[:-1], step * np.arange(-FINE, FINE + 1) / FINE)


def _swept(
    cost: Callable[[Array], Array], execute: Callable[[Array], bool], best: Array, start: Array, offsets: Array
) -> Array:
    """Return the cheapest success of the columns at the start plus all offsets; `best` if none is better."""
    lines = start + np.array(list(product(offsets, repeat=len(start))))
    inside = lines[np.all((lines >= 0) & (lines <= 1), axis=1)]
    for line in np.random.default_rng(0).permutation(inside):
        best = _better(cost, execute, line, best)
    return best


def _better(cost: Callable[[Array], Array], execute: Callable[[Array], bool], line: Array, best: Array) -> Array:
    """Return the cheapest success of a column if it is cheaper than the best so far; otherwise the best so far."""
    along = np.linspace(0, 1, ALONG)
    costs = cost(np.column_stack([np.tile(line, (ALONG, 1)), along]))
    cheap = np.flatnonzero(costs * (1 + RESOLUTION) <= cost(best[None])[0])
    low, high = -1, cheap[-1] if len(cheap) else -1
    if high < 0 or not execute(np.append(line, along[high])):
        return best
    while high - low > 1 and costs[high] > costs[max(low, 0)] * (1 + RESOLUTION):
        middle = (low + high) // 2
        low, high = (low, middle) if execute(np.append(line, along[middle])) else (middle, high)
    return np.append(line, along[high])
