"""Monte Carlo trials in chunks: each chunk runs in C threads, chunks run in this or in several processes.

A chunk is reduced to its outcomes before the next one starts, so memory does not grow with the number of trials.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from robustopt.config import Config, ExecutionConfig
from robustopt.errors import ConfigError, SimulationFailed
from robustopt.processes import AHEAD, cores, in_order, in_processes
from robustopt.simulation.controller import Gains, JointLayout, Reference
from robustopt.simulation.disturbance import CALIBRATION, FORCE, WORLD, calibration, forces, generator
from robustopt.simulation.feedback import with_errors
from robustopt.simulation.outcome import TrialOutcome, diverged, judge
from robustopt.simulation.scenes import Scene, scene_of
from robustopt.simulation.simulation import Record, Workspace, joint_positions, simulate
from robustopt.simulation.truth import World, true_world, varies

Array = np.ndarray

CHUNK = 25
"""Most trials in one batch: enough to keep the threads busy."""

CHUNK_STEPS = 200_000
"""Most time steps of all trials of a batch of several: few enough for some 300 MB of records."""

CONNECT = 10
"""How long a Dask scheduler and its workers are waited for [s]."""


@dataclass(frozen=True)
class Job:
    """All that a worker needs to run any trial."""

    config: Config
    execution: ExecutionConfig
    gains: Gains
    planned: Reference
    seed: int

    @cached_property
    def scene(self) -> Scene[Any]:
        """The world of the configuration, built once in each process."""
        return scene_of(self.config, self.gains, self.execution.timestep)

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in self.__dict__.items() if name != "scene"}


def run_trials(job: Job, trials: Sequence[int], threads: int, workspace: Workspace | None = None) -> list[TrialOutcome]:
    """Run trials by their numbers, all in one chunk."""
    prepared, record = simulate_trials(job, trials, threads, workspace or Workspace())
    return [outcome_of(job, prepared, record, i) for i in range(len(trials))]


@dataclass(frozen=True)
class Prepared:
    """What trials start from: their worlds, offsets of the coordinates (k, n), and where things are in the arrays."""

    trials: Sequence[int]
    worlds: Sequence[World]
    offsets: Array
    layout: JointLayout
    scene: Scene[Any]


def simulate_trials(job: Job, trials: Sequence[int], threads: int, workspace: Workspace) -> tuple[Prepared, Record]:
    """Simulate trials by their numbers."""
    execution, planned = job.execution, job.planned
    scene = job.scene
    worlds = [true_world(scene.believed, execution.truth, generator(job.seed, k, WORLD)) for k in trials]
    models = [scene.model(world) for world in (worlds if varies(execution.truth) else worlds[:1])]
    model, layout = models[0], scene.layout(models[0])
    disturbance, driven = execution.disturbance, scene.driven
    offsets = np.zeros((len(trials), planned.q.shape[1]))
    for offset, k in zip(offsets, trials, strict=True):
        offset[driven] = calibration(disturbance, len(scene.joint_names), generator(job.seed, k, CALIBRATION))
    control = workspace.array("control", (len(trials), len(planned.t), model.nu + 6 * model.nbody))
    control[:, :, : model.nu] = scene.controls(model, layout, planned)
    if offsets.any():
        control[:, :, layout.control] += offsets[:, None, driven]
    at = model.nu + 6 * _pushed(scene, layout, disturbance.on)
    for i, k in enumerate(trials):
        random = generator(job.seed, k, FORCE)
        control[i, :, at : at + 3] = forces(disturbance, execution.timestep, len(planned.t), random)
    start = np.array([scene.start(layout, planned.q[0] + offset, model.nq) for offset in offsets])
    record = simulate(models, start, control, threads, workspace)
    return Prepared(trials, worlds, offsets, layout, scene), record


def _pushed(scene: Scene[Any], layout: JointLayout, name: str | None) -> int:
    """Number of the body that the random force acts on."""
    name = scene.pushed if name is None else name
    if name not in layout.bodies:
        known = ", ".join(layout.bodies)
        raise ConfigError(f"nothing is called {name}; expected one of {known}", key="execution.disturbance.on")
    return layout.bodies[name]


def outcome_of(job: Job, prepared: Prepared, record: Record, i: int) -> TrialOutcome:
    """The outcome of the trial with index i of a chunk."""
    scene, layout, planned, failure = prepared.scene, prepared.layout, job.planned, job.execution.failure
    criteria, trial, world = scene.criteria(failure), prepared.trials[i], prepared.worlds[i]
    if record.diverged[i]:
        return diverged(trial, world, list(criteria))
    outcome = judge(
        trial, world, failure, planned, scene.motions(layout, planned, record, i), criteria, scene.joint_names,
        scene.torque_limit, np.abs(tracking_error(job, prepared, record, i)).max(), record.torque[i][:, layout.dofs],
    )  # fmt: skip
    return with_errors(outcome, scene.velocities(layout, record, i), planned, job.execution.timestep)


def tracking_error(job: Job, prepared: Prepared, record: Record, i: int) -> Array:
    """Positions of the joints with a motor less their reference in a trial, (N, m)."""
    driven = prepared.scene.driven
    reached = joint_positions(record, prepared.layout.joints, i)
    return np.asarray(reached - job.planned.q[:, driven] - prepared.offsets[i, driven])


# Chunks over processes ------------------------------------------------------------------------------------


def share_cores(workers: int) -> tuple[int, int]:
    """Processes and threads of each, together never more than there are cores."""
    processes = max(1, min(workers, cores()))
    return processes, max(1, cores() // processes)


@dataclass(frozen=True)
class Workers:
    """Who runs the chunks: processes of this machine, whose threads share the cores, or a Dask cluster.

    processes: at most as many as there are cores; scheduler: address of a Dask scheduler, or None
    """

    processes: int = 1
    scheduler: str | None = None


def run_all(
    job: Job, trials: Sequence[int], workers: Workers, progress: Callable[[int, int, int], None] | None
) -> tuple[list[TrialOutcome], bool]:
    """Outcomes of the trials in their order, and whether all were run; Ctrl-C keeps what was done before it.

    Where nothing is drawn at random one trial is simulated, and stands for all.
    """
    if trials and not is_random(job.execution):
        return _all_alike(job, trials, progress)
    processes, threads = share_cores(workers.processes)
    size = max(1, min(CHUNK, CHUNK_STEPS // len(job.planned.t)))
    chunks = [trials[i : i + size] for i in range(0, len(trials), size)]
    outcomes: list[TrialOutcome] = []
    if workers.scheduler is not None:
        results = _on_cluster(job, chunks, workers.scheduler)
    elif processes > 1:
        tasks = [(job, chunk, threads) for chunk in chunks]
        results = in_processes(run_trials, tasks, processes, SimulationFailed)
    else:
        results = _here(job, chunks, threads)
    try:
        for chunk in results:
            outcomes += chunk
            if progress is not None:
                progress(len(outcomes), len(trials), sum(outcome.success for outcome in outcomes))
    except KeyboardInterrupt:
        results.close()
        return outcomes, False
    return outcomes, True


def is_random(execution: ExecutionConfig) -> bool:
    """Whether trials differ: whether a force, an offset of a joint or a part of the world is drawn at random."""
    drawn = execution.disturbance
    return varies(execution.truth) or any(drawn.force_deviation) or bool(np.any(drawn.calibration_deviation))


def _all_alike(
    job: Job, trials: Sequence[int], progress: Callable[[int, int, int], None] | None
) -> tuple[list[TrialOutcome], bool]:
    outcomes: list[TrialOutcome] = []
    try:
        (first,) = run_trials(job, trials[:1], 1)
        outcomes = [replace(first, trial=k) for k in trials]
        if progress is not None:
            progress(len(trials), len(trials), len(trials) * first.success)
    except KeyboardInterrupt:
        return outcomes, False
    return outcomes, True


def _here(job: Job, chunks: Sequence[Sequence[int]], threads: int) -> Generator[list[TrialOutcome], None, None]:
    workspace = Workspace()
    for chunk in chunks:
        yield run_trials(job, chunk, threads, workspace)


def _on_cluster(job: Job, chunks: Sequence[Sequence[int]], scheduler: str) -> Generator[list[TrialOutcome], None, None]:
    """Chunks in their order, run by a Dask cluster, one thread each; Dask gives those of a lost worker to another."""
    try:
        from distributed import Client, KilledWorker
    except ImportError:
        raise ConfigError("a Dask cluster needs the package `distributed`: pip install 'robustopt[dask]'") from None
    try:
        client = Client(scheduler, timeout=CONNECT)
    except (OSError, ValueError) as error:
        raise SimulationFailed(f"The Dask scheduler {scheduler} cannot be reached: {error}") from None
    with client:
        try:
            client.wait_for_workers(1, timeout=CONNECT)
        except TimeoutError:
            raise SimulationFailed(f"The Dask scheduler {scheduler} has no workers; expected at least one") from None
        ahead = AHEAD * sum(client.nthreads().values())
        try:
            yield from in_order(
                lambda chunk: client.submit(run_trials, job, chunk, 1, pure=False).result, chunks, ahead
            )
        except KilledWorker as error:
            raise SimulationFailed(f"Workers of the Dask cluster died again and again: {error}") from error
