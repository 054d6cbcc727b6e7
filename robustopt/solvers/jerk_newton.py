"""Primal-dual interior-point method for the jerk-limited program on one piece of a path, compiled.

The unknowns are x = sd^2 and u = sdd at the n points between the two rests of the piece. On an interval, u changes at a
constant rate from u to u' in the time dt, which with the equations of the intervals follows from

    dt = 2 h / (sqrt(x) + sqrt(x')),   h = ds + (u' - u) dt^2 / 12,   x' - x = (u + u') h,

and h differs little from the length ds. On the first interval the rate is constant from rest, so dt = 3 ds / sqrt(x')
and u' = 2 x' / (3 ds); the last one is its mirror image. If the robot moves at an end of the piece, this end is a point
too, with x and u given, and there is no such interval. The jerk of a joint at a place of an interval is within J if

    dt -+ ((q''' x + 3 q'' u) r + q' (u' - u)) / J >= 0,   r = sqrt(x) dt,

with x and u interpolated there. The derivatives take h and r as constants: r hardly changes if a timing becomes faster
or slower as a whole. Only the steps towards the equations of the intervals count the derivatives of h. Then the only
curved term is dt. It is convex in (x, x'). The Newton matrix counts its curvature in the duration less that in the jerk
limits, but at least the part by which the smaller of x and x' falls short of the larger one: near rest, steps would
otherwise go too far (our choice).

Each step of Mehrotra's method solves the linearised conditions of optimality twice with one factorisation: for the
centre whose gap is 0, and for a centre with a gap that depends on how far the first step leads. The slacks s of all
limits g >= 0 are unknowns too, so a step need not stay within the limits.

If x and u are given at an end, there may be no timing, or the limits may leave a single one. Therefore each limit may
then be exceeded at a high cost, see `jerk_slacks`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from robustopt.arrays import Array, Indices
from robustopt.compiled import compiled, compiled_inner
from robustopt.solvers.jerk_matrix import BAND, factorise, off_rows, solve_factorised
from robustopt.solvers.jerk_slacks import Slacks, centre, left_gap, longest_of_limits, state

TO_BORDER = 0.95
"""Part of the way to the first slack or multiplier, or x, that becomes 0, of a step."""


class Program(NamedTuple):
    """Program on one piece with n points; z is x, u of the first point, of the second, ..., 0, 0.

    Ends of the piece at which the robot moves are among the points.

    Attributes:
        ends: lengths of the first interval from rest and of the last one to rest, 0 if the robot moves there (2,).
        ds: lengths of the other intervals (n - 1,).
        away: distance of each point from the nearer rest, or a like length near a moving end (n,).
        line_point: first of the two points that each linear limit depends on (l,).
        line: coefficients of x, u, x', u' in g = 1 + line z (l, 4).
        jerk_point: point at the start of the interval of each limit of a jerk (k,).
        place: its place within the interval, from 0 to 1 (k,).
        q1, q2, q3: q', q'' and q''' of the joint there, divided by its jerk limit (k,).
    """

    ends: Array
    ds: Array
    away: Array
    line_point: Indices
    line: Array
    jerk_point: Indices
    place: Array
    q1: Array
    q2: Array
    q3: Array


class Work(NamedTuple):
    """Values at the current timing.

    Attributes:
        dt: time of each interval (n + 1,) [s].
        h: mean length of the intervals between points (n - 1,).
        g: limits g >= 0, first the linear ones, then each jerk from above and below (m,).
        point: first of the two points that each limit depends on (m,).
        slope: derivatives of g with respect to x, u, x', u' (m, 4).
        band: Newton matrix, then its factors, (3 n + 1, 3 BAND + 1).
        lower: multipliers of the elimination (3 n + 1, BAND).
        pivot: row that was exchanged with each row (3 n + 1,).
    """

    dt: Array
    h: Array
    g: Array
    point: Indices
    slope: Array
    band: Array
    lower: Array
    pivot: Indices


def workspace(program: Program) -> Work:
    """Return room for the values of a program.

    Args:
        program: the program.
    """
    size = 3 * len(program.away) + 1
    point = np.concatenate([program.line_point, np.repeat(program.jerk_point, 2)])
    slope = np.concatenate([program.line, np.empty((2 * len(program.place), 4))])
    return Work(
        dt=np.empty(len(program.ds) + 2),
        h=np.empty(len(program.ds)),
        g=np.empty(len(point)),
        point=point,
        slope=slope,
        band=np.empty((size, 3 * BAND + 1)),
        lower=np.empty((size, BAND)),
        pivot=np.empty(size, dtype=np.int64),
    )


@compiled_inner(error_model="numpy")
def measure(program, z, work):
    """Set the times, h, the limits and their derivatives at a timing.

    Args:
        program: the program.
        z: the timing (2 n + 2,).
        work: its values are set.
    """
    n, lines = len(program.away), len(program.line_point)
    dt, g, slope = work.dt, work.g, work.slope
    dt[0], dt[n] = 3.0 * program.ends[0] / np.sqrt(z[0]), 3.0 * program.ends[1] / np.sqrt(z[2 * n - 2])
    for i in range(n - 1):
        mean, ds = 0.5 * (np.sqrt(z[2 * i]) + np.sqrt(z[2 * i + 2])), program.ds[i]
        root = np.sqrt(max(mean * mean - (z[2 * i + 3] - z[2 * i + 1]) * ds / 3.0, 0.0))
        dt[i + 1] = 2.0 * ds / (mean + root)
        work.h[i] = mean * dt[i + 1]
    for k in range(lines):
        p = 2 * program.line_point[k]
        g[k] = 1.0 + slope[k, 0] * z[p] + slope[k, 1] * z[p + 1] + slope[k, 2] * z[p + 2] + slope[k, 3] * z[p + 3]
    for k in range(len(program.jerk_point)):
        i, after = program.jerk_point[k], program.place[k]
        p, step, before = 2 * i, dt[i + 1], 1.0 - after
        here, change = before * z[p] + after * z[p + 2], z[p + 3] - z[p + 1]
        reach = np.sqrt(here) * step
        per_x, per_u = program.q3[k] * reach, 3.0 * program.q2[k] * reach
        jerk = per_x * here + per_u * (before * z[p + 1] + after * z[p + 3]) + program.q1[k] * change
        v, v_next = np.sqrt(z[p]), np.sqrt(z[p + 2])
        fall = 0.5 * step / (v + v_next)
        for side in range(2):
            sign, row = 1.0 - 2.0 * side, lines + 2 * k + side
            g[row] = step - sign * jerk
            slope[row, 0] = -fall / v - sign * before * per_x
            slope[row, 1] = -sign * (before * per_u - program.q1[k])
            slope[row, 2] = -fall / v_next - sign * after * per_x
            slope[row, 3] = -sign * (after * per_u + program.q1[k])


@compiled(error_model="numpy")
def optimise(program, z, work, gap, accuracy, most, least, penalty):
    """Improve a timing until it is optimal.

    Args:
        program: the program.
        z: the timing (2 n + 2,), within the limits if `penalty` is infinite; becomes the optimal one, up to `accuracy`.
        work: its values are set.
        gap: gap at the start as a fraction of the duration.
        accuracy: gap, and error of all conditions, at the end.
        most: largest number of steps.
        least: least part of the curvature of the duration that is counted; 1 takes more steps and never overshoots.
        penalty: cost of an excess by a whole limit, in durations at the start; infinite if no limit may be exceeded.

    Returns:
        The number of steps and the gap at the end.
    """
    n, m = len(program.away), len(work.g)
    measure(program, z, work)
    pairs = m if np.isinf(penalty) else 2 * m
    limits = Slacks(work.g.copy(), np.empty(m), np.zeros(m), np.full(m, np.inf), np.empty(m), np.empty(m), np.zeros(m))
    centre(program, work, limits, gap * work.dt.sum(), pairs, penalty)
    gradient, matrix = np.empty(2 * n + 2), np.empty((n, 8))
    right, step = np.empty(3 * n + 1), np.zeros(2 * n + 2)
    aim, aim_over = np.empty(m), np.zeros(m)
    for steps in range(most):
        total = work.dt.sum()
        gap, wrong = state(program, z, work, limits, right)
        gap /= total
        if gap <= accuracy and wrong <= accuracy:
            return steps, gap
        newton_matrix(program, z, work, limits, least, gradient, matrix)
        factorise(program, z, work, matrix)
        aim[:] = 0.0
        aim_over[:] = 0.0
        for corrector in range(2):
            newton_step(program, z, work, limits, aim, aim_over, gradient, right, step)
            primal, other = longest(z, step), 1.0
            primal, other = longest_of_limits(limits, primal, other)
            if not corrector:
                left = left_gap(limits, primal, other) / total
                wanted = gap * total / pairs * max((left / gap) ** 3, 1e-3)
                for k in range(m):
                    aim[k] = wanted - limits.d_slack[k] * limits.d_dual[k]
                    if pairs > m:
                        aim_over[k] = wanted + limits.d_over[k] * limits.d_dual[k]
        primal, other = min(TO_BORDER * primal, 1.0), min(TO_BORDER * other, 1.0)
        for j in range(2 * n):
            z[j] += primal * step[j]
        for k in range(m):
            limits.slack[k] += primal * limits.d_slack[k]
            limits.dual[k] += other * limits.d_dual[k]
            limits.over[k] += primal * limits.d_over[k]
        measure(program, z, work)
    return most, gap


@compiled_inner(error_model="numpy")
def longest(z, step):
    """Return the part of a step after which the first x is 0, at most 1 / TO_BORDER."""
    part = 1.0 / TO_BORDER
    for i in range(0, len(z) - 2, 2):
        if step[i] < 0.0:
            part = min(part, -z[i] / step[i])
    return part


@compiled_inner(error_model="numpy")
def newton_matrix(program, z, work, limits, least, gradient, matrix):
    """Set the gradient of the duration, and the Newton matrix.

    Its columns are xx, xu, uu, those of x, u with x', u', and the part of the curvature of dt that counts.
    """
    n, lines = len(program.away), len(program.line_point)
    dt, dual = work.dt, limits.dual
    gradient[:], matrix[:] = 0.0, 0.0
    curved = matrix[:, 7]
    curved[:] = 1.0
    for k in range(lines, len(dual)):
        curved[work.point[k]] -= dual[k]
    for end in range(2):
        i = end * (n - 1)
        gradient[2 * i] -= 0.5 * dt[end * n] / z[2 * i]
        matrix[i, 0] += 0.75 * dt[end * n] / (z[2 * i] * z[2 * i])
    for i in range(n - 1):
        v, v_next = np.sqrt(z[2 * i]), np.sqrt(z[2 * i + 2])
        both = v + v_next
        fall, fall_next = 0.5 * dt[i + 1] / (both * v), 0.5 * dt[i + 1] / (both * v_next)
        gradient[2 * i] -= fall
        gradient[2 * i + 2] -= fall_next
        ratio = min(z[2 * i], z[2 * i + 2]) / max(z[2 * i], z[2 * i + 2])
        part = max(curved[i], 1.0 - ratio, least)
        matrix[i, 0] += part * 0.5 * fall / v * (2.0 / both + 1.0 / v)
        matrix[i + 1, 0] += part * 0.5 * fall_next / v_next * (2.0 / both + 1.0 / v_next)
        matrix[i, 3] += part * fall / (both * v_next)
    for k in range(len(dual)):
        room = limits.slack[k]
        if limits.over[k] > 0.0:
            room += dual[k] * limits.over[k] / (limits.bound[k] - dual[k])
        i, weight = work.point[k], dual[k] / room
        a, b, c, d = work.slope[k]
        matrix[i, 0] += weight * a * a
        matrix[i, 1] += weight * a * b
        matrix[i, 2] += weight * b * b
        if c != 0.0 or d != 0.0:
            matrix[i, 3] += weight * a * c
            matrix[i, 4] += weight * a * d
            matrix[i, 5] += weight * b * c
            matrix[i, 6] += weight * b * d
            matrix[i + 1, 0] += weight * c * c
            matrix[i + 1, 1] += weight * c * d
            matrix[i + 1, 2] += weight * d * d


@compiled_inner(error_model="numpy")
def newton_step(program, z, work, limits, aim, aim_over, gradient, right, step):
    """Set the step of z, and those of slacks, multipliers and excesses towards the products `aim` and `aim_over`."""
    n, slack, dual, over = len(program.away), limits.slack, limits.dual, limits.over
    off_rows(program, z, work, right)
    for i in range(n):
        right[3 * i + 1], right[3 * i + 2] = -gradient[2 * i], -gradient[2 * i + 1]
    for k in range(len(slack)):
        i, room, off = work.point[k], slack[k], work.g[k] - slack[k]
        if over[k] > 0.0:
            spare = limits.bound[k] - dual[k]
            room += dual[k] * over[k] / spare
            off = work.g[k] - room + aim_over[k] / spare
        pull = (aim[k] - dual[k] * off) / room
        right[3 * i + 1] += pull * work.slope[k, 0]
        right[3 * i + 2] += pull * work.slope[k, 1]
        if i < n - 1:
            right[3 * i + 4] += pull * work.slope[k, 2]
            right[3 * i + 5] += pull * work.slope[k, 3]
    solve_factorised(program, z, work, right, step)
    for k in range(len(slack)):
        p = 2 * work.point[k]
        limits.d_slack[k] = work.g[k] - slack[k]
        for j in range(4):
            limits.d_slack[k] += work.slope[k, j] * step[p + j]
        if over[k] == 0.0:
            limits.d_dual[k] = (aim[k] - dual[k] * limits.d_slack[k]) / slack[k] - dual[k]
            continue
        spare = limits.bound[k] - dual[k]
        change = dual[k] * over[k] / spare
        off = limits.d_slack[k] - change + aim_over[k] / spare
        limits.d_dual[k] = (aim[k] - dual[k] * off) / (slack[k] + change) - dual[k]
        limits.d_over[k] = (aim_over[k] + over[k] * limits.d_dual[k]) / spare - over[k]
        limits.d_slack[k] += over[k] + limits.d_over[k]


@compiled(error_model="numpy")
def correct(program, z, work, most, accuracy):
    """Change a timing as little as possible so that it satisfies the equations of the intervals with their own h.

    Args:
        program: the program.
        z: the timing (2 n + 2,), changed.
        work: its values become those of the timing.
        most: largest number of steps; three are usual.
        accuracy: residual that is left, as a fraction of x.

    Returns:
        The residual.
    """
    n = len(program.away)
    right, step, matrix = np.empty(3 * n + 1), np.zeros(2 * n + 2), np.empty((n, 8))
    for _ in range(most):
        measure(program, z, work)
        off = off_rows(program, z, work, right)
        if off <= accuracy:
            return off
        matrix[:] = 0.0
        for i in range(n):
            right[3 * i + 1] = right[3 * i + 2] = 0.0
            matrix[i, 0], matrix[i, 2] = 1.0 / z[2 * i] ** 2, (program.away[i] / z[2 * i]) ** 2
        factorise(program, z, work, matrix)
        solve_factorised(program, z, work, right, step)
        z += step
    measure(program, z, work)
    return off_rows(program, z, work, right)
