"""The robot of a configuration: kinematics, dynamics and limits, for all points of a path at once.

An arm and a walking robot are one class. A walking robot has six base coordinates before its joints, which no motor
drives, and environment contacts: its feet, and a hand that rests on a rail. Contacts, constraints, joint damping, dry
friction and gravity compensation are switched off in the model. Limits and joint friction are data of `JointLimits`;
the caller adds the payload.
"""

from __future__ import annotations

from collections.abc import Mapping

import mujoco
import numpy as np

from robustopt.arrays import Array, Indices
from robustopt.config import FEET, HANDS, Config
from robustopt.errors import RobotError
from robustopt.robot import dynamics
from robustopt.robot.cartesian import LimitedPoint, PointMotion, limited_points, point_motion
from robustopt.robot.dynamics import BodyMotion, Dynamics, Frames
from robustopt.robot.floating_base import free_joint_positions
from robustopt.robot.inertia import require_possible, restore
from robustopt.robot.joint_limits import JointLimits, joint_limits
from robustopt.robot.model_file import compile_spec, joint_names
from robustopt.robot.preparation import CARRIER_SITE, RobotModel, load_model
from robustopt.robot.soles import Sole

LEAST_JOINTS = 6
"""Joints of a limb: at least as many as the pose of its foot or hand has coordinates."""


class Robot:
    """A robot without actuators, contacts and payload.

    Attributes:
        n: number of coordinates.
        base: number of coordinates of the floating base: 6 for a walking robot, else 0.
        motors: slice of the coordinates that have motors.
        joint_names: names of the coordinates, base first (n,).
        limits: limits of the coordinates, infinite for the base.
        hinges: True for a coordinate that rotates, False for one that slides (n,).
        ranges: ranges of the joints in the model file (n, 2) [rad or m].
        spec: specification of the links, to be copied and extended.
        world_spec: the same for simulation, with a free joint in place of the base coordinates.
        original: the model as in its file, with all joints and actuators.
        notes: content of the model file that was left out or replaced, in words.
        up: unit vector against gravity, world (3,).
        mass: mass of all links [kg].
        body_names: names of the bodies that have a mass.
        posture: position of the coordinates that the path does not prescribe (n,) [rad or m].
        contacts: contact points of the environment contacts, by name.
        chains: indices of the joints between the base and a contact, by contact.
        limbs: indices of the joints that move a contact and no other foot or hand, by contact; six for a foot, at least
            six for a hand.
        has_carrier: whether the robot has a carrier frame.
        hands: several hands that hold the tray together; () for a single tool.
        points: points whose speed or acceleration is limited.
    """

    def __init__(
        self, parts: RobotModel, model: mujoco.MjModel, limits: JointLimits, points: tuple[LimitedPoint, ...] = ()
    ) -> None:
        _switch_off_all_but_the_links(model)
        self.spec, self.world_spec = parts.spec, parts.world_spec
        self.original, self.notes = parts.original, parts.notes
        self.base, self.motors = parts.base, slice(parts.base, None)
        self.n, self.joint_names, self.limits, self.points = model.nv, joint_names(model), limits, points
        self.hinges = model.jnt_type == mujoco.mjtJoint.mjJNT_HINGE
        self.ranges = model.jnt_range.copy()
        gravity = np.array(model.opt.gravity)
        size = float(np.linalg.norm(gravity))
        self.up: Array = -gravity / size if size > 0 else np.array([0.0, 0.0, 1.0])
        self.mass = float(model.body_mass.sum())
        self.body_names = tuple(model.body(k).name for k in range(model.nbody) if model.body_mass[k] > 0)
        self.posture: Array = np.array([parts.posture[name] for name in self.joint_names])
        self.contacts: dict[str, Sole] = dict(parts.contacts)
        self._model, self._data = model, mujoco.MjData(model)
        self._sites = {name: model.site(name).id for name in self.contacts}
        sites = [model.site(k).name for k in range(model.nsite)]
        self._frames = Frames(
            base=self.base,
            contacts={name: int(model.site_bodyid[site]) for name, site in self._sites.items()},
            carrier=model.site(CARRIER_SITE).id if CARRIER_SITE in sites else None,
            holders=tuple((model.body(hand.body).id, hand.share) for hand in parts.hands),
        )
        self.hands = parts.hands
        self.has_carrier = self._frames.carrier is not None
        self.chains = {name: self._chain(name) for name in self.contacts}
        self.limbs = {name: self._limb(name) for name in self.contacts}

    # Kinematics -------------------------------------------------------------------------------------------

    def carrier_pose(self, q: Array) -> tuple[Array, Array]:
        """Return the carrier frame in the world.

        Args:
            q: coordinates (P, n).

        Returns:
            Position (P, 3) [m] and rotation (P, 3, 3).
        """
        model, data, site = self._model, self._data, self._carrier()
        position, rotation = np.empty((len(q), 3)), np.empty((len(q), 9))
        for i, qi in enumerate(q):
            data.qpos[:] = qi
            mujoco.mj_kinematics(model, data)
            position[i] = data.site_xpos[site]
            rotation[i] = data.site_xmat[site]
        return position, rotation.reshape(-1, 3, 3)

    def carrier_jacobians(self, q: Array) -> tuple[Array, Array, Array]:
        """Return the carrier frame and its Jacobian in the world.

        Args:
            q: coordinates (P, n).

        Returns:
            Position (P, 3) [m], rotation (P, 3, 3), and the Jacobian (P, 6, n) of the origin, linear then angular,
            world axes.
        """
        model, data, site = self._model, self._data, self._carrier()
        position, rotation, jacobian = np.empty((len(q), 3)), np.empty((len(q), 9)), np.empty((len(q), 6, self.n))
        now, turn, coordinates = data.site_xpos[site], data.site_xmat[site], data.qpos
        for i, (linear, angular) in enumerate(zip(jacobian[:, :3], jacobian[:, 3:], strict=True)):
            coordinates[:] = q[i]
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            mujoco.mj_jacSite(model, data, linear, angular, site)
            position[i], rotation[i] = now, turn
        return position, rotation.reshape(-1, 3, 3), jacobian

    def center_of_mass(self, q: Array) -> Array:
        """Return the centre of mass of the robot in the world, (P, 3) [m].

        Args:
            q: coordinates (P, n) [rad or m].
        """
        center = np.empty((len(q), 3))
        for i, qi in enumerate(q):
            self._data.qpos[:] = qi
            mujoco.mj_kinematics(self._model, self._data)
            mujoco.mj_comPos(self._model, self._data)
            center[i] = self._data.subtree_com[0]
        return center

    def contacts_and_com(self, q: Array) -> tuple[Array, Array, Array, Array, Array]:
        """Return the centre of mass and the contact frames in the world.

        Args:
            q: coordinates (n,) [rad or m].

        Returns:
            Centre of mass (3,) [m] and its Jacobian (3, n); for the k contacts position (k, 3) [m], rotation (k, 3, 3)
            and Jacobian (k, 6, n) of their sites, linear part first.
        """
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

    def contact_points(self, q: Array) -> dict[str, Array]:
        """Return the contact points in the world, (T, k, 3) by contact [m].

        Args:
            q: coordinates (T, n) [rad or m].
        """
        places = {name: np.empty((len(q), *sole.points.shape)) for name, sole in self.contacts.items()}
        for t, qt in enumerate(q):
            self._data.qpos[:] = qt
            mujoco.mj_kinematics(self._model, self._data)
            for name, site in self._sites.items():
                rotation = self._data.site_xmat[site].reshape(3, 3)
                places[name][t] = self._data.site_xpos[site] + self.contacts[name].points @ rotation.T
        return places

    def site_frame(self, contact: str) -> tuple[Array, Array]:
        """Return the frame of a contact in its body.

        Args:
            contact: name of the contact.

        Returns:
            Origin (3,) [m], and axes as columns (3, 3).
        """
        site, axes = self._model.site(contact), np.zeros(9)
        mujoco.mju_quat2Mat(axes, site.quat)
        return site.pos.copy(), axes.reshape(3, 3)

    def qpos(self, q: Array) -> Array:
        """Return the positions of `world_spec`: (P, n + 1) with a floating base, else the coordinates themselves.

        Args:
            q: coordinates (P, n) [rad or m].
        """
        return free_joint_positions(q, self.base)

    # Dynamics ---------------------------------------------------------------------------------------------

    def dynamics(self, q: Array, q1: Array, q2: Array) -> Dynamics:
        """Return the inverse dynamics along a path.

        Args:
            q: coordinates (P, n) [rad or m].
            q1: derivatives q'(s) (P, n).
            q2: second derivatives q''(s) (P, n).
        """
        return dynamics.path_dynamics(self._model, self._frames, q, q1, q2)

    def inverse_dynamics(
        self, q: Array, qd: Array, qdd: Array, bodies: Mapping[str, tuple[float, Array]] | None = None
    ) -> tuple[Array, Array, dict[str, Array]]:
        """Return generalised force, mass matrix and contact Jacobians at T instants, by MuJoCo's inverse dynamics.

        Args:
            q: coordinates (T, n) [rad or m].
            qd: velocities (T, n) [rad/s or m/s].
            qdd: accelerations (T, n) [rad/s^2 or m/s^2].
            bodies: mass [kg] and centre of mass in the frame of the body (3,) [m] of bodies that differ from the model;
                their inertia about the centre of mass scales with the mass.

        Returns:
            Generalised force (T, n), mass matrix (T, n, n), and Jacobian (T, 6, n) by contact, base rows as in
            `Dynamics`.
        """
        return dynamics.inverse_dynamics(self._model, self._frames, q, qd, qdd, bodies or {})

    def body_motion(self, name: str, q: Array, q1: Array, q2: Array) -> BodyMotion:
        """Return the motion of a body's frame along a path.

        Args:
            name: name of the body.
            q: coordinates (P, n) [rad or m].
            q1: derivatives q'(s) (P, n).
            q2: second derivatives q''(s) (P, n).
        """
        return dynamics.body_motion(self._model, self.base, name, q, q1, q2)

    def point_motion(self, point: LimitedPoint, q: Array, q1: Array, q2: Array) -> PointMotion:
        """Return the motion of a limited point along a path.

        Args:
            point: one of `points`.
            q: coordinates (P, n) [rad or m].
            q1: derivatives q'(s) (P, n).
            q2: second derivatives q''(s) (P, n).
        """
        return point_motion(self._model, point, q, q1, q2)

    def inertia_of(self, name: str) -> tuple[float, Array, Array]:
        """Return the inertia of a body.

        Args:
            name: name of the body.

        Returns:
            Mass [kg], centre of mass in the frame of the body (3,) [m], and inertia about it, axes of the body (3, 3)
            [kg m^2].
        """
        model = self._model
        body = model.body(name).id
        rotation = np.zeros(9)
        mujoco.mju_quat2Mat(rotation, model.body_iquat[body])
        turn = rotation.reshape(3, 3)
        inertia = turn @ np.diag(model.body_inertia[body]) @ turn.T
        return float(model.body_mass[body]), model.body_ipos[body].copy(), inertia

    # Structure --------------------------------------------------------------------------------------------

    def _carrier(self) -> int:
        if self._frames.carrier is None:
            raise RobotError("the robot carries nothing, so it has no carrier frame; give a tray or objects", "tray")
        return self._frames.carrier

    def _chain(self, site: str) -> Indices:
        """Return the indices of the joints between the base and a site."""
        chain: list[int] = []
        body = int(self._model.site(site).bodyid[0])
        while body:
            first, count = int(self._model.body_jntadr[body]), int(self._model.body_jntnum[body])
            chain += [k for k in range(first, first + count) if k >= self.base]
            body = int(self._model.body_parentid[body])
        return np.array(sorted(chain))

    def _limb(self, contact: str) -> Indices:
        """Return the indices of the joints that move this foot or hand and no other.

        Raises:
            RobotError: a foot does not have six of them, or a hand has fewer.
        """
        sites = {self._model.site(k).name for k in range(self._model.nsite)}
        others = [self._chain(name) for name in (*FEET, *HANDS) if name in sites and name != contact]
        limb = np.setdiff1d(self.chains[contact], np.concatenate(others))
        foot = contact in FEET
        if len(limb) < LEAST_JOINTS or (foot and len(limb) > LEAST_JOINTS):
            expected = f"{'' if foot else 'at least '}{LEAST_JOINTS} that move no other foot or hand"
            raise RobotError(f"{contact} hangs from {len(limb)} joints; expected {expected}", key="robot.model")
        return limb


def load_robot(config: Config) -> Robot:
    """Load the robot of a configuration.

    The model file determines its kind: if its first joint is a free joint, the robot walks.

    Args:
        config: the configuration.

    Raises:
        RobotError: the model cannot be found or read, does not fit the path, or lacks its tool or a limit, or
            `uncertainty` or `robot.limits.cartesian` names a body that the robot does not have.
    """
    parts = load_model(config)
    for spec in (parts.spec, parts.world_spec):
        for item in [*spec.actuators, *spec.sensors]:
            spec.delete(item)
        spec.option.gravity = config.gravity
    model = compile_spec(parts.spec, parts.file)
    restore(model, parts.inertias)
    sites = {model.site(k).name for k in range(model.nsite)}
    require_possible(model, parts.inertias, sites & {CARRIER_SITE, *parts.contacts}, str(parts.file))
    limits = joint_limits(config, parts, joint_names(model)[parts.base :])
    carrier = model.site(CARRIER_SITE).id if CARRIER_SITE in sites else None
    robot = Robot(parts, model, limits.behind_base(parts.base), limited_points(config, model, carrier))
    _require_bodies(config, robot)
    return robot


def _require_bodies(config: Config, robot: Robot) -> None:
    """Check that `uncertainty` names existing bodies, with intervals that contain the masses of the robot's bodies."""
    uncertain, held = config.uncertainty, {"tray", *config.objects}
    given = [("center_of_mass", name) for name in uncertain.center_of_mass]
    given += [("mass", name) for name in uncertain.mass]
    for key, name in given:
        if name not in robot.body_names and name not in held:
            known = ", ".join(robot.body_names)
            raise RobotError(f"the robot has no body {name}; its bodies are: {known}", f"uncertainty.{key}.{name}")
    for name, (low, high) in uncertain.mass.items():
        mass = robot.inertia_of(name)[0] if name not in held else low
        if not low <= mass <= high:
            raise RobotError(
                f"found [{low:g}, {high:g}], which does not contain the model's mass, {mass:g}; expected an interval "
                "around it",
                f"uncertainty.mass.{name}",
            )


def _switch_off_all_but_the_links(model: mujoco.MjModel) -> None:
    disable = mujoco.mjtDisableBit
    for bit in (disable.mjDSBL_CONSTRAINT, disable.mjDSBL_CONTACT, disable.mjDSBL_DAMPER, disable.mjDSBL_ACTUATION):
        model.opt.disableflags |= int(bit)
    model.body_gravcomp[:] = 0
    model.opt.density = model.opt.viscosity = 0.0
