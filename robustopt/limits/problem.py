"""Time-scaling problem: rows a u + b x + c <= 0 at every grid point, each with its name.

x = sd^2 at the grid points, piecewise linear in s; u = sdd, constant on each interval, x_{i+1} = x_i + 2 ds_i u_i. The
control of an interval satisfies the rows at both of its ends. Where the robot stops, the grid point is doubled: the
second one starts the next piece of the path, x = 0 at both, and the interval between them has no length.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from robustopt.config import Config
from robustopt.limits.contact import contact_systems
from robustopt.limits.polygons import Polygons, cut_affine, cut_part, edge_rows, facet_family, start
from robustopt.limits.rows import ContactFamily, PathMotion, TorqueFamily
from robustopt.limits.track import Error, Track, build_track
from robustopt.limits.uncertainty import acceleration_error, bodies, contact_shift, friction
from robustopt.limits.walking import StandingTorque, WalkMotion, walking_families
from robustopt.path import Path, build_path
from robustopt.robot import Robot, load_robot

Array = np.ndarray

STANDARD_GRAVITY = 9.81
"""Turns a mass into the weight that contact rows are a fraction of, whatever the configured gravity [m/s^2]."""

WITHOUT_LIMIT = 1e3
"""A problem without its joint acceleration limits still bounds |u|, but by this factor further out."""


@dataclass(frozen=True, eq=False)
class Limits:
    """All limits of a problem along its grid, before they are cut into rows.

    outline: polygons of the joint velocity limits and of what any acceleration limit allows; acceleration: rows of the
    joint acceleration limits (P, 2n, 3); joints: the outline cut with them; contacts: one family per contact system;
    torque: joint torque; names: of all rows; x_max: from joint velocity (P,); velocity_name: (P,) index of its joint
    """

    motion: PathMotion | WalkMotion
    outline: Polygons
    acceleration: Array
    joints: Polygons
    contacts: tuple[ContactFamily, ...]
    torque: TorqueFamily | StandingTorque
    names: tuple[str, ...]
    x_max: Array
    velocity_name: Array


@dataclass(frozen=True, eq=False)
class TimeScalingProblem:
    """Rows a u + b x + c <= 0 and bounds 0 <= x <= x_max on a grid.

    s: (P,) grid points in [0, 1]; piece: (P,) piece of the path; rest: (P,) where the robot must stand still;
    a, b, c: (P, m) rows, each a fraction of its limit, padded with rows that always hold;
    row_names: (m,) name of each column; x_max: (P,), 0 at rest; x_max_names: (P,) which joint's velocity bounds x;
    feasible: (P,) whether any (u, x) satisfies the rows of the point; facets: per contact system the rows its
    wrenches were held to (F, d); reference: (P,) about which the viscous torque is a tangent, nan for none;
    kept: names of the limits that count, None for all
    """

    config: Config
    robot: Robot
    path: Path
    s: Array
    piece: Array
    rest: Array
    a: Array
    b: Array
    c: Array
    row_names: tuple[str, ...]
    x_max: Array
    x_max_names: tuple[str, ...]
    feasible: Array
    limits: Limits = field(repr=False)
    facets: tuple[Array, ...] = field(repr=False)
    facet_names: tuple[Array, ...] = field(repr=False)
    reference: Array = field(repr=False)
    kept: frozenset[str] | None = None

    @cached_property
    def ds(self) -> Array:
        """Interval lengths, (P - 1,); 0 at stops."""
        return np.diff(self.s)

    def with_facets(self, facets: tuple[Array, ...]) -> TimeScalingProblem:
        """The same problem with its contact systems held to other rows, as fractions of the weight, (F, d) each."""
        pairs = zip(self.limits.contacts, facets, strict=True)
        names = tuple(_name_index(family, rows, self.limits.names) for family, rows in pairs)
        return _with_rows(self, facets, names, self.reference)

    def with_torque(self, torque: StandingTorque) -> TimeScalingProblem:
        """The same problem of a robot on its feet with other rows of its joint torques."""
        limits = replace(self.limits, torque=torque)
        return _with_rows(replace(self, limits=limits), self.facets, self.facet_names, self.reference)

    def only(self, names: Collection[str]) -> TimeScalingProblem:
        """The same problem with the limits of the given names alone; joint velocity always stays."""
        return _with_rows(replace(self, kept=frozenset(names)), self.facets, self.facet_names, self.reference)

    def with_reference(self, reference: Array) -> TimeScalingProblem:
        """The same problem with the viscous torque linearised about x = reference (P,)."""
        return _with_rows(self, self.facets, self.facet_names, reference)

    def counts(self, index: Array) -> Array:
        """Whether the limits of these indices into `limits.names` are among those that count, (k,)."""
        if self.kept is None:
            return np.ones(len(index), dtype=bool)
        return np.array([self.limits.names[k] in self.kept for k in index], dtype=bool)

    def torque_excess(self, u: Array, x: Array, points: Array) -> float:
        """Largest part of a torque limit by which an arm's exact torque exceeds it, for any value of the parameters.

        u, x: (M,); points: (M,) grid point of each
        """
        assert isinstance(self.limits.torque, TorqueFamily)
        counted = self.counts(np.tile(np.arange(2 * self.robot.n, 3 * self.robot.n), 2))
        return float(self.limits.torque.excess(u, x, points)[:, counted].max(initial=-1.0))

    def torques(self, u: Array, x: Array) -> Array:
        """Nominal torque of an arm's joints at grid points for (u, x) there, payload and joint friction included.

        (P, n) [N m]
        """
        assert isinstance(self.limits.torque, TorqueFamily)
        columns = []
        for joint in range(self.robot.n):
            coefficients, viscous = self.limits.torque.nominal(joint)
            affine = coefficients[:, 0] * u + coefficients[:, 1] * x + coefficients[:, 2]
            columns.append((affine + viscous * np.sqrt(np.maximum(x, 0.0))) * self.robot.limits.torque[joint])
        return np.stack(columns, axis=1)


def build_problem(config: Config) -> TimeScalingProblem:
    """The time-scaling problem of a configuration.

    Raises ConfigError, RobotError or PathError where the configuration cannot be used. A problem that has no solution
    is no error here: `solve` says so.
    """
    return rows_along(track_of(config), config)


def track_of(config: Config) -> Track:
    """The track of a configuration. Raises ConfigError, RobotError or PathError where that cannot be used."""
    robot = load_robot(config)
    return build_track(config, robot, build_path(config, robot))


def build_rows(config: Config, robot: Robot, path: Path) -> TimeScalingProblem:
    """The problem of a configuration whose robot and path are at hand."""
    return rows_along(build_track(config, robot, path), config)


def rows_along(track: Track, config: Config) -> TimeScalingProblem:
    """The problem of a configuration whose robot, path and number of collocation points are those of the track."""
    limits = _limits(config, track)
    facets = tuple(_scaled_facets(family) for family in limits.contacts)
    names = tuple(limits.names.index(family.system.names[0]) + family.system.kinds for family in limits.contacts)
    points = len(track.s)
    empty = np.zeros((points, 0))
    bare = TimeScalingProblem(
        config, track.robot, track.path, track.s, track.piece, track.rest, empty, empty, empty, (),
        np.where(track.rest, 0.0, track.x_max), track.velocity_names,
        np.ones(points, dtype=bool), limits, facets, names, np.full(points, np.nan),
    )  # fmt: skip
    return _with_rows(bare, facets, names, bare.reference)


def _limits(config: Config, track: Track) -> Limits:
    error = acceleration_error(config, track.robot.n)
    families = _walking_families if track.robot.base else _carrying_families
    contacts, torque = families(config, track, error)
    return Limits(
        track.motion, track.outline(error), track.acceleration(error), track.joint_polygons(error), contacts, torque,
        _all_names(track.robot, contacts), track.x_max, track.fastest,
    )  # fmt: skip


def _walking_families(
    config: Config, track: Track, error: Error
) -> tuple[tuple[ContactFamily, ...], TorqueFamily | StandingTorque]:
    """Contacts and joint torques of a robot on its feet."""
    assert isinstance(track.motion, WalkMotion)
    return walking_families(config, track.robot, track.path, track.s, track.motion, track.walking_loads(config, error))


def _carrying_families(
    config: Config, track: Track, error: Error
) -> tuple[tuple[ContactFamily, ...], TorqueFamily | StandingTorque]:
    """Contacts and joint torques of an arm that carries a tray."""
    everything = bodies(config)
    systems = contact_systems(config, friction(config), contact_shift(config))
    contacts = []
    for system in systems:
        loaded = tuple(tuple(everything[name] for name in row) for row in system.loads)
        parameters = [np.sum([body.nominal for body in row], axis=0) for row in loaded]
        centred = system.about([phi[1:4] / phi[0] for phi in parameters])
        weight = STANDARD_GRAVITY * sum(phi[0] for phi in parameters)
        contacts.append(ContactFamily(centred, track.loads(loaded, centred.points, error), weight))
    payload = track.loads((tuple(everything.values()),), (np.zeros(3),), error)
    return tuple(contacts), track.torque(payload, error)


def _all_names(robot: Robot, contacts: tuple[ContactFamily, ...]) -> tuple[str, ...]:
    """Names of all rows: velocity, acceleration and torque per joint, then the limits of the contact systems."""
    names = [f"{joint} {kind}" for kind in ("velocity", "acceleration", "torque") for joint in robot.joint_names]
    for family in contacts:
        names += family.system.names
    return tuple(dict.fromkeys(names))


def _name_index(family: ContactFamily, rows: Array, names: tuple[str, ...]) -> Array:
    return names.index(family.system.names[0]) + family.system.kind_of(rows)


def _scaled_facets(family: ContactFamily) -> Array:
    """The facets of a system as rows whose value is a fraction of the weight they carry, (F, d)."""
    if family.system.facets is None:
        return np.zeros((0, family.system.dimension))
    return family.system.facets / family.weight


def _with_rows(
    problem: TimeScalingProblem, facets: tuple[Array, ...], names: tuple[Array, ...], reference: Array
) -> TimeScalingProblem:
    """Cut the polygons of all limits and turn their edges into rows."""
    limits, n = problem.limits, problem.robot.n
    counts = problem.counts(np.arange(len(limits.names)))
    joint_names = np.tile(np.arange(n), 2)
    polygons = limits.joints
    used = counts[n + joint_names]
    if not used.all():
        polygons = start(WITHOUT_LIMIT * limits.outline.vertices[:, 1, 0], limits.x_max, limits.velocity_name)
        polygons = cut_affine(polygons, limits.acceleration[:, used], (n + joint_names)[used])
    for family, rows, index in zip(limits.contacts, facets, names, strict=True):
        used = counts[index]
        polygons = cut_part(polygons, facet_family(rows[used], family.loads, index[used]), family.first, family.last)
    used = counts[2 * n + joint_names]
    polygons = limits.torque.cut(polygons, reference, limits.x_max, used, 2 * n + joint_names)
    rows, columns = edge_rows(polygons, n, len(limits.names))
    a, b, c = np.ascontiguousarray(np.moveaxis(rows, 2, 0))
    return replace(
        problem, a=a, b=b, c=c, row_names=tuple(limits.names[k] for k in columns), feasible=polygons.sizes > 0,
        facets=facets, facet_names=names, reference=reference,
    )  # fmt: skip
