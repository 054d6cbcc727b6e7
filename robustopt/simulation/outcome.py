"""Outcome of a trial: success, or the first failure with its time and place on the path."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum
from typing import NamedTuple

import numpy as np

from robustopt.arrays import Array, Flags
from robustopt.config import FailureConfig
from robustopt.evidence import Failure, Peak
from robustopt.simulation.controller import Reference
from robustopt.simulation.parameters import Parameters

AT_LIMIT = 1e-9
"""Relative distance from its limit within which a torque counts as at the limit: it gets there up to rounding."""


class Status(Enum):
    """The way a trial ended, with a sentence that explains it."""

    sentence: str

    def __new__(cls, value: str, sentence: str) -> Status:
        """Make a member with a sentence."""
        member = object.__new__(cls)
        member._value_, member.sentence = value, sentence
        return member

    SUCCESS = "success", "Every object stayed in its place, every standing foot and hand on a rail too."
    SLID = "slid", "An object slid further on its support than is allowed."
    SLIPPED = "slipped", "A standing foot slipped further on the floor than is allowed, or a hand on its rail."
    TIPPED = "tipped", "An object tipped further against its support than is allowed."
    FELL = "fell", "An object dropped further below its place than is allowed, or the robot itself fell."
    LOST_CONTACT = "lost contact", "An object rose off its support further than is allowed, or a hand off its rail."
    LOST_GRIP = "lost grip", "A suction cup or the fixed pad of a gripper opened further than is allowed."
    SLID_IN_GRIP = "slid in grip", "A held part slid further along its cups or pads than is allowed."
    TORQUE_SATURATED = "torque saturated", "A joint torque stayed at its limit for longer than is allowed."
    DIVERGED = "simulation diverged", "The simulation diverged; its results do not count as physics."


@dataclass(frozen=True)
class ObjectOutcome:
    """Outcome of an object, of a contact of the robot with its environment, or of the floating base.

    Attributes:
        status: first failure of this object, or success.
        time: time of that failure, 0 at the start of the motion; nan without one [s].
        slip: largest movement along its support, cup or pad [m].
        tilt: largest angle from its planned orientation [rad].
        drop: largest distance below its place [m].
        lift: largest distance of all of its base above the support, or of any point of a lip or fixed pad from the
            part [m].

    A movement that does not apply is nan.
    """

    status: Status
    time: float
    slip: float
    tilt: float
    drop: float
    lift: float


@dataclass(frozen=True)
class TrialOutcome:
    """Outcome of a trial, n coordinates.

    Attributes:
        trial: number of the trial.
        status: the first failure, or success.
        what: name of the object, contact or joint that failed first; empty if none failed.
        time: time of that failure, 0 at the start of the motion; nan without one [s].
        s: planned position along the path at that time; nan without a failure.
        against: supports or holder that it was in contact with; empty for a joint, the base or without a failure.
        objects: outcome by name of each object, environment contact and floating base.
        tracking_error: largest distance of a joint from its reference [rad or m].
        torque: largest joint torque as a fraction of its limit.
        friction: actual coefficient of friction by contact.
        mass: actual mass by body [kg].
        force: actual force of the vacuum or gripper by held object [N].
        error_steps: number of samples of the acceleration error: steps of the motion before the failure, 0 if the
            simulation diverged.
        error_mean: mean of the low-passed acceleration error (n,) [rad/s^2 or m/s^2]; empty without a sample.
        error_square: mean of its square (n,).
        error_unfiltered_mean: mean of the error before the low-pass (n,).
        error_unfiltered_square: mean of its square (n,).
        error_series: mean of the low-passed error in each of 32 equal parts of the motion, up to the last one that
            ended before the failure, (k, n).
    """

    trial: int
    status: Status
    what: str
    time: float
    s: float
    against: str
    objects: Mapping[str, ObjectOutcome]
    tracking_error: float
    torque: float
    friction: Mapping[str, float]
    mass: Mapping[str, float]
    force: Mapping[str, float] = field(default_factory=dict)
    error_steps: int = 0
    error_mean: tuple[float, ...] = field(default=(), repr=False)
    error_square: tuple[float, ...] = field(default=(), repr=False)
    error_unfiltered_mean: tuple[float, ...] = field(default=(), repr=False)
    error_unfiltered_square: tuple[float, ...] = field(default=(), repr=False)
    error_series: tuple[tuple[float, ...], ...] = field(default=(), repr=False)

    @property
    def success(self) -> bool:
        """Check whether the trial succeeded; a diverged simulation is no success."""
        return self.status is Status.SUCCESS

    @property
    def failure(self) -> Failure | None:
        """Return the first failure with its time and place, None without one."""
        if self.success:
            return None
        t, s = (None if np.isnan(value) else value for value in (self.time, self.s))
        return Failure(self.status.value, self.what, self.against, t, s)

    @property
    def peaks(self) -> tuple[Peak, ...]:
        """Return the largest movement of each object, environment contact and floating base."""
        return tuple(
            Peak(name, *(None if np.isnan(value) else value for value in (item.slip, item.tilt)))
            for name, item in self.objects.items()
        )


@dataclass(frozen=True)
class Motion:
    """Movement over time relative to the plan, (N,) each; the kinds of movement are those of `ObjectOutcome`."""

    slip: Array
    tilt: Array
    drop: Array
    lift: Array


class Criterion(NamedTuple):
    """A way to fail: a `kind` of movement, a field of `Motion`, exceeds its limit."""

    status: Status
    kind: str
    limit: float


def judge(
    trial: int, parameters: Parameters, failure: FailureConfig, planned: Reference, motions: Mapping[str, Motion],
    criteria: Mapping[str, Sequence[Criterion]], against: Mapping[str, str], torque: Mapping[str, Array],
    tracking_error: float,
) -> TrialOutcome:  # fmt: skip
    """Return the outcome of a trial that did not diverge.

    Args:
        trial: number of the trial.
        parameters: actual parameters.
        failure: criteria of failure.
        planned: reference of the controllers.
        motions: movement of each object, environment contact and floating base, by name.
        criteria: ways in which each of these fails, by name.
        against: what each of these is in contact with, by name.
        torque: torque of each joint as a fraction of its limit, by name (N,).
        tracking_error: largest distance of a joint from its reference [rad or m].
    """
    objects = {name: _judge_object(motion, criteria[name], planned.t) for name, motion in motions.items()}
    events = [(item.time, item.status, name) for name, item in objects.items() if item.status is not Status.SUCCESS]
    longest = round(failure.saturation / (planned.t[1] - planned.t[0]))
    for name, share in torque.items():
        step = _end_of_long_run(share >= 1 - AT_LIMIT, longest)
        if step is not None:
            events.append((float(planned.t[step]), Status.TORQUE_SATURATED, name))
    time, status, what = min(events, key=lambda event: event[0], default=(np.nan, Status.SUCCESS, ""))
    s = float(np.interp(time, planned.t, planned.s)) if what else np.nan
    largest = max(float(share.max()) for share in torque.values())
    return TrialOutcome(
        trial, status, what, time, s, against.get(what, ""), objects, float(tracking_error), largest,
        *_reported(parameters),
    )  # fmt: skip


def diverged(trial: int, parameters: Parameters, names: Sequence[str]) -> TrialOutcome:
    """Return the outcome of a trial whose simulation diverged.

    Args:
        trial: number of the trial.
        parameters: actual parameters.
        names: names of the objects, environment contacts and floating base.
    """
    lost = ObjectOutcome(Status.DIVERGED, *[float("nan")] * 5)
    return TrialOutcome(
        trial, Status.DIVERGED, "", np.nan, np.nan, "", dict.fromkeys(names, lost), np.nan, np.nan,
        *_reported(parameters),
    )  # fmt: skip


def _reported(actual: Parameters) -> tuple[dict[str, float], dict[str, float], dict[str, float]]:
    return dict(actual.friction), {name: body.mass for name, body in actual.bodies.items()}, dict(actual.force)


def _judge_object(motion: Motion, criteria: Sequence[Criterion], t: Array) -> ObjectOutcome:
    events = []
    for status, kind, limit in criteria:
        values = getattr(motion, kind)
        if values.max() > limit:
            events.append((int(np.argmax(values > limit)), status))
    step, status = min(events, key=lambda event: event[0], default=(-1, Status.SUCCESS))
    time = float(t[step]) if events else np.nan
    largest = (float(values.max()) for values in (motion.slip, motion.tilt, motion.drop, motion.lift))
    return ObjectOutcome(status, time, *largest)


def _end_of_long_run(flags: Flags, length: int) -> int | None:
    """Return the step at which a run of true values first exceeds a length; None without one."""
    count = 0
    for i in np.flatnonzero(flags):
        count = count + 1 if i > 0 and flags[i - 1] else 1
        if count > length:
            return int(i)
    return None
