"""Friction and tipping utilisation of each interface over time, at the configured values: for plotting."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from robustopt.certificate.contact_points import Array
from robustopt.certificate.contacts import solve
from robustopt.certificate.force_closure import GAP
from robustopt.certificate.loads import body_loads, cross, tray_motion
from robustopt.certificate.motion import Motion, instants, motion
from robustopt.certificate.scene import Scene, System, build_scene
from robustopt.config import Config

if TYPE_CHECKING:
    from robustopt.solvers import Plan


def interface_utilisation(config: Config, plan: Plan) -> tuple[Array, dict[str, tuple[Array, Array]]]:
    """Utilisation of every interface at both ends of each interval of the grid, in the order of time.

    Returns the times (M,) [s], each inner one twice as u jumps there, and by the name of the interface ("upper on
    lower") the slip utilisation |f_t| / (mu f_z), (M,), and the tipping utilisation, (M,): the share of its way from
    standstill to the edge of the patch that the centre of pressure has gone. Both are 1 at the limit and infinite where
    the object lifts off. The load of a bridge on its supports is not determined by its motion: there the first is the
    gauge of the balance of all ("balance of plank on left and right"), and the second is not a number.
    """
    at = instants(plan, ())
    moving = np.flatnonzero(at.free > 0.0)
    there = motion(plan, at).at(moving)
    scene = build_scene(config, plan.problem.robot.joint_names)
    result = {}
    for system in scene.systems:
        if len(system.interfaces) == 1:
            result[scene.interface_name(system.interfaces[0])] = _slip_and_tipping(scene, system, there)
        else:
            values = scene.nominal.repeated(len(moving))
            balance = solve(scene, there, system, values, GAP).value
            result[system.name] = balance, np.full(len(moving), np.nan)
    return at.t[moving], result


def _slip_and_tipping(scene: Scene, system: System, there: Motion) -> tuple[Array, Array]:
    values = scene.nominal.repeated(len(there.free))
    loads = body_loads(scene, tray_motion(there, values.error), values)
    rest = np.sum([loads[b][0] for b in system.loads[0]], axis=0)
    wrench = rest + np.sum([loads[b][1] for b in system.loads[0]], axis=0)
    patch = scene.points[:, system.points]
    mu = scene.nominal.friction[system.interfaces[0]]
    with np.errstate(divide="ignore", invalid="ignore"):
        slip = np.where(wrench[2] > 0.0, np.hypot(wrench[0], wrench[1]) / (mu * wrench[2]), np.inf)
        start, end = _center_of_pressure(rest, patch[2, 0]), _center_of_pressure(wrench, patch[2, 0])
        tipping = np.where((wrench[2] > 0.0) & (rest[2] > 0.0), _way_to_edge(patch[:2], start, end), np.inf)
    return slip, tipping


def _center_of_pressure(wrench: Array, height: float) -> Array:
    """Where the wrench about the tray's origin presses on the plane at `height`, (2, M) [m]."""
    arm = np.array([0.0, 0.0, height])[:, None]
    moment = wrench[3:] - cross(arm, wrench[:3])
    return np.asarray(np.stack([-moment[1], moment[0]]) / wrench[2])


def _way_to_edge(polygon: Array, start: Array, end: Array) -> Array:
    """|end - start| as a share of the distance from start to the edge of the convex polygon (2, n) that way, (M,)."""
    edge = np.roll(polygon, -1, axis=1) - polygon
    normal = np.stack([edge[1], -edge[0]])
    room = (normal * polygon).sum(axis=0)[:, None] - normal.T @ start
    share = np.where(room > 0.0, (normal.T @ (end - start)) / room, np.inf)
    return np.asarray(np.maximum(share.max(axis=0), 0.0))
