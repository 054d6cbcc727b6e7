"""Executes a plan many times and sums up what came of it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from robustopt.confidence import clopper_pearson
from robustopt.config import Config, ExecutionConfig
from robustopt.errors import ConfigError, SimulationFailed
from robustopt.simulation.controller import Reference, gains_of, reference, require_stable
from robustopt.simulation.feedback import Feedback, feedback_of
from robustopt.simulation.monte_carlo import Job, Workers, is_random, run_all
from robustopt.simulation.outcome import Status, TrialOutcome
from robustopt.solvers import Plan
from robustopt.solvers.contact_forces import planned_forces
from robustopt.solvers.plan import controls_of
from robustopt.solvers.trajectory import Trajectory
from robustopt.views import view

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from pandas import DataFrame

MOST_STEPS = 1_000_000
"""Time steps of a trial; twice as many would take some 4 GB of memory (our choice)."""

LONGEST_STEP = 0.1
"""Time steps longer than this part of the trajectory are taken for a mistake (our choice)."""


CHECKED = 10
"""The controller's stability is checked at every so many grid points: inertia changes slowly along a path."""


@dataclass(frozen=True)
class Executions:
    """Trials of a plan.

    outcomes: one per trial, in their order; requested: number of trials asked for, more than there are where the
    execution was interrupted; duration: of the motion at this speed [s]; timestep [s] and number of steps of a trial;
    confidence: level of `interval`; feedback: acceleration error, None without a sound trial; alike: whether nothing is
    drawn at random, so that one simulation stands for all trials; interrupted: by Ctrl-C, even where all trials were
    done by then
    """

    outcomes: tuple[TrialOutcome, ...]
    requested: int
    seed: int
    speed: float
    duration: float
    timestep: float
    steps: int
    confidence: float
    feedback: Feedback | None
    alike: bool = False
    interrupted: bool = False

    @property
    def complete(self) -> bool:
        return len(self.outcomes) == self.requested

    @property
    def successes(self) -> int:
        return sum(outcome.success for outcome in self.outcomes)

    @property
    def success_rate(self) -> float:
        """Share of the trials that succeeded; a diverged simulation is no success. nan without a trial."""
        return self.successes / len(self.outcomes) if self.outcomes else float("nan")

    @property
    def interval(self) -> tuple[float, float]:
        """Clopper-Pearson interval of the success probability at the level `confidence`."""
        return clopper_pearson(self.successes, len(self.outcomes), self.confidence)

    @property
    def counts(self) -> Mapping[Status, int]:
        """Number of trials of each status that occurred."""
        found = [outcome.status for outcome in self.outcomes]
        return {status: found.count(status) for status in Status if status in found}

    def to_frame(self) -> DataFrame:
        """Return the trials as a table, one row each, with the columns of `executions.csv`."""
        return view("robustopt.frames.executions_frame", self)

    def plot(self) -> Figure:
        """Return a figure of the share of trials that ended in each status."""
        return view("robustopt.plotting.views.executions_figure", self)

    def _repr_html_(self) -> str:
        return view("robustopt.frames.executions_html", self)


def execute(
    config: Config,
    plan: Plan,
    trials: int | None = None,
    seed: int | None = None,
    speed: float = 1.0,
    *,
    numbers: Sequence[int] | None = None,
    workers: Workers | int = 1,
    progress: Callable[[int, int, int], None] | None = None,
) -> Executions:
    """Run a plan in simulation against the world of `execution.truth`.

    Trial k depends on the seed and on k alone: not on how many trials there are, in which order, nor by how many
    workers they are run.

    Args:
        config: the task; its `execution` section says what the world is like (all defaults where it has none).
        plan: a plan of the task; what the planner believed of friction, masses and errors may differ.
        trials: number of trials, instead of `execution.trials`.
        seed: instead of that of the configuration.
        speed: the plan is run this many times as fast.
        numbers: which trials to run, instead of the first `trials`.
        workers: number of processes, or where they are.
        progress: called with the trials done, those asked for and the successes, after every chunk.

    Raises:
        Infeasible: the plan is empty.
        ConfigError: the plan is of another task, or a key of `execution` does not fit the robot.
        SimulationFailed: the plan is not finite, or worker processes died again and again.
    """
    job = prepare(config, plan, seed, speed)
    execution, planned = job.execution, job.planned
    chosen = tuple(range(execution.trials if trials is None else trials)) if numbers is None else tuple(numbers)
    outcomes, finished = run_all(job, chosen, Workers(workers) if isinstance(workers, int) else workers, progress)
    return Executions(
        tuple(outcomes), len(chosen), job.seed, speed, plan.duration / speed, execution.timestep, len(planned.t),
        execution.confidence, feedback_of(outcomes), alike=not is_random(execution), interrupted=not finished,
    )  # fmt: skip


def prepare(config: Config, plan: Plan, seed: int | None = None, speed: float = 1.0) -> Job:
    """What any trial of a plan needs; arguments and errors as of `execute`."""
    _require_same_task(config, plan)
    execution = config.execution or ExecutionConfig()
    config = config.model_copy(update={"execution": execution})
    trajectory = Trajectory.from_plan(plan, speed)
    _require_usable(trajectory, execution)
    path = trajectory.at_gridpoints().q
    gains = gains_of(config, plan.problem.robot, path)
    planned = reference(trajectory, execution.timestep, execution.hold)
    if config.walks:
        planned = _with_torque(planned, plan, speed, execution.timestep)
    job = Job(config, execution, gains, planned, config.seed if seed is None else seed)
    model = job.scene.model(job.scene.believed)
    layout, checked = job.scene.layout(model), path[::CHECKED, job.scene.driven]
    require_stable(model, layout, gains, job.scene.joint_names, checked)
    return job


def faster(plan: Plan, speed: float) -> Plan:
    """The plan run `speed` times as fast: x and u grow with its square.

    They are made from sd, which a stored plan has number for number.
    """
    x = (speed * np.sqrt(np.maximum(plan.x, 0.0))) ** 2
    return replace(plan, x=x, u=controls_of(plan.problem.ds, x), duration=plan.duration / speed)


def _with_torque(planned: Reference, plan: Plan, speed: float, timestep: float) -> Reference:
    """The reference of a robot on its feet with the torque of its plan and of the planned contact forces."""
    torque, _ = planned_forces(faster(plan, speed)).sample(planned.t + timestep / 2)
    return replace(planned, torque=torque)


def _require_same_task(config: Config, plan: Plan) -> None:
    """The plan must be of the same robot, tray, objects and path; what was believed of them may differ."""
    theirs = plan.problem.config
    if config is theirs:
        return
    same = {
        "robot": config.robot == theirs.robot,
        "tray": _tray(config) == _tray(theirs),
        "path": config.path == theirs.path,
        "gravity": config.gravity == theirs.gravity,
        "objects": _places(config) == _places(theirs),
    }
    other = [key for key, equal in same.items() if not equal]
    if other:
        keys = ", ".join(other)
        raise ConfigError(
            f"the plan is of another task, {theirs.name}: {keys} differ{'s' if len(other) == 1 else ''}; "
            "expected a plan of this configuration",
            key=other[0],
        )


def _tray(config: Config) -> tuple[object, ...]:
    """Shape and place of the tray, if there is one."""
    return () if config.tray is None else (config.tray.size, config.tray.pose)


def _places(config: Config) -> list[tuple[object, ...]]:
    """Shapes and places of the objects."""
    keys = ("shape", "size", "radius", "height", "on", "at", "yaw")
    return [(name, *(getattr(body, key) for key in keys)) for name, body in config.objects.items()]


def _require_usable(trajectory: Trajectory, execution: ExecutionConfig) -> None:
    for name in ("s", "sd", "times"):
        wrong = np.flatnonzero(~np.isfinite(getattr(trajectory, name)))
        if wrong.size:
            raise SimulationFailed(f"The plan cannot be run: it is not a finite number at grid point {wrong[0]}.")
    if execution.timestep > LONGEST_STEP * trajectory.duration:
        raise ConfigError(
            f"found {execution.timestep:g} s; expected less than a tenth of the motion, which takes "
            f"{trajectory.duration:.3g} s",
            key="execution.timestep",
        )
    steps = (trajectory.duration + sum(execution.hold)) / execution.timestep
    if steps > MOST_STEPS:
        raise ConfigError(
            f"found {execution.timestep:g} s, with which the motion of {trajectory.duration:.0f} s takes {steps:,.0f} "
            f"steps; expected at most {MOST_STEPS:,} steps",
            key="execution.timestep",
        )
