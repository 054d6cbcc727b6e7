"""Clipping of convex polygons with half-planes, compiled.

A polygon is worked on in a `Draft`, which has room for every vertex that may appear. A half-plane is a row
a u + b x + c <= 0. The functions take arrays with indices, not parts of arrays: numba counts references to the latter,
which costs more than the arithmetic, most of all if threads share an array.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from robustopt.arrays import Array, Flags, Indices
from robustopt.compiled import compiled, merged

MAX_VERTICES = 384
"""Most vertices of a polygon while it is cut."""


class Draft(NamedTuple):
    """A polygon that is being cut, and the place that its next version is written to.

    Attributes:
        vertices: vertices (u, x) counter-clockwise, (MAX_VERTICES, 2).
        rows: row (a, b, c) of the edge that starts at each vertex, (MAX_VERTICES, 3).
        names: name of each edge (MAX_VERTICES,).
        kept: vertices that are known to satisfy every row (MAX_VERTICES,).
        new_vertices: vertices of the next version.
        new_rows: its rows.
        new_names: its names.
        new_kept: its vertices that are known to satisfy every row.
    """

    vertices: Array
    rows: Array
    names: Indices
    kept: Flags
    new_vertices: Array
    new_rows: Array
    new_names: Indices
    new_kept: Flags


def empty_draft():
    """Return a draft without a polygon."""
    arrays = [
        (np.zeros((MAX_VERTICES, 2)), np.zeros((MAX_VERTICES, 3)), np.zeros(MAX_VERTICES, np.int64),
        np.zeros(MAX_VERTICES, np.bool_))
        for _ in range(2)
    ]  # fmt: skip
    return Draft(*arrays[0], *arrays[1])


@merged
def read(polygons, i, draft):
    """Copy polygon i into a draft; return the number of its vertices."""
    V, R, L, kept = draft.vertices, draft.rows, draft.names, draft.kept
    vertices, rows, n = polygons.vertices, polygons.rows, polygons.sizes[i]
    for k in range(n):
        V[k, 0], V[k, 1] = vertices[i, k, 0], vertices[i, k, 1]
        R[k, 0], R[k, 1], R[k, 2], L[k] = rows[i, k, 0], rows[i, k, 1], rows[i, k, 2], polygons.names[i, k]
        kept[k] = False
    return n


@merged
def write(draft, n, polygons, i):
    """Copy a draft of n vertices to polygon i; if there is no room for it, only its size."""
    V, R, vertices, rows, names = draft.vertices, draft.rows, polygons.vertices, polygons.rows, polygons.names
    polygons.sizes[i] = n
    if n <= names.shape[1]:
        for k in range(n):
            vertices[i, k, 0], vertices[i, k, 1] = V[k, 0], V[k, 1]
            rows[i, k, 0], rows[i, k, 1], rows[i, k, 2], names[i, k] = R[k, 0], R[k, 1], R[k, 2], draft.names[k]


@merged
def sizes_along(V, n):
    """Return the largest sizes of u and of x of n vertices."""
    u, x = 0.0, 0.0
    for k in range(n):
        u, x = max(u, abs(V[k, 0])), max(x, abs(V[k, 1]))
    return u, x


@merged
def largest_value(V, n, a, b, c):
    """Return the largest value of a u + b x + c at n vertices."""
    largest = -np.inf
    for k in range(n):
        largest = max(largest, a * V[k, 0] + b * V[k, 1] + c)
    return largest


@merged
def clip(draft, n, a, b, c, name):
    """Keep the part of a draft of n vertices with a u + b x + c <= 0; return the number of its vertices.

    The new edge takes the row's name. Both ends of it are vertices that are not known to satisfy every row.
    """
    V, R, L, kept, V2, R2, L2, kept2 = draft
    if largest_value(V, n, a, b, c) <= 0.0:
        return n
    m = 0
    before = a * V[n - 1, 0] + b * V[n - 1, 1] + c
    for k in range(n):
        value = a * V[k, 0] + b * V[k, 1] + c
        # The edge that ends at vertex k crosses the line: a new vertex, with the row's edge or the rest of the old one.
        if (value > 0.0) != (before > 0.0):
            share = before / (before - value)
            p = k - 1 if k > 0 else n - 1
            for j in range(2):
                V2[m, j] = V[p, j] + share * (V[k, j] - V[p, j])
            kept2[m] = False
            R2[m, 0], R2[m, 1], R2[m, 2], L2[m] = R[p, 0], R[p, 1], R[p, 2], L[p]
            if value > 0.0:
                R2[m, 0], R2[m, 1], R2[m, 2], L2[m] = a, b, c, name
            m += 1
        # A vertex on the right side stays as it is.
        if value <= 0.0:
            V2[m, 0], V2[m, 1], kept2[m] = V[k, 0], V[k, 1], kept[k]
            R2[m, 0], R2[m, 1], R2[m, 2], L2[m] = R[k, 0], R[k, 1], R[k, 2], L[k]
            m += 1
        before = value
    for k in range(m):
        V[k, 0], V[k, 1], kept[k] = V2[k, 0], V2[k, 1], kept2[k]
        R[k, 0], R[k, 1], R[k, 2], L[k] = R2[k, 0], R2[k, 1], R2[k, 2], L2[k]
    return m


@compiled(_nrt=False)
def cut_rows(polygons, rows, names, result, draft):
    """Cut each polygon with rows of its own.

    Args:
        polygons: the polygons.
        rows: the rows (P, F, 3).
        names: name of each row (F,).
        result: polygons that the results are written to.
        draft: work arrays.

    Returns:
        Size of the largest result; more than MAX_VERTICES if one does not fit into a draft.
    """
    largest = 0
    for i in range(len(polygons.sizes)):
        n = read(polygons, i, draft)
        for f in range(rows.shape[1]):
            if n >= 3:
                n = clip(draft, n, rows[i, f, 0], rows[i, f, 1], rows[i, f, 2], names[f])
            if n > MAX_VERTICES - 2:
                return MAX_VERTICES + 1
        n = n if n >= 3 else 0
        write(draft, n, result, i)
        largest = max(largest, n)
    return largest
