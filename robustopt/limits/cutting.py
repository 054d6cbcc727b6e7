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
from robustopt.compiled import compiled, merged
from robustopt.limits.clipping import MAX_VERTICES, clip, largest_value, read, sizes_along, write
from robustopt.limits.coupling import exact_value
from robustopt.limits.row_bounds import BLOCK, find_bounds, find_reach
from robustopt.limits.row_values import active_piece, find_margin, find_wrenches, own_part, row_value

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


def none_tried():
    """Return room for rows to be tried."""
    return Tried(np.zeros(MAX_VERTICES, np.int64), np.zeros((MAX_VERTICES, 2)))


@compiled(_nrt=False)
def cut_family(polygons, rows, names, result, draft, work, blocks, tried):
    """Cut each polygon with the rows of a family.

    Args:
        polygons: the polygons.
        rows: the rows.
        names: number of the name of each (F,).
        result: polygons that the results are written to.
        draft: work arrays.
        work: work arrays for the rows.
        blocks: the rows in blocks.
        tried: room for rows to be tried.

    Returns:
        Size of the largest result; more than MAX_VERTICES if one does not fit into a draft.
    """
    count, largest = 0, 0
    for i in range(len(polygons.sizes)):
        n = read(polygons, i, draft)
        if n < 3:
            continue
        n = _cut(rows, i, tried, count, blocks, work, draft, n)
        if n > MAX_VERTICES - 2:
            return MAX_VERTICES + 1
        n = n if n >= 3 else 0
        count = _name_edges(draft.vertices, draft.names, n, names, tried.rows, tried.points)
        write(draft, n, result, i)
        largest = max(largest, n)
    return largest


@compiled(_nrt=False)
def worst_rows(rows, points, u, x, work, blocks, values, pieces):
    """Find the row of a family that is violated most, for several (u, x).

    Args:
        rows: the rows.
        points: grid points (M,).
        u: sdd (M,).
        x: sd^2 (M,).
        work: work arrays for the rows.
        blocks: the rows in blocks.
        values: set to its value, or to 0 if none is violated (M,).
        pieces: set to its active piece a u + slope x + c, if it is violated (M, 3).
    """
    for m in range(len(points)):
        i = points[m]
        b = i if rows.B.shape[0] > 1 else 0
        find_wrenches(rows.wrenches, i, u[m], x[m], work.wrenches)
        f, violation = _worst_row(rows, b, i, u[m], x[m], work, blocks)
        if f >= 0:
            values[m] = violation
            pieces[m, 0], pieces[m, 1], pieces[m, 2] = active_piece(rows, b, f, i, u[m], x[m], work)


@merged
def _cut(rows, i, tried, count, blocks, work, draft, n):
    """Cut a draft of n vertices until none of them violates a row; return their number, or more than MAX_VERTICES.

    The rows that bounded the last polygon are tried first. Then a look at all rows either confirms a vertex or finds
    the row that cuts it off.
    """
    V, kept = draft.vertices, draft.kept
    b = i if rows.B.shape[0] > 1 else 0
    size_u, size_x = sizes_along(V, n)
    first = 0
    for look in range(count + MOST_LOOKS):
        if look < count:
            f, u, x, violation = tried.rows[look], tried.points[look, 0], tried.points[look, 1], 0.0
        else:
            while first < n and kept[first]:
                first += 1
            if first == n:
                return n
            u, x = V[first, 0], V[first, 1]
        find_wrenches(rows.wrenches, i, u, x, work.wrenches)
        if look >= count:
            f, violation = _worst_row(rows, b, i, u, x, work, blocks)
        if f >= 0:
            a, slope, c = active_piece(rows, b, f, i, u, x, work)
            if look < count:
                violation = largest_value(V, n, a, slope, c)
            # a vertex that violates a row by rounding error is kept
            if violation > max(TOLERANCE, ROUNDING * (abs(a) * size_u + abs(slope) * size_x + abs(c))):
                n = clip(draft, n, a, slope, c, ROW - f)
                if n < 3 or n > MAX_VERTICES - 2:
                    return n
                first = 0
                continue
        if look >= count:
            kept[first] = True
    return MAX_VERTICES + 1


@merged
def _worst_row(rows, b, i, u, x, work, blocks):
    """Return the row that is violated most at (u, x), or -1, and by how much.

    Blocks are searched depth first, those alone that may contain a row that is violated more than the worst so far.
    """
    if len(blocks.reach):
        find_reach(rows, i, work.wrenches, blocks)
    bounds = blocks.bounds
    levels, width = bounds.shape
    worst, violation = -1, TOLERANCE
    # the place is k among the blocks of block m of a level, or -1 if their bounds have not been found
    level, m, k = levels - 1, 0, -1
    while level < levels:
        if k < 0:
            find_bounds(rows, b, i, u, x, work.wrenches, blocks, level, m)
            k = 0
        while k < width and bounds[level, k] <= violation:
            k += 1
        if k == width:
            level, m, k = level + 1, m // BLOCK, m % BLOCK + 1
        elif level > 0:
            level, m, k = level - 1, m * BLOCK + k, -1
        else:
            f = m * BLOCK + k
            own = own_part(rows.base, i, f, u, x)
            find_margin(rows, b, f, i, work)
            value = row_value(rows, b, f, own, work)
            if value > violation and rows.changes.shape[3]:
                value = own + exact_value(rows, b, f, i, work)
            if value > violation:
                worst, violation = f, value
            k += 1
    return worst, violation


@merged
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
