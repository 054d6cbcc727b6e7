"""Barrier of the jerk-limited program on one piece of a path: value and derivatives, compiled.

The unknowns are x = sd^2 and u = sdd at the n points between the two rests of the piece. On an interval, u changes at a
constant rate from u to u' in the time

    dt = 2 h / (sqrt(x) + sqrt(x')),   h = ds + (u' - u) dt^2 / 12,

and h differs little from the length ds. On the first interval the rate is constant from rest, so dt = 3 ds / sqrt(x').
The slacks of the program are

    -(a u + b x + c)                                   for each row of a point,
    -(a (u + u') / 2 + b x + c)                        for each row at both ends of each interval, with its mean sdd,
    1 - x / x_max                                      for each point,
    dt -+ ((q''' x + 3 q'' u) r + q' (u' - u)) / J     for each joint at both ends and in the middle of each interval,
                                                      with r = sqrt(x) dt.

The rows of the mean keep u from alternating about a point at which a limit does not depend on u. The last slack is that
of the limit J on a joint's jerk, times dt / J. While the barrier of a given weight is minimised, h and r are constants;
r hardly changes if a timing becomes faster or slower as a whole. Then the only curved term of a jerk row is dt. It is
convex in (x, x'), above its tangents, so the Newton matrix leaves its curvature out and stays positive definite.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from robustopt.arrays import Array
from robustopt.compiled import compiled

PLACES = (0.0, 0.5, 1.0)
"""Places within an interval at which jerk is limited; x and u are interpolated there."""


class PieceRows(NamedTuple):
    """Rows of the program on one piece, with n points between the rests and k joints that have a jerk limit.

    Attributes:
        a, b, c: rows a u + b x + c <= 0 of the points (n, m).
        x_max: largest x (n,).
        ends: lengths of the first and of the last interval (2,).
        ds: lengths of the other intervals (n - 1,).
        q1, q2, q3: q', q'' and q''' / J at the places `PLACES` of the intervals between the points (n - 1, 3, k).
    """

    a: Array
    b: Array
    c: Array
    x_max: Array
    ends: Array
    ds: Array
    q1: Array
    q2: Array
    q3: Array


class Newton(NamedTuple):
    """Derivatives of the barrier.

    Attributes:
        gradient: with respect to x and u of each point (n, 2).
        own: second derivatives with respect to (x, u) of each point: xx, xu, uu (n, 3).
        next: mixed second derivatives with respect to (x, u) of a point and of the next one (n - 1, 2, 2).
    """

    gradient: Array
    own: Array
    next: Array


@compiled()
def durations(rows, h, x):
    """Return the time of each interval (n + 1,) [s].

    Args:
        rows: the rows.
        h: mean length of each interval between points (n - 1,), see the module.
        x: sd^2 at the points (n,).
    """
    n = len(x)
    dt = np.empty(n + 1)
    dt[0], dt[n] = 3.0 * rows.ends[0] / np.sqrt(x[0]), 3.0 * rows.ends[1] / np.sqrt(x[n - 1])
    for i in range(n - 1):
        dt[i + 1] = 2.0 * h[i] / (np.sqrt(x[i]) + np.sqrt(x[i + 1]))
    return dt


@compiled()
def barrier(rows, h, reach, x, u, weight):
    """Return weight * duration - sum of log slack; infinite if a slack is not positive.

    Args:
        rows: the rows.
        h: mean length of each interval between points (n - 1,).
        reach: r at the places of these intervals (n - 1, 3).
        x: sd^2 at the points (n,).
        u: sdd at the points (n,).
        weight: weight of the duration.
    """
    n = len(x)
    for i in range(n):
        if not x[i] > 0.0:
            return np.inf
    dt = durations(rows, h, x)
    value = 0.0
    for i in range(n + 1):
        value += weight * dt[i]
    for i in range(n):
        for k in range(rows.a.shape[1]):
            slack = -(rows.a[i, k] * u[i] + rows.b[i, k] * x[i] + rows.c[i, k])
            if not slack > 0.0:
                return np.inf
            value -= np.log(slack)
        slack = 1.0 - x[i] / rows.x_max[i]
        if not slack > 0.0:
            return np.inf
        value -= np.log(slack)
    for i in range(n - 1):
        mean = 0.5 * (u[i] + u[i + 1])
        for e in range(2):
            p = i + e
            for k in range(rows.a.shape[1]):
                slack = -(rows.a[p, k] * mean + rows.b[p, k] * x[p] + rows.c[p, k])
                if not slack > 0.0:
                    return np.inf
                value -= np.log(slack)
        for e in range(3):
            part = PLACES[e]
            x_here, u_here = (1.0 - part) * x[i] + part * x[i + 1], (1.0 - part) * u[i] + part * u[i + 1]
            for k in range(rows.q1.shape[2]):
                jerk = (rows.q3[i, e, k] * x_here + 3.0 * rows.q2[i, e, k] * u_here) * reach[i, e]
                jerk += rows.q1[i, e, k] * (u[i + 1] - u[i])
                if not dt[i + 1] > abs(jerk):
                    return np.inf
                value -= np.log(dt[i + 1] - jerk) + np.log(dt[i + 1] + jerk)
    return value


@compiled()
def derivatives(rows, h, reach, x, u, weight, out):
    """Compute the derivatives of the barrier at a point inside, see `barrier`; return the duration [s].

    Args:
        rows: the rows.
        h: mean length of each interval between points (n - 1,).
        reach: r at the places of these intervals (n - 1, 3).
        x: sd^2 at the points (n,).
        u: sdd at the points (n,).
        weight: weight of the duration.
        out: set to the derivatives.
    """
    gradient, own, after = out.gradient, out.own, out.next
    n = len(x)
    gradient[:], own[:], after[:] = 0.0, 0.0, 0.0
    dt = durations(rows, h, x)
    for end in range(2):
        i = end * (n - 1)
        gradient[i, 0] -= weight * 0.5 * dt[end * n] / x[i]
        own[i, 0] += weight * 0.75 * dt[end * n] / (x[i] * x[i])
    _add_points(rows, x, u, gradient, own)
    g, H = np.empty(4), np.empty((4, 4))
    for i in range(n - 1):
        _of_interval(rows, i, reach, x, u, weight, dt[i + 1], g, H)
        for j in range(2):
            gradient[i, j] += g[j]
            gradient[i + 1, j] += g[2 + j]
            own[i, 2 * j] += H[j, j]
            own[i + 1, 2 * j] += H[2 + j, 2 + j]
            for k in range(2):
                after[i, j, k] = H[j, 2 + k]
        own[i, 1] += H[0, 1]
        own[i + 1, 1] += H[2, 3]
    return dt.sum()


@compiled()
def _add_points(rows, x, u, gradient, own):
    """Add the derivatives of the barrier of the rows of the points."""
    for i in range(len(x)):
        for k in range(rows.a.shape[1]):
            a, b = rows.a[i, k], rows.b[i, k]
            w = -1.0 / (a * u[i] + b * x[i] + rows.c[i, k])
            gradient[i, 0] += w * b
            gradient[i, 1] += w * a
            own[i, 0] += w * w * b * b
            own[i, 1] += w * w * a * b
            own[i, 2] += w * w * a * a
        w = 1.0 / (rows.x_max[i] - x[i])
        gradient[i, 0] += w
        own[i, 0] += w * w


@compiled()
def _of_interval(rows, i, reach, x, u, weight, dt, g, H):
    """Set the derivatives g (4,) and H (4, 4), its upper triangle, of interval i with respect to (x, u, x', u')."""
    p, q = np.sqrt(x[i]), np.sqrt(x[i + 1])
    rate = dt / (p + q)
    fall, fall_after = 0.5 * rate / p, 0.5 * rate / q  # minus the slopes of dt
    g[:], H[:] = 0.0, 0.0
    g[0], g[2] = -weight * fall, -weight * fall_after
    H[0, 0] = weight * 0.5 * fall / p * (2.0 / (p + q) + 1.0 / p)
    H[2, 2] = weight * 0.5 * fall_after / q * (2.0 / (p + q) + 1.0 / q)
    H[0, 2] = weight * fall / (p + q) / q
    row, mean = np.empty(4), 0.5 * (u[i] + u[i + 1])
    for e in range(2):
        at = i + e
        for k in range(rows.a.shape[1]):
            half, b = 0.5 * rows.a[at, k], rows.b[at, k]
            w = -1.0 / (2.0 * half * mean + b * x[at] + rows.c[at, k])
            g[1] += w * half
            g[2 * e] += w * b
            g[3] += w * half
            H[1, 1] += w * w * half * half
            H[1, 3] += w * w * half * half
            H[3, 3] += w * w * half * half
            H[2 * e, 2 * e] += w * w * b * b
            H[min(1, 2 * e), max(1, 2 * e)] += w * w * half * b
            H[2 * e, 3] += w * w * half * b
    for e in range(3):
        before, after = 1.0 - PLACES[e], PLACES[e]
        for k in range(rows.q1.shape[2]):
            per_x, per_u = rows.q3[i, e, k] * reach[i, e], 3.0 * rows.q2[i, e, k] * reach[i, e]
            change = rows.q1[i, e, k]
            jerk = per_x * (before * x[i] + after * x[i + 1]) + per_u * (before * u[i] + after * u[i + 1])
            jerk += change * (u[i + 1] - u[i])
            for sign in (1.0, -1.0):
                w = 1.0 / (dt - sign * jerk)
                row[0], row[1] = fall + sign * before * per_x, sign * (before * per_u - change)
                row[2], row[3] = fall_after + sign * after * per_x, sign * (after * per_u + change)
                for j in range(4):
                    g[j] += w * row[j]
                    for m in range(j, 4):
                        H[j, m] += w * w * row[j] * row[m]
