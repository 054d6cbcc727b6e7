"""Motion of robot and carrier along a path, affine in u = sdd, x = sd^2 and the acceleration error."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from robustopt.arrays import Array
from robustopt.limits.bodies import regressor, spin_regressor
from robustopt.robot import Dynamics, Robot
from robustopt.robot.dynamics import CarrierMotion


@dataclass(frozen=True, eq=False)
class PathMotion:
    """Motion along a path at P grid points.

    Attributes:
        q: coordinates (P, n).
        q1: q' (P, n).
        q2: q'' (P, n).
        dynamics: dynamics of the links alone.
        regressors: wrench per inertial parameter about the carrier's origin, carrier axes, per u, x, 1 and acceleration
            error of each coordinate (P, 3 + n, 6, 10); None for a robot that carries nothing.
    """

    q: Array
    q1: Array
    q2: Array
    dynamics: Dynamics
    regressors: Array | None

    @property
    def carrier(self) -> CarrierMotion:
        """Return the motion of the carrier frame of a robot that has one."""
        assert self.dynamics.carrier is not None, "this robot carries nothing"
        return self.dynamics.carrier

    @property
    def wrench_map(self) -> Array:
        """Return the regressors of a robot that has a carrier frame."""
        assert self.regressors is not None, "this robot carries nothing"
        return self.regressors

    def squeeze_torque(self, direction: Array) -> Array:
        """Return the generalised force of a unit internal force between the first two hands, (P, n) [N m].

        Args:
            direction: direction of the force, carrier frame (3,).
        """
        hands = self.carrier.hands
        assert hands is not None, "a single tool has no internal force"
        return np.asarray(np.einsum("pcj,c->pj", (hands[0] - hands[1])[:, :3], direction))


def path_motion(robot: Robot, q: Array, q1: Array, q2: Array) -> PathMotion:
    """Return the motion of a robot along a path.

    Args:
        robot: the robot.
        q: coordinates at the grid points (P, n) [rad or m].
        q1: derivatives q'(s) (P, n).
        q2: second derivatives q''(s) (P, n).
    """
    dynamics = robot.dynamics(q, q1, q2)
    carrier = dynamics.carrier
    return PathMotion(q, q1, q2, dynamics, None if carrier is None else _regressors(carrier, q1, q2))


def _regressors(carrier: CarrierMotion, q1: Array, q2: Array) -> Array:
    points, joints = q1.shape
    J = carrier.jacobian
    linear, angular = np.zeros((points, 3 + joints, 3)), np.zeros((points, 3 + joints, 3))
    per_u = np.einsum("pij,pj->pi", J, q1)
    per_x = np.einsum("pij,pj->pi", J, q2) + carrier.bias
    linear[:, 0], linear[:, 1], linear[:, 2] = per_u[:, :3], per_x[:, :3], -carrier.gravity
    angular[:, 0], angular[:, 1] = per_u[:, 3:], per_x[:, 3:]
    linear[:, 3:], angular[:, 3:] = np.swapaxes(J[:, :3], 1, 2), np.swapaxes(J[:, 3:], 1, 2)
    regressors = regressor(linear, angular)
    regressors[:, 1] += spin_regressor(per_u[:, 3:])
    return regressors
