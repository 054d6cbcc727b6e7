"""Worst utilisation of each named limit so far, on the grid and between grid points."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from robustopt.arrays import Array, Flags, Indices
from robustopt.limits.names import LimitName


@dataclass(frozen=True)
class Found:
    """A utilisation, 1 at the limit, the instant it was found at, and the parameters in the configuration's words."""

    utilisation: float
    instant: int
    limit: LimitName
    parameters: Mapping[str, object]


@dataclass
class Tally:
    """Collection of the worst of every limit; `grid` (T,) is True at instants that are grid points."""

    grid: Flags
    worst: dict[tuple[LimitName, bool], Found] = field(default_factory=dict)
    tests: int = 0

    def threshold(self, limit: LimitName) -> Array:
        """Return the utilisation of a limit that a new one must exceed, (T,)."""
        found = {grid: self.worst.get((limit, grid)) for grid in (True, False)}
        values = {grid: -np.inf if item is None else item.utilisation for grid, item in found.items()}
        return np.where(self.grid, values[True], values[False])

    def add(self, key: LimitName, found: Found) -> None:
        """Keep a utilisation of the limit `key` if it is the worst of its kind so far."""
        place = (key, bool(self.grid[found.instant]))
        if place not in self.worst or found.utilisation > self.worst[place].utilisation:
            self.worst[place] = found

    def peaks(self, utilisation: Array, at: Indices | None = None) -> list[int]:
        """Return the indices of the largest values (T,) on the grid and between grid points, if there are any.

        Args:
            utilisation: the values.
            at: their instants, None for all.
        """
        grid = self.grid if at is None else self.grid[at]
        kinds = (np.flatnonzero(grid), np.flatnonzero(~grid))
        return [int(kind[np.argmax(utilisation[kind])]) for kind in kinds if len(kind)]
