"""Run folders: written beside their final place and moved there in one step, so that none is ever half-written."""

from __future__ import annotations

import glob
import hashlib
import json
import os
import platform
import shutil
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, fields, is_dataclass
from datetime import UTC, datetime
from importlib import metadata
from math import isfinite
from pathlib import Path
from typing import Any

from robustopt import __version__
from robustopt.config import Config
from robustopt.config.load import dump
from robustopt.errors import RunFolderError
from robustopt.interruption import held

PROVENANCE, CONFIG, SUMMARY, JOURNAL = "provenance.json", "config.yaml", "summary.json", "journal.db"

PACKAGES = ("numpy", "scipy", "mujoco", "casadi", "highspy", "numba", "pydantic", "PyYAML")
"""Packages whose versions a run records: those that can change its numbers."""


@dataclass
class NewRun:
    """A run that is being written: into the hidden `folder`, which is moved to `place` at the end."""

    folder: Path
    place: Path


@contextmanager
def new_run(name: str, out: Path | None = None, root: Path = Path("results")) -> Iterator[NewRun]:
    """A folder to write a run into; it appears as a whole when the block ends, and not at all if the block fails.

    Without `out` the run is root/name/<UTC time>, with a number behind it where that is taken. An `out` that exists
    must be an empty folder. The hidden folder is made first, beside the final place, so that a place that cannot be
    written to is found before anything is computed. Hidden folders beside it whose process was killed are removed.

    Raises RunFolderError where the folder cannot be written.
    """
    final = out if out is not None else root / name / datetime.now(UTC).strftime("%Y-%m-%dT%H-%M-%SZ")
    if out is not None:
        _require_free(out)
    made: list[Path] = []
    try:
        made += _make_parents(final.parent)
        _remove_abandoned(final.parent)
        hidden = final.parent / f".{final.name}{_mark()}{os.getpid()}"
        hidden.mkdir()
        made.append(hidden)
    except OSError as error:
        _remove(made)
        raise RunFolderError(f"{final}: cannot be written: {_reason(error)}; expected a writable folder") from None
    try:
        run = NewRun(hidden, final)
        yield run
        flush(hidden)
        run.place = _publish(hidden, final, numbered=out is None)
    except OSError as error:
        _remove(made)
        raise RunFolderError(f"{final}: the run could not be written: {_reason(error)}") from error
    except BaseException:
        _remove(made)
        raise


def is_run(folder: Path) -> bool:
    """Whether a folder is a complete run of this package."""
    return all((folder / name).is_file() for name in (PROVENANCE, CONFIG, SUMMARY))


def is_unfinished(folder: Path) -> bool:
    """Whether a folder holds a run of a learner that is not complete."""
    return (folder / JOURNAL).is_file() and not (folder / SUMMARY).is_file()


def read_summary(folder: Path) -> dict[str, Any]:
    """Summary of a stored run; RunFolderError where there is none."""
    if not folder.is_dir():
        raise RunFolderError(f"{folder}: no such run folder; expected a folder that `robustopt plan` wrote")
    if is_unfinished(folder):
        raise RunFolderError(f"{folder}: unfinished; expected a complete run: robustopt learn --resume --out {folder}")
    if not is_run(folder):
        raise RunFolderError(f"{folder}: not a run folder of robustopt; expected {SUMMARY}, {CONFIG} and {PROVENANCE}")
    try:
        summary = json.loads((folder / SUMMARY).read_text(encoding="utf-8-sig"))
    except (OSError, ValueError) as error:
        raise RunFolderError(f"{folder / SUMMARY}: cannot be read: {error}") from None
    if not isinstance(summary, dict):
        raise RunFolderError(f"{folder / SUMMARY}: expected a JSON object")
    missing = [key for key in ("name", "status") if not isinstance(summary.get(key), str)]
    if missing:
        raise RunFolderError(f"{folder / SUMMARY}: {' and '.join(missing)} missing; the file has been changed")
    duration = summary.get("duration")
    if isinstance(duration, bool) or not isinstance(duration, int | float | None):
        raise RunFolderError(f"{folder / SUMMARY}: the duration is no number; the file has been changed")
    return summary


def write_json(path: Path, data: Mapping[str, Any]) -> None:
    """Write a JSON file of what `plain_data` makes of the values."""
    path.write_text(json_text(data) + "\n", encoding="utf-8")


def json_text(data: Mapping[str, Any]) -> str:
    """One JSON object, indented, of what `plain_data` makes of the values."""
    return json.dumps(plain_data(data), indent=2, ensure_ascii=False, allow_nan=False)


def plain_data(value: Any) -> Any:
    """Dataclasses, mappings and arrays as dicts, lists and numbers; a number that is not finite is None in JSON."""
    if is_dataclass(value):
        value = {entry.name: getattr(value, entry.name) for entry in fields(value)}
    if isinstance(value, Mapping):
        return {str(key): plain_data(inner) for key, inner in value.items()}
    if hasattr(value, "tolist"):
        value = value.tolist()
    if isinstance(value, (list, tuple)):
        return [plain_data(inner) for inner in value]
    return None if isinstance(value, float) and not isfinite(value) else value


def write_origin(folder: Path, config: Config, model_file: Path, arguments: Sequence[str]) -> None:
    """Write the resolved configuration and where the run comes from."""
    text = dump(config)
    (folder / CONFIG).write_text(text, encoding="utf-8")
    write_json(folder / PROVENANCE, provenance(config, text, model_file, arguments))


def provenance(config: Config, text: str, model_file: Path, arguments: Sequence[str]) -> dict[str, Any]:
    """What it takes to make a run again: versions, commit, configuration, robot, seed, arguments, machine."""
    from robustopt.robot.model_file import model_hash

    return {
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
        "arguments": ["robustopt", *map(_as_text, arguments)],
        "seed": config.seed,
        "config_sha256": hashlib.sha256(text.encode()).hexdigest(),
        "robot_model": {"name": config.robot.model, "sha256": model_hash(model_file)},
        "waypoints_sha256": waypoints_hash(config),
        "versions": {"python": platform.python_version(), **versions()},
        "git": _git(Path(__file__).resolve().parents[2]),
        "machine": {
            "system": platform.system(),
            "release": platform.release(),
            "architecture": platform.machine(),
            "cpus": os.cpu_count(),
        },
    }


def _as_text(argument: str) -> str:
    """An argument as UTF-8, where the system has given bytes that are no text in its own encoding."""
    return argument.encode("utf-8", "surrogateescape").decode("utf-8", "replace")


def waypoints_hash(config: Config) -> str | None:
    """SHA-256 of the file of joint waypoints, None where the configuration has none or names one that is missing."""
    file = config.folder / config.path.joints if isinstance(config.path.joints, str) else None
    return hashlib.sha256(file.read_bytes()).hexdigest() if file is not None and file.is_file() else None


def versions() -> dict[str, str | None]:
    """Versions of this package and of those that can change its numbers."""
    return {"robustopt": __version__, **{name: _version(name) for name in PACKAGES}}


def _version(package: str) -> str | None:
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return None


def _git(checkout: Path) -> dict[str, Any] | None:
    """Commit of the checkout that this package is part of, and whether its files differ from it."""
    top = _git_output(checkout, "rev-parse", "--show-toplevel")
    if top is None or Path(top) != checkout:
        return None
    status = _git_output(checkout, "status", "--porcelain")
    return {"commit": _git_output(checkout, "rev-parse", "HEAD"), "dirty": status != "" if status is not None else None}


def _git_output(folder: Path, *arguments: str) -> str | None:
    try:
        done = subprocess.run(["git", *arguments], cwd=folder, capture_output=True, text=True, timeout=10, check=True)
    except (OSError, subprocess.SubprocessError):
        return None
    return done.stdout.strip()


# The steps of writing -------------------------------------------------------------------------------------


def _require_free(out: Path) -> None:
    if is_run(out):
        message = f"{out}: holds an earlier run of robustopt; expected a new folder, or remove that one first"
        raise RunFolderError(message)
    if out.is_dir() and any(out.iterdir()):
        raise RunFolderError(f"{out}: is not empty; expected a new folder, or an empty one")
    if out.exists() and not out.is_dir():
        raise RunFolderError(f"{out}: is a file; expected a new folder, or an empty one")


def _make_parents(folder: Path) -> list[Path]:
    """Make a folder and those above it; the ones that were missing, outermost first."""
    missing = [place for place in (folder, *folder.parents) if not place.exists()][::-1]
    made: list[Path] = []
    try:
        for place in missing:
            place.mkdir(exist_ok=True)
            made.append(place)
    except OSError:
        _remove(made)
        raise
    return made


def _mark() -> str:
    """What stands between the name of a hidden folder and the process that writes it; processes belong to a machine."""
    return f".partial-{platform.node()}-"


def _remove_abandoned(folder: Path) -> None:
    """Remove hidden folders that processes of this machine were writing into a folder when they were killed."""
    for hidden in folder.glob(f".*{glob.escape(_mark())}*"):
        process = hidden.name.rpartition("-")[2]
        if process.isdigit() and not _is_alive(int(process)):
            shutil.rmtree(hidden, ignore_errors=True)


def _is_alive(process: int) -> bool:
    if sys.platform == "win32":  # where signal 0 is not a question
        return True
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except OSError:
        return True
    return True


def _remove(made: Sequence[Path]) -> None:
    """Take back what was made: the hidden folder with all in it, and folders above it that are empty."""
    with held(), suppress(OSError):
        for folder in reversed(made):
            if _mark() in folder.name:
                shutil.rmtree(folder, ignore_errors=True)
            else:
                folder.rmdir()


def flush(folder: Path) -> None:
    """Have the system write all files of a folder to the disk, which a full disk refuses.

    A journal is left out: SQLite does this itself, and would lose its lock on a file that its process closes.
    """
    for place in sorted(folder.rglob("*")):
        if place.is_file() and not place.name.startswith(JOURNAL):
            with place.open("rb+") as file:
                os.fsync(file.fileno())
    flush_folder(folder)


def flush_folder(folder: Path) -> None:
    """Have the system write the names of the files in a folder to the disk."""
    if sys.platform == "win32":
        return
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def _publish(hidden: Path, final: Path, numbered: bool) -> Path:
    """Move the hidden folder to its place, with `numbered` to the next free name if that is taken; where it is now."""
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


def _reason(error: OSError) -> str:
    about = f" ({error.filename})" if error.filename else ""
    return f"{error.strerror or error}{about}"
