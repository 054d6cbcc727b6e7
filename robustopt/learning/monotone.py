"""Inferences from monotone success about points of the unit cube that were not executed.

A success rules out all points that are at least as conservative, because they cost more. A failure rules out all points
that are at least as optimistic, because they fail too (paper, section 7.1, conditions 1 and 2).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from robustopt.arrays import Array, Flags, Indices
from robustopt.learning.parameters import Point


@dataclass(frozen=True)
class Knowledge:
    """The points whose outcome is known.

    Attributes:
        successes: points that succeeded, (m, k).
        failures: points that failed, (m, k).
        infeasible: points without a plan, (m, k).
    """

    successes: Array
    failures: Array
    infeasible: Array

    @staticmethod
    def of(k: int, successes: Sequence[Point], failures: Sequence[Point], infeasible: Sequence[Point]) -> Knowledge:
        """Return the knowledge from lists of points.

        Args:
            k: number of parameters.
            successes: points that succeeded.
            failures: points that failed.
            infeasible: points without a plan.

        Returns:
            The knowledge.
        """
        lists = (successes, failures, infeasible)
        return Knowledge(*(np.array(points, dtype=float).reshape(-1, k) for points in lists))

    @property
    def tops(self) -> Array:
        """Points that rule out all points that are at least as conservative, (m, k)."""
        return np.vstack([self.successes, self.infeasible])

    def undecided(self, points: Array) -> Flags:
        """Return whether points are not ruled out.

        Args:
            points: points, (m, k).

        Returns:
            Whether nothing rules out each point, (m,).
        """
        known = np.zeros(len(points), dtype=bool)
        for failure in self.failures:
            known |= np.all(points <= failure, axis=1)
        for top in self.tops:
            known |= np.all(points >= top, axis=1)
        return ~known

    def lower_corners(self) -> Array:
        """Return the most optimistic corners of the region that no failure rules out.

        Every point of that region is at least as conservative as one of them, so the least f* over the region is the
        least f* of the corners. Each failure lifts every corner that it rules out, along one axis at a time; corners
        above others are dropped.

        Returns:
            Corners, (m, k).
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
        """Cut off the slabs at the faces of boxes that are ruled out as a whole.

        Args:
            low: optimistic corners of the boxes, (m, k).
            high: conservative corners of the boxes, (m, k).

        Returns:
            The corners of the smaller boxes, (m, k) each.
        """
        low, high = low.copy(), high.copy()
        for failure in self.failures:
            for axis, slab in enumerate(_slabs(high <= failure)):
                low[slab, axis] = np.maximum(low[slab, axis], failure[axis])
        for top in self.tops:
            for axis, slab in enumerate(_slabs(low >= top)):
                high[slab, axis] = np.minimum(high[slab, axis], top[axis])
        return low, high

    def diagonal(self, low: Array, high: Array) -> tuple[Array, Array]:
        """Return the interval of t in which the point low + t (high - low) of each box is undecided.

        Args:
            low: optimistic corners of the boxes, (m, k).
            high: conservative corners of the boxes, (m, k).

        Returns:
            The two ends of the intervals, (m,) each.
        """
        first, last = np.zeros(len(low)), np.ones(len(low))
        size = np.maximum(high - low, 1e-300)
        for failure in self.failures:
            first = np.maximum(first, np.min((failure - low) / size, axis=1))
        for top in self.tops:
            last = np.minimum(last, np.max((top - low) / size, axis=1))
        return first, last

    def contradictions(self) -> int:
        """Return the number of pairs of a success and a failure that is at least as conservative."""
        return int(np.all(self.successes[:, None] <= self.failures[None], axis=2).sum())


def _slabs(covered: Flags) -> list[Indices]:
    """Return, for each axis, the boxes that are covered along all other axes, given the covered sides (m, k)."""
    count = np.sum(covered, axis=1)
    almost = np.flatnonzero(count >= covered.shape[1] - 1)
    return [almost[count[almost] - covered[almost, axis] == covered.shape[1] - 1] for axis in range(covered.shape[1])]


def _minimal(points: Array) -> Array:
    """Return the points that are not above another one, of points (m, k) that are all different."""
    above = np.all(points[:, None] >= points[None], axis=2)
    return points[above.sum(axis=1) == 1]
