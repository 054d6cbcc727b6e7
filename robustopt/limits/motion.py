"""Motion of robot and carrier along a path, affine in u = sdd, x = sd^2 and the acceleration error."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from robustopt.arrays import Array
from robustopt.limits.bodies import regressor, spin_regressor
from robustopt.robot import Dynamics, Robot
from robustopt.robot.dynamics import CarrierMotion


@dataclass(frozen=True, eq=False)
class PathMotion:
    """Motion along a path at P grid points.

    The dynamics are computed when they are first asked for: limits of velocity and acceleration need none.

    Attributes:
        robot: the robot.
        q: coordinates (P, n) [rad or m].
        q1: derivatives q'(s) (P, n).
        q2: second derivatives q''(s) (P, n).
    """

    robot: Robot = field(repr=False)
    q: Array
    q1: Array
    q2: Array

    @cached_property
    def dynamics(self) -> Dynamics:
        """Return the dynamics of the links alone."""
        return self.robot.dynamics(self.q, self.q1, self.q2)

    @property
    def carrier(self) -> CarrierMotion:
        """Return the motion of the carrier frame of a robot that has one."""
        assert self.dynamics.carrier is not None, "this robot carries nothing"
        return self.dynamics.carrier

    @cached_property
    def wrench_map(self) -> Array:
        """Return the wrench per inertial parameter about the carrier's origin of a robot that has a carrier frame.

        It is in carrier axes, per u, x, 1 and acceleration error of each coordinate (P, 3 + n, 6, 10).
        """
        return _regressors(self.carrier, self.q1, self.q2)

    def squeeze_torque(self, direction: Array) -> Array:
        """Return the generalised force of a unit internal force between the first two hands, (P, n) [N m].

        Args:
            direction: direction of the force, carrier frame (3,).
        """
        hands = self.carrier.hands
        assert hands is not None, "a single tool has no internal force"
        return np.asarray(np.einsum("pcj,c->pj", (hands[0] - hands[1])[:, :3], direction))


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
