"""Cutting of feasible polygons with rows, compiled: the inner loops of `polygons`, whose types and formula these are.

A family of rows is evaluated at a vertex; the row that is violated most cuts the polygon; and so on until no vertex
violates anything. Two things keep this cheap, and change no result. |B_f| sum_k |W_gk| bounds the interval terms, so
most rows are known to hold after two products instead of one per term. And what binds at one grid point mostly binds
at the next: its rows are tried first, by themselves, so that nearly every look at all rows confirms a vertex.
"""

from __future__ import annotations

import numba as nb
import numpy as np

MAX_VERTICES = 96
"""Most vertices of a polygon while it is cut."""

TOLERANCE = 1e-10
"""Largest violation of a row, relative to the limit, that a vertex of a polygon may keep: ten times rounding error."""

ROUNDING = 1e-14
"""Part of the largest terms of a row in a polygon by which its value at a vertex may be off; this matters only
far from any plan."""


@nb.njit(cache=True, nogil=True)
def _copy(R, L, k, R2, L2, m):
    """Row and name of edge k become those of edge m, without temporary arrays."""
    R2[m, 0], R2[m, 1], R2[m, 2], L2[m] = R[k, 0], R[k, 1], R[k, 2], L[k]


@nb.njit(cache=True, nogil=True)
def _clip(V, R, L, valid, n, a, b, c, name, V2, R2, L2, valid2):
    """Keep the part of a polygon with a u + b x + c <= 0; the new edge takes the row's name. Returns the count."""
    m = 0
    before = a * V[n - 1, 0] + b * V[n - 1, 1] + c
    for k in range(n):
        value = a * V[k, 0] + b * V[k, 1] + c
        if (value > 0.0) != (before > 0.0):
            share = before / (before - value)
            p = k - 1 if k > 0 else n - 1
            for j in range(2):
                V2[m, j] = V[p, j] + share * (V[k, j] - V[p, j])
            valid2[m] = False
            if value > 0.0:
                R2[m, 0], R2[m, 1], R2[m, 2], L2[m] = a, b, c, name
            else:
                _copy(R, L, p, R2, L2, m)
            m += 1
        if value <= 0.0:
            V2[m, 0], V2[m, 1], valid2[m] = V[k, 0], V[k, 1], valid[k]
            _copy(R, L, k, R2, L2, m)
            m += 1
        before = value
    for k in range(m):
        V[k, 0], V[k, 1], valid[k] = V2[k, 0], V2[k, 1], valid2[k]
        _copy(R2, L2, k, R, L, k)
    return m


@nb.njit(cache=True, nogil=True)
def _load(polygons, i, V, R, L):
    """Copy polygon i to where it is cut. Returns its size."""
    n = polygons.sizes[i]
    for k in range(n):
        V[k, 0], V[k, 1] = polygons.vertices[i, k, 0], polygons.vertices[i, k, 1]
        _copy(polygons.rows[i], polygons.names[i], k, R, L, k)
    return n


@nb.njit(cache=True, nogil=True)
def _store(V, R, L, n, result, i):
    """Copy a polygon that has been cut to its place, if there is room for it."""
    result.sizes[i] = n
    if n <= result.names.shape[1]:
        for k in range(n):
            result.vertices[i, k, 0], result.vertices[i, k, 1] = V[k, 0], V[k, 1]
            _copy(R, L, k, result.rows[i], result.names[i], k)


@nb.njit(cache=True, nogil=True)
def cut_rows(polygons, limits, result):
    """Cut with rows that are affine. Returns the size of the largest polygon, or more than MAX_VERTICES."""
    rows, names = limits
    V, V2 = np.empty((MAX_VERTICES, 2)), np.empty((MAX_VERTICES, 2))
    R, R2 = np.empty((MAX_VERTICES, 3)), np.empty((MAX_VERTICES, 3))
    L, L2 = np.empty(MAX_VERTICES, np.int64), np.empty(MAX_VERTICES, np.int64)
    valid, valid2 = np.zeros(MAX_VERTICES, np.bool_), np.zeros(MAX_VERTICES, np.bool_)
    largest = 0
    for i in range(len(polygons.sizes)):
        n = _load(polygons, i, V, R, L)
        for f in range(rows.shape[1]):
            if n >= 3:
                n = _clip(V, R, L, valid, n, rows[i, f, 0], rows[i, f, 1], rows[i, f, 2], names[f], V2, R2, L2, valid2)
            if n > MAX_VERTICES - 2:
                return MAX_VERTICES + 1
        _store(V, R, L, n if n >= 3 else 0, result, i)
        largest = max(largest, n)
    return largest


# The functions below take arrays with indices, not tuples or parts of arrays: numba counts references to the latter,
# which costs more than the arithmetic, most of all where threads share an array.


@nb.njit(cache=True, nogil=True)
def _wrenches(coefficients, i, u, x, out):
    """out[k] = coefficients (P, d, n, 3) of grid point i at (u, x), shape (n, d)."""
    for k in range(coefficients.shape[2]):
        for j in range(coefficients.shape[1]):
            out[k, j] = coefficients[i, j, k, 0] * u + coefficients[i, j, k, 1] * x + coefficients[i, j, k, 2]


@nb.njit(cache=True, nogil=True)
def _add_sizes(wrenches, group, out):
    """out[group[k]] += |wrenches[k]|."""
    for k in range(len(group)):
        for j in range(out.shape[1]):
            out[group[k], j] += abs(wrenches[k, j])


@nb.njit(cache=True, nogil=True, fastmath={"contract"})
def _add_products(columns, wrenches, g, j, out):
    """out += B wrenches[g] for the six columns (d, F) of B from j on; vectorised over the rows."""
    w0, w1, w2 = wrenches[g, j], wrenches[g, j + 1], wrenches[g, j + 2]
    w3, w4, w5 = wrenches[g, j + 3], wrenches[g, j + 4], wrenches[g, j + 5]
    c0, c1, c2 = columns[j], columns[j + 1], columns[j + 2]
    c3, c4, c5 = columns[j + 3], columns[j + 4], columns[j + 5]
    for f in range(len(out)):
        out[f] += w0 * c0[f] + w1 * c1[f] + w2 * c2[f] + w3 * c3[f] + w4 * c4[f] + w5 * c5[f]


@nb.njit(cache=True, nogil=True, fastmath={"contract"})
def _add_scaled(columns, wrenches, g, low, high, values, out):
    """out += scale(v) v, v = values + B wrenches[g] for six columns of B; scale is high if v > 0, else low."""
    w0, w1, w2 = wrenches[g, 0], wrenches[g, 1], wrenches[g, 2]
    w3, w4, w5 = wrenches[g, 3], wrenches[g, 4], wrenches[g, 5]
    c0, c1, c2, c3, c4, c5 = columns[0], columns[1], columns[2], columns[3], columns[4], columns[5]
    for f in range(len(out)):
        v = values[f] + w0 * c0[f] + w1 * c1[f] + w2 * c2[f] + w3 * c3[f] + w4 * c4[f] + w5 * c5[f]
        out[f] += v * (high if v > 0.0 else low)


@nb.njit(cache=True, nogil=True)
def _count_above(values, threshold):
    """How many values are above a threshold."""
    count = 0
    for f in range(len(values)):
        count += 1 if values[f] > threshold else 0
    return count


@nb.njit(cache=True, nogil=True)
def _margin(B, b, f, constant, base_terms, i, group, out):
    """out[f, g] = what the terms that depend on neither u nor x add to row B[b, f] at grid point i."""
    out[f] = 0.0
    for k in range(len(group)):
        product = base_terms[i, f, k] if base_terms.shape[0] else 0.0
        for j in range(B.shape[2]):
            product += B[b, f, j] * constant[i, j, k]
        out[f, group[k]] += abs(product)


@nb.njit(cache=True, nogil=True)
def _value(B, b, f, own, margins, central, swings, group, box, lowest, highest):
    """Value of row B[b, f] for the wrenches W_g0, W_gk and sum_k |R_gk| of a load, every parameter at its worst.

    own: the row's own part
    """
    for g in range(len(lowest)):
        value = margins[f, g]
        for j in range(B.shape[2]):
            value += B[b, f, j] * central[g, j] + abs(B[b, f, j]) * box[g, j]
        for k in range(len(group)):
            if group[k] == g:
                product = 0.0
                for j in range(B.shape[2]):
                    product += B[b, f, j] * swings[k, j]
                value += abs(product)
        own += value * (highest[g] if value > 0.0 else lowest[g])
    return own


@nb.njit(cache=True, nogil=True)
def _own(base, i, f, u, x):
    """A row's own part at grid point i and (u, x)."""
    return base[i, f, 0] * u + base[i, f, 1] * x + base[i, f, 2] if base.shape[0] else 0.0


@nb.njit(cache=True, nogil=True)
def _active_piece(family, i, f, margins, swings, remains, u, x):
    """Affine piece (a, b, c) of row f at grid point i that is active at (u, x): its value there is a u + b x + c."""
    loads, row = family.loads, family.B[i if family.B.shape[0] > 1 else 0, f]
    a, b, c = 0.0, 0.0, 0.0
    if family.base.shape[0]:
        a, b, c = family.base[i, f, 0], family.base[i, f, 1], family.base[i, f, 2]
    for g in range(len(loads.lowest)):
        p, q, r = 0.0, 0.0, margins[f, g]
        for j in range(len(row)):
            p += row[j] * loads.nominal[i, j, g, 0]
            q += row[j] * loads.nominal[i, j, g, 1]
            r += row[j] * loads.nominal[i, j, g, 2]
        for k in range(len(loads.group)):
            if loads.group[k] == g:
                product = 0.0
                for j in range(len(row)):
                    product += row[j] * swings[k, j]
                sign = -1.0 if product < 0.0 else 1.0
                for j in range(len(row)):
                    p += sign * row[j] * loads.terms[i, j, k, 0]
                    q += sign * row[j] * loads.terms[i, j, k, 1]
                    r += sign * row[j] * loads.terms[i, j, k, 2]
        for k in range(len(loads.remainder_group)):
            if loads.remainder_group[k] == g:
                for j in range(len(row)):
                    weight = abs(row[j]) * (-1.0 if remains[k, j] < 0.0 else 1.0)
                    p += weight * loads.remainder[i, j, k, 0]
                    q += weight * loads.remainder[i, j, k, 1]
                    r += weight * loads.remainder[i, j, k, 2]
        scale = loads.highest[g] if p * u + q * x + r > 0.0 else loads.lowest[g]
        a, b, c = a + scale * p, b + scale * q, c + scale * r
    return a, b, c


@nb.njit(cache=True, nogil=True)
def _bounds(columns, sizes, base, base_terms, constant_group, i, u, x, central, reach, lowest, highest, values, out):
    """out[f] >= value of row f at (u, x), for all rows; equal, but for rounding, where only masses have intervals.

    reach: sum_k |W_gk| + sum_k |R_gk|, (G, d), or (0, d) where there are no such terms
    """
    d = len(columns)
    for f in range(len(out)):
        out[f] = _own(base, i, f, u, x)
    for g in range(len(lowest)):
        values[:] = 0.0
        if base_terms.shape[0]:
            for k in range(len(constant_group)):
                if constant_group[k] == g:
                    for f in range(len(out)):
                        values[f] += abs(base_terms[i, f, k])
        if len(reach):
            for j in range(0, d, 6):
                _add_products(sizes, reach, g, j, values)
        for j in range(6, d, 6):
            _add_products(columns, central, g, j, values)
        _add_scaled(columns, central, g, lowest[g], highest[g], values, out)


@nb.njit(cache=True, nogil=True)
def cut_family(polygons, family, result):
    """Cut each polygon until no vertex violates a row. Returns the largest size, or more than MAX_VERTICES.

    While it is cut, the names of a polygon's edges that are rows of the family are -2 - row.
    """
    B, loads, base, base_terms, names = family
    nominal, terms, group, constant, constant_group, remainder, remainder_group, lowest, highest = loads
    F, d, G = B.shape[1], B.shape[2], len(lowest)
    V, V2 = np.empty((MAX_VERTICES, 2)), np.empty((MAX_VERTICES, 2))
    R, R2 = np.empty((MAX_VERTICES, 3)), np.empty((MAX_VERTICES, 3))
    L, L2 = np.empty(MAX_VERTICES, np.int64), np.empty(MAX_VERTICES, np.int64)
    valid, valid2 = np.zeros(MAX_VERTICES, np.bool_), np.zeros(MAX_VERTICES, np.bool_)
    central, box, fixed = np.zeros((G, d)), np.zeros((G, d)), np.zeros((G, d))
    swings, remains = np.zeros((len(group), d)), np.zeros((len(remainder_group), d))
    reach = np.zeros((G if len(group) + len(constant_group) + len(remainder_group) else 0, d))
    columns, sizes, values, bounds = np.zeros((d, F)), np.zeros((d, F)), np.zeros(F), np.zeros(F)
    margins, known = np.zeros((F, G)), np.full(F, -1)
    tried, count, b, largest = np.zeros(MAX_VERTICES, np.int64), 0, -1, 0
    for i in range(len(polygons.sizes)):
        n = _load(polygons, i, V, R, L)
        if n < 3:
            continue
        if B.shape[0] > 1 or b < 0:
            b = i if B.shape[0] > 1 else 0
            for f in range(F):
                for j in range(d):
                    columns[j, f], sizes[j, f] = B[b, f, j], abs(B[b, f, j])
        fixed[:] = 0.0
        for k in range(len(constant_group)):
            for j in range(d):
                fixed[constant_group[k], j] += abs(constant[i, j, k])
        u_size, x_size = np.abs(V[:n, 0]).max(), np.abs(V[:n, 1]).max()
        valid[:] = False
        next_try, finished = 0, False
        for _ in range(20 * MAX_VERTICES):
            vertex, worst, violation, trying = -1, -1, TOLERANCE, next_try < count
            first, last = 0, n
            if not trying:
                while first < n and valid[first]:
                    first += 1
                if first == n:
                    finished = True
                    break
                last = first + 1
            for k in range(first, last):
                u, x = V[k, 0], V[k, 1]
                _wrenches(nominal, i, u, x, central)
                _wrenches(terms, i, u, x, swings)
                _wrenches(remainder, i, u, x, remains)
                box[:] = 0.0
                _add_sizes(remains, remainder_group, box)
                if not trying and len(reach):
                    for g in range(G):
                        for j in range(d):
                            reach[g, j] = fixed[g, j] + box[g, j]
                    _add_sizes(swings, group, reach)
                f, end = 0, F
                if trying:  # a row that binds at the grid point before, at the vertex that likes it least
                    f, end = tried[next_try], tried[next_try] + 1
                else:
                    _bounds(
                        columns, sizes, base, base_terms, constant_group, i, u, x, central, reach, lowest, highest,
                        values, bounds,
                    )  # fmt: skip
                    end = F if _count_above(bounds, TOLERANCE) else 0
                while f < end:
                    if trying or bounds[f] > violation:
                        if known[f] != i:
                            _margin(B, b, f, constant, base_terms, i, constant_group, margins)
                            known[f] = i
                        own = _own(base, i, f, u, x)
                        value = _value(B, b, f, own, margins, central, swings, group, box, lowest, highest)
                        if value > violation:
                            vertex, worst, violation = k, f, value
                    f += 1
            next_try += 1 if trying else 0
            if worst < 0:
                valid[first] = valid[first] or not trying
                continue
            u, x = V[vertex, 0], V[vertex, 1]
            _wrenches(terms, i, u, x, swings)
            _wrenches(remainder, i, u, x, remains)
            a, slope, c = _active_piece(family, i, worst, margins, swings, remains, u, x)
            if violation <= ROUNDING * (abs(a) * u_size + abs(slope) * x_size + abs(c)):
                valid[vertex] = valid[vertex] or not trying
                continue
            n = _clip(V, R, L, valid, n, a, slope, c, -2 - worst, V2, R2, L2, valid2)
            if n < 3:
                n, finished = 0, True
                break
            if n > MAX_VERTICES - 2:
                break
        if not finished:
            return MAX_VERTICES + 1
        count = _name_edges(L, n, names, tried)
        _store(V, R, L, n, result, i)
        largest = max(largest, n)
    return largest


@nb.njit(cache=True, nogil=True)
def _name_edges(L, n, names, rows):
    """Give the edges that are rows of the family, -2 - row, their names. Lists them once each; returns how many."""
    count = 0
    for k in range(n):
        if L[k] <= -2:
            row, new = -2 - L[k], True
            L[k] = names[row]
            for m in range(count):
                new = new and rows[m] != row
            if new:
                rows[count] = row
                count += 1
    return count


@nb.njit(cache=True, nogil=True)
def family_values(family, points, u, x, out):
    """out[m, f] = value of row f at grid point points[m] and (u[m], x[m]), every parameter at its worst."""
    B, loads, base, base_terms, _ = family
    nominal, terms, group, constant, constant_group, remainder, remainder_group, lowest, highest = loads
    F, d, G = B.shape[1], B.shape[2], len(lowest)
    central, box, margins = np.zeros((G, d)), np.zeros((G, d)), np.zeros((F, G))
    swings, remains = np.zeros((len(group), d)), np.zeros((len(remainder_group), d))
    for m in range(len(points)):
        i = points[m]
        b = i if B.shape[0] > 1 else 0
        _wrenches(nominal, i, u[m], x[m], central)
        _wrenches(terms, i, u[m], x[m], swings)
        _wrenches(remainder, i, u[m], x[m], remains)
        box[:] = 0.0
        _add_sizes(remains, remainder_group, box)
        for f in range(F):
            _margin(B, b, f, constant, base_terms, i, constant_group, margins)
            own = _own(base, i, f, u[m], x[m])
            out[m, f] = _value(B, b, f, own, margins, central, swings, group, box, lowest, highest)
