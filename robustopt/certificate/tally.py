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

    def exceeds(self, limit: LimitName, utilisation: float, instant: int) -> bool:
        """Return whether a utilisation is the worst of a limit so far, at grid points or between them."""
        known = self.worst.get((limit, bool(self.grid[instant])))
        return known is None or utilisation > known.utilisation

    def add(self, key: LimitName, found: Found) -> None:
        """Keep a utilisation of the limit `key` if it is the worst of its kind so far."""
        if self.exceeds(key, found.utilisation, found.instant):
            self.worst[key, bool(self.grid[found.instant])] = found

    def peaks(self, utilisation: Array, at: Indices) -> list[int]:
        """Return the indices of the largest values (k,), at instants `at`, on the grid and between grid points."""
        grid = self.grid[at]
        kinds = (np.flatnonzero(grid), np.flatnonzero(~grid))
        return [int(kind[np.argmax(utilisation[kind])]) for kind in kinds if len(kind)]
