"""What a plan does at many instants: joints, arm and tray, with T the number of instants.

u = sdd is constant on an interval of the grid and x = sd^2 linear in s, so everything in between is known exactly. Each
interval is looked at from both of its ends (its own u with the x of the grid point), and at points in between. Where
the plan stands still (its ends and inner stops) it is looked at once more with u = 0.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from robustopt.certificate.contact_points import Array, Flags, Indices
from robustopt.robot import JointLimits

if TYPE_CHECKING:
    from robustopt.solvers import Plan


@dataclass(frozen=True, eq=False)
class Instants:
    """Where to look at a plan, (T,) each.

    s, t: place and time; x, u: sd^2 and sdd there; piece: of the path; grid: whether it is a grid point; free: 1 where
    the robot moves, 0 where it stands still (and has no acceleration error); node: index of s among the distinct
    `nodes` (positions and pieces) at which the arm's dynamics are needed
    """

    s: Array
    t: Array
    x: Array
    u: Array
    grid: Flags
    free: Array
    node: Indices
    node_s: Array
    node_piece: Indices


def instants(plan: Plan, between: Sequence[float], every: int = 1) -> Instants:
    """Instants of every `every`-th interval: both ends and the shares `between` of its length, and all standstills."""
    ds = np.diff(plan.s)
    root = np.sqrt(np.maximum(plan.x, 0.0))
    moving = np.flatnonzero(ds > 0.0)
    duration = np.zeros(len(ds))
    with np.errstate(divide="ignore"):
        duration[moving] = 2.0 * ds[moving] / (root[moving] + root[moving + 1])
    begin = np.concatenate([[0.0], np.cumsum(duration)])
    chosen = moving[::every]
    shares = np.array([0.0, 1.0, *between])
    interval, share = (values.ravel() for values in np.meshgrid(chosen, shares, indexing="ij"))
    x = plan.x[interval] + 2.0 * share * ds[interval] * plan.u[interval]
    x = np.where(share == 0.0, plan.x[interval], np.where(share == 1.0, plan.x[interval + 1], x))
    way = root[interval] + np.sqrt(np.maximum(x, 0.0))
    t = begin[interval] + np.divide(2.0 * share * ds[interval], way, out=np.zeros_like(x), where=way > 0.0)
    grid = (share == 0.0) | (share == 1.0)
    stops = np.flatnonzero(ds == 0.0)
    still = np.unique(np.concatenate([[0, len(plan.s) - 1], stops, stops + 1]))
    s = np.concatenate([plan.s[interval] + share * ds[interval], plan.s[still]])
    s[: len(interval)][share == 1.0] = plan.s[interval + 1][share == 1.0]
    piece = np.concatenate([plan.piece[interval], plan.piece[still]])
    key = np.column_stack([piece, s])
    nodes, node = np.unique(key, axis=0, return_inverse=True)
    none = np.zeros(len(still))
    return Instants(
        s=s,
        t=np.concatenate([t, begin[still]]),
        x=np.concatenate([np.maximum(x, 0.0), none]),
        u=np.concatenate([plan.u[interval], none]),
        grid=np.concatenate([grid, none == 0.0]),
        free=np.concatenate([np.ones(len(interval)), none]),
        node=node.ravel(),
        node_s=nodes[:, 1],
        node_piece=nodes[:, 0].astype(np.intp),
    )


@dataclass(frozen=True, eq=False)
class Motion:
    """Motion of the joints and of the tray, in the tray frame.

    linear, angular: (3, T) acceleration of the tray's origin; spin: (3, T) its angular velocity; gravity: (3, T);
    jacobian: (6, n, T) of the tray's origin; mass_matrix: (n, n, T) of the arm; free: (T,) 0 where the robot stands
    still; position, velocity, acceleration: (n, T) of the joints; torque: (n, T) of the arm and joint friction, without
    load; sticking: (n, T) dry friction of joints that do not move, of either sign; limits: of the joints
    """

    linear: Array
    angular: Array
    spin: Array
    gravity: Array
    jacobian: Array
    mass_matrix: Array
    free: Array
    position: Array
    velocity: Array
    acceleration: Array
    torque: Array
    sticking: Array
    limits: JointLimits

    def at(self, index: Indices) -> Motion:
        """The motion at some of the instants."""
        return replace(self, **{name: values[..., index] for name, values in self._arrays().items()})

    def widened(self) -> Motion:
        """The motion with an axis of length 1 before that of the instants, for many draws."""
        return replace(self, **{name: values[..., None, :] for name, values in self._arrays().items()})

    def _arrays(self) -> dict[str, Any]:
        return {field.name: getattr(self, field.name) for field in fields(self) if field.name != "limits"}


def motion(plan: Plan, at: Instants) -> Motion:
    """The motion of a plan at some instants."""
    robot, path = plan.problem.robot, plan.problem.path
    q, q1, q2 = (path.evaluate(at.node_s, at.node_piece, order) for order in range(3))
    arm = robot.dynamics(q, q1, q2)
    carrier = arm.carrier
    assert carrier is not None
    u, x, sd = at.u, at.x, np.sqrt(at.x)
    along, curving = _product(carrier.jacobian, q1), _product(carrier.jacobian, q2) + carrier.bias
    tray = u * _last(along[at.node]) + x * _last(curving[at.node])
    q, q1, q2 = (_last(values[at.node]) for values in (q, q1, q2))
    torque = u * _last(arm.force_u[at.node]) + x * _last(arm.force_x[at.node]) + _last(arm.force_0[at.node])
    limits = robot.limits
    dry = limits.dry_friction[:, None] * at.free
    torque += limits.viscous_friction[:, None] * q1 * sd + dry * np.sign(q1)
    return Motion(
        linear=tray[:3],
        angular=tray[3:],
        spin=sd * _last(along[at.node, 3:]),
        gravity=_last(carrier.gravity[at.node]),
        jacobian=_last(carrier.jacobian[at.node]),
        mass_matrix=_last(arm.mass_matrix[at.node]),
        free=at.free,
        position=q,
        velocity=q1 * sd,
        acceleration=q1 * u + q2 * x,
        torque=torque,
        sticking=np.where(q1 == 0.0, dry, 0.0),
        limits=limits,
    )


def _product(matrices: Array, vectors: Array) -> Array:
    return np.asarray((matrices @ vectors[:, :, None])[:, :, 0])


def _last(values: Array) -> Array:
    """The same with the first axis, that of the instants, last."""
    return np.ascontiguousarray(np.moveaxis(values, 0, -1))
