"""Interfaces of the simulated world: contacts and the floating base, whose motion decides whether a trial succeeds.

Each interface turns the record of a trial into the movement of an object, a contact of the robot or its base relative
to the plan, and knows the ways to fail.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from robustopt.arrays import Array, Flags
from robustopt.config import FailureConfig
from robustopt.path.footsteps import Place, Stance
from robustopt.simulation.controller import Reference
from robustopt.simulation.feedback import low_passed
from robustopt.simulation.outcome import Criterion, Motion, Status
from robustopt.simulation.simulation import Record, positions_before

TOUCHING = 1e-3
"""A contact point lower than this touches the floor or the rail [m]: contacts are soft, and a landing foot is not quite
level."""

LANDING = 0.15
"""Fraction of a phase in which a landed foot may still move, because it carries almost no load (our choice)."""

LEAST_FORCE = 1e-6
"""A normal force below this counts as none [N]."""

STEEP = 1e-6
"""Smallest cosine of the pitch; it keeps the rates of the angles finite if a falling robot lies on its face."""


class Interface(Protocol):
    """A contact or the floating base, whose motion decides whether a trial succeeds."""

    @property
    def name(self) -> str:
        """Return the name of the object, environment contact or body that it is judged with."""

    @property
    def against(self) -> str:
        """Return what it is in contact with, in words; empty for the floating base."""

    def motion(self, planned: Reference, record: Record, i: int) -> Motion:
        """Return the movement in a trial.

        Args:
            planned: reference of the controllers.
            record: record of a chunk of trials.
            i: index of the trial in the record.
        """

    def criteria(self, failure: FailureConfig) -> tuple[Criterion, ...]:
        """Return the ways to fail; if two occur in the same time step, the first one counts.

        Args:
            failure: limits of the movements.
        """


def combined(motions: Sequence[Motion]) -> Motion:
    """Return the movement of an object on several supports: the largest on any of them, but the smallest lift.

    Args:
        motions: movement on each support.
    """
    slip, tilt, drop = (np.max([getattr(m, kind) for m in motions], axis=0) for kind in ("slip", "tilt", "drop"))
    return Motion(slip, tilt, drop, np.min([m.lift for m in motions], axis=0))


# Objects --------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Standing:
    """An object on a support.

    Attributes:
        name: name of the object.
        against: name of the support.
        sensor: index in the sensor data of the object's pose in the frame of the support.
        position: planned centre in that frame (3,) [m].
        yaw: planned yaw in that frame [rad].
        corners: points of the base whose movement is slip, from the centre of the object (k, 3) [m].
        radius: radius of a round base [m], None for another shape.
        top: height of the support's upper face above the centre of the support [m].
    """

    name: str
    against: str
    sensor: int
    position: Array
    yaw: float
    corners: Array
    radius: float | None
    top: float

    def criteria(self, failure: FailureConfig) -> tuple[Criterion, ...]:
        """Return the ways to fail: it falls, tips, loses contact or slides."""
        return (
            Criterion(Status.FELL, "drop", failure.drop), Criterion(Status.TIPPED, "tilt", failure.tilt),
            Criterion(Status.LOST_CONTACT, "lift", failure.lift), Criterion(Status.SLID, "slip", failure.slip),
        )  # fmt: skip

    def motion(self, planned: Reference, record: Record, i: int) -> Motion:
        """Return the movement relative to the support."""
        x, y, z, *turn = np.ascontiguousarray(record.sensors[i][:, self.sensor : self.sensor + 7].T)
        (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = _rotation(*turn)
        cosine, sine = np.cos(self.yaw), np.sin(self.yaw)
        moved, lowest = np.zeros_like(x), np.full_like(x, np.inf)
        for a, b, c in self.corners.tolist():
            dx = x + xx * a + xy * b + xz * c - (self.position[0] + cosine * a - sine * b)
            dy = y + yx * a + yy * b + yz * c - (self.position[1] + sine * a + cosine * b)
            moved = np.maximum(moved, dx * dx + dy * dy)
            lowest = np.minimum(lowest, zx * a + zy * b + zz * c)
        upright = np.hypot(zx, zy)
        if self.radius is not None:
            lowest -= self.radius * upright
        tilt = np.arctan2(upright, zz)
        return Motion(np.sqrt(moved), tilt, self.position[2] - z, z + lowest - self.top)


@dataclass(frozen=True)
class Held:
    """A part that cups or pads hold; all quantities are in the carrier frame.

    Attributes:
        name: name of the part, or of the hand that holds the tray.
        against: what holds it, in words.
        sensor: index of the part's pose in the sensor data.
        position: planned centre of the part (3,) [m].
        rotation: planned axes of the part as columns (3, 3).
        points: contact points of its lips and pads (k, 3) [m].
        normals: normals at these points, from the tool into the part (k, 3).
        rigid: whether the contact can open at a point (k,); the driven finger follows the part.
    """

    name: str
    against: str
    sensor: int
    position: Array
    rotation: Array
    points: Array
    normals: Array
    rigid: Flags

    def criteria(self, failure: FailureConfig) -> tuple[Criterion, ...]:
        """Return the ways to fail: a lip or the fixed pad opens, or the part slides along its lips or pads."""
        return (
            Criterion(Status.LOST_GRIP, "lift", failure.opening),
            Criterion(Status.SLID_IN_GRIP, "slip", failure.grip_slip),
        )

    def motion(self, planned: Reference, record: Record, i: int) -> Motion:
        """Return the movement relative to the tool; `lift` is the largest opening of a lip or of the fixed pad."""
        pose = record.sensors[i][:, self.sensor : self.sensor + 7]
        turned = _rotations(pose[:, 3:]) @ self.rotation.T
        arms = self.points - self.position
        moved = pose[:, None, :3] - self.position + np.einsum("tij,kj->tki", turned, arms) - arms
        opening = np.einsum("tki,ki->tk", moved, self.normals)
        slide = np.linalg.norm(moved - opening[:, :, None] * self.normals, axis=2)
        cosine = 0.5 * (np.trace(turned, axis1=1, axis2=2) - 1.0)
        tilt = np.arccos(np.clip(cosine, -1.0, 1.0))
        none = np.full(len(pose), np.nan)
        return Motion(slide.max(axis=1), tilt, none, opening[:, self.rigid].max(axis=1))


# The robot and its environment ----------------------------------------------------------------------------


@dataclass(frozen=True)
class Stand:
    """A time in which a contact rests in one place.

    Attributes:
        begin: s at the begin.
        end: s at the end; at the end of the path it lasts to the end of the trial.
        place: the place.
    """

    begin: float
    end: float
    place: Place


def stands(stances: Sequence[Stance], name: str) -> tuple[Stand, ...]:
    """Return the times at which a contact rests; a foot rests from a little after it has landed until it lifts.

    Args:
        stances: stances of the path in their order.
        name: name of the contact.
    """
    found: list[Stand] = []
    before = False
    for stance in stances:
        stood = name in stance.places
        if stood and before:
            found[-1] = replace(found[-1], end=stance.end)
        elif stood:
            grace = LANDING * (stance.end - stance.begin) if stance.begin > 0 else 0.0
            found.append(Stand(stance.begin + grace, stance.end, stance.places[name]))
        before = stood
    return tuple(found)


@dataclass(frozen=True)
class MeasuredContact:
    """Force of the floor on a foot, or of a rail on a hand, at the start of each step; low-passed.

    Attributes:
        force: force in the axes of the contact, the normal force last (N, 3) [N].
        center_of_pressure: point in the plane of the contact at which it acts, x and y in the world (N, 2) [m]; nan
            without a force.
    """

    force: Array
    center_of_pressure: Array


@dataclass(frozen=True)
class Grounded:
    """A foot on the floor or a hand on a rail.

    Attributes:
        name: name of the contact.
        sensor: index in the sensor data of the pose of its site (3 + 4); force, moment and point of its force on the
            floor or rail follow, world frame (3 + 3 + 3).
        points: contact points in the frame of the site (k, 3) [m].
        stands: times at which the contact rests.
        leaves: whether it fails by rising off its support, as a hand does.
    """

    name: str
    sensor: int
    points: Array
    stands: tuple[Stand, ...]
    leaves: bool

    @property
    def against(self) -> str:
        """Return what it is in contact with."""
        return "rail" if self.leaves else "floor"

    def criteria(self, failure: FailureConfig) -> tuple[Criterion, ...]:
        """Return the ways to fail: it slips, or leaves its rail."""
        slips = (Criterion(Status.SLIPPED, "slip", failure.foot_slip),)
        return (*slips, Criterion(Status.LOST_CONTACT, "lift", failure.hand_lift)) if self.leaves else slips

    def motion(self, planned: Reference, record: Record, i: int) -> Motion:
        """Return the movement of the points that touch while the contact rests; 0 while it does not rest."""
        s, place = planned.s, self.stands[0].place
        poses = record.sensors[i][:, self.sensor : self.sensor + 7]
        rotations = place.axes.T @ _rotations(poses[:, 3:])
        points = (poses[:, None, :3] - place.position) @ place.axes + np.einsum("tij,kj->tki", rotations, self.points)
        lowest = points[:, :, 2].min(axis=1)
        tilt = np.arccos(np.clip(rotations[:, 2, 2], -1.0, 1.0))
        slip, standing = np.zeros(len(s)), np.zeros(len(s), dtype=bool)
        for stand in self.stands:
            here = np.flatnonzero((s >= stand.begin) & (s <= stand.end))
            if not len(here):
                continue
            moved = np.linalg.norm(points[here, :, :2] - points[here[0], :, :2], axis=2)
            slip[here] = np.where(points[here, :, 2] < TOUCHING, moved, 0.0).max(axis=1)
            standing[here] = True
        none = np.full(len(s), np.nan)
        return Motion(slip, np.where(standing, tilt, 0.0), none, np.where(standing, lowest, 0.0))

    def measured(self, record: Record, i: int, timestep: float) -> MeasuredContact:
        """Return the force of the floor or rail on the contact in a trial.

        Args:
            record: record of a chunk of trials.
            i: index of the trial in the record.
            timestep: time step [s].
        """
        wrench, place = record.sensors[i][:, self.sensor + 7 : self.sensor + 16].copy(), self.stands[0].place
        force, moment, point = np.split(wrench, 3, axis=1)
        # The sensor measures the force of the contact on the floor or the rail.
        whole = -moment + np.cross(point - place.position, -force)
        force, whole = low_passed(-force @ place.axes, timestep), low_passed(whole @ place.axes, timestep)
        lift = np.where(force[:, 2] > LEAST_FORCE, force[:, 2], np.nan)
        pressure = np.column_stack([-whole[:, 1], whole[:, 0]]) / lift[:, None]
        return MeasuredContact(force, place.world(pressure)[:, :2])


@dataclass(frozen=True)
class Trunk:
    """The floating base of a walking robot; the robot has fallen if the base is too far from upright or too low.

    Attributes:
        name: name of the body of the base.
        height: planned height of the base at rest [m].
        against: empty, because nothing touches the base.
    """

    name: str
    height: float
    against: str = ""

    def criteria(self, failure: FailureConfig) -> tuple[Criterion, ...]:
        """Return the ways to fail: it tilts or drops too far."""
        drop = failure.trunk_drop * self.height
        return Criterion(Status.FELL, "tilt", failure.trunk_tilt), Criterion(Status.FELL, "drop", drop)

    def motion(self, planned: Reference, record: Record, i: int) -> Motion:
        """Return the movement relative to the plan."""
        poses = positions_before(record, i)[:, :7]
        x, y = poses[:, 4], poses[:, 5]
        none = np.full(len(poses), np.nan)
        tilt = np.arccos(np.clip(1.0 - 2.0 * (x * x + y * y), -1.0, 1.0))
        return Motion(none, tilt, planned.q[:, 2] - poses[:, 2], none)

    def rates(self, record: Record, i: int) -> Array:
        """Return the rates of its coordinates, before each step and after the last, (N + 1, 6).

        Args:
            record: record of a chunk of trials.
            i: index of the trial in the record.
        """
        qpos = np.vstack([record.start_qpos[i, :7], record.qpos[i, :, :7]])
        qvel = np.vstack([record.start_qvel[i, :6], record.qvel[i, :, :6]])
        return np.column_stack([qvel[:, :3], turning(qpos[:, 3:], qvel[:, 3:])])


def turning(quaternions: Array, spin: Array) -> Array:
    """Return the rates of the angles about z, y and x, (N, 3) [rad/s].

    Args:
        quaternions: orientation of the body (N, 4).
        spin: angular velocity in the axes of the body (N, 3) [rad/s].
    """
    w, x, y, z = quaternions.T
    roll = np.arctan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    pitch = np.arcsin(np.clip(2 * (w * y - z * x), -1.0, 1.0))
    sine, cosine = np.sin(roll), np.cos(roll)
    yaw_rate = (spin[:, 1] * sine + spin[:, 2] * cosine) / np.maximum(np.cos(pitch), STEEP)
    return np.column_stack([yaw_rate, spin[:, 1] * cosine - spin[:, 2] * sine, spin[:, 0] + yaw_rate * np.sin(pitch)])


def _rotations(quaternions: Array) -> Array:
    """Return the rotation matrices (N, 3, 3) of unit quaternions w, x, y, z (N, 4)."""
    return np.moveaxis(np.array(_rotation(*quaternions.T)), 2, 0)


def _rotation(w: Array, x: Array, y: Array, z: Array) -> list[list[Array]]:
    """Return the rows of the rotation matrices of unit quaternions, (N,) each."""
    return [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
