"""What monotone success says of points that were not executed, in the unit cube of the parameters.

A success rules out all that is at least as conservative, which costs more; a failure rules out all that is at least as
optimistic, which fails too (paper, 7.1, conditions 1 and 2).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from robustopt.learning.parameters import Array, Point


@dataclass(frozen=True)
class Knowledge:
    """successes, failures: points that did, (m, k); infeasible: points without a plan, (m, k)"""

    successes: Array
    failures: Array
    infeasible: Array

    @staticmethod
    def of(k: int, successes: Sequence[Point], failures: Sequence[Point], infeasible: Sequence[Point]) -> Knowledge:
        """Knowledge from points in k parameters."""
        lists = (successes, failures, infeasible)
        return Knowledge(*(np.array(points, dtype=float).reshape(-1, k) for points in lists))

    @property
    def tops(self) -> Array:
        """Points from which all that is at least as conservative is ruled out, (m, k)."""
        return np.vstack([self.successes, self.infeasible])

    def undecided(self, points: Array) -> Array:
        """Which points (m, k) nothing rules out, (m,)."""
        known = np.zeros(len(points), dtype=bool)
        for failure in self.failures:
            known |= np.all(points <= failure, axis=1)
        for top in self.tops:
            known |= np.all(points >= top, axis=1)
        return ~known

    def lower_corners(self) -> Array:
        """Corners (m, k) such that every point that no failure rules out is at least as conservative as one of them.

        f* of what is not ruled out is therefore at least the least f* of these corners. Each failure lifts every corner
        that it rules out, along one axis at a time; corners above others are dropped.
        """
        corners = np.zeros((1, self.failures.shape[1]))
        for failure in self.failures:
            below = np.all(corners <= failure, axis=1)
            lifted = [corners[~below]]
            for axis in np.flatnonzero(failure < 1):
                moved = corners[below]
                moved[:, axis] = failure[axis]
                lifted.append(moved)
            corners = _minimal(np.unique(np.vstack(lifted), axis=0))
        return corners

    def contract(self, low: Array, high: Array) -> tuple[Array, Array]:
        """Boxes [low, high], (m, k) each, without the slabs at their faces that are ruled out as a whole."""
        low, high = low.copy(), high.copy()
        for failure in self.failures:
            for axis, slab in enumerate(_slabs(high <= failure)):
                low[slab, axis] = np.maximum(low[slab, axis], failure[axis])
        for top in self.tops:
            for axis, slab in enumerate(_slabs(low >= top)):
                high[slab, axis] = np.minimum(high[slab, axis], top[axis])
        return low, high

    def diagonal(self, low: Array, high: Array) -> tuple[Array, Array]:
        """Interval of t in which low + t (high - low) is undecided, for boxes (m, k): two arrays (m,)."""
        first, last = np.zeros(len(low)), np.ones(len(low))
        size = np.maximum(high - low, 1e-300)
        for failure in self.failures:
            first = np.maximum(first, np.min((failure - low) / size, axis=1))
        for top in self.tops:
            last = np.minimum(last, np.max((top - low) / size, axis=1))
        return first, last

    def contradictions(self) -> int:
        """Pairs of a success and a failure of which the failure is at least as conservative."""
        return int(np.all(self.successes[:, None] <= self.failures[None], axis=2).sum())


def _slabs(covered: Array) -> list[Array]:
    """For each axis, the boxes that are covered along all others, given what is covered of (m, k)."""
    count = np.sum(covered, axis=1)
    almost = np.flatnonzero(count >= covered.shape[1] - 1)
    return [almost[count[almost] - covered[almost, axis] == covered.shape[1] - 1] for axis in range(covered.shape[1])]


def _minimal(points: Array) -> Array:
    """The points (m, k), all different, that are not above another of them."""
    above = np.all(points[:, None] >= points[None], axis=2)
    return points[above.sum(axis=1) == 1]
