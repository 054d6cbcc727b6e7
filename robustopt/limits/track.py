"""Track: the grid along a path, and the parts of a problem that depend on robot and path alone.

Problems that differ only in their uncertain quantities share a track. It keeps the results that they have in common,
each under the uncertain quantities that it depends on.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from threading import Lock
from typing import Any, TypeVar

import numpy as np

from robustopt.arrays import Array, Flags, Indices
from robustopt.limits.bodies import Body
from robustopt.limits.cartesian import bound_speeds, speed_names
from robustopt.limits.generalised_force import generalised_force
from robustopt.limits.grid import Grid
from robustopt.limits.motion import PathMotion
from robustopt.limits.names import LimitKind, LimitName
from robustopt.limits.polygons import Polygons, RequiredWrench, cut_affine, start
from robustopt.limits.torque import TorqueLimit, own_inertia_terms, payload_torque
from robustopt.limits.turning import carrier_rates
from robustopt.limits.uncertainty import AccelerationError, Uncertainty
from robustopt.limits.wrenches import BodyWrenches, body_loads, body_wrenches, no_wrench
from robustopt.path import Path
from robustopt.robot import JointLimits, PointMotion, Robot

Value = TypeVar("Value")

LEAST_RATE = 1e-3
"""If q' vanishes at a grid point, sd is bounded as if the fastest joint had this fraction of its largest rate, far
beyond the values that other grid points and the curvature q'' allow."""

MOST_SPEED = 1e3
"""Speed of a joint [rad/s or m/s] beyond which a velocity limit counts as none, far above that of any robot. Polygons
start from this bound instead of an arbitrarily large one, in which all other limits would be lost in rounding errors.
A plan never reaches it: `solve` refuses a problem whose speed nothing bounds."""

MOST_KEPT = 16
"""Number of results of each kind that a track keeps: enough for problems that differ only in friction."""


@dataclass(frozen=True, eq=False)
class Track:
    """A grid along a path, and the motion of the robot there.

    Attributes:
        robot: the robot.
        path: the path.
        grid: the grid.
        rest: whether the robot must stand still (P,).
        motion: motion along the path.
        x_max: largest x that the velocities of the joints and the speeds of the limited points allow (P,).
        fastest: the joint that comes nearest to its velocity limit (P,).
        rates: rates of the carrier frame, see `turning.carrier_rates`.
        slowest: index of the point whose speed bounds x, in the order of `speed_names`; -1 if `fastest` does (P,).
        points: motion of the limited points.
    """

    robot: Robot
    path: Path
    grid: Grid
    rest: Flags
    motion: PathMotion
    x_max: Array
    fastest: Indices
    rates: Array
    slowest: Indices
    points: tuple[PointMotion, ...]
    _kept: dict[str, dict[Hashable, Any]] = field(default_factory=dict, repr=False)
    _lock: Lock = field(default_factory=Lock, repr=False)

    @property
    def s(self) -> Array:
        """Return the grid points in [0, 1] (P,)."""
        return self.grid.s

    @property
    def piece(self) -> Indices:
        """Return the piece of the path of each grid point (P,)."""
        return self.grid.piece

    def names(self, kind: LimitKind) -> tuple[LimitName, ...]:
        """Return the names of the limits of one kind, one for each joint (n,).

        Args:
            kind: velocity, acceleration or torque.
        """
        return tuple(LimitName(kind, joint) for joint in self.robot.joint_names)

    @cached_property
    def velocity_names(self) -> tuple[LimitName, ...]:
        """Return the names of the limits of velocity or Cartesian speed that bound x, (P,)."""
        joints, points = self.names(LimitKind.VELOCITY), speed_names(self.robot)
        return tuple(joints[j] if k < 0 else points[k] for j, k in zip(self.fastest, self.slowest, strict=True))

    @cached_property
    def u_max(self) -> Array:
        """Return the largest |u| with which x stays within its bounds on the intervals beside a grid point, (P,)."""
        ds = np.diff(self.s)
        rise = np.divide(np.maximum(self.x_max[:-1], self.x_max[1:]), 2.0 * ds, out=np.zeros_like(ds), where=ds > 0)
        return np.maximum(np.r_[rise, 0.0], np.r_[0.0, rise])

    def loads(
        self, carried: Sequence[Sequence[Body]], about: Sequence[Array], error: AccelerationError
    ) -> RequiredWrench:
        """Return the required wrenches of stacked objects; see `body_loads`.

        Args:
            carried: for each object the bodies that it carries, itself included.
            about: reference point of the moments of each object, carrier frame (3,) [m].
            error: acceleration error.
        """
        if not any(carried):
            return no_wrench(len(self.s), 6 * len(carried))
        erring = any(map(np.any, error.arrays))

        def wrenches_of(body: Body) -> BodyWrenches:
            return self._once("wrenches", (body, erring), lambda: body_wrenches(self.motion, body, erring))

        key = (tuple(map(tuple, carried)), np.concatenate(about).tobytes(), error)
        return self._once("loads", key, lambda: body_loads(carried, about, *error.arrays, wrenches_of))

    def generalised_force(self, uncertainty: Uncertainty) -> RequiredWrench:
        """Return the generalised force of the motion of a legged robot.

        Args:
            uncertainty: the uncertain quantities.
        """
        key = (uncertainty.robot_bodies, uncertainty.bodies, uncertainty.error, uncertainty.squeeze)
        return self._once("force", key, lambda: generalised_force(self.robot, self.motion, uncertainty))

    def payload_torque(self, payload: RequiredWrench, error: AccelerationError) -> TorqueLimit:
        """Return the torque limits of an arm with a payload.

        Args:
            payload: required wrench of the payload about the carrier's origin.
            error: acceleration error.
        """
        motion, limits, names = self.motion, self.robot.limits, self.names(LimitKind.TORQUE)
        limit = self._once(
            "torque", error.middle, lambda: payload_torque(motion, names, limits, payload, error.arrays, self.x_max)
        )
        key = (len(payload.constant_group), error)
        terms = self._once("torque terms", key, lambda: own_inertia_terms(motion, limits, payload, error.arrays[1]))
        return limit.carrying(payload, terms)

    def acceleration(self, error: AccelerationError) -> Array:
        """Return the rows of the joint acceleration limits, (P, 2n, 3).

        Args:
            error: acceleration error.
        """
        return self._once(
            "acceleration", error, lambda: _acceleration_rows(self.motion, self.robot.limits, *error.arrays)
        )

    def outline(self, error: AccelerationError) -> Polygons:
        """Return rectangles that contain every (u, x) within the acceleration limits, twice as wide as necessary.

        Args:
            error: acceleration error.
        """
        return self._once("outline", error.middle, lambda: _outline(self, error.arrays[0]))

    def joint_polygons(self, error: AccelerationError) -> Polygons:
        """Return the outline cut with the rows of the joint acceleration limits, whose names are numbered n + joint.

        Args:
            error: acceleration error.
        """
        names = self.robot.n + np.tile(np.arange(self.robot.n), 2)
        rows = self.acceleration(error)
        return self._once("joint polygons", error, lambda: cut_affine(self.outline(error), rows, names))

    def _once(self, kind: str, key: Hashable, make: Callable[[], Value]) -> Value:
        """Return a kept result, or make and keep it; two threads may make the same result at the same time."""
        kept = self._kept.setdefault(kind, {})
        found: Value | None = kept.get(key)
        if found is None:
            found = make()
            with self._lock:
                while len(kept) >= MOST_KEPT:
                    kept.pop(next(iter(kept)))
                kept[key] = found
        return found


def build_track(robot: Robot, path: Path, grid: Grid) -> Track:
    """Return the track of a path.

    Args:
        robot: the robot.
        path: the path.
        grid: the grid along the path.
    """
    rest = np.zeros(len(grid.s), dtype=bool)
    rest[[0, -1]] = [speed == 0.0 for speed in path.end_speeds]
    doubled = np.flatnonzero(np.diff(grid.s) == 0)
    rest[doubled] = rest[doubled + 1] = True
    q, q1, q2 = (path.evaluate(grid.s, grid.piece, order) for order in (0, 1, 2))
    motion = PathMotion(robot, q, q1, q2)
    rates = carrier_rates(robot, path)
    x_max, fastest = _velocity_bound(q1, robot.limits.velocity)
    x_max, slowest = bound_speeds(robot, path, grid, x_max)
    points = tuple(robot.point_motion(point, q, q1, q2) for point in robot.points)
    return Track(robot, path, grid, rest, motion, x_max, fastest, rates, slowest, points)


def _acceleration_rows(motion: PathMotion, limits: JointLimits, middle: Array, radius: Array) -> Array:
    """Return the rows +-(q' u + q'' x + middle) + radius <= limit, divided by the limit, (P, 2n, 3)."""
    rows = np.stack([motion.q1, motion.q2, np.broadcast_to(middle, motion.q1.shape)], axis=2)
    rows = np.concatenate([rows, -rows], axis=1)
    rows[:, :, 2] += np.r_[radius, radius]
    rows /= np.r_[limits.acceleration, limits.acceleration][:, None]
    rows[:, :, 2] -= 1.0
    return rows


def _velocity_bound(q1: Array, velocity: Array) -> tuple[Array, Indices]:
    """Return the largest x that the joint velocities allow (P,), and the joint that bounds it (P,)."""
    ratio = np.abs(q1) / np.minimum(velocity, MOST_SPEED)
    rate, still = ratio.max(axis=1), _still(q1)
    rate[still] = np.maximum(rate[still], LEAST_RATE * rate[~still].min())
    return 1.0 / rate**2, np.argmax(ratio, axis=1)


def _still(q1: Array) -> Flags:
    """Return whether all joints turn round together at a grid point, (P,)."""
    largest = np.abs(q1).max(axis=1)
    return np.asarray(largest < LEAST_RATE * largest.max())


def _outline(track: Track, middle: Array) -> Polygons:
    motion, x_max = track.motion, track.x_max
    limit = track.robot.limits.acceleration
    rate = np.abs(motion.q1) / limit
    lead = np.argmax(rate, axis=1)
    row = np.arange(len(x_max))
    bend = np.abs(motion.q2[row, lead]) / limit[lead] * x_max
    with np.errstate(divide="ignore"):
        reach = (1.0 + (np.abs(middle) / limit)[lead] + bend) / rate[row, lead]
    return start(np.minimum(2.0 * reach, track.u_max), x_max, track.fastest)
