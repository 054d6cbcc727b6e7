"""Bodies of masses at points, and what they need by Newton's law: an oracle for plans that hold for all real bodies.

Nothing here is shared with the sets of inertias that plans and certificates use. A body is a set of points with
weights, and what it requires is the sum of the forces that its points need. This is linear in the moments of the body,
1, r and r r^T, so the rows of a plan are evaluated for thousands of bodies at once. Worst bodies come from linear
programs over the places of the masses.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product

import mechanics
import numpy as np
from scipy.optimize import linprog

from robustopt.arrays import Array, Indices
from robustopt.certificate.balance import balance
from robustopt.certificate.force_closure import GAP
from robustopt.certificate.motion import CARRIER, Instants, instants, motion, stances
from robustopt.certificate.task import task_of
from robustopt.certificate.world import build_world
from robustopt.config import Config
from robustopt.limits.contact_limit import ContactLimit
from robustopt.scene.placement import TRAY, placements
from robustopt.solvers import Plan
from robustopt.solvers.plan import interval_ends

ROWS = 1 << 24
"""Largest number of values in memory together."""


@dataclass(frozen=True)
class Shape:
    """The places of the masses of an object, and the interval of its centre of mass, axes of the object.

    Attributes:
        places: places of masses (k, 3) [m].
        half: half extents of the box, or radius, radius and half the height of the cylinder (3,) [m].
        center: nominal centre of mass (3,) [m].
        reach: largest displacement of the centre of mass (3,) [m].
        round: whether the object is a cylinder.
    """

    places: Array
    half: Array
    center: Array
    reach: Array
    round: bool = False


def shape_of(config: Config, name: str) -> Shape:
    """Return a shape with three places along each edge of a box, or on rim and axis of a cylinder at three heights."""
    item = config.objects[name]
    if item.size is not None:
        half = np.array(item.size) / 2
        places = np.array(list(product((-1.0, 0.0, 1.0), repeat=3)))
    else:
        half = np.array([item.radius, item.radius, item.height / 2])
        angles = np.linspace(0.0, 2 * np.pi, 16, endpoint=False)
        disc = np.vstack([np.stack([np.cos(angles), np.sin(angles)], axis=1), [[0.0, 0.0]]])
        places = np.array([[*p, z] for p in disc for z in (-1.0, 0.0, 1.0)])
    reach = config.uncertainty.center_of_mass.get(name, (0.0, 0.0, 0.0))
    return Shape(places * half, half, np.array(item.center_of_mass), np.array(reach), item.size is None)


def moments(places: Array) -> Array:
    """Return 1, r and the entries of r r^T (k, 10) of places (k, 3)."""
    x, y, z = places.T
    return np.stack([np.ones_like(x), x, y, z, x * x, y * y, z * z, x * y, x * z, y * z], axis=1)


@dataclass(frozen=True)
class Points:
    """A body of unit mass: weights (k,) and places (k, 3) of its masses, axes of the object."""

    weights: Array
    places: Array

    @property
    def center(self) -> Array:
        return self.weights @ self.places

    @property
    def moments(self) -> Array:
        return self.weights @ moments(self.places)


def extreme(shape: Shape, value: Array) -> Points:
    """Return the body with the largest sum of values of its places, centre of mass in the interval."""
    rows = np.vstack([shape.places.T, -shape.places.T])
    ends = np.r_[shape.center + shape.reach, shape.reach - shape.center]
    found = linprog(-value, rows, ends, np.ones((1, len(value))), [1.0])
    if found.status != 0:
        raise ValueError(found.message)
    return Points(found.x, shape.places)


def random_bodies(shape: Shape, count: int, rng: np.random.Generator) -> Iterator[Points]:
    """Yield masses at random extreme places, some of them drawn in along axes, and uniform bodies about a centre."""
    for k in range(count):
        body = extreme(shape, rng.normal(size=len(shape.places)))
        yield (body, drawn_in(body, rng), uniform(shape, body.center, rng.uniform(size=3)))[k % 3]


def drawn_in(body: Points, rng: np.random.Generator) -> Points:
    """Return a body whose masses are nearer to its centre of mass, or in a plane, on a line or at a point with it."""
    center = body.center
    return Points(body.weights, center + rng.choice([0.0, 0.5, 1.0], size=3) * (body.places - center))


def uniform(shape: Shape, center: Array, size: Array) -> Points:
    """Return a body with the second moments of a uniform one of the same kind, about a centre of mass.

    Args:
        shape: the shape, which contains the body.
        center: the centre of mass (3,) [m].
        size: size along each axis, as a share of the largest possible one (3,); a cylinder uses the first and the last.
    """
    room = shape.half - np.abs(center)
    if shape.round:
        room[:2] = shape.half[0] - np.hypot(*center[:2])
        size = size[[0, 0, 2]]
    spread = np.sqrt([4.0, 4.0, 3.0] if shape.round else [3.0, 3.0, 3.0])
    return Points(np.full(8, 1 / 8), center + np.array(list(product((-1.0, 1.0), repeat=3))) * room * size / spread)


def usual(config: Config, name: str) -> Points:
    """Return a body with the configured centre of mass and inertia, whose products are zero."""
    item = config.tray if name == TRAY else config.objects[name]
    inertia = mechanics.inertia(config, name) / item.mass
    squares = np.maximum(0.5 * np.trace(inertia) - np.diag(inertia), 0.0)
    corners = np.array(list(product((-1.0, 1.0), repeat=3)))
    return Points(np.full(8, 1 / 8), np.array(item.center_of_mass) + corners * np.sqrt(squares))


def uncertain(config: Config, names: Sequence[str]) -> list[str]:
    """Return the objects among some names that may be any body that can exist."""
    return [name for name in names if name != TRAY and config.inertia_of(name) == "realizable"]


def masses(config: Config, name: str) -> tuple[float, float]:
    """Return both ends of the mass of the tray or an object [kg]."""
    item = config.tray if name == TRAY else config.objects[name]
    return config.uncertainty.mass.get(name, (item.mass, item.mass))


def wrenches(config: Config, name: str, places: Array, motions: Sequence[mechanics.Motion], about: Array) -> Array:
    """Return what unit masses at places (k, 3) in an object need, moments about a point, (M, k, 6)."""
    r = places if name == TRAY else _placed(config, name, places)
    linear, alpha, omega = np.array([(m.linear, m.angular, m.omega) for m in motions]).transpose(1, 0, 2)[:, :, None]
    force = linear + np.cross(alpha, r) + np.cross(omega, np.cross(omega, r))
    return np.concatenate([force, np.cross(r - about, force)], axis=2)


def _placed(config: Config, name: str, places: Array) -> Array:
    place = placements(config)[name]
    return np.asarray(place.position + places @ place.rotation.T)


# Rows ----------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Oracle:
    """Rows of a limit at M instants, for bodies of points; they hold where they are not positive.

    Attributes:
        config: the configuration.
        name: the limit.
        names: bodies that load it.
        motions: motion of the carrier at each instant (M,).
        still: the same with gravity alone (M,); empty for rows that are not scaled by what rest requires.
        facets: rows per wrench of each body about `about`, (F, 6) or (M, F, 6).
        about: reference of the moments, carrier frame (3,) [m].
        constant: values without any body (F,) or (M, F).
    """

    config: Config
    name: str
    names: tuple[str, ...]
    motions: Sequence[mechanics.Motion]
    facets: Mapping[str, Array]
    about: Array
    constant: Array
    still: Sequence[mechanics.Motion] = ()

    @property
    def at_rest(self) -> Oracle:
        """Return the same rows for gravity alone."""
        return replace(self, motions=self.still)

    def values(self, name: str, places: Array) -> Array:
        """Return the values of the rows per unit mass at places in a body, (M, F, k)."""
        found = wrenches(self.config, name, places, self.motions, self.about)
        return np.asarray(self.facets[name] @ np.swapaxes(found, 1, 2))

    def largest(self, name: str, values: Array) -> Array:
        """Return the values of a body of unit mass at its worse end of the interval of mass."""
        low, high = masses(self.config, name)
        return np.maximum(low * values, high * values)

    def of_others(self, without: Sequence[str]) -> Array:
        """Return the values (M, F) of all bodies but some, with their usual inertia, and of what has no body."""
        total = np.zeros((len(self.motions), self.constant.shape[-1])) + self.constant
        for name in set(self.names) - set(without):
            body = usual(self.config, name)
            total += self.largest(name, self.values(name, body.places) @ body.weights)
        return total

    def per_moment(self, name: str) -> Array:
        """Return the values of the rows per moment of a body, (M, F, 10): they are quadratic in the place."""
        places = shape_of(self.config, name).places
        return np.asarray(self.values(name, places) @ np.linalg.pinv(moments(places)).T)


def oracles(plan: Plan, draws: int, rng: np.random.Generator) -> Iterator[Oracle]:
    """Yield the rows of every contact of objects at both ends of every interval, with random ends of the errors."""
    problem = plan.problem
    u, x, points = interval_ends(plan)
    errors = _errors(plan, len(points) * draws, rng)
    each = list(zip(np.repeat(points, draws), np.repeat(u, draws), np.repeat(x, draws), errors, strict=True))
    motions = [mechanics.tray_motion(problem, *values) for values in each]
    zero = np.zeros(problem.robot.n)
    still = [mechanics.tray_motion(problem, point, 0.0, 0.0, zero) for point, *_ in each]
    for family in problem.limits.contacts:
        if set(family.system.loads[0]) <= set(problem.config.objects) and len(family.system.facets):
            yield _of_contact(problem.config, family, motions, still)


def shared_oracle(plan: Plan, system: int, samples: int, rng: np.random.Generator) -> Oracle:
    """Return rows of a cone that several objects share, at both ends of every interval.

    They are the limits that the programs of the certificate find for random values at each instant: every one of them
    must hold for all bodies.

    Args:
        plan: the plan.
        system: index of the contact system in the world of the certificate.
        samples: number of rows per instant.
        rng: generator of random numbers.
    """
    task, at = task_of(plan), instants(plan, ())
    world = build_world(task.config, task.robot, task.path, stances(task.path, at))
    moving, _ = motion(task, at)
    own, moved = world.systems[system], np.flatnonzero(at.free)
    found = []
    for _ in range(samples):
        values = world.sample(rng, len(moved), corners=True)
        found.append(balance(world, own, moving.at(moved), values, GAP).y)
    rows = -np.moveaxis(np.array(found), 2, 0)
    names = [body.name for body in world.bodies]
    facets = {names[b]: rows @ load.matrix for load in own.loads for b in load.bodies}
    motions, still = _motions(plan, at, moved, np.zeros((len(moved), task.robot.n)))
    return Oracle(task.config, str(own.name), tuple(facets), motions, facets, np.zeros(3), np.zeros(samples), still)


def _errors(plan: Plan, count: int, rng: np.random.Generator) -> Array:
    """Return random ends of the acceleration errors (count, n)."""
    given, middle = plan.problem.config.uncertainty.joint_acceleration, mechanics.nominal(plan.problem).error
    radius = (
        np.zeros(plan.problem.robot.n) if given is None else given.K * np.broadcast_to(given.deviation, len(middle))
    )
    return np.asarray(middle + rng.choice([-1.0, 1.0], size=(count, len(radius))) * radius)


def _of_contact(
    config: Config, family: ContactLimit, motions: Sequence[mechanics.Motion], still: Sequence[mechanics.Motion]
) -> Oracle:
    """Return the rows of a contact limit, with the forces that press."""
    facets, system = family.system.facets / family.weight, family.system
    constant = np.zeros(len(facets))
    for column, name in enumerate(system.pressed, 6):
        force = config.objects[name].held_by.tool.force
        constant += facets[:, column] * (force[0] if isinstance(force, tuple) else force)
    name = f"contact of {system.objects[0]}"
    rows = dict.fromkeys(system.loads[0], facets[:, :6])
    return Oracle(config, name, system.loads[0], motions, rows, system.points[0], constant, still)


def torque_oracle(plan: Plan, rng: np.random.Generator) -> Oracle:
    """Return the torques of the motors at both ends of every interval, as shares of their limits less 1.

    What the robot itself needs comes from the certificate.
    """
    task = task_of(plan)
    at = instants(plan, ())
    _, joints = motion(task, at)
    count = np.count_nonzero(at.free)
    errors = _errors(plan, count, rng)
    motions, _ = _motions(plan, at, np.arange(count), errors)
    torque = joints.torque[:, :count] + np.einsum("mnt,tn->mt", joints.inertia[..., :count], errors)
    sticking = joints.sticking[:, :count]
    limit = task.limits.torque[task.robot.motors][:, None]
    to_torque = np.moveaxis(joints.to_torque[CARRIER][..., :count], 2, 0) / limit
    facets = np.concatenate([to_torque, -to_torque], axis=1)
    constant = np.concatenate([torque + sticking, sticking - torque]).T / np.tile(limit[:, 0], 2) - 1.0
    names = tuple([TRAY] if task.config.tray is not None else []) + tuple(task.config.objects)
    return Oracle(task.config, "joint torque", names, motions, dict.fromkeys(names, facets), np.zeros(3), constant)


def _motions(
    plan: Plan, at: Instants, chosen: Indices, errors: Array
) -> tuple[list[mechanics.Motion], list[mechanics.Motion]]:
    """Return the motion of the carrier at chosen instants of the certificate, and the same with gravity alone."""
    places = zip(at.node_s, at.node_piece, strict=True)
    points = [int(np.argmin(np.abs(plan.s - s) + (plan.piece != piece))) for s, piece in places]
    moved, still = [], []
    for t, error in zip(chosen, errors, strict=True):
        moved.append(mechanics.tray_motion(plan.problem, points[at.node[t]], at.u[t], at.x[t], error))
        still.append(mechanics.tray_motion(plan.problem, points[at.node[t]], 0.0, 0.0, np.zeros_like(error)))
    return moved, still


# Worst bodies --------------------------------------------------------------------------------------------


def worst_of(plan: Plan, count: int, programs: int, rng: np.random.Generator) -> tuple[float, int]:
    """Return the largest value of a row that any body reaches, and the number of bodies tried at all instants."""
    worst, tried = -np.inf, 0
    for oracle in oracles(plan, 2, rng):
        for name in uncertain(oracle.config, oracle.names):
            shape, others = shape_of(oracle.config, name), oracle.of_others([name])
            bodies = list(random_bodies(shape, count, rng)) + directed(oracle, name, others, programs)
            own = oracle.per_moment(name)
            for part in np.array_split(
                np.array([body.moments for body in bodies]), 1 + own[..., 0].size * len(bodies) // ROWS
            ):
                value = oracle.largest(name, own @ part.T) + others[..., None]
                worst = max(worst, float(value.max()))
            tried += len(bodies)
    return worst, tried


def directed(oracle: Oracle, name: str, others: Array, count: int) -> list[Points]:
    """Return the worst bodies for the rows that masses at single places bring nearest to their limits."""
    shape = shape_of(oracle.config, name)
    per_place = oracle.values(name, shape.places)
    likely = np.argsort(-(per_place.max(axis=2) + others), axis=None)[: 3 * count : 3]
    return [extreme(shape, per_place[m, f]) for m, f in zip(*np.unravel_index(likely, others.shape), strict=True)]
