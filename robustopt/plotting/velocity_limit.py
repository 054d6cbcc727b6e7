"""Velocity limit curves: the largest and the smallest speed at each grid point that some acceleration admits."""

from __future__ import annotations

import numpy as np

from robustopt.arrays import Array
from robustopt.limits import TimeScalingProblem

UNBOUNDED = 1e12
"""Start of the search if nothing bounds x; a result of at least half of it counts as infinite (our choice)."""

VISCOUS_ROUNDS = 12
"""Rounds of linearising the viscous torque; three to five are usual."""

ROUNDING = 1e-12
"""Relative size below which a negative gap counts as rounding."""

MOST_STEPS = 1000
"""Each step moves to another pair of rows, so there are at most as many as pairs; a handful is usual."""


def velocity_limits(problem: TimeScalingProblem) -> tuple[Array, Array]:
    """Return the smallest and the largest admissible sd at each grid point.

    They are the roots of the smallest and the largest x >= 0 for which some u satisfies a u + b x + c <= 0 and the
    joint velocity limits hold. The smallest is 0 if the robot can stand still there; the largest is infinite if nothing
    limits it. Stops of the path do not count. The viscous torque is exact on both curves if the smallest is 0, whatever
    it was linearised about for the plan. Contacts without known facets count with the rows that the solver added, which
    bound their cone from outside.

    Args:
        problem: the time-scaling problem.

    Returns:
        Smallest and largest sd, shape (P,) each, [1/s]; not a number if no speed is admissible.
    """
    problem = _with_all_facets(problem)
    least, most = _admissible_x(problem.with_reference(np.full_like(problem.limits.x_max, np.nan)))
    if problem.limits.torque.viscous.any():
        most = _with_exact_viscous_torque(problem, most)
    empty = ~(least <= most)
    return np.sqrt(np.where(empty, np.nan, least)), np.sqrt(np.where(empty, np.nan, most))


def _admissible_x(problem: TimeScalingProblem) -> tuple[Array, Array]:
    """Return the smallest and the largest x that the rows admit at each grid point, (P,) each."""
    a, b, c = problem.a, problem.b, problem.c
    highest = np.minimum(problem.limits.x_max, UNBOUNDED)
    rest = np.zeros_like(highest)
    most = np.where(problem.feasible, largest_x(a, b, c, rest, highest), np.nan)
    least = np.maximum(-largest_x(a, -b, c, -highest, rest), 0.0)
    return np.where(np.isnan(most), np.nan, least), np.where(most >= 0.5 * UNBOUNDED, np.inf, most)


def _with_exact_viscous_torque(problem: TimeScalingProblem, most: Array) -> Array:
    """Return the largest x with the viscous torque linearised about the result itself, (P,).

    A tangent bounds the viscous torque from above and is exact at its point of contact. Rows with a tangent at any x
    are therefore on the safe side, and after the first round the largest x grows from round to round. The search starts
    from `most`, the largest x of rows with too little viscous torque.
    """
    reference = most
    for _ in range(VISCOUS_ROUNDS):
        _, most = _admissible_x(problem.with_reference(np.where(np.isfinite(reference), reference, np.nan)))
        previous, reference = reference, np.where(np.isnan(most), 0.25 * reference, most)
        if np.allclose(reference, previous, rtol=1e-4, equal_nan=True):
            break
    return most


def _with_all_facets(problem: TimeScalingProblem) -> TimeScalingProblem:
    """Return the problem with all facets of its cones; a solver may have added only the violated ones."""
    contacts = [limit.with_all_facets() for limit in problem.limits.contacts]
    same = all(full is held for full, held in zip(contacts, problem.limits.contacts, strict=True))
    return problem if same else problem.with_contacts(contacts)


def largest_x(a: Array, b: Array, c: Array, lowest: Array, highest: Array) -> Array:
    """Solve max x subject to a u + b x + c <= 0 and lowest <= x <= highest at every grid point.

    Rows with a > 0 bound u from above by -(b x + c)/a, rows with a < 0 from below, so x is admissible if
    gap(x) = min of the upper minus max of the lower bounds is not negative. gap is concave and piecewise linear:
    Newton's method from the right of its largest root never oversteps it, and ends there after finitely many steps.

    Args:
        a: coefficients of u, shape (P, m).
        b: coefficients of x, shape (P, m).
        c: constants, shape (P, m).
        lowest: lower bounds of x, finite, shape (P,).
        highest: upper bounds of x, finite, shape (P,).

    Returns:
        The largest x, shape (P,); not a number at an infeasible point.
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
    """Return the largest and the smallest x that the bounds and the rows with a = 0 allow; nan if there is none."""
    root = np.divide(-c, b, out=np.zeros_like(c), where=b != 0)
    upper = np.where((a == 0) & (b > 0), root, np.inf).min(axis=1, initial=np.inf)
    lower = np.where((a == 0) & (b < 0), root, -np.inf).max(axis=1, initial=-np.inf)
    x, x_min = np.minimum(highest, upper), np.maximum(lowest, lower)
    empty = (x < x_min) | ((a == 0) & (b == 0) & (c > 0)).any(axis=1)
    return np.where(empty, np.nan, x), x_min


def _gap(a: Array, slope: Array, offset: Array, x: Array) -> tuple[Array, Array]:
    """Return the least upper minus the greatest lower bound of u at x, and its derivative, (P,) each."""
    bound = slope * x[:, None] + offset
    upper, upper_slope = _least(np.where(a > 0, bound, np.inf), slope)
    lower, lower_slope = _least(np.where(a < 0, -bound, np.inf), -slope)
    return upper + lower, upper_slope + lower_slope


def _least(bound: Array, slope: Array) -> tuple[Array, Array]:
    """Return the smallest entry of each row of `bound` and its slope; infinity and 0 for a row without entries."""
    if bound.shape[1] == 0:
        return np.full(len(bound), np.inf), np.zeros(len(bound))
    rows, best = np.arange(len(bound)), np.argmin(bound, axis=1)
    value = bound[rows, best]
    return value, np.where(np.isfinite(value), slope[rows, best], 0.0)
