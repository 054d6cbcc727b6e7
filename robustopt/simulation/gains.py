"""Gains of the joint controllers, from configuration, model file or inertia, and the stability of the sampled loop."""

from __future__ import annotations

import mujoco
import numpy as np
from scipy.linalg import eigh

from robustopt.arrays import Array, Indices
from robustopt.config import FEET, Config, ExecutionConfig, UncertaintyConfig
from robustopt.config.execution_model import ControllerConfig
from robustopt.errors import ConfigError
from robustopt.limits.bodies import Body, regressor
from robustopt.limits.uncertainty import bodies
from robustopt.robot import Robot
from robustopt.simulation.controller import POSITION_VELOCITY, WITH_TORQUE, Gains, JointLayout
from robustopt.simulation.physics import PID, physics_of

BANDWIDTH = 50.0
"""Natural frequency of the default gains [rad/s], about that of the first joint of the shipped arm (our choice)."""

UPRIGHT = 10.0
"""Smallest ratio of the default stiffness of legs to the stiffness below which the robot topples, as for the shipped
humanoid (our choice)."""

STABILITY = 0.5
"""Largest fraction of the stability limit of the sampled controller that default gains may reach (our choice)."""

GROWTH = 1e-9
"""Growth per step that rounding errors can give a constant mode."""


def gains_of(config: Config, robot: Robot, q: Array) -> Gains:
    """Return the gains from the configuration, else from the model file, else default gains.

    A default gain follows from the inertia I of a joint, the largest of robot and load along the path, and from the
    bandwidth w: kp = I w^2, kd = 2 I w, ki = 0 (critical damping, our choice). `_stable_part` and `_walking_gains`
    describe exceptions.

    Args:
        config: the configuration.
        robot: the robot.
        q: coordinates along the path (P, n) [rad or m].

    Raises:
        ConfigError: a gain has neither one value nor one for each joint.
    """
    execution = config.execution or ExecutionConfig()
    names, physics = robot.joint_names[robot.motors], physics_of(robot.base, holds=False)
    found = _model_gains(robot.original, physics.servos)
    if not all(name in found for name in names):
        kp, kd = (_walking_gains if robot.base else _arm_gains)(config, robot, q, execution.timestep)
        found = {name: {"kp": kp[k], "ki": 0.0, "kd": kd[k]} for k, name in enumerate(names)} | found
    values = {
        kind: _given(execution.controller, kind, names, np.array([found[name][kind] for name in names]))
        for kind in ("kp", "ki", "kd")
    }
    torque = not physics.compensated or execution.controller.feedforward == "computed_torque"
    return Gains(**values, inputs=WITH_TORQUE if torque else POSITION_VELOCITY)


def _given(controller: ControllerConfig, kind: str, names: tuple[str, ...], otherwise: Array) -> Array:
    """Return the gains (m,) in the configuration, given once or per joint, else `otherwise`."""
    values = getattr(controller, kind)
    if values is None:
        return otherwise
    if isinstance(values, tuple) and len(values) != len(names):
        found = f"found {len(values)} values; expected one, or one for each of the joints {', '.join(names)}"
        raise ConfigError(found, key=f"execution.controller.{kind}")
    return np.broadcast_to(np.asarray(values, dtype=float), (len(names),)).copy()


def _model_gains(model: mujoco.MjModel, kinds: frozenset[int]) -> dict[str, dict[str, float]]:
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
    """Return the inertia of each joint on which its default gains are based, (m,).

    Gains that suit a load many times heavier than the robot are unstable without it, and objects can slide off. Joints
    that have nearly the same effect, such as two of a shoulder whose axes coincide, have little inertia against each
    other: gains for the whole inertia would be unstable together, even if each joint is stable by itself. So each joint
    counts with at most a multiple of its inertia while all others give way: the largest multiple with which the
    controller stays within `STABILITY` of its limit of stability.

    With m joints, STABILITY / m of the limit of each joint alone is always stable, because the matrices are at least 1
    / m of the diagonal of that inertia. kp and kd shrink alike, so a joint that counts with a fraction f of its inertia
    has a damping ratio of sqrt(f); a shorter time step leaves more.

    Args:
        largest: inertia of each joint, loaded (m,).
        matrices: inertia of the joints along the path, unloaded (P, m, m).
        h: time step [s]; if it is too long for the bandwidth, nothing is changed and the user has to shorten it.
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

    A joint of a standing leg supports the rest of the robot, which topples with a torque of m g h per radian at height
    h of the centre of mass. However light the foot, its kp is at least `UPRIGHT` times that. kd = 2 sqrt(kp I) damps a
    limb in the air critically. It is reduced for all joints if the controller would otherwise exceed `STABILITY` of its
    limit of stability.
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
    """Return the largest fraction of an inertia, with inverse `flexibility` (P, m, m), that a diagonal (m,) reaches."""
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


# Stability ------------------------------------------------------------------------------------------------


def require_stable(model: mujoco.MjModel, layout: JointLayout, gains: Gains, names: tuple[str, ...], q: Array) -> None:
    """Check that the controllers are stable along the path.

    With the time step h, semi-implicit Euler and implicit joint damping D, the loop M qdd = -kp q - (kd + D) qd is
    stable if h^2 kp + 2 h (kd - D) < 4 M. M is the inertia of the robot with its tray, without objects, which can slide
    on it. For a floating base, M is the inertia of the joints while the base gives way. MuJoCo's integrator for this
    case makes kd implicit too, so the rule is stricter than the loop requires, but not stricter than the contacts of
    feet require.

    For integral gains, the largest eigenvalue of one step of the loop decides. Additional inertia, of a load or of a
    body over a standing foot, makes it worse and is not counted, so a gain that is just accepted may still be too
    large.

    Args:
        model: model of the world.
        layout: indices of the m joints with a motor.
        gains: gains of their controllers.
        names: names of the joints (m,).
        q: positions of the joints along the path (P, m) [rad or m].

    Raises:
        ConfigError: the time step or an integral gain is too large.
    """
    data, h = mujoco.MjData(model), model.opt.timestep
    full, damping = np.zeros((model.nv, model.nv)), model.dof_damping[layout.dofs]
    implicit = model.opt.integrator == mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    stiffness = np.diag(h**2 * gains.kp + 2 * h * (gains.kd - damping)) / 4
    worst, growing = np.zeros(len(names)), np.zeros(len(names))
    for qi in q:
        data.qpos[layout.joints] = qi
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_makeM(model, data)
        mujoco.mj_fullM(model, data, full)
        inertia = _inertia_of(full, layout.dofs)
        values, vectors = eigh(stiffness, inertia)
        if values[-1] > worst.max():
            worst = values[-1] * np.abs(vectors[:, -1]) / np.abs(vectors[:, -1]).max()
        if gains.ki.any() and not growing.any():
            growing = _growing(inertia, damping, gains, h, implicit)
    _refuse(names, worst, growing, gains, h)


def _refuse(names: tuple[str, ...], worst: Array, growing: Array, gains: Gains, h: float) -> None:
    if worst.max() >= 1:
        raise ConfigError(
            f"found {h:g} s, but the controller of {names[int(np.argmax(worst))]} is unstable with this time step; "
            "expected a shorter one, or smaller gains in execution.controller",
            key="execution.timestep",
        )
    if growing.any():
        joint = int(np.argmax(growing))
        raise ConfigError(
            f"found {gains.ki[joint]:g}, but the controller of {names[joint]} is unstable with this integral gain; "
            "expected a gain well below kp kd / inertia of the joint",
            key="execution.controller.ki",
        )


def _growing(inertia: Array, damping: Array, gains: Gains, h: float, implicit: bool) -> Array:
    """Return the torque of each joint's integral in the fastest growing mode of the loop (m,); 0 if none grows.

    With position error e, velocity v and integral z, one step is z' = z - h e, e' = e + h v' and
    (M + h D) v' = M v + h (ki z - kp e - kd v), with kd v' in place of kd v if the integrator makes it implicit.
    """
    m, eye, kd = len(inertia), np.eye(len(inertia)), h * np.diag(gains.kd)
    solve = np.linalg.inv(inertia + h * np.diag(damping) + (kd if implicit else 0.0))
    e, v, z = -h * solve * gains.kp, solve @ (inertia if implicit else inertia - kd), h * solve * gains.ki
    step = np.block([[eye + h * e, h * v, h * z], [e, v, z], [-h * eye, 0 * eye, eye]])
    values, vectors = np.linalg.eig(step)
    fastest = int(np.argmax(np.abs(values)))
    grows = np.abs(values[fastest]) > 1 + GROWTH
    return gains.ki * np.abs(vectors[2 * m :, fastest]) if grows else np.zeros(m)


def _inertia_of(full: Array, dofs: Indices) -> Array:
    """Return the inertia of some degrees of freedom while the others give way (m, m), from the whole mass matrix."""
    others = np.setdiff1d(np.arange(len(full)), dofs)
    across = full[np.ix_(dofs, others)]
    given = across @ np.linalg.solve(full[np.ix_(others, others)], across.T) if len(others) else 0.0
    return np.asarray(full[np.ix_(dofs, dofs)] - given)
