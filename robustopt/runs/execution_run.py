"""Executes a task or the plan of a stored run, and writes the run."""

from __future__ import annotations

import csv
import hashlib
import json
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from robustopt.config import Config
from robustopt.config.load import load_config
from robustopt.errors import ConfigError, RobotError, RunFolderError, SolverFailed
from robustopt.limits import build_problem
from robustopt.robot.model_file import model_file, model_hash
from robustopt.runs.experiment import PLAN, PlanResult, summary, write_run
from robustopt.runs.store import CONFIG, PROVENANCE, SUMMARY, plain_data, read_summary, write_json, write_origin
from robustopt.simulation import Executions, Workers, execute
from robustopt.simulation.outcome import ObjectOutcome, Status, TrialOutcome
from robustopt.solvers import Plan
from robustopt.solvers.plan import solved_plan
from robustopt.solvers.trajectory import Trajectory

EXECUTIONS = "executions.csv"

FREE_KEYS = ("execution", "seed")
"""Keys that may be changed when a stored plan is executed: those that no plan depends on."""

SAME_PATH = 1e-9
"""Joint positions of a stored plan and of its rebuilt path differ by rounding alone, if at all [rad or m]."""

SAME_TIME = 1e-9
"""Times of a stored plan and those of its speeds differ by rounding alone, if at all: part of the duration."""


@dataclass(frozen=True)
class ExecutionResult:
    """Executions of a plan, and what is known of the plan.

    planned: the plan with its certificate, where it was made here; stored: summary of the run that it was read from
    """

    config: Config
    plan: Plan
    executions: Executions
    seconds: float
    planned: PlanResult | None = None
    stored: Mapping[str, Any] | None = None
    source: Path | None = None

    @property
    def diverged(self) -> bool:
        """Whether no simulation came to an end."""
        counts = self.executions.counts
        return bool(counts) and set(counts) == {Status.DIVERGED}

    @property
    def exit_code(self) -> int:
        """0 with all trials done, 130 where some are missing, 5 where every simulation diverged."""
        if not self.executions.complete:
            return 130
        return 5 if self.diverged else 0


def execute_plan(
    config: Config,
    planned: PlanResult,
    speed: float,
    workers: Workers,
    progress: Callable[[int, int, int], None] | None,
) -> ExecutionResult:
    """Execute a plan that has its certificate."""
    start = time.perf_counter()
    executions = execute(config, planned.plan, speed=speed, workers=workers, progress=progress)
    return ExecutionResult(config, planned.plan, executions, time.perf_counter() - start, planned=planned)


def execute_stored(
    folder: Path,
    overrides: Sequence[str],
    speed: float,
    workers: Workers,
    progress: Callable[[int, int, int], None] | None,
) -> ExecutionResult:
    """Execute the plan of a stored run.

    Raises RunFolderError where the run is not as it was written, and ConfigError for an override that the plan
    depends on.
    """
    stored = read_summary(folder)
    if stored.get("duration") is None:
        raise RunFolderError(f"{folder}: the run has no plan ({stored.get('status')}); expected one that was solved")
    _require_unchanged(folder)
    _require_free(overrides)
    config = load_config(folder / CONFIG, [*overrides, *_grid(stored)])
    plan = read_plan(config, folder / PLAN)
    start = time.perf_counter()
    executions = execute(config, plan, speed=speed, workers=workers, progress=progress)
    seconds = time.perf_counter() - start
    return ExecutionResult(config, plan, executions, seconds, stored=stored, source=folder)


def _grid(stored: Mapping[str, Any]) -> list[str]:
    """The number of collocation points as an override: a learner's plan may be on a finer grid than configured."""
    points = (stored.get("size") or {}).get("collocation_points")
    return [f"solver.collocation_points={points}"] if isinstance(points, int) else []


# Stored plans ---------------------------------------------------------------------------------------------


def read_plan(config: Config, path: Path) -> Plan:
    """The plan of a configuration in a file that `write_plan_csv` wrote, number for number.

    sd is stored and x = sd^2; a square root gives back sd exactly. Raises RunFolderError where the file is not a plan
    of the configuration.
    """
    problem = build_problem(config)
    names = problem.robot.joint_names
    head = ["t", "s", "sd", "sdd", *(f"{kind}_{name}" for kind in ("q", "qd", "qdd") for name in names)]
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            rows = list(csv.reader(file))
        found, *lines = rows
        short = next((i for i, line in enumerate(lines, 2) if len(line) != len(found)), None)
        if short is not None:
            raise RunFolderError(
                f"{path}: line {short} is cut short, or has been changed; expected the plan as written"
            )
        numbers = np.array(lines, dtype=float).reshape(-1, len(found))
    except (OSError, ValueError, IndexError) as error:
        raise RunFolderError(f"{path}: cannot be read as a plan: {error}") from None
    if found != head:
        theirs = ", ".join(column.removeprefix("q_") for column in found if column.startswith("q_"))
        raise RunFolderError(f"{path}: a plan of the joints {theirs}; expected one of {', '.join(names)}")
    if not np.isfinite(numbers).all():
        row = int(np.flatnonzero(~np.isfinite(numbers).all(axis=1))[0])
        raise RunFolderError(f"{path}: line {row + 2} has a number that is not finite; expected the plan as written")
    s, sd, q = numbers[:, 1], numbers[:, 2], numbers[:, 4 : 4 + problem.robot.n]
    same_grid = len(s) == len(problem.s) and np.array_equal(s, problem.s)
    if not same_grid or np.abs(problem.path.evaluate(s, problem.piece) - q).max() > SAME_PATH:
        raise RunFolderError(f"{path}: not on the path of the configuration beside it; expected the plan as written")
    plan = solved_plan(problem, sd**2, "stored", {})
    if (sd < 0).any() or not _same_times(plan, numbers[:, 0]):
        raise RunFolderError(f"{path}: its times are not those of its speeds sd; expected the plan as written")
    return plan


def _same_times(plan: Plan, times: np.ndarray) -> bool:
    try:
        expected = Trajectory.from_plan(plan).times
    except SolverFailed:  # it never ends
        return False
    return bool(np.abs(expected - times).max() <= SAME_TIME * expected[-1])


def _require_unchanged(folder: Path) -> None:
    try:
        origin = json.loads((folder / PROVENANCE).read_text(encoding="utf-8"))
        text = (folder / CONFIG).read_bytes()
        expected, robot = origin["config_sha256"], origin["robot_model"]["sha256"]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise RunFolderError(f"{folder / PROVENANCE}: cannot be read: {error}") from None
    if hashlib.sha256(text).hexdigest() != expected:
        raise RunFolderError(
            f"{folder / CONFIG}: was edited after the run; its plan is of another task. Expected the file as it was "
            "written, or a new run of `robustopt plan` with the edited one"
        )
    config = load_config(folder / CONFIG)
    if model_hash(model_file(config)) != robot:
        raise RobotError(
            f"the model file of {config.robot.model}, or one that it names, is not the one that {folder} was planned "
            "with; expected that one, or a new run of `robustopt plan`",
            key="robot.model",
        )


def _require_free(overrides: Sequence[str]) -> None:
    for override in overrides:
        if override.split("=")[0].split(".")[0] not in FREE_KEYS:
            keys = " and ".join(FREE_KEYS)
            raise ConfigError(f"override {override!r}: a stored plan depends on it; expected keys of {keys}")


# What is written ------------------------------------------------------------------------------------------


def write_execution_run(result: ExecutionResult, folder: Path, arguments: Sequence[str]) -> dict[str, Any]:
    """Write the data of an execution into a folder and return its summary."""
    if result.planned is not None:
        write_run(result.planned, folder, arguments)
    else:
        assert result.source is not None
        write_origin(folder, result.config, model_file(result.config), arguments)
        (folder / PLAN).write_bytes((result.source / PLAN).read_bytes())
    write_executions_csv(result.executions.outcomes, folder / EXECUTIONS)
    data = execution_summary(result)
    write_json(folder / SUMMARY, data)
    return data


def execution_summary(result: ExecutionResult) -> dict[str, Any]:
    """What a run says about its executions, after what is known of the plan, as plain data."""
    executions = result.executions
    known = summary(result.planned) if result.planned is not None else dict(result.stored or {})
    status = "solved" if known["kind"] == "execution" else known["status"]
    if result.diverged:
        status = "simulation failed"
    if not executions.complete:
        status = "interrupted"
    low, high = executions.interval
    first = min((o for o in executions.outcomes if o.what), key=lambda outcome: outcome.time, default=None)
    simulated = min(len(executions.outcomes), 1) if executions.alike else len(executions.outcomes)
    data = known | {
        "kind": "execution",
        "status": status,
        "message": sentence(executions),
        "success_rate": executions.success_rate,
        "success_interval": [low, high],
        "executions": {
            "trials": len(executions.outcomes),
            "requested": executions.requested,
            "successes": executions.successes,
            "confidence": executions.confidence,
            "alike": executions.alike,
            "statuses": {status.value: count for status, count in executions.counts.items()},
            "first_failure": None
            if first is None
            else {
                "trial": first.trial,
                "status": first.status.value,
                "what": first.what,
                "t": first.time,
                "s": first.s,
            },
            "seed": executions.seed,
            "speed": executions.speed,
            "duration": executions.duration,
            "feedback": executions.feedback,
        },
        "seconds": {**known.get("seconds", {}), "execute": result.seconds},
        "steps_per_second": simulated * executions.steps / result.seconds,
    }
    if result.source is not None:
        data["plan_of"] = str(result.source.absolute())
    return dict(plain_data(data))


def sentence(executions: Executions) -> str:
    """The outcome of executions in a sentence."""
    done, low_high = len(executions.outcomes), executions.interval
    if not done:
        return f"Interrupted before the first of {executions.requested:,} trials was done."
    others = [
        f"{count:,} {status.value}" for status, count in executions.counts.items() if status is not Status.SUCCESS
    ]
    low, high = (f"{100 * end:.1f}" for end in low_high)
    text = f"{executions.successes:,} of {done:,} trials succeeded; "
    if executions.alike:
        text += "nothing is drawn at random in this world, so one simulation stands for all of them."
    else:
        text += f"the success rate is from {low} to {high} % at a confidence of {100 * executions.confidence:g} %."
    if others:
        text += f" Of the others: {', '.join(others)}."
    if not executions.complete:
        text = f"Interrupted after {done:,} of {executions.requested:,} trials. " + text
    return text


def write_executions_csv(outcomes: Sequence[TrialOutcome], path: Path) -> None:
    """Write one line per trial; every number reads back as the same floating point number, nan is left empty."""
    objects = list(outcomes[0].objects) if outcomes else []
    rubbing = [name for name in objects if name in outcomes[0].friction]
    masses = list(outcomes[0].mass) if outcomes else []
    kinds = ("slip", "tilt", "drop", "lift")
    head = ["trial", "status", "what", "t", "s", "tracking_error", "torque"]
    head += [f"{kind}_{name}" for name in objects for kind in ("status", "t", *kinds)]
    head += [f"friction_{name}" for name in rubbing] + [f"mass_{name}" for name in masses]
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(head)
        for outcome in outcomes:
            row: list[Any] = [outcome.trial, outcome.status.value, outcome.what, outcome.time, outcome.s]
            row += [outcome.tracking_error, outcome.torque]
            for name in objects:
                row += _object_cells(outcome.objects[name], kinds)
            row += [outcome.friction[name] for name in rubbing] + [outcome.mass[name] for name in masses]
            writer.writerow(["" if isinstance(value, float) and np.isnan(value) else value for value in row])


def _object_cells(item: ObjectOutcome, kinds: Sequence[str]) -> list[Any]:
    return [item.status.value, item.time, *(getattr(item, kind) for kind in kinds)]
