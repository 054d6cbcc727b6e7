"""Motions of a plan at points in time: on whole control cycles, or where the jerk steps.

On whole cycles a plan is slowed down uniformly, never cut. With k = n h / T, the smallest factor of at least 1 for
which the duration T of the plan becomes a multiple of the period h, the motion is q(t / k): velocities are divided by k
and accelerations by k^2.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from robustopt.arrays import Array
from robustopt.solvers import Plan
from robustopt.solvers.trajectory import Samples, Trajectory, require_period

ROUNDING = 1e-9
"""Part of a period by which a plan may be longer than a number of periods and count as equal: a rounding error."""

TICK = 1e-9
"""Resolution of the times of messages [s]."""

AT_REST = 1e-9
"""Largest row c of a problem, a fraction of its limit, at which standing still is allowed: a rounding error."""


@dataclass(frozen=True)
class Motion:
    """A plan sampled at every control cycle, or where its jerk steps.

    Attributes:
        name: name of the task.
        joint_names: names of the joints (n,).
        period: time between samples, where the jerk steps the longest one [s].
        planned: duration of the plan [s].
        factor: factor k >= 1 by which the motion takes longer than the plan.
        samples: states at 0, period, 2 period, ... up to the end, or where the jerk steps.
        at_jerk_steps: whether there is a sample at every step of the jerk.
        rests: whether the robot can stand still everywhere on the path, so that all slower motions are feasible too.
        moving: ends at which the robot moves, `start` and `end`; () if it begins and ends at rest.
    """

    name: str
    joint_names: tuple[str, ...]
    period: float
    planned: float
    factor: float
    samples: Samples
    at_jerk_steps: bool
    rests: bool
    moving: tuple[str, ...]

    @property
    def duration(self) -> float:
        """Return the duration of the motion [s]."""
        return float(self.samples.t[-1])

    @property
    def notes(self) -> tuple[str, ...]:
        """Return the difference from the plan in words; () without one."""
        if self.factor == 1.0:
            return ()
        slower = f"slowed down uniformly by {100 * (self.factor - 1):.3g} %, from {self.planned:.6g} s"
        end = f"to {self.duration:.6g} s, so that it ends on a whole period"
        if len(self.samples.t) == 2:
            end = f"to {self.duration:.6g} s: it is shorter than one period, so only its start and its end are left"
        notes = [f"the motion is {slower} {end}"]
        if self.moving:
            notes.append(
                f"its speed at the {' and at the '.join(self.moving)} is lower by as much; a period of which "
                f"{self.planned:.6g} s is a multiple keeps it"
            )
        if not self.rests:
            notes.append(
                "the robot cannot stand still everywhere on this path, so the certificate of the plan does not cover "
                f"the slower motion; a period of which {self.planned:.6g} s is a multiple needs none"
            )
        return tuple(notes)


def whole_cycles(plan: Plan, period: float) -> Motion:
    """Return a plan at every control cycle, slowed down so that it ends on one.

    Args:
        plan: a plan with a timing.
        period: time between samples [s].

    Raises:
        Infeasible: the plan has no timing.
        ConfigError: the period is not positive and finite, or too short for the duration.
    """
    planned = Trajectory.from_plan(plan).duration
    require_period(planned, period)
    cycles = max(int(np.ceil(planned / period - ROUNDING)), 1)
    factor = cycles * period / planned
    if factor <= 1.0 + ROUNDING / cycles:
        factor = 1.0
    trajectory = Trajectory.from_plan(plan, 1.0 / factor)
    t: Array = period * np.arange(cycles + 1, dtype=float)
    samples = trajectory.sample(np.append(t[:-1], trajectory.duration))  # rounding must not move the end outside
    return _motion(plan, period, factor, replace(samples, t=t))


def at_jerk_steps(plan: Plan, longest: float) -> Motion:
    """Return a plan at its grid points, where its jerk steps, and at equal times in between.

    The jerk is smooth between such points, and a polynomial of fifth degree follows it closely; see `quintics`.

    Args:
        plan: a plan with jerk limits and a timing.
        longest: longest time between samples [s].

    Raises:
        Infeasible: the plan has no timing.
        ConfigError: the longest time is not positive and finite, or too short for the duration.
    """
    trajectory = Trajectory.from_plan(plan)
    require_period(trajectory.duration, longest)
    times = np.unique(trajectory.times)
    parts = np.maximum(np.ceil(np.diff(times) / longest - ROUNDING).astype(int), 1)
    place = np.append(0, np.cumsum(parts))
    t: Array = np.interp(np.arange(place[-1] + 1), place, times)
    # states at rounded times: in a step of 1 ms, half a nanosecond makes a jerk of 30 times the speed in SI units
    t = TICK * np.unique(np.round(t / TICK))
    samples = trajectory.sample(np.minimum(t, trajectory.duration))
    return _motion(plan, longest, 1.0, replace(samples, t=t), at_jerk_steps=True)


def _motion(plan: Plan, period: float, factor: float, samples: Samples, at_jerk_steps: bool = False) -> Motion:
    problem = plan.problem
    return Motion(
        problem.config.name,
        problem.robot.joint_names,
        period,
        Trajectory.from_plan(plan).duration,
        factor,
        samples,
        at_jerk_steps,
        rests=bool(problem.c.max(initial=0.0) <= AT_REST),
        moving=problem.path.moving_ends,
    )
