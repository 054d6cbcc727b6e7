"""What became of a trial: success, or what failed first, when, and where on the path."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from robustopt.config import FailureConfig
from robustopt.simulation.controller import Reference
from robustopt.simulation.truth import World

if TYPE_CHECKING:
    from robustopt.simulation.scene import Interface

Array = np.ndarray

AT_LIMIT = 1e-9
"""A torque within this part of its limit is at it: the limit is reached exactly, but for rounding."""


class Status(Enum):
    """How a trial ended; `sentence` says it to people."""

    SUCCESS = "success"
    SLID = "slid"
    SLIPPED = "slipped"
    TIPPED = "tipped"
    FELL = "fell"
    LOST_CONTACT = "lost contact"
    TORQUE_SATURATED = "torque saturated"
    DIVERGED = "simulation diverged"

    @property
    def sentence(self) -> str:
        return {
            Status.SUCCESS: "Every object stayed in its place, every standing foot and hand on a rail too.",
            Status.SLID: "An object slid further on its support than is allowed.",
            Status.SLIPPED: "A standing foot slipped further on the floor than is allowed, or a hand on its rail.",
            Status.TIPPED: "An object tipped further against its support than is allowed.",
            Status.FELL: "An object dropped further below its place than is allowed, or the robot itself fell.",
            Status.LOST_CONTACT: "An object rose off its support further than is allowed, or a hand off its rail.",
            Status.TORQUE_SATURATED: "A joint torque stayed at its limit for longer than is allowed.",
            Status.DIVERGED: "The simulation diverged; what it showed is not counted as physics.",
        }[self]


@dataclass(frozen=True)
class ObjectOutcome:
    """What became of an object: how it failed first, or success, when (t = 0: start of the motion; nan: never) [s],
    and the largest slip [m], tilt [rad], drop [m] and lift [m] against what it stands on; nan for what does not count.

    Of a robot on its feet the objects are its contacts and the trunk.
    """

    status: Status
    time: float
    slip: float
    tilt: float
    drop: float
    lift: float


@dataclass(frozen=True)
class TrialOutcome:
    """What became of a trial.

    status: the first failure in time, or success; what: the object or joint that failed, else empty; time [s] and s:
    of that failure, nan without one; objects: by name; tracking_error: largest distance of a joint from its
    reference [rad or m]; torque: largest part of a joint's limit; friction, mass: true values of the trial, by name;
    error_steps: number of samples of the acceleration error, the steps of the motion up to that failure, 0 where the
    simulation diverged; error_mean, error_square, error_unfiltered_mean, error_unfiltered_square: mean and mean square
    of the samples of each joint (see `feedback`) (n,) [rad/s^2], [(rad/s^2)^2], empty without a sample
    """

    trial: int
    status: Status
    what: str
    time: float
    s: float
    objects: Mapping[str, ObjectOutcome]
    tracking_error: float
    torque: float
    friction: Mapping[str, float]
    mass: Mapping[str, float]
    error_steps: int = 0
    error_mean: tuple[float, ...] = field(default=(), repr=False)
    error_square: tuple[float, ...] = field(default=(), repr=False)
    error_unfiltered_mean: tuple[float, ...] = field(default=(), repr=False)
    error_unfiltered_square: tuple[float, ...] = field(default=(), repr=False)

    @property
    def success(self) -> bool:
        return self.status is Status.SUCCESS


@dataclass(frozen=True)
class Motion:
    """Movement of an object against one support over time, (N,) each: slip [m], tilt [rad], drop [m], lift [m]."""

    slip: Array
    tilt: Array
    drop: Array
    lift: Array


class Criterion(NamedTuple):
    """How something fails: its `kind` of movement, a field of `Motion`, exceeds the limit."""

    status: Status
    kind: str
    limit: float


def object_criteria(failure: FailureConfig) -> tuple[Criterion, ...]:
    """How an object on the tray fails; where several happen in the same step, the first of these counts."""
    return (
        Criterion(Status.FELL, "drop", failure.drop), Criterion(Status.TIPPED, "tilt", failure.tilt),
        Criterion(Status.LOST_CONTACT, "lift", failure.lift), Criterion(Status.SLID, "slip", failure.slip),
    )  # fmt: skip


def object_motion(interface: Interface, sensors: Array) -> Motion:
    """Movement at an interface from a trial's sensor data (N, .): position and quaternion against the support."""
    at = interface.sensor
    x, y, z, qw, qx, qy, qz = np.ascontiguousarray(sensors[:, at : at + 7].T)
    xx, xy, xz = 1 - 2 * (qy * qy + qz * qz), 2 * (qx * qy - qw * qz), 2 * (qx * qz + qw * qy)
    yx, yy, yz = 2 * (qx * qy + qw * qz), 1 - 2 * (qx * qx + qz * qz), 2 * (qy * qz - qw * qx)
    zx, zy, zz = 2 * (qx * qz - qw * qy), 2 * (qy * qz + qw * qx), 1 - 2 * (qx * qx + qy * qy)
    cosine, sine = np.cos(interface.yaw), np.sin(interface.yaw)
    moved, lowest = np.zeros_like(x), np.full_like(x, np.inf)
    for a, b, c in interface.corners.tolist():
        dx = x + xx * a + xy * b + xz * c - (interface.position[0] + cosine * a - sine * b)
        dy = y + yx * a + yy * b + yz * c - (interface.position[1] + sine * a + cosine * b)
        moved = np.maximum(moved, dx * dx + dy * dy)
        lowest = np.minimum(lowest, zx * a + zy * b + zz * c)
    upright = np.hypot(zx, zy)
    if interface.radius is not None:
        lowest -= interface.radius * upright
    tilt = np.arctan2(upright, zz)
    return Motion(np.sqrt(moved), tilt, interface.position[2] - z, z + lowest - interface.top)


def judge(
    trial: int, world: World, failure: FailureConfig, planned: Reference, motions: Mapping[str, Motion],
    criteria: Mapping[str, Sequence[Criterion]], joint_names: Sequence[str], limits: Array, tracking_error: float,
    torque: Array,
) -> TrialOutcome:  # fmt: skip
    """The outcome of one trial that did not diverge.

    motions: of everything that friction holds; limits: of the joint torques (n,); tracking_error: largest of any joint;
    torque: (N, n)
    """
    objects = {name: _judge_object(motion, criteria[name], planned.t) for name, motion in motions.items()}
    share = np.abs(torque) / limits
    events = [(item.time, item.status, name) for name, item in objects.items() if item.status is not Status.SUCCESS]
    timestep = planned.t[1] - planned.t[0]
    for joint, name in enumerate(joint_names):
        start = _first_run(share[:, joint] >= 1 - AT_LIMIT, round(failure.saturation / timestep))
        if start is not None:
            events.append((float(planned.t[start]), Status.TORQUE_SATURATED, name))
    time, status, what = min(events, key=lambda event: event[0], default=(np.nan, Status.SUCCESS, ""))
    s = float(np.interp(time, planned.t, planned.s)) if what else np.nan
    return TrialOutcome(
        trial, status, what, time, s, objects, float(tracking_error), float(share.max()), *_truth_of(world)
    )


def diverged(trial: int, world: World, names: Sequence[str]) -> TrialOutcome:
    """The outcome of a trial whose simulation diverged; names: of everything that friction holds."""
    lost = ObjectOutcome(Status.DIVERGED, *[float("nan")] * 5)
    return TrialOutcome(
        trial, Status.DIVERGED, "", np.nan, np.nan, dict.fromkeys(names, lost), np.nan, np.nan, *_truth_of(world)
    )


def _truth_of(world: World) -> tuple[dict[str, float], dict[str, float]]:
    return dict(world.friction), {name: body.mass for name, body in world.bodies.items()}


def motion_of_object(motions: Sequence[Motion]) -> Motion:
    """Movement of an object that stands on several: the furthest from its place against any, the lift off all."""
    slip, tilt, drop = (np.max([getattr(m, kind) for m in motions], axis=0) for kind in ("slip", "tilt", "drop"))
    return Motion(slip, tilt, drop, np.min([m.lift for m in motions], axis=0))


def _judge_object(motion: Motion, criteria: Sequence[Criterion], t: Array) -> ObjectOutcome:
    """The outcome of something from its movement."""
    events = []
    for status, kind, limit in criteria:
        values = getattr(motion, kind)
        if values.max() > limit:
            events.append((int(np.argmax(values > limit)), status))
    step, status = min(events, key=lambda event: event[0], default=(-1, Status.SUCCESS))
    time = float(t[step]) if events else np.nan
    return ObjectOutcome(
        status, time, *(float(values.max()) for values in (motion.slip, motion.tilt, motion.drop, motion.lift))
    )


def _first_run(true: Array, length: int) -> int | None:
    """Where the first run of more than `length` true values in a row has gone on for too long; None without one."""
    count = 0
    if not true.any():
        return None
    for i in np.flatnonzero(true):
        count = count + 1 if i > 0 and true[i - 1] else 1
        if count > length:
            return int(i)
    return None
