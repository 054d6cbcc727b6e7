"""Gains of the joint controllers: from the configuration, else from the model file, else from inertia."""

from __future__ import annotations

import mujoco
import numpy as np

from robustopt.arrays import Array
from robustopt.config import FEET, Config, ExecutionConfig, UncertaintyConfig
from robustopt.config.execution_model import ControllerConfig
from robustopt.errors import ConfigError
from robustopt.limits.bodies import Body, regressor
from robustopt.limits.uncertainty import bodies
from robustopt.robot import Robot
from robustopt.simulation.controller import POSITION_VELOCITY, WITH_TORQUE, Gains

BANDWIDTH = 50.0
"""Natural frequency of the default gains [rad/s], about that of the first joint of the shipped arm (our choice)."""

UPRIGHT = 10.0
"""Least stiffness of the default gains of legs over the stiffness that topples the robot, as for the shipped humanoid
(our choice)."""

STABILITY = 0.5
"""Part of the way to the instability of the sampled controller that default gains may go (our choice)."""

PID = int(mujoco.mjtDyn.mjDYN_PID)
SERVOS = {True: {PID, int(mujoco.mjtDyn.mjDYN_NONE)}, False: {PID}}
"""Actuators of a model file whose gains count: of a walking robot also its `position` actuators."""


def gains_of(config: Config, robot: Robot, q: Array) -> Gains:
    """Return the gains of the configuration, else those of the model file, else defaults.

    A default gain comes from the inertia I of a joint, the largest of robot and load on the path, and the bandwidth w:
    kp = I w^2, kd = 2 I w, ki = 0 (critical damping). See `_arm_gains` and `_walking_gains` for the exceptions.

    Args:
        config: the task.
        robot: its robot, n coordinates, m of them with a motor.
        q: coordinates along the path (P, n) [rad or m].

    Raises:
        ConfigError: a list of gains does not have one value per joint.
    """
    execution = config.execution or ExecutionConfig()
    names, walks = robot.joint_names[robot.base :], robot.base > 0
    found = _model_gains(robot.original, SERVOS[walks])
    if not all(name in found for name in names):
        kp, kd = (_walking_gains if walks else _arm_gains)(config, robot, q, execution.timestep)
        found = {name: {"kp": kp[k], "ki": 0.0, "kd": kd[k]} for k, name in enumerate(names)} | found
    values = {
        kind: _given(execution.controller, kind, names, np.array([found[name][kind] for name in names]))
        for kind in ("kp", "ki", "kd")
    }
    torque = walks or execution.controller.feedforward == "computed_torque"
    return Gains(**values, inputs=WITH_TORQUE if torque else POSITION_VELOCITY)


def _given(controller: ControllerConfig, kind: str, names: tuple[str, ...], otherwise: Array) -> Array:
    """Return the gains (m,) that the configuration gives, once or per joint, else others."""
    values = getattr(controller, kind)
    if values is None:
        return otherwise
    if isinstance(values, tuple) and len(values) != len(names):
        found = f"found {len(values)} values; expected one, or one for each of the joints {', '.join(names)}"
        raise ConfigError(found, key=f"execution.controller.{kind}")
    return np.broadcast_to(np.asarray(values, dtype=float), (len(names),)).copy()


def _model_gains(model: mujoco.MjModel, kinds: set[int]) -> dict[str, dict[str, float]]:
    """Return the gains of the actuators of these kinds in a model file, by joint name."""
    found = {}
    for i in range(model.nactuator):
        on_joint = model.actuator_trntype[i] == mujoco.mjtTrn.mjTRN_JOINT
        kp, kd = -model.actuator_biasprm[i, 1:3]
        if on_joint and int(model.actuator_dyntype[i]) in kinds and model.actuator_gear[i, 0] == 1 and kp > 0:
            name = model.joint(model.actuator_trnid[i, 0]).name
            ki = float(model.actuator_gainprm[i, 0]) if model.actuator_dyntype[i] == PID else 0.0
            found[name] = {"kp": float(kp), "kd": float(kd), "ki": ki}
    return found


def _arm_gains(config: Config, robot: Robot, q: Array, h: float) -> tuple[Array, Array]:
    """Return kp and kd of the joints of an arm, (n,) each, from the part of its inertia that is stable."""
    mass_matrix, load, tray = _dynamics(config, robot, q)
    inertia = _stable_part(_largest(mass_matrix + load), mass_matrix + tray, h)
    return inertia * BANDWIDTH**2, 2 * inertia * BANDWIDTH


def _stable_part(largest: Array, matrices: Array, h: float) -> Array:
    """Return the inertia of each joint from which default gains may be made, (m,).

    Gains that suit a load many times heavier than the robot are unstable without it, and objects slide. Joints that
    move much the same, such as two of a shoulder whose axes coincide, have little inertia against each other: gains for
    all of it would be unstable, however sound each joint is by itself. So each joint counts with at most a multiple of
    its inertia while all others give way: the largest multiple with which the controller goes no more than `STABILITY`
    of the way to its instability.

    With m joints, STABILITY / m of the limit of each alone is always stable: the matrices are at least 1 / m of the
    diagonal of that inertia. kp and kd shrink alike, so a joint that counts with a part f of its inertia has a damping
    ratio of sqrt(f); a shorter time step leaves more.

    Args:
        largest: inertia of each joint, loaded (m,).
        matrices: inertia of the joints along the path, unloaded (P, m, m).
        h: time step [s]; one that is too long for the bandwidth changes nothing: the user has to shorten it.
    """
    flexibility = np.asarray(np.linalg.inv(matrices), dtype=np.float64)
    alone = 1.0 / np.diagonal(flexibility, axis1=1, axis2=2).max(axis=0)
    stiffness = (h * BANDWIDTH) ** 2 / 4 + h * BANDWIDTH

    def reached(multiple: float) -> float:
        return _largest_share(stiffness * np.minimum(largest, multiple * alone), flexibility)

    low, high = STABILITY / (stiffness * len(largest)), float((largest / alone).max())
    if stiffness >= 1 or reached(high) <= STABILITY:
        return largest
    for _ in range(40):
        middle = np.sqrt(low * high)
        low, high = (middle, high) if reached(middle) <= STABILITY else (low, middle)
    return np.minimum(largest, low * alone)


def _walking_gains(config: Config, robot: Robot, q: Array, h: float) -> tuple[Array, Array]:
    """Return kp and kd of the joints of a walking robot, (m,) each.

    A joint of a standing leg holds up the rest of the robot, which topples with the torque m g h per radian (h: height
    of the centre of mass): however light the foot, its kp is at least `UPRIGHT` times that. kd = 2 sqrt(kp I) damps a
    limb in the air critically; it shrinks for all joints if the controller would go more than `STABILITY` of the way to
    its instability.
    """
    matrices, load, _ = _dynamics(config, robot, q)
    inertia = _largest(matrices + load)
    kp = inertia * BANDWIDTH**2
    height = max(float(robot.contacts_and_com(qi)[0] @ robot.up) for qi in q)
    toppling = robot.mass * float(np.linalg.norm(config.gravity)) * height
    legs = np.unique(np.concatenate([robot.chains[foot] for foot in FEET]))
    kp[legs] = np.maximum(kp[legs], UPRIGHT * toppling)
    driven = slice(robot.base, None)
    kp, kd = kp[driven], 2 * np.sqrt(kp * inertia)[driven]
    flexibility = np.asarray(np.linalg.inv(matrices)[:, driven, driven], dtype=np.float64)  # while the base gives way
    from_kp, from_kd = _largest_share(h**2 * kp / 4, flexibility), _largest_share(h * kd / 2, flexibility)
    if from_kp < STABILITY:  # else the user has to shorten the time step
        kd = kd * min(1.0, (STABILITY - from_kp) / from_kd)
    return kp, kd


def _largest_share(stiffness: Array, flexibility: Array) -> float:
    """Return the largest part of the inertia, whose inverse is flexibility (P, m, m), that a diagonal (m,) comes to."""
    root = np.sqrt(stiffness)
    return float(np.linalg.eigvalsh(root[:, None] * flexibility * root).max())


def _dynamics(config: Config, robot: Robot, q: Array) -> tuple[Array, Array, Array]:
    """Return mass matrices at coordinates q, and the inertia that the whole load and the tray alone add, (P, n, n)."""
    dynamics = robot.dynamics(q, np.zeros_like(q), np.zeros_like(q))
    known = config.model_copy(update={"uncertainty": UncertaintyConfig()})
    carried = {name: _spatial_inertia(body) for name, body in bodies(known).items()}
    if dynamics.carrier is None or not carried:
        none = np.zeros_like(dynamics.mass_matrix)
        return dynamics.mass_matrix, none, none
    J = dynamics.carrier.jacobian
    turned = np.swapaxes(J, 1, 2)
    tray = carried.get("tray", np.zeros((6, 6)))
    return dynamics.mass_matrix, turned @ sum(carried.values()) @ J, turned @ tray @ J


def _largest(matrices: Array) -> Array:
    """Return the largest diagonal of matrices (P, n, n), (n,)."""
    return np.asarray(np.diagonal(matrices, axis1=1, axis2=2).max(axis=0))


def _spatial_inertia(body: Body) -> Array:
    """Return the wrench about the carrier's origin per acceleration of the carrier, linear then angular, (6, 6)."""
    unit = np.eye(6)
    return np.asarray((regressor(unit[:, :3], unit[:, 3:]) @ body.nominal).T)
