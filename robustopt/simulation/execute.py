"""Execution of a plan in simulation, many times, and the summary of the trials."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from robustopt.arrays import Array
from robustopt.confidence import clopper_pearson
from robustopt.config import Config, ExecutionConfig
from robustopt.errors import ConfigError, SimulationFailed
from robustopt.simulation.controller import WITH_TORQUE, Reference, computed_torque, reference, run_up, standing
from robustopt.simulation.feedback import Feedback, feedback_of
from robustopt.simulation.gains import gains_of, require_stable
from robustopt.simulation.monte_carlo import Job, Progress, Workers, is_random, run_all
from robustopt.simulation.outcome import Status, TrialOutcome
from robustopt.solvers import Plan
from robustopt.solvers.contact_forces import planned_forces
from robustopt.solvers.plan import controls_of
from robustopt.solvers.same_task import require_same_task
from robustopt.solvers.trajectory import Trajectory
from robustopt.views import view

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from pandas import DataFrame

MOST_STEPS = 1_000_000
"""Largest number of time steps of a trial; twice as many would take some 4 GB of memory (our choice)."""

LONGEST_STEP = 0.1
"""Longest time step as a fraction of the motion; a longer one is treated as a mistake (our choice)."""

CHECKED = 10
"""Interval of grid points at which the stability of the controller is checked: inertia changes slowly along a path."""


@dataclass(frozen=True)
class Executions:
    """Trials of a plan.

    Attributes:
        outcomes: outcome of each trial, in the order of the trials.
        requested: number of trials that were requested; larger than their number if the execution was interrupted.
        seed: seed of all trials.
        speed: factor on the speed of the plan.
        duration: duration of the motion at this speed [s].
        timestep: time step [s].
        steps: number of time steps of a trial.
        confidence: confidence level of `interval`.
        feedback: acceleration error over all trials, None without a sample.
        alike: whether nothing is random, so that one simulation stands for all trials.
        interrupted: whether Ctrl-C ended the execution, even if all trials were done by then.
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
        """Check whether all trials asked for were run."""
        return len(self.outcomes) == self.requested

    @property
    def successes(self) -> int:
        """Count the trials that succeeded."""
        return sum(outcome.success for outcome in self.outcomes)

    @property
    def success_rate(self) -> float:
        """Return the share of the trials that succeeded; a diverged simulation is no success. nan without a trial."""
        return self.successes / len(self.outcomes) if self.outcomes else float("nan")

    @property
    def interval(self) -> tuple[float, float]:
        """Return the Clopper-Pearson interval of the success probability at the level `confidence`."""
        return clopper_pearson(self.successes, len(self.outcomes), self.confidence)

    @property
    def counts(self) -> Mapping[Status, int]:
        """Count the trials of each status that occurred."""
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
    plan: Plan,
    config: Config | None = None,
    trials: int | None = None,
    seed: int | None = None,
    speed: float = 1.0,
    *,
    numbers: Sequence[int] | None = None,
    workers: Workers | int = 1,
    progress: Progress | None = None,
) -> Executions:
    """Execute a plan in the simulated world of `execution.truth`.

    Trial k depends on the seed and on k alone, not on the number of trials, their order or the number of workers.

    Args:
        plan: the plan.
        config: configuration in place of that of the plan. Its section `execution`, nominal values, intervals and
            solver may differ; robot, path and scene must be the same.
        trials: number of trials, in place of `execution.trials`.
        seed: seed, in place of the one in the configuration.
        speed: factor on the speed of the plan.
        numbers: numbers of the trials to run, in place of the first `trials`.
        workers: number of worker processes, or the processes or cluster that run the trials.
        progress: function that is called after every chunk with the numbers of trials done, requested, and succeeded.

    Returns:
        The trials and their summary.

    Raises:
        Infeasible: the plan has no timing.
        ConfigError: the configuration is of another task, a key of `execution` does not fit the robot, or a controller
            is unstable.
        SimulationFailed: the plan is not finite, or worker processes died repeatedly.
    """
    job = prepare(plan, config, seed, speed)
    execution, planned = job.execution, job.planned
    chosen = tuple(range(execution.trials if trials is None else trials)) if numbers is None else tuple(numbers)
    outcomes, finished = run_all(job, chosen, Workers(workers) if isinstance(workers, int) else workers, progress)
    return Executions(
        tuple(outcomes), len(chosen), job.seed, speed, plan.duration / speed, execution.timestep, len(planned.t),
        execution.confidence, feedback_of(outcomes), alike=not is_random(execution), interrupted=not finished,
    )  # fmt: skip


def prepare(plan: Plan, config: Config | None = None, seed: int | None = None, speed: float = 1.0) -> Job:
    """Prepare the trials of a plan.

    Args:
        plan: the plan.
        config: configuration with another section `execution`, in place of the configuration of the plan.
        seed: seed, in place of the one in the configuration.
        speed: factor on the speed of the plan.

    Raises:
        Infeasible: the plan has no timing.
        ConfigError: the configuration is of another task, a key of `execution` does not fit the robot, or a controller
            is unstable.
        SimulationFailed: the plan is not finite.
    """
    config = plan.problem.config if config is None else config
    require_same_task(config, plan)
    execution = config.execution or ExecutionConfig()
    config = config.model_copy(update={"execution": execution})
    trajectory = Trajectory.from_plan(plan, speed)
    _require_standing(plan)
    _require_usable(trajectory, execution)
    path = trajectory.at_gridpoints().q
    gains = gains_of(config, plan.problem.robot, path)
    planned = reference(trajectory, execution.timestep, execution.hold)
    job = Job(config, gains, planned, config.seed if seed is None else seed)
    world = job.world
    model = world.model(world.nominal)
    require_stable(model, world.layout(model), gains, world.joint_names, path[::CHECKED, world.driven])
    if "start" in trajectory.path.moving_ends:
        job = job.with_standing(_standing(job, trajectory))
    return job.with_torque(_torque(job, plan, speed)) if gains.inputs == WITH_TORQUE else job


def _standing(job: Job, trajectory: Trajectory) -> Reference:
    """Return the reference under which the world settles before a motion that begins at a speed, one row.

    Without feedforward of the torque, the robot lags behind its reference, because the controller must supply the
    torque. The position is behind the first one by the lag of a steady motion up to the start.
    """
    moving, rigid = run_up(trajectory), job.world.rigid()
    still = standing(moving)
    torque = computed_torque(rigid, still)
    if job.gains.inputs == WITH_TORQUE:
        return replace(still, torque=torque)
    change, kp = computed_torque(rigid, moving) - torque, job.gains.kp
    lag = np.zeros_like(still.q)
    np.divide(change[:, job.world.driven], kp, out=lag[:, job.world.driven], where=kp > 0.0)
    return replace(still, q=still.q - lag)


def _torque(job: Job, plan: Plan, speed: float) -> Array:
    """Return the torque of the planned motion at the middle of each step, (N, n) [N m or N].

    The contacts of a walking robot share its load, so its torque follows from the planned contact forces.
    """
    planned = job.planned
    if job.world.robot.contacts:
        return planned_forces(faster(plan, speed)).sample(planned.t + job.execution.timestep / 2)[0]
    return computed_torque(job.world.rigid(), planned)


def faster(plan: Plan, speed: float) -> Plan:
    """Return the plan at `speed` times its speed; x and u grow with the square of `speed`.

    They are computed from sd, which a stored plan has digit for digit.

    Args:
        plan: the plan.
        speed: factor on its speed.
    """
    x = (speed * np.sqrt(np.maximum(plan.x, 0.0))) ** 2
    u = controls_of(plan.problem.ds, x) if plan.steady else speed**2 * plan.u
    return replace(plan, x=x, u=u, change=speed**2 * plan.change, duration=plan.duration / speed)


def _require_standing(plan: Plan) -> None:
    """Check that a walking robot begins and ends at rest: balance is lost if it starts in the middle of a step."""
    if plan.problem.robot.base and plan.problem.path.moving_ends:
        raise ConfigError(
            "the rest of the plan of a walking robot cannot be executed; expected a plan that begins and ends at rest",
            key="path",
        )


def _require_usable(trajectory: Trajectory, execution: ExecutionConfig) -> None:
    """Check that the trajectory is finite, and that a trial has neither too few steps nor too many."""
    for name in ("s", "sd", "times"):
        wrong = np.flatnonzero(~np.isfinite(getattr(trajectory, name)))
        if wrong.size:
            raise SimulationFailed(f"The plan cannot be executed: it is not a finite number at grid point {wrong[0]}.")
    if execution.timestep > LONGEST_STEP * trajectory.duration:
        raise ConfigError(
            f"found {execution.timestep:g} s; expected less than a tenth of the motion, which takes "
            f"{trajectory.duration:.3g} s",
            key="execution.timestep",
        )
    time = trajectory.duration + sum(execution.hold)
    periods = {"timestep": execution.timestep, "disturbance.hold": execution.disturbance.hold}
    for key, period in periods.items():
        if time > MOST_STEPS * period:
            raise ConfigError(
                f"found {period:g} s, so a trial of {time:.4g} s has {time / period:,.0f} of them; expected at most "
                f"{MOST_STEPS:,}",
                key=f"execution.{key}",
            )
