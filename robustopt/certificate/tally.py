"""The worst utilisation of each limit so far, at grid points and between them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from robustopt.arrays import Array, Flags, Indices
from robustopt.limits.names import LimitName


@dataclass(frozen=True)
class Found:
    """A utilisation of a limit.

    Attributes:
        utilisation: used share of the limit; 1 at the limit.
        instant: index of the instant.
        limit: name of the limit.
        parameters: the parameters by their names in the configuration.
        cause: function that finds the name of the limit in place of `limit`, if this takes time.
    """

    utilisation: float
    instant: int
    limit: LimitName
    parameters: Mapping[str, object]
    cause: Callable[[], LimitName] | None = None


@dataclass
class Tally:
    """Collection of the worst utilisation of every limit.

    Attributes:
        grid: True at instants that are grid points (T,).
        worst: worst utilisation by name of the limit and whether it is at a grid point.
        tests: number of utilisations that were computed or bounded.
    """

    grid: Flags
    worst: dict[tuple[LimitName, bool], Found] = field(default_factory=dict)
    tests: int = 0

    def exceeds(self, limit: LimitName, utilisation: float, instant: int) -> bool:
        """Return whether a utilisation of a limit is the worst so far, on the grid or between grid points."""
        known = self.worst.get((limit, bool(self.grid[instant])))
        return known is None or utilisation > known.utilisation

    def add(self, key: LimitName, found: Found) -> None:
        """Keep a utilisation of the limit `key` if it is the worst so far, on the grid or between."""
        if self.exceeds(key, found.utilisation, found.instant):
            self.worst[key, bool(self.grid[found.instant])] = found

    def peaks(self, utilisation: Array, at: Indices) -> list[int]:
        """Return the indices of the largest of values (k,) at instants `at`, one on the grid and one between."""
        grid = self.grid[at]
        kinds = (np.flatnonzero(grid), np.flatnonzero(~grid))
        return [int(kind[np.argmax(utilisation[kind])]) for kind in kinds if len(kind)]
