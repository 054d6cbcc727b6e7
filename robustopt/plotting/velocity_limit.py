"""The maximum-velocity curve: the largest speed at each grid point that some acceleration makes admissible."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from robustopt.problem import TimeScalingProblem

Array = NDArray[np.float64]

UNBOUNDED = 1e12
"""Where nothing limits x the search starts here; what stays at or above half of it is infinite (our choice)."""

ROUNDING = 1e-12
"""Relative size below which a negative gap counts as rounding."""

MOST_STEPS = 1000
"""Each step moves to another pair of rows, so there are at most as many as pairs; a handful is the rule."""


def maximum_velocity(problem: TimeScalingProblem) -> Array:
    """Largest sd at each grid point, shape (P,), [1/s]; nan where no speed is admissible, infinite where any is.

    That is sqrt(x) for the largest x >= 0 for which some u satisfies a u + b x + c <= 0 and the joint velocities are
    within their limits. Stops do not lower it: it says what the limits allow, not where the robot must stand.
    """
    x = maximum_x(problem.a, problem.b, problem.c, problem.limits.x_max)
    return np.sqrt(x, out=np.full_like(x, np.nan), where=problem.feasible & ~np.isnan(x))


def maximum_x(a: Array, b: Array, c: Array, x_max: Array) -> Array:
    """Solve max x subject to a u + b x + c <= 0, 0 <= x <= x_max at every grid point, shape (P,); nan: infeasible.

    Rows with a > 0 bound u from above by -(b x + c)/a, rows with a < 0 from below, so x is admissible where
    gap(x) = min of the upper minus max of the lower bounds is not negative. gap is concave and piecewise linear:
    Newton's method from the right of its largest root never oversteps it, and ends there after finitely many steps.

    Args:
        a, b, c: rows, shape (P, m).
        x_max: bound of x, shape (P,).
    """
    x, x_min = _range_without_u(a, b, c, np.minimum(x_max, UNBOUNDED))
    slope = np.divide(-b, a, out=np.zeros_like(b), where=a != 0)
    offset = np.divide(-c, a, out=np.zeros_like(c), where=a != 0)
    for _ in range(MOST_STEPS):
        gap, gap_slope = _gap(a, slope, offset, x)
        outside = gap < -ROUNDING * (1.0 + np.abs(gap_slope * x))
        if not outside.any():
            break
        root = x - np.divide(gap, gap_slope, out=np.full_like(x, np.inf), where=gap_slope < 0)
        x = np.where(outside, np.where(root >= x_min, root, np.nan), x)
    return np.where(x >= 0.5 * UNBOUNDED, np.inf, x)


def _range_without_u(a: Array, b: Array, c: Array, x_max: Array) -> tuple[Array, Array]:
    """Largest and smallest x that x_max, x >= 0 and the rows with a = 0 allow; nan where there is none."""
    root = np.divide(-c, b, out=np.zeros_like(c), where=b != 0)
    upper = np.where((a == 0) & (b > 0), root, np.inf).min(axis=1, initial=np.inf)
    lower = np.where((a == 0) & (b < 0), root, 0.0).max(axis=1, initial=0.0)
    x = np.minimum(x_max, upper)
    empty = (x < lower) | ((a == 0) & (b == 0) & (c > 0)).any(axis=1)
    return np.where(empty, np.nan, x), lower


def _gap(a: Array, slope: Array, offset: Array, x: Array) -> tuple[Array, Array]:
    """Least upper minus greatest lower bound of u at x, and its derivative; both of shape (P,)."""
    bound = slope * x[:, None] + offset
    upper, upper_slope = _extreme(np.where(a > 0, bound, np.inf), slope)
    lower, lower_slope = _extreme(np.where(a < 0, -bound, np.inf), -slope)
    return upper + lower, upper_slope + lower_slope


def _extreme(bound: Array, slope: Array) -> tuple[Array, Array]:
    """Smallest entry of each row of `bound` and the slope that belongs to it; infinity and 0 where there is none."""
    if bound.shape[1] == 0:
        return np.full(len(bound), np.inf), np.zeros(len(bound))
    rows, best = np.arange(len(bound)), np.argmin(bound, axis=1)
    value = bound[rows, best]
    return value, np.where(np.isfinite(value), slope[rows, best], 0.0)
