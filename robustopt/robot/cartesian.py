"""Points of a robot whose speed and acceleration in the world are limited, from `robot.limits.cartesian`."""

from __future__ import annotations

import difflib
from collections.abc import Collection
from dataclasses import dataclass
from math import inf

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from robustopt.arrays import Array
from robustopt.config import TOOL, Config
from robustopt.errors import ConfigProblem, RobotError

MOST_NEAR = 3
"""Most similar names that an error lists first."""


@dataclass(frozen=True, eq=False)
class LimitedPoint:
    """The origin of a frame whose speed or acceleration is limited.

    Attributes:
        name: `tool`, or the name of the body.
        body: index of the body that carries the point.
        place: position in the frame of the body (3,) [m].
        speed: largest speed; infinite for none [m/s].
        acceleration: largest acceleration; infinite for none [m/s^2].
    """

    name: str
    body: int
    place: Array
    speed: float
    acceleration: float


@dataclass(frozen=True, eq=False)
class PointMotion:
    """Motion of a limited point along a path at P points, world axes.

    It moves with the velocity `first * sd` and accelerates by `first * u + second * x`.

    Attributes:
        point: the point.
        first: p'(s) (P, 3) [m].
        second: p''(s) (P, 3) [m].
        jacobian: Jacobian (P, 3, n).
    """

    point: LimitedPoint
    first: Array
    second: Array
    jacobian: Array


def limited_points(config: Config, model: mujoco.MjModel, carrier: int | None) -> tuple[LimitedPoint, ...]:
    """Return the points that `robot.limits.cartesian` names.

    Args:
        config: the configuration.
        model: the model of the links alone.
        carrier: index of the site of the carrier frame; None for a robot that carries nothing.

    Raises:
        RobotError: the robot has no such bodies, or no tool frame; the error lists all of them.
    """
    given = config.robot.limits.cartesian or {}
    bodies = [model.body(k).name for k in range(1, model.nbody) if model.body(k).name]
    unknown = [name for name in given if name not in bodies and (name != TOOL or carrier is None)]
    if unknown:
        key = "robot.limits.cartesian"
        raise RobotError([ConfigProblem(f"{key}.{it}", _unknown(it, bodies, carrier is not None)) for it in unknown])
    points = []
    for name, limit in given.items():
        if name == TOOL and carrier is not None:
            body, place = _tool(config, model, carrier)
        else:
            body, place = model.body(name).id, np.zeros(3)
        ends = (inf if value is None else value for value in (limit.speed, limit.acceleration))
        points.append(LimitedPoint(name, body, place, *ends))
    return tuple(points)


def point_motion(model: mujoco.MjModel, point: LimitedPoint, q: Array, q1: Array, q2: Array) -> PointMotion:
    """Return the motion of a point along a path.

    Args:
        model: the model of the links alone.
        point: the point.
        q: coordinates (P, n) [rad or m].
        q1: derivatives q'(s) (P, n).
        q2: second derivatives q''(s) (P, n).
    """
    data, jacobian, rate = mujoco.MjData(model), np.empty((*q.shape[:1], 3, model.nv)), np.empty((3, model.nv))
    bias = np.empty((len(q), 3))
    for i in range(len(q)):
        data.qpos[:], data.qvel[:] = q[i], q1[i]
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_comVel(model, data)
        there = data.xpos[point.body] + data.xmat[point.body].reshape(3, 3) @ point.place
        mujoco.mj_jac(model, data, jacobian[i], None, there, point.body)
        mujoco.mj_jacDot(model, data, rate, None, there, point.body)
        bias[i] = rate @ q1[i]
    first, curve = (np.einsum("pij,pj->pi", jacobian, values) for values in (q1, q2))
    return PointMotion(point, first, curve + bias, jacobian)


def _unknown(name: str, bodies: Collection[str], tool: bool) -> str:
    """Describe an unknown name, with the names that there are, the most similar first."""
    known = [TOOL, *bodies] if tool else list(bodies)
    near = difflib.get_close_matches(name, known, MOST_NEAR)
    ordered = ", ".join([*near, *(other for other in known if other not in near)])
    if name == TOOL:
        return f"the robot carries nothing, so it has no tool frame; expected one of its bodies: {ordered}"
    return f"the robot has no such body; expected one of {ordered}"


def _tool(config: Config, model: mujoco.MjModel, carrier: int) -> tuple[int, Array]:
    """Return the body of the tool frame, and the position of its origin in it (3,) [m].

    The tray has its pose in the tool frame; without a tray, the carrier frame is the tool frame.
    """
    site, turn = model.site(carrier), np.zeros(9)
    mujoco.mju_quat2Mat(turn, site.quat)
    origin = np.zeros(3)
    if config.tray is not None:
        pose = config.tray.pose
        origin = -Rotation.from_euler("xyz", pose.rpy).inv().apply(pose.position)
    return int(site.bodyid[0]), site.pos + turn.reshape(3, 3) @ origin
