"""Values of the rows of a family at one grid point and (u, x), every parameter at its worst, compiled.

The formula is the one at the head of `polygons`. All wrenches that the rows multiply are the columns of one array, and
are evaluated once per (u, x). The functions take arrays with indices, not parts of arrays; see `clipping`.
"""

from __future__ import annotations

from robustopt.compiled import compiled, compiled_inner, merged
from robustopt.limits.coupling import add_largest_changes, exact_value, find_changes, find_factors, value_of


@compiled_inner(forceinline=True)
def find_wrenches(coefficients, i, u, x, out):
    """Set out (C, d) to the wrenches of coefficients (P, d, C, 3) at grid point i and (u, x)."""
    for k in range(coefficients.shape[2]):
        for j in range(coefficients.shape[1]):
            out[k, j] = coefficients[i, j, k, 0] * u + coefficients[i, j, k, 1] * x + coefficients[i, j, k, 2]


@compiled_inner(fastmath={"contract"}, forceinline=True)
def own_part(base, i, f, u, x):
    """Return a row's own part at grid point i and (u, x)."""
    return base[i, f, 0] * u + base[i, f, 1] * x + base[i, f, 2] if base.shape[0] else 0.0


@merged
def find_margin(rows, b, f, i, work):
    """Set the margins of row B[b, f] to what the interval terms that depend on neither u nor x add to it at most."""
    if work.known[f] != i:
        work.known[f] = i
        _find_margin(rows.B, rows.base_terms, rows.constant, rows.constant_group, b, f, i, work.margins)
        if rows.changes.shape[3]:
            _add_changes(rows, b, f, i, work)


@compiled_inner(forceinline=True)
def _find_margin(B, base_terms, constant, group, b, f, i, margins):
    """Set the margins of row B[b, f] to the share of the constant interval terms."""
    for g in range(margins.shape[1]):
        margins[f, g] = 0.0
    for k in range(len(group)):
        product = base_terms[i, f, k] if base_terms.shape[0] else 0.0
        for j in range(B.shape[2]):
            product += B[b, f, j] * constant[i, j, k]
        margins[f, group[k]] += abs(product)


@compiled_inner()
def _add_changes(rows, b, f, i, work):
    """Add to the margins how much the interval terms and second moments can grow by each acceleration error."""
    values = work.values
    for g in range(len(values)):
        values[g] = 0.0
    find_changes(rows, b, f, i, work.changes)
    for e in range(work.changes.shape[1]):
        add_largest_changes(work.changes, e, len(values), rows.group, rows.usual, rows.round, work.both, values)
    for g in range(len(values)):
        work.margins[f, g] += values[g]


@compiled_inner(forceinline=True)
def _find_products(B, b, f, wrenches, margins, products):
    """Set the products of row B[b, f] with the columns, whose nominal ones include the margins."""
    for k in range(len(products)):
        product = margins[f, k] if k < margins.shape[1] else 0.0
        for j in range(B.shape[2]):
            product += B[b, f, j] * wrenches[k, j]
        products[k] = product


@compiled_inner(forceinline=True)
def row_value(rows, b, f, own, work):
    """Return the value of row B[b, f] at a grid point and (u, x), whose wrenches, margin and own part have been found.

    It is an upper bound if columns change with the acceleration error; `exact_value` is exact.
    """
    _find_products(rows.B, b, f, work.wrenches, work.margins, work.products)
    return value_of(work.products, rows.group, rows.usual, rows.round, rows.lowest, rows.highest, work.values, own)


@merged
def active_piece(rows, b, f, i, u, x, work):
    """Return the affine piece (a, slope, c) of row B[b, f] that is active at grid point i and (u, x).

    a u + slope x + c is the row's value at (u, x), and nowhere larger than its value. The wrenches have been found.
    """
    if rows.changes.shape[3]:
        exact_value(rows, b, f, i, work)
    else:
        find_margin(rows, b, f, i, work)
        _find_products(rows.B, b, f, work.wrenches, work.margins, work.products)
        find_factors(rows, work)
        for g in range(len(work.fixed)):
            work.fixed[g] = work.margins[f, g]
    return _piece(rows.B, rows.base, rows.wrenches, rows.group, rows.lowest, rows.highest, b, f, i, u, x, work)


@merged
def _piece(B, base, wrenches, group, lowest, highest, b, f, i, u, x, work):
    """Return the affine piece of a row for factors that were found."""
    a, slope, c = 0.0, 0.0, 0.0
    if base.shape[0]:
        a, slope, c = base[i, f, 0], base[i, f, 1], base[i, f, 2]
    for g in range(len(lowest)):
        p, q, r = 0.0, 0.0, work.fixed[g]
        for k in range(len(group)):
            if group[k] == g:
                for j in range(B.shape[2]):
                    weight = work.factors[k] * B[b, f, j]
                    p += weight * wrenches[i, j, k, 0]
                    q += weight * wrenches[i, j, k, 1]
                    r += weight * wrenches[i, j, k, 2]
        scale = highest[g] if p * u + q * x + r > 0.0 else lowest[g]
        a, slope, c = a + scale * p, slope + scale * q, c + scale * r
    return a, slope, c


@compiled(_nrt=False)
def family_values(rows, points, u, x, work, out):
    """Set out (M, F) to the values of the rows at grid points (M,) and (u, x), (M,) each."""
    for m in range(len(points)):
        i = points[m]
        b = i if rows.B.shape[0] > 1 else 0
        find_wrenches(rows.wrenches, i, u[m], x[m], work.wrenches)
        for f in range(out.shape[1]):
            own = own_part(rows.base, i, f, u[m], x[m])
            if rows.changes.shape[3]:
                out[m, f] = own + exact_value(rows, b, f, i, work)
            else:
                find_margin(rows, b, f, i, work)
                out[m, f] = row_value(rows, b, f, own, work)
