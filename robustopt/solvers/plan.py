"""Plan: the result that all solvers share."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from robustopt.arrays import Array, Flags, Indices
from robustopt.compiled import compiled
from robustopt.config.margin import has_intervals
from robustopt.limits import TimeScalingProblem
from robustopt.limits.names import LimitName
from robustopt.views import view

if TYPE_CHECKING:
    from pathlib import Path as FilePath

    from matplotlib.figure import Figure
    from pandas import DataFrame

ACTIVE_TOLERANCE = 1e-4
"""Fraction of its limit within which a row binds; solver tolerances are a hundredth of it."""


class Status(Enum):
    """Outcome of a solver; `sentence` puts it in words."""

    SOLVED = "solved"
    INFEASIBLE = "infeasible"
    ITERATION_LIMIT = "iteration limit"
    FAILED = "failed"

    @property
    def sentence(self) -> str:
        """Return the outcome in words."""
        return _SENTENCES[self.value]


_SENTENCES = {
    "solved": "The plan is the optimum.",
    "infeasible": "No timing of the path satisfies the limits.",
    "iteration limit": "The solver reached its iteration limit before the optimum.",
    "failed": "The solver stopped without an answer.",
}


def outcome(status: Status, problem: TimeScalingProblem) -> str:
    """Return the outcome of a solver in words, which mention intervals if there are any.

    Args:
        status: the outcome.
        problem: the problem.
    """
    scoped = status in (Status.SOLVED, Status.INFEASIBLE) and has_intervals(problem.config)
    return f"{status.sentence.removesuffix('.')} for every value in the intervals." if scoped else status.sentence


@dataclass(frozen=True, eq=False)
class Plan:
    """A timing of a path, or the reason why there is none.

    Attributes:
        status: outcome of the solver.
        message: the outcome in words.
        method: name of the solver.
        s: grid points in [0, 1] (P,).
        piece: piece of the path that each grid point belongs to (P,).
        x: sd^2 at the grid points (P,) [1/s^2]; empty without a timing.
        u: sdd on each interval (P - 1,) [1/s^2], 0 on intervals without length; empty without a timing.
        duration: sum over the intervals [s]; infinite without a timing.
        problem: the problem with all rows that the solver has found.
        statistics: figures of the solution process by name.
        stuck: grid point at which no choice is left, -1 unless the problem is infeasible.
    """

    status: Status
    message: str
    method: str
    s: Array
    piece: Indices
    x: Array
    u: Array
    duration: float
    problem: TimeScalingProblem = field(repr=False)
    statistics: Mapping[str, float]
    stuck: int = -1

    @cached_property
    def active(self) -> tuple[tuple[str, ...], ...]:
        """Return the names of the limits that bind at either end of each interval; empty without a timing."""
        return _active(self.problem, self.x, self.u) if self.status is Status.SOLVED else ()

    def export(self, folder: FilePath | str, period: float | None = None) -> list[FilePath]:
        """Write the plan into a folder, in the formats of a run folder.

        Args:
            folder: made if it is missing; files in it are overwritten.
            period: of the samples [s]; by default `output.period` of the configuration.

        Returns:
            The files: `plan.csv` (at the grid points), `trajectory.csv` (every period), and `joint_trajectory.json`
            (every period, in the shape of a ROS `trajectory_msgs/JointTrajectory` message).

        Raises:
            Infeasible: the plan has no timing.
            ConfigError: the period is not positive, or too short.
        """
        return view("robustopt.exports.folder.write_folder", self, folder, period)

    def to_frame(self) -> DataFrame:
        """Return the plan at its grid points as a table: t, s, sd, sdd, q_<joint>, qd_<joint>, qdd_<joint>.

        Raises:
            Infeasible: the plan has no timing.
        """
        return view("robustopt.frames.plan_frame", self)

    def plot(self) -> Figure:
        """Return the phase plane: the speed sd over s, with its limits and the limits that bind."""
        return view("robustopt.plotting.views.plan_figure", self)

    def _repr_html_(self) -> str:
        return view("robustopt.frames.plan_html", self)


def duration_of(ds: Array, x: Array) -> float:
    """Return the duration, the sum of 2 ds / (sd_i + sd_{i+1}) [s]; infinite if the robot rests on an interval.

    Args:
        ds: interval lengths (P - 1,); intervals without length do not count.
        x: sd^2 (P,).
    """
    return float(timing(ds, x)[0])


def controls_of(ds: Array, x: Array) -> Array:
    """Return u from x_{i+1} = x_i + 2 ds u_i, (P - 1,); 0 on intervals without length.

    Args:
        ds: interval lengths (P - 1,).
        x: sd^2 (P,).
    """
    return np.asarray(timing(ds, x)[1])


@compiled(error_model="numpy")
def timing(ds, x):  # type: ignore[no-untyped-def]
    """Return the duration and the controls of a timing, as `duration_of` and `controls_of`.

    Args:
        ds: interval lengths (P - 1,).
        x: sd^2 (P,).

    Returns:
        Duration [s], and u (P - 1,).
    """
    duration, u = 0.0, np.zeros(len(ds))
    speed = np.sqrt(x[0]) if x[0] > 0.0 else 0.0
    for i in range(len(ds)):
        before, speed = speed, np.sqrt(x[i + 1]) if x[i + 1] > 0.0 else 0.0
        if ds[i] > 0.0:
            duration += 2.0 * ds[i] / (before + speed)
            u[i] = (x[i + 1] - x[i]) / (2.0 * ds[i])
    return duration, u


def interval_ends(problem: TimeScalingProblem, x: Array, u: Array) -> tuple[Array, Array, Indices]:
    """Return u, x and the grid point at both ends of every interval that has a length, (M,) each.

    Args:
        problem: the problem.
        x: sd^2 (P,).
        u: sdd on each interval (P - 1,).
    """
    moving = np.flatnonzero(problem.ds > 0)
    points = np.r_[moving, moving + 1]
    return np.r_[u[moving], u[moving]], x[points], points


def solved_plan(problem: TimeScalingProblem, x: Array, method: str, statistics: Mapping[str, float]) -> Plan:
    """Return the plan of a solution.

    Args:
        problem: the problem.
        x: sd^2 (P,); becomes read-only.
        method: name of the solver.
        statistics: figures of the solution process by name.
    """
    duration, u = timing(problem.ds, x)
    return timed_plan(problem, x, u, duration, method, statistics)


def timed_plan(
    problem: TimeScalingProblem, x: Array, u: Array, duration: float, method: str, statistics: Mapping[str, float]
) -> Plan:
    """Return the plan of a solution with known controls and duration; see `solved_plan`.

    Args:
        problem: the problem.
        x: sd^2 (P,); becomes read-only.
        u: sdd on each interval (P - 1,); becomes read-only.
        duration: duration [s].
        method: name of the solver.
        statistics: figures of the solution process by name.
    """
    for array in (x, u):
        array.flags.writeable = False
    message = outcome(Status.SOLVED, problem)
    return Plan(Status.SOLVED, message, method, problem.s, problem.piece, x, u, duration, problem, statistics)


def failed_plan(
    problem: TimeScalingProblem, status: Status, method: str, message: str, stuck: int, statistics: Mapping[str, float]
) -> Plan:
    """Return a plan without a timing.

    Args:
        problem: the problem.
        status: status of the plan.
        method: name of the solver.
        message: sentence that explains the status.
        stuck: grid point at which the solver stopped, -1 if there is none.
        statistics: figures of the solution process by name.
    """
    none = np.zeros(0)
    return Plan(status, message, method, problem.s, problem.piece, none, none, np.inf, problem, statistics, stuck)


def binding_rows(problem: TimeScalingProblem, x: Array, u: Array) -> Flags:
    """Return whether each row binds at either end of each interval, (P - 1, m).

    Args:
        problem: the problem.
        x: sd^2 (P,).
        u: sdd on each interval (P - 1,).
    """
    return np.asarray(_binding_ends(problem, x, u).any(axis=0))


def _binding_ends(problem: TimeScalingProblem, x: Array, u: Array) -> Flags:
    """Return whether each row binds at the start and at the end of each interval, (2, P - 1, m)."""
    at_start = problem.a[:-1] * u[:, None] + problem.b[:-1] * x[:-1, None] + problem.c[:-1] > -ACTIVE_TOLERANCE
    at_end = problem.a[1:] * u[:, None] + problem.b[1:] * x[1:, None] + problem.c[1:] > -ACTIVE_TOLERANCE
    return np.asarray(np.stack([at_start, at_end]) & (problem.ds > 0)[:, None])


def _active(problem: TimeScalingProblem, x: Array, u: Array) -> tuple[tuple[str, ...], ...]:
    """Return the names of the limits that bind at either end of each interval, in the order of the columns."""
    ends = _binding_ends(problem, x, u)
    tipping = _tipping(problem, x, u, ends)
    names: list[dict[str, None]] = [{} for _ in u]
    for i, k in np.argwhere(ends.any(axis=0)):
        name = problem.row_names[k]
        names[i][tipping.get((i, name), name)] = None
    fast = (x >= problem.x_max * (1 - ACTIVE_TOLERANCE)) & (problem.x_max > 0)
    for i in np.flatnonzero(problem.ds > 0):
        for k in (i, i + 1):
            if fast[k]:
                names[i][problem.x_max_names[k]] = None
    return tuple(tuple(row) for row in names)


def _tipping(problem: TimeScalingProblem, x: Array, u: Array, ends: Flags) -> dict[tuple[int, str], LimitName]:
    """Return the intervals and names of slip limits that are tipping or peeling, with the name of the latter.

    A body that tips over a corner of its patch may also turn about this corner, so rows that bound slip bind together
    with those of tipping, and any of them may have bounded (u, x). Friction does not matter then.

    Args:
        problem: the problem.
        x: sd^2 (P,).
        u: sdd on each interval (P - 1,).
        ends: whether each row binds at the start and at the end of each interval (2, P - 1, m).
    """
    found: dict[tuple[int, str], LimitName] = {}
    for limit in problem.limits.contacts:
        slip, *others = limit.names
        if not others or others[0] == slip:
            continue
        slips = np.asarray(ends[:, :, [name == slip for name in problem.row_names]].any(axis=2))
        free = slips.copy()
        for end in (0, 1):
            at = np.flatnonzero(slips[end])
            free[end, at] = ~limit.tips(u[at], x[at + end], at + end, ACTIVE_TOLERANCE)
        for i in np.flatnonzero(slips.any(axis=0) & ~free.any(axis=0)):
            found[int(i), slip] = others[0]
    return found
