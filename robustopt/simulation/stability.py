"""Stability of the sampled joint controllers on a path.

With the time step h, semi-implicit Euler and implicit joint damping D, the loop M qdd = -kp q - (kd + D) qd is stable
if h^2 kp + 2 h (kd - D) < 4 M. M is the inertia of the robot with its tray, without objects, which can slide on it. If
the base floats, M is the inertia of the joints while the base gives way. MuJoCo's integrator for it makes kd implicit
too, so there the rule is stricter than the loop needs, but not stricter than the contacts of feet need.
"""

from __future__ import annotations

import mujoco
import numpy as np
from scipy.linalg import eigh

from robustopt.arrays import Array, Indices
from robustopt.errors import ConfigError
from robustopt.simulation.controller import Gains, JointLayout

GROWTH = 1e-9
"""Growth per step that rounding can give a constant."""


def require_stable(model: mujoco.MjModel, layout: JointLayout, gains: Gains, names: tuple[str, ...], q: Array) -> None:
    """Refuse a time step or an integral gain at which the controllers are unstable.

    For integral gains, the largest eigenvalue of one step of the loop decides. More inertia, of a load or of a body
    over a standing foot, makes that worse and is not counted, so a gain that is just accepted may still be too large.

    Args:
        model: compiled world with nominal parameters.
        layout: its m joints with a motor.
        gains: gains of their controllers.
        names: their names (m,).
        q: their positions along the path (P, m) [rad or m].

    Raises:
        ConfigError: the controller of a joint is unstable.
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
