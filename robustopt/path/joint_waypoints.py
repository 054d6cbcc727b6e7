"""Joint waypoints, from the configuration or from recordings in files."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from robustopt.arrays import Array, Flags, Indices
from robustopt.config import Config
from robustopt.errors import ConfigProblem, PathError
from robustopt.recordings import Layout, Recording, read_recording
from robustopt.recordings.recording import MOST_ROWS, counted

KEY = "path.joints"
MOST_COMPLAINTS = 10
"""Most repeated waypoints that one error lists: a log of a robot at rest has thousands."""
FARTHEST = 1e4
"""Largest position of a waypoint [rad or m]: the path between waypoints is checked every 2 cm (our choice)."""
SAME_POSITION = 1e-9
"""Joint positions nearer than this are repeated [rad or m]."""
SAME_PART = 1e-6
"""Waypoints nearer than this part of the path's length are repeated too if the path turns there: a spline would follow
the direction of a rounding error. A log that begins slowly has such waypoints in the direction of the path."""
STRAIGHT = 0.99
"""Least cosine of the angle between a short step and the path around it, for the step not to turn (our choice)."""
SAME_PLACE = 1e-3
"""Largest distance of a joint from the end of one file to the start of the next [rad or m]: rounding (our choice)."""
TURN = 2.0 * np.pi
"""Angles of more than a turn in all are usual in degrees and rare in radians (our choice)."""


@dataclass(frozen=True)
class Waypoints:
    """Waypoints of a joint path, no two in a row alike.

    Attributes:
        q: the waypoints (W, n) [rad or m].
        stops: inner waypoints at which the robot stops.
        ends_at_rest: whether the first and the last waypoint are repeated, which is kept as a stop.
        notes: content of the files that is not used, and doubts, in words.
        doubt: doubt about the unit of the angles, in words; None without one.
        recorded: duration of the recordings; None unless all have times [s].
    """

    q: Array
    stops: Indices
    ends_at_rest: tuple[bool, bool]
    notes: tuple[str, ...]
    doubt: str | None
    recorded: float | None


def joint_waypoints(config: Config, joint_names: tuple[str, ...], hinges: Flags) -> Waypoints:
    """Return the waypoints of `path.joints`.

    Args:
        config: the configuration; `path.joints` is a list of waypoints, or the name of a file, or of several.
        joint_names: names of the joints in their order (n,).
        hinges: True for a joint that rotates, False for one that slides (n,).

    Raises:
        PathError: a file cannot be read, a waypoint does not have one value for each joint, a file does not begin at
            the end of the one before, there are fewer than two waypoints, or one in a list is repeated.
    """
    path = config.path
    recordings = _recordings(config, joint_names)
    q = _joined([recording.q for recording in recordings], path.joint_files, joint_names)
    if path.unit == "degrees":
        q = np.where(hinges, np.radians(q), q)
    _require_moderate(q)
    kept = _kept(q)
    if len(kept) < 2:
        raise PathError(f"a path needs at least two waypoints; there is {len(kept) or 'none'}", key=KEY)
    dropped = len(q) - len(kept) - (len(recordings) - 1)
    notes = [note for recording in recordings for note in recording.notes]
    stops: Indices = np.zeros(0, dtype=np.intp)
    ends_at_rest = (False, False)
    if path.repeated == "stop":
        followed = np.flatnonzero(np.diff(np.append(kept, len(q))) > 1)
        stops = followed[(followed > 0) & (followed < len(kept) - 1)]
        ends_at_rest = bool((followed == 0).any()), bool((followed == len(kept) - 1).any())
    elif path.joint_rows and len(kept) < len(q):
        repeated = np.setdiff1d(np.arange(len(q)), kept)[:MOST_COMPLAINTS].tolist()
        raise PathError(
            [ConfigProblem(f"{KEY}[{i}]", f"repeats joints[{i - 1}]; leave one of them out") for i in repeated]
        )
    if dropped > 0:
        way = "dropped; path.repeated: stop keeps them as stops"
        if path.repeated == "stop":
            way = f"the robot stops at {counted(len(stops), 'place', 'places')} between start and end for them"
        notes.append(f"{counted(dropped, 'waypoint repeats', 'waypoints repeat')} the one before; {way}")
    doubt = _doubt(q[:, hinges], path.unit == "degrees")
    durations = [recording.duration for recording in recordings]
    recorded = None if None in durations else sum(filter(None, durations))
    return Waypoints(q[kept], stops, ends_at_rest, (*notes, *([doubt] if doubt else [])), doubt, recorded)


def _recordings(config: Config, joints: tuple[str, ...]) -> list[Recording]:
    """Return the waypoints of every file, or those in the configuration."""
    path = config.path
    if path.joint_files:
        layout = Layout(joints, config.robot.locked, path.unit == "degrees")
        return [read_recording(config.folder / name, layout) for name in path.joint_files]
    problems = [
        ConfigProblem(f"{KEY}[{i}]", f"has {len(row)} values; the robot has {len(joints)} joints: {', '.join(joints)}")
        for i, row in enumerate(path.joint_rows)
        if len(row) != len(joints)
    ]
    if problems:
        raise PathError(problems)
    return [Recording(np.array(path.joint_rows).reshape(-1, len(joints)))]


def _joined(parts: Sequence[Array], files: Sequence[str], names: Sequence[str]) -> Array:
    """Return the waypoints of files in turn; the start of each is moved onto the end of the one before.

    Raises:
        PathError: a file begins elsewhere, or one of several is empty.
    """
    joined = [parts[0]]
    for i, part in enumerate(parts[1:], 1):
        empty = next((k for k in (i - 1, i) if not len(parts[k])), None)
        if empty is not None:
            raise PathError(f"{files[empty]}: has no waypoints; expected some", key=KEY)
        gaps = np.abs(part[0] - parts[i - 1][-1])
        if gaps.max() > SAME_PLACE:
            joint = names[int(gaps.argmax())]
            gap = f"{files[i]}: begins {gaps.max():.4g} from the end of {files[i - 1]} (joint {joint})"
            raise PathError(f"{gap}; expected its first waypoint to be the last one of the file before", key=KEY)
        joined += [parts[i - 1][-1:], part[1:]]
    return np.concatenate(joined)


def _require_moderate(q: Array) -> None:
    """Check the number of waypoints (W, n), and the size of their positions."""
    if len(q) > MOST_ROWS:
        raise PathError(f"found more than {MOST_ROWS:,} waypoints; expected fewer", key=KEY)
    far = np.flatnonzero(np.abs(q).max(axis=1, initial=0.0) > FARTHEST)
    if len(far):
        value = q[far[0]][np.abs(q[far[0]]).argmax()]
        message = f"found {value:g}; expected joint positions of at most {FARTHEST:g} rad or m in size"
        raise PathError(message, key=f"{KEY}[{far[0]}]")


def _doubt(angles: Array, degrees: bool) -> str | None:
    """Return a doubt about the unit of angles (W, hinges) [rad], which are given in degrees if `degrees`."""
    if not angles.size:
        return None
    span = float((angles.max(axis=0, initial=0.0) - angles.min(axis=0, initial=0.0)).max())
    if not degrees and span > TURN:
        return f"the angles reach over {span:.4g} rad, more than a turn; if they are degrees: path.unit: degrees"
    if degrees and np.degrees(span) < TURN:
        return f"the angles reach over {np.degrees(span):.3g} degrees only; if they are radians: path.unit: radians"
    return None


def _kept(q: Array) -> Indices:
    """Return the waypoints (W, n) that repeat none before them."""
    kept: Indices = np.arange(len(q))
    while len(kept) > 1 and (again := _repeats(q[kept])).any():
        kept = kept[np.append(True, ~again)]
    return kept


def _repeats(waypoints: Array) -> Flags:
    """Mark the waypoints (N, n), from the second on, that repeat the one before, (N - 1,)."""
    steps = np.diff(waypoints, axis=0)
    first = np.arange(len(steps))
    around = waypoints[np.minimum(first + 2, len(steps))] - waypoints[np.maximum(first - 1, 0)]
    lengths = np.linalg.norm(steps, axis=1)
    turns = np.sum(steps * around, axis=1) < STRAIGHT * lengths * np.linalg.norm(around, axis=1)
    return np.asarray((lengths < SAME_POSITION) | (turns & (lengths < SAME_PART * lengths.sum())))
