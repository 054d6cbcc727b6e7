"""Limits of a robot on its feet, checked from first principles.

The motion of an instant goes through MuJoCo's inverse dynamics with the masses and centres of mass at hand; what the
base needs must come from contact forces at the corners of the standing feet, in their exact Coulomb cones (see
`force_closure`). On two feet the torques are those of the sharing that spares the joints most, a linear program.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import TYPE_CHECKING

import numpy as np
from scipy.optimize import linprog

from robustopt.certificate.contact_points import Array, Contacts, Face, Indices
from robustopt.certificate.force_closure import gauge_from_rest
from robustopt.certificate.motion import Instants
from robustopt.certificate.tally import Found, Tally
from robustopt.config import Config
from robustopt.config_model import BASE_COORDINATES as BASE
from robustopt.config_model import FEET
from robustopt.errors import SolverFailed
from robustopt.walker import Walker
from robustopt.walking_path import WalkingPath

if TYPE_CHECKING:
    from robustopt.timescaling import Plan

LENGTH = 0.1
"""Unit of length of the force programs [m]: about half a foot."""

DRIFT = 1e-4
"""How far a point of a standing foot may be from its place on the path [m]: a tenth of what a robot is built to."""

ROUNDS = 3
"""A direction changes which parameters are worst, they have another direction."""

EDGES = 32
"""Edges of the friction cones in the programs for the torques: inside the exact cones."""

SHARED_INSTANTS = {"quick": 40, "full": 400}
"""Instants on two feet whose torques are looked at, for the values that the contacts like least."""

INSTANTS_PER_DRAW = 16
"""Instants that a random draw of all values is looked at."""


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


def check_walk(config: Config, plan: Plan, at: Instants, level: str, draws: int, seed: int, tally: Tally) -> int:
    """Look at all limits of a plan of a robot on its feet; returns the number of random draws."""
    walk = _walk(config, plan, at)
    _check_kinematics(walk, tally)
    _check_feet(walk, tally)
    worst = _check_contacts(walk, tally)
    _check_torque(walk, worst, SHARED_INSTANTS[level], tally)
    if not _uncertain(walk):
        return 0
    _check_draws(walk, draws, np.random.default_rng(seed), tally)
    return draws


def _walk(config: Config, plan: Plan, at: Instants) -> Walk:
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


def _uncertain(walk: Walk) -> bool:
    low, high = walk.lower, walk.upper
    pairs = ((low.friction, high.friction), (low.shift, high.shift), (low.error, high.error))
    return bool(low.bodies) or any(np.any(a != b) for a, b in pairs)


# Joints and feet ------------------------------------------------------------------------------------------


def _check_kinematics(walk: Walk, tally: Tally) -> None:
    """Position, velocity and acceleration of the joints; the acceleration with the worse end of its error."""
    limits, names = walk.walker.limits, walk.walker.joint_names
    free = walk.free[:, None]
    acceleration = np.maximum(walk.qdd + walk.upper.error * free, -walk.qdd - walk.lower.error * free)
    low, high = limits.lower[BASE:], limits.upper[BASE:]
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    kinds = {
        "position": np.abs(walk.q[:, BASE:] - middle) / half,
        "velocity": np.abs(walk.qd[:, BASE:]) / limits.velocity[BASE:],
        "acceleration": acceleration[:, BASE:] / limits.acceleration[BASE:],
    }
    for kind, utilisation in kinds.items():
        for j, joint in enumerate(names[BASE:]):
            _record(f"{joint} {kind}", utilisation[:, j], tally)
        tally.tests += utilisation.size


def _check_feet(walk: Walk, tally: Tally) -> None:
    """Standing feet stay where they are."""
    soles = walk.walker.soles(walk.q)
    drift = np.zeros(len(walk.q))
    for k, stance in enumerate(walk.path.stances):
        at = walk.stance == k
        for name, place in stance.places.items():
            points = walk.walker.feet[name].points + np.append(place, 0.0)
            drift[at] = np.maximum(drift[at], np.linalg.norm(soles[name][at] - points, axis=2).max(axis=1, initial=0.0))
    _record("standing feet in place", drift / DRIFT, tally)
    tally.tests += len(drift)


def _record(name: str, utilisation: Array, tally: Tally, parameters: Sequence[Mapping[str, object]] = ()) -> None:
    for t in tally.peaks(utilisation):
        found = parameters[t] if parameters else {}
        tally.add(name, Found(float(utilisation[t]), t, name, found))


# Contacts -------------------------------------------------------------------------------------------------


def _check_contacts(walk: Walk, tally: Tally) -> Mapping[int, Values]:
    """Contact forces for the values that are worst, found by the directions of the programs; those, by instant."""
    worst: dict[int, Values] = {}
    for k, stance in enumerate(walk.path.stances):
        at = np.flatnonzero(walk.stance == k)
        if len(at):
            worst |= _check_stance(walk, at, stance_name(stance.feet), stance.places, tally)
    return worst


def stance_name(feet: Sequence[str]) -> str:
    """Name of the contact limit of a stance."""
    return "contact of " + (feet[0] if len(feet) == 1 else "both feet")


def _check_stance(walk: Walk, at: Indices, name: str, places: Mapping[str, Array], tally: Tally) -> dict[int, Values]:
    corners = list(_corners(walk))
    needs = [walk.needs(at, bodies)[:2] for bodies in corners]
    nominal = needs[0]
    changes = {
        body: [need for corner, need in zip(corners, needs, strict=True) if body in corner]
        for body in walk.lower.bodies
    }
    chosen = {body: np.zeros(len(at), dtype=np.intp) for body in changes}
    free = walk.free[at][:, None]
    error = 0.5 * (walk.lower.error + walk.upper.error) * free
    contacts, center = _contacts(walk, places, walk.lower.friction, _inward(walk))
    weight = walk.walker.mass * 9.81
    reached = np.full(len(at), -np.inf)
    result: dict[int, Values] = {}
    for _ in range(ROUNDS):
        force, inertia = (part.copy() for part in nominal)
        for body, options in changes.items():
            for option, (its_force, its_inertia) in enumerate(options):
                here = chosen[body] == option
                force[here] += (its_force - nominal[0])[here]
                inertia[here] += (its_inertia - nominal[1])[here]
        wrench = force[:, :BASE] + (inertia[:, :BASE] @ error[:, :, None])[:, :, 0]
        value, y = _gauge(contacts, center, wrench, weight)
        better = value > reached
        reached = np.maximum(reached, value)
        values = [
            Values(walk.lower.friction, _inward(walk), error[t], _named(walk, {b: int(chosen[b][t]) for b in chosen}))
            for t in range(len(at))
        ]
        result |= {int(at[t]): values[t] for t in np.flatnonzero(better)}
        tally.tests += len(at)
        if not _uncertain(walk):
            break
        push = (inertia[:, :BASE].transpose(0, 2, 1) @ y[:, :, None])[:, :, 0]
        error = np.where(push < 0.0, walk.upper.error, walk.lower.error) * free
        for body, options in changes.items():
            gain = [np.einsum("tk,tk->t", y, its_force[:, :BASE]) for its_force, _ in options]
            chosen[body] = np.argmin(gain, axis=0)
    _record_some(name, at, reached, [_described(walk, result[int(t)]) for t in at], tally)
    return result


def _record_some(
    name: str, at: Indices, utilisation: Array, parameters: Sequence[Mapping[str, object]], tally: Tally
) -> None:
    """Keep the worst on the grid and between grid points of some instants."""
    for grid in (True, False):
        here = np.flatnonzero(tally.grid[at] == grid)
        if len(here):
            t = int(here[np.argmax(utilisation[here])])
            tally.add(name, Found(float(utilisation[t]), int(at[t]), name, parameters[t]))


def _corners(walk: Walk) -> Iterator[dict[str, tuple[float, Array]]]:
    """Values as in the model, then for one body at a time every corner of its mass and centre of mass."""
    yield {}
    for name, low in walk.lower.bodies.items():
        for mass, *center in _body_corners(low, walk.upper.bodies[name]):
            yield {name: (float(mass), np.array(center))}


def _body_corners(low: tuple[float, Array], high: tuple[float, Array]) -> list[tuple[float, ...]]:
    sides = [(low[0], high[0]), *zip(low[1].tolist(), high[1].tolist(), strict=True)]
    return list(product(*[dict.fromkeys(side) for side in sides]))


def _named(walk: Walk, chosen: Mapping[str, int]) -> dict[str, tuple[float, Array]]:
    """Mass and centre of mass of each body by the index of its corner."""
    corners = {name: _body_corners(low, walk.upper.bodies[name]) for name, low in walk.lower.bodies.items()}
    return {name: (corners[name][k][0], np.array(corners[name][k][1:])) for name, k in chosen.items()}


def _inward(walk: Walk) -> Array:
    """Displacements of the contact points towards the middle of their foot: the hull of all others holds theirs."""
    points = np.stack([walk.walker.feet[name].points[:, :2] for name in FEET])
    return -np.sign(points - points.mean(axis=1, keepdims=True)) * walk.upper.shift


def _contacts(walk: Walk, places: Mapping[str, Array], friction: Array, shift: Array) -> tuple[Contacts, Array]:
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


def _gauge(contacts: Contacts, center: Array, wrench: Array, weight: float) -> tuple[Array, Array]:
    """Utilisation of the contacts (T,) for wrenches about the world's origin (T, 6), seen from an even pressure, and
    the direction of the nearest limit for these wrenches (T, 6), in which they are worst where it is lowest."""
    scaled = wrench.copy()
    scaled[:, 3:] -= np.cross(center, wrench[:, :3])
    scaled /= weight * np.r_[np.ones(3), np.full(3, LENGTH)]
    even = np.zeros((6, len(wrench)))
    even[2] = 1.0
    answer = gauge_from_rest(contacts, even, scaled.T - even)
    y = answer.y.T / (weight * np.r_[np.ones(3), np.full(3, LENGTH)])
    y[:, :3] += np.cross(center, y[:, 3:])  # y (force) + y (moment - center x force), transposed
    return answer.value, y


# Torques --------------------------------------------------------------------------------------------------


def _check_torque(walk: Walk, worst: Mapping[int, Values], shared: int, tally: Tally) -> None:
    """Torques of all joints on one foot, and on two at some instants, each for the values that contacts like least and
    as configured."""
    for k, stance in enumerate(walk.path.stances):
        at = np.flatnonzero(walk.stance == k)
        single = len(stance.feet) == 1
        count = sum(len(other.feet) > 1 for other in walk.path.stances)
        if not single and len(at) > shared // count:
            at = at[np.unique(np.linspace(0, len(at) - 1, shared // count).astype(int))]
        if len(at):
            _check_stance_torque(walk, at, stance.places, worst, tally)


def _check_stance_torque(
    walk: Walk, at: Indices, places: Mapping[str, Array], worst: Mapping[int, Values], tally: Tally
) -> None:
    force, inertia, jacobians = walk.needs(at, {})
    free = walk.free[at][:, None]
    limits, names = walk.walker.limits.torque, walk.walker.joint_names
    spread = 0.5 * (walk.upper.error - walk.lower.error) * free
    middle = 0.5 * (walk.upper.error + walk.lower.error) * free
    if len(places) == 1:
        name = next(iter(places))
        force = force + (inertia @ middle[:, :, None])[:, :, 0]
        pulled = np.swapaxes(jacobians[name], 1, 2)[:, BASE:]
        torque = force[:, BASE:] - (pulled @ force[:, :BASE, None])[:, :, 0]
        change = inertia[:, BASE:] - pulled @ inertia[:, :BASE]
        torque = np.abs(torque) + (np.abs(change) @ spread[:, :, None])[:, :, 0]
    else:
        errors = np.stack([worst[int(t)].error for t in at])
        force = force + (inertia @ errors[:, :, None])[:, :, 0]
        torque = _shared_torque(walk, places, force, jacobians)
    utilisation = torque / limits[BASE:]
    for j, joint in enumerate(names[BASE:]):
        _record_some(f"{joint} torque", at, utilisation[:, j], [{}] * len(at), tally)
    tally.tests += utilisation.size


def _shared_torque(walk: Walk, places: Mapping[str, Array], force: Array, jacobians: Mapping[str, Array]) -> Array:
    """Sizes of the torques (T, n - 6) with the sharing of the load that uses the joints' limits least.

    force: generalised force (T, n) that is needed
    """
    contacts, center = _contacts(walk, places, walk.lower.friction, _inward(walk))
    points = contacts.point[:, :, 0].T * LENGTH + center
    angle = 2.0 * np.pi * np.arange(EDGES) / EDGES
    parts = [np.column_stack([mu * np.cos(angle), mu * np.sin(angle), np.ones(EDGES)]) for mu in contacts.mu[:, 0]]
    edges = np.concatenate(parts)
    arms = np.repeat(points, EDGES, axis=0)
    generators = np.column_stack([edges, np.cross(arms, edges)]).T
    limit = walk.walker.limits.torque[BASE:]
    result = np.empty((len(force), len(limit)))
    for t, need in enumerate(force):
        pull = np.zeros((len(limit), generators.shape[1]))
        first = 0
        for name in places:
            size = len(walk.walker.feet[name].points) * EDGES
            part = slice(first, first + size)
            pull[:, part] = jacobians[name][t][:, BASE:].T @ generators[:, part]
            first += size
        result[t] = need[BASE:] - pull @ _shares(generators, pull, need, limit, walk.walker.mass * 9.81)
    return np.abs(result)


def _shares(generators: Array, pull: Array, need: Array, limit: Array, weight: float) -> Array:
    """Forces along the generators that make the wrench and use the joints least."""
    count = generators.shape[1]
    scale = np.r_[np.ones(3), np.full(3, 1.0 / LENGTH)]
    lacking = generators.mean(axis=1)
    wrench = np.column_stack([generators, -lacking, np.zeros(6)]) * scale[:, None]
    share = np.hstack([pull * weight / limit[:, None], np.zeros((len(limit), 1))])
    one = np.ones((len(limit), 1))
    rows = np.vstack([np.hstack([-share, -one]), np.hstack([share, -one])])
    torque = need[BASE:] / limit
    answer = linprog(
        np.r_[np.zeros(count), 1e3, 1.0], A_ub=rows, b_ub=np.r_[-torque, torque], A_eq=wrench,
        b_eq=need[:BASE] * scale / weight, bounds=(0.0, None), method="highs",
    )  # fmt: skip
    if answer.x is None:
        raise SolverFailed(f"the torques on two feet could not be found: {answer.message}")
    return np.asarray(answer.x[:count] * weight)


# Draws ----------------------------------------------------------------------------------------------------


def _check_draws(walk: Walk, draws: int, rng: np.random.Generator, tally: Tally) -> None:
    """Contact forces for random values of everything at random instants, half of them with all values at an end."""
    chosen: list[tuple[Values, Indices]] = []
    for k in range(draws):
        values = _draw(walk, rng, corner=k % 2 == 0)
        chosen.append((values, rng.integers(0, len(walk.q), INSTANTS_PER_DRAW)))
    wrench = np.empty((draws, INSTANTS_PER_DRAW, BASE))
    if walk.lower.bodies:
        for k, (values, at) in enumerate(chosen):
            force, inertia, _ = walk.needs(at, values.bodies)
            wrench[k] = force[:, :BASE] + (inertia[:, :BASE] @ values.error) * walk.free[at][:, None]
    else:
        force, inertia, _ = walk.needs(np.arange(len(walk.q)), {})
        for k, (values, at) in enumerate(chosen):
            wrench[k] = force[at, :BASE] + (inertia[at, :BASE] @ values.error) * walk.free[at][:, None]
    instant = np.concatenate([at for _, at in chosen])
    draw = np.repeat(np.arange(draws), INSTANTS_PER_DRAW)
    friction = np.stack([values.friction for values, _ in chosen], axis=-1)
    shift = np.stack([values.shift for values, _ in chosen], axis=-1)
    for k, stance in enumerate(walk.path.stances):
        here = np.flatnonzero(walk.stance[instant] == k)
        if len(here):
            contacts, center = _contacts(walk, stance.places, friction[:, draw[here]], shift[..., draw[here]])
            value, _ = _gauge(contacts, center, wrench.reshape(-1, BASE)[here], walk.walker.mass * 9.81)
            parameters = [_described(walk, chosen[draw[i]][0]) for i in here]
            _record_some(stance_name(stance.feet), instant[here], value, parameters, tally)
            tally.tests += len(here)


def _draw(walk: Walk, rng: np.random.Generator, corner: bool) -> Values:
    def between(low: Array, high: Array) -> Array:
        share = rng.random(np.shape(low))
        return np.asarray(low + (np.round(share) if corner else share) * (high - low))

    low, high = walk.lower, walk.upper
    bodies = {
        name: (float(between(np.array(mass), np.array(high.bodies[name][0]))), between(center, high.bodies[name][1]))
        for name, (mass, center) in low.bodies.items()
    }
    return Values(
        between(low.friction, high.friction), between(low.shift, high.shift), between(low.error, high.error), bodies
    )


def _described(walk: Walk, values: Values) -> dict[str, object]:
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
