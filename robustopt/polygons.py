"""Feasible polygons: the exact set of (u, x) that every value of the uncertain parameters allows at a grid point.

At one grid point each limit is a convex function of u = sdd and x = sd^2: the largest, over the box of the
parameters, of rows that are affine in (u, x). The feasible set is therefore a convex polygon. It is found by
cutting: start from a polygon, evaluate all rows at its vertices, cut with the row that is violated most there, and
repeat until no vertex violates anything. Of several hundred facets of a friction cone only the few that bind near
the polygon are ever made into rows, and the edges of the final polygon are exactly the rows that are not redundant.

A row family is, for B (F, d) and a load W that is affine in (u, x),

    value_f = base_f + sum_g scale_g(v_fg) v_fg,   v_fg = B_f W_g0 + sum_k |B_f W_gk| + sum_k |B_f| |R_gk|,

where g runs over groups of bodies, scale_g(v) is the group's largest mass where v > 0 and its smallest elsewhere, the
W_gk are exact interval terms and the R_gk bounded remainders (see `uncertainty`).
"""

from __future__ import annotations

from typing import NamedTuple

import numba as nb
import numpy as np

from robustopt.errors import SolverFailed

Array = np.ndarray

MAX_VERTICES = 96
TOLERANCE = 1e-10
"""Largest violation of a row, relative to the limit, that a vertex of a polygon may keep: ten times rounding error."""

ROUNDING = 1e-14
"""Part of the largest terms of a row in a polygon by which its value at a vertex may be off; this matters only
far from any plan."""

EDGE_LENGTH = 1e-9
"""Edges of a feasible polygon shorter than this part of the polygon are rounding errors, not rows."""

NO_NAME = -1
"""Name index of the edges x >= 0 and of the bounds that a polygon starts from."""


class Polygons(NamedTuple):
    """One polygon per grid point: vertices (u, x) counter-clockwise, and the row of the edge that starts at each.

    vertices: (P, V, 2); rows: (P, V, 3), a u + b x + c <= 0; names: (P, V); sizes: (P,), the number of vertices, 0
    where nothing is feasible
    """

    vertices: Array
    rows: Array
    names: Array
    sizes: Array

    def copy(self) -> Polygons:
        return Polygons(*(array.copy() for array in self))

    def at(self, points: slice) -> Polygons:
        """The polygons at some grid points, the same arrays: to cut these is to cut the whole."""
        return Polygons(*(array[points] for array in self))


class Loads(NamedTuple):
    """What the rows of a family multiply, in groups whose mass has one interval each.

    nominal: W_g0, coefficients of (u, x, 1) last, shape (P, d, G, 3)
    terms: interval terms W_gk, shape (P, d, n, 3); group: (n,)
    constant: interval terms that depend on neither u nor x, shape (P, d, n_c); constant_group: (n_c,)
    remainder: R_gk, shape (P, d, n_r, 3); remainder_group: (n_r,)
    lowest, highest: mass factors of the groups, (G,)
    """

    nominal: Array
    terms: Array
    group: Array
    constant: Array
    constant_group: Array
    remainder: Array
    remainder_group: Array
    lowest: Array
    highest: Array

    def middle(self) -> Array:
        """The load with every parameter at the middle of its interval: coefficients of (u, x, 1), shape (P, d, 3)."""
        middle: Array = np.einsum("pdgk,g->pdk", self.nominal, 0.5 * (self.lowest + self.highest))
        return middle

    def at(self, points: Array | slice) -> Loads:
        """The loads at some of the grid points."""
        over_points = ("nominal", "terms", "constant", "remainder")
        return self._replace(**{name: getattr(self, name)[points] for name in over_points})


class Family(NamedTuple):
    """Rows over loads: see the head of the module.

    B: (1, F, d), or (P, F, d) where the rows differ from point to point; loads: what they multiply
    base: affine part of a row by itself, (P, F, 3), or (0, 0, 3) for none
    base_terms: what each constant interval term of the loads adds to a row by itself, (P, F, n_c), or (0, 0, 0)
    names: index of each row's name, (F,)
    """

    B: Array
    loads: Loads
    base: Array
    base_terms: Array
    names: Array


def facet_family(facets: Array, loads: Loads, names: Array) -> Family:
    """The family of rows facets (F, d) that are the same at every grid point and have no part of their own."""
    return Family(np.ascontiguousarray(facets)[None], loads, np.zeros((0, 0, 3)), np.zeros((0, 0, 0)), names)


def start(u_bound: Array, x_max: Array, velocity_name: Array) -> Polygons:
    """Rectangles |u| <= u_bound, 0 <= x <= x_max, both (P,)."""
    points = len(x_max)
    vertices = np.zeros((points, MAX_VERTICES, 2))
    rows = np.zeros((points, MAX_VERTICES, 3))
    names = np.full((points, MAX_VERTICES), NO_NAME)
    vertices[:, 0, 0] = vertices[:, 3, 0] = -u_bound
    vertices[:, 1, 0] = vertices[:, 2, 0] = u_bound
    vertices[:, 2, 1] = vertices[:, 3, 1] = x_max
    rows[:, 0, 1] = -1.0
    rows[:, 1, 0], rows[:, 1, 2] = 1.0, -u_bound
    rows[:, 2, 1], rows[:, 2, 2] = 1.0, -x_max
    rows[:, 3, 0], rows[:, 3, 2] = -1.0, -u_bound
    names[:, 2] = velocity_name
    return Polygons(vertices, rows, names, np.full(points, 4))


def cut(polygons: Polygons, family: Family) -> None:
    """Cut the polygons with a family of rows. Raises SolverFailed where one would have more than MAX_VERTICES edges."""
    if len(family.names) and not _cut_family(polygons, family):
        raise SolverFailed(f"a feasible polygon at a grid point has more than {MAX_VERTICES} edges")


@nb.njit(cache=True)
def _copy(R, L, k, R2, L2, m):
    """Row and name of edge k become those of edge m, without temporary arrays."""
    R2[m, 0], R2[m, 1], R2[m, 2], L2[m] = R[k, 0], R[k, 1], R[k, 2], L[k]


@nb.njit(cache=True)
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


@nb.njit(cache=True)
def cut_affine(polygons, rows, names):
    """Cut with rows a u + b x + c <= 0, shape (P, F, 3), of the names (F,)."""
    V2, R2 = np.empty((MAX_VERTICES, 2)), np.empty((MAX_VERTICES, 3))
    L2 = np.empty(MAX_VERTICES, np.int64)
    valid, valid2 = np.zeros(MAX_VERTICES, np.bool_), np.zeros(MAX_VERTICES, np.bool_)
    for i in range(len(polygons.sizes)):
        V, R, L, n = polygons.vertices[i], polygons.rows[i], polygons.names[i], polygons.sizes[i]
        for f in range(rows.shape[1]):
            if n >= 3:
                n = _clip(V, R, L, valid, n, rows[i, f, 0], rows[i, f, 1], rows[i, f, 2], names[f], V2, R2, L2, valid2)
        polygons.sizes[i] = n if n >= 3 else 0


@nb.njit(cache=True)
def _wrenches(coefficients, u, x, out):
    """out[k] = coefficients (d, n, 3) at (u, x), shape (n, d)."""
    for k in range(coefficients.shape[1]):
        for j in range(coefficients.shape[0]):
            out[k, j] = coefficients[j, k, 0] * u + coefficients[j, k, 1] * x + coefficients[j, k, 2]


@nb.njit(cache=True)
def _add_products(columns, wrench, out):
    """out += B wrench for the columns (d, F) of B; the inner loop runs over the rows, which the compiler vectorises."""
    for j in range(len(wrench)):
        weight = wrench[j]
        if weight != 0.0:
            for f in range(len(out)):
                out[f] += weight * columns[j, f]


@nb.njit(cache=True)
def _add_sizes(columns, wrench, products, out):
    """out += |B wrench + products|; products is overwritten."""
    _add_products(columns, wrench, products)
    for f in range(len(out)):
        out[f] += abs(products[f])
        products[f] = 0.0


@nb.njit(cache=True)
def _active_piece(family, i, f, swings, remains, u, x):
    """Affine piece (a, b, c) of row f at grid point i that is active at (u, x): its value there is a u + b x + c."""
    loads, row = family.loads, family.B[i if family.B.shape[0] > 1 else 0, f]
    sums = np.zeros((len(loads.lowest), 3))
    for g in range(len(loads.lowest)):
        for j in range(len(row)):
            sums[g] += row[j] * loads.nominal[i, j, g]
    for k in range(len(loads.group)):
        sign = -1.0 if np.dot(row, swings[k]) < 0.0 else 1.0
        for j in range(len(row)):
            sums[loads.group[k]] += sign * row[j] * loads.terms[i, j, k]
    for k in range(len(loads.constant_group)):
        product = family.base_terms[i, f, k] if family.base_terms.shape[0] else 0.0
        for j in range(len(row)):
            product += row[j] * loads.constant[i, j, k]
        sums[loads.constant_group[k], 2] += abs(product)
    for k in range(len(loads.remainder_group)):
        for j in range(len(row)):
            weight = abs(row[j]) * (-1.0 if remains[k, j] < 0.0 else 1.0)
            sums[loads.remainder_group[k]] += weight * loads.remainder[i, j, k]
    piece = family.base[i, f].copy() if family.base.shape[0] else np.zeros(3)
    for g in range(len(loads.lowest)):
        value = sums[g, 0] * u + sums[g, 1] * x + sums[g, 2]
        piece += (loads.highest[g] if value > 0.0 else loads.lowest[g]) * sums[g]
    return piece


@nb.njit(cache=True)
def _cut_family(polygons, family):
    """Cut each polygon until no vertex violates a row. False where a polygon grew beyond MAX_VERTICES."""
    B, loads, base, base_terms, names = family
    F, d, G = B.shape[1], B.shape[2], len(loads.lowest)
    V2, R2 = np.empty((MAX_VERTICES, 2)), np.empty((MAX_VERTICES, 3))
    L2 = np.empty(MAX_VERTICES, np.int64)
    valid, valid2 = np.zeros(MAX_VERTICES, np.bool_), np.zeros(MAX_VERTICES, np.bool_)
    central = np.zeros((G, d))
    swings, remains = np.zeros((len(loads.group), d)), np.zeros((len(loads.remainder_group), d))
    columns, sizes = np.zeros((d, F)), np.zeros((d, F))
    margin, values, total, products = np.zeros((G, F)), np.zeros((G, F)), np.zeros(F), np.zeros(F)
    box = np.zeros((G, d))
    filled = False
    for i in range(len(polygons.sizes)):
        n = polygons.sizes[i]
        if n < 3:
            continue
        V, R, L = polygons.vertices[i], polygons.rows[i], polygons.names[i]
        if B.shape[0] > 1 or not filled:
            columns[:] = (B[i] if B.shape[0] > 1 else B[0]).T
            sizes[:] = np.abs(columns)
            filled = True
        margin[:] = 0.0
        for k in range(len(loads.constant_group)):
            if base_terms.shape[0]:
                products[:] = base_terms[i, :, k]
            _add_sizes(columns, loads.constant[i, :, k], products, margin[loads.constant_group[k]])
        u_size, x_size = np.abs(V[:n, 0]).max(), np.abs(V[:n, 1]).max()
        valid[:] = False
        finished = False
        for _ in range(20 * MAX_VERTICES):
            vertex = -1
            for k in range(n):
                if not valid[k]:
                    vertex = k
                    break
            if vertex < 0:
                finished = True
                break
            u, x = V[vertex, 0], V[vertex, 1]
            _wrenches(loads.nominal[i], u, x, central)
            _wrenches(loads.terms[i], u, x, swings)
            _wrenches(loads.remainder[i], u, x, remains)
            values[:] = margin
            for g in range(G):
                _add_products(columns, central[g], values[g])
            for k in range(len(loads.group)):
                _add_sizes(columns, swings[k], products, values[loads.group[k]])
            if len(loads.remainder_group):
                box[:] = 0.0
                for k in range(len(loads.remainder_group)):
                    box[loads.remainder_group[k]] += np.abs(remains[k])
                for g in range(G):
                    _add_products(sizes, box[g], values[g])
            total[:] = 0.0
            for f in range(base.shape[1]):
                total[f] = base[i, f, 0] * u + base[i, f, 1] * x + base[i, f, 2]
            for g in range(G):
                for f in range(F):
                    total[f] += values[g, f] * (loads.highest[g] if values[g, f] > 0.0 else loads.lowest[g])
            worst = np.argmax(total)
            if total[worst] <= TOLERANCE:
                valid[vertex] = True
                continue
            a, b, c = _active_piece(family, i, worst, swings, remains, u, x)
            if total[worst] <= ROUNDING * (abs(a) * u_size + abs(b) * x_size + abs(c)):
                valid[vertex] = True
                continue
            n = _clip(V, R, L, valid, n, a, b, c, names[worst], V2, R2, L2, valid2)
            if n < 3:
                n, finished = 0, True
                break
            if n > MAX_VERTICES - 2:
                break
        if not finished:
            return False
        polygons.sizes[i] = n
    return True


@nb.njit(cache=True)
def edge_slots(vertices, edge_names, count, joints, names):
    """Number of each edge among the edges of its name at its grid point; -1 for what is no row, (P, V).

    Names below `joints` are those of velocity bounds, which are no rows.
    """
    slots = np.full(edge_names.shape, -1)
    used = np.zeros(names, np.int64)
    for i in range(len(count)):
        used[:] = 0
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
            if name < joints or (du <= EDGE_LENGTH * width_u and dx <= EDGE_LENGTH * width_x):
                continue
            slots[i, k] = used[name]
            used[name] += 1
    return slots
