"""Newton and Euler: the wrenches that the bodies require, and the values for which sums of them are lowest.

A body of mass m, with centre of mass c from the origin of its frame and inertia I about c, requires the force m (a_c -
g) with a_c = a + alpha x c + omega x (omega x c), and the moment I alpha + omega x I omega about its centre of mass. A
wrench here is force then moment about the origin of the body's frame, in its axes. It has two parts: `rest` balances
gravity alone, and `move` is all that the motion adds. The last axes of all arrays broadcast to the T instants.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from robustopt.arrays import Array
from robustopt.certificate.bodies import Body, Parameters
from robustopt.certificate.motion import Frame, Motion
from robustopt.certificate.realizable import ENTRIES
from robustopt.certificate.world import World

Load = tuple[Array, Array]
"""Parts `rest` and `move` of a wrench."""


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


def body_load(body: Body, frame: Frame, mass: Array, com: Array, inertia: Array) -> Load:
    """Return the two parts of the wrench that a body requires, (6, ...) each.

    Args:
        body: the body.
        frame: motion of its frame.
        mass: mass (...) [kg].
        com: displacement of the centre of mass, body axes (3, ...) [m].
        inertia: inertia about the centre of mass per unit of mass, body axes (6, ...) [m^2].
    """
    center = _center(body, com)
    spin = frame.spin
    turning = np.tensordot(body.turn, _turning(body, frame, inertia), axes=1)
    linear = frame.linear + cross(frame.angular, center) + cross(spin, cross(spin, center))
    return _wrench(-mass * frame.gravity, center, 0.0), _wrench(mass * linear, center, mass * turning)


def _center(body: Body, com: Array) -> Array:
    """Return the centre of mass for a displacement in body axes (3, ...), in axes of the frame."""
    return np.asarray(np.tensordot(body.turn, com, axes=1) + body.center.reshape(3, *[1] * (com.ndim - 1)))


def _turning(body: Body, frame: Frame, inertia: Array) -> Array:
    """Return I alpha + omega x I omega for an inertia per unit of mass (6, ...), in axes of the body (3, ...)."""
    angular, spin = (np.tensordot(body.turn.T, vector, axes=1) for vector in (frame.angular, frame.spin))
    return _times(inertia, angular) + cross(spin, _times(inertia, spin))


def _times(inertia: Array, vector: Array) -> Array:
    """Return an inertia (6, ...) times a vector (3, ...), both in axes of the body."""
    x, y, z = vector
    xx, yy, zz, xy, xz, yz = inertia
    return np.stack([xx * x + xy * y + xz * z, xy * x + yy * y + yz * z, xz * x + yz * y + zz * z])


def _wrench(force: Array, center: Array, turning: Array | float) -> Array:
    moment = cross(center, force) + turning
    return np.concatenate([np.broadcast_to(force, moment.shape), moment])


def body_loads(world: World, motion: Motion, values: Parameters) -> list[Load]:
    """Return the two parts of the wrench that each body requires, (6, ...) each."""
    frames = {name: shaken(frame, motion.free, values.error) for name, frame in motion.frames.items()}
    return [
        body_load(body, frames[body.frame], values.mass[b], values.com[b], values.inertia[b])
        for b, body in enumerate(world.bodies)
    ]


def at_lowest(
    world: World, motion: Motion, values: Parameters, goals: Sequence[Functional], joint_goal: Array | float = 0.0
) -> Parameters:
    """Return the inertial parameters and acceleration errors at which a sum of functionals is lowest.

    The bodies are independent, so all extremes of each body are tried by themselves. The sum is linear in the error,
    whose end is chosen afterwards.

    Args:
        world: the bodies and intervals.
        motion: motion at T instants.
        values: T sets of values to start from.
        goals: the functionals, one body each.
        joint_goal: further gain of the sum per acceleration error (n, T).
    """
    frames = {name: shaken(frame, motion.free, values.error) for name, frame in motion.frames.items()}
    mass, com, inertia = values.mass.copy(), values.com.copy(), values.inertia.copy()
    for goal in goals:
        if world.varies(goal.body):
            frame = frames[world.bodies[goal.body].frame]
            mass[goal.body], com[goal.body], inertia[goal.body] = _lowest(world, goal, frame, mass.shape[1:])
    gain = np.zeros_like(values.error) + joint_goal
    for goal in goals:
        body = world.bodies[goal.body]
        gain += _gain_of_error(body, motion.frames[body.frame], goal, *(own[goal.body] for own in (mass, com, inertia)))
    low, high = world.lower.error[:, None], world.upper.error[:, None]
    return replace(values, mass=mass, com=com, inertia=inertia, error=np.where(gain > 0.0, low, high))


def _lowest(world: World, goal: Functional, frame: Frame, shape: tuple[int, ...]) -> tuple[Array, Array, Array]:
    """Return mass (T,), com (3, T) and inertia (6, T) of one body at the extremes at which the goal is lowest."""
    b, body = goal.body, world.bodies[goal.body]
    slope, at_rest = _slope(body, frame, goal), frame.linear - goal.weight * frame.gravity
    lowest, best = np.full(shape, np.inf), np.zeros((10, *shape))
    for com in product(*(np.unique([p.com[b, k] for p in (world.lower, world.upper)]) for k in range(3))):
        at = np.array(com)[:, None]
        inertias, center = body.inertias(at[:, 0]), _center(body, at)
        turning = inertias @ slope
        own = np.argmin(turning, axis=0)
        push = goal.force + cross(goal.moment, center)
        linear = at_rest + cross(frame.angular, center) + cross(frame.spin, cross(frame.spin, center))
        value = (push * linear).sum(axis=0) + turning[own, np.arange(len(own))]
        mass = np.where(value < 0.0, world.upper.mass[b], world.lower.mass[b])
        better = mass * value < lowest
        lowest = np.where(better, mass * value, lowest)
        best[0, better], best[1:4, better], best[4:, better] = mass[better], at, inertias[own[better]].T
    return best[0], best[1:4], best[4:]


def _slope(body: Body, frame: Frame, goal: Functional) -> Array:
    """Return the derivative of the goal with respect to the inertia, per unit of mass, (6, T).

    With the moment m of the goal it is the symmetric part of m alpha^T + (m x omega) omega^T.
    """
    moment, angular, spin = (np.tensordot(body.turn.T, v, axes=1) for v in (goal.moment, frame.angular, frame.spin))
    sides = ((moment, angular), (cross(moment, spin), spin))
    twice = [1.0 if i == j else 2.0 for i, j in ENTRIES]
    return np.stack(
        [
            c * sum(0.5 * (left[i] * right[j] + left[j] * right[i]) for left, right in sides)
            for c, (i, j) in zip(twice, ENTRIES, strict=True)
        ]
    )


def _gain_of_error(body: Body, frame: Frame, goal: Functional, mass: Array, com: Array, inertia: Array) -> Array:
    """Return the derivative of the goal of a body's wrench with respect to the acceleration error, (n, T)."""
    center = _center(body, com)
    push = goal.force + cross(goal.moment, center)
    moment = np.tensordot(body.turn.T, goal.moment, axes=1)
    twist = cross(center, push) + np.tensordot(body.turn, _times(inertia, moment), axes=1)
    pull = np.concatenate([push, twist])
    return np.asarray(mass * (frame.jacobian * pull[:, None]).sum(axis=0))


def cross(a: Array, b: Array) -> Array:
    """Return the cross product along the first axis."""
    out = np.empty(np.broadcast_shapes(a.shape, b.shape))
    out[0] = a[1] * b[2] - a[2] * b[1]
    out[1] = a[2] * b[0] - a[0] * b[2]
    out[2] = a[0] * b[1] - a[1] * b[0]
    return out
