"""Joint torques on several environment contacts, for the sharing that uses the joint limits least."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.optimize import linprog

from robustopt.arrays import Array, Indices
from robustopt.certificate.balance import required_by_base
from robustopt.certificate.contact_points import Contacts
from robustopt.certificate.joints import tell_torque, torques
from robustopt.certificate.loads import body_loads
from robustopt.certificate.motion import Joints
from robustopt.certificate.systems import System
from robustopt.certificate.tally import Tally
from robustopt.certificate.world import World
from robustopt.certificate.worst import Search
from robustopt.errors import SolverFailed

EDGES = 32
"""Number of edges of the friction cones in the torque programs; they lie inside the exact cones."""


def check_shared_torque(
    search: Search, searched: Indices, joints: Joints, limits: Array, most: int, tally: Tally
) -> None:
    """Check the joint torques of a robot with a floating base in a stance on several contacts.

    The contact points are displaced towards the middle of their contact: the hull of any other displaced points
    contains these.

    Args:
        search: search for the values that are worst for the contacts.
        searched: indices of the searched instants among those of the stance.
        joints: joints at the instants of the stance.
        limits: torque limits (m,).
        most: largest number of instants to check.
        tally: receives the worst utilisations.
    """
    world, system = search.world, search.system
    chosen = searched[np.unique(np.linspace(0, len(searched) - 1, min(most, len(searched))).astype(int))]
    values = replace(search.worst.at(chosen), shift=np.repeat(_inward(world)[..., None], len(chosen), axis=2))
    motion, joints = search.motion.at(chosen), joints.at(chosen)
    loads = body_loads(world, motion, values)
    rows = system.loads[0].matrix @ required_by_base(world, motion, loads, values.error)
    contacts = system.contact_points(values.friction, values.shift)
    utilisation = np.zeros((len(limits), len(chosen)))
    for squeeze in {world.lower.force[-1], world.upper.force[-1]}:
        values.force[-1] = squeeze
        torque = torques(world, joints, motion.free, loads, values) / limits[:, None]
        for t in range(len(chosen)):
            generators, pull = _generators(world, system, contacts[np.array([t])], joints.at(np.array([t])))
            pull = pull / limits[:, None]
            share = _sharing(generators, pull, rows[:, t], torque[:, t])
            utilisation[:, t] = np.maximum(utilisation[:, t], np.abs(torque[:, t] - pull @ share))
    for j, own in enumerate(utilisation):
        tell_torque(world, own, j, values, search.index[chosen], tally)


def _inward(world: World) -> Array:
    """Return the displacements (2, Q) of all contact points towards the middle of their contacts."""
    away = [contact.patch.polygon - contact.patch.polygon.mean(axis=0) for contact in world.contacts]
    return np.asarray(-np.sign(np.concatenate(away).T) * world.upper.shift)


def _generators(world: World, system: System, contacts: Contacts, joints: Joints) -> tuple[Array, Array]:
    """Return the rows (6, g) of the edges of all friction cones, and the joint torques (m, g) that they replace."""
    angle = 2.0 * np.pi * np.arange(EDGES) / EDGES
    edges = np.stack([np.ones(EDGES), np.cos(angle), np.sin(angle)])
    rows, pulls = [], []
    for index, face in zip(system.contacts, system.faces, strict=True):
        forces = np.repeat(edges[:, :, None], face.last - face.first, axis=2)[..., None]
        own = contacts.wrenches(face, forces).reshape(6, -1)
        rows.append(own)
        pull = joints.pulls[world.contacts[index].patch.name][:, :, 0]
        pulls.append(pull @ np.linalg.solve(system.loads[0].matrix, own))
    return np.hstack(rows), np.hstack(pulls)


def _sharing(generators: Array, pull: Array, rows: Array, torque: Array) -> Array:
    """Return the forces along the generators (g,) that supply the rows (6,) and use the joint limits least.

    Args:
        generators: rows of the generators (6, g).
        pull: torques that they replace, as shares of the limits (m, g).
        rows: rows that the base requires (6,).
        torque: torques without contacts, as shares of the limits (m,).
    """
    count, one = generators.shape[1], np.ones((len(torque), 1))
    lacking = generators.mean(axis=1)
    wrench = np.column_stack([generators, -lacking, np.zeros(6)])
    share = np.hstack([pull, np.zeros((len(torque), 1))])
    answer = linprog(
        np.r_[np.zeros(count), 1e3, 1.0], A_ub=np.vstack([np.hstack([-share, -one]), np.hstack([share, -one])]),
        b_ub=np.r_[-torque, torque], A_eq=wrench, b_eq=rows, bounds=(0.0, None), method="highs",
    )  # fmt: skip
    if answer.x is None:
        raise SolverFailed(f"the torques on several contacts could not be found: {answer.message}")
    return np.asarray(answer.x[:count])
