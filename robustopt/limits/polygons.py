"""Feasible polygons: the exact set of (u, x) that every value of the uncertain parameters allows at a grid point.

At one grid point each limit is a convex function of u = sdd and x = sd^2: the maximum, over the box of the parameters,
of rows that are affine in (u, x). The feasible set is therefore a convex polygon. It is found by cutting: start from a
polygon, evaluate all rows at its vertices, cut with the most violated row, and repeat until no vertex violates a row.
Of the several hundred facets of a friction cone only the few that bind near the polygon ever become rows, and the edges
of the final polygon are exactly the rows that are not redundant (our choice).

A row family is, for B (F, d) and a load W that is affine in (u, x),

    value_f = base_f + max_e sum_g scale_g(v_fg) v_fg,   v_fg = B_f W_g0 + sum_k |B_f W_gk| + sum_b h(B_f W_gb),

in which g runs over groups of bodies, scale_g(v) is the largest mass of the group if v > 0 and its smallest otherwise,
the W_gk are interval terms, W_gb is the wrench per second moment of body b (see `bodies`), and all of them depend on
the acceleration error e. h is the support function of the set of second moments,

    h(y) = sum_a max(0, r_a),   r_a = y_aa + sum_b |y_ab| / 2,   with max(0, r_x, r_y) for both axes of a disc.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from robustopt.compiled import compiled
from robustopt.errors import SolverFailed
from robustopt.limits.clipping import MAX_VERTICES, cut_rows, empty_draft
from robustopt.limits.coupling import columns_of, row_work
from robustopt.limits.cutting import cut_family, none_tried, worst_rows
from robustopt.limits.row_bounds import row_blocks
from robustopt.limits.row_values import family_values

Array = np.ndarray

ROOM = 16
"""Initial room for the vertices of a polygon, which grows if needed; waiter tasks need fewer."""

EDGE_LENGTH, EDGE_CHANGE = 1e-9, 1e-10
"""Edges of a feasible polygon shorter than this fraction of its size are rounding errors, not rows, if the terms of
their row also change by less than this fraction of the limit. The first would not do alone: where few limits bind the
polygon is large, and an edge near the plan is short beside it."""

NO_NAME = -1
"""Number of the name of the edges x >= 0 and of the bounds of the initial polygon."""


class Polygons(NamedTuple):
    """One polygon per grid point, and the row that each of its edges lies on.

    Attributes:
        vertices: vertices (u, x), counter-clockwise (P, V, 2).
        rows: row a u + b x + c <= 0 of the edge that starts at each vertex (P, V, 3).
        names: number of the name of each row (P, V).
        sizes: number of vertices, 0 if no (u, x) is feasible (P,).
    """

    vertices: Array
    rows: Array
    names: Array
    sizes: Array


ALONG_PATH = ("nominal", "terms", "moments", "constant", "products")
"""Names of the arrays of a required wrench with an axis of grid points and one of coordinates, in this order."""


class RequiredWrench(NamedTuple):
    """The quantities that the rows of a family multiply, in groups; the mass of a group has one interval.

    Attributes:
        nominal: W_g0, coefficients of (u, x, 1) last (P, d, G, 3).
        terms: interval terms W_gk (P, d, n, 3).
        group: group of each interval term (n,).
        moments: wrenches per second moment, six in turn for each of m bodies, in the order of `INERTIA_TERMS`,
            (P, d, 6 m, 3).
        moment_group: group of each of these bodies (m,).
        usual: their nominal second moments, which the nominal wrenches contain, (6 m,).
        round: whether the first two axes of each are those of a disc (m,).
        constant: interval terms that depend on neither u nor x (P, d, n_c): first those of the E coordinates with an
            acceleration error, group by group, then others.
        constant_group: group of each of them (n_c,).
        products: change of each interval term, then of each second moment, by each acceleration error
            (P, d, n + 6 m, E).
        lowest: smallest mass factor of each group (G,).
        highest: largest mass factor of each group (G,).
    """

    nominal: Array
    terms: Array
    group: Array
    moments: Array
    moment_group: Array
    usual: Array
    round: Array
    constant: Array
    constant_group: Array
    products: Array
    lowest: Array
    highest: Array

    def middle(self) -> Array:
        """Return the load with every parameter at the middle of its interval: coefficients of (u, x, 1), (P, d, 3)."""
        middle: Array = np.einsum("pdgk,g->pdk", self.nominal, 0.5 * (self.lowest + self.highest))
        return middle

    def at(self, points: Array | slice) -> RequiredWrench:
        """Return the required wrenches at some of the grid points.

        Args:
            points: the grid points, indices or a slice.
        """
        return self._replace(**{name: getattr(self, name)[points] for name in ALONG_PATH})


class Family(NamedTuple):
    """Rows over required wrenches; the formula stands at the head of the module.

    Attributes:
        B: coefficients of the load (1, F, d), or (P, F, d) if the rows differ between grid points; d = 6 for each
            wrench of a stack.
        wrench: the required wrenches.
        base: affine part of each row that does not depend on the load (P, F, 3), or (0, 0, 3) for none.
        base_terms: contribution of each constant interval term to a row beside its load (P, F, n_c), or (0, 0, 0).
        names: number of the name of each row (F,).
    """

    B: Array
    wrench: RequiredWrench
    base: Array
    base_terms: Array
    names: Array


def facet_family(facets: Array, wrench: RequiredWrench, names: Array) -> Family:
    """Return the family of rows that are the same at every grid point and have no affine part.

    Args:
        facets: the rows (F, d).
        wrench: the required wrenches that they multiply.
        names: number of the name of each row (F,).
    """
    return Family(np.ascontiguousarray(facets)[None], wrench, np.zeros((0, 0, 3)), np.zeros((0, 0, 0)), names)


def start(u_bound: Array, x_max: Array, velocity_name: Array) -> Polygons:
    """Return rectangles |u| <= u_bound, 0 <= x <= x_max, one per grid point.

    Args:
        u_bound: largest |u| (P,).
        x_max: largest x (P,).
        velocity_name: number of the name of the limit x <= x_max (P,).
    """
    points = len(x_max)
    polygons = _empty(points, 4)
    vertices, rows, names = polygons.vertices, polygons.rows, polygons.names
    vertices[:], rows[:], names[:] = 0.0, 0.0, NO_NAME
    vertices[:, 0, 0] = vertices[:, 3, 0] = -u_bound
    vertices[:, 1, 0] = vertices[:, 2, 0] = u_bound
    vertices[:, 2, 1] = vertices[:, 3, 1] = x_max
    rows[:, 0, 1] = -1.0
    rows[:, 1, 0], rows[:, 1, 2] = 1.0, -u_bound
    rows[:, 2, 1], rows[:, 2, 2] = 1.0, -x_max
    rows[:, 3, 0], rows[:, 3, 2] = -1.0, -u_bound
    names[:, 2] = velocity_name
    polygons.sizes[:] = 4
    return polygons


def _empty(points: int, room: int) -> Polygons:
    """Return polygons without vertices; entries beyond the vertices of a polygon have no meaning."""
    vertices, rows = np.empty((points, room, 2)), np.empty((points, room, 3))
    return Polygons(vertices, rows, np.empty((points, room), dtype=np.int64), np.zeros(points, dtype=np.int64))


def cut(polygons: Polygons, family: Family) -> Polygons:
    """Return the polygons cut with a family of rows.

    Args:
        polygons: polygons so far, which are not changed.
        family: the rows.

    Raises:
        SolverFailed: a polygon would have more than `MAX_VERTICES` edges.
    """
    if not len(family.names):
        return polygons
    rows = columns_of(family)
    work = empty_draft(), row_work(rows), row_blocks(rows), none_tried()
    return _stored(lambda result: cut_family(polygons, rows, family.names, result, *work), polygons)


def cut_part(polygons: Polygons, family: Family, first: int, last: int) -> Polygons:
    """Return the polygons, cut with a family of rows at some of the grid points.

    Args:
        polygons: polygons so far, which are not changed.
        family: the rows at all grid points.
        first: first grid point to cut.
        last: last grid point to cut; if negative, all of them are cut.

    Raises:
        SolverFailed: a polygon would have more than `MAX_VERTICES` edges.
    """
    if last < 0 or not len(family.names):
        return cut(polygons, family)
    part = slice(first, last + 1)
    inner = cut(Polygons(*(array[part] for array in polygons)), family._replace(wrench=family.wrench.at(part)))
    result = _empty(len(polygons.sizes), max(polygons.names.shape[1], inner.names.shape[1]))
    for array, before, after in zip(result, polygons, inner, strict=True):
        if array.ndim > 1:
            array[:, : before.shape[1]] = before
            array[part, : after.shape[1]] = after
        else:
            array[:], array[part] = before, after
    return result


def cut_affine(polygons: Polygons, rows: Array, names: Array) -> Polygons:
    """Return the polygons cut with rows a u + b x + c <= 0.

    Args:
        polygons: polygons so far, which are not changed.
        rows: a, b and c (P, F, 3).
        names: number of the name of each row (F,).

    Raises:
        SolverFailed: a polygon would have more than `MAX_VERTICES` edges.
    """
    if not len(names):
        return polygons
    rows, draft = np.ascontiguousarray(rows), empty_draft()
    return _stored(lambda result: cut_rows(polygons, rows, names, result, draft), polygons)


def evaluate(family: Family, points: Array, u: Array, x: Array) -> Array:
    """Return the values of a family of rows with every uncertain parameter at its worst, (M, F).

    Args:
        family: the rows.
        points: grid points (M,).
        u: sdd (M,).
        x: sd^2 (M,).
    """
    values = np.zeros((len(points), len(family.names)))
    rows = columns_of(family)
    family_values(rows, points, u, x, row_work(rows), values)
    return values


def worst(family: Family, points: Array, u: Array, x: Array) -> tuple[Array, Array]:
    """Return how much the worst row of a family is violated with every uncertain parameter at its worst, and its piece.

    Args:
        family: the rows.
        points: grid points (M,).
        u: sdd (M,).
        x: sd^2 (M,).

    Returns:
        Values (M,), 0 if no row is violated; and the row a u + b x + c <= 0 for the worst parameters (M, 3).
    """
    values, pieces = np.zeros(len(points)), np.zeros((len(points), 3))
    rows = columns_of(family)
    worst_rows(rows, points, u, x, row_work(rows), row_blocks(rows), values, pieces)
    return values, pieces


def _stored(cut_into: Callable[[Polygons], int], polygons: Polygons) -> Polygons:
    """Return the result of a function that cuts polygons and returns their largest size, with room for this one."""
    room = max(ROOM, polygons.names.shape[1])
    while True:
        result = _empty(len(polygons.sizes), room)
        largest = cut_into(result)
        if largest > MAX_VERTICES:
            raise SolverFailed(f"a feasible polygon at a grid point has more than {MAX_VERTICES} edges")
        if largest <= room:
            return result
        room = largest


def edge_rows(polygons: Polygons, joints: int, names: int) -> tuple[Array, Array]:
    """Return the edges of the polygons as rows.

    A name has as many columns as one grid point needs at most. A column that a grid point does not need holds a row
    that is always satisfied.

    Args:
        polygons: the polygons.
        joints: names below this number are of velocities; their bounds of x become no rows.
        names: number of names.

    Returns:
        Rows (P, m, 3), and the number of the name of each column (m,).
    """
    slots, width = np.full(polygons.names.shape, -1), np.zeros(names, dtype=np.int64)
    _find_slots(
        polygons.vertices, polygons.rows, polygons.names, polygons.sizes, joints, slots, width, np.zeros_like(width)
    )
    first = np.cumsum(width) - width
    rows = np.zeros((len(polygons.sizes), width.sum(), 3))
    rows[:, :, 2] = -1.0
    _place(polygons.rows, polygons.names, polygons.sizes, slots, first, rows)
    return rows, np.repeat(np.arange(names), width)


@compiled(_nrt=False)
def _find_slots(vertices, rows, edge_names, count, joints, slots, width, used):
    """Set the number of each edge among the edges of its name, and the number of edges per name.

    Args:
        vertices: vertices of the polygons (P, V, 2).
        rows: rows of their edges (P, V, 3).
        edge_names: number of the name of each edge (P, V).
        count: number of edges (P,).
        joints: names below this number are of velocities; their bounds of x become no rows.
        slots: set to the number of each edge that is a row; of others it is -1 (P, V).
        width: set to the largest number of edges at one grid point for each name (names,).
        used: work array (names,).
    """
    for i in range(len(count)):
        for name in range(len(used)):
            used[name] = 0
        n = count[i]
        width_u, width_x = 0.0, 0.0
        for k in range(n):
            width_u = max(width_u, abs(vertices[i, k, 0] - vertices[i, 0, 0]))
            width_x = max(width_x, abs(vertices[i, k, 1] - vertices[i, 0, 1]))
        for k in range(n):
            name = edge_names[i, k]
            after = k + 1 if k + 1 < n else 0
            du = abs(vertices[i, after, 0] - vertices[i, k, 0])
            dx = abs(vertices[i, after, 1] - vertices[i, k, 1])
            short = du <= EDGE_LENGTH * width_u and dx <= EDGE_LENGTH * width_x
            short &= abs(rows[i, k, 0]) * du + abs(rows[i, k, 1]) * dx <= EDGE_CHANGE
            bound = name < 0 or (name < joints and rows[i, k, 0] == 0.0)
            if bound or (short and (width_u > 0.0 or width_x > 0.0)):  # of a single point all edges are rows
                continue
            slots[i, k] = used[name]
            used[name] += 1
            width[name] = max(width[name], used[name])


@compiled(_nrt=False)
def _place(edges, edge_names, count, slots, first, rows):
    """Put the edges that are rows into their columns."""
    for i in range(len(count)):
        for k in range(count[i]):
            if slots[i, k] >= 0:
                for j in range(3):
                    rows[i, first[edge_names[i, k]] + slots[i, k], j] = edges[i, k, j]
