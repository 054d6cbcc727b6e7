"""Objects that turn nearly in place, whose pressure is prescribed by default.

If a body with its centre of mass at distance R from the axis of a turn begins to turn, the twist about the normal of
its support is I / (m R r) of the friction force times r, the distance of the farthest corner from the middle of its
base. In MuJoCo a plan with free pressure promises up to 0.3 % too much acceleration at a twist of 0.05, 0.8 % at 0.1
and 2.8 % at 0.2 (experiments/block_twist.py). R and the direction of the turn change along the path, so that the twist
of a motion can be larger than that of its directions. So the largest one along the path counts, and the limit is 0.05
(our choice).
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from robustopt.arrays import Array
from robustopt.config import Config
from robustopt.limits.systems import carried, stands_alone
from robustopt.limits.uncertainty import bodies
from robustopt.path import Path
from robustopt.robot import Robot
from robustopt.scene.patches import Patch, patches
from robustopt.scene.placement import supports

LEAST_TWIST = 0.05
"""Twist above which the pressure of an object is prescribed by default, per friction force and size of the base."""

STILL = 1e-9
"""Rates below this part of all rates are rounding errors."""


@lru_cache(maxsize=4)
def carrier_rates(robot: Robot, path: Path) -> Array:
    """Return the rates of the carrier frame along a path, whatever the grid of a plan.

    Args:
        robot: the robot.
        path: the path.

    Returns:
        Velocity of the origin and angular velocity, carrier axes, per sd, (P, 2, 3) [m] and [rad]; empty for a robot
        that carries nothing.
    """
    if not robot.has_carrier:
        return np.zeros((0, 2, 3))
    s = path.fine_grid()
    _, axes, jacobians = robot.carrier_jacobians(path(s))
    return np.asarray((jacobians @ path(s, 1)[:, :, None]).reshape(-1, 2, 3) @ axes)


def twisted(config: Config, rates: Array) -> frozenset[str]:
    """Return the objects without a `pressure` that the path turns nearly in place.

    Objects that share their load with others, on two supports or below such an object, are not among them.

    Args:
        config: the configuration.
        rates: rates of the carrier frame (P, 2, 3).
    """
    own = {
        patch.object: patch
        for patch in patches(config)
        if supports(config.objects[patch.object])
        and config.objects[patch.object].pressure is None
        and stands_alone(config, patch.object)
    }
    return frozenset(name for name, patch in own.items() if _twist(config, patch, rates) > LEAST_TWIST)


def _twist(config: Config, patch: Patch, rates: Array) -> float:
    """Return the largest twist per friction force and size of the base, for rates (P, 2, 3) of the carrier frame."""
    every = bodies(config)
    phi = np.sum([every[name].nominal for name in carried(config, patch.object)], axis=0)
    mass, center, normal = phi[0], phi[1:4] / phi[0], patch.axes[:, 2]
    xx, yy, zz, xy, xz, yz = phi[4:]
    about_origin = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    inertia = normal @ about_origin @ normal - mass * np.sum(np.cross(normal, center) ** 2)
    size = np.linalg.norm(patch.polygon - patch.polygon.mean(axis=0), axis=1).max()
    velocity = rates[:, 0] + np.cross(rates[:, 1], center)
    sideways = np.linalg.norm(np.cross(velocity, normal), axis=1)
    least = STILL * (np.linalg.norm(velocity, axis=1) + size * np.linalg.norm(rates[:, 1], axis=1))
    used = mass * size * np.maximum(sideways, least)
    ratio = np.divide(inertia * np.abs(rates[:, 1] @ normal), used, out=np.zeros(len(used)), where=used > 0.0)
    return float(ratio.max())
