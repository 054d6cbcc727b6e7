"""Limits of a robot on its feet, checked from first principles.

The motion of an instant goes through MuJoCo's inverse dynamics with the masses and centres of mass at hand; what the
base needs must come from contact forces at the corners of the standing feet, and of a hand on a rail, in their exact
Coulomb cones (see `force_closure`).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import product
from typing import TYPE_CHECKING

import numpy as np

from robustopt.certificate.contact_points import Array, Indices
from robustopt.certificate.force_closure import gauge_from_rest
from robustopt.certificate.motion import Instants
from robustopt.certificate.tally import Found, Tally
from robustopt.certificate.walk import (
    Hold,
    Values,
    Walk,
    described,
    hold,
    inward,
    is_uncertain,
    record,
    stance_name,
    walk_of,
)
from robustopt.certificate.walking_torque import check_torque
from robustopt.config import BASE_COORDINATES as BASE
from robustopt.config import Config
from robustopt.path.footsteps import Place

if TYPE_CHECKING:
    from robustopt.solvers import Plan

DRIFT = 1e-4
"""How far a point of a standing foot may be from its place on the path [m]: a tenth of what a robot is built to."""

ROUNDS = 3
"""A direction changes which parameters are worst, they have another direction."""

SHARED_INSTANTS = {"quick": 40, "full": 400}
"""Instants on several contacts whose torques are looked at, for the values that the contacts like least."""

INSTANTS_PER_DRAW = 16
"""Instants that a random draw of all values is looked at."""


def check_walk(config: Config, plan: Plan, at: Instants, level: str, draws: int, seed: int, tally: Tally) -> int:
    """Look at all limits of a plan of a robot on its feet; returns the number of random draws."""
    walk = walk_of(config, plan, at)
    _check_kinematics(walk, tally)
    _check_places(walk, tally)
    worst = _check_contacts(walk, tally)
    check_torque(walk, worst, SHARED_INSTANTS[level], tally)
    if not is_uncertain(walk):
        return 0
    _check_draws(walk, draws, np.random.default_rng(seed), tally)
    return draws


def _check_kinematics(walk: Walk, tally: Tally) -> None:
    """Position, velocity and acceleration of the joints; the acceleration with the worse end of its error."""
    limits, names = walk.walker.limits, walk.walker.joint_names
    free = walk.free[:, None]
    acceleration = np.maximum(walk.qdd + walk.upper.error * free, -walk.qdd - walk.lower.error * free)
    limited = np.isfinite(limits.lower[BASE:]) & np.isfinite(limits.upper[BASE:])
    low, high = np.where(limited, limits.lower[BASE:], -1.0), np.where(limited, limits.upper[BASE:], 1.0)
    kinds = {
        "position": np.where(limited, _position(walk.q[:, BASE:], low, high), 0.0),
        "velocity": np.abs(walk.qd[:, BASE:]) / limits.velocity[BASE:],
        "acceleration": acceleration[:, BASE:] / limits.acceleration[BASE:],
    }
    for kind, utilisation in kinds.items():
        for j, joint in enumerate(names[BASE:]):
            _record(f"{joint} {kind}", utilisation[:, j], tally)
        tally.tests += utilisation.size


def _position(q: Array, low: Array, high: Array) -> Array:
    """Distance from the middle of the range as a share of half the range."""
    return np.asarray(np.abs(q - 0.5 * (low + high)) / (0.5 * (high - low)))


def _check_places(walk: Walk, tally: Tally) -> None:
    """Contacts stay where they are."""
    found = walk.walker.contact_points(walk.q)
    drift = np.zeros(len(walk.q))
    for k, stance in enumerate(walk.path.stances):
        at = walk.stance == k
        for name, place in stance.places.items():
            points = place.world(walk.walker.contacts[name].points)
            drift[at] = np.maximum(drift[at], np.linalg.norm(found[name][at] - points, axis=2).max(axis=1, initial=0.0))
    _record("contacts in place", drift / DRIFT, tally)
    tally.tests += len(drift)


def _record(name: str, utilisation: Array, tally: Tally, parameters: Sequence[Mapping[str, object]] = ()) -> None:
    for t in tally.peaks(utilisation):
        found = parameters[t] if parameters else {}
        tally.add(name, Found(float(utilisation[t]), t, name, found))


def _check_contacts(walk: Walk, tally: Tally) -> Mapping[int, Values]:
    """Contact forces for the values that are worst, found by the directions of the programs; those, by instant."""
    worst: dict[int, Values] = {}
    for k, stance in enumerate(walk.path.stances):
        at = np.flatnonzero(walk.stance == k)
        if len(at):
            worst |= _check_stance(walk, at, stance_name(stance), stance.places, tally)
    return worst


def _check_stance(walk: Walk, at: Indices, name: str, places: Mapping[str, Place], tally: Tally) -> dict[int, Values]:
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
    held = hold(walk, places, walk.lower.friction, inward(walk))
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
        value, y = _gauge(held, wrench, weight)
        better = value > reached
        reached = np.maximum(reached, value)
        values = [
            Values(walk.lower.friction, inward(walk), error[t], _named(walk, {b: int(chosen[b][t]) for b in chosen}))
            for t in range(len(at))
        ]
        result |= {int(at[t]): values[t] for t in np.flatnonzero(better)}
        tally.tests += len(at)
        if not is_uncertain(walk):
            break
        push = (inertia[:, :BASE].transpose(0, 2, 1) @ y[:, :, None])[:, :, 0]
        error = np.where(push < 0.0, walk.upper.error, walk.lower.error) * free
        for body, options in changes.items():
            gain = [np.einsum("tk,tk->t", y, its_force[:, :BASE]) for its_force, _ in options]
            chosen[body] = np.argmin(gain, axis=0)
    record(name, at, reached, [described(walk, result[int(t)]) for t in at], tally)
    return result


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


def _gauge(held: Hold, wrench: Array, weight: float) -> tuple[Array, Array]:
    """Utilisation of the contacts (T,) for wrenches about the world's origin (T, 6), seen from an even pressure, and
    the direction of the nearest limit for these wrenches (T, 6), in which they are worst where it is lowest."""
    even = np.zeros((6, len(wrench)))
    even[2] = 1.0
    answer = gauge_from_rest(held.contacts, even, held.scaled(wrench, weight) - even)
    return answer.value, held.direction(answer.y, weight)


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
    names = walk.walker.contacts
    friction = {name: np.array([values.friction[name] for values, _ in chosen]) for name in names}
    shift = {name: np.stack([values.shift[name] for values, _ in chosen], axis=-1) for name in names}
    for k, stance in enumerate(walk.path.stances):
        here = np.flatnonzero(walk.stance[instant] == k)
        if len(here):
            drawn = {name: mu[draw[here]] for name, mu in friction.items()}
            held = hold(walk, stance.places, drawn, {name: away[..., draw[here]] for name, away in shift.items()})
            value, _ = _gauge(held, wrench.reshape(-1, BASE)[here], walk.walker.mass * 9.81)
            parameters = [described(walk, chosen[draw[i]][0]) for i in here]
            record(stance_name(stance), instant[here], value, parameters, tally)
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
    friction = between(np.array(list(low.friction.values())), np.array(list(high.friction.values())))
    return Values(
        dict(zip(low.friction, friction.tolist(), strict=True)),
        {name: between(shift, high.shift[name]) for name, shift in low.shift.items()},
        between(low.error, high.error),
        bodies,
    )
