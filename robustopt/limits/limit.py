"""The contract of a limit: what the problem asks of it, and what a user provides to add one."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from robustopt.arrays import Array, Flags, Indices
from robustopt.limits.names import LimitName
from robustopt.limits.polygons import Polygons
from robustopt.limits.track import Track


class Limit(Protocol):
    """A limit on (u, x) = (sdd, sd^2) at every grid point, robust against every uncertain quantity."""

    @property
    def names(self) -> tuple[LimitName, ...]:
        """Return the names of the limit, one or several."""

    def cut(self, polygons: Polygons, index: Indices, used: Flags) -> Polygons:
        """Return the feasible polygons, cut with the rows of this limit.

        Args:
            polygons: feasible (u, x) so far, one polygon per grid point; not to be changed.
            index: number of each of the names in the problem, by which rows are labelled (k,).
            used: which of the names count (k,).
        """

    def excess(self, u: Array, x: Array, points: Indices) -> Array:
        """Return by how much the limit is exceeded, as a fraction of it, for the worst uncertain quantities.

        Args:
            u: sdd (M,).
            x: sd^2 (M,).
            points: grid point of each (M,).

        Returns:
            Values (M, k) for the k names, at most 0 if the limit is kept; nan if they are not known explicitly.
        """


LimitFactory = Callable[[Track], Limit]
"""Makes a limit from the track: robot, path, grid and motion."""
