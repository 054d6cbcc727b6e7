"""Newton and Euler: the wrenches that must be exerted on the bodies on a moving tray.

A body of mass m, centre of mass c (from the tray's origin) and inertia I about it needs the force m (a_c - g) with
a_c = a + alpha x c + omega x (omega x c), and about its centre of mass the moment I alpha + omega x I omega. A wrench
here is force then moment about the tray's origin, tray frame, in two parts: `rest` against gravity alone, and `move`,
all that the motion adds. Arrays end with any axes that broadcast against the T instants of the motion.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from robustopt.certificate.contact_points import Array
from robustopt.certificate.motion import Motion
from robustopt.certificate.scene import Body, Parameters, Scene, System

Load = tuple[Array, Array]
"""Parts `rest` and `move` of a wrench."""

ENDS = tuple((a, b, c, d) for a in (0, 1) for b in (0, 1) for c in (0, 1) for d in (0, 1))
"""Ends of the intervals of mass and of the three coordinates of the centre of mass."""


@dataclass(frozen=True, eq=False)
class Tray:
    """Acceleration of the tray with the joint acceleration error in it, and the rest of its motion, (3, ...) each."""

    linear: Array
    angular: Array
    spin: Array
    gravity: Array


@dataclass(frozen=True, eq=False)
class Functional:
    """A linear function of the wrench w = weight rest + move, about the tray's origin: force w[:3] + moment w[3:]."""

    force: Array
    moment: Array
    weight: Array | float = 1.0

    def __call__(self, rest: Array, move: Array) -> Array:
        wrench = self.weight * rest + move
        return np.asarray((self.force * wrench[:3]).sum(axis=0) + (self.moment * wrench[3:]).sum(axis=0))


def tray_motion(motion: Motion, error: Array) -> Tray:
    """Motion of the tray with joint acceleration errors (n, ...)."""
    shape = np.broadcast_shapes(error.shape[1:], motion.free.shape)
    extra = np.zeros((6, *shape))
    for joint, value in enumerate(error):
        if np.any(value):
            shaking = value * motion.free
            for k in range(6):
                extra[k] += motion.jacobian[k, joint] * shaking
    linear, angular = motion.linear + extra[:3], motion.angular + extra[3:]
    return Tray(linear, angular, motion.spin, motion.gravity)


def body_load(body: Body, tray: Tray, mass: Array, com: Array) -> Load:
    """Parts `rest` and `move` of the wrench that a body needs, (6, ...) each; mass (...), com (3, ...) body axes."""
    center = np.tensordot(body.turn, com, axes=1) + body.center.reshape(3, *[1] * (com.ndim - 1))
    spin = tray.spin
    turning = np.tensordot(body.inertia, tray.angular, axes=1) + cross(spin, np.tensordot(body.inertia, spin, axes=1))
    linear = tray.linear + cross(tray.angular, center) + cross(spin, cross(spin, center))
    return _wrench(-mass * tray.gravity, center, 0.0), _wrench(mass * linear, center, mass * turning)


def _wrench(force: Array, center: Array, turning: Array | float) -> Array:
    moment = cross(center, force) + turning
    return np.concatenate([np.broadcast_to(force, moment.shape), moment])


def body_loads(scene: Scene, tray: Tray, parameters: Parameters) -> list[Load]:
    """Parts `rest` and `move` of the wrenches that all bodies need, (6, ...) each."""
    return [body_load(body, tray, parameters.mass[b], parameters.com[b]) for b, body in enumerate(scene.bodies)]


def system_load(system: System, loads: list[Load]) -> Load:
    """Parts `rest` and `move` of what the blocks of a system need, in its units about its reference, (6 K, ...)."""
    rest = [_in_units(system, _total([loads[b][0] for b in block])) for block in system.loads]
    move = [_in_units(system, _total([loads[b][1] for b in block])) for block in system.loads]
    return np.concatenate(rest), np.concatenate(move)


def _total(wrenches: list[Array]) -> Array:
    total = wrenches[0]
    for wrench in wrenches[1:]:
        total = total + wrench
    return total


def _in_units(system: System, wrench: Array) -> Array:
    moment = wrench[3:] - cross(system.reference.reshape(3, *[1] * (wrench.ndim - 1)), wrench[:3])
    return np.concatenate([wrench[:3], moment / system.length]) / system.force


def functional(system: System, y: Array, block: int, weight: Array | float) -> Functional:
    """y (6 K, ...), which acts on a system's scaled wrenches, as it acts on those of the bodies of one block."""
    own = y[6 * block : 6 * block + 6]
    moment = own[3:] / (system.length * system.force)
    reference = system.reference.reshape(3, *[1] * (y.ndim - 1))
    return Functional(own[:3] / system.force + cross(reference, moment), moment, weight)


def at_lowest(
    scene: Scene,
    motion: Motion,
    values: Parameters,
    goals: list[tuple[int, Functional]],
    joint_goal: Array | float = 0.0,
) -> Parameters:
    """Ends of the intervals of mass, centre of mass and acceleration error at which a sum of functionals is lowest.

    goals: body and the functional of its wrench; joint_goal: (n, T) what the sum gains directly from the error. The
    bodies are independent, and each is tried at all its ends; then the error, in which the sum is linear.
    """
    tray = tray_motion(motion, values.error)
    mass, com = values.mass.copy(), values.com.copy()
    for b, goal in goals:
        _lowest_ends(scene, b, tray, goal, mass, com)
    gain = np.zeros_like(values.error) + joint_goal
    for b, goal in goals:
        gain += _gain_of_error(scene.bodies[b], motion, goal, mass[b], com[b])
    low, high = scene.lower.error[:, None], scene.upper.error[:, None]
    return replace(values, mass=mass, com=com, error=np.where(gain > 0.0, low, high))


def _lowest_ends(scene: Scene, b: int, tray: Tray, goal: Functional, mass: Array, com: Array) -> None:
    """Set mass (B, T) and com (B, 3, T) of one body to the ends of their intervals where the goal is lowest."""
    ends = np.array([np.r_[p.mass[b], p.com[b]] for p in (scene.lower, scene.upper)])
    wide = ends[0] < ends[1]
    lowest = np.full(mass.shape[1:], np.inf)
    best = np.zeros((4, *mass.shape[1:]))
    for choice in ENDS:
        if any(end and not w for end, w in zip(choice, wide, strict=True)):
            continue
        corner = ends[choice, range(4)]
        value = goal(*body_load(scene.bodies[b], tray, corner[:1], corner[1:, None]))
        better = value < lowest
        lowest = np.where(better, value, lowest)
        best[:, better] = corner[:, None]
    mass[b], com[b] = best[0], best[1:]


def _gain_of_error(body: Body, motion: Motion, goal: Functional, mass: Array, com: Array) -> Array:
    """Derivative of the goal of a body's wrench with respect to the joint acceleration error, (n, T)."""
    center = np.tensordot(body.turn, com, axes=1) + body.center[:, None]
    push = goal.force + cross(goal.moment, center)
    twist = cross(center, push) + np.tensordot(body.inertia, goal.moment, axes=1)
    pull = np.concatenate([push, twist])
    return np.asarray(mass * (motion.jacobian * pull[:, None]).sum(axis=0))


def cross(a: Array, b: Array) -> Array:
    """Cross product along the first axis."""
    return np.stack([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])
