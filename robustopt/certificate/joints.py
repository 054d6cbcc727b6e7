"""Utilisation of the joint limits: position, velocity, acceleration with its error, torque with payload and friction.

Without a floating base, or on a single environment contact, the torques follow from the motion. For several contacts
see `shared_torque`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from robustopt.arrays import Array, Indices
from robustopt.certificate.bodies import Parameters
from robustopt.certificate.loads import Functional, Load, at_lowest, body_loads
from robustopt.certificate.motion import Instants, Joints, Motion
from robustopt.certificate.tally import Found, Tally
from robustopt.certificate.task import Task
from robustopt.certificate.world import World
from robustopt.limits.names import LimitKind, LimitName
from robustopt.robot.joint_limits import JointLimits
from robustopt.solvers import Plan

JUMP_TIME = 1e-6
"""Time that a jump of the acceleration is taken to last [s]: with it, rounding errors of a continuous acceleration stay
far below a limit, and a jump is far above."""


def check_kinematics(world: World, joints: Joints, free: Array, limits: JointLimits, tally: Tally) -> None:
    """Check position, velocity and acceleration, with the acceleration error at its worse end."""
    motors = slice(world.base, None)
    lower, upper = world.lower.error[motors, None], world.upper.error[motors, None]
    above, below = joints.acceleration + upper * free, joints.acceleration + lower * free
    acceleration = np.maximum(above, -below) / limits.acceleration[motors, None]
    chosen = np.where(above > -below, upper, lower)
    velocity = np.abs(joints.velocity) / limits.velocity[motors, None]
    position = _position(joints.position, limits.lower[motors, None], limits.upper[motors, None])
    for kind, utilisation in (
        (LimitKind.POSITION, position), (LimitKind.VELOCITY, velocity), (LimitKind.ACCELERATION, acceleration),
    ):  # fmt: skip
        for j, joint in enumerate(world.joints[motors]):
            wrong = kind is LimitKind.ACCELERATION and (lower[j] or upper[j])
            for t in tally.peaks(utilisation[j], np.arange(len(free))):
                parameters = {"joint_acceleration": {joint: float(chosen[j, t])}} if wrong else {}
                name = LimitName(kind, joint)
                tally.add(name, Found(float(utilisation[j, t]), t, name, parameters))
        tally.tests += utilisation.size


def check_jerk(plan: Plan, task: Task, at: Instants, tally: Tally) -> None:
    """Check the jerk of the joints within the intervals, and that their acceleration does not jump in between.

    Args:
        plan: the plan.
        task: robot, path and limits.
        at: the instants.
        tally: receives the worst utilisations.
    """
    robot, limits = task.robot, task.limits.jerk
    chosen = np.flatnonzero(np.isfinite(limits))
    if not len(chosen):
        return
    piece, speed = at.node_piece[at.node], np.sqrt(at.x)
    q1, q2, q3 = (
        task.path.evaluate(s, piece, order)[:, chosen].T for s, order in ((at.s, 1), (at.s, 2), (at.inside, 3))
    )
    jerk = np.abs(q3 * speed**3 + 3.0 * q2 * speed * at.u + q1 * at.rate)
    start, end = task.path.end_accelerations
    after, before = np.r_[plan.u, end], np.r_[start, plan.u_end]  # 0 at rest and on the intervals without length
    jumps = np.abs(after - before) / JUMP_TIME
    where = np.flatnonzero(at.grid)
    nearest = where[np.argmin(np.abs(at.s[where][None] - plan.s[:, None]), axis=1)]
    rate = np.abs(task.path.evaluate(plan.s, plan.piece, 1))[:, chosen]
    for k, j in enumerate(chosen):
        name = LimitName(LimitKind.JERK, robot.joint_names[j])
        for t in tally.peaks(jerk[k], np.arange(len(at.s))):
            tally.add(name, Found(float(jerk[k, t] / limits[j]), t, name, {}))
        jumped = int(np.argmax(rate[:, k] * jumps))
        tally.add(name, Found(float(rate[jumped, k] * jumps[jumped] / limits[j]), int(nearest[jumped]), name, {}))
    tally.tests += jerk.size + rate.size


def _position(position: Array, low: Array, high: Array) -> Array:
    """Return the distance from the middle of the range as a share of half the range, (m, T).

    For a joint without limits it is 0. For a joint with a single limit it is 1 plus the distance beyond the limit [rad
    or m], but at least 0.
    """
    both = np.isfinite(low) & np.isfinite(high)
    bottom, top = np.where(both, low, -1.0), np.where(both, high, 1.0)
    middle, half = 0.5 * (bottom + top), 0.5 * (top - bottom)
    beyond = np.maximum(position - high, low - position)
    return np.where(both, np.abs(position - middle) / half, np.maximum(0.0, 1.0 + beyond))


def torques(world: World, joints: Joints, free: Array, loads: Sequence[Load], values: Parameters) -> Array:
    """Return the joint torques (m, ...) [N m or N] for given values, with the wrenches of all bodies.

    Dry friction acts in the worse direction on joints that do not move.
    """
    wrenches: dict[str, Array] = {}
    for body, (rest, move) in zip(world.bodies, loads, strict=True):
        if body.payload:
            wrenches[body.frame] = wrenches.get(body.frame, 0.0) + rest + move
    shaking = [(other, free * value) for other, value in enumerate(values.error) if np.any(value)]
    torque = []
    for j, total in enumerate(joints.torque):
        for frame, wrench in wrenches.items():
            total = total + sum(joints.to_torque[frame][j, k] * part for k, part in enumerate(wrench))
        for other, value in shaking:
            total = total + joints.inertia[j, other] * value
        total = total + joints.squeeze[j] * values.force[-1]
        torque.append(total + joints.sticking[j] * np.where(total < 0.0, -1.0, 1.0))
    return np.stack(torque)


@dataclass(frozen=True, eq=False)
class KnownTorques:
    """Joints whose torque follows from the motion.

    Attributes:
        joints: the joints.
        limits: torque limits (m,) [N m or N].
        at: indices of the instants.
    """

    joints: Joints
    limits: Array
    at: Indices


def check_torque(world: World, motion: Motion, known: KnownTorques, tally: Tally) -> None:
    """Check the torque of each joint, in both directions and at every instant, at the worst ends of the intervals.

    The torque of a joint is a linear function of the wrenches of the bodies and of the acceleration error. So the worst
    ends are exact except for the product of the two.

    Args:
        world: the bodies.
        motion: motion at the instants of `known`.
        known: the joints.
        tally: receives the worst utilisations.
    """
    start = world.nominal.repeated(len(motion.free))
    loads = body_loads(world, motion, start)
    for j in range(len(known.limits)):
        one = known.joints.only(j)
        for sign in (1.0, -1.0):
            values = start
            if world.uncertain:
                functionals = [
                    Functional(b, -sign * one.to_torque[body.frame][0, :3], -sign * one.to_torque[body.frame][0, 3:])
                    for b, body in enumerate(world.bodies)
                    if body.payload
                ]
                values = at_lowest(world, motion, start, functionals, -sign * one.inertia[0])
                values.force[-1] = np.where(sign * one.squeeze[0] > 0.0, world.upper.force[-1], world.lower.force[-1])
                loads = body_loads(world, motion, values)
            torque = torques(world, one, motion.free, loads, values)
            tell_torque(world, np.abs(torque[0]) / known.limits[j], j, values, known.at, tally)


def tell_torque(world: World, utilisation: Array, j: int, values: Parameters, at: Indices, tally: Tally) -> None:
    """Add the utilisation (k,) of the torque of motor j at instants `at`, for k sets of values, to the tally."""
    name = LimitName(LimitKind.TORQUE, world.joints[world.base + j])
    for k in tally.peaks(utilisation, at):
        if tally.exceeds(name, float(utilisation[k]), int(at[k])):
            tally.add(name, Found(float(utilisation[k]), int(at[k]), name, world.describe(values.at(k), None)))
    tally.tests += utilisation.size
