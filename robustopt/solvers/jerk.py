"""Jerk-limited timing: the minimum-time program in which sdd is continuous and changes at a constant rate per interval.

sdd is 0 at every rest. The rows a u + b x + c <= 0 hold at every grid point with its own u, and at both ends of every
interval with the mean of its u, as without jerk limits. Each piece of the path, from one rest to the next, is a
program of its own in (x, u) = (sd^2, sdd) at its inner grid points:

    x' - x = (u + u') h,   h = ds + (u' - u) dt^2 / 12,   dt = 2 h / (sd + sd')

on each interval, which is exact for a constant rate (u' - u) / dt, and u = 2 x / (3 ds) at the first point after rest,
u = -2 x / (3 ds) at the last one before. The jerk of a joint is q''' sd^3 + 3 q'' sd sdd + q' sddd.

An interior-point method finds a local minimum, from a slow timing of the piece (our choice, see `jerk_barrier`). The
Newton matrix with the equations of the intervals is banded. At the centre for a weight w of the duration, the n slacks
leave a gap of about n / w.
"""

from __future__ import annotations

import time

import numpy as np
from scipy.linalg import solve_banded

from robustopt.arrays import Array, Indices
from robustopt.limits import TimeScalingProblem
from robustopt.solvers.binding import JERK_INSIDE
from robustopt.solvers.jerk_barrier import PLACES, Newton, PieceRows, barrier, derivatives, durations
from robustopt.solvers.plan import Plan, Status, failed_plan, interval_times, jerk_plan

STEPS = 400
"""Largest number of Newton steps on a piece; about sixty are usual."""

FIRST_GAP, ACCURACY, SHARPEN = 0.5, 1e-5, 20.0
"""First and last gap, as fractions of the duration, and the factor by which the weight grows in between."""

CENTRED = 1e-2
"""Squared Newton decrement below which the weight grows: the next centre is a few steps away."""

USED = 0.5
"""Part of each limit that the timing at the start uses."""

SHORTEST_STEP, MOST_RESIDUAL = 1e-10, 1e-5
"""Length of a Newton step below which, and residual of the equations of the intervals above which, rounding errors
prevail: the last centre is the result."""

MOST_GAP = 1e-3
"""Gap, as a fraction of the duration, above which a result is no solution."""

BAND = 4
"""Number of diagonals of the Newton matrix above, and below, the main one."""

MOST_CORRECTIONS = 20
"""Largest number of corrections of h, or Newton steps to a starting timing; three are usual."""

CONSISTENT = 1e-12
"""Residual of the equations of the intervals, as a fraction of x, that rounding errors leave."""

SLOWER, ROOM = 1e-7, 3.0
"""First part by which a timing is slowed down if a correction has moved it too near to a row, and the change of the sum
of the logarithms of all slacks from which on this is so."""

METHOD = "reachability"
"""Name of the method that this solver belongs to."""

LEAST_SLACK = 1e-9
"""Part of each limit that standing still must leave free."""


def solve_jerk(problem: TimeScalingProblem) -> Plan:
    """Return a minimum-time plan within the jerk limits on the rows of a problem, or a failed plan with the reason.

    Args:
        problem: the problem; the robot can stand still at its rests.
    """
    began = time.perf_counter()
    x, u, steps, gap = np.zeros(len(problem.s)), np.zeros(len(problem.s)), 0, 0.0

    def figures() -> dict[str, float]:
        return {"solver_seconds": time.perf_counter() - began, "newton_steps": float(steps), "optimality_gap": gap}

    refused = unless_still(problem, METHOD)
    if refused is not None:
        return refused
    for first, last in pieces(problem):
        x[first + 1 : last], u[first + 1 : last], taken, left = minimise(limited_rows(problem, first, last))
        steps, gap = steps + taken, max(gap, left)
        if gap > MOST_GAP:
            status = Status.ITERATION_LIMIT
            return failed_plan(problem, status, METHOD, status.sentence, -1, figures())
    return jerk_plan(problem, x, u, METHOD, figures())


def unless_still(problem: TimeScalingProblem, method: str) -> Plan | None:
    """Return a failed plan if there is a grid point at which the robot cannot stand still with some slack, else None.

    Args:
        problem: the problem.
        method: name of the method.
    """
    wrong = problem.c.max(axis=1, initial=-1.0) > -LEAST_SLACK
    if not wrong.any():
        return None
    stuck = int(np.argmax(wrong))
    name = problem.row_names[int(np.argmax(problem.c[stuck]))]
    message = (
        "With jerk limits, the robot must be able to stand still everywhere on the path; at s = "
        f"{problem.s[stuck]:.4g} it cannot, because of {name}."
    )
    return failed_plan(problem, Status.FAILED, method, message, stuck, {})


def pieces(problem: TimeScalingProblem) -> list[tuple[int, int]]:
    """Return the first and the last grid point of each piece from rest to rest.

    Args:
        problem: the problem.
    """
    stops = np.flatnonzero(problem.ds == 0.0)
    return list(zip([0, *(stops + 1).tolist()], [*stops.tolist(), len(problem.s) - 1], strict=True))


def limited_rows(problem: TimeScalingProblem, first: int, last: int) -> PieceRows:
    """Return the rows of the piece between two rests.

    On the first interval the rate k is constant, so u = 2 x / (3 ds) and k = 2 sd^3 / (9 ds^2) at its end. The jerk is
    at most sd^3 (|q'''| + 2 |q''| / ds + 2 |q'| / (9 ds^2)), which bounds x. The last interval is its mirror image.

    Args:
        problem: the problem.
        first: grid point at the start.
        last: grid point at the end.
    """
    path, s, jerk = problem.path, problem.s[first : last + 1], problem.robot.limits.jerk
    chosen = np.isfinite(jerk)
    ds = np.diff(s)
    inside = np.clip(PLACES, JERK_INSIDE, 1.0 - JERK_INSIDE)
    places = s[:-1, None] + inside * ds[:, None]
    piece = np.full(places.size, problem.piece[first])
    q1, q2, q3 = (
        path.evaluate(places.ravel(), piece, order)[:, chosen].reshape(*places.shape, -1) / jerk[chosen]
        for order in (1, 2, 3)
    )
    x_max = problem.x_max[first + 1 : last].copy()
    for end in (0, -1):
        largest1, largest2, largest3 = (np.abs(values[end]).max(axis=0) for values in (q1, q2, q3))
        gain = largest3 + 2.0 * largest2 / ds[end] + 2.0 * largest1 / (9.0 * ds[end] ** 2)
        with np.errstate(divide="ignore"):  # joints that do not move have no jerk
            x_max[end] = min(x_max[end], gain.max() ** (-2.0 / 3.0))
    a, b, c = (np.ascontiguousarray(rows[first + 1 : last]) for rows in (problem.a, problem.b, problem.c))
    ends, between = np.array([ds[0], ds[-1]]), ds[1:-1].copy()
    return PieceRows(a, b, c, x_max, ends, between, *(np.ascontiguousarray(q[1:-1]) for q in (q1, q2, q3)))


def minimise(rows: PieceRows) -> tuple[Array, Array, int, float]:
    """Return the timing of a piece of least duration, and how it was found.

    Args:
        rows: the rows; x = u = 0 satisfies them with some slack.

    Returns:
        x and u at the inner points (n,), the number of Newton steps, and the gap as a fraction of the duration.
    """
    x, u = slow_timing(rows)
    n = len(x)
    newton = Newton(np.zeros((n, 2)), np.zeros((n, 3)), np.zeros((n - 1, 2, 2)))
    slacks = 3 * rows.a.size + n + 2 * rows.q3.size
    h, reach = _measures(rows, x, u)
    weight, steps = slacks / (FIRST_GAP * float(durations(rows, h, x).sum())), 0
    centre, gap = (x, u), np.inf
    while steps < STEPS and gap > ACCURACY:
        duration = derivatives(rows, h, reach, x, u, weight, newton)
        dx, du = _step(rows, h, x, u, newton)
        steps += 1
        decrement = -float(newton.gradient[:, 0] @ dx + newton.gradient[:, 1] @ du)
        size, value = 1.0, barrier(rows, h, reach, x, u, weight)
        while size > SHORTEST_STEP:
            enough = value - 0.01 * size * decrement + SHORTEST_STEP * abs(value)
            if barrier(rows, h, reach, x + size * dx, u + size * du, weight) <= enough:
                x, u = x + size * dx, u + size * du
                break
            size *= 0.5
        if size <= SHORTEST_STEP or (gap < MOST_GAP and np.abs(_residual(rows, h, x, u)).max() > MOST_RESIDUAL):
            break  # rounding errors leave nothing to gain
        if abs(decrement) < CENTRED:
            x, u, h, reach = _consistent(rows, x, u, barrier(rows, h, reach, x, u, 0.0) + ROOM)
            centre, gap = (x, u), slacks / (weight * duration)
            weight *= SHARPEN
    x, u, _, _ = _consistent(rows, *centre, np.finfo(float).max)
    return x, u, steps, gap


def _measures(rows: PieceRows, x: Array, u: Array) -> tuple[Array, Array]:
    """Return h of the intervals between points (n - 1,), and r at their places (n - 1, 3)."""
    speed = np.sqrt(x)
    mean = 0.5 * (speed[:-1] + speed[1:])
    dt = interval_times(rows.ds, mean, np.diff(u))
    middle = np.sqrt(0.5 * (x[:-1] + x[1:]))
    return mean * dt, np.stack([speed[:-1] * dt, middle * dt, speed[1:] * dt], axis=1)


def _corrected(rows: PieceRows, x: Array, u: Array) -> tuple[Array, Array, Array, Array]:
    """Return x, u that satisfy the equations of the intervals with their own h, and h and r."""
    for _ in range(MOST_CORRECTIONS):
        h, reach = _measures(rows, x, u)
        if np.abs(_residual(rows, h, x, u)).max() <= CONSISTENT:
            break
        dx, du = _step(rows, h, x, u, None)
        x, u = x + dx, u + du
    return x, u, h, reach


def _consistent(rows: PieceRows, x: Array, u: Array, most: float) -> tuple[Array, Array, Array, Array]:
    """Return x, u that satisfy the equations of the intervals with their own h, and h and r.

    The timing is slowed down until the barrier of a weight of 0 is at most `most`.
    """
    x, u, h, reach = _corrected(rows, x, u)
    slower = SLOWER
    while not barrier(rows, h, reach, x, u, 0.0) <= most:
        x, u = x * (1.0 - slower), u * (1.0 - slower)
        slower = min(2.0 * slower, 0.5)
    return x, u, h, reach


def slow_timing(rows: PieceRows) -> tuple[Array, Array]:
    """Return a timing (x, u) of a piece that uses at most the part USED of its limits, (n,) each.

    It has the shape s = 10 t^3 - 15 t^4 + 6 t^5, from rest to rest with sdd = 0 at both ends.

    Args:
        rows: the rows; x = u = 0 satisfies them with some slack.
    """
    ds = np.concatenate([rows.ends[:1], rows.ds, rows.ends[1:]])
    length = ds.sum()
    ahead, left = np.cumsum(ds)[:-1] / length, np.cumsum(ds[::-1])[-2::-1] / length
    near = np.where(ahead < 0.5, _time_of(ahead), _time_of(left))
    rate = length * 30.0 * near**2 * (1.0 - near) ** 2
    x = rate**2
    u = np.where(ahead < 0.5, 1.0, -1.0) * length * (60.0 * near - 180.0 * near**2 + 120.0 * near**3)
    x, u, h, reach = _corrected(rows, x, u)
    used = ((rows.a * u[:, None] + rows.b * x[:, None]) / -rows.c).max(initial=0.0)
    part = USED / max(used, float((x / rows.x_max).max()))
    x, u = part * x, part * u
    while not np.isfinite(barrier(rows, h, reach, x, u, 0.0)):
        x, u = 0.5 * x, 0.5 * u
    return x, u


def _time_of(s: Array) -> Array:
    """Return t in [0, 1/2] with s = 10 t^3 - 15 t^4 + 6 t^5, by Newton's method from t = (s / 10)^(1/3)."""
    t = np.cbrt(s / 10.0)
    for _ in range(MOST_CORRECTIONS):
        t = np.minimum(t - (10.0 * t**3 - 15.0 * t**4 + 6.0 * t**5 - s) / (30.0 * t**2 * (1.0 - t) ** 2), 0.5)
    return t


def _residual(rows: PieceRows, h: Array, x: Array, u: Array) -> Array:
    """Return the residual of the equations of the intervals, each as a fraction of its smaller x, (n + 1,)."""
    first, last = rows.ends
    off = np.empty(len(x) + 1)
    off[0], off[-1] = first * u[0] - 2.0 / 3.0 * x[0], last * u[-1] + 2.0 / 3.0 * x[-1]
    off[1:-1] = np.diff(x) - h * (u[:-1] + u[1:])
    return off / _smaller(x)


def _smaller(x: Array) -> Array:
    """Return the smaller x at the ends of each interval, or the one that is not at rest, (n + 1,)."""
    return np.concatenate([x[:1], np.minimum(x[:-1], x[1:]), x[-1:]])


def _step(rows: PieceRows, h: Array, x: Array, u: Array, newton: Newton | None) -> tuple[Array, Array]:
    """Return the Newton step (dx, du), or without derivatives the least relative change that satisfies the equations.

    The unknowns of the banded system are in the order of the path: multiplier, dx, du, multiplier, ... Each is divided
    by a size that it has near rest, x itself and x / s for u.
    """
    n = len(x)
    first, last = rows.ends
    away = np.minimum(first + np.r_[0.0, np.cumsum(rows.ds)], last + np.r_[np.cumsum(rows.ds[::-1])[::-1], 0.0])
    size = np.stack([x, x / away], axis=1)
    if newton is None:
        gradient, own, after = np.zeros((n, 2)), np.tile([1.0, 0.0, 1.0], (n, 1)), np.zeros((n - 1, 2, 2))
    else:
        gradient = newton.gradient * size
        own = newton.own * np.stack([size[:, 0] ** 2, size[:, 0] * size[:, 1], size[:, 1] ** 2], axis=1)
        after = newton.next * size[:-1, :, None] * size[1:, None, :]
    band, right = np.zeros((2 * BAND + 1, 3 * n + 1)), np.empty(3 * n + 1)
    at = 3 * np.arange(n)

    def put(row: Indices | int, column: Indices | int, values: Array | float) -> None:
        band[BAND + row - column, column] = values
        band[BAND + column - row, row] = values

    put(at + 1, at + 1, own[:, 0])
    put(at + 1, at + 2, own[:, 1])
    put(at + 2, at + 2, own[:, 2])
    for j in range(2):
        for k in range(2):
            put(at[:-1] + 1 + j, at[1:] + 1 + k, after[:, j, k])
    scale = _smaller(x)
    between, inner = at[1:], scale[1:-1]
    put(0, 1, -2.0 / 3.0 * size[0, 0] / scale[0])
    put(0, 2, first * size[0, 1] / scale[0])
    put(3 * n, 3 * n - 2, 2.0 / 3.0 * size[-1, 0] / scale[-1])
    put(3 * n, 3 * n - 1, last * size[-1, 1] / scale[-1])
    put(between, between - 2, -size[:-1, 0] / inner)
    put(between, between - 1, -h * size[:-1, 1] / inner)
    put(between, between + 1, size[1:, 0] / inner)
    put(between, between + 2, -h * size[1:, 1] / inner)
    right[at + 1], right[at + 2] = -gradient[:, 0], -gradient[:, 1]
    right[np.append(at, 3 * n)] = -_residual(rows, h, x, u)
    found = solve_banded((BAND, BAND), band, right, overwrite_ab=True, overwrite_b=True, check_finite=False)
    return size[:, 0] * found[at + 1], size[:, 1] * found[at + 2]
