"""A robot on its feet: kinematics and floating-base dynamics along a path, for the whole grid at once.

Its contacts are both feet and, if it has one on a rail, a hand; what is said of a contact holds for each of them.

Coordinates q (n,): the six of the base (see `walker_model`), then the joints. The base has no motors: the first six
rows of the inverse dynamics, written as a wrench about the world's origin, are what the contacts must exert.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass, fields

import mujoco
import numpy as np

from robustopt.config import BASE_COORDINATES as BASE
from robustopt.config import FEET, HANDS, Config, RailConfig
from robustopt.errors import RobotError
from robustopt.robot import Links
from robustopt.robot.joint_limits import JointLimits, joint_limits
from robustopt.robot.model_file import USUAL, compile_spec, joint_names
from robustopt.robot.walker_model import Sole, load_walker_model
from robustopt.scene.rail import rail_box

Array = np.ndarray


@dataclass(frozen=True)
class WalkerDynamics:
    """Inverse dynamics along a path at P points, without contact forces.

    With u = sdd and x = sd^2 the generalised force is `force_u * u + force_x * x + force_0`, (P, n); its first six rows
    are the wrench on the robot, force then moment about the world's origin, world axes [N, N m], the others joint
    torques [N m]. `mass_matrix` (P, n, n): generalised force per acceleration, its rows likewise. `jacobians`: per
    contact (P, 6, n), motion of its body at the world's origin, linear then angular, world axes: what a wrench w about
    the world's origin on the contact does is J^T w, its base rows apart.
    """

    force_u: Array
    force_x: Array
    force_0: Array
    mass_matrix: Array
    jacobians: Mapping[str, Array]

    def __post_init__(self) -> None:
        for item in fields(self):
            value = getattr(self, item.name)
            for array in value.values() if isinstance(value, Mapping) else (value,):
                array.setflags(write=False)


@dataclass(frozen=True)
class BodyMotion:
    """Motion of a body's frame along a path, body axes: acceleration of its origin without gravity per u, x and 1.

    `linear_u`, `linear_x`, `linear_0`, `angular_u`, `angular_x`, `spin`: (P, 3), `spin` the angular velocity at
    qd = q'(s). `jacobian`: (P, 6, n) of the origin, linear then angular. `to_force`: (P, n, 6), the generalised force
    of a wrench about the origin, base rows as in `WalkerDynamics`.
    """

    linear_u: Array
    linear_x: Array
    linear_0: Array
    angular_u: Array
    angular_x: Array
    spin: Array
    jacobian: Array
    to_force: Array


RAIL = "robustopt_rail"
"""Name of a rail among the geoms of a model."""

TOUCH = 1e-4
"""Overlap that counts as touching [m]: rounding, well below any collision of interest."""


LEAST_JOINTS = 6
"""Joints of a limb: at least as many as the pose of its foot or hand has coordinates."""


class Walker(Links):
    """A floating base with joints, two feet, and a hand if it rests on a rail.

    `joint_names` (n,): the base's coordinates first; `limits`: infinite for the base; `posture` (n,): where the base
    and all joints stay that are in no limb; `contacts`: contact points by name; `chains`: indices of the joints between
    the base and each contact; `limbs`: those of them that move no other foot or hand, six for a foot, at least six for
    a hand; `mass` [kg]; `up` (3,): against gravity
    """

    def __init__(
        self,
        spec: mujoco.MjSpec,
        model: mujoco.MjModel,
        limits: JointLimits,
        posture: Array,
        contacts: Mapping[str, Sole],
        notes: tuple[str, ...] = (),
    ) -> None:
        super().__init__(spec, model, limits, notes)
        self.posture = posture
        self.contacts = dict(contacts)
        self.mass = float(model.body_mass.sum())
        self.up = -np.array(model.opt.gravity) / np.linalg.norm(model.opt.gravity)
        self._sites = {name: model.site(name).id for name in contacts}
        self.chains = {name: self._chain(name) for name in contacts}
        self.limbs = {name: self._limb(name) for name in contacts}

    @property
    def body_names(self) -> tuple[str, ...]:
        """Names of the bodies that have a mass."""
        return tuple(self._model.body(k).name for k in range(self._model.nbody) if self._model.body_mass[k] > 0)

    def _chain(self, site: str) -> Array:
        """Indices of the joints between the base and a site."""
        chain: list[int] = []
        body = int(self._model.site(site).bodyid[0])
        while body:
            first, count = int(self._model.body_jntadr[body]), int(self._model.body_jntnum[body])
            chain += [k for k in range(first, first + count) if k >= BASE]
            body = int(self._model.body_parentid[body])
        return np.array(sorted(chain))

    def _limb(self, contact: str) -> Array:
        """Indices of the joints that move this foot or hand and no other. Raises RobotError for too few or many."""
        sites = {self._model.site(k).name for k in range(self._model.nsite)}
        others = [self._chain(name) for name in (*FEET, *HANDS) if name in sites and name != contact]
        limb = np.setdiff1d(self.chains[contact], np.concatenate(others))
        foot = contact in FEET
        if len(limb) < LEAST_JOINTS or (foot and len(limb) > LEAST_JOINTS):
            expected = f"{'' if foot else 'at least '}{LEAST_JOINTS} that move no other foot or hand"
            raise RobotError(f"{contact} hangs from {len(limb)} joints; expected {expected}", key="robot.model")
        return limb

    def site_frame(self, contact: str) -> tuple[Array, Array]:
        """Origin (3,) [m] and axes, as columns (3, 3), of the frame of a contact in its body."""
        site, axes = self._model.site(contact), np.zeros(9)
        mujoco.mju_quat2Mat(axes, site.quat)
        return site.pos.copy(), axes.reshape(3, 3)

    def qpos(self, q: Array) -> Array:
        """Positions (P, n + 1) of the model file, whose base is a free joint, for coordinates q (P, n)."""
        half = 0.5 * q[:, 3:6]
        (cz, cy, cx), (sz, sy, sx) = np.cos(half).T, np.sin(half).T
        w, x = cz * cy * cx + sz * sy * sx, cz * cy * sx - sz * sy * cx
        y, z = cz * sy * cx + sz * cy * sx, sz * cy * cx - cz * sy * sx
        return np.column_stack([q[:, :3], w, x, y, z, q[:, BASE:]])

    def contacts_and_com(self, q: Array) -> tuple[Array, Array, Array, Array, Array]:
        """At one q (n,): centre of mass (3,), its Jacobian (3, n), and per contact position (k, 3), rotation (k, 3, 3)
        and Jacobian (k, 6, n) of its site, world."""
        model, data = self._model, self._data
        data.qpos[:] = q
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        com_jacobian, jacobians = np.empty((3, self.n)), np.empty((len(self.contacts), 6, self.n))
        mujoco.mj_jacSubtreeCom(model, data, com_jacobian, 0)
        for k, site in enumerate(self._sites.values()):
            mujoco.mj_jacSite(model, data, jacobians[k, :3], jacobians[k, 3:], site)
        sites = list(self._sites.values())
        position, rotation = data.site_xpos[sites].copy(), data.site_xmat[sites].reshape(-1, 3, 3).copy()
        return data.subtree_com[0].copy(), com_jacobian, position, rotation, jacobians

    def dynamics(self, q: Array, q1: Array, q2: Array) -> WalkerDynamics:
        """Dynamics along a path: `q`, `q1` = q'(s), `q2` = q''(s), shape (P, n) each."""
        P, n = q.shape
        model, data = self._model, mujoco.MjData(self._model)
        mass_matrix, force_0, moving = np.empty((P, n, n)), np.empty((P, n)), np.empty((P, n))
        jacobians = {name: np.empty((P, 6, n)) for name in self.contacts}
        bodies = {name: int(model.site_bodyid[site]) for name, site in self._sites.items()}
        origin = np.zeros(3)
        for i in range(P):
            data.qpos[:] = q[i]
            data.qvel[:] = q1[i]
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            mujoco.mj_makeM(model, data)
            mujoco.mj_fullM(model, data, mass_matrix[i])
            for name, J in jacobians.items():
                mujoco.mj_jac(model, data, J[i, :3], J[i, 3:], origin, bodies[name])
            mujoco.mj_comVel(model, data)
            mujoco.mj_rne(model, data, 0, moving[i])
            data.qvel[:] = 0
            mujoco.mj_comVel(model, data)
            mujoco.mj_rne(model, data, 0, force_0[i])
        force_u = (mass_matrix @ q1[:, :, None])[:, :, 0]
        force_x = (mass_matrix @ q2[:, :, None])[:, :, 0] + moving - force_0
        to_wrench = _base_to_wrench(next(iter(jacobians.values())))
        for part in (force_u, force_x, force_0):
            part[:, :BASE] = (to_wrench @ part[:, :BASE, None])[:, :, 0]
        mass_matrix[:, :BASE] = to_wrench @ mass_matrix[:, :BASE]
        return WalkerDynamics(force_u, force_x, force_0, mass_matrix, jacobians)

    def inverse_dynamics(
        self, q: Array, qd: Array, qdd: Array, bodies: Mapping[str, tuple[float, Array]] | None = None
    ) -> tuple[Array, Array, dict[str, Array]]:
        """Generalised force of a motion, its change per acceleration, and the contacts' Jacobians at T instants.

        By MuJoCo's inverse dynamics at each instant, base rows and Jacobians as in `WalkerDynamics`: (T, n), (T, n, n)
        and (T, 6, n) by name. q, qd, qdd: (T, n); bodies: mass [kg] and centre of mass in the body's frame (3,) [m] of
        those that are not as in the model; the inertia about the centre of mass scales with the mass.
        """
        model = _with_bodies(self._model, bodies or {})
        data = mujoco.MjData(model)
        T, n = q.shape
        force, inertia = np.empty((T, n)), np.empty((T, n, n))
        jacobians = {name: np.empty((T, 6, n)) for name in self.contacts}
        for t in range(T):
            data.qpos[:], data.qvel[:], data.qacc[:] = q[t], qd[t], qdd[t]
            mujoco.mj_inverse(model, data)
            force[t] = data.qfrc_inverse
            mujoco.mj_fullM(model, data, inertia[t])
            for name, J in jacobians.items():
                body = int(model.site_bodyid[self._sites[name]])
                mujoco.mj_jac(model, data, J[t, :3], J[t, 3:], np.zeros(3), body)
        to_wrench = _base_to_wrench(next(iter(jacobians.values())))
        force[:, :BASE] = (to_wrench @ force[:, :BASE, None])[:, :, 0]
        inertia[:, :BASE] = to_wrench @ inertia[:, :BASE]
        return force, inertia, jacobians

    def contact_points(self, q: Array) -> dict[str, Array]:
        """Contact points in the world at q (T, n): (T, k, 3) by name [m]."""
        places = {name: np.empty((len(q), *sole.points.shape)) for name, sole in self.contacts.items()}
        for t, qt in enumerate(q):
            self._data.qpos[:] = qt
            mujoco.mj_kinematics(self._model, self._data)
            for name, site in self._sites.items():
                rotation = self._data.site_xmat[site].reshape(3, 3)
                places[name][t] = self._data.site_xpos[site] + self.contacts[name].points @ rotation.T
        return places

    def first_collision(self, q: Array) -> tuple[int, tuple[str, str], float] | None:
        """First of the postures q (T, n) in which two bodies overlap: its index, the bodies, and the overlap [m]."""
        model = copy(self._model)
        disable = mujoco.mjtDisableBit
        model.opt.disableflags &= ~(int(disable.mjDSBL_CONTACT) | int(disable.mjDSBL_CONSTRAINT))
        data = mujoco.MjData(model)
        for t, qt in enumerate(q):
            data.qpos[:] = qt
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            mujoco.mj_collision(model, data)
            if data.ncon and data.contact.dist.min() < -TOUCH:
                deepest = int(np.argmin(data.contact.dist))
                first, second = (model.body(model.geom_bodyid[g]).name for g in data.contact.geom[deepest])
                return t, (first, second), -float(data.contact.dist[deepest])
        return None

    def first_touch(self, q: Array, rail: RailConfig) -> tuple[int, str, float] | None:
        """First of the postures q (T, n) in which a body overlaps a rail, apart from the hand that rests on it and the
        body that the hand hangs from: its index, the body, and the overlap [m]."""
        hand = int(self._model.site(rail.contact).bodyid[0])
        allowed = {0, hand, int(self._model.body_parentid[hand])}
        spec, quaternion, (middle, axes, half) = self.spec.copy(), np.zeros(4), rail_box(rail)
        mujoco.mju_mat2Quat(quaternion, axes.ravel())
        spec.worldbody.add_geom(
            USUAL.default, type=mujoco.mjtGeom.mjGEOM_BOX, name=RAIL, size=half, pos=middle, quat=quaternion
        )
        model = spec.compile()
        data, bar = mujoco.MjData(model), model.geom(RAIL).id
        near = model.geom_rbound + model.geom_rbound[bar]
        for t, qt in enumerate(q):
            data.qpos[:] = qt
            mujoco.mj_kinematics(model, data)
            away = np.linalg.norm(data.geom_xpos - data.geom_xpos[bar], axis=1)
            for geom in np.flatnonzero(away < near):
                body = int(model.geom_bodyid[geom])
                if body not in allowed:
                    gap = mujoco.mj_geomDistance(model, data, bar, int(geom), 1.0, None)
                    if gap < -TOUCH:
                        return t, model.body(body).name, -gap
        return None

    def inertia_of(self, name: str) -> tuple[float, Array, Array]:
        """Mass [kg] of a body, its centre of mass in the body's frame (3,) [m], and the inertia about it (3, 3)."""
        model = self._model
        body = model.body(name).id
        rotation = np.zeros(9)
        mujoco.mju_quat2Mat(rotation, model.body_iquat[body])
        turn = rotation.reshape(3, 3)
        inertia = turn @ np.diag(model.body_inertia[body]) @ turn.T
        return float(model.body_mass[body]), model.body_ipos[body].copy(), inertia

    def body_motion(self, name: str, q: Array, q1: Array, q2: Array) -> BodyMotion:
        """Motion of the frame of a body along a path, for what its mass and centre of mass add to the dynamics."""
        P, n = q.shape
        model, data, body = self._model, mujoco.MjData(self._model), self._model.body(name).id
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
        to_force[:, :BASE] = _base_to_wrench(at_origin) @ to_force[:, :BASE]
        gravity = into @ np.array(model.opt.gravity)
        return BodyMotion(
            per_u[:, :3], per_x[:, :3], -gravity, per_u[:, 3:], per_x[:, 3:], per_u[:, 3:], local, to_force
        )  # fmt: skip


def _with_bodies(model: mujoco.MjModel, bodies: Mapping[str, tuple[float, Array]]) -> mujoco.MjModel:
    """A copy of a model whose bodies have other masses [kg] and centres of mass (3,) [m]."""
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


def _base_to_wrench(jacobian: Array) -> Array:
    """Wrench about the world's origin from the generalised forces of the base's coordinates, (P, 6, 6).

    Every body moves with the base like a rigid body, so the base columns of any body's Jacobian at the origin tell
    their power.
    """
    return np.linalg.inv(np.swapaxes(jacobian[:, :, :BASE], 1, 2))


def load_walker(config: Config) -> Walker:
    """The robot on its feet of the configuration.

    Raises RobotError if the model cannot be used or has joint friction, and for unknown bodies in `uncertainty`.
    """
    robot, posture, contacts = load_walker_model(config)
    spec = robot.spec
    for item in [*spec.actuators, *spec.sensors]:
        spec.delete(item)
    spec.option.gravity = config.gravity
    model = compile_spec(spec, robot.file)
    names = joint_names(model)
    limits = joint_limits(config, robot, names[BASE:])
    if np.any(limits.dry_friction) or np.any(limits.viscous_friction):
        raise RobotError(
            f"{robot.file.name} has friction in its joints, which a robot on its feet may not have; give "
            "robot.joint_friction: false",
            key="robot.joint_friction",
        )
    if config.path.pelvis_height is not None:
        posture[2] = config.path.pelvis_height
    walker = Walker(spec, model, _with_base(limits), posture, contacts, robot.notes)
    _require_bodies(config, walker)
    return walker


def _with_base(limits: JointLimits) -> JointLimits:
    """The limits of the joints behind those of the base, which has none."""
    endless = np.full(BASE, np.inf)
    padded = {
        item.name: np.concatenate([-endless if item.name == "lower" else endless, getattr(limits, item.name)])
        for item in fields(limits)
    }
    return JointLimits(**padded | {name: np.zeros(len(endless) + len(limits.lower)) for name in FRICTIONS})


FRICTIONS = ("dry_friction", "viscous_friction")


def _require_bodies(config: Config, walker: Walker) -> None:
    """Bodies that `uncertainty` names must exist, and its intervals of their masses contain the model's."""
    uncertain = config.uncertainty
    given: Sequence[tuple[str, Mapping[str, object]]] = (
        ("center_of_mass", uncertain.center_of_mass),
        ("mass", uncertain.mass),
    )
    for key, values in given:
        for name in values:
            if name not in walker.body_names:
                known = ", ".join(walker.body_names)
                raise RobotError(f"the robot has no body {name}; its bodies are: {known}", f"uncertainty.{key}.{name}")
    for name, (low, high) in uncertain.mass.items():
        mass = walker.inertia_of(name)[0]
        if not low <= mass <= high:
            raise RobotError(
                f"found [{low:g}, {high:g}], which does not contain the model's mass, {mass:g}; expected an interval "
                "around it",
                f"uncertainty.mass.{name}",
            )
