"""Interior-point method for the cone programs of force closure, compiled.

Every program has n second-order cones of three coordinates, a matrix A_i (3, rows) for each, and one variable g >= 0:

    min g  s.t.  sum_i A_i^T f_i - g rest = move,  f_i in the cone of point i,
    max -y move  s.t.  s_i = A_i y in the (self-dual) cone of point i,  s_g = 1 - y rest >= 0.

Nesterov-Todd scaling W of each cone, with W^-1 f = W s, and Mehrotra's predictor and corrector lead to normal equations
of the size of y. The first coordinate of a cone, |(c_1, c_2)| <= c_0, is its axis.
"""

from __future__ import annotations

import numpy as np

from robustopt.compiled import compiled, compiled_inner

MOST_ITERATIONS = 60
"""Largest number of iterations; ten are usual."""

BACK_OFF = 0.99
"""Length of a step, as a share of the distance to the boundary of the cones."""

REGULAR = 1e-14
"""Smallest pivot of the normal equations as a share of their trace: a patch that is a line or a point has no stiffness
in some directions."""

WORSE = 100.0
"""Growth of the error over the best iterate at which rounding errors have the upper hand."""


@compiled_inner(error_model="numpy")
def _seen(A, y, out):
    """Compute A_i y (n, 3)."""
    for i in range(A.shape[0]):
        for k in range(3):
            total = 0.0
            for r in range(len(y)):
                total += A[i, k, r] * y[r]
            out[i, k] = total


@compiled_inner(error_model="numpy")
def _subtract_pressed(A, c, out):
    """Subtract sum_i A_i^T c_i (rows,)."""
    for i in range(A.shape[0]):
        for k in range(3):
            for r in range(len(out)):
                out[r] -= A[i, k, r] * c[i, k]


@compiled_inner(error_model="numpy")
def _inner(a, b):
    """Return the sum of the products of all entries of two matrices (n, 3)."""
    total = 0.0
    for i in range(a.shape[0]):
        total += a[i, 0] * b[i, 0] + a[i, 1] * b[i, 1] + a[i, 2] * b[i, 2]
    return total


@compiled_inner(error_model="numpy")
def _square(c, i):
    """Return c_0^2 - c_1^2 - c_2^2 of cone i, positive inside it."""
    return c[i, 0] ** 2 - c[i, 1] ** 2 - c[i, 2] ** 2


@compiled_inner(error_model="numpy")
def _find_scaling(f, s, w):
    """Compute the direction (3) and the size of the scaling of each cone, (n, 4)."""
    for i in range(f.shape[0]):
        f_size, s_size = np.sqrt(_square(f, i)), np.sqrt(_square(s, i))
        both = 0.0
        for k in range(3):
            both += f[i, k] / f_size * s[i, k] / s_size
        half = np.sqrt(2.0 * (1.0 + both))
        w[i, 0] = (f[i, 0] / f_size + s[i, 0] / s_size) / half
        w[i, 1] = (f[i, 1] / f_size - s[i, 1] / s_size) / half
        w[i, 2] = (f[i, 2] / f_size - s[i, 2] / s_size) / half
        w[i, 3] = np.sqrt(f_size / s_size)


@compiled_inner(error_model="numpy")
def _scale(w, c, sign, out):
    """Compute sign W c (n, 3), possibly in place."""
    for i in range(w.shape[0]):
        c0, c1, c2, eta = c[i, 0], c[i, 1], c[i, 2], sign * w[i, 3]
        along = w[i, 1] * c1 + w[i, 2] * c2
        factor = c0 + along / (1.0 + w[i, 0])
        out[i, 0] = eta * (w[i, 0] * c0 + along)
        out[i, 1] = eta * (c1 + w[i, 1] * factor)
        out[i, 2] = eta * (c2 + w[i, 2] * factor)


@compiled_inner(error_model="numpy")
def _factorise(A, w, root, rest, column, M):
    """Compute the lower Cholesky factor of sum_i A_i^T W_i^2 A_i + root^2 rest rest^T, (rows, rows)."""
    rows = len(rest)
    for r in range(rows):
        for q in range(r + 1):
            M[r, q] = root * rest[r] * root * rest[q]
    for i in range(A.shape[0]):
        w0, w1, w2, eta = w[i, 0], w[i, 1], w[i, 2], w[i, 3]
        lean = 1.0 / (1.0 + w0)
        for r in range(rows):
            a0, a1, a2 = A[i, 0, r], A[i, 1, r], A[i, 2, r]
            along = w1 * a1 + w2 * a2
            factor = a0 + along * lean
            column[0, r] = eta * (w0 * a0 + along)
            column[1, r] = eta * (a1 + w1 * factor)
            column[2, r] = eta * (a2 + w2 * factor)
        for r in range(rows):
            for q in range(r + 1):
                M[r, q] += column[0, r] * column[0, q] + column[1, r] * column[1, q] + column[2, r] * column[2, q]
    trace = 0.0
    for r in range(rows):
        trace += M[r, r]
    for j in range(rows):
        for k in range(j):
            for r in range(j, rows):
                M[r, j] -= M[r, k] * M[j, k]
        pivot = np.sqrt(max(M[j, j], REGULAR * trace))
        M[j, j] = pivot
        for r in range(j + 1, rows):
            M[r, j] /= pivot


@compiled_inner(error_model="numpy")
def _solve(M, x):
    """Solve L L^T x = x in place."""
    rows = len(x)
    for i in range(rows):
        for k in range(i):
            x[i] -= M[i, k] * x[k]
        x[i] /= M[i, i]
    for i in range(rows - 1, -1, -1):
        for k in range(i + 1, rows):
            x[i] -= M[k, i] * x[k]
        x[i] /= M[i, i]


@compiled_inner(error_model="numpy")
def _longest(c, d, c_g, d_g):
    """Return the largest a with c_i + a d_i in every cone and c_g + a d_g >= 0, for c inside, (n, 3)."""
    longest = -c_g / d_g if d_g < 0.0 else np.inf
    for i in range(c.shape[0]):
        bend, inside = _square(d, i), max(_square(c, i), 0.0)
        if bend >= 0.0 and d[i, 0] >= 0.0:
            continue
        cross = c[i, 0] * d[i, 0] - c[i, 1] * d[i, 1] - c[i, 2] * d[i, 2]
        root = np.sqrt(max(cross * cross - bend * inside, 0.0))
        if cross < 0.0:
            longest = min(longest, inside / (root - cross))
        elif bend < 0.0:
            longest = min(longest, (cross + root) / -bend)
    return longest


@compiled_inner(error_model="numpy")
def _correct(v, target, f, s):
    """Turn scaled steps f into q with v o q = target e - v o v - f o s; o is the Jordan product of the cone, (n, 3)."""
    for i in range(v.shape[0]):
        c0, c1, c2 = v[i, 0], v[i, 1], v[i, 2]
        both = c0 * c0 + c1 * c1 + c2 * c2 + f[i, 0] * s[i, 0] + f[i, 1] * s[i, 1] + f[i, 2] * s[i, 2]
        r0 = target - both
        r1 = -2.0 * c0 * c1 - f[i, 0] * s[i, 1] - f[i, 1] * s[i, 0]
        r2 = -2.0 * c0 * c2 - f[i, 0] * s[i, 2] - f[i, 2] * s[i, 0]
        q0 = (c0 * r0 - c1 * r1 - c2 * r2) / _square(v, i)
        f[i, 0], f[i, 1], f[i, 2] = q0, (r1 - c1 * q0) / c0, (r2 - c2 * q0) / c0


@compiled_inner(error_model="numpy")
def _find_step(A, w, M, rest, root, residual, f, g, y, s, work):
    """Compute the Newton step y, and turn the scaled right-hand sides f, g into the steps f, g, s; return g and s_g."""
    for r in range(len(y)):
        y[r] = residual[r] + rest[r] * root * g
    _scale(w, f, 1.0, work)
    _subtract_pressed(A, work, y)
    _solve(M, y)
    _seen(A, y, s)
    _scale(w, s, -1.0, s)
    s_g = 0.0
    for r in range(len(y)):
        s_g += root * rest[r] * y[r]
    for i in range(f.shape[0]):
        for k in range(3):
            f[i, k] -= s[i, k]
    return g - s_g, s_g


@compiled_inner(error_model="numpy")
def _left(v, v_g, f, g, s, s_g, a, b, product):
    """Return the share of the complementarity that the corrector aims at, by Mehrotra's rule."""
    left = (v_g + a * g) * (v_g + b * s_g)
    for i in range(v.shape[0]):
        for k in range(3):
            left += (v[i, k] + a * f[i, k]) * (v[i, k] + b * s[i, k])
    return (max(left, 0.0) / product) ** 3


@compiled_inner(error_model="numpy")
def _iterate(A, rest, f, s, g, s_g, y, residual, product, v, df, ds, dy, w, column, M, work):
    """Take one predictor and one corrector step in f and y; return g."""
    root, v_g = np.sqrt(g / s_g), np.sqrt(g * s_g)
    _find_scaling(f, s, w)
    _scale(w, s, 1.0, v)
    _factorise(A, w, root, rest, column, M)
    for i in range(f.shape[0]):
        for k in range(3):
            df[i, k] = -v[i, k]
    dg, ds_g = _find_step(A, w, M, rest, root, residual, df, -v_g, dy, ds, work)
    a, b = min(1.0, _longest(v, df, v_g, dg)), min(1.0, _longest(v, ds, v_g, ds_g))
    target = _left(v, v_g, df, dg, ds, ds_g, a, b, product) * product / (1 + f.shape[0])
    _correct(v, target, df, ds)
    right = (target - dg * ds_g) / v_g - v_g
    dg, ds_g = _find_step(A, w, M, rest, root, residual, df, right, dy, ds, work)
    a = min(1.0, BACK_OFF * _longest(v, df, v_g, dg))
    b = min(1.0, BACK_OFF * _longest(v, ds, v_g, ds_g))
    _scale(w, df, a, df)
    for i in range(f.shape[0]):
        for k in range(3):
            f[i, k] += df[i, k]
    for r in range(len(y)):
        y[r] -= b * dy[r]
    return g + a * root * dg


@compiled_inner(error_model="numpy")
def _inside(c):
    """Return whether every c_i lies inside its cone."""
    inside = True
    for i in range(c.shape[0]):
        inside &= _square(c, i) > 0.0
    return inside


@compiled_inner(error_model="numpy")
def _measure(A, rest, move, weight, f, g, y, s, residual):
    """Compute slacks and residual; return s_g, the dual value, the complementarity and the size of the residual."""
    _seen(A, y, s)
    s_g, lower, size = 1.0, 0.0, 0.0
    for r in range(len(y)):
        s_g -= rest[r] * y[r]
        lower -= move[r] * y[r]
        residual[r] = move[r] + g * rest[r]
    _subtract_pressed(A, f, residual)
    for r in range(len(y)):
        size += (weight[r] * residual[r]) ** 2
    return s_g, lower, g * s_g + _inner(f, s), np.sqrt(size)


@compiled_inner(error_model="numpy")
def _solve_one(A, rest, move, inside, weight, enough, rules, best_y, left_over, y, dy, residual, cones, column, M):
    """Solve one program; return g, its lower bound, and g of the best iterate."""
    gap, accepted, balanced, most = rules
    f, s, v, df, ds, work, w = cones
    up = 0.0
    for r in range(len(y)):
        up += inside[r] * rest[r]
    pressing = up > 0.0
    up = up if pressing else 1.0
    for r in range(len(y)):
        y[r] = best_y[r] = 0.5 * inside[r] / up
        left_over[r] = 0.0
    if not pressing:
        return np.inf, np.inf, np.inf
    for i in range(f.shape[0]):
        f[i, 0], f[i, 1], f[i, 2] = up / f.shape[0], 0.0, 0.0
    g, value, bound, reached, least = 1.0, np.inf, 0.0, np.inf, np.inf
    for _ in range(MOST_ITERATIONS):
        s_g, lower, product, unbalanced = _measure(A, rest, move, weight, f, g, y, s, residual)
        done = unbalanced < balanced * (1.0 + g) and g <= enough
        error = np.maximum(unbalanced, g - lower) / (1.0 + g)
        if done or error < least:
            value = g if done or error < accepted else np.inf
            reached = g
            for r in range(len(y)):
                best_y[r], left_over[r] = y[r], residual[r]
        bound = max(bound, lower)
        stuck = not (_inside(f) and _inside(s) and s_g > 0.0 and error <= WORSE * least)
        least = min(least, error)
        if done or error < gap or lower > most or stuck:
            break
        g = _iterate(A, rest, f, s, g, s_g, y, residual, product, v, df, ds, dy, w, column, M, work)
    return value, bound, reached


@compiled(error_model="numpy")
def solve(A, rest, move, inside, weight, enough, rules):
    """Solve T programs.

    A program that breaks down at the limit of numerical precision ends with its best iterate.

    Args:
        A: matrices of the cones (T or 1, n, 3, rows).
        rest: reference (T, rows).
        move: rows that the motion adds (T, rows).
        inside: direction strictly inside the dual cones of all points (rows,).
        weight: units of the residual of each row (T or 1, rows).
        enough: g below which a program may stop once forces balance (T,).
        rules: error below which a program is solved; error below which the best iterate counts as a solution; residual
            below which forces balance; lower bound of g above which a program stops.

    Returns:
        g (T,), infinite without a solution; lower bound of g (T,); y (T, rows); g (T,) and residual (T, rows) of the
        best iterate.
    """
    T, rows, n = rest.shape[0], rest.shape[1], A.shape[1]
    value, lower, reached = np.empty(T), np.empty(T), np.empty(T)
    best_y, left_over = np.empty((T, rows)), np.empty((T, rows))
    cones = (
        np.empty((n, 3)),
        np.empty((n, 3)),
        np.empty((n, 3)),
        np.empty((n, 3)),
        np.empty((n, 3)),
        np.empty((n, 3)),
        np.empty((n, 4)),
    )
    y, dy, residual, column, M = (
        np.empty(rows),
        np.empty(rows),
        np.empty(rows),
        np.empty((3, rows)),
        np.empty((rows, rows)),
    )
    for t in range(T):
        own, unit = A[t if len(A) > 1 else 0], weight[t if len(weight) > 1 else 0]
        value[t], lower[t], reached[t] = _solve_one(
            own,
            rest[t],
            move[t],
            inside,
            unit,
            enough[t],
            rules,
            best_y[t],
            left_over[t],
            y,
            dy,
            residual,
            cones,
            column,
            M,
        )
    return value, lower, best_y, reached, left_over
