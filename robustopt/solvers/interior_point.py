"""Interior point: the convex minimum-time program on given rows, to full accuracy, compiled.

    minimise  sum_i 2 ds_i / (sqrt(x_i) + sqrt(x_{i+1}))   such that  slack = -(G x + h) >= 0

Every row of G touches two neighbouring x, so the Newton matrix of the logarithmic barrier is tridiagonal and a step
costs a few operations per row. At the centre for a weight w of the duration, n rows leave a gap of at most n / w to
the optimum (Boyd and Vandenberghe, Convex Optimization, section 11.2).
"""

from __future__ import annotations

import numpy as np

from robustopt.compiled import compiled

STEPS = 200
"""Largest number of Newton steps; about fifty are usual."""

FIRST_GAP, ACCURACY, SHARPEN = 1e-2, 1e-8, 20.0
"""First and last gap, as fractions of the duration, and the factor by which the weight grows in between."""

CENTRED = 1e-2
"""Squared Newton decrement below which the weight grows: the next centre is a few steps away."""

START = 0.98
"""Factor on x of the feasible timing at the start: a slower timing of the same path has slack in every row."""

LEAST_START = 1e-9
"""Smallest x at the start, as a fraction of the largest x of the feasible timing."""

RELAXED = 2e-9
"""Relaxation of rows, as a fraction of their limits: twice the tolerance of `reachability.passes`."""

LEAST_PRODUCT = 1e-100
"""Smallest product of slacks of which one logarithm is taken: a further factor leaves it far from underflow."""

SHORTEST = 1e-12
"""Share of a step at which the search for a better timing along it ends."""

TO_BOUNDARY = 0.95
"""Share of the way to the nearest bound that a step may take."""


@compiled()
def _rows(a, b, c, x_max, ds, free):
    """Return the rows G1 x_i + G2 x_{i+1} + h <= 0 of the intervals and of the bounds of x, and the index i of each."""
    P, m = a.shape
    G1, G2, h, at = (
        np.empty(2 * P * m + P),
        np.empty(2 * P * m + P),
        np.empty(2 * P * m + P),
        np.empty(2 * P * m + P, np.int64),
    )
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
        if free[i]:
            G1[n], G2[n], h[n], at[n] = 1.0 / x_max[i], 0.0, -1.0, i
            n += 1
    return G1[:n], G2[:n], h[:n], at[:n]


@compiled()
def _derivatives(x, ds, gradient, diagonal, off):
    """Compute the gradient and the tridiagonal Hessian of the duration; return the duration."""
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


@compiled()
def _solve_tridiagonal(diagonal, off, right, free, work, out):
    """Solve a symmetric tridiagonal system over the free entries; the others stay 0."""
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


@compiled()
def _slacks(G1, G2, h, at, x, slack):
    """Compute slack = -(G x + h); return its smallest entry."""
    least = np.inf
    for k in range(len(at)):
        slack[k] = -(G1[k] * x[at[k]] + G2[k] * x[at[k] + 1] + h[k])
        least = min(least, slack[k])
    return least


@compiled()
def _barrier(x, ds, slack, weight):
    """Return the value of the barrier, weight * duration - sum log slack."""
    value, product = 0.0, 1.0
    for i in range(len(ds)):
        if ds[i] > 0.0:
            value += weight * 2.0 * ds[i] / (np.sqrt(x[i]) + np.sqrt(x[i + 1]))
    for k in range(len(slack)):  # a logarithm of several factors, as long as their product has full accuracy
        product *= slack[k]
        if not LEAST_PRODUCT < product < 1.0 / LEAST_PRODUCT:
            value -= np.log(product)
            product = 1.0
    return value - np.log(product)


@compiled()
def _add_barrier(G1, G2, at, slack, weight, gradient, diagonal, off):
    """Turn the derivatives of the duration into the derivatives of the barrier."""
    gradient *= weight
    diagonal *= weight
    off *= weight
    for k in range(len(at)):
        i, w = at[k], 1.0 / slack[k]
        gradient[i] += w * G1[k]
        gradient[i + 1] += w * G2[k]
        diagonal[i] += w * w * G1[k] * G1[k]
        diagonal[i + 1] += w * w * G2[k] * G2[k]
        off[i] += w * w * G1[k] * G2[k]


@compiled()
def _step_inside(G1, G2, at, x, dx, slack, free):
    """Return the length of the step dx, at most 1, that keeps away from all bounds."""
    step = 1.0
    for i in range(len(x)):
        if free[i] and dx[i] < 0.0:
            step = min(step, -TO_BOUNDARY * x[i] / dx[i])
    for k in range(len(at)):
        closing = G1[k] * dx[at[k]] + G2[k] * dx[at[k] + 1]
        if closing > 0.0:
            step = min(step, TO_BOUNDARY * slack[k] / closing)
    return step


@compiled()
def polish(a, b, c, x_max, ds, feasible, free):
    """Find the minimum-time timing on some rows, starting from a feasible timing.

    If the slower timing has no slack, for example because the robot could not stand still, the rows are relaxed by
    RELAXED and the start is the feasible timing. If that has no slack either, it is returned with an infinite gap.

    Args:
        a: coefficients of u (P, m).
        b: coefficients of x (P, m).
        c: constants (P, m).
        x_max: largest x, 0 at rest (P,).
        ds: interval lengths, 0 at stops (P - 1,).
        feasible: a feasible timing x (P,).
        free: whether x may change (P,).

    Returns:
        The timing x (P,), and a bound on the excess of its duration over the optimum [s].
    """
    P = len(feasible)
    G1, G2, h, at = _rows(a, b, c, x_max, ds, free)
    n = len(at)
    least = LEAST_START * feasible.max()
    x = np.where(free, np.maximum(START * feasible, least), feasible)
    slack, trial = np.empty(n), np.empty(n)
    if _slacks(G1, G2, h, at, x, slack) <= 0.0:
        h -= RELAXED
        x[:] = np.where(free, np.maximum(feasible, least), feasible)
        if _slacks(G1, G2, h, at, x, slack) <= 0.0:
            return feasible, np.inf
    gradient, diagonal, off = np.zeros(P), np.zeros(P), np.zeros(P)
    work, dx = np.zeros(P), np.zeros(P)
    duration = _derivatives(x, ds, gradient, diagonal, off)
    weight = n / (FIRST_GAP * duration)
    value = _barrier(x, ds, slack, weight)
    for _ in range(STEPS):
        duration = _derivatives(x, ds, gradient, diagonal, off)
        _add_barrier(G1, G2, at, slack, weight, gradient, diagonal, off)
        _solve_tridiagonal(diagonal, off, -gradient, free, work, dx)
        decrement = -np.dot(gradient, dx)
        step = _step_inside(G1, G2, at, x, dx, slack, free)
        after = value
        while step > SHORTEST:
            enough = value - 0.01 * step * decrement + 1e-12 * abs(value)
            if _slacks(G1, G2, h, at, x + step * dx, trial) > 0.0:
                after = _barrier(x + step * dx, ds, trial, weight)
                if after <= enough:
                    break
            step *= 0.5
        x += step * dx
        if step > SHORTEST:
            slack, trial, value = trial, slack, after
        else:
            _slacks(G1, G2, h, at, x, slack)
            value = _barrier(x, ds, slack, weight)
        if decrement < CENTRED:
            if n / weight <= ACCURACY * duration:
                break
            weight *= SHARPEN
            value = _barrier(x, ds, slack, weight)
    return x, n / weight
