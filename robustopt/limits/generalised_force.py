"""Generalised force W of the motion of a legged robot, as a function of the uncertain quantities.

W (n,) is affine in (u, x): first the wrench that the environment contacts must supply, about the world's origin, then
the joint torques without them. An acceleration error e adds M e. A body enters through its ten inertial parameters, as
the force J^T w of its required wrench: bodies of the robot whose mass or centre of mass is uncertain, in place of their
nominal values, and all that the robot carries.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from robustopt.arrays import Array, Indices
from robustopt.limits.bodies import Body, regressor, spin_regressor, uncertain_body
from robustopt.limits.motion import PathMotion
from robustopt.limits.polygons import RequiredWrench
from robustopt.limits.uncertainty import Uncertainty
from robustopt.robot import Robot
from robustopt.robot.dynamics import BodyMotion


def generalised_force(robot: Robot, motion: PathMotion, uncertainty: Uncertainty) -> RequiredWrench:
    """Return the generalised force of a legged robot.

    Args:
        robot: the robot.
        motion: motion along the path.
        uncertainty: the uncertain quantities.

    Returns:
        Generalised force (P, n, ...) [N, N m].
    """
    total = _Total(motion, *uncertainty.error.arrays)
    for body, moving, nominal in _bodies(robot, motion, uncertainty):
        total.add(body, moving, nominal)
    if uncertainty.squeeze and len(robot.hands) > 1:
        between = robot.hands[1].point - robot.hands[0].point
        total.add_interval(uncertainty.squeeze * motion.squeeze_torque(between / np.linalg.norm(between)))
    return total.loads()


def _bodies(
    robot: Robot, motion: PathMotion, uncertainty: Uncertainty
) -> Iterator[tuple[Body, BodyMotion, Array | None]]:
    """Yield the bodies to add, their motion, and the inertial parameters that the robot's model has for them."""
    for name, interval, reach in uncertainty.robot_bodies:
        mass, center, inertia = robot.inertia_of(name)
        body = uncertain_body(name, interval or (mass, mass), center, inertia / mass, np.diag(reach))
        yield body, robot.body_motion(name, motion.q, motion.q1, motion.q2), mass * body.psi
    if motion.dynamics.carrier is not None:
        carried = _carrier_motion(motion, robot.base)
        for body in uncertainty.bodies:
            yield body, carried, None


def _carrier_motion(motion: PathMotion, base: int) -> BodyMotion:
    """Return the motion of the carrier frame as a body motion."""
    carrier = motion.carrier
    J, R, p = carrier.jacobian, carrier.rotation, carrier.position
    per_u = (J @ motion.q1[:, :, None])[:, :, 0]
    per_x = (J @ motion.q2[:, :, None])[:, :, 0] + carrier.bias
    to_force = np.swapaxes(J, 1, 2).copy()
    to_force[:, :base] = 0.0
    to_force[:, :3, :3] = to_force[:, 3:base, 3:] = R
    to_force[:, 3:base, :3] = np.cross(p[:, None], np.swapaxes(R, 1, 2)).swapaxes(1, 2)
    return BodyMotion(
        per_u[:, :3], per_x[:, :3], -carrier.gravity, per_u[:, 3:], per_x[:, 3:], per_u[:, 3:], J, to_force
    )  # fmt: skip


class _Total:
    """The generalised force of the links, to which bodies are added."""

    def __init__(self, motion: PathMotion, middle: Array, radius: Array) -> None:
        dynamics = motion.dynamics
        self._middle, self._radius = middle, radius
        self._erring: Indices = np.flatnonzero(radius)
        nominal = np.stack([dynamics.force_u, dynamics.force_x, dynamics.force_0], axis=2)
        nominal[:, :, 2] += dynamics.mass_matrix @ middle
        self._shape = dynamics.force_u.shape
        self._groups = [nominal]
        self._shaken = [np.swapaxes(dynamics.mass_matrix[:, :, self._erring], 1, 2)]
        self._varying: list[tuple[Body, int, Array, Array]] = []
        self._lowest, self._highest = [1.0], [1.0]
        self._intervals: list[Array] = []

    def add(self, body: Body, moving: BodyMotion, nominal: Array | None) -> None:
        """Add a body; `nominal` (10,) are the inertial parameters that the model of the links has for it already."""
        certain = body.mass[0] == body.mass[1]
        factor = body.mass[0] if certain else 1.0
        parameters = factor * np.vstack([body.psi, body.linear, body.moments])
        forces, shakes = _forces(moving, parameters, self._erring, self._middle)
        group = 0 if certain else len(self._groups)
        if nominal is not None:
            known, shake = _forces(moving, nominal[None], self._erring, self._middle)
            self._groups[0], self._shaken[0] = self._groups[0] - known[0], self._shaken[0] - shake[0]
        if certain:
            self._groups[0], self._shaken[0] = self._groups[0] + forces[0], self._shaken[0] + shakes[0]
        else:
            self._groups, self._shaken = [*self._groups, forces[0]], [*self._shaken, shakes[0]]
            self._lowest, self._highest = [*self._lowest, body.mass[0]], [*self._highest, body.mass[1]]
        self._varying.append((body, group, forces[1:], shakes[1:]))

    def add_interval(self, term: Array) -> None:
        """Add an interval term (P, n) that depends on neither u nor x, with a factor in [-1, 1]."""
        self._intervals.append(term)

    def loads(self) -> RequiredWrench:
        """Return the generalised force of the links and all bodies."""
        radius = self._radius[self._erring, None]
        constant = [np.swapaxes(shake * radius, 1, 2) for shake in self._shaken]
        constant += [term[:, :, None] for term in self._intervals]
        groups = np.r_[np.repeat(np.arange(len(self._groups)), len(self._erring)), np.zeros(len(self._intervals), int)]
        bodies = [(body, group) for body, group, _, _ in self._varying if len(body.moments)]
        counts = [len(body.linear) for body, _, _, _ in self._varying]
        parts = [(forces, shakes) for _, _, forces, shakes in self._varying]
        terms = [(forces[:n], shakes[:n]) for n, (forces, shakes) in zip(counts, parts, strict=True)]
        moments = [(forces[n:], shakes[n:]) for n, (forces, shakes) in zip(counts, parts, strict=True)]
        changes = [np.swapaxes(shakes * radius, 2, 3) for _, shakes in terms + moments]
        return RequiredWrench(
            nominal=np.ascontiguousarray(np.stack(self._groups, axis=2)),
            terms=self._stacked([forces for forces, _ in terms], 3),
            group=np.repeat([g for _, g, _, _ in self._varying], counts).astype(np.int64),
            moments=self._stacked([forces for forces, _ in moments], 3),
            moment_group=np.array([g for _, g in bodies], dtype=np.int64),
            usual=np.concatenate([np.zeros(0), *(body.usual for body, _ in bodies)]),
            round=np.array([body.round for body, _ in bodies], dtype=bool),
            constant=np.ascontiguousarray(np.concatenate(constant, axis=2)),
            constant_group=groups,
            products=self._stacked(changes, len(self._erring)),
            lowest=np.array(self._lowest),
            highest=np.array(self._highest),
        )

    def _stacked(self, terms: Sequence[Array], columns: int) -> Array:
        """Return terms (k, P, n, columns) one after the other, (P, n, K, columns)."""
        together = np.concatenate([np.zeros((0, *self._shape, columns)), *terms])
        return np.ascontiguousarray(np.moveaxis(together, 0, 2))


def _forces(moving: BodyMotion, parameters: Array, erring: Indices, middle: Array) -> tuple[Array, Array]:
    """Return the generalised forces of a body for K sets of its inertial parameters (K, 10).

    Coefficients of u, x, 1 (K, P, n, 3) with the acceleration error at its middle, and per acceleration error
    (K, P, E, n).
    """
    columns = np.r_[erring, np.flatnonzero(middle)]
    jacobian = np.swapaxes(moving.jacobian[:, :, columns], 1, 2)
    none = np.zeros_like(moving.linear_u)[:, None]
    linear = np.concatenate([np.stack([moving.linear_u, moving.linear_x, moving.linear_0], 1), jacobian[..., :3]], 1)
    angular = np.concatenate([np.stack([moving.angular_u, moving.angular_x], 1), none, jacobian[..., 3:]], 1)
    Y = regressor(linear, angular)
    Y[:, 1] += spin_regressor(moving.spin)
    wrenches = np.einsum("pcij,kj->kpci", Y, parameters)
    forces = wrenches @ np.swapaxes(moving.to_force, 1, 2)
    per_unit, shakes = np.swapaxes(forces[:, :, :3], 2, 3).copy(), forces[:, :, 3 : 3 + len(erring)]
    shift = middle[np.flatnonzero(middle)]
    per_unit[..., 2] += np.einsum("kpen,e->kpn", forces[:, :, 3 + len(erring) :], shift)
    return per_unit, shakes
