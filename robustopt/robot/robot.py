"""The robot that carries the tray: kinematics, dynamics and limits, for all points of a path at once.

The model is the arm alone, with its tool. Contacts, constraints, joint damping, dry friction and gravity compensation
are switched off in it: limits and joint friction are data of `JointLimits`, and the load is added by the caller.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import mujoco
import numpy as np

from robustopt.config import Config
from robustopt.robot.joint_limits import JointLimits, joint_limits
from robustopt.robot.model_file import TRAY_SITE, compile_spec, joint_names, load_model

__all__ = ["ArmDynamics", "JointLimits", "Robot", "load_robot"]


@dataclass(frozen=True)
class ArmDynamics:
    """Dynamics of the arm alone along a path q(s), at P points.

    With u = sdd and x = sd^2, and without joint friction, the joint torque is `tau_u * u + tau_x * x + tau_0`, and the
    tray frame accelerates by `jacobian @ q1 * u + (jacobian @ q2 + bias) * x`.

    `tau_u`, `tau_x`, `tau_0`: (P, n) [N m or N]. `mass_matrix`: (P, n, n), armature included. `position` (P, 3) [m] and
    `rotation` (P, 3, 3): tray frame in the world. `jacobian`: (P, 6, n) of the tray's origin, rows linear then angular,
    tray frame. `bias`: (P, 6) acceleration of the tray frame at qd = q'(s), qdd = 0, linear then angular, tray frame
    [m/s^2, rad/s^2]. `gravity`: (P, 3), tray frame [m/s^2].
    """

    tau_u: np.ndarray
    tau_x: np.ndarray
    tau_0: np.ndarray
    mass_matrix: np.ndarray
    rotation: np.ndarray
    position: np.ndarray
    jacobian: np.ndarray
    bias: np.ndarray
    gravity: np.ndarray

    def __post_init__(self) -> None:
        for item in fields(self):
            getattr(self, item.name).setflags(write=False)


class Links:
    """What an arm and a robot on its feet have in common: links without actuators, joints and their limits.

    `hinges` (n,): whether a joint turns (or slides). `ranges` (n, 2): of the joints in the model file [rad or m].
    `spec`: the links, to be copied and added to. `notes`: what of the model file was left out.
    """

    def __init__(self, spec: mujoco.MjSpec, model: mujoco.MjModel, limits: JointLimits, notes: tuple[str, ...]) -> None:
        switch_off_all_but_the_links(model)
        self.spec = spec
        self.joint_names = joint_names(model)
        self.n = model.nv
        self.limits = limits
        self.hinges = model.jnt_type == mujoco.mjtJoint.mjJNT_HINGE
        self.ranges = model.jnt_range.copy()
        self.notes = notes
        self._model = model
        self._data = mujoco.MjData(model)


class Robot(Links):
    """An arm with `n` joints that carries a tray.

    `up` (3,): unit vector against gravity, world
    """

    def __init__(
        self, spec: mujoco.MjSpec, model: mujoco.MjModel, limits: JointLimits, notes: tuple[str, ...] = ()
    ) -> None:
        super().__init__(spec, model, limits, notes)
        self._site = model.site(TRAY_SITE).id
        self._body = int(model.site_bodyid[self._site])
        self._gravity = np.array(model.opt.gravity)
        weight = float(np.linalg.norm(self._gravity))
        self.up = -self._gravity / weight if weight > 0 else np.array([0.0, 0.0, 1.0])

    def tray_pose(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Tray frame in the world at joint positions `q` (P, n): position (P, 3) [m] and rotation (P, 3, 3)."""
        model, data = self._model, self._data
        position, rotation = np.empty((len(q), 3)), np.empty((len(q), 9))
        for i, qi in enumerate(q):
            data.qpos[:] = qi
            mujoco.mj_kinematics(model, data)
            position[i] = data.site_xpos[self._site]
            rotation[i] = data.site_xmat[self._site]
        return position, rotation.reshape(-1, 3, 3)

    def tray_jacobian(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Tray frame in the world at one joint position `q` (n,).

        Returns position (3,) [m], rotation (3, 3), and the Jacobian (6, n) of its origin, rows linear then angular,
        in the world frame.
        """
        model, data = self._model, self._data
        jacobian = np.empty((6, self.n))
        data.qpos[:] = q
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_jacSite(model, data, jacobian[:3], jacobian[3:], self._site)
        return data.site_xpos[self._site].copy(), data.site_xmat[self._site].reshape(3, 3).copy(), jacobian

    def center_of_mass(self, q: np.ndarray) -> np.ndarray:
        """Centre of mass of the arm in the world at joint positions `q` (P, n), shape (P, 3) [m]."""
        center = np.empty((len(q), 3))
        for i, qi in enumerate(q):
            self._data.qpos[:] = qi
            mujoco.mj_kinematics(self._model, self._data)
            mujoco.mj_comPos(self._model, self._data)
            center[i] = self._data.subtree_com[0]
        return center

    def dynamics(self, q: np.ndarray, q1: np.ndarray, q2: np.ndarray) -> ArmDynamics:
        """Dynamics along a path: `q`, `q1` = q'(s), `q2` = q''(s), shape (P, n) each."""
        P, n = q.shape
        mass_matrix, world_jacobian = np.empty((P, n, n)), np.empty((P, 6, n))
        jacobian_rate, position = np.empty((6, n)), np.empty((P, 3))
        rotation, bias = np.empty((P, 3, 3)), np.empty((P, 6))
        tau_0, tau_moving = np.empty((P, n)), np.empty((P, n))
        model, data, site, body = self._model, self._data, self._site, self._body
        site_position, site_rotation = data.site_xpos[site], data.site_xmat[site].reshape(3, 3)
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
            mujoco.mj_rne(model, data, 0, tau_moving[i])
            mujoco.mj_jacSite(model, data, world_jacobian[i, :3], world_jacobian[i, 3:], site)
            mujoco.mj_jacDot(model, data, jacobian_rate[:3], jacobian_rate[3:], site_position, body)
            bias[i] = jacobian_rate @ q1[i]
            position[i], rotation[i] = site_position, site_rotation
            data.qvel[:] = 0
            mujoco.mj_comVel(model, data)
            mujoco.mj_rne(model, data, 0, tau_0[i])
            if springs:
                mujoco.mj_passive(model, data)
                tau_0[i] -= data.qfrc_spring
                tau_moving[i] -= data.qfrc_spring
        into_tray = rotation.transpose(0, 2, 1)
        return ArmDynamics(
            tau_u=(mass_matrix @ q1[:, :, None])[:, :, 0],
            tau_x=(mass_matrix @ q2[:, :, None])[:, :, 0] + tau_moving - tau_0,
            tau_0=tau_0,
            mass_matrix=mass_matrix,
            rotation=rotation,
            position=position,
            jacobian=np.concatenate((into_tray @ world_jacobian[:, :3], into_tray @ world_jacobian[:, 3:]), axis=1),
            bias=np.concatenate(
                ((into_tray @ bias[:, :3, None])[:, :, 0], (into_tray @ bias[:, 3:, None])[:, :, 0]), axis=1
            ),
            gravity=into_tray @ self._gravity,
        )


def load_robot(config: Config) -> Robot:
    """The robot of the configuration.

    Raises RobotError if the model cannot be found or read, has joints other than hinges and slides, or lacks the tool
    or a limit.
    """
    robot = load_model(config)
    spec = robot.spec
    for item in [*spec.actuators, *spec.sensors]:
        spec.delete(item)
    spec.option.gravity = config.gravity
    model = compile_spec(spec, robot.file)
    return Robot(spec, model, joint_limits(config, robot, joint_names(model)), robot.notes)


def switch_off_all_but_the_links(model: mujoco.MjModel) -> None:
    disable = mujoco.mjtDisableBit
    for bit in (disable.mjDSBL_CONSTRAINT, disable.mjDSBL_CONTACT, disable.mjDSBL_DAMPER, disable.mjDSBL_ACTUATION):
        model.opt.disableflags |= int(bit)
    model.body_gravcomp[:] = 0
    model.opt.density = model.opt.viscosity = 0.0
