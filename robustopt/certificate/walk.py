"""A plan of a robot on its feet at many instants, the ends of all uncertain values, and their contact points."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from robustopt.certificate.contact_points import Array, Contacts, Face, Indices
from robustopt.certificate.motion import Instants
from robustopt.certificate.tally import Found, Tally
from robustopt.config import BASE_COORDINATES as BASE
from robustopt.config import FEET, Config
from robustopt.path.walking_path import WalkingPath
from robustopt.robot.walker import Walker

if TYPE_CHECKING:
    from robustopt.timescaling import Plan

LENGTH = 0.1
"""Unit of length of the force programs [m]: about half a foot."""


@dataclass(frozen=True)
class Values:
    """Uncertain values: friction of the feet (2,), displacement of every contact point (2, k, 2) [m], error of the
    acceleration (n,), and by body its mass [kg] and centre of mass (3,) [m]."""

    friction: Array
    shift: Array
    error: Array
    bodies: Mapping[str, tuple[float, Array]]


@dataclass(frozen=True, eq=False)
class Walk:
    """A plan at T instants: path coordinates and their rates (T, n), and which stance each belongs to (T,).

    free: 1 where the robot moves, 0 where it stands still; lower, upper: ends of all values
    """

    config: Config
    walker: Walker
    path: WalkingPath
    q: Array
    qd: Array
    qdd: Array
    free: Array
    stance: Indices
    lower: Values
    upper: Values

    def needs(self, at: Indices, bodies: Mapping[str, tuple[float, Array]]) -> tuple[Array, Array, dict[str, Array]]:
        """Generalised force (T, n), per acceleration error (T, n, n), and Jacobians of the feet at some instants."""
        return self.walker.inverse_dynamics(self.q[at], self.qd[at], self.qdd[at], bodies)


def walk_of(config: Config, plan: Plan, at: Instants) -> Walk:
    """Motion of a plan at some instants; at a switch, they belong to the one of its two stances that is on one foot."""
    walker, path = plan.problem.robot, plan.problem.path
    assert isinstance(walker, Walker)
    assert isinstance(path, WalkingPath)
    q, q1, q2 = (path.evaluate(at.node_s, at.node_piece, order)[at.node] for order in range(3))
    sd, u, x = np.sqrt(at.x)[:, None], at.u[:, None], at.x[:, None]
    borders = np.array([stance.begin for stance in path.stances[1:]])
    before = np.searchsorted(borders, at.s, side="left")
    after = np.searchsorted(borders, at.s, side="right")
    single = np.array([len(stance.feet) == 1 for stance in path.stances])
    lower, upper = _ends(config, walker)
    return Walk(
        config, walker, path, q, q1 * sd, q1 * u + q2 * x, at.free, np.where(single[after], after, before), lower, upper
    )


def _ends(config: Config, walker: Walker) -> tuple[Values, Values]:
    """Lowest and highest of all values, read from the configuration."""
    belief, interval = config.contact.friction, config.uncertainty.friction
    friction = np.array([_pair(_of(interval, name), _of(belief, name)) for name in FEET])
    shift = np.array([_of(config.uncertainty.contact_points, name) or 0.0 for name in FEET])
    shifts = shift[:, None, None] * np.ones((2, len(walker.feet[FEET[0]].points), 2))
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
    lower = Values(friction[:, 0], -shifts, low, dict(sorted(ends[0].items())))
    return lower, Values(friction[:, 1], shifts, high, dict(sorted(ends[1].items())))


def _of(given: object, name: str) -> object:
    return given.get(name, given.get("default")) if isinstance(given, Mapping) else given


def _pair(interval: object, value: object) -> object:
    return (value, value) if interval is None else interval


def is_uncertain(walk: Walk) -> bool:
    """Whether any value has an interval."""
    low, high = walk.lower, walk.upper
    pairs = ((low.friction, high.friction), (low.shift, high.shift), (low.error, high.error))
    return bool(low.bodies) or any(np.any(a != b) for a, b in pairs)


def stance_name(feet: Sequence[str]) -> str:
    """Name of the contact limit of a stance."""
    return "contact of " + (feet[0] if len(feet) == 1 else "both feet")


def record(
    name: str, at: Indices, utilisation: Array, parameters: Sequence[Mapping[str, object]], tally: Tally
) -> None:
    """Keep the worst on the grid and between grid points of some instants."""
    for grid in (True, False):
        here = np.flatnonzero(tally.grid[at] == grid)
        if len(here):
            t = int(here[np.argmax(utilisation[here])])
            tally.add(name, Found(float(utilisation[t]), int(at[t]), name, parameters[t]))


def inward(walk: Walk) -> Array:
    """Displacements of the contact points towards the middle of their foot: the hull of all others holds theirs."""
    points = np.stack([walk.walker.feet[name].points[:, :2] for name in FEET])
    return -np.sign(points - points.mean(axis=1, keepdims=True)) * walk.upper.shift


def contact_points(walk: Walk, places: Mapping[str, Array], friction: Array, shift: Array) -> tuple[Contacts, Array]:
    """Contact points of a stance about its centre in units of `LENGTH`, and the centre (3,) [m].

    friction: (2,) or (2, T); shift: (2, k, 2) or (2, k, 2, T)
    """
    shift = shift if shift.ndim == 4 else shift[..., None]
    friction = friction if friction.ndim == 2 else friction[:, None]
    faces, points, mu, first = [], [], [], 0
    for name, place in places.items():
        foot, own = FEET.index(name), walk.walker.feet[name].points
        flat = (own[:, :2] + place)[:, :, None] + shift[foot]
        points.append(np.concatenate([flat, np.zeros((len(own), 1, flat.shape[2]))], axis=1))
        mu.append(np.repeat(friction[foot][None], len(own), axis=0))
        faces.append(Face(first, first + len(own), 0, -1))
        first += len(own)
    center = np.append(np.mean(list(places.values()), axis=0), 0.0)
    stacked = np.concatenate(points).transpose(1, 0, 2)
    return Contacts(tuple(faces), (stacked - center[:, None, None]) / LENGTH, np.concatenate(mu)), center


def described(walk: Walk, values: Values) -> dict[str, object]:
    """Values in the configuration's words, as far as they are uncertain or matter."""
    described: dict[str, object] = {"friction": dict(zip(FEET, values.friction.tolist(), strict=True))}
    names = walk.walker.joint_names
    error = {name: float(e) for name, e in zip(names, values.error, strict=True) if e}
    if error:
        described["acceleration"] = error
    if np.any(values.shift):
        described["contact_points"] = dict(zip(FEET, np.abs(values.shift).max(axis=(1, 2)).tolist(), strict=True))
    for name, (mass, center) in values.bodies.items():
        described[name] = {"mass": mass, "center_of_mass": center.tolist()}
    return described
