"""Newton and Euler: the wrenches that the bodies require, and the values for which sums of them are lowest.

A body of mass m, with centre of mass c from the origin of its frame and inertia I about c, requires the force m (a_c -
g) with a_c = a + alpha x c + omega x (omega x c), and the moment I alpha + omega x I omega about its centre of mass. A
wrench here is force then moment about the origin of the body's frame, in its axes. It has two parts: `rest` balances
gravity alone, and `move` is all that the motion adds. The last axes of all arrays broadcast to the T instants.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from robustopt.arrays import Array
from robustopt.certificate.bodies import Body, Parameters
from robustopt.certificate.motion import Frame, Motion
from robustopt.certificate.world import World

Load = tuple[Array, Array]
"""Parts `rest` and `move` of a wrench."""

ENDS = tuple((a, b, c, d) for a in (0, 1) for b in (0, 1) for c in (0, 1) for d in (0, 1))
"""Ends of the intervals of mass and of the three coordinates of the centre of mass."""


@dataclass(frozen=True, eq=False)
class Functional:
    """A linear function of the wrench w = weight rest + move of one body: force w[:3] + moment w[3:].

    Attributes:
        body: index of the body.
        force: coefficients of the force (3, ...).
        moment: coefficients of the moment (3, ...).
        weight: factor on `rest`.
    """

    body: int
    force: Array
    moment: Array
    weight: Array | float = 1.0

    def __call__(self, rest: Array, move: Array) -> Array:
        """Return the value for the two parts of a wrench."""
        wrench = self.weight * rest + move
        return np.asarray((self.force * wrench[:3]).sum(axis=0) + (self.moment * wrench[3:]).sum(axis=0))


def shaken(frame: Frame, free: Array, error: Array) -> Frame:
    """Return the motion of a frame with acceleration errors (n, ...), which are zero while the robot stands still."""
    extra = np.zeros((6, *np.broadcast_shapes(error.shape[1:], free.shape)))
    for joint, value in enumerate(error):
        if np.any(value):
            shaking = value * free
            for k in range(6):
                extra[k] += frame.jacobian[k, joint] * shaking
    return replace(frame, linear=frame.linear + extra[:3], angular=frame.angular + extra[3:])


def body_load(body: Body, frame: Frame, mass: Array, com: Array) -> Load:
    """Return the two parts of the wrench that a body requires, (6, ...) each; mass (...), com (3, ...) in body axes."""
    center = np.tensordot(body.turn, com, axes=1) + body.center.reshape(3, *[1] * (com.ndim - 1))
    spin = frame.spin
    turning = np.tensordot(body.inertia, frame.angular, axes=1) + cross(spin, np.tensordot(body.inertia, spin, axes=1))
    linear = frame.linear + cross(frame.angular, center) + cross(spin, cross(spin, center))
    return _wrench(-mass * frame.gravity, center, 0.0), _wrench(mass * linear, center, mass * turning)


def _wrench(force: Array, center: Array, turning: Array | float) -> Array:
    moment = cross(center, force) + turning
    return np.concatenate([np.broadcast_to(force, moment.shape), moment])


def body_loads(world: World, motion: Motion, values: Parameters) -> list[Load]:
    """Return the two parts of the wrench that each body requires, (6, ...) each."""
    frames = {name: shaken(frame, motion.free, values.error) for name, frame in motion.frames.items()}
    return [body_load(body, frames[body.frame], values.mass[b], values.com[b]) for b, body in enumerate(world.bodies)]


def at_lowest(
    world: World, motion: Motion, values: Parameters, goals: Sequence[Functional], joint_goal: Array | float = 0.0
) -> Parameters:
    """Return the ends of mass, centre of mass and acceleration error at which a sum of functionals is lowest.

    The bodies are independent, so all ends of each body are tried by themselves. The sum is linear in the error, whose
    end is chosen afterwards.

    Args:
        world: the bodies and intervals.
        motion: motion at T instants.
        values: T sets of values to start from.
        goals: the functionals, one body each.
        joint_goal: further gain of the sum per acceleration error (n, T).
    """
    frames = {name: shaken(frame, motion.free, values.error) for name, frame in motion.frames.items()}
    mass, com = values.mass.copy(), values.com.copy()
    for goal in goals:
        _lowest_ends(world, goal, frames[world.bodies[goal.body].frame], mass, com)
    gain = np.zeros_like(values.error) + joint_goal
    for goal in goals:
        body = world.bodies[goal.body]
        gain += _gain_of_error(body, motion.frames[body.frame], goal, mass[goal.body], com[goal.body])
    low, high = world.lower.error[:, None], world.upper.error[:, None]
    return replace(values, mass=mass, com=com, error=np.where(gain > 0.0, low, high))


def _lowest_ends(world: World, goal: Functional, frame: Frame, mass: Array, com: Array) -> None:
    """Set mass (B, T) and com (B, 3, T) of one body to the ends of their intervals at which the goal is lowest."""
    b = goal.body
    ends = np.array([np.r_[p.mass[b], p.com[b]] for p in (world.lower, world.upper)])
    wide = ends[0] < ends[1]
    if not wide.any():
        return
    lowest = np.full(mass.shape[1:], np.inf)
    best = np.zeros((4, *mass.shape[1:]))
    for choice in ENDS:
        if any(end and not w for end, w in zip(choice, wide, strict=True)):
            continue
        corner = ends[choice, range(4)]
        value = goal(*body_load(world.bodies[b], frame, corner[:1], corner[1:, None]))
        better = value < lowest
        lowest = np.where(better, value, lowest)
        best[:, better] = corner[:, None]
    mass[b], com[b] = best[0], best[1:]


def _gain_of_error(body: Body, frame: Frame, goal: Functional, mass: Array, com: Array) -> Array:
    """Return the derivative of the goal of a body's wrench with respect to the acceleration error, (n, T)."""
    center = np.tensordot(body.turn, com, axes=1) + body.center[:, None]
    push = goal.force + cross(goal.moment, center)
    twist = cross(center, push) + np.tensordot(body.inertia, goal.moment, axes=1)
    pull = np.concatenate([push, twist])
    return np.asarray(mass * (frame.jacobian * pull[:, None]).sum(axis=0))


def cross(a: Array, b: Array) -> Array:
    """Return the cross product along the first axis."""
    return np.stack([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])
