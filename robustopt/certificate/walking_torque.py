"""Joint torques of a robot on its feet: known on one foot alone, else those of the sharing that spares joints most."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy.optimize import linprog

from robustopt.certificate.contact_points import Array, Indices
from robustopt.certificate.tally import Tally
from robustopt.certificate.walk import LENGTH, Values, Walk, inward, record
from robustopt.config import BASE_COORDINATES as BASE
from robustopt.errors import SolverFailed
from robustopt.path.footsteps import Place

EDGES = 32
"""Edges of the friction cones in the programs for the torques: inside the exact cones."""


def check_torque(walk: Walk, worst: Mapping[int, Values], shared: int, tally: Tally) -> None:
    """Torques of all joints on one foot alone, and on several contacts at some instants, each for the values that
    contacts like least and as configured."""
    for k, stance in enumerate(walk.path.stances):
        at = np.flatnonzero(walk.stance == k)
        single = len(stance.contacts) == 1
        count = sum(len(other.contacts) > 1 for other in walk.path.stances)
        if not single and len(at) > shared // count:
            at = at[np.unique(np.linspace(0, len(at) - 1, shared // count).astype(int))]
        if len(at):
            _check_stance_torque(walk, at, stance.places, worst, tally)


def _check_stance_torque(
    walk: Walk, at: Indices, places: Mapping[str, Place], worst: Mapping[int, Values], tally: Tally
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
        record(f"{joint} torque", at, utilisation[:, j], [{}] * len(at), tally)
    tally.tests += utilisation.size


def _shared_torque(walk: Walk, places: Mapping[str, Place], force: Array, jacobians: Mapping[str, Array]) -> Array:
    """Sizes of the torques (T, n - 6) with the sharing of the load that uses the joints' limits least.

    force: generalised force (T, n) that is needed
    """
    angle, shift = 2.0 * np.pi * np.arange(EDGES) / EDGES, inward(walk)
    columns, parts, first = [], {}, 0
    for name, place in places.items():
        mu, points = walk.lower.friction[name], place.world(walk.walker.contacts[name].points[:, :2] + shift[name])
        edges = np.column_stack([mu * np.cos(angle), mu * np.sin(angle), np.ones(EDGES)]) @ place.axes.T
        forces, arms = np.tile(edges, (len(points), 1)), np.repeat(points, EDGES, axis=0)
        columns.append(np.column_stack([forces, np.cross(arms, forces)]).T)
        parts[name] = slice(first, first + len(forces))
        first += len(forces)
    generators = np.hstack(columns)
    limit = walk.walker.limits.torque[BASE:]
    result = np.empty((len(force), len(limit)))
    for t, need in enumerate(force):
        pull = np.zeros((len(limit), generators.shape[1]))
        for name, part in parts.items():
            pull[:, part] = jacobians[name][t][:, BASE:].T @ generators[:, part]
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
        raise SolverFailed(f"the torques on several contacts could not be found: {answer.message}")
    return np.asarray(answer.x[:count] * weight)
