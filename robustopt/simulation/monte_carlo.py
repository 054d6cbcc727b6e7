"""Monte Carlo trials in chunks: each chunk runs in C threads, chunks run in this or in several processes.

A chunk is reduced to its outcomes before the next one starts, so memory does not grow with the number of trials.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import mujoco
import numpy as np

from robustopt.arrays import Array
from robustopt.config import Config, ExecutionConfig
from robustopt.errors import ConfigError, SimulationFailed
from robustopt.interruption import held
from robustopt.processes import cores, in_processes
from robustopt.simulation.cluster import on_cluster
from robustopt.simulation.controller import Gains, Reference, controls
from robustopt.simulation.disturbance import CALIBRATION, FORCE, WORLD, calibration, forces, generator
from robustopt.simulation.feedback import with_errors
from robustopt.simulation.outcome import TrialOutcome, diverged, judge
from robustopt.simulation.parameters import Parameters, actual_parameters, varies
from robustopt.simulation.simulation import Launch, Record, Workspace, positions_before, simulate
from robustopt.simulation.world import Layout, World

CHUNK = 25
"""Largest number of trials in one chunk: enough to keep the threads busy."""

CHUNK_STEPS = 200_000
"""Largest number of time steps of all trials in a chunk of several: records take up to about 300 MB."""

DECIMALS = 9
"""Decimals of the positions at the start [m, rad]. Faces that lie exactly on each other leave it to the last bit which
of the two MuJoCo clips against the other, and a trial that begins so differs from processor to processor by up to
millimetres; a nanometre decides the same everywhere.
"""

Progress = Callable[[int, int, int], None]
"""Function that is called with the numbers of trials done, requested, and succeeded."""


@dataclass(frozen=True)
class Job:
    """The data that a worker needs to run any trial.

    Attributes:
        config: the configuration.
        gains: gains of the controllers.
        planned: reference of the controllers.
        seed: seed of all trials.
        standing: reference under which the world settles before a motion that does not begin at rest, one row; None
            for the first row of `planned`.
    """

    config: Config
    gains: Gains
    planned: Reference
    seed: int
    standing: Reference | None = None

    @property
    def execution(self) -> ExecutionConfig:
        """Return the section `execution` of the task."""
        return self.config.execution or ExecutionConfig()

    @cached_property
    def world(self) -> World:
        """Build the world of the task, once in each process."""
        return World(self.config, self.gains, self.execution.timestep)

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in self.__dict__.items() if name != "world"}

    def with_standing(self, standing: Reference) -> Job:
        """Return the job of a motion that begins at a speed; it keeps the world that has been built.

        Args:
            standing: reference under which the world settles, one row.
        """
        return self._with(replace(self, standing=standing))

    def with_torque(self, torque: Array) -> Job:
        """Return the job with a feedforward torque; it keeps the world that has been built.

        Args:
            torque: torque in the middle of each step (N, n) [N m or N].
        """
        return self._with(replace(self, planned=replace(self.planned, torque=torque)))

    def _with(self, job: Job) -> Job:
        job.__dict__["world"] = self.world
        return job

    def parameters(self, trial: int) -> Parameters:
        """Sample the actual parameters of a trial.

        Args:
            trial: number of the trial.
        """
        return actual_parameters(self.world.nominal, self.config, generator(self.seed, trial, WORLD))


@dataclass(frozen=True)
class Prepared:
    """The start of k trials.

    Attributes:
        trials: numbers of the trials.
        parameters: actual parameters of each trial.
        offsets: calibration offsets (k, n) [rad or m].
        layout: layout of their models.
    """

    trials: Sequence[int]
    parameters: Sequence[Parameters]
    offsets: Array
    layout: Layout


def run_trials(job: Job, trials: Sequence[int], threads: int, workspace: Workspace | None = None) -> list[TrialOutcome]:
    """Run trials in one chunk, and return their outcomes.

    Args:
        job: the job.
        trials: numbers of the trials.
        threads: number of threads.
        workspace: arrays to reuse.

    Raises:
        ConfigError: a key of `execution` does not fit the robot, or its values cannot be simulated.
    """
    prepared, record = simulate_trials(job, trials, threads, workspace or Workspace())
    return [outcome_of(job, prepared, record, i) for i in range(len(trials))]


def simulate_trials(job: Job, trials: Sequence[int], threads: int, workspace: Workspace) -> tuple[Prepared, Record]:
    """Simulate trials in one chunk.

    Args:
        job: the job.
        trials: numbers of the trials.
        threads: number of threads.
        workspace: arrays to reuse.

    Returns:
        The start of the trials, and their record.

    Raises:
        ConfigError: a key of `execution` does not fit the robot, or its values cannot be simulated.
    """
    execution, world = job.execution, job.world
    parameters = [job.parameters(k) for k in trials]
    models = [world.model(own) for own in (parameters if varies(execution.truth) else parameters[:1])]
    model, layout = models[0], world.layout(models[0])
    offsets = np.zeros((len(trials), job.planned.q.shape[1]))
    for offset, k in zip(offsets, trials, strict=True):
        random = generator(job.seed, k, CALIBRATION)
        offset[world.driven] = calibration(execution.disturbance, len(world.joint_names), random)
    control = workspace.array("control", (len(trials), len(job.planned.t), model.nu + 6 * model.nbody))
    control[:, :, : model.nu] = controls(model, layout, job.planned, world.driven)
    if offsets.any():
        control[:, :, layout.control] += offsets[:, None, world.driven]
    at = model.nu + 6 * _pushed(world, layout, execution.disturbance.on)
    for inputs, k in zip(control, trials, strict=True):
        random = generator(job.seed, k, FORCE)
        inputs[:, at : at + 3] = forces(execution.disturbance, execution.timestep, len(job.planned.t), random)
    first = job.planned.q[0] if job.standing is None else job.standing.q[0]
    placed = [world.start(layout, first + offset, model.nq) for offset in offsets]
    start = np.round(placed, DECIMALS)
    launch = None if job.standing is None else _launch(job, job.standing, model, layout, offsets)
    record = simulate(models, start, control, threads, workspace, launch)
    return Prepared(trials, parameters, offsets, layout), record


def _launch(job: Job, standing: Reference, model: mujoco.MjModel, layout: Layout, offsets: Array) -> Launch:
    """Return the start of k trials in motion, whose joints have calibration offsets (k, n)."""
    world, qd = job.world, job.planned.qd[0]
    inputs = np.repeat(controls(model, layout, standing, world.driven), len(offsets), axis=0)
    inputs[:, layout.control] += offsets[:, world.driven]
    qvel = [world.start_velocity(layout, standing.q[0] + offset, qd, model) for offset in offsets]
    return Launch(inputs, np.array(qvel))


def _pushed(world: World, layout: Layout, name: str | None) -> int:
    """Return the number of the body on which the random force acts."""
    name = world.pushed if name is None else name
    if name not in layout.bodies:
        known = ", ".join(layout.bodies)
        raise ConfigError(f"nothing is called {name}; expected one of {known}", key="execution.disturbance.on")
    return layout.bodies[name]


def outcome_of(job: Job, prepared: Prepared, record: Record, i: int) -> TrialOutcome:
    """Return the outcome of one trial of a chunk.

    Args:
        job: the job.
        prepared: start of the trials of the chunk.
        record: record of the chunk.
        i: index of the trial in the chunk.
    """
    world, layout, planned, failure = job.world, prepared.layout, job.planned, job.execution.failure
    criteria, trial, parameters = layout.criteria(failure), prepared.trials[i], prepared.parameters[i]
    if record.diverged[i]:
        return diverged(trial, parameters, list(criteria))
    share = np.abs(record.torque[i][:, layout.dofs]) / world.torque_limit
    outcome = judge(
        trial, parameters, failure, planned, layout.motions(planned, record, i), criteria,
        layout.against(), dict(zip(world.joint_names, share.T, strict=True)),
        np.abs(tracking_error(job, prepared, record, i)).max(),
    )  # fmt: skip
    return with_errors(outcome, world.velocities(layout, record, i), planned, job.execution.timestep)


def tracking_error(job: Job, prepared: Prepared, record: Record, i: int) -> Array:
    """Return the distance of the joints with a motor from their reference in a trial, (N, m) [rad or m].

    Args:
        job: the job.
        prepared: start of the trials of the chunk.
        record: record of the chunk.
        i: index of the trial in the chunk.
    """
    driven = job.world.driven
    reached = positions_before(record, i, prepared.layout.joints)
    return np.asarray(reached - job.planned.q[:, driven] - prepared.offsets[i, driven])


# Chunks over processes ------------------------------------------------------------------------------------


def share_cores(workers: int) -> tuple[int, int]:
    """Return the number of processes and the number of threads of each, in total at most as many as there are cores.

    Args:
        workers: largest number of processes.
    """
    processes = max(1, min(workers, cores()))
    return processes, max(1, cores() // processes)


@dataclass(frozen=True)
class Workers:
    """The processes that run the chunks.

    Attributes:
        processes: number of processes of this machine, at most one per core; their threads share the cores.
        scheduler: address of the Dask scheduler of a cluster that runs the chunks instead, or None.
    """

    processes: int = 1
    scheduler: str | None = None


def run_all(
    job: Job, trials: Sequence[int], workers: Workers, progress: Progress | None
) -> tuple[list[TrialOutcome], bool]:
    """Run trials. Ctrl-C keeps the chunks that were done before it.

    If no trial differs from another, one simulation stands for all.

    Args:
        job: the job.
        trials: numbers of the trials.
        workers: the processes or cluster that run them.
        progress: function that is called after every chunk.

    Returns:
        The outcomes in the order of the trials, and whether all trials were run.

    Raises:
        ConfigError: a key of `execution` does not fit the robot, or its values cannot be simulated.
        SimulationFailed: worker processes died repeatedly.
    """
    alike = bool(trials) and not is_random(job.execution)
    results = _here(job, [trials[:1]], 1) if alike else _chunk_outcomes(job, trials, workers)
    outcomes: list[TrialOutcome] = []
    try:
        for chunk in results:
            outcomes += [replace(chunk[0], trial=k) for k in trials] if alike else chunk
            if progress is not None:
                progress(len(outcomes), len(trials), sum(outcome.success for outcome in outcomes))
    except KeyboardInterrupt:
        results.close()
        return outcomes, False
    return outcomes, True


def _chunk_outcomes(job: Job, trials: Sequence[int], workers: Workers) -> Generator[list[TrialOutcome], None, None]:
    """Yield the outcomes of trials chunk by chunk, in their order."""
    processes, threads = share_cores(workers.processes)
    size = max(1, min(CHUNK, CHUNK_STEPS // len(job.planned.t)))
    chunks = [trials[i : i + size] for i in range(0, len(trials), size)]
    if workers.scheduler is not None:
        return on_cluster(run_trials, [(job, chunk, 1) for chunk in chunks], workers.scheduler)
    if processes > 1:
        tasks = [(job, chunk, threads) for chunk in chunks]
        return in_processes(run_trials, tasks, processes, SimulationFailed)
    return _here(job, chunks, threads)


def is_random(execution: ExecutionConfig) -> bool:
    """Check whether trials differ, because a force, a calibration offset or a parameter of the world is random.

    Args:
        execution: the section `execution`.
    """
    random = execution.disturbance
    return varies(execution.truth) or any(random.force_deviation) or bool(np.any(random.calibration_deviation))


def _here(job: Job, chunks: Sequence[Sequence[int]], threads: int) -> Generator[list[TrialOutcome], None, None]:
    workspace = Workspace()
    for chunk in chunks:
        with held():  # libraries turn an interruption into errors of their own
            outcomes = run_trials(job, chunk, threads, workspace)
        yield outcomes
