"""What became of a trial: success, or what failed first, when, and where on the path."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum

import numpy as np

from robustopt.config_model import FailureConfig
from robustopt.execution.controller import Reference
from robustopt.execution.scene import Interface
from robustopt.execution.truth import World

Array = np.ndarray

AT_LIMIT = 1e-9
"""A torque within this part of its limit is at it: the limit is reached exactly, but for rounding."""


class Status(Enum):
    """How a trial ended; `sentence` says it to people."""

    SUCCESS = "success"
    SLID = "slid"
    TIPPED = "tipped"
    FELL = "fell"
    LOST_CONTACT = "lost contact"
    TORQUE_SATURATED = "torque saturated"
    DIVERGED = "simulation diverged"

    @property
    def sentence(self) -> str:
        return {
            Status.SUCCESS: "Every object stayed in its place.",
            Status.SLID: "An object slid further on its support than is allowed.",
            Status.TIPPED: "An object tipped further against its support than is allowed.",
            Status.FELL: "An object dropped further below its place than is allowed.",
            Status.LOST_CONTACT: "An object rose off its support further than is allowed.",
            Status.TORQUE_SATURATED: "A joint torque stayed at its limit for longer than is allowed.",
            Status.DIVERGED: "The simulation diverged; what it showed is not counted as physics.",
        }[self]


@dataclass(frozen=True)
class ObjectOutcome:
    """What became of an object: how it failed first, or success, when (t = 0: start of the motion; nan: never) [s],
    and the largest slip [m], tilt [rad], drop [m] and lift [m] against what it stands on."""

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
    error_mean, error_square, error_unfiltered_mean, error_unfiltered_square: mean and mean square of the acceleration
    error of each joint (see `feedback`), empty where the simulation diverged; error_steps: steps they are over
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


def object_motion(interface: Interface, sensors: Array) -> Motion:
    """Movement at an interface from a trial's sensor data (N, .)."""
    at = interface.sensor
    position, rotation = sensors[:, at : at + 3], rotations(sensors[:, at + 3 : at + 7])
    c, s = np.cos(interface.yaw), np.sin(interface.yaw)
    placed = interface.position + interface.corners @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    corners = position[:, None] + interface.corners @ rotation.transpose(0, 2, 1)
    slip = np.sqrt(((corners - placed)[..., :2] ** 2).sum(axis=2)).max(axis=1)
    tilt = np.arctan2(np.hypot(rotation[:, 0, 2], rotation[:, 1, 2]), rotation[:, 2, 2])
    lowest = _lowest(interface, position, rotation)
    return Motion(slip, tilt, interface.position[2] - position[:, 2], lowest - interface.top)


def rotations(quaternion: Array) -> Array:
    """Rotation matrices (N, 3, 3) of unit quaternions w, x, y, z (N, 4)."""
    w, x, y, z = quaternion.T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), 2, 0)


def _lowest(interface: Interface, position: Array, rotation: Array) -> Array:
    """Height of the lowest point of the base above the centre of the support, (N,) [m]."""
    down = rotation[:, 2]
    if interface.radius is not None:
        rim = interface.radius * np.hypot(down[:, 0], down[:, 1])
        return np.asarray(position[:, 2] + down[:, 2] * interface.corners[0, 2] - rim)
    return np.asarray(position[:, 2] + (down @ interface.corners.T).min(axis=1))


def judge(
    trial: int, world: World, failure: FailureConfig, planned: Reference, interfaces: Sequence[Interface],
    joint_names: Sequence[str], limits: Array, positions: Array, targets: Array, torque: Array, sensors: Array,
    diverged: bool,
) -> TrialOutcome:  # fmt: skip
    """The outcome of one trial.

    limits: of the joint torques (n,); positions, targets: of the joints and their references (N, n); torque: (N, n);
    sensors: (N, .)
    """
    friction, mass = dict(world.friction), {name: body.mass for name, body in world.bodies.items()}
    names = dict.fromkeys(interface.object for interface in interfaces)
    if diverged:
        lost = ObjectOutcome(Status.DIVERGED, *[float("nan")] * 5)
        return TrialOutcome(
            trial, Status.DIVERGED, "", np.nan, np.nan, dict.fromkeys(names, lost), np.nan, np.nan, friction, mass
        )
    objects = {}
    for name in names:
        motions = [object_motion(interface, sensors) for interface in interfaces if interface.object == name]
        objects[name] = _judge_object(motions, failure, planned.t)
    share = np.abs(torque) / limits
    events = [(item.time, item.status, name) for name, item in objects.items() if item.status is not Status.SUCCESS]
    timestep = planned.t[1] - planned.t[0]
    for joint, name in enumerate(joint_names):
        start = _first_run(share[:, joint] >= 1 - AT_LIMIT, round(failure.saturation / timestep))
        if start is not None:
            events.append((float(planned.t[start]), Status.TORQUE_SATURATED, name))
    time, status, what = min(events, key=lambda event: event[0], default=(np.nan, Status.SUCCESS, ""))
    s = float(np.interp(time, planned.t, planned.s)) if what else np.nan
    error = float(np.abs(positions - targets).max())
    return TrialOutcome(trial, status, what, time, s, objects, error, float(share.max()), friction, mass)


def _judge_object(motions: Sequence[Motion], failure: FailureConfig, t: Array) -> ObjectOutcome:
    """The outcome of an object: furthest from its place against any support, and off all of them to lose contact."""
    slip, tilt, drop = (np.max([getattr(m, kind) for m in motions], axis=0) for kind in ("slip", "tilt", "drop"))
    lift = np.min([m.lift for m in motions], axis=0)
    limits = (
        (Status.FELL, drop, failure.drop), (Status.TIPPED, tilt, failure.tilt),
        (Status.LOST_CONTACT, lift, failure.lift), (Status.SLID, slip, failure.slip),
    )  # fmt: skip
    events = [(int(np.argmax(values > limit)), status) for status, values, limit in limits if values.max() > limit]
    step, status = min(events, key=lambda event: event[0], default=(-1, Status.SUCCESS))
    time = float(t[step]) if events else np.nan
    return ObjectOutcome(status, time, *(float(values.max()) for values in (slip, tilt, drop, lift)))


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
