"""The grid along a path."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from robustopt.arrays import Array, Indices
from robustopt.path import Path

REST_REFINEMENT = 0.45
"""Share of cosine spacing in the grid of a piece, the rest is uniform: finer towards rest, where sd is like sqrt(s).
With 0.45, 200 intervals are within 0.3 % of a fine grid on all waiter tasks; below 0.4 and above 0.55 not on all."""

FIRST_INTERVALS, FIRST_PER_PIECE = 48, 16
"""Intervals of the first grid along a path, and at least so many on each piece, before waypoints are added."""

CROWDED = 0.4
"""A grid point that is nearer to a kink than this part of the spacing gives way to it."""


FINER, FIRST_INTERVAL = 0.6, (1e-4, 2e-2)
"""Ratio of neighbouring distances from rest where jerk is limited, and bounds of the first one as a part of the
spacing: sdd rises like the cube root of s there. On one axis, the loss is 0.001 to 0.09 % of the duration."""


@dataclass(frozen=True)
class Accuracy:
    """Estimated accuracy of a grid.

    Attributes:
        error: part of the shortest duration that ever finer grids would save.
        violation: largest violation of a limit between grid points, as a share of the limit.
        enough: whether both are as small as wanted.
    """

    error: float
    violation: float
    enough: bool

    @property
    def sentence(self) -> str:
        """Return the accuracy in words."""
        if not np.isfinite(self.error):
            return "The accuracy of the grid was not estimated."
        loss, beyond = f"{100 * self.error:.2g} %", f"{100 * self.violation:.2g} %"
        text = (
            f"By estimate, the duration is {loss} above that of ever finer grids, and limits are exceeded by at most "
        )
        text += f"{beyond} between grid points."
        return text if self.enough else f"{text} The search for a finer grid ended at its bound."


@dataclass(frozen=True, eq=False)
class Grid:
    """Points along a path; a stop is a grid point of both pieces that meet there.

    Attributes:
        s: position of each grid point (P,), from 0 to 1.
        piece: piece of the path that each grid point belongs to (P,).
        accuracy: estimated accuracy; None if the number of intervals was given.
    """

    s: Array
    piece: Indices
    accuracy: Accuracy | None = None

    @property
    def intervals(self) -> int:
        """Return the number of intervals that have a length."""
        return int(np.count_nonzero(np.diff(self.s) > 0))

    def split(self, parts: Indices | int) -> Grid:
        """Return the grid with every interval split into equal parts.

        Args:
            parts: number of parts of each interval (P - 1,), or of all; an interval without length stays whole.
        """
        ds = np.diff(self.s)
        count = np.where(ds > 0, parts, 1)
        interval = np.repeat(np.arange(len(ds)), count)
        part = np.arange(len(interval)) - np.repeat(np.cumsum(count) - count, count)
        s = self.s[interval] + ds[interval] * part / count[interval]
        return Grid(np.append(s, self.s[-1]), np.append(self.piece[interval], self.piece[-1]))


def with_fine_rests(grid: Grid, first: Array) -> Grid:
    """Return a grid with more points near the ends of each piece, at distances that shrink by FINER towards rest.

    Args:
        grid: the grid.
        first: length of the first and of the last interval of each piece that is wanted, within FIRST_INTERVAL
            (pieces, 2).
    """
    s, piece = [grid.s], [grid.piece]
    for k, wanted in enumerate(first):
        own = grid.s[grid.piece == k]
        for end, sign, spacing in ((own[0], 1.0, own[1] - own[0]), (own[-1], -1.0, own[-1] - own[-2])):
            part = np.clip(wanted[0 if sign > 0 else 1] / spacing, *FIRST_INTERVAL)
            count = int(np.ceil(np.log(part) / np.log(FINER)))
            s.append(end + sign * spacing * FINER ** np.arange(1, count + 1))
            piece.append(np.full(count, k))
    every, pieces = np.concatenate(s), np.concatenate(piece)
    order = np.lexsort((every, pieces))
    return Grid(every[order], pieces[order], grid.accuracy)


def numbered_grid(path: Path, intervals: int) -> Grid:
    """Return the grid with a given number of intervals.

    The grid point next to each kink moves onto it, unless there are more kinks than half the grid points.

    Args:
        path: the path.
        intervals: number of intervals, shared among the pieces.
    """
    s, piece = gridpoints(path, intervals)
    free = np.append(np.diff(s) > 0, False) & np.insert(np.diff(s) > 0, 0, False)
    if 2 * len(path.kinks) <= np.count_nonzero(free):
        for kink in path.kinks:
            nearest = int(np.argmin(np.where(free, np.abs(s - kink), np.inf)))
            s[nearest], free[nearest] = kink, False
    return Grid(np.sort(s), piece)


def first_grid(path: Path) -> Grid:
    """Return a coarse grid that contains all kinks, from which the search for an accurate grid starts.

    Args:
        path: the path.
    """
    pieces = len(path.breaks) - 1
    s, piece = gridpoints(path, max(FIRST_INTERVALS, FIRST_PER_PIECE * pieces))
    after = np.searchsorted(s, path.kinks)
    spacing = s[after] - s[after - 1]
    kept = np.ones(len(s), dtype=bool)
    for point in (after - 1, after):
        near = np.abs(s[point] - path.kinks) < CROWDED * spacing
        kept[point[near]] = False
    fixed = np.r_[True, np.diff(s) == 0] | np.r_[np.diff(s) == 0, True]
    kept |= fixed
    kinks = path.kinks[~np.isin(path.kinks, s[fixed])]
    every = np.concatenate([s[kept], kinks])
    order = np.argsort(every, kind="stable")
    return Grid(every[order], np.concatenate([piece[kept], path.piece_at(kinks)])[order])


def gridpoints(path: Path, intervals: int) -> tuple[Array, Indices]:
    """Return the grid of a path; a stop is a grid point of both pieces that meet there.

    Args:
        path: the path.
        intervals: number of intervals, shared among the pieces.

    Returns:
        s of each grid point (P,), and its piece (P,), with P = intervals + pieces.
    """
    lengths = np.diff(path.breaks)
    counts = _apportion(lengths, intervals)
    s, piece = [], []
    for k, count in enumerate(counts):
        xi = np.linspace(0.0, 1.0, count + 1)
        spaced = (1 - REST_REFINEMENT) * xi + REST_REFINEMENT * (1 - np.cos(np.pi * xi)) / 2
        points = path.breaks[k] + lengths[k] * spaced
        points[0], points[-1] = path.breaks[k], path.breaks[k + 1]
        s.append(points)
        piece.append(np.full(count + 1, k))
    return np.concatenate(s), np.concatenate(piece)


def _apportion(lengths: Array, total: int) -> list[int]:
    """Split `total` intervals in proportion to the lengths, at least two each, by largest remainders.

    Short pieces get two, the others share the rest; the sum exceeds `total` only if that is below two each.
    """
    short = np.zeros(len(lengths), dtype=bool)
    while True:
        left = total - 2 * short.sum()
        shares = np.where(short, 2.0, lengths / max(lengths[~short].sum(), 1e-300) * left)
        if not (shares < 2.0).any():
            break
        short |= shares < 2.0
    counts = np.floor(shares).astype(int)
    for k in np.argsort(counts - shares, kind="stable")[: max(total - counts.sum(), 0)]:
        counts[k] += 1
    return [int(count) for count in counts]
