"""Footing of a robot on its feet in a trial: how far its contacts and the trunk moved, and what they were pushed with.

A standing foot has slipped when one of its contact points that touch the floor has moved; one that has just landed may
take up its load first. A hand slips on its rail likewise, and loses contact when all of its palm is off it. The robot
has fallen when its floating base, the trunk, is too far from upright or too low.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from robustopt.path.footsteps import Place, Stance
from robustopt.simulation.feedback import low_passed
from robustopt.simulation.outcome import Motion

Array = np.ndarray

TOUCHING = 1e-3
"""A contact point lower than this touches the floor or the rail [m]: contacts are soft, and a landing foot is not quite
level."""

LANDING = 0.15
"""Part of a phase for which a foot that has landed may still move: it carries next to nothing (our choice)."""

LEAST_FORCE = 1e-6
"""A normal force below this is none [N]."""

STEEP = 1e-6
"""Keeps the rates of the angles finite where a falling robot lies on its face."""


@dataclass(frozen=True)
class MeasuredContact:
    """What the floor does to a foot, or a rail to a hand, at the start of each step, low-passed as acceleration errors.

    force: in the axes of the contact, the normal force last, (N, 3) [N]; center_of_pressure: where it acts in the plane
    of the contact, x and y in the world (N, 2) [m], nan without a force
    """

    force: Array
    center_of_pressure: Array

    @classmethod
    def of(cls, place: Place, force: Array, moment: Array, point: Array, timestep: float) -> MeasuredContact:
        """From force, moment about a point, and that point, (N, 3) each, world axes; place: a plane of the contact."""
        whole = moment + np.cross(point - place.position, force)
        force, whole = low_passed(force @ place.axes, timestep), low_passed(whole @ place.axes, timestep)
        lift = np.where(force[:, 2] > LEAST_FORCE, force[:, 2], np.nan)
        pressure = np.column_stack([-whole[:, 1], whole[:, 0]]) / lift[:, None]
        return cls(force, place.world(pressure)[:, :2])


@dataclass(frozen=True)
class Stand:
    """A time in which a contact rests in one place: from `begin` to `end` in s, or to the end of the trial."""

    begin: float
    end: float
    place: Place


def stands(stances: Sequence[Stance], names: Sequence[str]) -> dict[str, list[Stand]]:
    """When each contact rests where: a foot from a little after it has landed until it lifts, or to the end."""
    found: dict[str, list[Stand]] = {name: [] for name in names}
    for name, own in found.items():
        before = False
        for stance in stances:
            stood = name in stance.places
            if stood and before:
                own[-1] = replace(own[-1], end=stance.end)
            elif stood:
                grace = LANDING * (stance.end - stance.begin) if stance.begin > 0 else 0.0
                own.append(Stand(stance.begin + grace, stance.end, stance.places[name]))
            before = stood
    return found


def contact_motion(points: Array, times: Sequence[Stand], s: Array, poses: Array) -> Motion:
    """Movement of a contact while it rests on what it is on, 0 while it does not.

    points: in the frame of the contact (k, 3) [m]; times: when it rests; s: planned, (N,); poses: position and
    quaternion of the contact's frame at the start of each step, world (N, 7)
    """
    place = times[0].place
    rotations = place.axes.T @ _rotations(poses[:, 3:])
    corners = (poses[:, None, :3] - place.position) @ place.axes + np.einsum("tij,kj->tki", rotations, points)
    lowest = corners[:, :, 2].min(axis=1)
    tilt = np.arccos(np.clip(rotations[:, 2, 2], -1.0, 1.0))
    slip, standing = np.zeros(len(s)), np.zeros(len(s), dtype=bool)
    for stand in times:
        here = np.flatnonzero((s >= stand.begin) & (s <= stand.end))
        if not len(here):
            continue
        moved = np.linalg.norm(corners[here, :, :2] - corners[here[0], :, :2], axis=2)
        slip[here] = np.where(corners[here, :, 2] < TOUCHING, moved, 0.0).max(axis=1)
        standing[here] = True
    none = np.full(len(s), np.nan)
    return Motion(slip, np.where(standing, tilt, 0.0), none, np.where(standing, lowest, 0.0))


def trunk_motion(height: Array, poses: Array) -> Motion:
    """Movement of the floating base against the plan; height: planned (N,) [m]; poses: (N, 7)."""
    x, y = poses[:, 4], poses[:, 5]
    none = np.full(len(poses), np.nan)
    tilt = np.arccos(np.clip(1.0 - 2.0 * (x * x + y * y), -1.0, 1.0))
    return Motion(none, tilt, height - poses[:, 2], none)


def _rotations(quaternions: Array) -> Array:
    """Rotation matrices (N, 3, 3) of unit quaternions w, x, y, z (N, 4)."""
    w, x, y, z = quaternions.T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), 2, 0)


def turning(quaternions: Array, spin: Array) -> Array:
    """Rates of the turns about z, y and x (N, 3) from quaternions (N, 4) and angular velocities, body axes (N, 3)."""
    w, x, y, z = quaternions.T
    roll = np.arctan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    pitch = np.arcsin(np.clip(2 * (w * y - z * x), -1.0, 1.0))
    sine, cosine = np.sin(roll), np.cos(roll)
    yaw_rate = (spin[:, 1] * sine + spin[:, 2] * cosine) / np.maximum(np.cos(pitch), STEEP)
    return np.column_stack([yaw_rate, spin[:, 1] * cosine - spin[:, 2] * sine, spin[:, 0] + yaw_rate * np.sin(pitch)])
