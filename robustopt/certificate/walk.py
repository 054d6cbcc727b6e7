"""A plan of a robot on its feet at many instants, the ends of all uncertain values, and their contact points."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from robustopt.certificate.contact_points import Array, Contacts, Face, Indices
from robustopt.certificate.motion import Instants
from robustopt.certificate.tally import Found, Tally
from robustopt.config import BASE_COORDINATES as BASE
from robustopt.config import Config
from robustopt.geometry import common_direction, contact_axes
from robustopt.path import Path
from robustopt.path.footsteps import Place, Stance
from robustopt.robot import Robot

if TYPE_CHECKING:
    from robustopt.solvers import Plan

LENGTH = 0.1
"""Unit of length of the force programs [m]: about half a foot."""


@dataclass(frozen=True)
class Values:
    """Uncertain values: by contact its friction and the displacement of its points (k, 2) [m], error of the
    acceleration (n,), and by body its mass [kg] and centre of mass (3,) [m]."""

    friction: Mapping[str, float]
    shift: Mapping[str, Array]
    error: Array
    bodies: Mapping[str, tuple[float, Array]]


@dataclass(frozen=True, eq=False)
class Walk:
    """A plan at T instants: path coordinates and their rates (T, n), and which stance each belongs to (T,).

    free: 1 where the robot moves, 0 where it stands still; lower, upper: ends of all values
    """

    config: Config
    walker: Robot
    path: Path
    q: Array
    qd: Array
    qdd: Array
    free: Array
    stance: Indices
    lower: Values
    upper: Values

    def needs(self, at: Indices, bodies: Mapping[str, tuple[float, Array]]) -> tuple[Array, Array, dict[str, Array]]:
        """Generalised force (T, n), per acceleration error (T, n, n), and the contacts' Jacobians at some instants."""
        return self.walker.inverse_dynamics(self.q[at], self.qd[at], self.qdd[at], bodies)


def walk_of(config: Config, plan: Plan, at: Instants) -> Walk:
    """Motion of a plan at some instants; at a switch, they belong to the one of its two stances with fewer contacts."""
    walker, path = plan.problem.robot, plan.problem.path
    q, q1, q2 = (path.evaluate(at.node_s, at.node_piece, order)[at.node] for order in range(3))
    sd, u, x = np.sqrt(at.x)[:, None], at.u[:, None], at.x[:, None]
    borders = np.array([stance.begin for stance in path.stances[1:]])
    before = np.searchsorted(borders, at.s, side="left")
    after = np.searchsorted(borders, at.s, side="right")
    count = np.array([len(stance.contacts) for stance in path.stances])
    stance = np.where(count[after] <= count[before], after, before)
    lower, upper = _ends(config, walker)
    return Walk(config, walker, path, q, q1 * sd, q1 * u + q2 * x, at.free, stance, lower, upper)


def _ends(config: Config, walker: Robot) -> tuple[Values, Values]:
    """Lowest and highest of all values, read from the configuration."""
    belief, interval = config.contact.friction, config.uncertainty.friction
    friction = {name: _pair(_of(interval, name), _of(belief, name)) for name in walker.contacts}
    shifts = {
        name: (_of(config.uncertainty.contact_points, name) or 0.0) * np.ones((len(sole.points), 2))
        for name, sole in walker.contacts.items()
    }
    low, high = np.zeros(walker.n), np.zeros(walker.n)
    error, base = config.uncertainty.joint_acceleration, np.asarray(config.uncertainty.base_acceleration, dtype=float)
    low[:BASE], high[:BASE] = -base, base
    if error is not None:
        middle, radius = np.asarray(error.mean), error.K * np.asarray(error.deviation)
        low[BASE:], high[BASE:] = middle - radius, middle + radius
    ends: list[dict[str, tuple[float, Array]]] = [{}, {}]
    for name in {*config.uncertainty.mass, *config.uncertainty.center_of_mass}:
        mass, center, _ = walker.inertia_of(name)
        masses = config.uncertainty.mass.get(name, (mass, mass))
        reach = np.array(config.uncertainty.center_of_mass.get(name, (0.0, 0.0, 0.0)))
        ends[0][name], ends[1][name] = (masses[0], center - reach), (masses[1], center + reach)
    least = Values(
        {name: pair[0] for name, pair in friction.items()}, {name: -shift for name, shift in shifts.items()}, low,
        dict(sorted(ends[0].items())),
    )  # fmt: skip
    most = Values({name: pair[1] for name, pair in friction.items()}, shifts, high, dict(sorted(ends[1].items())))
    return least, most


def _of(given: Any, name: str) -> Any:
    return given.get(name, given.get("default")) if isinstance(given, Mapping) else given


def _pair(interval: tuple[float, float] | None, value: float) -> tuple[float, float]:
    return (value, value) if interval is None else interval


def is_uncertain(walk: Walk) -> bool:
    """Whether any value has an interval."""
    low, high = walk.lower, walk.upper
    rubbing = low.friction != high.friction or any(np.any(shift) for shift in high.shift.values())
    return bool(low.bodies) or rubbing or bool(np.any(low.error != high.error))


def stance_name(stance: Stance) -> str:
    """Name of the contact limit of a stance."""
    alone = len(stance.contacts) == 1
    return f"contact of {stance.contacts[0] if alone else stance.words}"


def record(
    name: str, at: Indices, utilisation: Array, parameters: Sequence[Mapping[str, object]], tally: Tally
) -> None:
    """Keep the worst on the grid and between grid points of some instants."""
    for grid in (True, False):
        here = np.flatnonzero(tally.grid[at] == grid)
        if len(here):
            t = int(here[np.argmax(utilisation[here])])
            tally.add(name, Found(float(utilisation[t]), int(at[t]), name, parameters[t]))


def inward(walk: Walk) -> dict[str, Array]:
    """Displacements of the contact points towards the middle of theirs: the hull of all others holds these."""
    shifts = {}
    for name, sole in walk.walker.contacts.items():
        away = sole.points[:, :2] - sole.points[:, :2].mean(axis=0)
        shifts[name] = -np.sign(away) * walk.upper.shift[name]
    return shifts


@dataclass(frozen=True, eq=False)
class Hold:
    """Contact points of a stance for force programs: about its `center` (3,) [m], in units of `LENGTH`, and in `axes`
    (3, 3), as columns, along whose z all contact forces have a positive part."""

    contacts: Contacts
    center: Array
    axes: Array

    def scaled(self, wrench: Array, weight: float) -> Array:
        """Wrenches about the world's origin (T, 6) [N, N m] in these axes and units, (6, T), forces by the weight."""
        moment = wrench[:, 3:] - np.cross(self.center, wrench[:, :3])
        return np.concatenate([wrench[:, :3] @ self.axes, moment @ self.axes / LENGTH], axis=1).T / weight

    def direction(self, y: Array, weight: float) -> Array:
        """The directions d (T, 6) for which d wrench = y scaled(wrench), y (6, T)."""
        force, moment = y[:3].T @ self.axes.T / weight, y[3:].T @ self.axes.T / (weight * LENGTH)
        # y (force) + y (moment - center x force), transposed
        return np.concatenate([force + np.cross(self.center, moment), moment], axis=1)


def hold(walk: Walk, places: Mapping[str, Place], friction: Mapping[str, Any], shift: Mapping[str, Array]) -> Hold:
    """The contact points of a stance. friction: number or (T,) of each contact; shift: (k, 2) or (k, 2, T)."""
    center = np.mean([place.position for place in places.values()], axis=0)
    normals = [place.axes[:, 2] for place in places.values()]
    common = common_direction(normals, [walk.upper.friction[name] for name in places])
    assert common is not None, "checked when the configuration was read"
    level = all(np.array_equal(normal, common) for normal in normals)
    axes = np.eye(3) if level else contact_axes(common, np.eye(3)[int(np.argmin(np.abs(common)))])
    faces, points, mu, first = [], [], [], 0
    for name, place in places.items():
        moved = shift[name] if shift[name].ndim == 3 else shift[name][:, :, None]
        flat = walk.walker.contacts[name].points[:, :2, None] + moved
        world = place.position[:, None] + np.einsum("ij,kjt->kit", place.axes[:, :2], flat)
        points.append(np.einsum("ij,kit->jkt", axes, world - center[:, None]) / LENGTH)
        mu.append(np.tile(np.atleast_1d(friction[name]), (len(flat), 1)))
        faces.append(Face(first, first + len(flat), 0, -1, None if level else axes.T @ place.axes))
        first += len(flat)
    return Hold(Contacts(tuple(faces), np.concatenate(points, axis=1), np.concatenate(mu)), center, axes)


def described(walk: Walk, values: Values) -> dict[str, object]:
    """Values in the configuration's words, as far as they are uncertain or matter."""
    described: dict[str, object] = {"friction": {name: float(mu) for name, mu in values.friction.items()}}
    names = walk.walker.joint_names
    error = {name: float(e) for name, e in zip(names, values.error, strict=True) if e}
    if error:
        described["acceleration"] = error
    if any(np.any(shift) for shift in values.shift.values()):
        described["contact_points"] = {name: float(np.abs(shift).max()) for name, shift in values.shift.items()}
    for name, (mass, center) in values.bodies.items():
        described[name] = {"mass": mass, "center_of_mass": center.tolist()}
    return described
