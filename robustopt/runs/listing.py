"""Lists the runs below a folder, and whether each is complete, rejected, can be resumed, or is under way."""

from __future__ import annotations

from pathlib import Path

from robustopt.errors import RunFolderError, RunInUse
from robustopt.runs.journal import Journal
from robustopt.runs.records import Record
from robustopt.runs.store import PROVENANCE, is_unfinished, read_provenance, read_summary


class Listed(Record):
    """Run in a list: its folder and origin, its kind, state and status, and the duration of its motion [s]."""

    folder: str
    created: str
    name: str | None = None
    kind: str | None = None
    state: str
    status: str | None = None
    duration: float | None = None


def runs(root: Path) -> list[Listed]:
    """Return every run below a folder, the latest first.

    Args:
        root: the folder.
    """
    found = [path.parent for path in root.rglob(PROVENANCE) if not _hidden(path.relative_to(root))]
    return sorted(map(_listed, found), key=lambda run: run.created, reverse=True)


def _hidden(path: Path) -> bool:
    return any(part.startswith(".") for part in path.parts)


def _listed(folder: Path) -> Listed:
    created = _created(folder)
    if is_unfinished(folder):
        return Listed(folder=str(folder), created=created, kind="learning", state=_state(folder))
    try:
        data = read_summary(folder)
    except RunFolderError:
        return Listed(folder=str(folder), created=created, state="damaged")
    return Listed(
        folder=str(folder), created=created, name=data.name, kind=data.kind,
        state="rejected" if data.rejected else "complete", status=data.status, duration=data.duration,
    )  # fmt: skip


def _created(folder: Path) -> str:
    try:
        return read_provenance(folder).created
    except RunFolderError:
        return ""


def _state(folder: Path) -> str:
    """Return whether an unfinished run is under way in some process, or can be resumed."""
    try:
        Journal.open(folder).close()
    except RunInUse:
        return "running"
    except RunFolderError:
        return "damaged"
    return "resumable"
