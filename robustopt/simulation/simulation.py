"""Many trials at once in MuJoCo: settle, then run open loop on controls that are known beforehand, in C threads."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import mujoco
import numpy as np
from mujoco.batch import Batch

Array = np.ndarray

SETTLE = 0.5
"""Time for which the world comes to rest under the controller before anything is recorded [s]."""

CONTROL = int(mujoco.mjtState.mjSTATE_CTRL) | int(mujoco.mjtState.mjSTATE_XFRC_APPLIED)


@dataclass(frozen=True)
class Record:
    """What trials did in N time steps; leading index: trial.

    qpos (n, N, nq), qvel (n, N, nv): after each step; start_qpos (n, nq), start_qvel (n, nv): before the first;
    sensors (n, N, .) and torque (n, N, nv), drives and gravity compensation together: at the start of each step;
    diverged: (n,)
    """

    qpos: Array
    qvel: Array
    start_qpos: Array
    start_qvel: Array
    sensors: Array
    torque: Array
    diverged: Array


def joint_positions(record: Record, joints: Array, i: int) -> Array:
    """Positions of joints of a trial at the start of each step, (N, m); joints: their indices in qpos."""
    return np.vstack([record.start_qpos[i, joints], record.qpos[i, :-1][:, joints]])


def joint_velocities(record: Record, dofs: Array, i: int) -> Array:
    """Velocities of joints of a trial before each step and after the last, (N + 1, m); dofs: their indices in qvel."""
    return np.vstack([record.start_qvel[i, dofs], record.qvel[i][:, dofs]])


class Workspace:
    """Large arrays that are used again from chunk to chunk: to have new ones zeroed costs as much as a tenth of a run.

    A record made in a workspace is valid until the next one.
    """

    def __init__(self) -> None:
        self._arrays: dict[str, Array] = {}

    def array(self, name: str, shape: tuple[int, ...]) -> Array:
        """An array of the shape; zeros at first, later what was last written to it."""
        found = self._arrays.get(name)
        if found is None or found.shape != shape:
            found = self._arrays[name] = np.zeros(shape)
        return found


def simulate(
    models: Sequence[mujoco.MjModel], start: Array, control: Array, threads: int, workspace: Workspace
) -> Record:
    """Run trials from rest.

    models: one for all trials, or one for each; start: qpos (n, nq); control: inputs and then the external forces on
    all bodies, (n, N, nu + 6 nbody); threads: at most as many at a time
    """
    trials, steps = control.shape[:2]
    model = models[0]
    batch = Batch(model, trials, min(threads, trials))
    if len(models) > 1:
        batch.set_models(list(models))
    with _no_log_file():
        _settle(batch, models, start, control[:, 0, : model.nu])
    warned = _warned(batch)
    qpos, qvel = batch.bind("qpos").copy(), batch.bind("qvel").copy()
    sizes = {"qpos": model.nq, "qvel": model.nv, "sensordata": model.nsensordata, "qfrc_actuator": model.nv}
    records = {name: workspace.array(name, (trials, steps, size)) for name, size in sizes.items()}
    with _no_log_file():
        out = batch.rollout(steps, control, control_spec=CONTROL, record=tuple(sizes), out=records)
    diverged = warned | _warned(batch) | ~np.isfinite(out["qpos"][:, -1]).all(axis=1)
    diverged |= np.abs(batch.bind("time") - steps * model.opt.timestep) > model.opt.timestep / 2
    return Record(out["qpos"], out["qvel"], qpos, qvel, out["sensordata"], out["qfrc_actuator"], diverged)


def _settle(batch: Batch, models: Sequence[mujoco.MjModel], start: Array, inputs: Array) -> None:
    """Bring all trials to rest; those that are alike are settled once."""
    steps = round(SETTLE / batch.model.opt.timestep)
    alike = len(models) == 1 and bool((start == start[0]).all() and (inputs == inputs[0]).all())
    settled = Batch(batch.model, 1, 1) if alike else batch
    settled.bind("qpos")[:] = start[: settled.nsim]
    settled.bind("ctrl")[:] = inputs[: settled.nsim]
    settled.step(nstep=steps)
    if alike:
        batch.state[:] = settled.state
        batch.warning[:] = settled.warning
    batch.bind("time")[:] = 0.0


@contextmanager
def _no_log_file() -> Iterator[None]:
    """Keep MuJoCo from writing its warnings to a file in the working directory; they are counted in the batch."""
    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(lambda _: None)
    try:
        yield
    finally:
        mujoco.set_mju_user_warning(before)


def _warned(batch: Batch) -> Array:
    """Trials in which MuJoCo has warned, (n,): that is how it reports a simulation that diverges."""
    return np.asarray(batch.warning.reshape(batch.nsim, -1).any(axis=1))
