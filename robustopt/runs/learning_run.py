"""Run folders of learners: begun before anything is computed, continued after any interruption, completed at the end.

A folder with a journal and no summary is unfinished. The summary is written last, in one step; all other files are
written anew by every attempt to complete the run.
"""

from __future__ import annotations

import csv
import hashlib
import json
import shutil
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from robustopt.config import Config
from robustopt.config.load import dump, load_config, resolved
from robustopt.errors import RunFolderError
from robustopt.robot.model_file import model_file, model_hash
from robustopt.runs.beliefs import Planner
from robustopt.runs.campaign import Learned, made_again
from robustopt.runs.execution_run import EXECUTIONS
from robustopt.runs.experiment import FIGURES, PlanResult, write_plan
from robustopt.runs.journal import Journal
from robustopt.runs.learning_summary import DIVERGED, LEARNED, learning_summary, row_record
from robustopt.runs.manual import NEXT
from robustopt.runs.store import (
    CONFIG,
    JOURNAL,
    PROVENANCE,
    SUMMARY,
    flush,
    flush_folder,
    is_unfinished,
    new_run,
    versions,
    waypoints_hash,
    write_json,
    write_origin,
)
from robustopt.simulation.outcome import Status

ITERATIONS = "iterations.csv"

# Begin and continue ---------------------------------------------------------------------------------------


def begin(config: Config, out: Path | None, arguments: Sequence[str], executor: str) -> Path:
    """Make the folder of a new run, with its configuration, provenance and an empty journal; where it is.

    executor: who makes the executions, as in the journal
    """
    if out is not None and is_unfinished(out):
        raise RunFolderError(f"{out}: holds an unfinished run; continue it with --resume, or choose another folder")
    with new_run(config.name, out) as run:
        write_origin(run.folder, config, model_file(config), arguments)
        Journal.create(run.folder, executor)
    return run.place


def discard_if_empty(folder: Path, parents: int = 0) -> None:
    """Remove a run that is unfinished and has nothing in its journal; another one stays as it is.

    parents: so many folders above it are removed as well, where they are empty
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
    """The configuration of a run that is to be continued: the stored one, which a given one must not differ from.

    Raises RunFolderError where the folder is no run of a learner, or was begun with another configuration or robot.
    """
    if not (folder / JOURNAL).is_file():
        raise RunFolderError(f"{folder}: nothing to resume; expected the folder of a run of `robustopt learn`")
    origin = _origin(folder)
    try:
        text, robot = origin["config_sha256"], origin["robot_model"]["sha256"]
        edited = hashlib.sha256((folder / CONFIG).read_bytes()).hexdigest() != text
    except (OSError, KeyError, TypeError) as error:
        raise _unreadable(folder, error) from None
    if edited:
        raise RunFolderError(f"{folder / CONFIG}: was edited after the run began; expected the file as it was written")
    stored = load_config(folder / CONFIG)
    if model_hash(model_file(stored)) != robot:
        raise RunFolderError(
            f"{folder}: the model file of {stored.robot.model}, or one that it names, has changed since the run began"
        )
    waypoints = origin.get("waypoints_sha256")
    if waypoints is not None and waypoints_hash(stored) != waypoints:
        raise RunFolderError(f"{folder}: the waypoints {stored.path.joints} have changed since the run began")
    if config is not None and dump(config) != dump(stored):
        changes = "; ".join(differences(resolved(stored), resolved(config)))
        raise RunFolderError(
            f"{folder}: was begun with another configuration: {changes}. Expected the same one, or a new run"
        )
    return stored


def require_same_versions(folder: Path) -> None:
    """Executions of other versions may be other ones; a run has those of one kind.

    Raises RunFolderError where the run was begun with other versions.
    """
    before, now = _origin(folder).get("versions"), versions()
    if not isinstance(before, dict):
        raise RunFolderError(f"{folder / PROVENANCE}: has no versions; expected the file as it was written")
    changed = [
        f"{name} was {before[name]} and is {now[name]}" for name in now if before.get(name, now[name]) != now[name]
    ]
    if changed:
        raise RunFolderError(
            f"{folder}: was begun with other versions: {'; '.join(changed)}. Expected the same ones, or a new run"
        )


def _origin(folder: Path) -> dict[str, Any]:
    try:
        origin = json.loads((folder / PROVENANCE).read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise _unreadable(folder, error) from None
    if not isinstance(origin, dict):
        raise _unreadable(folder, "expected a JSON object")
    return origin


def _unreadable(folder: Path, why: object) -> RunFolderError:
    return RunFolderError(f"{folder}: {PROVENANCE} or {CONFIG} cannot be read: {why}")


def latest_unfinished(config: Config, root: Path = Path("results")) -> Path | None:
    """The latest unfinished run of a task below `root`; one of the same configuration goes before any other."""
    folders = [place for place in (root / config.name).glob("*") if is_unfinished(place)]
    text = dump(config)
    same = [place for place in folders if _text(place / CONFIG) == text]
    return max(same or folders, key=lambda place: (place / JOURNAL).stat().st_mtime_ns, default=None)


def _text(path: Path) -> str | None:
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, ValueError):
        return None


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
    def diverged(self) -> bool:
        """Whether no simulation came to an end."""
        statuses = {item.status for entry in self.journal.entries() for _, item in entry.executions}
        return statuses == {Status.DIVERGED.value}


def result_of(learned: Learned, journal: Journal) -> LearningResult:
    """The result of a learner that is finished.

    Raises RunFolderError where its best plan cannot be made again.
    """
    best = learned.best
    planned = made_again(Planner(learned.config), best.trial) if best is not None else None
    return LearningResult(learned, planned, journal)


@contextmanager
def writing(folder: Path) -> Iterator[None]:
    """Says where files cannot be written; the journal has all that was learned, so that the run can be continued."""
    try:
        yield
    except OSError as error:
        message = (
            f"{folder}: the run could not be completed: {error.strerror or error}; it can be continued by --resume"
        )
        raise RunFolderError(message) from error


def write_learning_files(result: LearningResult, folder: Path) -> dict[str, Any]:
    """Write all files but figures and summary; the summary's data. What an earlier attempt left of them goes first."""
    shutil.rmtree(folder / FIGURES, ignore_errors=True)
    (folder / NEXT).unlink(missing_ok=True)
    if result.planned is not None:
        write_plan(result.planned, folder)
    _write_iterations(result.learned, folder / ITERATIONS)
    _write_executions(result.journal, folder / EXECUTIONS)
    return learning_summary(result.learned, result.planned, result.diverged)


def complete(folder: Path, data: Mapping[str, Any]) -> None:
    """Write the summary in one step, once all else is on the disk: from here on the run is complete.

    Raises RunFolderError where what the run was begun with is gone.
    """
    missing = [name for name in (CONFIG, PROVENANCE) if not (folder / name).is_file()]
    if missing:
        found = f"{' and '.join(missing)} removed while the run was at work"
        raise RunFolderError(f"{folder}: the run could not be completed: {found}; expected the files as written")
    temporary = folder / f".{SUMMARY}.partial"
    write_json(temporary, data)
    flush(folder)
    temporary.replace(folder / SUMMARY)
    flush_folder(folder)


def exit_code_of(status: str) -> int:
    """Exit code of a complete run: 0 with a plan that succeeded, 5 where every simulation diverged, else 3."""
    return {LEARNED: 0, DIVERGED: 5}.get(status, 3)


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
