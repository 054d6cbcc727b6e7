"""Time-scaling problem: rows a u + b x + c <= 0 at every grid point, each with its name.

x = sd^2 at the grid points, piecewise linear in s; u = sdd, constant on each interval, x_{i+1} = x_i + 2 ds_i u_i. The
control of an interval satisfies the rows at both of its ends. Where the robot stops, the grid point is doubled: the
second one starts the next piece of the path, x = 0 at both, and the interval between them has no length.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, field, replace

import numpy as np

from robustopt.config import Config
from robustopt.contact import contact_systems
from robustopt.path import Path, build_path
from robustopt.polygons import Polygons, cut, cut_affine, edge_slots, facet_family, start
from robustopt.robot import Robot, load_robot
from robustopt.rows import (
    ContactFamily,
    PathMotion,
    TorqueFamily,
    acceleration_rows,
    body_loads,
    path_motion,
    torque_family,
)
from robustopt.uncertainty import acceleration_error, bodies, contact_shift, friction
from robustopt.walker import Walker, load_walker
from robustopt.walking import StandingTorque, WalkMotion, walking_families
from robustopt.walking_path import WalkingPath, build_walking_path

Array = np.ndarray

REST_REFINEMENT = 0.45
"""Share of cosine spacing in the grid of a piece, the rest is uniform: finer towards rest, where sd is like sqrt(s).
With 0.45, 200 intervals are within 0.3 % of a fine grid on all waiter tasks; below 0.4 and above 0.55 not on all."""

STANDARD_GRAVITY = 9.81
"""Turns a mass into the weight that contact rows are a fraction of, whatever the configured gravity [m/s^2]."""

LEAST_RATE = 1e-3
"""Where q' vanishes, sd and sdd are bounded as if it were this part of its largest value, far beyond what other grid
points and the bend q'' leave of them."""

WITHOUT_LIMIT = 1e3
"""A problem without its joint acceleration limits still bounds |u|, but by this factor further out."""


def gridpoints(path: Path, intervals: int) -> tuple[Array, Array]:
    """Grid of a path: s (P,) and the piece of each grid point (P,); stops are doubled, P = intervals + pieces."""
    lengths = np.diff(path.breaks)
    counts = _apportion(lengths, intervals)
    s, piece = [], []
    for k, count in enumerate(counts):
        xi = np.linspace(0.0, 1.0, count + 1)
        spaced = (1 - REST_REFINEMENT) * xi + REST_REFINEMENT * (1 - np.cos(np.pi * xi)) / 2
        points = path.breaks[k] + lengths[k] * spaced
        points[0], points[-1] = path.breaks[k], path.breaks[k + 1]
        s.append(points)
        piece.append(np.full(count + 1, k))
    return np.concatenate(s), np.concatenate(piece)


def _apportion(lengths: Array, total: int) -> list[int]:
    """Split `total` intervals in proportion to the lengths, at least two each, by largest remainders."""
    shares = np.maximum(lengths / lengths.sum() * total, 2.0)
    counts = np.floor(shares).astype(int)
    for k in np.argsort(counts - shares, kind="stable")[: max(total - counts.sum(), 0)]:
        counts[k] += 1
    return [int(count) for count in counts]


@dataclass(frozen=True, eq=False)
class Limits:
    """All limits of a problem along its grid, before they are cut into rows.

    outline: polygons of the joint velocity limits and of what any acceleration limit allows; acceleration: rows of the
    joint acceleration limits (P, 2n, 3); contacts: one family per contact system;
    torque: joint torque; names: of all rows; x_max: from joint velocity (P,); velocity_name: (P,) index of its joint
    """

    motion: PathMotion | WalkMotion
    outline: Polygons
    acceleration: Array
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
    robot: Robot | Walker
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

    @property
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
        return np.array([self.kept is None or self.limits.names[k] in self.kept for k in index], dtype=bool)

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
    return build_rows(config, *robot_and_path(config))


def robot_and_path(config: Config) -> tuple[Robot | Walker, Path]:
    """What of a configuration does not depend on beliefs; errors as of `build_problem`."""
    if config.walks:
        walker = load_walker(config)
        return walker, build_walking_path(config, walker)
    robot = load_robot(config)
    return robot, build_path(config, robot)


def build_rows(config: Config, robot: Robot | Walker, path: Path) -> TimeScalingProblem:
    """The problem of a configuration whose robot and path are at hand."""
    s, piece = gridpoints(path, config.solver.collocation_points)
    for switch in path.switches:  # the limits on both sides of it hold there
        s[1 + np.argmin(np.abs(s[1:-1] - switch))] = switch
    rest = np.zeros(len(s), dtype=bool)
    rest[[0, -1]] = True
    doubled = np.flatnonzero(np.diff(s) == 0)
    rest[doubled] = rest[doubled + 1] = True
    limits = _limits(config, robot, path, s, piece)
    facets = tuple(_scaled_facets(family) for family in limits.contacts)
    names = tuple(_name_index(family, rows, limits.names) for family, rows in zip(limits.contacts, facets, strict=True))
    empty = np.zeros((len(s), 0))
    bare = TimeScalingProblem(
        config, robot, path, s, piece, rest, empty, empty, empty, (), np.where(rest, 0.0, limits.x_max),
        tuple(limits.names[k] for k in limits.velocity_name), np.ones(len(s), dtype=bool), limits, facets, names,
        np.full(len(s), np.nan),
    )  # fmt: skip
    return _with_rows(bare, facets, names, bare.reference)


def _limits(config: Config, robot: Robot | Walker, path: Path, s: Array, piece: Array) -> Limits:
    q, q1, q2 = (path.evaluate(s, piece, order) for order in (0, 1, 2))
    middle, radius = error = acceleration_error(config, robot.n)
    motion: PathMotion | WalkMotion
    torque: TorqueFamily | StandingTorque
    if isinstance(robot, Walker):
        assert isinstance(path, WalkingPath)
        motion, contacts, torque = walking_families(config, robot, path, s, q, q1, q2, np.stack(error))
    else:
        motion, contacts, torque = _carrying_families(config, robot, q, q1, q2, np.stack(error))
    names = _all_names(robot, contacts)
    x_max, fastest = _velocity_bound(q1, robot.limits.velocity)
    outline = _outline(motion, robot, middle, x_max, fastest)
    acceleration = acceleration_rows(motion, robot.limits, middle, radius)
    return Limits(motion, outline, acceleration, contacts, torque, names, x_max, fastest)


def _carrying_families(
    config: Config, robot: Robot, q: Array, q1: Array, q2: Array, error: Array
) -> tuple[PathMotion, tuple[ContactFamily, ...], TorqueFamily]:
    """Motion, contacts and joint torques of an arm that carries a tray.

    q, q1, q2: (P, n); error: middle and half-width of the acceleration error, (2, n)
    """
    motion, (middle, radius) = path_motion(q1, q2, robot.dynamics(q, q1, q2)), error
    everything = bodies(config)
    systems = contact_systems(config, friction(config), contact_shift(config))
    contacts = []
    for system in systems:
        loaded = [[everything[name] for name in row] for row in system.loads]
        parameters = [np.sum([body.nominal for body in row], axis=0) for row in loaded]
        centred = system.about([phi[1:4] / phi[0] for phi in parameters])
        weight = STANDARD_GRAVITY * sum(phi[0] for phi in parameters)
        contacts.append(ContactFamily(centred, body_loads(motion, loaded, centred.points, middle, radius), weight))
    payload = body_loads(motion, [list(everything.values())], [np.zeros(3)], middle, radius)
    return motion, tuple(contacts), torque_family(motion, robot.limits, payload, middle, radius)


def _all_names(robot: Robot | Walker, contacts: tuple[ContactFamily, ...]) -> tuple[str, ...]:
    """Names of all rows: velocity, acceleration and torque per joint, then the limits of the contact systems."""
    names = [f"{joint} {kind}" for kind in ("velocity", "acceleration", "torque") for joint in robot.joint_names]
    for family in contacts:
        names += family.system.names
    return tuple(dict.fromkeys(names))


def _velocity_bound(q1: Array, velocity: Array) -> tuple[Array, Array]:
    """Largest x that the joint velocities allow, (P,), and which joint bounds it, (P,)."""
    ratio = np.abs(q1) / velocity
    fastest = np.argmax(ratio, axis=1)
    return 1.0 / _without_zeros(ratio.max(axis=1)) ** 2, fastest


def _outline(
    motion: PathMotion | WalkMotion, robot: Robot | Walker, middle: Array, x_max: Array, fastest: Array
) -> Polygons:
    """Rectangles that hold every (u, x) of the acceleration limits, twice as wide as they need to be."""
    limit = robot.limits.acceleration
    rate = np.abs(motion.q1) / limit
    lead = np.argmax(rate, axis=1)
    row = np.arange(len(x_max))
    bend = np.abs(motion.q2[row, lead]) / limit[lead] * x_max
    reach = (1.0 + (np.abs(middle) / limit)[lead] + bend) / _without_zeros(rate[row, lead])
    return start(2.0 * reach, x_max, fastest)


def _without_zeros(rates: Array) -> Array:
    """Rates of the fastest joint along the path (P,), bounded from below where joints turn around together."""
    return np.maximum(rates, LEAST_RATE * rates.max())


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
    polygons = limits.outline.copy()
    used = counts[n + joint_names]
    if not used.all():
        polygons = start(WITHOUT_LIMIT * limits.outline.vertices[:, 1, 0], limits.x_max, limits.velocity_name)
    cut_affine(polygons, np.ascontiguousarray(limits.acceleration[:, used]), (n + joint_names)[used])
    for family, rows, index in zip(limits.contacts, facets, names, strict=True):
        used = counts[index]
        here = slice(family.first, family.last + 1 if family.last >= 0 else None)
        cut(polygons.at(here), facet_family(rows[used], family.loads.at(here), index[used]))
    used = counts[2 * n + joint_names]
    limits.torque.cut(polygons, reference, limits.x_max, used, 2 * n + joint_names)
    a, b, c, columns = _columns(polygons, n, len(limits.names))
    return replace(
        problem, a=a, b=b, c=c, row_names=tuple(limits.names[k] for k in columns), feasible=polygons.sizes > 0,
        facets=facets, facet_names=names, reference=reference,
    )  # fmt: skip


def _columns(polygons: Polygons, joints: int, names: int) -> tuple[Array, Array, Array, list[int]]:
    """Edges of the polygons as rows; the columns of one name are as many as one grid point needs at most."""
    slots = edge_slots(polygons.vertices, polygons.names, polygons.sizes, joints, names)
    point, edge = np.nonzero(slots >= 0)
    name = polygons.names[point, edge]
    width = np.zeros(names, dtype=np.int64)
    np.maximum.at(width, name, slots[point, edge] + 1)
    first = np.r_[0, np.cumsum(width)]
    rows = np.zeros((len(polygons.sizes), first[-1], 3))
    rows[:, :, 2] = -1.0
    rows[point, first[name] + slots[point, edge]] = polygons.rows[point, edge]
    columns = [k for k in range(names) for _ in range(width[k])]
    return rows[:, :, 0].copy(), rows[:, :, 1].copy(), rows[:, :, 2].copy(), columns
