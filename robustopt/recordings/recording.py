"""Joint positions from a file, and the mistakes in such files."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from robustopt.arrays import Array
from robustopt.errors import PathError

KEY = "path.joints"

MOST_ROWS = 50_000
"""Largest number of waypoints; a log of a minute at 1 kHz should be thinned (our choice)."""

STILL = 1e-3
"""Largest range of a joint that the robot does not have and that counts as constant [rad or m] (our choice)."""


@dataclass(frozen=True)
class Layout:
    """The positions that a path needs.

    Attributes:
        joints: names of the joints in their order (n,).
        locked: names of the joints that the configuration locks.
        degrees: whether angles are in degrees.
    """

    joints: tuple[str, ...]
    locked: Collection[str]
    degrees: bool


@dataclass(frozen=True)
class Recording:
    """Joint positions in the order of a file.

    Attributes:
        q: positions in the order of the robot's joints (W, n), angles in the unit of the file.
        t: time of each position, never decreasing (W,) [s]; None if the file has no times.
        notes: content of the file that is not used, in words.
    """

    q: Array
    t: Array | None = None
    notes: tuple[str, ...] = ()

    @property
    def duration(self) -> float | None:
        """Return the time from the first position to the last one [s]; None without times."""
        return float(self.t[-1] - self.t[0]) if self.t is not None and len(self.t) else None


def refused(file: Path, message: str) -> PathError:
    """Return an error about a file.

    Args:
        file: the file.
        message: what is wrong, and the remedy.
    """
    return PathError(f"{file}: {message}", key=KEY)


def counted(count: int, one: str, many: str) -> str:
    """Return a number with its noun: `1 row has`, `12 rows have`.

    Args:
        count: the number.
        one: words after 1.
        many: words after any other number.
    """
    return f"{count:,} {one if count == 1 else many}"


def require_few(file: Path, count: int) -> None:
    """Check the number of rows of a file.

    Args:
        file: the file.
        count: number of rows.

    Raises:
        PathError: there are more than `MOST_ROWS`.
    """
    if count > MOST_ROWS:
        raise refused(file, f"found more than {MOST_ROWS:,} waypoints; expected fewer")


def require_forward(file: Path, t: Array, places: Sequence[str]) -> None:
    """Check that the times of a file do not run backwards.

    Args:
        file: the file.
        t: the times (W,) [s].
        places: place of each row in the file (W,).

    Raises:
        PathError: they do.
    """
    back = np.flatnonzero(np.diff(t) < 0)
    if len(back):
        i = back[0]
        times = "once" if len(back) == 1 else f"{len(back):,} times"
        first = f"first from {t[i]:.10g} s to {t[i + 1]:.10g} s, {places[i + 1]}"
        raise refused(file, f"the time runs backwards {times}, {first}; expected times in order")


def joint_columns(file: Path, names: Sequence[str], q: Array, layout: Layout) -> Recording:
    """Return the positions of the robot's joints; the other joints of a file must be locked or constant.

    Args:
        file: the file.
        names: names of all joints in the file (m,).
        q: their positions (W, m).
        layout: the positions that the path needs.

    Raises:
        PathError: a joint of the robot is missing, or another joint moves.
    """
    missing = [name for name in layout.joints if name not in names]
    if missing:
        raise refused(file, f"has no positions of {', '.join(missing)}; its joints are {', '.join(names)}")
    others = [i for i, name in enumerate(names) if name not in layout.joints]
    ranges = np.ptp(q, axis=0) if len(q) else np.zeros(len(names))
    moving = [f"{names[i]} by {ranges[i]:.4g}" for i in others if names[i] not in layout.locked and ranges[i] > STILL]
    if moving:
        found = f"joints move that the robot does not have: {', '.join(moving)}"
        raise refused(file, f"{found}; expected them in robot.locked, or constant")
    notes = (f"{file.name}: joints not used: {', '.join(names[i] for i in others)}",) if others else ()
    return Recording(q[:, [names.index(name) for name in layout.joints]], notes=notes)
