"""Joint controller: PID with gravity compensation, optionally with the torque of the planned motion fed forward.

The controller runs inside MuJoCo as one `pid` actuator per joint, with the planned position and velocity as inputs.
Gravity compensation of arm and tray counts as torque of the drives, and the drives' limit holds for the sum.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh

from robustopt.config import BASE_COORDINATES as BASE
from robustopt.config import FEET, Config, UncertaintyConfig
from robustopt.errors import ConfigError
from robustopt.limits.bodies import Body, regressor
from robustopt.limits.uncertainty import bodies
from robustopt.robot import Robot
from robustopt.robot.preparation import load_model
from robustopt.solvers.trajectory import Trajectory

Array = NDArray[np.float64]

BANDWIDTH = 50.0
"""Natural frequency of the default gains [rad/s], about that of the first joint of the shipped robot (our choice)."""

UPRIGHT = 10.0
"""How many times stiffer than a robot topples the default gains of its legs are at least: about what those of the
shipped humanoid are (our choice)."""

STABILITY = 0.5
"""Part of the way to the instability of the sampled controller that default gains may go (our choice)."""

GROWTH = 1e-9
"""Part by which a step may seem to grow what stays as it is: rounding."""

_INPUTS = mujoco.mjtCtrlInput
POSITION_VELOCITY = int(_INPUTS.mjINPUT_POS) | int(_INPUTS.mjINPUT_VEL)
PID = int(mujoco.mjtDyn.mjDYN_PID)
WITH_TORQUE = POSITION_VELOCITY | int(_INPUTS.mjINPUT_FF)


@dataclass(frozen=True)
class Gains:
    """Gains of the joint controllers, (n,) each, and which inputs they take (MuJoCo's mjtCtrlInput bits)."""

    kp: Array
    ki: Array
    kd: Array
    inputs: int


@dataclass(frozen=True)
class Reference:
    """What the controller is told, one row per time step; t = 0 is the start of the motion.

    t, s: (N,) [s], [1]; q, qd: (N, n) planned at the start of each step; qdd: (N, n) planned in its middle;
    moving: (N,) whether the step is part of the motion; torque: (N, n) of the planned motion in the middle of the step
    [N m or N], where the plan is known to say it
    """

    t: Array
    s: Array
    q: Array
    qd: Array
    qdd: Array
    moving: NDArray[np.bool_]
    torque: Array | None = None


@dataclass(frozen=True)
class JointLayout:
    """Where things are in the arrays of a compiled scene.

    joints, dofs: of the m joints with a motor, in qpos and qvel; control: first control column of each; bodies: numbers
    of those that a force can act on, by name
    """

    joints: Array
    dofs: Array
    control: Array
    bodies: Mapping[str, int]


def gains_of(config: Config, robot: Robot, q: Array) -> Gains:
    """Gains from the configuration, else from the actuators of the model file, else from the joint's inertia.

    Actuators that count are `pid` ones, those of a robot on its feet also `position` ones. Default of a joint with
    inertia I, the largest of robot and load at coordinates q (P, n), and bandwidth w: kp = I w^2, kd = 2 I w, ki = 0
    (critical damping); of the joints of an arm less of I where that would be unstable, see `_stable_part`; legs are
    stiffer, see `_gains_on_feet`.
    """
    assert config.execution is not None
    given = config.execution.controller
    if robot.base:
        names, model = robot.joint_names[BASE:], load_model(config).original
        kinds = {PID, int(mujoco.mjtDyn.mjDYN_NONE)}
    else:
        names, model, kinds = robot.joint_names, load_model(config).original, {PID}
    found = _model_gains(model, kinds)
    if not all(name in found for name in names):
        found = _default_gains(config, robot, q, names) | found
    values = {}
    for kind, key in (("kp", given.kp), ("ki", given.ki), ("kd", given.kd)):
        values[kind] = np.array([found[name][kind] for name in names])
        if key is not None:
            values[kind] = _per_joint(key, names, f"execution.controller.{kind}")
    torque = config.walks or given.feedforward == "computed_torque"
    inputs = WITH_TORQUE if torque else POSITION_VELOCITY
    return Gains(**values, inputs=inputs)


def reference(trajectory: Trajectory, timestep: float, hold: tuple[float, float]) -> Reference:
    """The trajectory at every time step, between the times the robot stands still."""
    steps = int(np.ceil((hold[0] + trajectory.duration + hold[1]) / timestep - 1e-6))
    t = np.arange(steps, dtype=np.float64) * timestep - hold[0]
    start, middle = trajectory.sample(t), trajectory.sample(t + timestep / 2)
    moving = (middle.t > 0) & (middle.t < trajectory.duration)
    return Reference(t, start.s, start.q, start.qd, middle.qdd, moving)


def controls(model: mujoco.MjModel, layout: JointLayout, planned: Reference, torque: Array | None) -> Array:
    """Control inputs at every time step, (N, nu); torque: (N, n) fed forward, or None."""
    inputs = np.zeros((len(planned.t), model.nu))
    inputs[:, layout.control] = planned.q
    inputs[:, layout.control + 1] = planned.qd
    if torque is not None:
        inputs[:, layout.control + 2] = torque
    return inputs


def computed_torque(rigid: mujoco.MjModel, planned: Reference) -> Array:
    """Torque of the planned motion beyond gravity compensation, (N, n): inverse dynamics of arm and believed load."""
    data = mujoco.MjData(rigid)
    torque = np.zeros_like(planned.q)
    for i in range(len(planned.t)):
        data.qpos[:], data.qvel[:], data.qacc[:] = planned.q[i], planned.qd[i], planned.qdd[i]
        mujoco.mj_inverse(rigid, data)
        torque[i] = data.qfrc_inverse
    return torque


def require_stable(model: mujoco.MjModel, layout: JointLayout, gains: Gains, names: tuple[str, ...], q: Array) -> None:
    """Refuse a time step or an integral gain at which the sampled controller is unstable on the path q (P, m).

    With the time step h, semi-implicit Euler and implicit joint damping D, the loop M qdd = -kp q - (kd + D) qd is
    stable where h^2 kp + 2 h (kd - D) < 4 M: M of the arm and the tray, without objects, which slide on it. Where the
    base is free, M is what is left of the joints' inertia when the base gives way; MuJoCo's integrator for it makes kd
    implicit too, so there the rule is stricter than the loop needs, which contacts of feet at long time steps do need.
    With an integral gain the largest eigenvalue of a step of the loop says it: more inertia, of what is carried or of a
    body over a standing foot, makes that worse and is not counted, so an integral gain that is just accepted may still
    be too large.
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
    if worst.max() >= 1:
        raise ConfigError(
            f"found {h:g} s; the controller of {names[int(np.argmax(worst))]} is unstable with so long a time step: "
            "expected a shorter one, or smaller gains in execution.controller",
            key="execution.timestep",
        )
    if growing.any():
        joint = int(np.argmax(growing))
        raise ConfigError(
            f"found {gains.ki[joint]:g}; the controller of {names[joint]} is unstable with so large an integral gain: "
            "expected well below kp kd / inertia of the joint",
            key="execution.controller.ki",
        )


def _growing(inertia: Array, damping: Array, gains: Gains, h: float, implicit: bool) -> Array:
    """Torque of each joint's integral in what grows fastest from step to step (m,); 0 where nothing grows.

    State: position error e, velocity v and integral z, with z' = z - h e, e' = e + h v' and
    (M + h D) v' = M v + h (ki z - kp e - kd v), where `implicit` with kd v' instead of kd v.
    """
    m, eye, kd = len(inertia), np.eye(len(inertia)), h * np.diag(gains.kd)
    solve = np.linalg.inv(inertia + h * np.diag(damping) + (kd if implicit else 0.0))
    e, v, z = -h * solve * gains.kp, solve @ (inertia if implicit else inertia - kd), h * solve * gains.ki
    step = np.block([[eye + h * e, h * v, h * z], [e, v, z], [-h * eye, 0 * eye, eye]])
    values, vectors = np.linalg.eig(step)
    fastest = int(np.argmax(np.abs(values)))
    grows = np.abs(values[fastest]) > 1 + GROWTH
    return gains.ki * np.abs(vectors[2 * m :, fastest]) if grows else np.zeros(m)


def _inertia_of(full: Array, dofs: np.ndarray) -> Array:
    """Inertia of some degrees of freedom while the others give way (m, m), from that of all."""
    others = np.setdiff1d(np.arange(len(full)), dofs)
    across = full[np.ix_(dofs, others)]
    given = across @ np.linalg.solve(full[np.ix_(others, others)], across.T) if len(others) else 0.0
    return np.asarray(full[np.ix_(dofs, dofs)] - given)


def _per_joint(values: float | tuple[float, ...], names: tuple[str, ...], key: str) -> Array:
    if isinstance(values, tuple) and len(values) != len(names):
        joints = ", ".join(names)
        raise ConfigError(f"found {len(values)} values; expected one, or one for each of the joints {joints}", key=key)
    return np.broadcast_to(np.asarray(values, dtype=float), (len(names),)).copy()


def _model_gains(model: mujoco.MjModel, kinds: set[int]) -> dict[str, dict[str, float]]:
    """Gains of the `pid` actuators of a model, and of its `position` ones (without dynamics), by joint name."""
    found = {}
    for i in range(model.nactuator):
        on_joint = model.actuator_trntype[i] == mujoco.mjtTrn.mjTRN_JOINT
        kp, kd = -model.actuator_biasprm[i, 1:3]
        if on_joint and int(model.actuator_dyntype[i]) in kinds and model.actuator_gear[i, 0] == 1 and kp > 0:
            name = model.joint(model.actuator_trnid[i, 0]).name
            ki = float(model.actuator_gainprm[i, 0]) if model.actuator_dyntype[i] == PID else 0.0
            found[name] = {"kp": float(kp), "kd": float(kd), "ki": ki}
    return found


def _default_gains(config: Config, robot: Robot, q: Array, names: tuple[str, ...]) -> dict[str, dict[str, float]]:
    """Gains from the inertia of the joints at coordinates q (P, n), by joint name."""
    assert config.execution is not None
    if robot.base:
        kp, kd = _gains_on_feet(config, robot, q)
    else:
        inertia = _stable_part(*_inertia(config, robot, q), config.execution.timestep)
        kp, kd = inertia * BANDWIDTH**2, 2 * inertia * BANDWIDTH
    return {name: {"kp": kp[k], "ki": 0.0, "kd": kd[k]} for k, name in enumerate(names)}


def _stable_part(largest: Array, matrices: Array, h: float) -> Array:
    """Inertia of each joint of an arm that default gains may be made from, (m,).

    Gains that suit a load many times heavier than what moves it are unstable without it: objects slide. And joints
    that move much the same, such as two of a shoulder whose axes fall together, have little inertia against each other:
    gains as for all of it would be unstable (see `require_stable`), however sound each joint by itself. So of each
    joint at most a multiple of what is left of it counts when all others give way: the largest multiple with which the
    controller goes no more than `STABILITY` of the way. With m joints, STABILITY / m of the limit of each alone is
    always stable: the matrices are at least 1 / m of the diagonal of what is left. kp and kd shrink alike, so a joint
    of which a part f counts has a damping ratio of sqrt(f); a shorter time step leaves more.

    largest: inertia of each joint, loaded (m,); matrices: of the joints along the path, unloaded (P, m, m); h: time
    step [s]. A time step that is too long for the bandwidth changes nothing: it is for the user to mend.
    """
    flexibility = np.linalg.inv(matrices)
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


def _largest_share(stiffness: Array, flexibility: np.ndarray) -> float:
    """Largest part of the inertia of joints, whose inverse is flexibility (P, m, m), that a diagonal (m,) comes to."""
    root = np.sqrt(stiffness)
    return float(np.linalg.eigvalsh(root[:, None] * flexibility * root).max())


def _gains_on_feet(config: Config, robot: Robot, q: Array) -> tuple[Array, Array]:
    """kp and kd of the joints of a robot on its feet at coordinates q (P, n), (m,) each.

    I is the largest diagonal of the mass matrix, of a limb in the air. A joint of a leg that stands holds up all the
    rest, which topples with the torque m g h per radian (h: height of the centre of mass): however light the foot, its
    kp is at least `UPRIGHT` times that. kd = 2 sqrt(kp I) damps the limb in the air critically, and is a part of that
    for all joints where the sampled controller would else go more than `STABILITY` of the way (see `require_stable`).
    """
    assert config.execution is not None
    h = config.execution.timestep
    matrices = robot.dynamics(q, np.zeros_like(q), np.zeros_like(q)).mass_matrix
    inertia = np.diagonal(matrices, axis1=1, axis2=2).max(axis=0)
    kp = inertia * BANDWIDTH**2
    height = max(float(robot.contacts_and_com(qi)[0] @ robot.up) for qi in q)
    toppling = robot.mass * float(np.linalg.norm(config.gravity)) * height
    legs = np.unique(np.concatenate([robot.chains[foot] for foot in FEET]))
    kp[legs] = np.maximum(kp[legs], UPRIGHT * toppling)
    kp, kd = kp[BASE:], 2 * np.sqrt(kp * inertia)[BASE:]
    flexibility = np.linalg.inv(matrices)[:, BASE:, BASE:]  # while the base gives way
    from_kp, from_kd = _largest_share(h**2 * kp / 4, flexibility), _largest_share(h * kd / 2, flexibility)
    if from_kp < STABILITY:  # else the time step is for the user to mend
        kd = kd * min(1.0, (STABILITY - from_kp) / from_kd)
    return kp, kd


def _inertia(config: Config, robot: Robot, q: Array) -> tuple[Array, Array]:
    """At joint positions q (P, n) of an arm: largest diagonal of the mass matrix with all that it carries (n,), and
    the mass matrices with the tray alone (P, n, n)."""
    arm = robot.dynamics(q, np.zeros_like(q), np.zeros_like(q))
    known = config.model_copy(update={"uncertainty": UncertaintyConfig()})
    carried = {name: _spatial_inertia(body) for name, body in bodies(known).items()}
    assert arm.carrier is not None
    J = arm.carrier.jacobian
    turned = np.swapaxes(J, 1, 2)
    loaded = arm.mass_matrix + turned @ sum(carried.values()) @ J
    largest = np.diagonal(loaded, axis1=1, axis2=2).max(axis=0)
    return np.asarray(largest), np.asarray(arm.mass_matrix + turned @ carried["tray"] @ J)


def _spatial_inertia(body: Body) -> Array:
    """Wrench about the tray's origin per acceleration of the tray, both linear then angular, (6, 6)."""
    unit = np.eye(6)
    return np.asarray((regressor(unit[:, :3], unit[:, 3:]) @ body.nominal).T)
