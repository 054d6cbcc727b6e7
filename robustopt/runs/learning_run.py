"""Run folders of learners: begun before anything is computed, continued after any interruption, completed at the end.

A folder with a journal and no summary is unfinished. The summary is written last, in one step; all other files are
written anew by every attempt to complete the run.
"""

from __future__ import annotations

import csv
import shutil
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from robustopt.config import Config
from robustopt.config.load import dump
from robustopt.errors import RunFolderError
from robustopt.evidence import Failure
from robustopt.files import links_in, read_text, reason, written
from robustopt.learning.outcomes import Executed
from robustopt.runs.beliefs import Planner
from robustopt.runs.campaign import Learned, made_again
from robustopt.runs.execution_run import EXECUTIONS
from robustopt.runs.journal import Journal
from robustopt.runs.learning_summary import learning_summary, row_columns
from robustopt.runs.manual import NEXT
from robustopt.runs.origin import require_same_config, unchanged_config, write_origin
from robustopt.runs.plan_run import FIGURES, PlanResult
from robustopt.runs.records import Summary
from robustopt.runs.store import (
    CONFIG,
    JOURNAL,
    PROVENANCE,
    SUMMARY,
    flush,
    flush_folder,
    is_unfinished,
    new_run,
    record_text,
)
from robustopt.simulation import Status

ITERATIONS = "iterations.csv"

# Begin and continue ---------------------------------------------------------------------------------------


def begin(config: Config, out: Path | None, arguments: Sequence[str], executor: str) -> Path:
    """Make the folder of a new run, with its configuration, provenance and an empty journal.

    Args:
        config: the task.
        out: the folder; None for a new one below `results`.
        arguments: of the command line.
        executor: of the plans, as in the journal.

    Returns:
        The folder.

    Raises:
        RunFolderError: the folder holds a run, or cannot be written.
    """
    if out is not None and is_unfinished(out):
        raise RunFolderError(f"{out}: holds an unfinished run; continue it with --resume, or choose another folder")
    with new_run(config.name, out) as run:
        write_origin(run.folder, config, arguments)
        Journal.create(run.folder, executor)
    return run.place


def discard_if_empty(folder: Path, parents: int = 0) -> None:
    """Remove a run that is unfinished and has nothing in its journal; keep any other.

    Args:
        folder: of the run.
        parents: number of folders above it that are removed as well if they are empty.
    """
    if not is_unfinished(folder):
        return
    try:
        journal = Journal.open(folder)
        empty = next(journal.entries(), None) is None
        journal.close()
    except RunFolderError:
        return
    if not empty:
        return
    shutil.rmtree(folder)
    with suppress(OSError):  # not empty
        for parent in list(folder.parents)[:parents]:
            parent.rmdir()


def resumed(folder: Path, config: Config | None) -> Config:
    """Return the configuration of a run that is to be continued.

    Args:
        folder: of the run.
        config: must be that of the run; None for the stored one.

    Raises:
        RunFolderError: the folder is no run of a learner, has links in it, or was begun with another configuration,
            robot or waypoints.
    """
    if not (folder / JOURNAL).is_file():
        raise RunFolderError(f"{folder}: nothing to resume; expected the folder of a run of `robustopt learn`")
    if links := links_in(folder):
        raise RunFolderError(f"{links[0]}: is a link; expected the files and folders of the run themselves")
    stored = unchanged_config(folder)
    if config is not None:
        require_same_config(folder, stored, config)
    return stored


def latest_unfinished(config: Config) -> Path | None:
    """Return the latest unfinished run of a task, preferably one of the same configuration; None without one.

    Args:
        config: the configuration.
    """
    folders = [place for place in Path("results", config.name).glob("*") if is_unfinished(place)]
    text = dump(config)
    same = [place for place in folders if _text(place / CONFIG) == text]
    return max(same or folders, key=lambda place: (place / JOURNAL).stat().st_mtime_ns, default=None)


def _text(path: Path) -> str | None:
    try:
        return read_text(path)
    except OSError:
        return None


# Complete -------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class LearningResult:
    """Run of a learner that is finished, with the best plan, which is made again for its files."""

    learned: Learned
    planned: PlanResult | None
    journal: Journal


def result_of(learned: Learned, journal: Journal) -> LearningResult:
    """Return the result of a learner that is finished.

    Args:
        learned: the learned intervals.
        journal: the journal of the run.

    Raises:
        RunFolderError: the best plan cannot be made again.
    """
    best = learned.best
    planned = made_again(Planner(learned.config), best.trial) if best is not None else None
    return LearningResult(learned, planned, journal)


@contextmanager
def writing(folder: Path) -> Iterator[None]:
    """Turn an OSError into a RunFolderError; the journal has all that was learned, so that the run can be continued.

    Args:
        folder: folder of the run.

    Raises:
        RunFolderError: a file cannot be written.
    """
    try:
        yield
    except OSError as error:
        message = f"{folder}: the run could not be completed: {reason(error)}; it can be continued by --resume"
        raise RunFolderError(message) from error


def write_learning_files(result: LearningResult, folder: Path) -> Summary:
    """Write all files but figures and summary, in place of those of an earlier attempt, and return the summary.

    Args:
        result: the result of the learner.
        folder: folder of the run.
    """
    shutil.rmtree(folder / FIGURES, ignore_errors=True)
    (folder / NEXT).unlink(missing_ok=True)
    if result.planned is not None:
        result.planned.plan.export(folder, result.planned.config.output.period)
    _write_iterations(result.learned, folder / ITERATIONS)
    _write_executions(result.journal, folder / EXECUTIONS)
    statuses = {item.outcome.status for entry in result.journal.entries() for _, item in entry.executions}
    return learning_summary(result.learned, result.planned, diverged=statuses == {Status.DIVERGED.value})


def complete(folder: Path, data: Summary) -> None:
    """Write the summary in one step, after all other files are on the disk; from then on the run is complete.

    Args:
        folder: folder of the run.
        data: the summary.

    Raises:
        RunFolderError: configuration or provenance are missing.
    """
    missing = [name for name in (CONFIG, PROVENANCE) if not (folder / name).is_file()]
    if missing:
        found = f"{' and '.join(missing)} removed while the run was at work"
        raise RunFolderError(f"{folder}: the run could not be completed: {found}; expected the files as written")
    with written(folder / SUMMARY) as beside:
        beside.write_text(record_text(data), encoding="utf-8")
        flush(folder)
    flush_folder(folder)


def _write_iterations(learned: Learned, path: Path) -> None:
    """Write one line per plan; lists are joined by blanks."""
    records = [row_columns(learned, row) for row in learned.rows]
    _write_csv(list(dict.fromkeys(key for record in records for key in record)), records, path)


def _write_executions(journal: Journal, path: Path) -> None:
    """Write one line per execution; every number reads back as the same floating point number."""
    heads = ["execution", "plan", "speed", "success", "status", "what", "against", "t", "s"]
    records = [
        {"execution": item.number, "plan": plan, "speed": speed, **_shown(item.outcome)}
        for plan, entry in enumerate(journal.entries())
        for speed, item in entry.executions
    ]
    _write_csv(list(dict.fromkeys([*heads, *(key for record in records for key in record)])), records, path)


def _shown(outcome: Executed) -> dict[str, Any]:
    """Return what an execution showed as the columns of `executions.csv`, but for its acceleration error."""
    failure = outcome.failure or Failure("")
    first = {"what": failure.what, "against": failure.against, "t": failure.t, "s": failure.s}
    peaks = {f"{kind}_{peak.name}": getattr(peak, kind) for peak in outcome.peaks for kind in ("slip", "tilt")}
    return {"success": outcome.success, "status": outcome.status, **first, **peaks}


def _write_csv(heads: Sequence[str], records: Sequence[Mapping[str, Any]], path: Path) -> None:
    with written(path) as beside, beside.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(heads)
        writer.writerows([_cell(record.get(head)) for head in heads] for record in records)


def _cell(value: Any) -> str:
    if value is None:
        return ""
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, Mapping):
        return " ".join(f"{key}={_cell(inner)}" for key, inner in value.items())
    return " ".join(map(_cell, value)) if isinstance(value, (list, tuple)) else str(value)
