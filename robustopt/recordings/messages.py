"""ROS messages of joint positions, JointTrajectory and RobotTrajectory, as JSON or YAML."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from robustopt.arrays import Array
from robustopt.files import MOST_TEXT, read_text
from robustopt.recordings.recording import (
    Layout,
    Recording,
    counted,
    joint_columns,
    refused,
    require_few,
    require_forward,
)

MOST_JSON = 50_000_000
"""Largest size of a message in JSON [bytes]: 50,000 points of 7 joints with velocities and accelerations have 28 MB.
YAML is read 10 times as slowly, and is bounded as any text."""

_WRAPPERS = ("trajectory", "joint_trajectory")
"""Fields in which an action goal and a RobotTrajectory hold the JointTrajectory."""


def read_message(file: Path, layout: Layout) -> Recording:
    """Return the joint positions in a message.

    Args:
        file: the file, JSON or YAML by its suffix.
        layout: the positions that the path needs.

    Raises:
        OSError: the file cannot be read.
        PathError: the file is no such message, or a joint is missing, or another one moves, or the time runs backwards.
    """
    message = _trajectory(file, _document(file))
    names, points = message.get("joint_names"), message.get("points")
    if not (isinstance(names, list) and names and all(isinstance(name, str) for name in names)):
        raise refused(file, "has no joint_names; expected a ROS JointTrajectory or RobotTrajectory")
    if len(set(names)) < len(names):
        raise refused(file, f"the joint_names {', '.join(names)} repeat a name; expected each name once")
    if not isinstance(points, list) or not all(isinstance(point, dict) for point in points):
        raise refused(file, "has no list of points; expected a ROS JointTrajectory or RobotTrajectory")
    require_few(file, len(points))
    recording = joint_columns(file, names, _positions(file, points, len(names)), layout)
    return Recording(recording.q, _times(file, points), recording.notes)


def _document(file: Path) -> Any:
    """Return the content of a file; in YAML all scalars are texts."""
    is_json = file.suffix.lower() == ".json"
    text = read_text(file, MOST_JSON if is_json else MOST_TEXT)
    try:
        if is_json:
            return json.loads(text)
        loader = getattr(yaml, "CBaseLoader", yaml.BaseLoader)  # the one in C is not part of every build
        documents = [document for document in yaml.load_all(text, Loader=loader) if document]
    except (ValueError, yaml.YAMLError, RecursionError) as error:
        found = " ".join(str(getattr(error, "problem", None) or error).split())
        raise refused(file, f"cannot be read as {file.suffix.removeprefix('.').upper()}: {found}") from None
    if len(documents) > 1:
        raise refused(file, f"has {len(documents)} documents; expected one message")
    return documents[0] if documents else None


def _trajectory(file: Path, message: Any) -> dict[str, Any]:
    """Return the JointTrajectory in a message."""
    for wrapper in _WRAPPERS:
        if isinstance(message, dict) and wrapper in message:
            floating = message.get("multi_dof_joint_trajectory")
            if isinstance(floating, dict) and floating.get("points"):
                raise refused(file, "has points in multi_dof_joint_trajectory; expected joints of one coordinate only")
            message = message[wrapper]
    if not isinstance(message, dict):
        raise refused(file, "is not a message; expected a ROS JointTrajectory or RobotTrajectory")
    return message


def _positions(file: Path, points: Sequence[dict[str, Any]], n: int) -> Array:
    """Return the positions of all joints (W, n)."""
    rows = [point.get("positions") or [] for point in points]
    wrong = [i for i, row in enumerate(rows) if not isinstance(row, list) or len(row) != n]
    if wrong:
        row = rows[wrong[0]]
        count = len(row) if isinstance(row, list) else "no list of"
        have = counted(len(wrong), "point has", "points have")
        first = f"first: points[{wrong[0]}] with {count}"
        raise refused(file, f"{have} not one position for each of the {n} joint_names; {first}")
    values = np.array([[_number(value) for value in row] for row in rows], dtype=float).reshape(-1, n)
    bad = np.argwhere(~np.isfinite(values))
    if len(bad):
        i, j = bad[0]
        count = counted(len(bad), "position is not a finite number", "positions are not finite numbers")
        raise refused(file, f"{count}; first: {str(rows[i][j])[:40]!r} in points[{i}]")
    return values


def _times(file: Path, points: Sequence[dict[str, Any]]) -> Array | None:
    """Return the times of the points (W,) [s]; None if they have none."""
    stamps = [point.get("time_from_start") for point in points]
    if all(stamp is None for stamp in stamps):
        return None
    t = np.array([_seconds(stamp) for stamp in stamps])
    wrong = np.flatnonzero(~np.isfinite(t))
    if len(wrong):
        points_have = counted(len(wrong), "point has", "points have")
        raise refused(file, f"{points_have} no time_from_start with sec and nanosec; first: points[{wrong[0]}]")
    require_forward(file, t, [f"points[{i}]" for i in range(len(t))])
    return t


def _seconds(stamp: Any) -> float:
    """Return a time in seconds: a number, or the fields of ROS 2 or ROS 1; nan for anything else."""
    if not isinstance(stamp, dict):
        return _number(stamp)
    sec, nanosec = (("sec", "nanosec"), ("secs", "nsecs"))["secs" in stamp]
    return _number(stamp.get(sec, 0)) + 1e-9 * _number(stamp.get(nanosec, 0))


def _number(value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float, str)):
        return float("nan")
    try:
        return float(value)
    except (ValueError, OverflowError):
        return float("nan")
