"""Run folders: written beside their final place and moved there in one step, so that none is ever half-written."""

from __future__ import annotations

import glob
import json
import os
import platform
import shutil
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, TypeVar

from pydantic import ValidationError

from robustopt.errors import RunFolderError
from robustopt.files import read_text, reason, write_text
from robustopt.interruption import held
from robustopt.runs.records import Provenance, Record, Summary, plain_data

PROVENANCE, CONFIG, SUMMARY, JOURNAL = "provenance.json", "config.yaml", "summary.json", "journal.db"

R = TypeVar("R", bound=Record)


@dataclass
class NewRun:
    """Run that is being written: into the hidden `folder`, which is moved to `place` at the end."""

    folder: Path
    place: Path


@contextmanager
def new_run(name: str, out: Path | None = None, root: Path = Path("results")) -> Iterator[NewRun]:
    """Make a folder to write a run into; it appears as a whole when the block ends, and not at all if the block fails.

    The hidden folder is made first, beside the final place, so that a place that cannot be written to is found before
    anything is computed. Hidden folders beside it whose process was killed are removed.

    Args:
        name: of the task.
        out: the run folder, new or empty; by default root/name/<UTC time>, with a number behind it if that is taken.
        root: folder of all runs.

    Raises:
        RunFolderError: the folder cannot be written.
    """
    final = out if out is not None else root / name / datetime.now(UTC).strftime("%Y-%m-%dT%H-%M-%SZ")
    if out is not None:
        final = _require_free(out)
    hidden, made = _make_hidden(final)
    try:
        run = NewRun(hidden, final)
        yield run
        flush(hidden)
        run.place = _publish(hidden, final, numbered=out is None)
    except OSError as error:
        _remove(made)
        raise RunFolderError(f"{final}: the run could not be written: {reason(error)}") from error
    except BaseException:
        _remove(made)
        raise


def is_run(folder: Path) -> bool:
    """Return whether a folder is a complete run of this package.

    Args:
        folder: the folder.
    """
    return all(os.path.isfile(folder / name) for name in (PROVENANCE, CONFIG, SUMMARY))


def is_unfinished(folder: Path) -> bool:
    """Return whether a folder holds a run of a learner that is not complete.

    Args:
        folder: the folder.
    """
    return os.path.isfile(folder / JOURNAL) and not os.path.isfile(folder / SUMMARY)


# Records --------------------------------------------------------------------------------------------------


def read_summary(folder: Path) -> Summary:
    """Return the summary of a stored run.

    Args:
        folder: folder of the run.

    Raises:
        RunFolderError: there is no complete run in the folder, or its summary has been changed.
    """
    if not os.path.isdir(folder):
        raise RunFolderError(f"{folder}: no such run folder; expected a folder that `robustopt plan` wrote")
    if is_unfinished(folder):
        raise RunFolderError(f"{folder}: unfinished; expected a complete run: robustopt learn --resume --out {folder}")
    if not is_run(folder):
        raise RunFolderError(f"{folder}: not a run folder of robustopt; expected {SUMMARY}, {CONFIG} and {PROVENANCE}")
    return _read(folder / SUMMARY, Summary)


def require_plan(folder: Path) -> Summary:
    """Return the summary of a run that has a plan to execute.

    Args:
        folder: folder of the run.

    Raises:
        RunFolderError: the run has no plan or a rejected one, or there is no complete run in the folder.
    """
    known = read_summary(folder)
    if known.duration is None:
        raise RunFolderError(f"{folder}: the run has no plan ({known.status}); expected one that was solved")
    if known.rejected:
        raise RunFolderError(f"{folder}: its plan failed its certificate and was rejected; expected one that passed")
    return known


def read_provenance(folder: Path) -> Provenance:
    """Return the provenance of a run, complete or not.

    Args:
        folder: folder of the run.

    Raises:
        RunFolderError: the file is missing, or has been changed.
    """
    return _read(folder / PROVENANCE, Provenance)


def _read(path: Path, kind: type[R]) -> R:
    try:
        return kind.model_validate_json(read_text(path), strict=True)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        found = ": ".join(filter(None, [".".join(map(str, first["loc"])), first["msg"]]))
        remedy = f"it has been changed, or is of another version of robustopt ({found})"
    except OSError as error:
        remedy = error.strerror or str(error)
    raise RunFolderError(f"{path}: cannot be read: {remedy}; expected the file as it was written") from None


def write_record(path: Path, record: Record) -> None:
    """Write a record as a JSON file.

    Args:
        path: the file.
        record: the record.
    """
    write_text(path, record_text(record))


def record_text(record: Record) -> str:
    """Return the text of the JSON file of a record.

    Args:
        record: the record.
    """
    return json_text(record.model_dump(mode="json", exclude_unset=True)) + "\n"


def json_text(data: Mapping[str, Any]) -> str:
    """Return one JSON object, indented.

    Args:
        data: content of the object.
    """
    return json.dumps(plain_data(data), indent=2, ensure_ascii=False, allow_nan=False)


# The steps of writing -------------------------------------------------------------------------------------


def _require_free(out: Path) -> Path:
    """Check that a run can take the place of a folder; return the folder, or the one that a link leads to."""
    if is_run(out):
        message = f"{out}: holds an earlier run of robustopt; expected a new folder, or remove that one first"
        raise RunFolderError(message)
    try:
        with suppress(OSError):
            out.lstat()  # a ValueError tells that no file can have this name
        final = Path(os.path.realpath(out)) if out.is_symlink() or out.name in ("", "..") else out
        if os.path.isdir(final):
            if any(final.iterdir()):
                raise RunFolderError(f"{out}: is not empty; expected a new folder, or an empty one")
            if final.samefile("."):
                raise RunFolderError(f"{out}: is the current folder; expected a new folder, or another empty one")
            final.rmdir()  # as at the end of the run: refused for a mounted folder, or for that of another user
            final.mkdir()
        elif final.exists():
            raise RunFolderError(f"{out}: is a file; expected a new folder, or an empty one")
    except OSError as error:
        raise _unwritable(out, error) from None
    except ValueError:
        raise RunFolderError(f"{str(out)!r}: no folder can have this name; expected another one") from None
    return final


def _unwritable(folder: Path, error: OSError) -> RunFolderError:
    return RunFolderError(f"{folder}: cannot be written: {reason(error)}; expected a writable folder")


def _make_hidden(final: Path) -> tuple[Path, list[Path]]:
    """Make the hidden folder of a run; return it, and all folders that were made for it, outermost first."""
    made: list[Path] = []
    try:
        for place in [place for place in (final.parent, *final.parent.parents) if not place.exists()][::-1]:
            place.mkdir(exist_ok=True)
            made.append(place)
        _remove_abandoned(final.parent)
        hidden = final.parent / f".{final.name}{_mark()}{os.getpid()}"
        hidden.mkdir()
        return hidden, [*made, hidden]
    except OSError as error:
        _remove(made)
        raise _unwritable(final, error) from None


def _mark() -> str:
    """Return the text between the name of a hidden folder and its process, which belongs to one machine."""
    return f".partial-{platform.node()}-"


def _remove_abandoned(folder: Path) -> None:
    """Remove the hidden folders that killed processes of this machine left in a folder."""
    for hidden in folder.glob(f".*{glob.escape(_mark())}*"):
        process = hidden.name.rpartition("-")[2]
        if process.isdecimal() and not _is_alive(int(process)):
            shutil.rmtree(hidden, ignore_errors=True)


def _is_alive(process: int) -> bool:
    if sys.platform == "win32":  # signal 0 is not a question there
        return True
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except OSError:
        return True
    return True


def _remove(made: Sequence[Path]) -> None:
    """Remove the hidden folder with all in it, and the folders above it that were made for it and are empty."""
    with held(), suppress(OSError):
        for folder in reversed(made):
            if _mark() in folder.name:
                shutil.rmtree(folder, ignore_errors=True)
            else:
                folder.rmdir()


def flush(folder: Path) -> None:
    """Flush all files of a folder to the disk, which a full disk refuses.

    A journal is left out: SQLite flushes it itself, and would lose its lock on a file that its process closes.

    Args:
        folder: the folder.
    """
    for place in sorted(folder.rglob("*")):
        if place.is_file() and not place.name.startswith(JOURNAL):
            with place.open("rb+") as file:
                os.fsync(file.fileno())
    flush_folder(folder)


def flush_folder(folder: Path) -> None:
    """Flush the names of the files in a folder to the disk.

    Args:
        folder: the folder.
    """
    if sys.platform == "win32":
        return
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def _publish(hidden: Path, final: Path, numbered: bool) -> Path:
    """Move the hidden folder to its place and return that; with `numbered`, to the next free name if it is taken."""
    place, number = final, 1
    while True:
        try:
            if place.is_dir() and not numbered:
                place.rmdir()
            if numbered and place.exists():
                raise FileExistsError
            hidden.rename(place)
        except OSError:
            if not numbered or not place.exists():
                raise
            number += 1
            place = final.with_name(f"{final.name}-{number}")
            continue
        flush_folder(place.parent)
        return place
