"""Jerk-limited timing: the minimum-time program in which sdd is continuous and changes at a constant rate per interval.

sdd is 0 at every rest. The rows a u + b x + c <= 0 hold at every grid point with its own u, and at both ends of every
interval with the mean of its u, as without jerk limits: they keep u from alternating about a point at which a limit
does not depend on u. Each piece of the path, from one rest to the next, is a program of its own in (x, u) = (sd^2, sdd)
at its inner grid points, see `jerk_newton`. The jerk of a joint is q''' sd^3 + 3 q'' sd sdd + q' sddd. It is limited at
both ends and in the middle of every interval, and at more places where q''' bends in between.

A primal-dual interior-point method finds a local minimum, from a slow timing of the piece (our choice).
"""

from __future__ import annotations

import time

import numpy as np

from robustopt.arrays import Array, Indices
from robustopt.limits import TimeScalingProblem
from robustopt.solvers.binding import JERK_INSIDE
from robustopt.solvers.jerk_newton import Program, Work, correct, optimise, workspace
from robustopt.solvers.plan import Plan, Status, failed_plan, jerk_plan

STEPS = 150
"""Largest number of Newton steps on a piece, before it is tried once more with all curvature; 15 to 50 are usual."""

FIRST_GAP, ACCURACY = 10.0, 2e-6
"""First and last gap, as fractions of the duration."""

USED = 0.5
"""Part of each limit that the timing at the start uses."""

MOST_CORRECTIONS = 20
"""Largest number of Newton steps to a timing that satisfies the equations of the intervals; three are usual."""

CONSISTENT = 1e-12
"""Residual of the equations of the intervals, as a fraction of x, that rounding errors leave."""

PLACES = np.linspace(0.0, 1.0, 9)
"""Places within an interval at which jerk may be limited; x and u are interpolated there."""

USUAL = np.isin(np.arange(9), (0, 4, 8))
"""Whether jerk is limited at each place of every interval."""

BENT = 5e-3
"""Part of its limit by which the jerk at the velocity limit may differ from the parabola through the usual places,
before it is limited at all places: half of what a certificate accepts."""

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
        if left > ACCURACY:
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


def limited_rows(problem: TimeScalingProblem, first: int, last: int) -> Program:
    """Return the program of the piece between two rests.

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
    places = s[:-1, None] + np.clip(PLACES, JERK_INSIDE, 1.0 - JERK_INSIDE) * ds[:, None]
    piece = np.full(places.size, problem.piece[first])
    q1, q2, q3 = (
        path.evaluate(places.ravel(), piece, order)[:, chosen].reshape(*places.shape, -1) / jerk[chosen]
        for order in (1, 2, 3)
    )
    x_max = problem.x_max[first + 1 : last].copy()
    limited = _limited_places(q1[1:-1], q3[1:-1], np.maximum(x_max[:-1], x_max[1:]))
    for end in (0, -1):
        largest1, largest2, largest3 = (np.abs(values[end]).max(axis=0) for values in (q1, q2, q3))
        gain = largest3 + 2.0 * largest2 / ds[end] + 2.0 * largest1 / (9.0 * ds[end] ** 2)
        with np.errstate(divide="ignore"):  # joints that do not move have no jerk
            x_max[end] = min(x_max[end], gain.max() ** (-2.0 / 3.0))
    a, b, c = (rows[first + 1 : last] for rows in (problem.a, problem.b, problem.c))
    return Program(
        np.array([ds[0], ds[-1]]),
        ds[1:-1].copy(),
        np.minimum(s[1:-1] - s[0], s[-1] - s[1:-1]),
        *_lines(a / -c, b / -c, x_max),
        limited[0],
        PLACES[limited[1]],
        *(q[1:-1][limited] for q in (q1, q2, q3)),
    )


def _limited_places(q1: Array, q3: Array, fastest: Array) -> tuple[Indices, ...]:
    """Return the intervals between points, places and joints at which jerk is limited, (k,) each.

    Args:
        q1: q' / J at all places of these intervals (n - 1, 9, joints).
        q3: q''' / J there.
        fastest: largest x on each interval (n - 1,).
    """
    from_start, middle = 1.0 - PLACES[:, None], 4.0 * (PLACES * (1.0 - PLACES))[:, None]
    parabola = (
        q3[:, :1] * from_start * (1.0 - 2.0 * PLACES[:, None])
        + q3[:, 4:5] * middle
        + q3[:, 8:] * PLACES[:, None] * (2.0 * PLACES[:, None] - 1.0)
    )
    bent = np.abs(q3 - parabola).max(axis=1) * fastest[:, None] ** 1.5 > BENT
    moving = np.abs(q1).max(axis=(0, 1)) > 0.0
    return np.nonzero((USUAL[:, None] | bent[:, None]) & moving)


def _lines(a: Array, b: Array, x_max: Array) -> tuple[Indices, Array]:
    """Return the linear limits: rows a u + b x <= 1 of the points, with u and with the means, and x <= x_max.

    Args:
        a: coefficients of u (n, m).
        b: coefficients of x (n, m).
        x_max: largest x (n,).

    Returns:
        First of the two points that each limit depends on (l,), and its coefficients of x, u, x', u' (l, 4).
    """
    n, point, line = len(x_max), [np.arange(len(x_max))], [np.zeros((len(x_max), 4))]
    line[0][:, 0] = -1.0 / x_max
    at, k = np.nonzero((a != 0.0) | (b != 0.0))
    own = np.zeros((len(at), 4))
    own[:, 0], own[:, 1] = -b[at, k], -a[at, k]
    point.append(at)
    line.append(own)
    at, k = np.nonzero(a)
    for end in (0, 1):
        here = (at >= end) & (at - end < n - 1)
        mean = np.zeros((np.count_nonzero(here), 4))
        mean[:, 2 * end] = -b[at, k][here]
        mean[:, 1] = mean[:, 3] = -0.5 * a[at, k][here]
        point.append(at[here] - end)
        line.append(mean)
    return np.concatenate(point), np.concatenate(line)


def minimise(program: Program) -> tuple[Array, Array, int, float]:
    """Return the timing of a piece of least duration, and how it was found.

    Args:
        program: the program; x = u = 0 satisfies its limits with some slack.

    Returns:
        x and u at the inner points (n,), the number of Newton steps, and the gap as a fraction of the duration,
        infinite if the steps did not suffice.
    """
    start, work, steps = slow_timing(program), workspace(program), 0
    for least in (0.0, 1.0):
        z = start.copy()
        taken, gap = optimise(program, z, work, FIRST_GAP, ACCURACY, STEPS, least)
        steps += taken
        if taken < STEPS:
            break
    else:
        gap = np.inf
    correct(program, z, work, MOST_CORRECTIONS, CONSISTENT)
    z /= max(1.0, _excess(program, work, 1.0))
    return z[:-2:2], z[1:-2:2], steps, gap


def _excess(program: Program, work: Work, part: float) -> float:
    """Return the number by which x and u of a timing must be divided so that it uses at most a part of all limits.

    Args:
        program: the program.
        work: its values at the timing.
        part: the part.
    """
    lines, step = len(program.line), work.dt[program.jerk_point + 1]
    used = 1.0 - float(work.g[:lines].min())
    jerk = 1.0 - float((work.g[lines:].reshape(-1, 2).min(axis=1) / step).min(initial=1.0))
    return max(used / part, (jerk / part) ** (2.0 / 3.0))


def slow_timing(program: Program) -> Array:
    """Return a timing of a piece that uses at most the part USED of its limits, (2 n + 2,), see `Program`.

    It has the shape s = 10 t^3 - 15 t^4 + 6 t^5, from rest to rest with sdd = 0 at both ends.

    Args:
        program: the program; x = u = 0 satisfies its limits with some slack.
    """
    ds = np.concatenate([program.ends[:1], program.ds, program.ends[1:]])
    length = ds.sum()
    ahead, left = np.cumsum(ds)[:-1] / length, np.cumsum(ds[::-1])[-2::-1] / length
    near = np.where(ahead < 0.5, _time_of(ahead), _time_of(left))
    z = np.zeros(2 * len(near) + 2)
    z[:-2:2] = (length * 30.0 * near**2 * (1.0 - near) ** 2) ** 2
    z[1:-2:2] = np.where(ahead < 0.5, 1.0, -1.0) * length * (60.0 * near - 180.0 * near**2 + 120.0 * near**3)
    work = workspace(program)
    correct(program, z, work, MOST_CORRECTIONS, CONSISTENT)
    return z / _excess(program, work, USED)


def _time_of(s: Array) -> Array:
    """Return t in [0, 1/2] with s = 10 t^3 - 15 t^4 + 6 t^5, by Newton's method from t = (s / 10)^(1/3)."""
    t = np.cbrt(s / 10.0)
    for _ in range(MOST_CORRECTIONS):
        t = np.minimum(t - (10.0 * t**3 - 15.0 * t**4 + 6.0 * t**5 - s) / (30.0 * t**2 * (1.0 - t) ** 2), 0.5)
    return t
