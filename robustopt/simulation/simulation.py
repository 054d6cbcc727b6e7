"""Simulation of many trials at once in MuJoCo: they settle, then run open loop on known controls, in C threads."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import mujoco
import numpy as np
from mujoco.batch import Batch

from robustopt.arrays import Array, Flags, Indices

SETTLE = 0.5
"""Time for which the world comes to rest under the controller before recording starts [s]."""

CONTROL = int(mujoco.mjtState.mjSTATE_CTRL) | int(mujoco.mjtState.mjSTATE_XFRC_APPLIED)


@dataclass(frozen=True)
class Record:
    """States of k trials over N time steps.

    Attributes:
        qpos: positions after each step (k, N, nq).
        qvel: velocities after each step (k, N, nv).
        start_qpos: positions before the first step (k, nq).
        start_qvel: velocities before the first step (k, nv).
        sensors: sensor data at the start of each step (k, N, .).
        torque: torque of drives and gravity compensation together, at the start of each step (k, N, nv).
        diverged: whether the simulation of a trial diverged (k,).
    """

    qpos: Array
    qvel: Array
    start_qpos: Array
    start_qvel: Array
    sensors: Array
    torque: Array
    diverged: Flags


def positions_before(record: Record, i: int, chosen: slice | Indices = slice(None)) -> Array:
    """Return positions at the start of each step of a trial, (N, m).

    Args:
        record: the record.
        i: index of the trial in the record.
        chosen: indices of the positions in qpos.
    """
    return np.vstack([record.start_qpos[i, chosen], record.qpos[i, :-1][:, chosen]])


def velocities(record: Record, i: int, dofs: Indices) -> Array:
    """Return velocities of a trial before each step and after the last, (N + 1, m).

    Args:
        record: the record.
        i: index of the trial in the record.
        dofs: indices of the velocities in qvel (m,).
    """
    return np.vstack([record.start_qvel[i, dofs], record.qvel[i][:, dofs]])


@dataclass(frozen=True)
class Launch:
    """Start of k trials that begin in motion.

    Attributes:
        inputs: control inputs under which the world settles at rest (k, nu).
        qvel: velocities that it has at once when recording starts (k, nv).
    """

    inputs: Array
    qvel: Array


class Workspace:
    """Large arrays for reuse from chunk to chunk, because filling new ones with zeros takes a tenth of a run.

    A record made in a workspace is valid until the next one is made.
    """

    def __init__(self) -> None:
        self._arrays: dict[str, Array] = {}

    def array(self, name: str, shape: tuple[int, ...]) -> Array:
        """Return an array: filled with zeros at first, later with its last content.

        Args:
            name: name of the array.
            shape: shape of the array.
        """
        found = self._arrays.get(name)
        if found is None or found.shape != shape:
            found = self._arrays[name] = np.zeros(shape)
        return found


def simulate(
    models: Sequence[mujoco.MjModel],
    start: Array,
    control: Array,
    threads: int,
    workspace: Workspace,
    launch: Launch | None = None,
) -> Record:
    """Run k trials.

    Args:
        models: one model for all trials, or one for each.
        start: qpos of each trial before it settles (k, nq).
        control: control inputs, then the external forces on all bodies (k, N, nu + 6 nbody).
        threads: number of threads.
        workspace: arrays for the record.
        launch: start in motion; None to start from rest.
    """
    trials, steps = control.shape[:2]
    model = models[0]
    batch = Batch(model, trials, min(threads, trials))
    if len(models) > 1:
        batch.set_models(list(models))
    with _no_log_file():
        _settle(batch, models, start, control[:, 0, : model.nu] if launch is None else launch.inputs)
    if launch is not None:
        batch.bind("qvel")[:] = launch.qvel
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
    """Bring all trials to rest; identical trials settle once."""
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
    """Keep MuJoCo from writing its warnings to a file in the working directory; the batch counts them."""
    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(lambda _: None)
    try:
        yield
    finally:
        mujoco.set_mju_user_warning(before)


def _warned(batch: Batch) -> Flags:
    """Find the trials in which MuJoCo has warned, (k,): it reports a simulation that diverges by a warning."""
    return np.asarray(batch.warning.reshape(batch.nsim, -1).any(axis=1))
