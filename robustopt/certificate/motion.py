"""Motion of the joints, the base and the frames of all bodies at T instants of a plan.

u = sdd is constant on an interval of the grid and x = sd^2 is linear in s; with jerk limits, u is linear in time. So
the motion in between is known exactly.
Each interval is checked at both of its ends, with its own u and the x of the grid point, and at points in between. At
standstills, the two ends and inner stops of the path, there is one more instant with u = 0.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, Self

import numpy as np

from robustopt.arrays import Array, Flags, Indices
from robustopt.certificate.task import Task
from robustopt.path import Path
from robustopt.robot import Dynamics, Robot
from robustopt.solvers import Plan

CARRIER = "robustopt carrier"
"""Name of the frame that all objects are attached to; frames of links have the names of their bodies."""

INSIDE = 1e-6
"""Distance from the ends of an interval, as a part of it, at which q''' is evaluated."""


@dataclass(frozen=True, eq=False)
class Instants:
    """Instants at which a plan is checked, (T,) each.

    Attributes:
        s: position along the path.
        t: time [s].
        x: sd^2 [1/s^2].
        u: sdd [1/s^2].
        rate: sddd [1/s^3].
        inside: position along the path within the interval, near s: q''' may jump at a grid point.
        grid: True at a grid point.
        free: 1 if the robot moves; 0 if it stands still and has no acceleration error.
        node: index of the node, one of the P distinct positions at which dynamics are needed.
        node_s: position of each node along the path (P,).
        node_piece: piece of the path of each node (P,).
    """

    s: Array
    t: Array
    x: Array
    u: Array
    rate: Array
    inside: Array
    grid: Flags
    free: Array
    node: Indices
    node_s: Array
    node_piece: Indices


def instants(plan: Plan, between: Sequence[float]) -> Instants:
    """Return instants on every interval, at its ends and in between, and at all standstills.

    Args:
        plan: the plan.
        between: instants within an interval, as shares of its length, without 0 and 1; of its time if u changes.
    """
    ds = np.diff(plan.s)
    root = np.sqrt(np.maximum(plan.x, 0.0))
    moving = np.flatnonzero(ds > 0.0)
    duration = np.zeros(len(ds))
    duration[moving] = interval_times(plan)[moving]
    duration[ds == 0.0] = plan.problem.path.pauses
    begin = np.concatenate([[0.0], np.cumsum(duration)])
    shares = np.array([0.0, 1.0, *between])
    interval, share = (values.ravel() for values in np.meshgrid(moving, shares, indexing="ij"))
    at = _linear(plan, root, interval, share) if plan.steady else _cubic(plan, root, duration, interval, share)
    way, x, u, tau, rate = at
    way, x = (
        np.where(share == 0.0, values[interval], np.where(share == 1.0, values[interval + 1], inner))
        for values, inner in ((plan.s, way), (plan.x, x))
    )
    stops = np.flatnonzero(ds == 0.0)
    ends = np.array([0, len(plan.s) - 1])[np.equal(plan.problem.path.end_speeds, 0.0)]
    still = np.unique(np.concatenate([ends, stops, stops + 1]))
    s = np.concatenate([way, plan.s[still]])
    piece = np.concatenate([plan.piece[interval], plan.piece[still]])
    nodes, node = np.unique(np.column_stack([piece, s]), axis=0, return_inverse=True)
    none = np.zeros(len(still))
    first, last = plan.s[interval], plan.s[interval + 1]
    return Instants(
        s=s,
        t=np.concatenate([begin[interval] + tau, begin[still]]),
        x=np.concatenate([np.maximum(x, 0.0), none]),
        u=np.concatenate([u, none]),
        rate=np.concatenate([rate, none]),
        inside=np.concatenate(
            [np.clip(way, first + INSIDE * (last - first), last - INSIDE * (last - first)), s[len(way) :]]
        ),
        grid=np.concatenate([(share == 0.0) | (share == 1.0), none == 0.0]),
        free=np.concatenate([np.ones(len(interval)), none]),
        node=node.ravel(),
        node_s=nodes[:, 1],
        node_piece=nodes[:, 0].astype(np.intp),
    )


def interval_times(plan: Plan) -> Array:
    """Return the time of each interval (P - 1,) [s].

    If u is constant it is 2 ds / (sd + sd'). Else ds = (sd + sd') dt / 2 - (u' - u) dt^2 / 12.
    """
    ds, root = np.diff(plan.s), np.sqrt(np.maximum(plan.x, 0.0))
    both = root[:-1] + root[1:]
    with np.errstate(divide="ignore", invalid="ignore"):
        if plan.steady:
            return np.where(ds > 0.0, 2.0 * ds / both, 0.0)
        # the smaller root, in the form that does not cancel
        part = np.maximum(0.25 * both**2 - plan.change * ds / 3.0, 0.0)
        return np.where(ds > 0.0, 2.0 * ds / (0.5 * both + np.sqrt(part)), 0.0)


def _linear(plan: Plan, root: Array, interval: Indices, share: Array) -> tuple[Array, Array, Array, Array, Array]:
    """Return s, x, u, time since the start of the interval and sddd at shares of the lengths of intervals (T,)."""
    ds = np.diff(plan.s)
    x = plan.x[interval] + 2.0 * share * ds[interval] * plan.u[interval]
    x = np.where(share == 0.0, plan.x[interval], np.where(share == 1.0, plan.x[interval + 1], x))
    way = root[interval] + np.sqrt(np.maximum(x, 0.0))
    tau = np.divide(2.0 * share * ds[interval], way, out=np.zeros_like(x), where=way > 0.0)
    return plan.s[interval] + share * ds[interval], x, plan.u[interval], tau, np.zeros_like(x)


def _cubic(
    plan: Plan, root: Array, duration: Array, interval: Indices, share: Array
) -> tuple[Array, Array, Array, Array, Array]:
    """Return s, x, u, time since the start of the interval and sddd at shares of the times of intervals (T,)."""
    tau, u = share * duration[interval], plan.u[interval]
    rate = plan.change[interval] / duration[interval]
    s = plan.s[interval] + tau * (root[interval] + tau * (u / 2.0 + tau * rate / 6.0))
    speed = root[interval] + tau * (u + tau * rate / 2.0)
    return s, speed**2, u + tau * rate, tau, rate


def picked(values: Array, index: int | Indices | slice) -> Array:
    """Return values at some of the indices of the last axis, along which the result is contiguous in memory.

    Args:
        values: the values (..., T).
        index: the indices.
    """
    return values[..., index] if isinstance(index, slice) else np.asarray(np.take(values, index, axis=-1))


class Series:
    """Base class of dataclasses of arrays with T instants as their last axis, or of mappings of such series."""

    def at(self, index: Indices | slice) -> Self:
        """Return the series at some of the instants."""
        return self._mapped(lambda values: picked(values, index))

    def _mapped(self, change: Any) -> Self:
        def changed(value: Any) -> Any:
            if isinstance(value, Mapping):
                return {name: changed(item) for name, item in value.items()}
            return value._mapped(change) if isinstance(value, Series) else change(value)

        names = [item.name for item in fields(self)]  # type: ignore[arg-type]  # subclasses are dataclasses
        return replace(self, **{name: changed(getattr(self, name)) for name in names})  # type: ignore[type-var]


@dataclass(frozen=True, eq=False)
class Frame(Series):
    """Motion of a frame that is attached to a link, in its own axes.

    Attributes:
        linear: acceleration of the origin (3, T) [m/s^2].
        angular: angular acceleration (3, T) [rad/s^2].
        spin: angular velocity (3, T) [rad/s].
        gravity: acceleration of gravity (3, T) [m/s^2].
        jacobian: Jacobian of the origin, linear then angular (6, n, T).
        to_base: matrix from a wrench about the frame's origin to the wrench on the floating base, about the world's
            origin (base, 6, T).
    """

    linear: Array
    angular: Array
    spin: Array
    gravity: Array
    jacobian: Array
    to_base: Array


@dataclass(frozen=True, eq=False)
class Motion(Series):
    """Motion of all bodies, and the wrench that the robot's links alone require at their floating base.

    Attributes:
        frames: frames by name.
        base_force: required wrench about the world's origin, world axes (base, T) [N, N m].
        base_inertia: change of this wrench per acceleration (base, n, T).
        free: 0 if the robot stands still, else 1 (T,).
    """

    frames: Mapping[str, Frame]
    base_force: Array
    base_inertia: Array
    free: Array


@dataclass(frozen=True, eq=False)
class Joints(Series):
    """Motion and torques of the m joints that have motors.

    Attributes:
        position: joint positions (m, T) [rad or m].
        velocity: joint velocities (m, T) [rad/s or m/s].
        acceleration: joint accelerations (m, T) [rad/s^2 or m/s^2].
        torque: torque of the links and of joint friction, without payload (m, T) [N m or N].
        inertia: change of the torque per acceleration (m, n, T).
        to_torque: by frame, matrix from a wrench about its origin to joint torques (m, 6, T).
        sticking: dry friction of joints that do not move, in either direction (m, T) [N m or N].
        squeeze: torque per internal force between the first two hands, from the second to the first (m, T).
        pulls: by environment contact, torque that its wrench about the world's origin replaces (m, 6, T).
    """

    position: Array
    velocity: Array
    acceleration: Array
    torque: Array
    inertia: Array
    to_torque: Mapping[str, Array]
    sticking: Array
    squeeze: Array
    pulls: Mapping[str, Array]

    def only(self, j: int) -> Joints:
        """Return the series of a single joint."""
        return self._mapped(lambda values: values[j : j + 1])

    def standing_on(self, contact: str, motion: Motion) -> Joints:
        """Return the joints with the torques of a single environment contact that exerts all that the base requires."""
        pull = self.pulls[contact]
        to_torque = {
            name: maps - np.einsum("mkt,kjt->mjt", pull, motion.frames[name].to_base)
            for name, maps in self.to_torque.items()
        }
        return replace(
            self,
            torque=self.torque - np.einsum("mkt,kt->mt", pull, motion.base_force),
            inertia=self.inertia - np.einsum("mkt,knt->mnt", pull, motion.base_inertia),
            to_torque=to_torque,
        )


def motion(task: Task, at: Instants, links: Iterable[str] = ()) -> tuple[Motion, Joints]:
    """Return the motion along a path at some instants.

    Args:
        task: robot, path and limits.
        at: the instants.
        links: names of the links whose frames are needed.
    """
    robot, path = task.robot, task.path
    nodes = [path.evaluate(at.node_s, at.node_piece, order) for order in range(3)]
    found = robot.dynamics(*nodes)
    maps = {name: _link(robot, name, nodes, at) for name in links}
    if found.carrier is not None:
        maps[CARRIER] = _carrier(found, nodes, at, robot.base)
    force = at.u * _last(found.force_u, at) + at.x * _last(found.force_x, at) + _last(found.force_0, at)
    inertia, base = _last(found.mass_matrix, at), robot.base
    moving = Motion({name: frame for name, (frame, _) in maps.items()}, force[:base], inertia[:base], at.free)
    to_torque = {name: torque for name, (_, torque) in maps.items()}
    pulls = {
        name: np.ascontiguousarray(np.swapaxes(_last(values[:, :, base:], at), 0, 1))
        for name, values in found.contact_jacobians.items()
    }
    q, q1, q2 = (_last(values[:, base:], at) for values in nodes)
    dry = task.limits.dry_friction[base:, None] * at.free
    friction = task.limits.viscous_friction[base:, None] * q1 * np.sqrt(at.x) + dry * np.sign(q1)
    joints = Joints(
        position=q,
        velocity=q1 * np.sqrt(at.x),
        acceleration=q1 * at.u + q2 * at.x,
        torque=force[base:] + friction,
        inertia=inertia[base:],
        to_torque=to_torque,
        sticking=np.where(q1 == 0.0, dry, 0.0),
        squeeze=_squeeze(robot, found, at),
        pulls=pulls,
    )
    return moving, joints


def _carrier(found: Dynamics, nodes: list[Array], at: Instants, base: int) -> tuple[Frame, Array]:
    """Return the motion of the carrier frame, and the torques (m, 6, T) for a wrench about its origin."""
    own = found.carrier
    assert own is not None
    along, curving = _product(own.jacobian, nodes[1]), _product(own.jacobian, nodes[2]) + own.bias
    acceleration = at.u * _last(along, at) + at.x * _last(curving, at)
    frame = Frame(
        linear=acceleration[:3],
        angular=acceleration[3:],
        spin=np.sqrt(at.x) * _last(along[:, 3:], at),
        gravity=_last(own.gravity, at),
        jacobian=_last(own.jacobian, at),
        to_base=_last(_to_world(own.position, own.rotation)[:, :base], at),
    )
    return frame, np.swapaxes(frame.jacobian[:, base:], 0, 1)


def between_hands(robot: Robot) -> Array:
    """Return the wrench (6,) of a unit force on the tray along the line from its second to its first hand.

    It is in carrier axes about the origin of the carrier. The first hand exerts this wrench, the second its opposite.
    """
    first, second = robot.hands[0].point, robot.hands[1].point
    line = (first - second) / np.linalg.norm(first - second)
    return np.concatenate([line, np.cross(first, line)])


def _squeeze(robot: Robot, found: Dynamics, at: Instants) -> Array:
    """Return the joint torques (m, T) per internal force between two hands; 0 with a single tool."""
    hands = found.carrier.hands if found.carrier is not None else None
    if hands is None:
        return np.zeros((robot.n - robot.base, len(at.s)))
    return _last(between_hands(robot) @ (hands[0] - hands[1])[:, :, robot.base :], at)


def _to_world(position: Array, rotation: Array) -> Array:
    """Return the matrices (P, 6, 6) from wrenches about a frame's origin to those about the world's, in world axes."""
    x, y, z = position.T
    none = np.zeros_like(x)
    arm = np.moveaxis(np.array([[none, -z, y], [z, none, -x], [-y, x, none]]), 2, 0)
    return np.concatenate(
        [np.concatenate([rotation, np.zeros_like(rotation)], 2), np.concatenate([arm @ rotation, rotation], 2)], 1
    )


def _link(robot: Robot, name: str, nodes: list[Array], at: Instants) -> tuple[Frame, Array]:
    """Return the motion of a link's frame, and the torques (m, 6, T) for a wrench about its origin."""
    own = robot.body_motion(name, *nodes)
    to_force = _last(own.to_force, at)
    frame = Frame(
        linear=at.u * _last(own.linear_u, at) + at.x * _last(own.linear_x, at),
        angular=at.u * _last(own.angular_u, at) + at.x * _last(own.angular_x, at),
        spin=np.sqrt(at.x) * _last(own.spin, at),
        gravity=-_last(own.linear_0, at),
        jacobian=_last(own.jacobian, at),
        to_base=to_force[: robot.base],
    )
    return frame, to_force[robot.base :]


def stances(path: Path, at: Instants) -> Indices:
    """Return the stance (T,) of each instant: at a switch the one with fewer contacts, without steps 0."""
    found, chosen = path.stances, np.zeros(len(at.s), dtype=np.intp)
    borders = [0.0, *path.switches, 1.0]
    for k in sorted(range(len(found)), key=lambda k: -len(found[k].contacts)):
        chosen[(borders[k] <= at.s) & (at.s <= borders[k + 1])] = k
    return chosen


def _product(matrices: Array, vectors: Array) -> Array:
    return np.asarray((matrices @ vectors[:, :, None])[:, :, 0])


def _last(values: Array, at: Instants) -> Array:
    """Return values given at nodes (first axis) at the instants (last axis)."""
    return np.ascontiguousarray(np.moveaxis(values, 0, -1)[..., at.node])
