"""Planned contact forces of a walking robot, shared among its contacts so that they vary smoothly along the plan.

`load_sharing` distributes the required wrench over the contacts: both feet, and a hand on a rail. While both feet
stand, the share of a foot that has landed rises and the share of a foot that will lift falls, so that its force does
not jump when the stance changes (our choice). The joint torques with these forces are the feedforward of an execution.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from robustopt.arrays import Array, Indices
from robustopt.config import BASE_COORDINATES as BASE
from robustopt.config import FEET
from robustopt.errors import Infeasible
from robustopt.limits.load_sharing import distribute, willingness
from robustopt.limits.torque_sharing import Sharing
from robustopt.path import Path
from robustopt.robot import Dynamics
from robustopt.solvers.trajectory import Trajectory

if TYPE_CHECKING:
    from robustopt.solvers.plan import Plan

FADE = 0.6
"""Part of a phase on both feet over which a foot fades in after landing, or fades out before lifting (our choice)."""

LEAST_SHARE = 1e-4
"""Share of a foot at the moment it lifts or lands, relative to 1 when it stands: 0 would make the program singular."""


@dataclass(frozen=True, eq=False)
class ContactForces:
    """Contact forces and joint torques of a plan at M instants, in the order of time.

    At the first and the last instant the robot stands still. In between are the start and the end of every interval, so
    a jump of sdd has two instants at the same time.

    Attributes:
        t: time (M,) [s].
        s: position along the path (M,).
        forces: force at each point of each contact, world frame, (M, k, 3) [N]; 0 for a foot in the air.
        points: certain contact points, world frame, (M, k, 3) [m]; the last ones for a foot in the air.
        axes: axes of each contact as columns, its normal last, world frame, (3, 3).
        torque: joint torques (M, n) [N m]; 0 for the base.
        residual: part of the required wrench that the forces miss, as a fraction of the weight (M,).
    """

    t: Array
    s: Array
    forces: Mapping[str, Array]
    points: Mapping[str, Array]
    axes: Mapping[str, Array]
    torque: Array
    residual: Array

    def total(self, contact: str) -> Array:
        """Return the force on a contact, world frame, (M, 3) [N].

        Args:
            contact: name of the contact.
        """
        return np.asarray(self.forces[contact].sum(axis=1))

    def pressed(self, contact: str) -> Array:
        """Return the force on a contact in its own axes, with the normal force last, (M, 3) [N].

        Args:
            contact: name of the contact.
        """
        return np.asarray(self.total(contact) @ self.axes[contact])

    def wrench(self, contact: str) -> Array:
        """Return the wrench on a contact about the centroid of its points, world axes, (M, 6) [N, N m].

        Args:
            contact: name of the contact.
        """
        arm = self.points[contact] - self.points[contact].mean(axis=1, keepdims=True)
        moment = np.cross(arm, self.forces[contact]).sum(axis=1)
        return np.concatenate([self.total(contact), moment], axis=1)

    def center_of_pressure(self, contact: str | None = None) -> Array:
        """Return the centre of pressure of a contact, or by default of both feet.

        Args:
            contact: name of the contact.

        Returns:
            x and y in the world (M, 2) [m]; nan without normal force.
        """
        names = FEET if contact is None else [contact]
        pressure = np.concatenate([self.forces[name] @ self.axes[name][:, 2] for name in names], axis=1)
        points = np.concatenate([self.points[name][..., :2] for name in names], axis=1)
        total = pressure.sum(axis=1)
        some = np.where(total > 1e-9 * total.max(initial=1.0), total, np.nan)
        return np.asarray((pressure[:, :, None] * points).sum(axis=1) / some[:, None])

    def sample(self, t: Array) -> tuple[Array, dict[str, Array]]:
        """Return joint torques and contact forces at given times, interpolated linearly, constant outside the plan.

        Args:
            t: times (T,) [s].

        Returns:
            Joint torques (T, n) [N m], and the force on each contact, world frame, (T, 3) [N].
        """
        late = np.searchsorted(self.t, t, side="right")
        first = np.clip(late - 1, 0, len(self.t) - 1)
        second = np.clip(late, 0, len(self.t) - 1)
        width = self.t[second] - self.t[first]
        part = np.divide(t - self.t[first], width, out=np.zeros(len(t)), where=width > 0)[:, None]

        def between(values: Array) -> Array:
            return np.asarray((1.0 - part) * values[first] + part * values[second])

        return between(self.torque), {name: between(self.total(name)) for name in self.forces}


def planned_forces(plan: Plan) -> ContactForces:
    """Return the contact forces of a plan of a walking robot.

    Args:
        plan: the plan.

    Raises:
        Infeasible: the plan has no timing, or the robot has no environment contacts.
    """
    if plan.x.size == 0:
        raise Infeasible(f"There are no contact forces: {plan.message}")
    problem = plan.problem
    sharing, path = problem.limits.torque.sharing, problem.path
    if not sharing.contacts:
        raise Infeasible("There are no environment contacts: the robot has no floating base.")
    trajectory = Trajectory.from_plan(plan)
    interval = np.arange(len(plan.u))
    points = np.concatenate([[0], np.column_stack([interval, interval + 1]).ravel(), [len(plan.s) - 1]])
    u = np.concatenate([[0.0], np.column_stack([plan.u, plan.u_end]).ravel(), [0.0]])
    x = np.concatenate([[0.0], plan.x[points[1:-1]], [0.0]])
    middle = np.concatenate([[0.0], np.repeat(0.5 * (plan.s[:-1] + plan.s[1:]), 2), [1.0]])
    phases = len(path.stances)
    stance = np.minimum((middle * phases).astype(int), phases - 1)
    required = _nominal_force(sharing, points, u, x)
    forces, corners, residual = _forces(sharing, path, plan.s[points], stance, required)
    return ContactForces(
        t=trajectory.times[points],
        s=plan.s[points],
        forces=forces,
        points=corners,
        axes={name: place.axes for name, place in path.stances[0].places.items()},
        torque=_torque(sharing.motion.dynamics, points, required, forces, corners),
        residual=residual,
    )


def _nominal_force(sharing: Sharing, points: Indices, u: Array, x: Array) -> Array:
    """Return the nominal generalised force at grid points (M,), without acceleration error, (M, n) [N, N m]."""
    dynamics = sharing.motion.dynamics
    force = dynamics.force_u[points] * u[:, None] + dynamics.force_x[points] * x[:, None] + dynamics.force_0[points]
    if dynamics.carrier is None:
        return force
    affine = np.stack([u, x, np.ones(len(u))], axis=1)
    return np.asarray(np.einsum("mdk,mk->md", sharing.loads.middle()[points], affine))


def _forces(
    sharing: Sharing, path: Path, s: Array, stance: Indices, required: Array
) -> tuple[dict[str, Array], dict[str, Array], Array]:
    """Return forces and points of all contacts (M, k, 3), and the part of the wrench that the forces miss (M,)."""
    count = {name: len(points) for name, points in sharing.soles.items()}
    forces = {name: np.zeros((len(s), k, 3)) for name, k in count.items()}
    corners = {name: np.zeros((len(s), k, 3)) for name, k in count.items()}
    residual = np.empty(len(s))
    for k, (family, own) in enumerate(zip(sharing.contacts, path.stances, strict=True)):
        here = np.flatnonzero(stance == k)
        system, parts = family.system, sharing.parts(k)
        shares = _shares(path, k, s[here])
        weights = np.empty((len(here), system.generators.shape[1]))
        for name, part in parts.items():
            weights[:, part] = shares[name][:, None]
        center = np.mean([own.places[name].position for name in own.places if name in FEET], axis=0)
        generators = system.about([center]).generators
        wrench = required[here, :BASE].copy()
        wrench[:, 3:] -= np.cross(center, wrench[:, :3])
        along, residual[here] = distribute(generators, weights, wrench, family.weight)
        for name, part in parts.items():
            pushes = along[:, None, part] * system.generators[:3, part]
            forces[name][here] = pushes.reshape(len(here), 3, count[name], system.edges).sum(axis=3).transpose(0, 2, 1)
        for name in count:
            corners[name][here] = _corners(sharing, path, k, name)
    return forces, corners, residual


def _corners(sharing: Sharing, path: Path, stance: int, name: str) -> Array:
    """Return the points of a contact (k, 3) in a stance, or in the last one before in which it rested."""
    while name not in path.stances[stance].places:
        stance -= 1
    return path.stances[stance].places[name].world(sharing.soles[name])


def _shares(path: Path, stance: int, s: Array) -> dict[str, Array]:
    """Return the relative share of each contact, (M,); that of a foot is lower after it lands and before it lifts."""
    own, stances = path.stances[stance], path.stances
    part = (s - own.begin) / (own.end - own.begin)
    shares = {}
    for name in own.places:
        share = np.full(len(s), willingness(name))
        if stance > 0 and name not in stances[stance - 1].places:
            share = np.minimum(share, _ramp(part / FADE))
        if stance + 1 < len(stances) and name not in stances[stance + 1].places:
            share = np.minimum(share, _ramp((1.0 - part) / FADE))
        shares[name] = share
    return shares


def _ramp(t: Array) -> Array:
    """Return the smooth step from LEAST_SHARE at 0 to 1 at 1."""
    t = np.clip(t, 0.0, 1.0)
    return np.asarray(LEAST_SHARE + (1.0 - LEAST_SHARE) * t * t * (3.0 - 2.0 * t))


def _torque(
    dynamics: Dynamics, points: Indices, required: Array, forces: Mapping[str, Array], corners: Mapping[str, Array]
) -> Array:
    """Return the joint torques that remain for the motors (M, n), 0 for the base."""
    torque = required.copy()
    for name, pushes in forces.items():
        moment = np.cross(corners[name], pushes).sum(axis=1)
        wrench = np.concatenate([pushes.sum(axis=1), moment], axis=1)
        torque -= (np.swapaxes(dynamics.contact_jacobians[name][points], 1, 2) @ wrench[:, :, None])[:, :, 0]
    torque[:, :BASE] = 0.0
    return torque
