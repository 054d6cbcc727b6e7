"""How well the robot follows its plan: executed minus planned joint acceleration, as the learners need it.

The executed acceleration is the difference of the joint velocity over a time step, which is what the simulated arm
really did in that step; the planned one is that of the middle of the step. Their difference is low-passed without
phase shift, because a plan's acceleration jumps and contacts chatter: what is above the cut-off moves no object.

Samples are the steps of the motion up to the first failure of the trial. What comes after it, an object on the floor or
against the arm, says nothing of how well the plan is followed; it is cut off before the low-pass.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import butter, filtfilt

from robustopt.simulation.controller import Reference
from robustopt.simulation.outcome import Status, TrialOutcome

Array = np.ndarray
Values = tuple[float, ...]

CUTOFF = 50.0
"""Cut-off frequency of the low-pass, second order forwards and backwards [Hz]."""


@dataclass(frozen=True)
class Feedback:
    """Mean and deviation of the joint acceleration error over the samples of all trials, (n,) [rad/s^2].

    mean, deviation: low-passed; unfiltered_mean, unfiltered_deviation: as it is; trials, samples: number of trials, and
    of steps of all of them together, that they are over
    """

    mean: Values
    deviation: Values
    unfiltered_mean: Values
    unfiltered_deviation: Values
    trials: int
    samples: int


def acceleration_error(velocity: Array, planned: Array, timestep: float) -> tuple[Array, Array]:
    """Executed minus planned joint acceleration in every step, low-passed and unfiltered, (N, n) each.

    velocity: of the joints, before each step and after the last, (N + 1, n); planned: acceleration in the middle of
    each step (N, n)
    """
    error = np.diff(velocity, axis=0) / timestep - planned
    return low_passed(error, timestep), error


def low_passed(values: Array, timestep: float) -> Array:
    """Values over time (N, ...) without what is above the cut-off; as they are where the steps are too long or few."""
    margin = round(1 / CUTOFF / timestep)
    if 2 * CUTOFF * timestep >= 1 or len(values) <= margin:
        return values
    numerator, denominator = butter(2, 2 * CUTOFF * timestep)
    # Mirrored at the ends: what is added by default, turned about the last sample, would leave that one unfiltered.
    return np.asarray(filtfilt(numerator, denominator, values, axis=0, padtype="even", padlen=margin))


def with_errors(outcome: TrialOutcome, velocity: Array, planned: Reference, timestep: float) -> TrialOutcome:
    """The outcome with the moments of its acceleration errors; without samples where the simulation diverged.

    velocity: of the joints, before each step and after the last, (N + 1, n)
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
    return replace(
        outcome, error_steps=int(moving.sum()), error_mean=mean, error_square=square,
        error_unfiltered_mean=raw_mean, error_unfiltered_square=raw_square,
    )  # fmt: skip


def feedback_of(outcomes: Sequence[TrialOutcome]) -> Feedback | None:
    """The feedback of all trials, every sample counting the same; None without a sample."""
    some = [outcome for outcome in outcomes if outcome.error_steps]
    if not some:
        return None
    steps = [o.error_steps for o in some]
    mean, deviation = _pooled(steps, [o.error_mean for o in some], [o.error_square for o in some])
    unfiltered = _pooled(steps, [o.error_unfiltered_mean for o in some], [o.error_unfiltered_square for o in some])
    return Feedback(mean, deviation, *unfiltered, trials=len(some), samples=sum(steps))


def _moments(error: Array) -> tuple[Values, Values]:
    """Mean and mean square of each column of (M, n)."""
    return tuple(error.mean(axis=0).tolist()), tuple((error**2).mean(axis=0).tolist())


def _pooled(steps: list[int], means: list[Values], squares: list[Values]) -> tuple[Values, Values]:
    """Mean and deviation of the samples of trials, from number, mean and mean square of each trial's."""
    mean, square = (np.average(values, axis=0, weights=steps) for values in (means, squares))
    return tuple(mean.tolist()), tuple(np.sqrt(np.maximum(square - mean**2, 0.0)).tolist())
