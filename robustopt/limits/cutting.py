"""Cutting of feasible polygons with a family of rows, compiled; `polygons` has its formula.

The family is evaluated at a vertex, the row that is violated most cuts the polygon, and so on until no vertex violates
anything. Two things keep this cheap, and change no result. Bounds tell which rows may be violated (see `row_bounds`).
And rows that bind at one grid point mostly bind at the next, so they are tried there first, by the piece that is active
where they bound; then nearly every look at all rows confirms a vertex.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from robustopt.arrays import Array, Indices
from robustopt.compiled import compiled, compiled_inner
from robustopt.limits.clipping import MAX_VERTICES, clip, empty_draft, largest_value, read, size_along, write
from robustopt.limits.coupling import is_coupled, largest_weight
from robustopt.limits.row_bounds import block_bounds, next_above, row_blocks, row_bounds
from robustopt.limits.row_values import (
    active_piece,
    add_sizes,
    find_margin,
    row_value,
    row_work,
    worst_value,
    wrenches_at,
)

TOLERANCE = 1e-10
"""Largest violation of a row, relative to the limit, that a vertex of a polygon may keep: ten times rounding error."""

ROUNDING = 1e-14
"""Part of the largest terms of a row in a polygon by which its value at a vertex may be off; this matters only
far from any plan."""

MOST_LOOKS = 20 * MAX_VERTICES
"""Vertices of one polygon that are looked at, at most."""

ROW = -2
"""Name of the edge that row 0 of the family makes while a polygon is cut; row f has ROW - f."""


class Tried(NamedTuple):
    """Rows that bounded the last polygon, to be tried first.

    Attributes:
        rows: rows of the family (MAX_VERTICES,).
        points: middles (u, x) of their edges (MAX_VERTICES, 2).
    """

    rows: Indices
    points: Array


@compiled()
def cut_family(polygons, family, result):
    """Cut each polygon with the rows of a family.

    Args:
        polygons: the polygons.
        family: the rows.
        result: polygons that the results are written to.

    Returns:
        Size of the largest result; more than MAX_VERTICES if one does not fit into a draft.
    """
    draft, work, blocks = empty_draft(), row_work(family), row_blocks(family)
    tried = Tried(np.zeros(MAX_VERTICES, np.int64), np.zeros((MAX_VERTICES, 2)))
    count, largest = 0, 0
    for i in range(len(polygons.sizes)):
        n = read(polygons, i, draft)
        if n < 3:
            continue
        draft.kept[:] = False
        sizes = size_along(draft.vertices, n, 0), size_along(draft.vertices, n, 1)
        n = _try_rows(family, i, tried, count, work, draft, n, sizes)
        if 3 <= n <= MAX_VERTICES - 2:
            n = _cut_at_vertices(family, i, blocks, work, draft, n, sizes)
        if n > MAX_VERTICES - 2:
            return MAX_VERTICES + 1
        n = n if n >= 3 else 0
        count = _name_edges(draft.vertices, draft.names, n, family.names, tried.rows, tried.points)
        write(draft, n, result, i)
        largest = max(largest, n)
    return largest


@compiled()
def worst_rows(family, points, u, x, values, pieces):
    """Find the row of a family that is violated most, for several (u, x).

    Args:
        family: the rows.
        points: grid points (M,).
        u: sdd (M,).
        x: sd^2 (M,).
        values: set to its value, or to 0 if none is violated (M,).
        pieces: set to its active piece a u + slope x + c, if it is violated (M, 3).
    """
    work, blocks = row_work(family), row_blocks(family)
    for m in range(len(points)):
        i = points[m]
        _find_reach(family, i, blocks)
        _find_wrenches(family.wrench, i, u[m], x[m], work, blocks)
        f, violation = _worst_row(family, i, u[m], x[m], work, blocks)
        if f >= 0:
            values[m] = violation
            pieces[m, 0], pieces[m, 1], pieces[m, 2] = _piece(family, f, i, u[m], x[m], work)


@compiled_inner(forceinline=True)
def _try_rows(family, i, tried, count, work, draft, n, sizes):
    """Cut a draft of n vertices with the rows that bounded the last polygon; return the number of its vertices."""
    for k in range(count):
        f, u, x = tried.rows[k], tried.points[k, 0], tried.points[k, 1]
        _find_intervals(family.wrench, i, u, x, work)
        wrenches_at(family.wrench.nominal, i, u, x, work.central)
        piece = _piece(family, f, i, u, x, work)
        if _exceeds(largest_value(draft.vertices, n, piece[0], piece[1], piece[2]), piece, sizes):
            n = _clipped(draft, n, piece, f)
            if n < 3 or n > MAX_VERTICES - 2:
                break
    return n


@compiled_inner(forceinline=True)
def _cut_at_vertices(family, i, blocks, work, draft, n, sizes):
    """Cut a draft of n vertices until none of them violates a row; return their number, or more than MAX_VERTICES.

    A look at all rows either confirms a vertex or finds the row that cuts it off.
    """
    _find_reach(family, i, blocks)
    first = 0
    for _ in range(MOST_LOOKS):
        while first < n and draft.kept[first]:
            first += 1
        if first == n:
            return n
        u, x = draft.vertices[first, 0], draft.vertices[first, 1]
        _find_wrenches(family.wrench, i, u, x, work, blocks)
        f, violation = _worst_row(family, i, u, x, work, blocks)
        if f >= 0:
            piece = _piece(family, f, i, u, x, work)
            if _exceeds(violation, piece, sizes):
                n = _clipped(draft, n, piece, f)
                if n < 3 or n > MAX_VERTICES - 2:
                    return n
                first = 0
                continue
        draft.kept[first] = True
    return MAX_VERTICES + 1


@compiled_inner(forceinline=True)
def _find_intervals(wrench, i, u, x, work):
    """Set the interval terms and second moments at grid point i and (u, x)."""
    if len(wrench.group):
        wrenches_at(wrench.terms, i, u, x, work.swings)
    if len(wrench.usual):
        wrenches_at(wrench.moments, i, u, x, work.moments)


@compiled_inner(forceinline=True)
def _find_wrenches(wrench, i, u, x, work, blocks):
    """Set all wrenches at grid point i and (u, x), and their reach."""
    central, swings, moments, reach, fixed = work.central, work.swings, work.moments, blocks.reach, blocks.fixed
    _find_intervals(wrench, i, u, x, work)
    wrenches_at(wrench.nominal, i, u, x, central)
    if len(reach):
        for g in range(reach.shape[0]):
            for j in range(reach.shape[1]):
                reach[g, j] = fixed[g, j]
        add_sizes(swings, wrench.group, reach)
        for q in range(len(wrench.usual)):
            for j in range(reach.shape[1]):
                reach[wrench.moment_group[q // 6], j] += abs(moments[q, j]) * largest_weight(wrench.usual, q)


@compiled_inner(forceinline=True)
def _find_reach(family, i, blocks):
    """Set the parts of the reach that depend on neither u nor x, at grid point i."""
    wrench, base_terms = family.wrench, family.base_terms
    constant, group, products, n = wrench.constant, wrench.constant_group, wrench.products, len(wrench.group)
    fixed, own_reach = blocks.fixed, blocks.own_reach
    fixed[:] = 0.0
    for k in range(len(group)):
        for j in range(fixed.shape[1]):
            fixed[group[k], j] += abs(constant[i, j, k])
    for k in range(products.shape[2]):
        g = wrench.group[k] if k < n else wrench.moment_group[(k - n) // 6]
        size = 1.0 if k < n else largest_weight(wrench.usual, k - n)
        for j in range(fixed.shape[1]):
            for e in range(products.shape[3]):
                fixed[g, j] += size * abs(products[i, j, k, e])
    own_reach[:] = 0.0
    for f in range(len(own_reach)):
        for k in range(len(group)):
            own_reach[f, group[k]] += abs(base_terms[i, f, k])


@compiled_inner(forceinline=True)
def _worst_row(family, i, u, x, work, blocks):
    """Return the row that is violated most at (u, x), or -1, and by how much."""
    lowest, highest = family.wrench.lowest, family.wrench.highest
    central, reach, of_parts, of_blocks, value = (
        work.central,
        blocks.reach,
        blocks.of_parts,
        blocks.of_blocks,
        blocks.value,
    )
    found = -1, TOLERANCE
    if blocks.made:
        block_bounds(blocks.outermost, blocks.outermost_sizes, 0, central, reach, lowest, highest, of_parts, value)
    part = next_above(of_parts, 0, TOLERANCE)
    while part < len(of_parts):
        if blocks.made:
            block_bounds(blocks.extremes, blocks.extreme_sizes, part, central, reach, lowest, highest, of_blocks, value)
        m = next_above(of_blocks, 0, found[1])
        while m < len(of_blocks):
            found = _worst_of_block(family, i, u, x, part * len(of_blocks) + m, work, blocks, found)
            m = next_above(of_blocks, m + 1, found[1])
        part = next_above(of_parts, part + 1, found[1])
    return found


@compiled_inner(forceinline=True)
def _worst_of_block(family, i, u, x, m, work, blocks, found):
    """Return the worst row of block m at (u, x), and by how much it is violated; or `found` if that is worse."""
    B, base, lowest, highest = family.B, family.base, family.wrench.lowest, family.wrench.highest
    central, reach, of_rows, value = work.central, blocks.reach, blocks.of_rows, blocks.value
    b = i if B.shape[0] > 1 else 0
    worst, violation = found
    if blocks.made:
        block_bounds(blocks.entries, blocks.sizes, m, central, reach, lowest, highest, of_rows, value)
    else:
        row_bounds(B, b, base, blocks.own_reach, i, u, x, central, reach, lowest, highest, of_rows)
    r = next_above(of_rows, 0, violation)
    while r < len(of_rows):
        f = m * len(of_rows) + r
        find_margin(family, b, f, i, work)
        value_here = row_value(family, b, f, i, u, x, work)
        if value_here > violation and is_coupled(family.wrench):
            value_here = worst_value(family, b, f, i, u, x, work)
        if value_here > violation:
            worst, violation = f, value_here
        r = next_above(of_rows, r + 1, violation)
    return worst, violation


@compiled_inner()
def _piece(family, f, i, u, x, work):
    """Return the piece (a, slope, c) of row f that is active at grid point i and (u, x)."""
    b = i if family.B.shape[0] > 1 else 0
    find_margin(family, b, f, i, work)
    worst_value(family, b, f, i, u, x, work)
    return active_piece(family.B, b, family.wrench, family.base, i, f, work.fixed, work.signs, work.weights, u, x)


@compiled_inner(forceinline=True)
def _exceeds(violation, piece, sizes):
    """Return whether a piece is violated by more than rounding error in a polygon of the given sizes along u and x."""
    a, slope, c = piece
    return violation > max(TOLERANCE, ROUNDING * (abs(a) * sizes[0] + abs(slope) * sizes[1] + abs(c)))


@compiled_inner(forceinline=True)
def _clipped(draft, n, piece, f):
    """Clip a draft with the piece of row f; return the number of its vertices."""
    return clip(draft, n, piece[0], piece[1], piece[2], ROW - f)


@compiled_inner()
def _name_edges(V, L, n, names, rows, points):
    """Give the edges that are rows of the family their names; list the rows and middles, and return their number."""
    count = 0
    for k in range(n):
        if L[k] <= ROW:
            after = k + 1 if k + 1 < n else 0
            rows[count] = ROW - L[k]
            for j in range(2):
                points[count, j] = 0.5 * (V[k, j] + V[after, j])
            L[k] = names[rows[count]]
            count += 1
    return count
