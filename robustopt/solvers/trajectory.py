"""Timed trajectory of a plan: sampling in closed form, and the share of time in which each limit binds.

On each interval of the grid sdd changes at a constant rate sddd_i, 0 without jerk limits, so with tau = t - t_i

    s(t) = s_i + sd_i tau + u_i tau^2 / 2 + sddd_i tau^3 / 6,    sd(t) = sd_i + u_i tau + sddd_i tau^2 / 2,

and q = q(s), qd = q' sd, qdd = q' sdd + q'' sd^2, without numerical integration.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from robustopt.errors import ConfigError, Infeasible, SolverFailed

if TYPE_CHECKING:
    from robustopt.path import Path
    from robustopt.solvers.plan import Plan

Array = NDArray[np.float64]

NO_LIMIT = "no limit"
"""Name under which `binding_shares` counts the time in which no limit binds."""

PAUSE = "pause"
"""Name under which it counts the time of pauses."""

ZERO_LENGTH = 1e-13
"""An interval of s shorter than this is a stop, a doubled grid point: s lies in [0, 1], so two equal numbers differ by
less after rounding (our choice)."""

MERGE = 1e-3
"""A last partial period shorter than this fraction of a period is merged into the one before it: a multiple of the
period that misses the end by rounding must not become two samples at the same time (our choice)."""

MOST_SAMPLES = 1_000_000
"""Largest number of samples; more indicate a mistake in the period (our choice)."""


@dataclass(frozen=True)
class Samples:
    """States of a robot with n joints at T times.

    Attributes:
        t: time from the start, shape (T,), [s].
        s, sd, sdd: position, speed and acceleration along the path, shape (T,), [1], [1/s], [1/s^2].
        q, qd, qdd: joint position, velocity and acceleration, shape (T, n), [rad or m], [rad/s or m/s], [rad/s^2 or
            m/s^2].
    """

    t: Array
    s: Array
    sd: Array
    sdd: Array
    q: Array
    qd: Array
    qdd: Array


@dataclass(frozen=True)
class Trajectory:
    """A plan as a function of time.

    Attributes:
        times: time at each grid point, shape (P,), [s]; a stop (a doubled grid point) has the same time twice unless
            the robot pauses there.
        s, sd: position and speed along the path at each grid point, shape (P,), [1], [1/s].
        sdd: acceleration at the start of each interval, shape (P-1,), [1/s^2]; 0 on an interval of zero length.
        sddd: constant rate of sdd on each interval, shape (P-1,), [1/s^3]; 0 without jerk limits.
        piece: piece of the path that each grid point belongs to, shape (P,).
        path: the geometric path q(s).
    """

    times: Array
    s: Array
    sd: Array
    sdd: Array
    sddd: Array
    piece: NDArray[np.intp]
    path: Path

    @classmethod
    def from_plan(cls, plan: Plan, speed: float = 1.0) -> Trajectory:
        """Make the trajectory of a plan that is executed `speed` times as fast: s_run(t) = s_plan(speed t).

        Args:
            plan: a plan with a timing.
            speed: factor on sd; sdd and the joint accelerations grow with its square.

        Raises:
            Infeasible: the plan is empty.
            SolverFailed: the plan rests at both ends of an interval that has a length, so it never ends.
            ConfigError: `speed` is not positive and finite.
        """
        _require_positive("speed", speed)
        if plan.x.size == 0:
            raise Infeasible(f"There is no trajectory: {plan.message}")
        s = np.asarray(plan.s, dtype=float)
        sd = speed * np.sqrt(np.maximum(plan.x, 0.0))
        if plan.steady:
            steps = interval_durations(s, sd)
            sdd, sddd = np.divide(np.diff(sd), steps, out=np.zeros_like(steps), where=steps > 0), np.zeros_like(steps)
            steps = steps + plan.problem.pauses / speed
        else:
            steps, sdd = plan.steps / speed, plan.u * speed**2
            sddd = np.divide(plan.change * speed**2, steps, out=np.zeros_like(steps), where=steps > 0)
        times = np.concatenate([[0.0], np.cumsum(steps)])
        arrays = (times, s.copy(), sd, sdd, sddd, np.array(plan.piece, dtype=np.intp))
        for array in arrays:
            array.flags.writeable = False
        return cls(*arrays, plan.problem.path)

    @property
    def duration(self) -> float:
        """Return the time from start to end [s]."""
        return float(self.times[-1])

    def sample(self, t: Array | float) -> Samples:
        """Return the states at times t, exact for sdd that is constant or changes at a constant rate on each interval.

        At a jump of sdd the later value holds; at the end, the last one. Before the start and after the end, the first
        and the last position hold with sd = sdd = 0.

        Args:
            t: times from the start, shape (T,) or one number, [s].
        """
        t = np.atleast_1d(np.asarray(t, dtype=float))
        last = int(np.flatnonzero(np.diff(self.times))[-1])
        i = np.clip(np.searchsorted(self.times, t, side="right") - 1, 0, last)
        tau = np.clip(t, 0.0, self.duration) - self.times[i]
        step = self.times[i + 1] - self.times[i]
        part, sddd = tau / step, self.sddd[i]
        sd = (1.0 - part) * self.sd[i] + part * self.sd[i + 1] - 0.5 * sddd * tau * (step - tau)
        s = self.s[i] + 0.5 * (self.sd[i] + sd) * tau - sddd * tau**3 / 12.0
        s = np.clip(s, self.s[i], self.s[i + 1])
        inside = (t >= 0.0) & (t <= self.duration)
        sd = np.where(inside, sd, 0.0)
        sdd = np.where(inside, self.sdd[i] + sddd * tau, 0.0)
        return joint_motion(self.path, self.piece[i], t, s, sd, sdd)

    def at_gridpoints(self) -> Samples:
        """Return the states at the grid points, shape (P,), with sdd of the following interval.

        Before a stop, and at the end, sdd belongs to the interval before: the two copies of a stop's grid point have
        the same time and position, the first one the braking and the second one the starting acceleration.
        """
        following = np.append(self.sdd, 0.0)
        before = np.insert(self.sdd + self.sddd * np.diff(self.times), 0, 0.0)
        moves = np.append(np.diff(self.s) > ZERO_LENGTH, False)
        sdd = np.where(moves, following, before)
        return joint_motion(self.path, self.piece, self.times, self.s, self.sd, sdd)

    def every(self, period: float) -> Samples:
        """Return the states at t = 0, period, 2 period, ... and at the end; see `sample_times`.

        Args:
            period: the period [s].

        Raises:
            ConfigError: the period is not positive and finite, or too short for the duration.
        """
        return self.sample(sample_times(self.duration, period))


def joint_motion(path: Path, piece: NDArray[np.intp], t: Array, s: Array, sd: Array, sdd: Array) -> Samples:
    """Return the joint states q = q(s), qd = q' sd, qdd = q' sdd + q'' sd^2.

    Args:
        path: the geometric path.
        piece: piece of the path (T,).
        t: time (T,) [s].
        s: position along the path (T,).
        sd: speed along the path (T,) [1/s].
        sdd: acceleration along the path (T,) [1/s^2].
    """
    q, q1, q2 = (path.evaluate(s, piece, order=order) for order in range(3))
    return Samples(t, s, sd, sdd, q, q1 * sd[:, None], q1 * sdd[:, None] + q2 * (sd**2)[:, None])


def interval_durations(s: Array, sd: Array) -> Array:
    """Return the time of each interval, 2 ds / (sd_i + sd_{i+1}), (P - 1,) [s]; 0 at a stop.

    Args:
        s: position along the path at the grid points (P,).
        sd: speed along the path at the grid points (P,) [1/s].

    Raises:
        SolverFailed: an interval with a length has no speed at both ends.
    """
    ds = np.diff(s)
    speed = sd[:-1] + sd[1:]
    moves = ds > ZERO_LENGTH
    stuck = np.flatnonzero(moves & (speed == 0))
    if stuck.size:
        rest, never = s[stuck[0]], s[stuck[0] + 1]
        raise SolverFailed(
            f"The plan rests at s = {rest:.6g} and at s = {never:.6g}, and never gets from one to the other."
        )
    return np.divide(2.0 * ds, speed, out=np.zeros_like(ds), where=moves)


def sample_times(duration: float, period: float) -> Array:
    """Return the times 0, period, 2 period, ... and the duration itself, shape (T,), [s].

    The last sample is exactly at the end, so the last step is shorter than a period if the duration is no multiple of
    it. A last step shorter than `MERGE` periods is merged into the one before, which is then longer by as much.

    Args:
        duration: duration of the trajectory [s].
        period: time between samples [s].

    Raises:
        ConfigError: the period is not positive and finite, or so short that there are more than `MOST_SAMPLES`.
    """
    require_period(duration, period)
    full_steps = max(int(np.ceil(duration / period - MERGE)), 1)
    return np.append(np.arange(full_steps) * period, duration)


def require_period(duration: float, period: float) -> None:
    """Check the period of samples.

    Args:
        duration: duration of the trajectory [s].
        period: time between samples [s].

    Raises:
        ConfigError: the period is not positive and finite, or so short that there are more than `MOST_SAMPLES`.
    """
    _require_positive("period", period)
    if duration > MOST_SAMPLES * period:
        raise ConfigError(
            f"found {period!r} s, which gives more than {MOST_SAMPLES:,} samples; expected a longer period",
            key="period",
        )


def binding_shares(plan: Plan) -> dict[str, float]:
    """Return the share of the duration in which each limit binds, by name, largest first; the shares sum to 1.

    Limits that bind on the same interval share its time equally; time in which none binds counts as `NO_LIMIT`, and
    pauses as `PAUSE`. Equal shares are in alphabetical order.

    Args:
        plan: a plan with a timing.

    Raises:
        Infeasible: the plan is empty.
    """
    times: dict[str, float] = {}
    steps, pauses = np.diff(Trajectory.from_plan(plan).times), plan.problem.pauses > 0.0
    for step, pauses_here, names in zip(steps.tolist(), pauses.tolist(), plan.active, strict=True):
        for name in (PAUSE,) if pauses_here else names or (NO_LIMIT,):
            if step > 0:
                times[name] = times.get(name, 0.0) + step / max(len(names), 1)
    total = sum(times.values())
    return {name: time / total for name, time in sorted(times.items(), key=lambda item: (-item[1], item[0]))}


def _require_positive(name: str, value: float) -> None:
    if not (np.isfinite(value) and value > 0):
        raise ConfigError(f"found {value!r}; expected a number above 0", key=name)
