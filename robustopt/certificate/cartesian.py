"""Utilisation of the Cartesian limits: speed and acceleration of the tool and of bodies, with the acceleration error.

The motion of the tool frame follows from that of the carrier frame by the mechanics of a rigid body.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from robustopt.arrays import Array
from robustopt.certificate.motion import CARRIER, Instants, Motion
from robustopt.certificate.tally import Found, Tally
from robustopt.certificate.task import Task
from robustopt.certificate.world import World
from robustopt.config import TOOL, Config
from robustopt.limits.names import LimitKind, LimitName

SWEEPS = 4
"""Rounds of the search for the worst acceleration error, each of which increases the acceleration."""


def bodies_of(task: Task) -> tuple[str, ...]:
    """Return the names of the bodies with Cartesian limits, whose frames `motion` must give.

    The name `tool` is that of the tool frame if the robot carries something, else of a body.
    """
    carries = task.robot.has_carrier
    return tuple(name for name in task.config.robot.limits.cartesian or () if not (carries and name == TOOL))


def check_cartesian(world: World, task: Task, motion: Motion, at: Instants, tally: Tally) -> None:
    """Check the speed and the acceleration of every point that has a limit.

    Args:
        world: the acceleration error.
        task: robot, path and limits.
        motion: motion at the instants, with the frames of `bodies_of`.
        at: the instants.
        tally: receives the worst utilisations.
    """
    qd = np.sqrt(at.x) * task.path.evaluate(at.node_s, at.node_piece, 1)[at.node].T
    for name, limit in (task.config.robot.limits.cartesian or {}).items():
        of_tool = name not in bodies_of(task)
        frame = motion.frames[CARRIER if of_tool else name]
        arm = np.tile(_tool_in_carrier(task.config) if of_tool else np.zeros(3), (len(at.s), 1)).T
        jacobian = frame.jacobian[:3] - np.cross(arm[:, None], frame.jacobian[3:], axis=0)
        speed = np.linalg.norm(np.einsum("int,nt->it", jacobian, qd), axis=0)
        acceleration = frame.linear + np.cross(frame.angular, arm, axis=0)
        acceleration += np.cross(frame.spin, np.cross(frame.spin, arm, axis=0), axis=0)
        most = _most(acceleration, jacobian * at.free, world.lower.error, world.upper.error)
        for kind, values, largest in (
            (LimitKind.CARTESIAN_SPEED, speed, limit.speed),
            (LimitKind.CARTESIAN_ACCELERATION, most, limit.acceleration),
        ):
            label = LimitName(kind, name)
            for t in tally.peaks(values, np.arange(len(values))) if largest is not None else ():
                tally.add(label, Found(float(values[t] / largest), t, label, {}))
        tally.tests += 2 * speed.size


def _most(acceleration: Array, jacobian: Array, low: Array, high: Array) -> Array:
    """Return the largest norm (T,) that a search finds of accelerations (3, T) and errors between two ends (n,)."""
    middle, radius = 0.5 * (low + high), 0.5 * (high - low)
    mean = acceleration + np.einsum("int,n->it", jacobian, middle)
    worst = mean
    for _ in range(SWEEPS if radius.any() else 0):
        signs = np.sign(np.einsum("int,it->nt", jacobian, worst))
        worst = mean + np.einsum("int,nt->it", jacobian, radius[:, None] * signs)
    return np.asarray(np.linalg.norm(worst, axis=0))


def _tool_in_carrier(config: Config) -> Array:
    """Return the origin of the tool frame in the carrier frame, in which the tray is given (3,) [m]."""
    if config.tray is None:
        return np.zeros(3)
    pose = config.tray.pose
    return np.asarray(-Rotation.from_euler("xyz", pose.rpy).as_matrix().T @ pose.position)
