"""Interior point: the convex minimum-time program on given rows, to full accuracy, compiled.

    minimise  sum_i 2 ds_i / (sqrt(x_i) + sqrt(x_{i+1}))   such that  G x + h + slack = 0,  slack >= 0

Every row of G touches two neighbouring x, so the Newton matrix H + G^T diag(lambda / slack) G is tridiagonal and a step
costs a few operations per row (primal-dual method with the centring of Mehrotra's rule; our choice of method).
"""

from __future__ import annotations

import numba as nb
import numpy as np

Array = np.ndarray

STEPS = 80
"""Most Newton steps; about twenty are needed."""

ACCURACY = 1e-9
"""Duality gap, as a fraction of the duration, at which the method stops."""

START = 0.98
"""The start is the feasible timing with x scaled by this: a slower timing of the same path has slack in every row."""

TO_BOUNDARY = 0.995
"""Share of the way to the nearest bound that a step may take."""


@nb.njit(cache=True)
def _rows(a, b, c, x_max, ds):  # type: ignore[no-untyped-def]
    """Rows G1 x_i + G2 x_{i+1} + h <= 0 of the intervals, and of the bounds of x, with the index i of each."""
    P, m = a.shape
    G1, G2, h, at = np.empty(2 * P * m + P), np.empty(2 * P * m + P), np.empty(2 * P * m + P), np.empty(2 * P * m + P, np.int64)
    n = 0
    for i in range(P - 1):
        if ds[i] == 0.0:
            continue
        gain = 0.5 / ds[i]
        for end in range(2):
            for k in range(m):
                slope = a[i + end, k] * gain
                if a[i + end, k] == 0.0 and b[i + end, k] == 0.0:
                    continue
                G1[n] = -slope + (b[i, k] if end == 0 else 0.0)
                G2[n] = slope + (b[i + 1, k] if end == 1 else 0.0)
                h[n] = c[i + end, k]
                at[n] = i
                n += 1
    for i in range(P - 1):
        if x_max[i] > 0.0:
            G1[n], G2[n], h[n], at[n] = 1.0 / x_max[i], 0.0, -1.0, i
            n += 1
    return G1[:n], G2[:n], h[:n], at[:n]


@nb.njit(cache=True)
def _derivatives(x, ds, gradient, diagonal, off):  # type: ignore[no-untyped-def]
    """Gradient and tridiagonal Hessian of the duration. Returns the duration."""
    P = len(x)
    gradient[:], diagonal[:], off[:] = 0.0, 0.0, 0.0
    total = 0.0
    for i in range(P - 1):
        if ds[i] == 0.0:
            continue
        p, q = np.sqrt(x[i]), np.sqrt(x[i + 1])
        t = 2.0 * ds[i] / (p + q)
        total += t
        rate = t / (p + q)
        if p > 0.0:
            gradient[i] -= 0.5 * rate / p
            diagonal[i] += 0.25 * rate / (p * p) * (2.0 / (p + q) + 1.0 / p)
        if q > 0.0:
            gradient[i + 1] -= 0.5 * rate / q
            diagonal[i + 1] += 0.25 * rate / (q * q) * (2.0 / (p + q) + 1.0 / q)
        if p > 0.0 and q > 0.0:
            off[i] += 0.5 * rate / (p + q) / (p * q)
    return total


@nb.njit(cache=True)
def _solve_tridiagonal(diagonal, off, right, free, work, out):  # type: ignore[no-untyped-def]
    """Symmetric tridiagonal system over the free entries; the others stay 0."""
    P = len(right)
    for i in range(P):
        pivot, value = diagonal[i], right[i]
        if not free[i]:
            work[i], out[i] = 1.0, 0.0
            continue
        if i > 0 and free[i - 1]:
            factor = off[i - 1] / work[i - 1]
            pivot -= factor * off[i - 1]
            value -= factor * out[i - 1]
        work[i], out[i] = pivot, value
    for i in range(P - 1, -1, -1):
        if free[i]:
            after = off[i] * out[i + 1] if i + 1 < P and free[i + 1] else 0.0
            out[i] = (out[i] - after) / work[i]


@nb.njit(cache=True)
def _direction(G1, G2, at, gradient, diagonal, off, free, residual, slack, dual, target, d2, o2, right, work, dx, ds_, dl):  # type: ignore[no-untyped-def]
    """Newton step of the perturbed optimality conditions: dx, d slack, d lambda."""
    n = len(at)
    d2[:], o2[:] = diagonal, off
    right[:] = -gradient
    for k in range(n):
        i, w = at[k], dual[k] / slack[k]
        d2[i] += w * G1[k] * G1[k]
        d2[i + 1] += w * G2[k] * G2[k]
        o2[i] += w * G1[k] * G2[k]
        force = dual[k] + (target[k] - dual[k] * slack[k] + dual[k] * residual[k]) / slack[k]
        right[i] -= force * G1[k]
        right[i + 1] -= force * G2[k]
    _solve_tridiagonal(d2, o2, right, free, work, dx)
    for k in range(n):
        i = at[k]
        ds_[k] = -residual[k] - G1[k] * dx[i] - G2[k] * dx[i + 1]
        dl[k] = (target[k] - dual[k] * slack[k] - dual[k] * ds_[k]) / slack[k]


@nb.njit(cache=True)
def _longest(value, step):  # type: ignore[no-untyped-def]
    longest = 1.0
    for k in range(len(value)):
        if step[k] < 0.0:
            longest = min(longest, -TO_BOUNDARY * value[k] / step[k])
    return longest


@nb.njit(cache=True)
def polish(a, b, c, x_max, ds, feasible):  # type: ignore[no-untyped-def]
    """Minimum-time x (P,) on the rows from a feasible one, or the feasible one itself where no better was found."""
    P = len(feasible)
    G1, G2, h, at = _rows(a, b, c, x_max, ds)
    n = len(at)
    free = x_max > 0.0
    x = np.where(free, np.maximum(START * feasible, 1e-9 * x_max), 0.0)
    slack, dual, residual, target = np.empty(n), np.empty(n), np.empty(n), np.empty(n)
    gradient, diagonal, off = np.zeros(P), np.zeros(P), np.zeros(P)
    d2, o2, right, work, dx = np.zeros(P), np.zeros(P), np.zeros(P), np.zeros(P), np.zeros(P)
    dslack, ddual = np.empty(n), np.empty(n)
    duration = _derivatives(x, ds, gradient, diagonal, off)
    for k in range(n):
        value = G1[k] * x[at[k]] + G2[k] * x[at[k] + 1] + h[k]
        slack[k] = max(-value, 1e-4)
        dual[k] = 1e-2 * duration / n / slack[k]
    for _ in range(STEPS):
        duration = _derivatives(x, ds, gradient, diagonal, off)
        gap, worst = 0.0, 0.0
        for k in range(n):
            residual[k] = G1[k] * x[at[k]] + G2[k] * x[at[k] + 1] + h[k] + slack[k]
            gap += slack[k] * dual[k]
            worst = max(worst, abs(residual[k]))
        if gap <= ACCURACY * duration and worst <= 1e-11:
            break
        target[:] = 0.0
        _direction(G1, G2, at, gradient, diagonal, off, free, residual, slack, dual, target, d2, o2, right, work, dx, dslack, ddual)
        primal, second = min(_longest(slack, dslack), _longest(x, dx)), _longest(dual, ddual)
        after = 0.0
        for k in range(n):
            after += (slack[k] + primal * dslack[k]) * (dual[k] + second * ddual[k])
        centre = (after / gap) ** 3 * gap / n
        for k in range(n):
            target[k] = centre - dslack[k] * ddual[k]
        _direction(G1, G2, at, gradient, diagonal, off, free, residual, slack, dual, target, d2, o2, right, work, dx, dslack, ddual)
        primal, second = min(_longest(slack, dslack), _longest(x, dx)), _longest(dual, ddual)
        x += primal * dx
        for k in range(n):
            slack[k] += primal * dslack[k]
            dual[k] += second * ddual[k]
    return x
