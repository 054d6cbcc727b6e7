"""Reachability: the minimum-time timing by two passes over the grid, compiled.

Backward: the controllable set of a grid point is the interval of x from which the end can be reached. Its ends are two
linear programs in (u, x), over the rows at both ends of the interval and the next controllable set. Forward: from the
start take the largest u that stays controllable. Let F_i(x) be the largest x_{i+1} that can follow x_i, a concave
function. If no F_i decreases before the x_i of the forward pass, its timing is the pointwise largest, hence optimal. In
general the largest F_i of all smaller x gives a second pass, an upper bound of every feasible timing, and so a lower
bound of the duration. If the two durations differ, an interior-point method polishes the plan (our choice).
"""

from __future__ import annotations

import time

import numpy as np

from robustopt.arrays import Array
from robustopt.compiled import compiled, compiled_inner, merged
from robustopt.limits import TimeScalingProblem
from robustopt.solvers.interior_point import polish
from robustopt.solvers.plan import Plan, Status, controls_of, duration_of, failed_plan, outcome, timed_plan, timing

FEASIBILITY = 1e-9
"""Fraction of its limit by which a row may be violated: the accuracy of a vertex of two rows in double precision."""

SAME_START = 1e-8
"""Part by which x at the start may be above the controllable set: a plan that starts from another one is in it but for
rounding errors."""

AT_REST = np.zeros(2)
"""Ends of a timing from rest to rest."""

OPTIMALITY_GAP = 5e-5
"""Fraction of the duration by which the forward pass may exceed its lower bound without being polished: half of the
1e-4 to which the solvers agree."""


def solve_reachability(problem: TimeScalingProblem) -> Plan:
    """Return the minimum-time plan on the rows of a problem, or a failed plan with the reason.

    Args:
        problem: the problem.
    """
    began = time.perf_counter()
    x, bound, stuck = passes(problem.a, problem.b, problem.c, problem.x_max, problem.ds, problem.fixed[[0, -1]])
    closed = np.flatnonzero(~problem.feasible)
    stuck = closed[0] if len(closed) else stuck
    if stuck >= 0:
        return _stuck(problem, stuck, began)
    duration, u = timing(problem.ds, x)
    least = timing(problem.ds, bound)[0] if np.any(bound > x) else duration
    gap = 1.0 - least / duration
    polished = gap > OPTIMALITY_GAP
    if polished:
        free = np.isnan(problem.fixed)
        better, left = polish(problem.a, problem.b, problem.c, problem.x_max, problem.ds, x, free)
        after = duration_of(problem.ds, better)
        if after < duration:
            x, u, duration = better, controls_of(problem.ds, better), after
        gap = min(gap, 1.0 - (after - left) / duration)
    if not duration < np.inf:
        return _stuck(problem, int(np.argmax((x[:-1] + x[1:] == 0.0) & (problem.ds > 0))), began)
    statistics = {"solver_seconds": time.perf_counter() - began, "optimality_gap": gap, "polished": float(polished)}
    return timed_plan(problem, x, u, duration, "reachability", statistics)


def _stuck(problem: TimeScalingProblem, point: int, began: float) -> Plan:
    statistics = {"solver_seconds": time.perf_counter() - began}
    message = outcome(Status.INFEASIBLE, problem)
    return failed_plan(problem, Status.INFEASIBLE, "reachability", message, point, statistics)


@compiled_inner(error_model="numpy")
def _gather(a, b, c, i, step, A, B, C):
    """List the rows of grid points i and i + 1 that are not padding, from place 2 on; return where they end.

    x + step u is the x of grid point i + 1.
    """
    n = 2
    for end in range(2):
        p, along = i + end, end * step
        for k in range(a.shape[1]):
            if a[p, k] != 0.0 or b[p, k] != 0.0:
                A[n], B[n], C[n] = a[p, k] + along * b[p, k], b[p, k], c[p, k]
                n += 1
            elif c[p, k] > FEASIBILITY:
                A[n], B[n], C[n] = 0.0, 0.0, c[p, k]
                n += 1
    return n


@compiled_inner(error_model="numpy")
def _extreme_x(A, B, C, m, x_max, sign, order):
    """Return the largest or smallest x in [0, x_max] with A u + B x + C <= 0 for some u, else nan; sign: 1.0 or -1.0.

    This is incremental linear programming in two variables (Seidel): a violated row moves the optimum onto its line.
    `order` is the order of the rows; indices from m on are skipped. A violated row moves to the front, because a row
    that binds at one grid point mostly binds at the next, too. The indices are unsigned: compiled code then need not
    check for indices that count from the end.
    """
    x = x_max if sign > 0.0 else 0.0
    u = 0.0
    for p in range(len(order)):
        i = order[p]
        if i >= m or A[i] * u + B[i] * x + C[i] <= FEASIBILITY * 1e-3:
            continue
        norm = A[i] * A[i] + B[i] * B[i]
        if norm < 1e-300:
            if C[i] > FEASIBILITY:
                return np.nan
            continue
        u0, x0 = -A[i] * C[i] / norm, -B[i] * C[i] / norm
        du, dx = -B[i], A[i]
        low, high = -np.inf, np.inf
        scale = 1e-13 * norm
        if abs(dx) > scale:
            t0, t1 = -x0 / dx, (x_max - x0) / dx
            low, high = min(t0, t1), max(t0, t1)
        elif x0 < -FEASIBILITY or x0 - x_max > FEASIBILITY:
            return np.nan
        for k in range(p):
            j = order[k]
            if j >= m:
                continue
            slope = A[j] * du + B[j] * dx
            rest = A[j] * u0 + B[j] * x0 + C[j]
            if slope > scale:
                high = min(high, -rest / slope)
            elif slope < -scale:
                low = max(low, -rest / slope)
            elif rest > FEASIBILITY:
                return np.nan
        if low > high:
            gap = (low - high) * np.sqrt(norm)
            if gap > FEASIBILITY * (1.0 + abs(u0) + abs(x0)):
                return np.nan
            low = high = 0.5 * (low + high)
        rising = sign * dx
        t = high if rising > 0 else (low if rising < 0 else min(max(0.0, low), high))
        if not np.isfinite(t):
            t = low if np.isfinite(low) else (high if np.isfinite(high) else 0.0)
        u, x = u0 + t * du, x0 + t * dx
        for k in range(p, 0, -1):
            order[k] = order[k - 1]
        order[0] = i
    return min(max(x, 0.0), x_max)


@merged
def _holds_at_rest(A, C, m):
    """Return whether some u satisfies A u + C <= 0: then the smallest x is 0, which is nearly always so."""
    above = 0
    for k in range(m):
        above += 1 if C[k] > 0.0 else 0
    if above == 0:
        return True
    low, high = -np.inf, np.inf
    for k in range(m):
        if A[k] > 0.0:
            high = min(high, -C[k] / A[k])
        elif A[k] < 0.0:
            low = max(low, -C[k] / A[k])
        elif C[k] > 0.0:
            return False
    return low <= high


def passes(a: Array, b: Array, c: Array, x_max: Array, ds: Array, ends: Array = AT_REST) -> tuple[Array, Array, int]:
    """Run the backward and the forward pass.

    Args:
        a: coefficients of u (P, m).
        b: coefficients of x (P, m).
        c: constants (P, m).
        x_max: largest x, 0 at rest (P,).
        ds: interval lengths, 0 at stops (P - 1,).
        ends: x at the start and at the end (2,).

    Returns:
        The timing x (P,); an upper bound of every feasible x (P,); the grid point at which no choice is left or the
        robot cannot move on, or -1.
    """
    P, m = a.shape
    low, high, x, bound = np.zeros((4, P))
    A, B, C = np.empty((3, 2 * m + 2))
    fast, slow, order = np.tile(np.arange(2 * m + 2, dtype=np.uint32), (3, 1))
    low[-1] = high[-1] = ends[1]
    x[0] = bound[0] = ends[0]
    stuck = _backward(a, b, c, x_max, ds, low, high, A, B, C, fast, slow)
    if stuck < 0 and not low[0] - FEASIBILITY <= ends[0] * (1.0 + SAME_START) <= high[0] * (1.0 + 2.0 * SAME_START):
        stuck = 0
    if stuck < 0:
        _forward(a, b, c, ds, low, high, x, bound, A, B, C, order)
    return x, bound, stuck


@compiled(error_model="numpy", _nrt=False)
def _backward(a, b, c, x_max, ds, low, high, A, B, C, fast, slow):
    """Find the controllable sets; return the grid point at which none is left, or -1."""
    for i in range(len(ds) - 1, -1, -1):
        if ds[i] == 0.0:
            low[i], high[i] = low[i + 1], min(high[i + 1], x_max[i])
        else:
            step = 2.0 * ds[i]
            A[0], B[0], C[0] = step, 1.0, -high[i + 1]
            A[1], B[1], C[1] = -step, -1.0, low[i + 1]
            n = _gather(a, b, c, i, step, A, B, C)
            high[i] = _extreme_x(A, B, C, n, x_max[i], 1.0, fast)
            low[i] = 0.0 if _holds_at_rest(A, C, n) else _extreme_x(A, B, C, n, x_max[i], -1.0, slow)
        if not low[i] <= high[i] or (ds[i] > 0.0 and high[i] == 0.0 and high[i + 1] == 0.0):
            return i
    return -1


@compiled(error_model="numpy", _nrt=False)
def _forward(a, b, c, ds, low, high, x, bound, A, B, C, order):
    """Find the timing and its bound in the controllable sets."""
    for i in range(len(ds)):
        if ds[i] == 0.0:
            x[i + 1], bound[i + 1] = x[i], bound[i]
            continue
        step = 2.0 * ds[i]
        u, decreasing = (high[i + 1] - x[i]) / step, False
        for end in range(2):
            p, along = i + end, end * step
            for k in range(a.shape[1]):
                slope = a[p, k] + along * b[p, k]
                rest = b[p, k] * x[i] + c[p, k]
                if slope > 0.0 and -rest < u * slope:
                    u, decreasing = -rest / slope, step * b[p, k] > slope
        x[i + 1] = min(max(x[i] + step * u, low[i + 1]), high[i + 1])
        bound[i + 1] = x[i + 1]
        if decreasing or bound[i] > x[i]:
            n = _gather(a, b, c, i, step, A, B, C)
            bound[i + 1] = _largest_next(A, B, C, n, step, low[i], bound[i], high[i + 1], order)


@merged
def _largest_next(A, B, C, n, step, low, high, most, order):
    """Return the largest x + step u <= most with low <= x <= high and A u + B x + C <= 0, in (u, x + step u)."""
    for k in range(2, n):
        A[k] -= step * B[k]
    A[0], B[0], C[0] = -step, 1.0, -high
    A[1], B[1], C[1] = step, -1.0, low
    for k in range(len(order)):
        order[k] = k if k >= n else (k + 2 if k + 2 < n else k + 2 - n)
    largest = _extreme_x(A, B, C, n, most, 1.0, order)
    return most if np.isnan(largest) else largest
