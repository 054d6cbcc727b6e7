"""Reading of recordings, by the suffix of the file."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from robustopt.files import require_regular
from robustopt.recordings.messages import read_message
from robustopt.recordings.recording import Layout, Recording, counted, refused, require_few
from robustopt.recordings.tables import read_table

__all__ = ["Layout", "Recording", "read_recording"]


def read_recording(file: Path, layout: Layout) -> Recording:
    """Return the joint positions in a file: `.npy`, a ROS message as `.json`, `.yaml` or `.yml`, or else CSV.

    Args:
        file: the file.
        layout: the positions that the path needs.

    Raises:
        PathError: the file cannot be read, or does not hold the positions of the robot's joints.
    """
    suffix = file.suffix.lower()
    try:
        if suffix == ".npy":
            return _read_array(file, layout)
        return (read_message if suffix in (".json", ".yaml", ".yml") else read_table)(file, layout)
    except OSError as error:
        raise refused(file, f"cannot be read: {error.strerror or error}") from error


def _read_array(file: Path, layout: Layout) -> Recording:
    """Return the rows of an array, whose columns are the joints in their order."""
    require_regular(file)
    n = len(layout.joints)
    try:
        stored = np.lib.format.open_memmap(file, mode="r")  # no larger than the file, whatever its head says
    except OSError:
        raise
    except Exception as error:  # numpy reads the head as Python, which can fail in many ways
        raise refused(file, f"cannot be read as an array: {' '.join(str(error).split())[:200]}") from None
    if stored.dtype.kind not in "fiu" or stored.ndim != 2 or stored.shape[1] != n:
        found = f"an array of shape {stored.shape} and type {stored.dtype}"
        raise refused(file, f"{found}; expected one row per waypoint with {n} numbers: {', '.join(layout.joints)}")
    require_few(file, len(stored))
    q = np.array(stored, dtype=float)
    wrong = np.flatnonzero(~np.isfinite(q).all(axis=1))
    if len(wrong):
        rows = counted(len(wrong), "row has", "rows have")
        raise refused(file, f"{rows} values that are not finite numbers; first: row {wrong[0]}")
    return Recording(q)
