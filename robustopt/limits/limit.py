"""The interface of a limit: the members that a problem uses, and that a user implements to add a limit."""

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
            polygons: feasible (u, x) so far, one polygon per grid point; they must not be changed.
            index: number of each name of the limit in the problem, which labels its rows (k,).
            used: which of the names count (k,).
        """

    def excess(self, u: Array, x: Array, points: Indices) -> Array:
        """Return the excess over the limit, as a fraction of it, for the worst uncertain quantities.

        Args:
            u: sdd (M,).
            x: sd^2 (M,).
            points: grid point of each (M,).

        Returns:
            Values (M, k) for the k names, at most 0 if the limit is satisfied; nan if they are not known explicitly.
        """


LimitFactory = Callable[[Track], Limit]
"""Function that makes a limit from the track, which holds robot, path, grid and motion."""
