"""Cutting of feasible polygons with rows, compiled: the inner loops of `polygons`, whose types and formula these are.

A family of rows is evaluated at a vertex; the row that is violated most cuts the polygon; and so on until no vertex
violates anything. Three things keep this cheap, and change no result. |B_f| sum_k |W_gk| bounds the interval terms, so
most rows are known to hold after two products instead of one per term. Facets come like next to like, so the least and
the largest entries of a block of them bound them all, and few blocks are looked into. And what binds at one grid point
mostly binds at the next: its rows are tried first, by the piece that is active where they bound, so that nearly every
look at all rows confirms a vertex.
"""

from __future__ import annotations

import numpy as np

from robustopt.compiled import compiled

MAX_VERTICES = 384
"""Most vertices of a polygon while it is cut."""

TOLERANCE = 1e-10
"""Largest violation of a row, relative to the limit, that a vertex of a polygon may keep: ten times rounding error."""

BLOCK = 16
"""Rows that are bounded together: then a look at 588 facets is 37 bounds and the one or two blocks that may bind."""

ROUNDING = 1e-14
"""Part of the largest terms of a row in a polygon by which its value at a vertex may be off; this matters only
far from any plan."""


@compiled()
def _size(V, n, j):
    """Largest coordinate j of a polygon by size."""
    largest = 0.0
    for k in range(n):
        largest = max(largest, abs(V[k, j]))
    return largest


@compiled()
def _largest(V, n, a, b, c):
    """Largest value of a u + b x + c on a polygon."""
    largest = -np.inf
    for k in range(n):
        largest = max(largest, a * V[k, 0] + b * V[k, 1] + c)
    return largest


@compiled()
def _copy(R, L, k, R2, L2, m):
    """Row and name of edge k become those of edge m, without temporary arrays."""
    R2[m, 0], R2[m, 1], R2[m, 2], L2[m] = R[k, 0], R[k, 1], R[k, 2], L[k]


@compiled()
def _clip(V, R, L, valid, n, a, b, c, name, V2, R2, L2, valid2):
    """Keep the part of a polygon with a u + b x + c <= 0; the new edge takes the row's name. Returns the count."""
    if _largest(V, n, a, b, c) <= 0.0:
        return n
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


@compiled()
def _load(vertices, rows, names, n, i, V, R, L):
    """Copy polygon i, of n vertices, to where it is cut."""
    for k in range(n):
        V[k, 0], V[k, 1] = vertices[i, k, 0], vertices[i, k, 1]
        R[k, 0], R[k, 1], R[k, 2], L[k] = rows[i, k, 0], rows[i, k, 1], rows[i, k, 2], names[i, k]


@compiled()
def _store(V, R, L, n, vertices, rows, names, sizes, i):
    """Copy a polygon that has been cut to its place, if there is room for it."""
    sizes[i] = n
    if n <= names.shape[1]:
        for k in range(n):
            vertices[i, k, 0], vertices[i, k, 1] = V[k, 0], V[k, 1]
            rows[i, k, 0], rows[i, k, 1], rows[i, k, 2], names[i, k] = R[k, 0], R[k, 1], R[k, 2], L[k]


@compiled()
def cut_rows(polygons, limits, result):
    """Cut with rows that are affine. Returns the size of the largest polygon, or more than MAX_VERTICES."""
    rows, names = limits
    V, V2 = np.empty((MAX_VERTICES, 2)), np.empty((MAX_VERTICES, 2))
    R, R2 = np.empty((MAX_VERTICES, 3)), np.empty((MAX_VERTICES, 3))
    L, L2 = np.empty(MAX_VERTICES, np.int64), np.empty(MAX_VERTICES, np.int64)
    valid, valid2 = np.zeros(MAX_VERTICES, np.bool_), np.zeros(MAX_VERTICES, np.bool_)
    vertices, edges, edge_names, counts = polygons
    new_vertices, new_edges, new_names, new_counts = result
    largest = 0
    for i in range(len(counts)):
        n = counts[i]
        _load(vertices, edges, edge_names, n, i, V, R, L)
        for f in range(rows.shape[1]):
            if n >= 3:
                n = _clip(V, R, L, valid, n, rows[i, f, 0], rows[i, f, 1], rows[i, f, 2], names[f], V2, R2, L2, valid2)
            if n > MAX_VERTICES - 2:
                return MAX_VERTICES + 1
        _store(V, R, L, n if n >= 3 else 0, new_vertices, new_edges, new_names, new_counts, i)
        largest = max(largest, n)
    return largest


# The functions below take arrays with indices, not tuples or parts of arrays: numba counts references to the latter,
# which costs more than the arithmetic, most of all where threads share an array.


@compiled()
def _wrenches(coefficients, i, u, x, out):
    """out[k] = coefficients (P, d, n, 3) of grid point i at (u, x), shape (n, d)."""
    for k in range(coefficients.shape[2]):
        for j in range(coefficients.shape[1]):
            out[k, j] = coefficients[i, j, k, 0] * u + coefficients[i, j, k, 1] * x + coefficients[i, j, k, 2]


@compiled()
def _add_sizes(wrenches, group, out):
    """out[group[k]] += |wrenches[k]|."""
    for k in range(len(group)):
        for j in range(out.shape[1]):
            out[group[k], j] += abs(wrenches[k, j])


@compiled(forceinline=True)
def _margin(B, b, f, constant, base_terms, i, group, out):
    """out[f, g] = what the terms that depend on neither u nor x add to row B[b, f] at grid point i."""
    out[f] = 0.0
    for k in range(len(group)):
        product = base_terms[i, f, k] if base_terms.shape[0] else 0.0
        for j in range(B.shape[2]):
            product += B[b, f, j] * constant[i, j, k]
        out[f, group[k]] += abs(product)


@compiled(forceinline=True)
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


@compiled()
def _own(base, i, f, u, x):
    """A row's own part at grid point i and (u, x)."""
    return base[i, f, 0] * u + base[i, f, 1] * x + base[i, f, 2] if base.shape[0] else 0.0


@compiled()
def _active_piece(B, b, loads, base, i, f, margins, swings, remains, u, x):
    """Affine piece (a, slope, c) of row B[b, f] at grid point i that is active at (u, x): a u + slope x + c there."""
    nominal, terms, group, _, _, remainder, remainder_group, lowest, highest = loads
    a, slope, c = 0.0, 0.0, 0.0
    if base.shape[0]:
        a, slope, c = base[i, f, 0], base[i, f, 1], base[i, f, 2]
    for g in range(len(lowest)):
        p, q, r = 0.0, 0.0, margins[f, g]
        for j in range(B.shape[2]):
            p += B[b, f, j] * nominal[i, j, g, 0]
            q += B[b, f, j] * nominal[i, j, g, 1]
            r += B[b, f, j] * nominal[i, j, g, 2]
        for k in range(len(group)):
            if group[k] == g:
                product = 0.0
                for j in range(B.shape[2]):
                    product += B[b, f, j] * swings[k, j]
                sign = -1.0 if product < 0.0 else 1.0
                for j in range(B.shape[2]):
                    p += sign * B[b, f, j] * terms[i, j, k, 0]
                    q += sign * B[b, f, j] * terms[i, j, k, 1]
                    r += sign * B[b, f, j] * terms[i, j, k, 2]
        for k in range(len(remainder_group)):
            if remainder_group[k] == g:
                for j in range(B.shape[2]):
                    weight = abs(B[b, f, j]) * (-1.0 if remains[k, j] < 0.0 else 1.0)
                    p += weight * remainder[i, j, k, 0]
                    q += weight * remainder[i, j, k, 1]
                    r += weight * remainder[i, j, k, 2]
        scale = highest[g] if p * u + q * x + r > 0.0 else lowest[g]
        a, slope, c = a + scale * p, slope + scale * q, c + scale * r
    return a, slope, c


@compiled(fastmath={"contract"})
def _block_bounds(entries, sizes, m, central, reach, lowest, highest, out):
    """out[k] >= value at a vertex of rows with entries between entries[m, 0, :, k] and entries[m, -1, :, k].

    entries: (M, 1 or 2, 6, K); sizes: bounds of their absolute values, (M, 6, K); reach: sum_k |W_gk| + sum_k |R_gk|,
    (G, 6), or (0, 6) for no intervals. For single rows the bound is their value, but for rounding, where only masses
    have intervals.
    """
    upper = entries.shape[1] - 1
    for k in range(len(out)):
        out[k] = 0.0
    for g in range(len(lowest)):
        w0, w1, w2, w3, w4, w5 = (
            central[g, 0],
            central[g, 1],
            central[g, 2],
            central[g, 3],
            central[g, 4],
            central[g, 5],
        )
        e0, e1, e2 = upper * (w0 > 0.0), upper * (w1 > 0.0), upper * (w2 > 0.0)
        e3, e4, e5 = upper * (w3 > 0.0), upper * (w4 > 0.0), upper * (w5 > 0.0)
        low, high = lowest[g], highest[g]
        if len(reach):
            r0, r1, r2, r3, r4, r5 = reach[g, 0], reach[g, 1], reach[g, 2], reach[g, 3], reach[g, 4], reach[g, 5]
            for k in range(len(out)):
                v = w0 * entries[m, e0, 0, k] + w1 * entries[m, e1, 1, k] + w2 * entries[m, e2, 2, k]
                v += w3 * entries[m, e3, 3, k] + w4 * entries[m, e4, 4, k] + w5 * entries[m, e5, 5, k]
                v += r0 * sizes[m, 0, k] + r1 * sizes[m, 1, k] + r2 * sizes[m, 2, k]
                v += r3 * sizes[m, 3, k] + r4 * sizes[m, 4, k] + r5 * sizes[m, 5, k]
                out[k] += v * (high if v > 0.0 else low)
        else:
            for k in range(len(out)):
                v = w0 * entries[m, e0, 0, k] + w1 * entries[m, e1, 1, k] + w2 * entries[m, e2, 2, k]
                v += w3 * entries[m, e3, 3, k] + w4 * entries[m, e4, 4, k] + w5 * entries[m, e5, 5, k]
                out[k] += v * (high if v > 0.0 else low)


@compiled(fastmath={"contract"})
def _row_bounds(B, b, base, own_reach, i, u, x, central, reach, lowest, highest, out):
    """out[f] >= value of row B[b, f] at (u, x); equal, but for rounding, where only masses have intervals.

    own_reach: what a row's own interval terms add at most, (F, G), or (0, G) for none
    """
    for f in range(len(out)):
        out[f] = _own(base, i, f, u, x)
        for g in range(len(lowest)):
            v = own_reach[f, g] if len(own_reach) else 0.0
            if len(reach):
                for j in range(B.shape[2]):
                    v += B[b, f, j] * central[g, j] + abs(B[b, f, j]) * reach[g, j]
            else:
                for j in range(B.shape[2]):
                    v += B[b, f, j] * central[g, j]
            out[f] += v * (highest[g] if v > 0.0 else lowest[g])


@compiled()
def _next_above(values, k, threshold):
    """First index from k on of a value above a threshold; the number of values if there is none."""
    while k < len(values) and values[k] <= threshold:
        k += 1
    return k


@compiled()
def _fill_blocks(B, entries, sizes, extremes, extreme_sizes):
    """Rows B[0] (F, 6) block by block, entries (M, 1, 6, BLOCK), padded with zeros, and their sizes (M, 6, BLOCK); the
    least and the largest entries of each block, extremes (1, 2, 6, M), and the largest sizes (1, 6, M)."""
    for m in range(len(entries)):
        for j in range(6):
            low = high = B[0, m * BLOCK, j]
            for r in range(min(BLOCK, B.shape[1] - m * BLOCK)):
                entry = B[0, m * BLOCK + r, j]
                entries[m, 0, j, r], sizes[m, j, r] = entry, abs(entry)
                low, high = min(low, entry), max(high, entry)
            extremes[0, 0, j, m], extremes[0, 1, j, m], extreme_sizes[0, j, m] = low, high, max(-low, high)


@compiled()
def cut_family(polygons, family, result):
    """Cut each polygon until no vertex violates a row. Returns the largest size, or more than MAX_VERTICES.

    While it is cut, the names of a polygon's edges that are rows of the family are -2 - row.
    """
    B, loads, base, base_terms, names = family
    nominal, terms, group, constant, constant_group, remainder, remainder_group, lowest, highest = loads
    vertices, edges, edge_names, counts = polygons
    new_vertices, new_edges, new_names, new_counts = result
    F, d, G = B.shape[1], B.shape[2], len(lowest)
    V, V2 = np.empty((MAX_VERTICES, 2)), np.empty((MAX_VERTICES, 2))
    R, R2 = np.empty((MAX_VERTICES, 3)), np.empty((MAX_VERTICES, 3))
    L, L2 = np.empty(MAX_VERTICES, np.int64), np.empty(MAX_VERTICES, np.int64)
    valid, valid2 = np.zeros(MAX_VERTICES, np.bool_), np.zeros(MAX_VERTICES, np.bool_)
    central, box, fixed = np.zeros((G, d)), np.zeros((G, d)), np.zeros((G, d))
    swings, remains = np.zeros((len(group), d)), np.zeros((len(remainder_group), d))
    reach = np.zeros((G if len(group) + len(constant_group) + len(remainder_group) else 0, d))
    in_blocks = B.shape[0] == 1 and base.shape[0] == 0 and d == 6 and F > BLOCK
    size, M = (BLOCK, (F + BLOCK - 1) // BLOCK) if in_blocks else (F, 1)
    entries, entry_sizes = np.zeros((M, 1, 6, BLOCK)), np.zeros((M, 6, BLOCK))
    extremes, extreme_sizes = np.zeros((1, 2, 6, M)), np.zeros((1, 6, M))
    block_bounds, bounds = np.full(M, np.inf), np.zeros(size)
    if in_blocks:
        _fill_blocks(B, entries, entry_sizes, extremes, extreme_sizes)
    margins, own_reach, known = np.zeros((F, G)), np.zeros((F if len(base_terms) else 0, G)), np.full(F, -1)
    tried, middle = np.zeros(MAX_VERTICES, np.int64), np.zeros((MAX_VERTICES, 2))
    count, largest = 0, 0
    for i in range(len(counts)):
        n = counts[i]
        if n < 3:
            continue
        _load(vertices, edges, edge_names, n, i, V, R, L)
        b = i if B.shape[0] > 1 else 0
        fixed[:] = 0.0
        for k in range(len(constant_group)):
            for j in range(d):
                fixed[constant_group[k], j] += abs(constant[i, j, k])
        own_reach[:] = 0.0
        for f in range(len(own_reach)):
            for k in range(len(constant_group)):
                own_reach[f, constant_group[k]] += abs(base_terms[i, f, k])
        u_size, x_size = _size(V, n, 0), _size(V, n, 1)
        valid[:] = False
        next_try, finished = 0, False
        for _ in range(20 * MAX_VERTICES):
            first, worst, violation, trying = 0, -1, TOLERANCE, next_try < count
            if trying:
                worst, u, x = tried[next_try], middle[next_try, 0], middle[next_try, 1]
                next_try += 1
            else:
                while first < n and valid[first]:
                    first += 1
                if first == n:
                    finished = True
                    break
                u, x = V[first, 0], V[first, 1]
            if len(group):
                _wrenches(terms, i, u, x, swings)
            if len(remainder_group):
                _wrenches(remainder, i, u, x, remains)
            if not trying:
                _wrenches(nominal, i, u, x, central)
                if len(reach):
                    box[:] = 0.0
                    _add_sizes(remains, remainder_group, box)
                    for g in range(G):
                        for j in range(d):
                            reach[g, j] = fixed[g, j] + box[g, j]
                    _add_sizes(swings, group, reach)
                if in_blocks:
                    _block_bounds(extremes, extreme_sizes, 0, central, reach, lowest, highest, block_bounds)
                m = _next_above(block_bounds, 0, TOLERANCE)
                while m < M:
                    if in_blocks:
                        _block_bounds(entries, entry_sizes, m, central, reach, lowest, highest, bounds)
                    else:
                        _row_bounds(B, b, base, own_reach, i, u, x, central, reach, lowest, highest, bounds)
                    r = _next_above(bounds, 0, violation)
                    while r < size:
                        f = m * size + r
                        if known[f] != i:
                            _margin(B, b, f, constant, base_terms, i, constant_group, margins)
                            known[f] = i
                        own = _own(base, i, f, u, x)
                        value = _value(B, b, f, own, margins, central, swings, group, box, lowest, highest)
                        if value > violation:
                            worst, violation = f, value
                        r = _next_above(bounds, r + 1, violation)
                    m = _next_above(block_bounds, m + 1, TOLERANCE)
                if worst < 0:
                    valid[first] = True
                    continue
            elif known[worst] != i:
                _margin(B, b, worst, constant, base_terms, i, constant_group, margins)
                known[worst] = i
            a, slope, c = _active_piece(B, b, loads, base, i, worst, margins, swings, remains, u, x)
            if trying:
                violation = _largest(V, n, a, slope, c)
            if violation <= max(TOLERANCE, ROUNDING * (abs(a) * u_size + abs(slope) * x_size + abs(c))):
                valid[first] = valid[first] or not trying
                continue
            n = _clip(V, R, L, valid, n, a, slope, c, -2 - worst, V2, R2, L2, valid2)
            if n < 3:
                n, finished = 0, True
                break
            if n > MAX_VERTICES - 2:
                break
        if not finished:
            return MAX_VERTICES + 1
        count = _name_edges(V, L, n, names, tried, middle)
        _store(V, R, L, n, new_vertices, new_edges, new_names, new_counts, i)
        largest = max(largest, n)
    return largest


@compiled()
def _name_edges(V, L, n, names, rows, middle):
    """Give the edges that are rows of the family, -2 - row, their names. Lists rows and middles; returns how many."""
    count = 0
    for k in range(n):
        if L[k] <= -2:
            after = k + 1 if k + 1 < n else 0
            rows[count] = -2 - L[k]
            for j in range(2):
                middle[count, j] = 0.5 * (V[k, j] + V[after, j])
            L[k] = names[rows[count]]
            count += 1
    return count


@compiled()
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
