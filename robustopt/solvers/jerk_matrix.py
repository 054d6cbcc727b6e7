"""Newton matrix of the jerk-limited program with the equations of the intervals, its factors, and solution; compiled.

The unknowns, in the order of the path, are the multiplier of the first equation, x, u, the next multiplier, and so on,
so the matrix is banded. The rows of the equations contain the derivatives of h, see `jerk_newton`; the columns of their
multipliers do not. If the robot moves at an end, its x and u are given there: their rows, and the one of the equation
that would describe the interval from rest, are those of a step of 0.
"""

from __future__ import annotations

import numpy as np

from robustopt.compiled import compiled_inner

BAND = 4
"""Number of diagonals of the Newton matrix above, and below, the main one."""

STEEPEST = 0.1
"""Least root of the equation for dt, as a part of the mean speed, in its derivatives: they have no bound."""


@compiled_inner(error_model="numpy")
def off_rows(program, z, work, right):
    """Set the rows of the equations of the intervals on the right side; return their largest residual.

    Each is a fraction of the smaller x of its interval, or of the one that is not at rest.
    """
    n, worst = len(program.away), 0.0
    for i in range(n + 1):
        if (i == 0 or i == n) and program.ends[min(i, 1)] == 0.0:
            off = 0.0
        elif i == 0:
            off = (program.ends[0] * z[1] - 2.0 / 3.0 * z[0]) / z[0]
        elif i == n:
            off = (program.ends[1] * z[2 * n - 1] + 2.0 / 3.0 * z[2 * n - 2]) / z[2 * n - 2]
        else:
            p = 2 * i
            off = (z[p] - z[p - 2] - work.h[i - 1] * (z[p - 1] + z[p + 1])) / min(z[p], z[p - 2])
        right[3 * i] = -off
        worst = max(worst, abs(off))
    return worst


@compiled_inner(error_model="numpy")
def factorise(program, z, work, matrix):
    """Factorise the Newton matrix with the equations of the intervals, by elimination with row exchanges.

    x is divided by its value, and u by x and by the distance from the nearer rest: near rest they become small.
    """
    n, band = len(program.away), work.band
    band[:] = 0.0
    for i in range(n):
        x, r = z[2 * i], 3 * i + 1
        w = x / program.away[i]
        put(band, r, r, matrix[i, 0] * x * x)
        put(band, r, r + 1, matrix[i, 1] * x * w)
        put(band, r + 1, r + 1, matrix[i, 2] * w * w)
        if i == 0:
            put(band, 0, 1, -2.0 / 3.0)
            put(band, 0, 2, program.ends[0] * w / x)
        if i == n - 1:
            put(band, r + 2, r, 2.0 / 3.0)
            put(band, r + 2, r + 1, program.ends[1] * w / x)
            continue
        x_next = z[2 * i + 2]
        w_next, scale, h = x_next / program.away[i + 1], min(x, x_next), work.h[i]
        put(band, r, r + 3, matrix[i, 3] * x * x_next)
        put(band, r, r + 4, matrix[i, 4] * x * w_next)
        put(band, r + 1, r + 3, matrix[i, 5] * w * x_next)
        put(band, r + 1, r + 4, matrix[i, 6] * w * w_next)
        put(band, r + 2, r, -x / scale)
        put(band, r + 2, r + 1, -h * w / scale)
        put(band, r + 2, r + 3, x_next / scale)
        put(band, r + 2, r + 4, -h * w_next / scale)
        change_of_h(
            band[r + 2], z[2 * i : 2 * i + 4], work.dt[i + 1], h, x / scale, w / scale, x_next / scale, w_next / scale
        )
    for end in range(2):
        if program.ends[end] == 0.0:
            first = end * (3 * n - 2)
            band[first : first + 3] = 0.0
            band[first : first + 3, BAND] = 1.0
    eliminate(band, work.lower, work.pivot)


@compiled_inner(error_model="numpy")
def change_of_h(row, z, dt, h, x, w, x_next, w_next):
    """Add the derivatives of h to the row of the equation of an interval, times the units of its four unknowns."""
    mean = h / dt
    root = max(mean - (z[3] - z[1]) * dt / 6.0, STEEPEST * mean)
    both = z[1] + z[3]
    per_mean, per_change = 0.25 * both * (dt - h / root), both * h * dt / (12.0 * root)
    row[BAND - 2] -= x * per_mean / np.sqrt(z[0])
    row[BAND - 1] += w * per_change
    row[BAND + 1] -= x_next * per_mean / np.sqrt(z[2])
    row[BAND + 2] -= w_next * per_change


@compiled_inner(error_model="numpy")
def put(band, row, column, value):
    """Set an element of a symmetric matrix."""
    band[row, BAND + column - row] = value
    band[column, BAND + row - column] = value


@compiled_inner(error_model="numpy")
def eliminate(band, lower, pivot):
    """Factorise a banded matrix in place."""
    size = len(band)
    for k in range(size):
        last, best = min(k + BAND, size - 1), k
        for r in range(k + 1, last + 1):
            if abs(band[r, BAND + k - r]) > abs(band[best, BAND + k - best]):
                best = r
        pivot[k] = best
        if best != k:
            for j in range(2 * BAND + 1):
                at = BAND + k - best + j
                band[k, BAND + j], band[best, at] = band[best, at], band[k, BAND + j]
        for r in range(k + 1, last + 1):
            factor = band[r, BAND + k - r] / band[k, BAND]
            lower[k, r - k - 1] = factor
            if factor != 0.0:
                for j in range(1, 2 * BAND + 1):
                    band[r, BAND + k - r + j] -= factor * band[k, BAND + j]


@compiled_inner(error_model="numpy")
def solve_factorised(program, z, work, right, step):
    """Solve for the step of z, with the right side in the units of the rows; `right` is overwritten."""
    n, band, size = len(program.away), work.band, len(right)
    for i in range(n):
        right[3 * i + 1] *= z[2 * i]
        right[3 * i + 2] *= z[2 * i] / program.away[i]
    for end in range(2):
        if program.ends[end] == 0.0:
            right[end * (3 * n - 2) : end * (3 * n - 2) + 3] = 0.0
    for k in range(size):
        best = work.pivot[k]
        right[k], right[best] = right[best], right[k]
        for r in range(k + 1, min(k + BAND, size - 1) + 1):
            right[r] -= work.lower[k, r - k - 1] * right[k]
    for k in range(size - 1, -1, -1):
        for j in range(1, min(2 * BAND, size - 1 - k) + 1):
            right[k] -= band[k, BAND + j] * right[k + j]
        right[k] /= band[k, BAND]
    for i in range(n):
        step[2 * i] = right[3 * i + 1] * z[2 * i]
        step[2 * i + 1] = right[3 * i + 2] * z[2 * i] / program.away[i]
    for end in range(2):
        if program.ends[end] == 0.0:
            step[end * (2 * n - 2) : end * (2 * n - 2) + 2] = 0.0
