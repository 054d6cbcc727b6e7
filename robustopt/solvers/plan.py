"""Plan: the result that all solvers share."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import Enum
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from robustopt.arrays import Array, Indices
from robustopt.compiled import compiled
from robustopt.config.margin import has_intervals
from robustopt.limits import TimeScalingProblem
from robustopt.views import view

if TYPE_CHECKING:
    from pathlib import Path as FilePath

    from matplotlib.figure import Figure
    from pandas import DataFrame


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

LOCAL_OPTIMUM = "Because jerk is limited, the plan is a local optimum."
"""Sentence for a solution with jerk limits, whose program is not convex."""


NONE_FOUND = "No timing of the path was found that satisfies the limits."
"""Sentence for the same program if speed and acceleration at an end of the path are given."""


def outcome(status: Status, problem: TimeScalingProblem, local: bool = False) -> str:
    """Return the outcome of a solver in words, which mention intervals if there are any.

    Args:
        status: the outcome.
        problem: the problem.
        local: whether the search was a local one.
    """
    sentence = {Status.SOLVED: LOCAL_OPTIMUM, Status.INFEASIBLE: NONE_FOUND}.get(status) if local else None
    sentence = sentence or status.sentence
    scoped = status in (Status.SOLVED, Status.INFEASIBLE) and has_intervals(problem.config)
    return f"{sentence.removesuffix('.')} for every value in the intervals." if scoped else sentence


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
        u: sdd at the start of each interval (P - 1,) [1/s^2], 0 on intervals without length; empty without a timing.
        change: change of sdd on each interval, at a constant rate in time (P - 1,) [1/s^2]; 0 without jerk limits.
        duration: sum over the intervals, and pauses [s]; infinite without a timing.
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
    change: Array
    duration: float
    problem: TimeScalingProblem = field(repr=False)
    statistics: Mapping[str, float]
    stuck: int = -1

    @cached_property
    def active(self) -> tuple[tuple[str, ...], ...]:
        """Return the names of the limits that bind at either end of each interval; empty without a timing."""
        return view("robustopt.solvers.binding.active", self) if self.status is Status.SOLVED else ()

    @property
    def steady(self) -> bool:
        """Return whether sdd is constant on each interval, as in plans without jerk limits."""
        return not self.change.any()

    @property
    def u_end(self) -> Array:
        """Return sdd at the end of each interval (P - 1,) [1/s^2]."""
        return self.u + self.change

    @cached_property
    def steps(self) -> Array:
        """Return the time of each interval (P - 1,) [s].

        On intervals without length it is that of the pause; it is infinite if the robot rests.
        """
        speed, ds = np.sqrt(self.x), self.problem.ds
        mean = 0.5 * (speed[:-1] + speed[1:])
        steps = self.problem.pauses.copy()
        moving = ds > 0.0
        steps[moving] = interval_times(ds[moving], mean[moving], self.change[moving])
        return steps

    def export(self, folder: FilePath | str, period: float | None = None) -> list[FilePath]:
        """Write the plan into a folder, in the formats of a run folder.

        Args:
            folder: made if it is missing; files in it are overwritten.
            period: of the samples [s]; by default `output.period` of the configuration.

        Returns:
            The files: `plan.csv` (at the grid points), `trajectory.csv` (every period), and `joint_trajectory.json`
            (every period, with jerk limits at the steps of the jerk, in the shape of a ROS
            `trajectory_msgs/JointTrajectory` message).

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


def interval_times(ds: Array, mean: Array, change: Array) -> Array:
    """Return the time of intervals on which sdd changes at a constant rate, ds = mean dt - change dt^2 / 12, (M,) [s].

    Args:
        ds: lengths (M,).
        mean: mean of the speeds sd at both ends (M,) [1/s].
        change: sdd at the end less sdd at the start (M,) [1/s^2].
    """
    return np.asarray(2.0 * ds / (mean + np.sqrt(np.maximum(mean**2 - change * ds / 3.0, 0.0))))


def interval_ends(plan: Plan) -> tuple[Array, Array, Indices]:
    """Return u, x and the grid point at both ends of every interval that has a length, (M,) each.

    If u changes on the intervals, the mean of each is there at both of its ends too.

    Args:
        plan: a plan with a timing.
    """
    moving = np.flatnonzero(plan.problem.ds > 0)
    points, u, u_end = np.r_[moving, moving + 1], plan.u[moving], plan.u_end[moving]
    if plan.steady:
        return np.r_[u, u], plan.x[points], points
    mean = 0.5 * (u + u_end)
    return np.r_[u, u_end, mean, mean], np.r_[plan.x[points], plan.x[points]], np.r_[points, points]


def grid_points(plan: Plan) -> tuple[Array, Array, Indices]:
    """Return u, x and the grid point at both ends of every interval that has a length, (M,) each, without means of u.

    If u is continuous, each grid point between two such intervals is there once.

    Args:
        plan: a plan with a timing.
    """
    if plan.steady:
        return interval_ends(plan)
    moving = plan.problem.ds > 0
    starts, lasts = np.flatnonzero(moving), np.flatnonzero(moving & ~np.append(moving[1:], False))
    points = np.r_[starts, lasts + 1]
    return np.r_[plan.u[starts], plan.u_end[lasts]], plan.x[points], points


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
        duration: duration without pauses [s].
        method: name of the solver.
        statistics: figures of the solution process by name.
    """
    change = np.zeros_like(u)
    for array in (x, u, change):
        array.flags.writeable = False
    message, duration = outcome(Status.SOLVED, problem), duration + float(problem.pauses.sum())
    return Plan(Status.SOLVED, message, method, problem.s, problem.piece, x, u, change, duration, problem, statistics)


def jerk_plan(problem: TimeScalingProblem, x: Array, sdd: Array, method: str, statistics: Mapping[str, float]) -> Plan:
    """Return the plan of a solution in which sdd changes at a constant rate on each interval.

    Args:
        problem: the problem.
        x: sd^2 (P,); becomes read-only.
        sdd: sdd at the grid points (P,).
        method: name of the solver.
        statistics: figures of the solution process by name.
    """
    moving = problem.ds > 0.0
    u, change = np.where(moving, sdd[:-1], 0.0), np.where(moving, np.diff(sdd), 0.0)
    for array in (x, u, change):
        array.flags.writeable = False
    message = outcome(Status.SOLVED, problem, local=True)
    plan = Plan(Status.SOLVED, message, method, problem.s, problem.piece, x, u, change, np.inf, problem, statistics)
    return replace(plan, duration=float(plan.steps.sum()))


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
    return Plan(status, message, method, problem.s, problem.piece, none, none, none, np.inf, problem, statistics, stuck)
