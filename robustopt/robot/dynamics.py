"""Dynamics of the links along a path, for the whole grid at once, from MuJoCo's recursive algorithms.

With u = sdd and x = sd^2 every quantity along a path q(s) is affine in (u, x): the generalised force of the motion is
force_u u + force_x x + force_0, without forces of contacts, payload and joint friction.
"""

from __future__ import annotations

from collections.abc import Mapping
from copy import copy
from dataclasses import dataclass, fields

import mujoco
import numpy as np

from robustopt.arrays import Array
from robustopt.robot.floating_base import base_to_wrench


@dataclass(frozen=True)
class CarrierMotion:
    """The motion of the carrier frame along a path at P points.

    At u = sdd and x = sd^2 the frame accelerates by `jacobian @ q1 * u + (jacobian @ q2 + bias) * x`.

    Attributes:
        position: position of the origin in the world (P, 3) [m].
        rotation: rotation from carrier axes into the world (P, 3, 3).
        jacobian: Jacobian of the origin, linear then angular, carrier axes (P, 6, n).
        bias: acceleration at qd = q'(s) and qdd = 0, linear then angular, carrier axes (P, 6) [m/s^2, rad/s^2].
        gravity: acceleration of gravity in carrier axes (P, 3) [m/s^2].
        hands: jacobians at the carrier's origin of several hands that hold the tray together (k, P, 6, n), of which
            `jacobian` is the mean weighted by their shares; None for a single tool.
    """

    position: Array
    rotation: Array
    jacobian: Array
    bias: Array
    gravity: Array
    hands: Array | None = None

    def __post_init__(self) -> None:
        _freeze(self)


@dataclass(frozen=True)
class Dynamics:
    """The inverse dynamics of the links along a path at P points, without contacts and payload.

    At u = sdd and x = sd^2 the generalised force is `force_u * u + force_x * x + force_0`. Rows of a floating base are
    the wrench on the robot, force then moment about the world's origin, world axes [N, N m]; the other rows are joint
    torques or forces [N m or N], without joint friction.

    Attributes:
        force_u, force_x, force_0: generalised force per u, per x and at rest, (P, n).
        mass_matrix: generalised force per acceleration, armature included, (P, n, n).
        contact_jacobians: by environment contact the motion of its body at the world's origin, linear then angular,
            world axes, (P, 6, n); a wrench w on the contact about the world's origin does J^T w at the joints.
        carrier: motion of the carrier frame, None if the robot has none.
    """

    force_u: Array
    force_x: Array
    force_0: Array
    mass_matrix: Array
    contact_jacobians: Mapping[str, Array]
    carrier: CarrierMotion | None

    def __post_init__(self) -> None:
        _freeze(self)


@dataclass(frozen=True)
class BodyMotion:
    """The motion of a body's frame along a path at P points, body axes.

    The acceleration of its origin less gravity is `linear_u * u + linear_x * x + linear_0`, the angular acceleration
    `angular_u * u + angular_x * x`.

    Attributes:
        linear_u, linear_x, linear_0, angular_u, angular_x: coefficients of these accelerations (P, 3) [m/s^2, rad/s^2].
        spin: angular velocity at qd = q'(s) (P, 3) [rad/s].
        jacobian: Jacobian of the origin, linear then angular (P, 6, n).
        to_force: generalised force of a wrench about the origin, base rows as in `Dynamics` (P, n, 6).
    """

    linear_u: Array
    linear_x: Array
    linear_0: Array
    angular_u: Array
    angular_x: Array
    spin: Array
    jacobian: Array
    to_force: Array


@dataclass(frozen=True)
class Frames:
    """The indices of the frames of interest in a compiled model.

    Attributes:
        base: number of base coordinates.
        contacts: index of the body of each environment contact, by name.
        carrier: index of the carrier's site; None if there is none.
        holders: index of the body and share (6, 6) of each of several hands that hold the tray; () for one tool.
    """

    base: int
    contacts: Mapping[str, int]
    carrier: int | None
    holders: tuple[tuple[int, Array], ...] = ()


def _freeze(value: CarrierMotion | Dynamics) -> None:
    """Make the arrays of a result read-only."""
    for item in fields(value):
        found = getattr(value, item.name)
        for array in found.values() if isinstance(found, Mapping) else (found,):
            if isinstance(array, np.ndarray):
                array.setflags(write=False)


def path_dynamics(model: mujoco.MjModel, frames: Frames, q: Array, q1: Array, q2: Array) -> Dynamics:
    """Return the inverse dynamics along a path.

    Args:
        model: the model of the links alone.
        frames: contacts and carrier of the model.
        q: coordinates (P, n) [rad or m].
        q1: derivatives q'(s) (P, n).
        q2: second derivatives q''(s) (P, n).
    """
    P, n = q.shape
    data, origin = mujoco.MjData(model), np.zeros(3)
    mass_matrix, force_0, moving = np.empty((P, n, n)), np.empty((P, n)), np.empty((P, n))
    jacobians, of_base = {name: np.empty((P, 6, n)) for name in frames.contacts}, np.empty((P, 6, n))
    contacts = [(J[:, :3], J[:, 3:], frames.contacts[name]) for name, J in jacobians.items()]
    contacts.append((of_base[:, :3], of_base[:, 3:], int(model.jnt_bodyid[0])))
    carrier = _Carrier(model, data, frames, P) if frames.carrier is not None else None
    springs = np.any(model.jnt_stiffness) or np.any(model.jnt_stiffnesspoly) or model.ntendon
    for i in range(P):
        data.qpos[:] = q[i]
        data.qvel[:] = q1[i]
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_tendon(model, data)
        mujoco.mj_makeM(model, data)
        mujoco.mj_fullM(model, data, mass_matrix[i])
        mujoco.mj_comVel(model, data)
        mujoco.mj_rne(model, data, 0, moving[i])
        for linear, angular, body in contacts:
            mujoco.mj_jac(model, data, linear[i], angular[i], origin, body)
        if carrier is not None:
            carrier.record(i)
        data.qvel[:] = 0
        mujoco.mj_comVel(model, data)
        mujoco.mj_rne(model, data, 0, force_0[i])
        if springs:
            mujoco.mj_passive(model, data)
            force_0[i] -= data.qfrc_spring
            moving[i] -= data.qfrc_spring
    force_u = (mass_matrix @ q1[:, :, None])[:, :, 0]
    force_x = (mass_matrix @ q2[:, :, None])[:, :, 0] + moving - force_0
    _base_rows_to_wrench(of_base, frames.base, (force_u, force_x, force_0), mass_matrix)
    motion = carrier.motion(q1) if carrier is not None else None
    return Dynamics(force_u, force_x, force_0, mass_matrix, jacobians, motion)


class _Carrier:
    """A record of the motion of the carrier frame, point by point."""

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, frames: Frames, points: int) -> None:
        site = frames.carrier
        assert site is not None
        position, rotation = np.empty((points, 3)), np.empty((points, 3, 3))
        now, turn = data.site_xpos[site], data.site_xmat[site].reshape(3, 3)
        holders = frames.holders or ((int(model.site_bodyid[site]), np.eye(6)),)
        bodies = [body for body, _ in holders]
        jacobians, rates = (np.empty((len(bodies), points, 6, model.nv)) for _ in range(2))
        parts = [(J[:, :3], J[:, 3:], rate[:, :3], rate[:, 3:]) for J, rate in zip(jacobians, rates, strict=True)]

        def record(i: int) -> None:
            for body, (linear, angular, linear_rate, angular_rate) in zip(bodies, parts, strict=True):
                mujoco.mj_jac(model, data, linear[i], angular[i], now, body)
                mujoco.mj_jacDot(model, data, linear_rate[i], angular_rate[i], now, body)
            position[i], rotation[i] = now, turn

        self.record = record
        self._jacobians, self._rates, self._position, self._rotation = jacobians, rates, position, rotation
        self._shares = [share for _, share in holders]
        self._gravity = np.array(model.opt.gravity)

    def motion(self, q1: Array) -> CarrierMotion:
        """Return the recorded motion in carrier axes, for q1 = q'(s) (P, n)."""
        into = self._rotation.transpose(0, 2, 1)
        bias = (self._rates @ q1[None, :, :, None])[..., 0]
        local = [np.concatenate((into @ J[:, :3], into @ J[:, 3:]), axis=1) for J in self._jacobians]
        rates = [
            np.concatenate(((into @ b[:, :3, None])[:, :, 0], (into @ b[:, 3:, None])[:, :, 0]), axis=1) for b in bias
        ]
        if len(local) > 1:  # several hands: the mean motion, weighted by their shares
            J = sum(share.T @ part for share, part in zip(self._shares, local, strict=True))
            rate = sum(part @ share for share, part in zip(self._shares, rates, strict=True))
        else:
            (J,), (rate,) = local, rates
        hands = np.stack(local) if len(local) > 1 else None
        J, rate, gravity = np.asarray(J), np.asarray(rate), into @ self._gravity
        return CarrierMotion(self._position, self._rotation, J, rate, gravity, hands)


def _base_rows_to_wrench(jacobian: Array, base: int, forces: tuple[Array, ...], mass_matrix: Array) -> None:
    """Turn the base rows of forces (P, n) and a mass matrix (P, n, n) into wrenches about the world's origin."""
    to_wrench = base_to_wrench(jacobian, base)
    for part in forces:
        part[:, :base] = (to_wrench @ part[:, :base, None])[:, :, 0]
    mass_matrix[:, :base] = to_wrench @ mass_matrix[:, :base]


def inverse_dynamics(
    model: mujoco.MjModel,
    frames: Frames,
    q: Array,
    qd: Array,
    qdd: Array,
    bodies: Mapping[str, tuple[float, Array]],
) -> tuple[Array, Array, dict[str, Array]]:
    """Return generalised force, mass matrix and contact Jacobians at T instants, by MuJoCo's inverse dynamics.

    Args:
        model: the model of the links alone.
        frames: contacts of the model.
        q: coordinates (T, n) [rad or m].
        qd: velocities (T, n) [rad/s or m/s].
        qdd: accelerations (T, n) [rad/s^2 or m/s^2].
        bodies: mass [kg] and centre of mass in the frame of the body (3,) [m] of bodies that differ from the model;
            their inertia about the centre of mass scales with the mass.

    Returns:
        Generalised force (T, n), mass matrix (T, n, n), and Jacobian (T, 6, n) by contact, with base rows as in
        `Dynamics`.
    """
    model = _with_bodies(model, bodies)
    data = mujoco.MjData(model)
    T, n = q.shape
    force, inertia = np.empty((T, n)), np.empty((T, n, n))
    jacobians, of_base = {name: np.empty((T, 6, n)) for name in frames.contacts}, np.empty((T, 6, n))
    contacts = [(J, frames.contacts[name]) for name, J in jacobians.items()]
    contacts.append((of_base, int(model.jnt_bodyid[0])))
    for t in range(T):
        data.qpos[:], data.qvel[:], data.qacc[:] = q[t], qd[t], qdd[t]
        mujoco.mj_inverse(model, data)
        force[t] = data.qfrc_inverse
        mujoco.mj_fullM(model, data, inertia[t])
        for J, body in contacts:
            mujoco.mj_jac(model, data, J[t, :3], J[t, 3:], np.zeros(3), body)
    _base_rows_to_wrench(of_base, frames.base, (force,), inertia)
    return force, inertia, jacobians


def _with_bodies(model: mujoco.MjModel, bodies: Mapping[str, tuple[float, Array]]) -> mujoco.MjModel:
    """Copy a model and give bodies other masses [kg] and centres of mass (3,) [m]."""
    if not bodies:
        return model
    changed = copy(model)
    for name, (mass, center) in bodies.items():
        body = changed.body(name).id
        changed.body_inertia[body] *= mass / changed.body_mass[body]
        changed.body_mass[body] = mass
        changed.body_ipos[body] = center
    mujoco.mj_setConst(changed, mujoco.MjData(changed))
    return changed


def body_motion(model: mujoco.MjModel, base: int, name: str, q: Array, q1: Array, q2: Array) -> BodyMotion:
    """Return the motion of a body's frame along a path, through which its mass and centre of mass enter the dynamics.

    Args:
        model: the model of the links alone.
        base: number of base coordinates.
        name: name of the body.
        q: coordinates (P, n) [rad or m].
        q1: derivatives q'(s) (P, n).
        q2: second derivatives q''(s) (P, n).
    """
    P, n = q.shape
    data, body = mujoco.MjData(model), model.body(name).id
    J, at_origin, rate, rotation = np.empty((P, 6, n)), np.empty((P, 6, n)), np.empty((6, n)), np.empty((P, 3, 3))
    bias = np.empty((P, 6))
    for i in range(P):
        data.qpos[:] = q[i]
        data.qvel[:] = q1[i]
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_comVel(model, data)
        mujoco.mj_jacBody(model, data, J[i, :3], J[i, 3:], body)
        mujoco.mj_jac(model, data, at_origin[i, :3], at_origin[i, 3:], np.zeros(3), body)
        mujoco.mj_jacDot(model, data, rate[:3], rate[3:], data.xpos[body], body)
        bias[i] = rate @ q1[i]
        rotation[i] = data.xmat[body].reshape(3, 3)
    into = np.swapaxes(rotation, 1, 2)
    local = np.concatenate([into @ J[:, :3], into @ J[:, 3:]], axis=1)
    both = np.zeros((P, 6, 6))
    both[:, :3, :3] = both[:, 3:, 3:] = into
    curve = (both @ bias[:, :, None])[:, :, 0]
    per_u = (local @ q1[:, :, None])[:, :, 0]
    per_x = (local @ q2[:, :, None])[:, :, 0] + curve
    to_force = np.swapaxes(local, 1, 2).copy()
    to_force[:, :base] = base_to_wrench(at_origin, base) @ to_force[:, :base]
    gravity = into @ np.array(model.opt.gravity)
    return BodyMotion(
        per_u[:, :3], per_x[:, :3], -gravity, per_u[:, 3:], per_x[:, 3:], per_u[:, 3:], local, to_force
    )  # fmt: skip
