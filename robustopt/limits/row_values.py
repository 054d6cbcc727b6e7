"""Values of the rows of a family at one grid point and (u, x), every parameter at its worst, compiled.

The formula is the one at the head of `polygons`. The wrenches that all rows multiply are evaluated once per (u, x), in
a `RowWork`. The functions take arrays with indices, not tuples or parts of arrays, or are inlined; see `clipping`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from robustopt.arrays import Array, Indices
from robustopt.compiled import compiled, compiled_inner


class RowWork(NamedTuple):
    """Work arrays for the values of rows: the parts of the required wrench at (u, x), and of rows at a grid point.

    Attributes:
        central: W_g0 (G, d).
        swings: interval terms W_gk (n, d).
        remains: remainders R_gk (n_r, d).
        box: sum_k |R_gk| (G, d).
        margins: share of the constant interval terms in each row (F, G).
        known: grid point that the margins of each row are of (F,).
    """

    central: Array
    swings: Array
    remains: Array
    box: Array
    margins: Array
    known: Indices


@compiled()
def row_work(family):
    """Return the work arrays for a family."""
    wrench, (F, d), G = family.wrench, family.B.shape[1:], len(family.wrench.lowest)
    return RowWork(
        np.zeros((G, d)), np.zeros((len(wrench.group), d)), np.zeros((len(wrench.remainder_group), d)),
        np.zeros((G, d)), np.zeros((F, G)), np.full(F, -1),
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
    """Set the margins of row B[b, f] to what the interval terms that depend on neither u nor x add to it."""
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


@compiled_inner(fastmath={"contract"}, forceinline=True)
def own_part(base, i, f, u, x):
    """Return a row's own part at grid point i and (u, x)."""
    return base[i, f, 0] * u + base[i, f, 1] * x + base[i, f, 2] if base.shape[0] else 0.0


@compiled_inner(forceinline=True)
def row_value(family, b, f, i, u, x, work):
    """Return the value of row B[b, f] at grid point i and (u, x), whose wrenches and margin have been found."""
    B, group, lowest, highest = family.B, family.wrench.group, family.wrench.lowest, family.wrench.highest
    central, swings, box, margins = work.central, work.swings, work.box, work.margins
    total = own_part(family.base, i, f, u, x)
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
        total += value * (highest[g] if value > 0.0 else lowest[g])
    return total


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
def _group_piece(B, b, wrench, i, f, g, margin, swings, remains):
    """Return the piece of row B[b, f] for the bodies of group g per unit of their mass factor."""
    group, remainder_group = wrench.group, wrench.remainder_group
    piece = (0.0, 0.0, margin)
    for j in range(B.shape[2]):
        piece = _plus(piece, B[b, f, j], wrench.nominal, i, j, g)
    # Each interval term takes the sign that makes it positive.
    for k in range(len(group)):
        if group[k] == g:
            product = 0.0
            for j in range(B.shape[2]):
                product += B[b, f, j] * swings[k, j]
            sign = -1.0 if product < 0.0 else 1.0
            for j in range(B.shape[2]):
                piece = _plus(piece, sign * B[b, f, j], wrench.terms, i, j, k)
    # So does each coordinate of a remainder.
    for k in range(len(remainder_group)):
        if remainder_group[k] == g:
            for j in range(B.shape[2]):
                weight = abs(B[b, f, j]) * (-1.0 if remains[k, j] < 0.0 else 1.0)
                piece = _plus(piece, weight, wrench.remainder, i, j, k)
    return piece


@compiled_inner(forceinline=True)
def active_piece(B, b, wrench, base, i, f, margins, swings, remains, u, x):
    """Return the affine piece (a, slope, c) of row B[b, f] at grid point i that is active at (u, x).

    a u + slope x + c is the row's value there, and nowhere larger than its value.
    """
    a, slope, c = 0.0, 0.0, 0.0
    if base.shape[0]:
        a, slope, c = base[i, f, 0], base[i, f, 1], base[i, f, 2]
    for g in range(len(wrench.lowest)):
        p, q, r = _group_piece(B, b, wrench, i, f, g, margins[f, g], swings, remains)
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
        wrenches_at(wrench.remainder, i, u[m], x[m], work.remains)
        work.box[:] = 0.0
        add_sizes(work.remains, wrench.remainder_group, work.box)
        work.known[:] = -1
        for f in range(out.shape[1]):
            find_margin(family, b, f, i, work)
            out[m, f] = row_value(family, b, f, i, u[m], x[m], work)
