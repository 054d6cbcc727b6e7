"""The runs below a folder, and whether each is complete, can be resumed, or is under way."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from robustopt.errors import RunFolderError, RunInUse
from robustopt.runs.journal import Journal
from robustopt.runs.store import PROVENANCE, is_unfinished, read_summary


def runs(root: Path) -> list[dict[str, Any]]:
    """Every run below a folder, the latest first: where it is, what it is, and whether it is complete."""
    found = [path.parent for path in root.rglob(PROVENANCE) if not _hidden(path.relative_to(root))]
    records = [_record(folder) for folder in found]
    return sorted(records, key=lambda record: record["created"], reverse=True)


def _hidden(path: Path) -> bool:
    return any(part.startswith(".") for part in path.parts)


def _record(folder: Path) -> dict[str, Any]:
    origin, data = _read(folder / PROVENANCE), _summary(folder)
    known = {"folder": str(folder), "created": str(origin.get("created", "")), "name": data.get("name")}
    if data:
        result = {"kind": data.get("kind"), "state": "complete", "status": data.get("status")}
        return known | result | {"duration": data.get("duration")}
    if is_unfinished(folder):
        return known | {"kind": "learning", "state": _state(folder), "status": None, "duration": None}
    return known | {"kind": None, "state": "damaged", "status": None, "duration": None}


def _state(folder: Path) -> str:
    """Whether an unfinished run is under way in some process, or can be resumed."""
    try:
        Journal.open(folder).close()
    except RunInUse:
        return "running"
    except RunFolderError:
        return "damaged"
    return "resumable"


def _summary(folder: Path) -> dict[str, Any]:
    try:
        return read_summary(folder)
    except RunFolderError:
        return {}


def _read(path: Path) -> dict[str, Any]:
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return data if isinstance(data, dict) else {}
