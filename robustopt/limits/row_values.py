"""Values of the rows of a family at one grid point and (u, x), every parameter at its worst, compiled.

The formula is the one at the head of `polygons`. The wrenches that all rows multiply are evaluated once per (u, x), in
a `RowWork`. The functions take arrays with indices, not tuples or parts of arrays, or are inlined; see `clipping`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from robustopt.arrays import Array, Indices
from robustopt.compiled import compiled, compiled_inner
from robustopt.limits.coupling import (
    Coupled,
    coupled_value,
    coupled_work,
    find_product_bounds,
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


@compiled()
def row_work(family):
    """Return the work arrays for a family."""
    wrench, (F, d), G = family.wrench, family.B.shape[1:], len(family.wrench.lowest)
    n, m = len(wrench.group), len(wrench.usual)
    return RowWork(
        np.zeros((G, d)), np.zeros((n, d)), np.zeros((m, d)), np.zeros(m), np.zeros((F, G)), np.full(F, -1),
        np.zeros(n), np.zeros(m), np.zeros(G), coupled_work(wrench),
    )  # fmt: skip


@compiled_inner(forceinline=True)
def wrenches_at(coefficients, i, u, x, out):
    """Set out (n, d) to the wrenches of coefficients (P, d, n, 3) at grid point i and (u, x)."""
    for k in range(coefficients.shape[2]):
        for j in range(coefficients.shape[1]):
            out[k, j] = coefficients[i, j, k, 0] * u + coefficients[i, j, k, 1] * x + coefficients[i, j, k, 2]


@compiled_inner(forceinline=True)
def add_sizes(wrenches, group, out):
    """Add |wrenches[k]| to out[group[k]]."""
    for k in range(len(group)):
        for j in range(out.shape[1]):
            out[group[k], j] += abs(wrenches[k, j])


@compiled_inner(forceinline=True)
def find_margin(family, b, f, i, work):
    """Set the margins of row B[b, f] to what the interval terms that depend on neither u nor x add to it at most."""
    B, wrench, base_terms, margins = family.B, family.wrench, family.base_terms, work.margins
    constant, group = wrench.constant, wrench.constant_group
    if work.known[f] == i:
        return
    work.known[f] = i
    for g in range(margins.shape[1]):
        margins[f, g] = 0.0
    for k in range(len(group)):
        product = base_terms[i, f, k] if base_terms.shape[0] else 0.0
        for j in range(B.shape[2]):
            product += B[b, f, j] * constant[i, j, k]
        margins[f, group[k]] += abs(product)
    if is_coupled(wrench):
        find_product_bounds(family, b, f, i, work)


@compiled_inner(fastmath={"contract"}, forceinline=True)
def own_part(base, i, f, u, x):
    """Return a row's own part at grid point i and (u, x)."""
    return base[i, f, 0] * u + base[i, f, 1] * x + base[i, f, 2] if base.shape[0] else 0.0


@compiled_inner(forceinline=True)
def row_value(family, b, f, i, u, x, work):
    """Return the value of row B[b, f] at grid point i and (u, x), whose wrenches and margin have been found.

    It is an upper bound if the terms of the row depend on the acceleration error; `worst_value` is exact.
    """
    B, group, lowest, highest = family.B, family.wrench.group, family.wrench.lowest, family.wrench.highest
    moment_group, usual, is_round = family.wrench.moment_group, family.wrench.usual, family.wrench.round
    central, swings, margins, y = work.central, work.swings, work.margins, work.shares
    for q in range(len(usual)):
        y[q] = 0.0
        for j in range(B.shape[2]):
            y[q] += B[b, f, j] * work.moments[q, j]
    total = own_part(family.base, i, f, u, x)
    for g in range(len(lowest)):
        value = margins[f, g]
        for j in range(B.shape[2]):
            value += B[b, f, j] * central[g, j]
        for k in range(len(group)):
            if group[k] == g:
                product = 0.0
                for j in range(B.shape[2]):
                    product += B[b, f, j] * swings[k, j]
                value += abs(product)
        for m in range(len(moment_group)):
            if moment_group[m] == g:
                value += support(y, 6 * m, usual, m, is_round[m])
        total += value * (highest[g] if value > 0.0 else lowest[g])
    return total


@compiled_inner()
def worst_value(family, b, f, i, u, x, work):
    """Return the value of row B[b, f] at grid point i and (u, x), and set signs, weights and fixed to the worst.

    The wrenches and the margin have been found.
    """
    B, wrench = family.B, family.wrench
    if is_coupled(wrench):
        return own_part(family.base, i, f, u, x) + coupled_value(family, b, f, i, work)
    value = row_value(family, b, f, i, u, x, work)
    for g in range(len(wrench.lowest)):
        work.fixed[g] = work.margins[f, g]
    for k in range(len(wrench.group)):
        product = 0.0
        for j in range(B.shape[2]):
            product += B[b, f, j] * work.swings[k, j]
        work.signs[k] = -1.0 if product < 0.0 else 1.0
    for m in range(len(wrench.moment_group)):
        set_moments(work.shares, 6 * m, wrench.usual, m, wrench.round[m], work.weights)
    return value


@compiled_inner(forceinline=True)
def _plus(piece, weight, coefficients, i, j, k):
    """Return a piece (a, slope, c) plus the weighted coefficients [i, j, k, :]."""
    a, slope, c = piece
    return (
        a + weight * coefficients[i, j, k, 0],
        slope + weight * coefficients[i, j, k, 1],
        c + weight * coefficients[i, j, k, 2],
    )


@compiled_inner(forceinline=True)
def _group_piece(B, b, wrench, i, f, g, fixed, signs, weights):
    """Return the piece of row B[b, f] for the bodies of group g per unit of their mass factor."""
    piece = (0.0, 0.0, fixed[g])
    for j in range(B.shape[2]):
        piece = _plus(piece, B[b, f, j], wrench.nominal, i, j, g)
    for k in range(len(wrench.group)):
        if wrench.group[k] == g:
            for j in range(B.shape[2]):
                piece = _plus(piece, signs[k] * B[b, f, j], wrench.terms, i, j, k)
    for q in range(len(wrench.usual)):
        if wrench.moment_group[q // 6] == g:
            for j in range(B.shape[2]):
                piece = _plus(piece, weights[q] * B[b, f, j], wrench.moments, i, j, q)
    return piece


@compiled_inner()
def active_piece(B, b, wrench, base, i, f, fixed, signs, weights, u, x):
    """Return the affine piece (a, slope, c) of row B[b, f] at grid point i for worst parameters that were found.

    a u + slope x + c is the row's value at the (u, x) at which they are the worst, and nowhere larger than its value.
    """
    a, slope, c = 0.0, 0.0, 0.0
    if base.shape[0]:
        a, slope, c = base[i, f, 0], base[i, f, 1], base[i, f, 2]
    for g in range(len(wrench.lowest)):
        p, q, r = _group_piece(B, b, wrench, i, f, g, fixed, signs, weights)
        scale = wrench.highest[g] if p * u + q * x + r > 0.0 else wrench.lowest[g]
        a, slope, c = a + scale * p, slope + scale * q, c + scale * r
    return a, slope, c


@compiled()
def family_values(family, points, u, x, out):
    """Set out (M, F) to the values of the rows at grid points (M,) and (u, x), (M,) each."""
    work = row_work(family)
    wrench = family.wrench
    for m in range(len(points)):
        i = points[m]
        b = i if family.B.shape[0] > 1 else 0
        wrenches_at(wrench.nominal, i, u[m], x[m], work.central)
        wrenches_at(wrench.terms, i, u[m], x[m], work.swings)
        wrenches_at(wrench.moments, i, u[m], x[m], work.moments)
        work.known[:] = -1
        for f in range(out.shape[1]):
            find_margin(family, b, f, i, work)
            out[m, f] = worst_value(family, b, f, i, u[m], x[m], work)
