"""Joint waypoints, from the configuration or a CSV file."""

from __future__ import annotations

import csv
import io
from itertools import islice

import numpy as np

from robustopt.arrays import Array, Flags
from robustopt.config import Config
from robustopt.errors import ConfigProblem, PathError
from robustopt.files import MOST_BYTES, read_text

KEY = "path.joints"
MOST_COMPLAINTS = 10
"""Most repeated waypoints that one error lists: a log of a robot at rest has thousands."""
MOST_WAYPOINTS = 50_000
"""Largest number of waypoints; a log of a minute at 1 kHz should be thinned (our choice)."""
FARTHEST = 1e4
"""Largest position of a waypoint [rad or m]: the path between waypoints is checked every 2 cm (our choice)."""
SAME_POSITION = 1e-9
"""Joint positions nearer than this are repeated [rad or m]."""
SAME_PART = 1e-6
"""Waypoints nearer than this part of the path's length are repeated too if the path turns there: a spline would follow
the direction of a rounding error. A log that begins slowly has such waypoints in the direction of the path."""
STRAIGHT = 0.99
"""Least cosine of the angle between a short step and the path around it, for the step not to turn (our choice)."""


def joint_waypoints(config: Config, joint_names: tuple[str, ...]) -> Array:
    """Return the waypoints of `path.joints`, shape (W, n) [rad or m].

    Args:
        config: the configuration; `path.joints` is a list or the name of a CSV file.
        joint_names: names of the joints in their order.

    Raises:
        PathError: a CSV file cannot be read, a waypoint does not have one value for each joint, there are fewer than
            two waypoints, or one is repeated.
    """
    joints = config.path.joints
    rows = _read_csv(config, joints, joint_names) if isinstance(joints, str) else [list(row) for row in joints or ()]
    problems = [
        ConfigProblem(
            f"{KEY}[{i}]",
            f"has {len(row)} values; the robot has {len(joint_names)} joints: {', '.join(joint_names)}",
        )
        for i, row in enumerate(rows)
        if len(row) != len(joint_names)
    ]
    if problems:
        raise PathError(problems)
    if len(rows) > MOST_WAYPOINTS:
        raise PathError(f"found more than {MOST_WAYPOINTS:,} waypoints; expected fewer", key=KEY)
    if len(rows) < 2:
        raise PathError(f"a path needs at least two waypoints; there is {len(rows) or 'none'}", key=KEY)
    waypoints = np.array(rows)
    far = np.flatnonzero(np.abs(waypoints).max(axis=1) > FARTHEST)
    if len(far):
        value = waypoints[far[0]][np.abs(waypoints[far[0]]).argmax()]
        message = f"found {value:g}; expected joint positions of at most {FARTHEST:g} rad or m in size"
        raise PathError(message, key=f"{KEY}[{far[0]}]")
    repeated = np.flatnonzero(_repeats(waypoints))
    if len(repeated):
        listed = repeated[:MOST_COMPLAINTS].tolist()
        raise PathError(
            [ConfigProblem(f"{KEY}[{i + 1}]", f"repeats joints[{i}]; leave one of them out") for i in listed]
        )
    return waypoints


def _repeats(waypoints: Array) -> Flags:
    """Mark the waypoints (N, n), from the second on, that repeat the one before, (N - 1,)."""
    steps = np.diff(waypoints, axis=0)
    first = np.arange(len(steps))
    around = waypoints[np.minimum(first + 2, len(steps))] - waypoints[np.maximum(first - 1, 0)]
    lengths = np.linalg.norm(steps, axis=1)
    turns = np.sum(steps * around, axis=1) < STRAIGHT * lengths * np.linalg.norm(around, axis=1)
    return np.asarray((lengths < SAME_POSITION) | (turns & (lengths < SAME_PART * lengths.sum())))


def _read_csv(config: Config, name: str, joint_names: tuple[str, ...]) -> list[list[float]]:
    """Read the rows of a CSV file, one waypoint each; a first row with the joint names puts the columns in order."""
    file = config.folder / name
    try:
        lines = csv.reader(io.StringIO(read_text(file, MOST_BYTES)))
        filled = ([cell.strip() for cell in row] for row in lines if any(map(str.strip, row)))
        rows = list(islice(filled, MOST_WAYPOINTS + 2))  # the first may be a header
    except (OSError, csv.Error) as error:
        found = getattr(error, "strerror", None) or error
        raise PathError(f"{file}: cannot be read: {found}", key=KEY) from error
    columns = list(range(len(rows[0]))) if rows else []
    if rows and not _is_number(rows[0][0]):
        header = rows.pop(0)
        if sorted(header) != sorted(joint_names):
            raise PathError(
                f"{file}: the columns are {', '.join(header)}; they must be the joints {', '.join(joint_names)}",
                key=KEY,
            )
        columns = [header.index(joint) for joint in joint_names]
    values = []
    for i, row in enumerate(rows):
        if len(row) != len(columns):
            raise PathError(f"{file}, waypoint {i}: has {len(row)} values; the first one has {len(columns)}", key=KEY)
        wrong = [cell for cell in row if not _is_number(cell)]
        if wrong:
            raise PathError(f"{file}, waypoint {i}: {wrong[0]!r} is not a finite number", key=KEY)
        values.append([float(row[column]) for column in columns])
    return values


def _is_number(text: str) -> bool:
    try:
        return bool(np.isfinite(float(text)))
    except ValueError:
        return False
