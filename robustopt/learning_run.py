"""Run folders of learners: begun before anything is computed, continued after any interruption, completed at the end.

A folder with a journal and no summary is unfinished. The summary is written last, in one step.
"""

from __future__ import annotations

import csv
import hashlib
import json
import os
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from robustopt.beliefs import Planner
from robustopt.campaign import Learned
from robustopt.config import Config, dump, load_config, resolved
from robustopt.errors import RunFolderError
from robustopt.execution.outcome import Status
from robustopt.execution_run import EXECUTIONS
from robustopt.experiment import PlanResult, write_plan
from robustopt.journal import JOURNAL, Journal, is_unfinished
from robustopt.learning_summary import learning_summary, row_record
from robustopt.robot_model import model_file
from robustopt.store import CONFIG, PROVENANCE, SUMMARY, json_text, new_run, write_origin

ITERATIONS = "iterations.csv"

NO_PLAN_EXIT, DIVERGED_EXIT = 3, 5


# Begin and continue ---------------------------------------------------------------------------------------


def begin(config: Config, out: Path | None, arguments: Sequence[str]) -> Path:
    """Make the folder of a new run, with its configuration, provenance and an empty journal; where it is."""
    if out is not None and is_unfinished(out):
        raise RunFolderError(f"{out}: holds an unfinished run; continue it with --resume, or choose another folder")
    with new_run(config.name, out) as run:
        write_origin(run.folder, config, model_file(config), arguments)
        Journal.create(run.folder)
    return run.place


def discard_if_empty(folder: Path) -> None:
    """Remove a run that is unfinished and has nothing in its journal; another one stays as it is."""
    if not is_unfinished(folder):
        return
    try:
        journal = Journal.open(folder)
    except RunFolderError:
        return
    empty = next(journal.entries(), None) is None
    journal.close()
    if empty:
        shutil.rmtree(folder)


def resumed(folder: Path, config: Config | None) -> Config:
    """The configuration of a run that is to be continued: the stored one, which a given one must not differ from.

    Raises RunFolderError where the folder is no run of a learner, or was begun with another configuration or robot.
    """
    if not (folder / JOURNAL).is_file():
        raise RunFolderError(f"{folder}: nothing to resume; expected the folder of a run of `robustopt learn`")
    stored = load_config(folder / CONFIG)
    try:
        origin = json.loads((folder / PROVENANCE).read_text(encoding="utf-8"))
        text, robot = origin["config_sha256"], origin["robot_model"]["sha256"]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise RunFolderError(f"{folder / PROVENANCE}: cannot be read: {error}") from None
    if hashlib.sha256((folder / CONFIG).read_bytes()).hexdigest() != text:
        raise RunFolderError(f"{folder / CONFIG}: was edited after the run began; expected the file as it was written")
    if hashlib.sha256(model_file(stored).read_bytes()).hexdigest() != robot:
        raise RunFolderError(f"{folder}: the model file of {stored.robot.model} has changed since the run began")
    if config is not None and dump(config) != dump(stored):
        changes = "; ".join(differences(resolved(stored), resolved(config)))
        raise RunFolderError(
            f"{folder}: was begun with another configuration: {changes}. Expected the same one, or a new run"
        )
    return stored


def latest_unfinished(name: str, root: Path = Path("results")) -> Path | None:
    """The latest unfinished run of a task below `root`."""
    folders = [place for place in (root / name).glob("*") if is_unfinished(place)]
    return max(folders, key=lambda place: (place / JOURNAL).stat().st_mtime_ns, default=None)


def differences(stored: Any, given: Any, key: str = "") -> list[str]:
    """What differs between two resolved configurations, e.g. "seed was 0 and is 1"."""
    if isinstance(stored, Mapping) and isinstance(given, Mapping):
        names = dict.fromkeys([*stored, *given])
        inner = (differences(stored.get(n), given.get(n), f"{key}.{n}" if key else n) for n in names)
        return [line for lines in inner for line in lines]
    if isinstance(stored, list) and isinstance(given, list) and len(stored) == len(given):
        pairs = enumerate(zip(stored, given, strict=True))
        return [line for i, (old, new) in pairs for line in differences(old, new, f"{key}[{i}]")]
    return [] if stored == given else [f"{key} was {_shown(stored)} and is {_shown(given)}"]


def _shown(value: Any) -> str:
    text = "not given" if value is None else json.dumps(value)
    return text if len(text) <= 80 else f"{text[:77]}..."


# What is written ------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class LearningResult:
    """A run of a learner that is finished, with the best plan, which is made again for its files."""

    learned: Learned
    planned: PlanResult | None
    journal: Journal

    @property
    def exit_code(self) -> int:
        """0 with a plan that succeeded, 5 where every simulation diverged, 3 where no plan succeeded."""
        if self.planned is not None:
            return 0
        statuses = {item.status for entry in self.journal.entries() for _, item in entry.executions}
        return DIVERGED_EXIT if statuses == {Status.DIVERGED.value} else NO_PLAN_EXIT


def result_of(learned: Learned, journal: Journal) -> LearningResult:
    """The result of a learner that is finished."""
    best = learned.best
    planned = Planner(learned.config).plan(best.trial.belief) if best is not None else None
    return LearningResult(learned, planned, journal)


def write_learning_files(result: LearningResult, folder: Path) -> dict[str, Any]:
    """Write all files but the summary, which `complete` writes; the summary's data."""
    if result.planned is not None:
        write_plan(result.planned, folder)
    _write_iterations(result.learned, folder / ITERATIONS)
    _write_executions(result.journal, folder / EXECUTIONS)
    return learning_summary(result.learned, result.planned, result.exit_code == DIVERGED_EXIT)


def complete(folder: Path, data: Mapping[str, Any]) -> None:
    """Write the summary in one step: from here on the run is complete."""
    temporary = folder / f".{SUMMARY}.partial"
    temporary.write_text(json_text(data) + "\n", encoding="utf-8")
    with temporary.open("rb+") as file:
        os.fsync(file.fileno())
    temporary.replace(folder / SUMMARY)


def _write_iterations(learned: Learned, path: Path) -> None:
    """One line per plan; lists are joined by blanks."""
    records = [row_record(learned, row) for row in learned.rows]
    heads = dict.fromkeys(key for record in records for key in record)
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(heads)
        writer.writerows([[_cell(record.get(key)) for key in heads] for record in records])


def _write_executions(journal: Journal, path: Path) -> None:
    """One line per execution; every number reads back as the same floating point number."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["execution", "plan", "speed", "success", "status", "what", "t", "s"])
        for plan, entry in enumerate(journal.entries()):
            for speed, item in entry.executions:
                cells = (item.number, plan, speed, item.success, item.status, item.what, item.t, item.s)
                writer.writerow(map(_cell, cells))


def _cell(value: Any) -> str:
    if value is None:
        return ""
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, Mapping):
        return " ".join(f"{key}={_cell(inner)}" for key, inner in value.items())
    return " ".join(map(_cell, value)) if isinstance(value, (list, tuple)) else str(value)
