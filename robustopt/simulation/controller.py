"""Joint controller: a PID with gravity compensation, or with feedforward of the torque of the planned motion.

The controller runs inside MuJoCo as one `pid` actuator per joint, with the planned position and velocity as inputs. The
limit of a drive applies to the sum of its torques, gravity compensation included.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import mujoco
import numpy as np

from robustopt.arrays import Array, Flags, Indices
from robustopt.solvers.trajectory import Trajectory, joint_motion

_INPUTS = mujoco.mjtCtrlInput
POSITION_VELOCITY = int(_INPUTS.mjINPUT_POS) | int(_INPUTS.mjINPUT_VEL)
WITH_TORQUE = POSITION_VELOCITY | int(_INPUTS.mjINPUT_FF)


@dataclass(frozen=True)
class Gains:
    """Gains of the controllers of m joints.

    Attributes:
        kp: proportional gains (m,) [N m/rad or N/m].
        ki: integral gains (m,) [N m/(rad s) or N/(m s)].
        kd: derivative gains (m,) [N m s/rad or N s/m].
        inputs: inputs that the controllers take, bits of MuJoCo's mjtCtrlInput.
    """

    kp: Array
    ki: Array
    kd: Array
    inputs: int


@dataclass(frozen=True)
class Reference:
    """Reference of the controllers, one row for each of N time steps; n coordinates.

    Attributes:
        t: start of each step (N,); 0 is the start of the motion [s].
        s: planned position along the path at that time (N,).
        q: planned coordinates at that time (N, n) [rad or m].
        qd: planned velocities at that time (N, n) [rad/s or m/s].
        qdd: planned accelerations in the middle of each step (N, n) [rad/s^2 or m/s^2].
        moving: whether the step is part of the motion (N,).
        torque: torque of the planned motion in the middle of each step (N, n) [N m or N]; None without feedforward of
            it.
    """

    t: Array
    s: Array
    q: Array
    qd: Array
    qdd: Array
    moving: Flags
    torque: Array | None = None


@dataclass(frozen=True)
class JointLayout:
    """Indices of the m joints with a motor in the arrays of a model.

    Attributes:
        joints: their indices in qpos (m,).
        dofs: their indices in qvel (m,).
        control: index of the first control input of each (m,).
    """

    joints: Indices
    dofs: Indices
    control: Indices


def reference(trajectory: Trajectory, timestep: float, hold: tuple[float, float]) -> Reference:
    """Sample a trajectory at every time step, including the times at rest before and after the motion.

    There is no time at rest at an end at which the robot moves.

    Args:
        trajectory: the trajectory.
        timestep: time step [s].
        hold: times at rest before and after the motion [s].
    """
    moving_ends = trajectory.path.moving_ends
    before, after = (0.0 if end in moving_ends else time for end, time in zip(("start", "end"), hold, strict=True))
    steps = int(np.ceil((before + trajectory.duration + after) / timestep - 1e-6))
    t = np.arange(steps, dtype=np.float64) * timestep - before
    last = trajectory.duration if "end" in moving_ends else np.inf
    start, middle = trajectory.sample(t), trajectory.sample(np.minimum(t + timestep / 2, last))
    moving = (middle.t > 0) & (middle.t < trajectory.duration)
    return Reference(t, start.s, start.q, start.qd, middle.qdd, moving)


def run_up(trajectory: Trajectory) -> Reference:
    """Return the reference at the start of a motion with the acceleration that the path gives there, one row.

    Args:
        trajectory: the motion, which begins at a speed.
    """
    path, sd = trajectory.path, trajectory.sd[:1]
    sdd = path.end_accelerations[0] * (sd / path.end_speeds[0]) ** 2
    found = joint_motion(path, trajectory.piece[:1], np.zeros(1), trajectory.s[:1], sd, sdd)
    return Reference(found.t, found.s, found.q, found.qd, found.qdd, np.zeros(1, dtype=bool))


def standing(moving: Reference) -> Reference:
    """Return the reference of a robot that stands still in a position, one row.

    Args:
        moving: reference in this position, one row.
    """
    return replace(moving, qd=np.zeros_like(moving.qd), qdd=np.zeros_like(moving.qdd))


def controls(model: mujoco.MjModel, layout: JointLayout, planned: Reference, driven: slice) -> Array:
    """Return the control inputs at every time step, (N, nu).

    Args:
        model: model of the world.
        layout: indices of the joints with a motor.
        planned: reference of the controllers.
        driven: the coordinates that have a motor.
    """
    inputs = np.zeros((len(planned.t), model.nu))
    inputs[:, layout.control] = planned.q[:, driven]
    inputs[:, layout.control + 1] = planned.qd[:, driven]
    if planned.torque is not None:
        inputs[:, layout.control + 2] = planned.torque[:, driven]
    return inputs


def computed_torque(rigid: mujoco.MjModel, planned: Reference) -> Array:
    """Return the torque of a motion beyond gravity compensation, (N, n) [N m or N].

    Args:
        rigid: model of the robot with its load fixed to it.
        planned: the motion.
    """
    data = mujoco.MjData(rigid)
    torque = np.zeros_like(planned.q)
    for i in range(len(planned.t)):
        data.qpos[:], data.qvel[:], data.qacc[:] = planned.q[i], planned.qd[i], planned.qdd[i]
        mujoco.mj_inverse(rigid, data)
        torque[i] = data.qfrc_inverse
    return torque
