"""Acceleration error: executed minus planned joint acceleration, as the learners use it.

The executed acceleration is the difference of the simulated joint velocity over a time step; the planned one is that in
the middle of the step. Their difference passes a low-pass without phase shift, because the acceleration of a plan
jumps and contacts chatter: content above the cut-off moves no object (our choice).

Samples are the steps of the motion up to the first failure of the trial. Later steps, with an object on the floor or
against the arm, do not show how well the robot follows the plan; they are removed before the low-pass.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import butter, filtfilt

from robustopt.arrays import Array
from robustopt.simulation.controller import Reference
from robustopt.simulation.outcome import Status, TrialOutcome

Values = tuple[float, ...]

PARTS = 32
"""Number of equal parts of the motion over each of which the reported series has the mean error."""

DIGITS = 4
"""Significant digits of that series: an execution of six joints takes about 1.5 kB of a journal."""

CUTOFF = 50.0
"""Cut-off frequency of the low-pass, second order forwards and backwards [Hz]."""


@dataclass(frozen=True)
class Feedback:
    """Acceleration error over all trials of a plan, n coordinates.

    Attributes:
        mean: mean of the low-passed error (n,) [rad/s^2 or m/s^2].
        deviation: its standard deviation (n,).
        unfiltered_mean: mean of the error before the low-pass (n,).
        unfiltered_deviation: its standard deviation (n,).
        trials: number of trials with a sample.
        samples: number of time steps of all of them together.
    """

    mean: Values
    deviation: Values
    unfiltered_mean: Values
    unfiltered_deviation: Values
    trials: int
    samples: int


def acceleration_error(velocity: Array, planned: Array, timestep: float) -> tuple[Array, Array]:
    """Return executed minus planned acceleration in every step, low-passed and unfiltered, (N, n) each.

    Args:
        velocity: velocity of the coordinates before each step and after the last (N + 1, n).
        planned: acceleration in the middle of each step (N, n).
        timestep: time step [s].
    """
    error = np.diff(velocity, axis=0) / timestep - planned
    return low_passed(error, timestep), error


def low_passed(values: Array, timestep: float) -> Array:
    """Return values over time after the low-pass, or unchanged if the time steps are too long or too few, (N, ...).

    Args:
        values: values over time (N, ...).
        timestep: time step [s].
    """
    margin = round(1 / CUTOFF / timestep)
    if 2 * CUTOFF * timestep >= 1 or len(values) <= margin:
        return values
    numerator, denominator = butter(2, 2 * CUTOFF * timestep)
    # Mirrored at the ends: the default, an extension turned about the last sample, would leave that one unfiltered.
    return np.asarray(filtfilt(numerator, denominator, values, axis=0, padtype="even", padlen=margin))


def with_errors(outcome: TrialOutcome, velocity: Array, planned: Reference, timestep: float) -> TrialOutcome:
    """Return the outcome with the moments of its acceleration errors, unchanged if the simulation diverged.

    Args:
        outcome: outcome of the trial.
        velocity: velocity of the coordinates before each step and after the last (N + 1, n).
        planned: reference of the controllers.
        timestep: time step [s].
    """
    if outcome.status is Status.DIVERGED:
        return outcome
    end = int(np.searchsorted(planned.t, outcome.time)) if outcome.what else len(planned.t)
    moving = planned.moving[:end]
    if not moving.any():
        return outcome
    filtered, raw = acceleration_error(velocity[: end + 1], planned.qdd[:end], timestep)
    mean, square = _moments(filtered[moving])
    raw_mean, raw_square = _moments(raw[moving])
    series = means_of_parts(filtered[moving], (np.arange(moving.sum()) + 0.5) / planned.moving.sum())
    return replace(
        outcome, error_steps=int(moving.sum()), error_mean=mean, error_square=square,
        error_unfiltered_mean=raw_mean, error_unfiltered_square=raw_square, error_series=series,
    )  # fmt: skip


def feedback_of(outcomes: Sequence[TrialOutcome]) -> Feedback | None:
    """Return the acceleration error over all trials, each sample with the same weight; None without a sample.

    Args:
        outcomes: outcomes of the trials.
    """
    some = [outcome for outcome in outcomes if outcome.error_steps]
    if not some:
        return None
    steps = [o.error_steps for o in some]
    mean, deviation = _pooled(steps, [o.error_mean for o in some], [o.error_square for o in some])
    unfiltered = _pooled(steps, [o.error_unfiltered_mean for o in some], [o.error_unfiltered_square for o in some])
    return Feedback(mean, deviation, *unfiltered, trials=len(some), samples=sum(steps))


def means_of_parts(error: Array, share: Array) -> tuple[Values, ...]:
    """Return the mean error in each of the equal parts of a motion that has a sample, without the last one if cut off.

    Args:
        error: errors of some samples (M, n).
        share: time of each sample as a share of the duration of the motion, rising (M,).
    """
    part = np.floor(PARTS * share).astype(int)
    step = (share[-1] - share[0]) / max(len(share) - 1, 1)
    whole = part < np.floor(PARTS * (share[-1] + step))
    return tuple(
        tuple(float(f"{value:.{DIGITS}g}") for value in error[part == k].mean(axis=0).tolist())
        for k in np.unique(part[whole])
    )


def _moments(error: Array) -> tuple[Values, Values]:
    """Return mean and mean square of each column of (M, n)."""
    return tuple(error.mean(axis=0).tolist()), tuple((error**2).mean(axis=0).tolist())


def _pooled(steps: list[int], means: list[Values], squares: list[Values]) -> tuple[Values, Values]:
    """Return mean and deviation of the samples of trials, from number, mean and mean square of each trial."""
    mean, square = (np.average(values, axis=0, weights=steps) for values in (means, squares))
    return tuple(mean.tolist()), tuple(np.sqrt(np.maximum(square - mean**2, 0.0)).tolist())
