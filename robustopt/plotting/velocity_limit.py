"""The velocity limit curves: the largest and the smallest speed at each grid point that some acceleration admits."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from robustopt.limits import TimeScalingProblem

Array = NDArray[np.float64]

UNBOUNDED = 1e12
"""Where nothing limits x the search starts here; what stays at or above half of it is infinite (our choice)."""

VISCOUS_ROUNDS = 12
"""Rounds of linearising the viscous torque; three to five are the rule."""

ROUNDING = 1e-12
"""Relative size below which a negative gap counts as rounding."""

MOST_STEPS = 1000
"""Each step moves to another pair of rows, so there are at most as many as pairs; a handful is the rule."""


def velocity_limits(problem: TimeScalingProblem) -> tuple[Array, Array]:
    """Smallest and largest sd at each grid point, both of shape (P,), [1/s]; nan where no speed is admissible.

    They are the roots of the smallest and the largest x >= 0 for which some u satisfies a u + b x + c <= 0 with the
    joint velocities within their limits. The smallest is 0 where the robot may stand still; the largest is infinite
    where nothing limits it. Stops do not count: this is what the limits allow, not where the robot must stand.

    The viscous torque is exact at both curves if the smallest is 0, whatever it was linearised about for the plan.
    Contacts whose cone has no known facets count with the rows that the solver added: an outer bound.
    """
    problem = _with_all_facets(problem)
    least, most = _admissible_x(problem.with_reference(np.full_like(problem.limits.x_max, np.nan)))
    if problem.limits.torque.viscous.any():
        most = _with_exact_viscous_torque(problem, most)
    return np.sqrt(np.where(np.isnan(most), np.nan, least)), np.sqrt(most)


def _admissible_x(problem: TimeScalingProblem) -> tuple[Array, Array]:
    """Smallest and largest x of the rows at each grid point, both of shape (P,)."""
    a, b, c = problem.a, problem.b, problem.c
    highest = np.minimum(problem.limits.x_max, UNBOUNDED)
    rest = np.zeros_like(highest)
    most = np.where(problem.feasible, largest_x(a, b, c, rest, highest), np.nan)
    least = np.maximum(-largest_x(a, -b, c, -highest, rest), 0.0)
    return np.where(np.isnan(most), np.nan, least), np.where(most >= 0.5 * UNBOUNDED, np.inf, most)


def _with_exact_viscous_torque(problem: TimeScalingProblem, most: Array) -> Array:
    """Largest x with the viscous torque linearised about the result itself, (P,).

    A tangent is an upper bound of the viscous torque that is exact where it touches. Rows with the tangent at any x
    admit only what the exact torque admits, so after the first round the largest x grows from round to round.

    most: largest x of rows with too little viscous torque, to start from
    """
    reference = most
    for _ in range(VISCOUS_ROUNDS):
        _, most = _admissible_x(problem.with_reference(np.where(np.isfinite(reference), reference, np.nan)))
        previous, reference = reference, np.where(np.isnan(most), 0.25 * reference, most)
        if np.allclose(reference, previous, rtol=1e-4, equal_nan=True):
            break
    return most


def _with_all_facets(problem: TimeScalingProblem) -> TimeScalingProblem:
    """The problem with all facets of its contact cones: a solver may have added only those that its plans violated."""
    contacts = [limit.with_all_facets() for limit in problem.limits.contacts]
    same = all(full is held for full, held in zip(contacts, problem.limits.contacts, strict=True))
    return problem if same else problem.with_contacts(contacts)


def largest_x(a: Array, b: Array, c: Array, lowest: Array, highest: Array) -> Array:
    """Solve max x subject to a u + b x + c <= 0, lowest <= x <= highest, at every grid point, (P,); nan: infeasible.

    Rows with a > 0 bound u from above by -(b x + c)/a, rows with a < 0 from below, so x is admissible where
    gap(x) = min of the upper minus max of the lower bounds is not negative. gap is concave and piecewise linear:
    Newton's method from the right of its largest root never oversteps it, and ends there after finitely many steps.

    Args:
        a, b, c: rows, shape (P, m).
        lowest, highest: bounds of x, finite, shape (P,).
    """
    x, x_min = _range_without_u(a, b, c, lowest, highest)
    slope = np.divide(-b, a, out=np.zeros_like(b), where=a != 0)
    offset = np.divide(-c, a, out=np.zeros_like(c), where=a != 0)
    for _ in range(MOST_STEPS):
        gap, gap_slope = _gap(a, slope, offset, x)
        outside = gap < -ROUNDING * (1.0 + np.abs(gap_slope * x))
        if not outside.any():
            break
        root = x - np.divide(gap, gap_slope, out=np.full_like(x, np.inf), where=gap_slope < 0)
        x = np.where(outside, np.where(root >= x_min - ROUNDING * np.abs(x), root, np.nan), x)
    return x


def _range_without_u(a: Array, b: Array, c: Array, lowest: Array, highest: Array) -> tuple[Array, Array]:
    """Largest and smallest x that the bounds and the rows with a = 0 allow; nan where there is none."""
    root = np.divide(-c, b, out=np.zeros_like(c), where=b != 0)
    upper = np.where((a == 0) & (b > 0), root, np.inf).min(axis=1, initial=np.inf)
    lower = np.where((a == 0) & (b < 0), root, -np.inf).max(axis=1, initial=-np.inf)
    x, x_min = np.minimum(highest, upper), np.maximum(lowest, lower)
    empty = (x < x_min) | ((a == 0) & (b == 0) & (c > 0)).any(axis=1)
    return np.where(empty, np.nan, x), x_min


def _gap(a: Array, slope: Array, offset: Array, x: Array) -> tuple[Array, Array]:
    """Least upper minus greatest lower bound of u at x, and its derivative; both of shape (P,)."""
    bound = slope * x[:, None] + offset
    upper, upper_slope = _least(np.where(a > 0, bound, np.inf), slope)
    lower, lower_slope = _least(np.where(a < 0, -bound, np.inf), -slope)
    return upper + lower, upper_slope + lower_slope


def _least(bound: Array, slope: Array) -> tuple[Array, Array]:
    """Smallest entry of each row of `bound` and the slope that belongs to it; infinity and 0 where there is none."""
    if bound.shape[1] == 0:
        return np.full(len(bound), np.inf), np.zeros(len(bound))
    rows, best = np.arange(len(bound)), np.argmin(bound, axis=1)
    value = bound[rows, best]
    return value, np.where(np.isfinite(value), slope[rows, best], 0.0)
