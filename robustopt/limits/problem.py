"""Time-scaling problem: rows a u + b x + c <= 0 at every grid point, each with its name.

x = sd^2 at the grid points, piecewise linear in s; u = sdd, constant on each interval, x_{i+1} = x_i + 2 ds_i u_i. The
control of an interval satisfies the rows at both of its ends. At a stop the grid point is doubled: the second
one starts the next piece of the path, x = 0 at both, and the interval between them has no length.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from robustopt.arrays import Array, Flags, Indices
from robustopt.config import Config
from robustopt.limits.cartesian import PointAcceleration, point_acceleration, speed_names
from robustopt.limits.contact_limit import ContactLimit
from robustopt.limits.contacts import contact_limits, torque_limit
from robustopt.limits.laws import ContactLaw
from robustopt.limits.limit import Limit, LimitFactory
from robustopt.limits.motion import PathMotion
from robustopt.limits.names import LimitKind, LimitName
from robustopt.limits.polygons import Polygons, cut_affine, edge_rows, start
from robustopt.limits.speed_between import SpeedBetween, speed_between
from robustopt.limits.systems import SLIPS
from robustopt.limits.torque import TorqueLimit, torque_scale
from robustopt.limits.track import Track
from robustopt.limits.uncertainty import Uncertainty, uncertainty_of
from robustopt.path import Path
from robustopt.robot import Robot


@dataclass(frozen=True, eq=False)
class Limits:
    """All limits of a problem along its grid, before they are cut into rows.

    Attributes:
        track: grid and motion.
        uncertainty: the uncertain quantities.
        contacts: limits of the contact systems.
        torque: limits of the joint torques.
        others: limits that a user has added.
        laws: contact laws that a user has given, by the name of the contact.
        points: limits of the acceleration of points.
        speeds: limits of the speeds of joints and points between grid points, with jerk limits.
    """

    track: Track
    uncertainty: Uncertainty
    contacts: tuple[ContactLimit, ...]
    torque: TorqueLimit
    others: tuple[Limit, ...] = ()
    laws: Mapping[str, ContactLaw] = field(default_factory=dict)
    points: tuple[PointAcceleration, ...] = ()
    speeds: tuple[SpeedBetween, ...] = ()

    @property
    def motion(self) -> PathMotion:
        """Return the motion along the path."""
        return self.track.motion

    @property
    def x_max(self) -> Array:
        """Return the largest x that the velocities of joints and the speeds of points allow (P,)."""
        return self.track.x_max

    @cached_property
    def names(self) -> tuple[LimitName, ...]:
        """Return the names of all limits: velocity, acceleration and torque of each joint, points, contacts, others."""
        kinds = (LimitKind.VELOCITY, LimitKind.ACCELERATION, LimitKind.TORQUE)
        names = [name for kind in kinds for name in self.track.names(kind)] + [*speed_names(self.track.robot)]
        return tuple(dict.fromkeys([*names, *(name for limit in self.cutting for name in limit.names)]))

    @property
    def cutting(self) -> tuple[Limit, ...]:
        """Return the limits that cut the polygons of the joint limits, in their order."""
        return (*self.speeds, *self.points, *self.contacts, self.torque, *self.others)

    def index(self, limit: Limit) -> Indices:
        """Return the number of each name of a limit among the names of all limits.

        Args:
            limit: the limit.
        """
        return np.array([self.names.index(name) for name in limit.names], dtype=np.int64)

    def start(self, counts: Flags) -> Polygons:
        """Return the polygons of the joint velocity and joint acceleration limits.

        Args:
            counts: whether each limit in `names` counts; limits of velocity and speed always do.
        """
        track, error, n = self.track, self.uncertainty.error, self.track.robot.n
        joint = np.tile(np.arange(n), 2)
        used = counts[n + joint]
        if used.all():
            return track.joint_polygons(error)
        outline = start(track.u_max, track.x_max, track.fastest)
        return cut_affine(outline, track.acceleration(error)[:, used], (n + joint)[used])


@dataclass(frozen=True, eq=False)
class TimeScalingProblem:
    """Rows a u + b x + c <= 0 and bounds 0 <= x <= x_max on a grid.

    Attributes:
        config: the configuration.
        robot: the robot.
        path: the path.
        s: grid points in [0, 1] (P,).
        piece: piece of the path (P,).
        rest: whether the robot must stand still (P,).
        a: coefficients of u (P, m); rows are fractions of their limits, padded with rows that always hold.
        b: coefficients of x (P, m).
        c: constants (P, m).
        row_names: name of each column (m,).
        x_max: largest x, 0 at rest (P,).
        x_max_names: the limit of velocity or Cartesian speed that bounds x (P,).
        feasible: whether any (u, x) satisfies the rows of the grid point (P,).
        limits: the limits, from which the rows are made.
        kept: names of the limits that count, None for all.
        running: x and sdd at the grid points (2, P) in a running plan, from which searches start; None without one.
    """

    config: Config
    robot: Robot
    path: Path
    s: Array
    piece: Indices
    rest: Flags
    a: Array
    b: Array
    c: Array
    row_names: tuple[LimitName, ...]
    x_max: Array
    x_max_names: tuple[LimitName, ...]
    feasible: Flags
    limits: Limits = field(repr=False)
    kept: frozenset[str] | None = None
    running: Array | None = field(default=None, repr=False)

    @cached_property
    def ds(self) -> Array:
        """Return the interval lengths (P - 1,); 0 at stops."""
        return np.diff(self.s)

    @cached_property
    def fixed(self) -> Array:
        """Return x where it is given, 0 at rest and the square of the speed at both ends, and nan elsewhere (P,)."""
        fixed = np.where(self.rest, 0.0, np.nan)
        fixed[[0, -1]] = np.square(self.path.end_speeds)
        return fixed

    @cached_property
    def jerk(self) -> Array:
        """Return the jerk limits that count, infinite for joints without one (n,) [rad/s^3 or m/s^3]."""
        names, limits = self.limits.track.names(LimitKind.JERK), self.robot.limits.jerk
        counted = [self.kept is None or name in self.kept for name in names]
        return np.where(counted, limits, np.inf)

    @cached_property
    def pauses(self) -> Array:
        """Return the time for which the robot stands still on each interval without length, else 0, (P - 1,) [s]."""
        pauses = np.zeros(len(self.ds))
        pauses[self.ds == 0.0] = self.path.pauses
        return pauses

    @property
    def facets(self) -> tuple[Array, ...]:
        """Return the rows of each contact system, as fractions of its weight, (F, d) each."""
        return tuple(limit.facets for limit in self.limits.contacts)

    @property
    def reference(self) -> Array:
        """Return the x about which the viscous torque is linearised (P,), nan for none."""
        return self.limits.torque.reference

    def with_contacts(self, contacts: Sequence[ContactLimit]) -> TimeScalingProblem:
        """Return the same problem with other limits of its contact systems.

        Args:
            contacts: one limit for each contact system.
        """
        return _with_rows(replace(self, limits=replace(self.limits, contacts=tuple(contacts))))

    def with_cuts(self, contacts: Sequence[ContactLimit]) -> TimeScalingProblem:
        """Return the same problem with limits of its contact systems that have more cuts, without cutting all polygons.

        Args:
            contacts: one limit for each contact system.
        """
        new, names = [], []
        for before, after in zip(self.limits.contacts, contacts, strict=True):
            if after.cuts.shape[1] > before.cuts.shape[1]:
                new.append(after.cuts[:, before.cuts.shape[1] :])
                names += [after.names[SLIPS]] * new[-1].shape[1]
        rows = [np.concatenate([old, *(part[:, :, k] for part in new)], axis=1)
                for k, old in enumerate((self.a, self.b, self.c))]  # fmt: skip
        a, b, c = rows
        limits = replace(self.limits, contacts=tuple(contacts))
        return replace(self, a=a, b=b, c=c, row_names=(*self.row_names, *names), limits=limits)

    def with_facets(self, facets: Sequence[Array]) -> TimeScalingProblem:
        """Return the same problem with other rows of its contact systems.

        Args:
            facets: rows of each contact system, as fractions of its weight, (F, d) each.
        """
        pairs = zip(self.limits.contacts, facets, strict=True)
        return self.with_contacts([limit.with_facets(rows) for limit, rows in pairs])

    def with_torque(self, torque: TorqueLimit) -> TimeScalingProblem:
        """Return the same problem with other torque limits.

        Args:
            torque: the torque limits.
        """
        return _with_rows(replace(self, limits=replace(self.limits, torque=torque)))

    def with_reference(self, reference: Array) -> TimeScalingProblem:
        """Return the same problem with the viscous torque linearised about another x.

        Args:
            reference: the x (P,), nan for none.
        """
        return self.with_torque(self.limits.torque.with_reference(reference))

    def only(self, names: Collection[str]) -> TimeScalingProblem:
        """Return the same problem with some of its limits; those of joint velocity and Cartesian speed always stay.

        Args:
            names: names of the limits to keep.
        """
        return _with_rows(replace(self, kept=frozenset(names)))

    def counts(self, index: Indices) -> Flags:
        """Return whether limits count, (k,).

        Args:
            index: numbers of the limits in `limits.names` (k,).
        """
        if self.kept is None:
            return np.ones(len(index), dtype=bool)
        return np.array([self.limits.names[k] in self.kept for k in index], dtype=bool)

    def torque_exceeds(self, most: float, u: Array, x: Array, points: Indices) -> bool:
        """Return whether a joint torque exceeds its limit by more than a fraction of it, over all uncertain quantities.

        The torque is the exact one, without linearisation.

        Args:
            most: the fraction; negative for a distance below the limit.
            u: sdd (M,).
            x: sd^2 at the grid point (M,).
            points: grid point of each (M,).
        """
        counted = self.counts(np.arange(2 * self.robot.n, 3 * self.robot.n))
        return self.limits.torque.exceeds(most, u, x, points, counted)

    def torques(self, u: Array, x: Array) -> Array:
        """Return the nominal joint torques at the grid points, payload and joint friction included, (P, n) [N m].

        Args:
            u: sdd at each grid point (P,).
            x: sd^2 at each grid point (P,).
        """
        return self.limits.torque.torques(u, x) * torque_scale(self.robot.limits.torque)


def rows_along(
    track: Track,
    config: Config,
    limits: Sequence[LimitFactory] = (),
    laws: Mapping[str, ContactLaw] | None = None,
) -> TimeScalingProblem:
    """Return the problem of a configuration on a given track.

    Args:
        track: robot, path and grid.
        config: the configuration; its robot and path must be those of the track.
        limits: further limits, each made from the track.
        laws: contact laws in place of the configured ones, by the name of the contact of an object.

    Raises:
        ConfigError: the configuration does not fit the robot, or a law is given for a contact that no object has.
    """
    uncertainty = uncertainty_of(config, track.robot.n, track.robot.base)
    contacts = contact_limits(config, track, uncertainty, laws)
    torque = torque_limit(track, uncertainty, contacts)
    limited = [motion for motion in track.points if np.isfinite(motion.point.acceleration)]
    points = tuple(point_acceleration(motion, *uncertainty.error.arrays) for motion in limited)
    others = tuple(factory(track) for factory in limits)
    speeds = speed_between(track)
    every = Limits(track, uncertainty, contacts, torque, others, laws or {}, points, speeds)
    empty = np.zeros((len(track.s), 0))
    bare = TimeScalingProblem(
        config, track.robot, track.path, track.s, track.piece, track.rest, empty, empty, empty, (),
        np.where(track.rest, 0.0, track.x_max), track.velocity_names, np.ones(len(track.s), dtype=bool), every,
    )  # fmt: skip
    return _with_rows(bare)


def _with_rows(problem: TimeScalingProblem) -> TimeScalingProblem:
    """Return the problem with the polygons of all limits cut, and their edges as rows."""
    limits = problem.limits
    counts = problem.counts(np.arange(len(limits.names)))
    polygons = limits.start(counts)
    for limit in limits.cutting:
        index = limits.index(limit)
        polygons = limit.cut(polygons, index, counts[index])
    rows, columns = edge_rows(polygons, problem.robot.n, len(limits.names))
    a, b, c = np.ascontiguousarray(np.moveaxis(rows, 2, 0))
    names = tuple(limits.names[k] for k in columns)
    return replace(problem, a=a, b=b, c=c, row_names=names, feasible=polygons.sizes > 0)
