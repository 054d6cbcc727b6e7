"""How well the robot follows its plan: executed minus planned joint acceleration, as the learners need it.

The executed acceleration is the difference of the joint velocity over a time step, which is what the simulated arm
really did in that step; the planned one is that of the middle of the step. Their difference is low-passed without
phase shift, because a plan's acceleration jumps and contacts chatter: what is above the cut-off moves no object.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.signal import butter, filtfilt

from robustopt.execution.controller import Reference
from robustopt.execution.outcome import TrialOutcome

Array = np.ndarray
Values = tuple[float, ...]

CUTOFF = 50.0
"""Cut-off frequency of the low-pass, second order forwards and backwards [Hz]."""


@dataclass(frozen=True)
class Feedback:
    """Mean and deviation of the joint acceleration error over all trials and steps of the motion, (n,) [rad/s^2].

    mean, deviation: low-passed; unfiltered_mean, unfiltered_deviation: as it is; trials: number they are over
    """

    mean: Values
    deviation: Values
    unfiltered_mean: Values
    unfiltered_deviation: Values
    trials: int


def acceleration_error(velocity: Array, planned: Reference, timestep: float) -> tuple[Array, Array]:
    """Executed minus planned joint acceleration in every step, low-passed and unfiltered, (N, n) each.

    velocity: of the joints, before each step and after the last, (N + 1, n)
    """
    error = np.diff(velocity, axis=0) / timestep - planned.qdd
    cutoff = 2 * CUTOFF * timestep
    if cutoff >= 1 or len(error) <= 9:
        return error, error
    numerator, denominator = butter(2, cutoff)
    return np.asarray(filtfilt(numerator, denominator, error, axis=0)), error


def moments(error: Array) -> tuple[Values, Values]:
    """Mean and mean square of each column of (M, n)."""
    return tuple(error.mean(axis=0).tolist()), tuple((error**2).mean(axis=0).tolist())


def feedback_of(outcomes: Sequence[TrialOutcome]) -> Feedback | None:
    """The feedback of all trials whose simulation did not diverge; None where there is none."""
    sound = [outcome for outcome in outcomes if outcome.error_steps]
    if not sound:
        return None

    mean, deviation = _mean_and_deviation([o.error_mean for o in sound], [o.error_square for o in sound])
    unfiltered = _mean_and_deviation(
        [o.error_unfiltered_mean for o in sound], [o.error_unfiltered_square for o in sound]
    )
    return Feedback(mean, deviation, *unfiltered, trials=len(sound))


def _mean_and_deviation(means: list[Values], squares: list[Values]) -> tuple[Values, Values]:
    mean, square = np.mean(means, axis=0), np.mean(squares, axis=0)
    return tuple(mean.tolist()), tuple(np.sqrt(np.maximum(square - mean**2, 0.0)).tolist())
