"""Executes a task or the plan of a stored run, and writes the run."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from robustopt.config import Config
from robustopt.config.margin import without_margin
from robustopt.errors import ConfigError
from robustopt.evidence import grouped
from robustopt.files import read_bytes, written
from robustopt.runs.origin import unchanged_config, write_origin
from robustopt.runs.plan_run import PLAN, PlanResult, summary, write_run
from robustopt.runs.records import ExecutionsRecord, FailuresRecord, FeedbackRecord, FirstFailure, RunStatus, Summary
from robustopt.runs.store import SUMMARY, require_plan, write_record
from robustopt.runs.stored_plan import read_plan
from robustopt.simulation import Executions, Status, Workers, execute
from robustopt.simulation.monte_carlo import Progress
from robustopt.solvers import Plan

EXECUTIONS = "executions.csv"

FREE_KEYS = ("execution", "seed")
"""Keys that may be changed when a stored plan is executed: no plan depends on them."""


@dataclass(frozen=True)
class ExecutionResult:
    """Executions of a plan, with the summary of planning.

    Attributes:
        known: summary of planning, or of the run that the plan was read from.
        planned: the plan with its certificate if it was made here.
        source: run folder that the plan was read from.
        seconds: computing time of the executions [s].
    """

    config: Config
    plan: Plan
    executions: Executions
    seconds: float
    known: Summary
    planned: PlanResult | None = None
    source: Path | None = None

    @property
    def status(self) -> RunStatus:
        """How the run ended: interrupted if trials are missing, failed if every simulation diverged."""
        if not self.executions.complete:
            return RunStatus.INTERRUPTED
        if set(self.executions.counts) == {Status.DIVERGED}:
            return RunStatus.SIMULATION_FAILED
        return RunStatus.SOLVED if self.known.kind == "execution" else self.known.status


def execute_plan(
    config: Config, planned: PlanResult, speed: float, workers: Workers, progress: Progress | None
) -> ExecutionResult:
    """Execute a plan that has its certificate.

    Args:
        config: the configuration, whose section `execution` may differ from that of the plan.
        planned: the plan and its certificate.
        speed: factor on the speed of the plan.
        workers: the processes or cluster that run the trials.
        progress: function that is called after every chunk of trials.

    Raises:
        ConfigError: the configuration is of another task, or a key of `execution` does not fit the robot.
        SimulationFailed: the plan is not finite, or worker processes died repeatedly.
    """
    start = time.perf_counter()
    executions = execute(planned.plan, config, speed=speed, workers=workers, progress=progress)
    seconds = time.perf_counter() - start
    return ExecutionResult(config, planned.plan, executions, seconds, summary(planned), planned=planned)


def execute_stored(
    folder: Path, overrides: Sequence[str], speed: float, workers: Workers, progress: Progress | None
) -> ExecutionResult:
    """Execute the plan of a stored run.

    Args:
        folder: of the run.
        overrides: `key=value` for keys of `FREE_KEYS`.
        speed: factor on the speed of the plan.
        workers: run the trials.
        progress: called after every chunk of trials.

    Raises:
        RunFolderError: the run has no plan or a rejected one, or is not as it was written.
        ConfigError: the plan depends on an override.
    """
    known = require_plan(folder)
    _require_free(overrides)
    config = unchanged_config(folder, overrides)
    plan = read_plan(config, folder / PLAN)
    start = time.perf_counter()
    executions = execute(plan, config, speed=speed, workers=workers, progress=progress)
    return ExecutionResult(config, plan, executions, time.perf_counter() - start, known, source=folder)


def _require_free(overrides: Sequence[str]) -> None:
    for override in overrides:
        if override.split("=")[0].split(".")[0] not in FREE_KEYS:
            keys = " and ".join(FREE_KEYS)
            raise ConfigError(f"override {override!r}: a stored plan depends on it; expected keys of {keys}")


# Files ----------------------------------------------------------------------------------------------------


def write_execution_run(result: ExecutionResult, folder: Path, arguments: Sequence[str]) -> Summary:
    """Write the data of an execution into a folder and return its summary.

    Args:
        result: the plan and its executions.
        folder: folder of the run.
        arguments: arguments of the command, for the record of its origin.
    """
    if result.planned is not None:
        write_run(result.planned, folder, arguments)
    else:
        assert result.source is not None
        write_origin(folder, result.config, arguments)
        with written(folder / PLAN) as beside:
            beside.write_bytes(read_bytes(result.source / PLAN))
    write_executions_csv(result.executions, folder / EXECUTIONS)
    data = _execution_summary(result)
    write_record(folder / SUMMARY, data)
    return data


def write_executions_csv(executions: Executions, path: Path) -> None:
    """Write one line per trial; every number reads back as the same floating-point number, and nan is left empty.

    Args:
        executions: the trials.
        path: the file.
    """
    with written(path) as beside:
        executions.to_frame().to_csv(beside, index=False, lineterminator="\n")


def _execution_summary(result: ExecutionResult) -> Summary:
    """Return the summary of executions, which extends the summary of their plan."""
    executions, known = result.executions, result.known
    simulated = min(len(executions.outcomes), 1) if executions.alike else len(executions.outcomes)
    own = Summary(
        kind="execution",
        name=known.name,
        status=result.status,
        message=sentence(executions),
        without_margin=without_margin(result.config) or None,
        success_rate=executions.success_rate,
        success_interval=executions.interval,
        executions=_executions_record(executions),
        seconds={**known.seconds, "execute": result.seconds},
        steps_per_second=simulated * executions.steps / result.seconds,
    )
    update = {name: getattr(own, name) for name in own.model_fields_set}
    if result.source is not None:
        update["plan_of"] = str(result.source.absolute())
    return known.model_copy(update=update)


def _executions_record(executions: Executions) -> ExecutionsRecord:
    """Return the part of a summary about executions."""
    first = min((o for o in executions.outcomes if o.what), key=lambda outcome: outcome.time, default=None)
    feedback = executions.feedback
    return ExecutionsRecord(
        trials=len(executions.outcomes),
        requested=executions.requested,
        successes=executions.successes,
        confidence=executions.confidence,
        alike=executions.alike,
        statuses={status.value: count for status, count in executions.counts.items()},
        first_failure=None
        if first is None
        else FirstFailure(trial=first.trial, status=first.status.value, what=first.what, t=first.time, s=first.s),
        failures=tuple(
            FailuresRecord.model_validate(group)
            for group in grouped(outcome.failure for outcome in executions.outcomes if outcome.failure is not None)
        ),
        seed=executions.seed,
        speed=executions.speed,
        duration=executions.duration,
        feedback=None if feedback is None else FeedbackRecord.model_validate(feedback),
    )


def sentence(executions: Executions) -> str:
    """Return the outcome of executions in a few sentences.

    Args:
        executions: the trials.
    """
    done, requested = len(executions.outcomes), executions.requested
    if not done:
        return f"Interrupted before the first of {requested:,} trials was done."
    low, high = (f"{100 * end:.1f}" for end in executions.interval)
    text = f"{executions.successes:,} of {done:,} trials succeeded; "
    if executions.alike:
        text += "nothing is drawn at random in this world, so one simulation stands for all of them."
    else:
        text += f"the success rate is from {low} to {high} % at a confidence of {100 * executions.confidence:g} %."
    others = [f"{count:,} {s.value}" for s, count in executions.counts.items() if s is not Status.SUCCESS]
    if others:
        text += f" Of the others: {', '.join(others)}."
    if not executions.complete:
        text = f"Interrupted after {done:,} of {requested:,} trials. " + text
    return text
