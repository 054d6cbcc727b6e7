"""Limits of speeds between grid points of jerk-limited timings."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from robustopt.arrays import Array, Flags, Indices
from robustopt.limits.names import LimitName
from robustopt.limits.polygons import Polygons, cut_affine
from robustopt.limits.track import Track

EXCESS = 2.5e-3
"""Largest excess of a joint velocity between grid points, as a fraction of its limit: a quarter of what a certificate
accepts. Without it, fast changes of sdd on coarse grids cost up to 0.1 % of the duration more (our choice)."""


@dataclass(frozen=True, eq=False)
class SpeedBetween:
    """The limits of the speeds of joints and points between grid points, if jerk limits make x concave there.

    Both tangents of x at the ends of an interval lie above it. So x stays below the line through the bounds B and B' at
    both ends, those of velocities enlarged by EXCESS, if x + u ds <= (B + B') / 2 at the start, and x' - u' ds <=
    (B + B') / 2 at the end.

    Attributes:
        names: names of the limits (k,).
        rows: rows a u + b x + c <= 0 as fractions of (B + B') / 2, two for each limit (P, 2 k, 3).
    """

    names: tuple[LimitName, ...]
    rows: Array

    def cut(self, polygons: Polygons, index: Indices, used: Flags) -> Polygons:
        """Return the feasible polygons, cut with the rows; see `Limit`.

        Args:
            polygons: feasible (u, x) so far.
            index: number of each name in the problem (k,).
            used: which of the names count (k,).
        """
        return cut_affine(polygons, self.rows[:, np.repeat(used, 2)], np.repeat(index[used], 2))

    def excess(self, u: Array, x: Array, points: Indices) -> Array:
        """Return the larger value of the two rows of each limit, (M, k); see `Limit`.

        Args:
            u: sdd (M,).
            x: sd^2 (M,).
            points: grid point of each (M,).
        """
        a, b, c = np.moveaxis(self.rows[points], 2, 0)
        return np.asarray((a * u[:, None] + b * x[:, None] + c).reshape(len(u), -1, 2).max(axis=2))


def speed_between(track: Track) -> tuple[SpeedBetween, ...]:
    """Return the limits of speeds between grid points, none without limits of jerk.

    Args:
        track: the track.
    """
    if not np.isfinite(track.robot.limits.jerk).any():
        return ()
    names, ds = tuple(dict.fromkeys(track.velocity_names)), np.diff(track.s)
    most = np.where(track.slowest < 0, (1.0 + EXCESS) ** 2, 1.0) * track.x_max
    middle = 0.5 * (most[:-1] + most[1:])
    slowest = np.array([names.index(name) for name in track.velocity_names])
    rows = np.zeros((len(track.s), 2 * len(names), 3))
    rows[:, :, 2] = -1.0
    for end, sign in ((0, 1.0), (1, -1.0)):
        interval = np.flatnonzero(ds > 0.0)
        column = 2 * slowest[interval + end] + end
        rows[interval + end, column, 0] = sign * (ds / middle)[interval]
        rows[interval + end, column, 1] = 1.0 / middle[interval]
    return (SpeedBetween(names, rows),)
