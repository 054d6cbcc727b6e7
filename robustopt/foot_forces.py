"""Planned contact forces of a robot on its feet: how the standing feet share the load, smoothly along the plan.

The wrench that the motion needs is distributed over the standing feet by `load_sharing`. A foot that will lift or has
landed fades out and in while both feet stand, so that its force does not jump where the stance changes (our choice).
The joint torques with these forces are the feedforward of an execution.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from robustopt.config import BASE_COORDINATES as BASE
from robustopt.contact.load_sharing import distribute
from robustopt.errors import ProblemInfeasible
from robustopt.path.walking_path import WalkingPath
from robustopt.problem.walking import StandingTorque
from robustopt.robot.walker import Walker, WalkerDynamics
from robustopt.trajectory import Trajectory

if TYPE_CHECKING:
    from robustopt.timescaling.plan import Plan

Array = np.ndarray

FADE = 0.6
"""Part of a phase on both feet over which a foot that has landed takes up its share, or one that will lift drops it."""

LEAST_SHARE = 1e-4
"""Share of a foot at the moment it lifts or lands, against 1 when it stands."""


@dataclass(frozen=True, eq=False)
class FootForces:
    """Contact forces and joint torques of a plan at M instants, in the order of time.

    The first and the last are those of standing still; in between are the start and the end of every interval, so that
    where sdd jumps there are two instants at the same time.

    t, s: time and place (M,); forces: per foot at its contact points (M, k, 3), world [N], 0 while it is in the air;
    points: of each foot (M, k, 3), world [m], as the planner counts on them, where it stood last while in the air;
    torque: (M, n) [N m], 0 for the base; residual: (M,) what the wrench misses, as a fraction of the weight
    """

    t: Array
    s: Array
    forces: Mapping[str, Array]
    points: Mapping[str, Array]
    torque: Array
    residual: Array

    def total(self, foot: str) -> Array:
        """Force on a foot, (M, 3), world [N]."""
        return np.asarray(self.forces[foot].sum(axis=1))

    def wrench(self, foot: str) -> Array:
        """Force and moment on a foot about the middle of its sole, world axes, (M, 6) [N, N m]."""
        arm = self.points[foot] - self.points[foot].mean(axis=1, keepdims=True)
        moment = np.cross(arm, self.forces[foot]).sum(axis=1)
        return np.concatenate([self.total(foot), moment], axis=1)

    def center_of_pressure(self, foot: str | None = None) -> Array:
        """Centre of pressure of a foot, or of all contacts, (M, 2), world [m]; nan where nothing presses."""
        feet = list(self.forces) if foot is None else [foot]
        pressure = np.concatenate([self.forces[name][..., 2] for name in feet], axis=1)
        points = np.concatenate([self.points[name][..., :2] for name in feet], axis=1)
        total = pressure.sum(axis=1)
        some = np.where(total > 1e-9 * total.max(initial=1.0), total, np.nan)
        return np.asarray((pressure[:, :, None] * points).sum(axis=1) / some[:, None])

    def sample(self, t: Array) -> tuple[Array, dict[str, Array]]:
        """Joint torque (T, n) and force on each foot (T, 3) at times t (T,), linear in between; constant outside."""
        late = np.searchsorted(self.t, t, side="right")
        first = np.clip(late - 1, 0, len(self.t) - 1)
        second = np.clip(late, 0, len(self.t) - 1)
        width = self.t[second] - self.t[first]
        part = np.divide(t - self.t[first], width, out=np.zeros(len(t)), where=width > 0)[:, None]

        def between(values: Array) -> Array:
            return np.asarray((1.0 - part) * values[first] + part * values[second])

        return between(self.torque), {name: between(self.total(name)) for name in self.forces}


def planned_forces(plan: Plan) -> FootForces:
    """Contact forces of a plan of a robot on its feet. Raises ProblemInfeasible for a plan that was not found."""
    if plan.x.size == 0:
        raise ProblemInfeasible(f"There are no forces: {plan.message}")
    problem = plan.problem
    torque, walker, path = problem.limits.torque, problem.robot, problem.path
    assert isinstance(torque, StandingTorque)
    assert isinstance(walker, Walker)
    assert isinstance(path, WalkingPath)
    trajectory = Trajectory.from_plan(plan)
    interval = np.arange(len(plan.u))
    points = np.concatenate([[0], np.column_stack([interval, interval + 1]).ravel(), [len(plan.s) - 1]])
    u = np.concatenate([[0.0], np.repeat(plan.u, 2), [0.0]])
    x = np.concatenate([[0.0], plan.x[points[1:-1]], [0.0]])
    middle = np.concatenate([[0.0], np.repeat(0.5 * (plan.s[:-1] + plan.s[1:]), 2), [1.0]])
    phases = path.footsteps.phases
    stance = np.minimum((middle * phases).astype(int), phases - 1)
    dynamics = torque.dynamics
    load = dynamics.force_u[points] * u[:, None] + dynamics.force_x[points] * x[:, None] + dynamics.force_0[points]
    forces, corners, residual = _forces(torque, walker, path, plan.s[points], stance, load)
    return FootForces(
        t=trajectory.times[points],
        s=plan.s[points],
        forces=forces,
        points=corners,
        torque=_torque(dynamics, points, load, forces, corners),
        residual=residual,
    )


def _forces(
    torque: StandingTorque, walker: Walker, path: WalkingPath, s: Array, stance: Array, load: Array
) -> tuple[dict[str, Array], dict[str, Array], Array]:
    """Forces and contact points of both feet (M, k, 3), and what the wrench misses (M,)."""
    count = {name: len(foot.points) for name, foot in walker.feet.items()}
    forces = {name: np.zeros((len(s), k, 3)) for name, k in count.items()}
    corners = {name: np.zeros((len(s), k, 3)) for name, k in count.items()}
    residual = np.empty(len(s))
    for k, (family, own) in enumerate(zip(torque.contacts, path.stances, strict=True)):
        here = np.flatnonzero(stance == k)
        system, feet = family.system, family.system.interfaces
        shares = _shares(path, k, s[here])
        sizes = [count[name] * system.edges for name in feet]
        split = np.cumsum(sizes)[:-1]
        weights = np.concatenate(
            [np.repeat(shares[name][:, None], n, 1) for name, n in zip(feet, sizes, strict=True)], 1
        )
        center = np.append(np.mean(list(own.places.values()), axis=0), 0.0)
        generators = system.about([center]).generators
        wrench = load[here, :BASE].copy()
        wrench[:, 3:] -= np.cross(center, wrench[:, :3])
        along, residual[here] = distribute(generators, weights, wrench, family.weight)
        edges = system.generators[:3]
        for name, part, edge in zip(feet, np.split(along, split, 1), np.split(edges, split, 1), strict=True):
            pushes = part[:, None, :] * edge
            forces[name][here] = pushes.reshape(len(here), 3, count[name], system.edges).sum(axis=3).transpose(0, 2, 1)
        for name in walker.feet:
            corners[name][here] = _corners(torque, path, k, name)
    return forces, corners, residual


def _corners(torque: StandingTorque, path: WalkingPath, stance: int, name: str) -> Array:
    """Contact points of a foot (k, 3) where it stands in a stance, or stood last."""
    while name not in path.stances[stance].places:
        stance -= 1
    flat = torque.soles[name] + path.stances[stance].places[name]
    return np.column_stack([flat, np.zeros(len(flat))])


def _shares(path: WalkingPath, stance: int, s: Array) -> dict[str, Array]:
    """Weight of each standing foot, (M,): 1, but less after it landed and before it lifts."""
    own, stances = path.stances[stance], path.stances
    part = (s - own.begin) / (own.end - own.begin)
    shares = {}
    for name in own.places:
        share = np.ones(len(s))
        if stance > 0 and name not in stances[stance - 1].places:
            share = np.minimum(share, _ramp(part / FADE))
        if stance + 1 < len(stances) and name not in stances[stance + 1].places:
            share = np.minimum(share, _ramp((1.0 - part) / FADE))
        shares[name] = share
    return shares


def _ramp(t: Array) -> Array:
    """Smooth step from LEAST_SHARE at 0 to 1 at 1."""
    t = np.clip(t, 0.0, 1.0)
    return np.asarray(LEAST_SHARE + (1.0 - LEAST_SHARE) * t * t * (3.0 - 2.0 * t))


def _torque(
    dynamics: WalkerDynamics, points: Array, load: Array, forces: Mapping[str, Array], corners: Mapping[str, Array]
) -> Array:
    """Joint torques (M, n) that are left for the motors, 0 for the base."""
    torque = load.copy()
    for name, pushes in forces.items():
        moment = np.cross(corners[name], pushes).sum(axis=1)
        wrench = np.concatenate([pushes.sum(axis=1), moment], axis=1)
        torque -= (np.swapaxes(dynamics.jacobians[name][points], 1, 2) @ wrench[:, :, None])[:, :, 0]
    torque[:, :BASE] = 0.0
    return torque
