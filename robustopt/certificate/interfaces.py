"""Friction and tipping utilisation of each contact over time, at the configured values: for plotting."""

from __future__ import annotations

import numpy as np

from robustopt.arrays import Array
from robustopt.certificate.balance import balance, required
from robustopt.certificate.force_closure import GAP
from robustopt.certificate.loads import body_loads
from robustopt.certificate.motion import Motion, instants, motion, stances
from robustopt.certificate.systems import System
from robustopt.certificate.world import World, build_world
from robustopt.config import Config
from robustopt.solvers import Plan


def interface_utilisation(config: Config, plan: Plan) -> tuple[Array, dict[str, tuple[Array, Array]]]:
    """Return the utilisation of every contact of the objects at both ends of each interval, in the order of time.

    Args:
        config: the configuration whose friction and masses count.
        plan: the plan.

    Returns:
        Times (M,) [s], each inner one twice as u jumps there, and by the name of the contact ("upper on lower") the
        slip utilisation |f_t| / (mu f_z), (M,), and the tipping utilisation, (M,): the share of its way from standstill
        to the edge of the patch that the centre of pressure has gone. Both are 1 at the limit and infinite where the
        contact opens. A bridge, cups and pads have the gauge of their balance in place of the first ("balance of plank
        on left and right"), and the second is not a number: the motion does not determine how they share the wrench,
        and a vacuum may be used up without slip or tipping.
    """
    at = instants(plan, ())
    world = build_world(config, plan.problem.robot, plan.problem.path, stances(plan, at))
    moving = np.flatnonzero(at.free > 0.0)
    there = motion(plan, at, world.links)[0].at(moving)
    result = {}
    for system in world.systems:
        if system.at is None and system.simple and not system.pull.any():
            result[system.name.removeprefix("contact of ")] = _slip_and_tipping(world, system, there)
        elif system.at is None:
            values = world.nominal.repeated(len(moving))
            result[system.name] = balance(world, system, there, values, GAP).value, np.full(len(moving), np.nan)
    return at.t[moving], result


def _slip_and_tipping(world: World, system: System, there: Motion) -> tuple[Array, Array]:
    values = world.nominal.repeated(len(there.free))
    rest, move = required(world, system, there, body_loads(world, there, values), values)
    wrench, mu = rest + move, world.nominal.friction[system.contacts[0]]
    with np.errstate(divide="ignore", invalid="ignore"):
        slip = np.where(wrench[2] > 0.0, np.hypot(wrench[0], wrench[1]) / (mu * wrench[2]), np.inf)
        start, end = (np.stack([-part[4], part[3]]) / part[2] for part in (rest, wrench))
        tipping = np.where((wrench[2] > 0.0) & (rest[2] > 0.0), _way_to_edge(system.point[:2], start, end), np.inf)
    return slip, tipping


def _way_to_edge(polygon: Array, start: Array, end: Array) -> Array:
    """Return |end - start| as a share of the way from start to the edge of the convex polygon (2, n), (M,)."""
    edge = np.roll(polygon, -1, axis=1) - polygon
    normal = np.stack([edge[1], -edge[0]])
    room = (normal * polygon).sum(axis=0)[:, None] - normal.T @ start
    share = np.where(room > 0.0, (normal.T @ (end - start)) / room, np.inf)
    return np.asarray(np.maximum(share.max(axis=0), 0.0))
