"""Values of the rows of a family at one grid point and (u, x), every parameter at its worst, compiled.

The formula is the one at the head of `polygons`. The wrenches that all rows multiply are evaluated once per (u, x), in
a `RowWork`. The functions take arrays with indices, not tuples or parts of arrays, or are inlined; see `clipping`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from robustopt.arrays import Array, Indices
from robustopt.compiled import compiled, compiled_inner, merged
from robustopt.limits.coupling import (
    Coupled,
    add_all_product_bounds,
    coupled_value,
    coupled_work,
    is_coupled,
    set_moments,
    support,
)


class RowWork(NamedTuple):
    """Work arrays for the values of rows: the parts of the required wrench at (u, x), and of rows at a grid point.

    Attributes:
        central: W_g0 (G, d).
        swings: interval terms W_gk (n, d).
        moments: wrenches per second moment W_gb (6 m, d).
        shares: values of a row per second moment (6 m,).
        margins: bound of the share of the constant interval terms and products in each row (F, G).
        known: grid point that the margins of each row are of (F,).
        signs: worst factor of each interval term (n,).
        weights: worst second moments less the usual ones (6 m,).
        fixed: share of the acceleration error, at its worst, and of other constants in a row (G,).
        coupled: work arrays for rows whose terms depend on the acceleration error.
    """

    central: Array
    swings: Array
    moments: Array
    shares: Array
    margins: Array
    known: Indices
    signs: Array
    weights: Array
    fixed: Array
    coupled: Coupled


def row_work(family):
    """Return the work arrays for a family."""
    wrench, (F, d), G = family.wrench, family.B.shape[1:], len(family.wrench.lowest)
    n, m = len(wrench.group), len(wrench.usual)
    return RowWork(
        np.zeros((G, d)), np.zeros((n, d)), np.zeros((m, d)), np.zeros(m), np.zeros((F, G)), np.full(F, -1),
        np.zeros(n), np.zeros(m), np.zeros(G), coupled_work(wrench),
    )  # fmt: skip


@merged
def find_wrenches(wrench, i, u, x, work):
    """Set the wrenches at grid point i and (u, x)."""
    _wrenches_at(wrench.nominal, i, u, x, work.central)
    if len(wrench.group):
        _wrenches_at(wrench.terms, i, u, x, work.swings)
    if len(wrench.usual):
        _wrenches_at(wrench.moments, i, u, x, work.moments)


@compiled_inner(forceinline=True)
def _wrenches_at(coefficients, i, u, x, out):
    """Set out (n, d) to the wrenches of coefficients (P, d, n, 3) at grid point i and (u, x)."""
    for k in range(coefficients.shape[2]):
        for j in range(coefficients.shape[1]):
            out[k, j] = coefficients[i, j, k, 0] * u + coefficients[i, j, k, 1] * x + coefficients[i, j, k, 2]


@merged
def find_margin(family, b, f, i, work):
    """Set the margins of row B[b, f] to what the interval terms that depend on neither u nor x add to it at most."""
    if work.known[f] != i:
        work.known[f] = i
        _find_margin(family.B, family.base_terms, family.wrench, b, f, i, work.margins, work.coupled)


@compiled_inner()
def _find_margin(B, base_terms, wrench, b, f, i, margins, coupled):
    constant, group = wrench.constant, wrench.constant_group
    for g in range(margins.shape[1]):
        margins[f, g] = 0.0
    for k in range(len(group)):
        product = base_terms[i, f, k] if base_terms.shape[0] else 0.0
        for j in range(B.shape[2]):
            product += B[b, f, j] * constant[i, j, k]
        margins[f, group[k]] += abs(product)
    if is_coupled(wrench):
        add_all_product_bounds(B, b, f, i, wrench, coupled, margins)


@compiled_inner(fastmath={"contract"}, forceinline=True)
def own_part(base, i, f, u, x):
    """Return a row's own part at grid point i and (u, x)."""
    return base[i, f, 0] * u + base[i, f, 1] * x + base[i, f, 2] if base.shape[0] else 0.0


@merged
def row_value(family, b, f, i, own, work):
    """Return the value of row B[b, f] at grid point i and (u, x), whose wrenches, margin and own part have been found.

    It is an upper bound if the terms of the row depend on the acceleration error; `coupled_value` is exact.
    """
    B, wrench, swings, shares = family.B, family.wrench, work.swings, work.shares
    _find_shares(B, b, f, work.moments, shares)
    total = own
    for g in range(len(wrench.lowest)):
        value = work.margins[f, g]
        for j in range(B.shape[2]):
            value += B[b, f, j] * work.central[g, j]
        for k in range(len(wrench.group)):
            if wrench.group[k] == g:
                product = 0.0
                for j in range(B.shape[2]):
                    product += B[b, f, j] * swings[k, j]
                value += abs(product)
        for m in range(len(wrench.moment_group)):
            if wrench.moment_group[m] == g:
                value += support(shares, 6 * m, wrench.usual, m, wrench.round[m])
        total += value * (wrench.highest[g] if value > 0.0 else wrench.lowest[g])
    return total


@compiled_inner()
def _find_shares(B, b, f, moments, shares):
    """Set the values of row B[b, f] per second moment."""
    for q in range(len(shares)):
        shares[q] = 0.0
        for j in range(B.shape[2]):
            shares[q] += B[b, f, j] * moments[q, j]


@merged
def active_piece(family, b, f, i, u, x, work):
    """Return the affine piece (a, slope, c) of row B[b, f] that is active at grid point i and (u, x).

    a u + slope x + c is the row's value at (u, x), and nowhere larger than its value. The wrenches have been found.
    """
    B, wrench, base = family.B, family.wrench, family.base
    find_margin(family, b, f, i, work)
    if is_coupled(wrench):
        coupled_value(B, family.base_terms, wrench, b, f, i, work)
    else:
        _find_worst(B, b, f, wrench, work)
    a, slope, c = 0.0, 0.0, 0.0
    if base.shape[0]:
        a, slope, c = base[i, f, 0], base[i, f, 1], base[i, f, 2]
    for g in range(len(wrench.lowest)):
        p, q, r = _group_piece(B, b, f, i, g, wrench, work)
        scale = wrench.highest[g] if p * u + q * x + r > 0.0 else wrench.lowest[g]
        a, slope, c = a + scale * p, slope + scale * q, c + scale * r
    return a, slope, c


@merged
def _find_worst(B, b, f, wrench, work):
    """Set signs, weights and fixed to the worst for row B[b, f], whose terms do not depend on the acceleration error."""
    for g in range(len(work.fixed)):
        work.fixed[g] = work.margins[f, g]
    for k in range(len(work.signs)):
        product = 0.0
        for j in range(B.shape[2]):
            product += B[b, f, j] * work.swings[k, j]
        work.signs[k] = -1.0 if product < 0.0 else 1.0
    _find_shares(B, b, f, work.moments, work.shares)
    for m in range(len(wrench.moment_group)):
        set_moments(work.shares, 6 * m, wrench.usual, m, wrench.round[m], work.weights)


@merged
def _group_piece(B, b, f, i, g, wrench, work):
    """Return the piece of row B[b, f] for the bodies of group g per unit of their mass factor."""
    piece = _plus(0.0, 0.0, work.fixed[g], 1.0, B, b, f, wrench.nominal, i, g)
    for k in range(len(wrench.group)):
        if wrench.group[k] == g:
            piece = _plus(piece[0], piece[1], piece[2], work.signs[k], B, b, f, wrench.terms, i, k)
    for q in range(len(wrench.usual)):
        if wrench.moment_group[q // 6] == g:
            piece = _plus(piece[0], piece[1], piece[2], work.weights[q], B, b, f, wrench.moments, i, q)
    return piece


@compiled_inner()
def _plus(a, slope, c, weight, B, b, f, coefficients, i, k):
    """Return a piece (a, slope, c) plus a weight times row B[b, f] times the coefficients [i, :, k, :]."""
    for j in range(B.shape[2]):
        factor = weight * B[b, f, j]
        a += factor * coefficients[i, j, k, 0]
        slope += factor * coefficients[i, j, k, 1]
        c += factor * coefficients[i, j, k, 2]
    return a, slope, c


@compiled(_nrt=False)
def family_values(family, points, u, x, work, out):
    """Set out (M, F) to the values of the rows at grid points (M,) and (u, x), (M,) each."""
    for m in range(len(points)):
        i = points[m]
        b = i if family.B.shape[0] > 1 else 0
        find_wrenches(family.wrench, i, u[m], x[m], work)
        for f in range(out.shape[1]):
            own = own_part(family.base, i, f, u[m], x[m])
            if is_coupled(family.wrench):
                out[m, f] = own + coupled_value(family.B, family.base_terms, family.wrench, b, f, i, work)
            else:
                find_margin(family, b, f, i, work)
                out[m, f] = row_value(family, b, f, i, own, work)
