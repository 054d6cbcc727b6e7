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

from dataclasses import dataclass

import numba as nb
import numpy as np

from robustopt.errors import SolverFailed

Array = np.ndarray

MAX_VERTICES = 96
TOLERANCE = 1e-10
"""Largest violation of a row, relative to the limit, that a vertex of a polygon may keep: ten times rounding error."""

NO_NAME = -1
"""Name index of the edges x >= 0 and of the bounds that a polygon starts from."""


@dataclass
class Polygons:
    """One polygon per grid point: vertices (u, x) counter-clockwise, and the row of the edge that starts at each.

    vertices: (P, V, 2); rows: (P, V, 3), a u + b x + c <= 0; names: (P, V); count: (P,), 0 where nothing is feasible
    """

    vertices: Array
    rows: Array
    names: Array
    count: Array

    def copy(self) -> Polygons:
        return Polygons(self.vertices.copy(), self.rows.copy(), self.names.copy(), self.count.copy())


@dataclass(frozen=True)
class Loads:
    """What the rows of a family multiply, in groups whose mass has one interval each.

    terms: W_gk with their coefficients of (u, x, 1) last, shape (P, d, n, 3); kind 0 is a group's W_g0, kind 1 an interval term
    kind, group: (n,)
    constant: interval terms that depend on neither u nor x, shape (P, d, n_c); constant_group: (n_c,)
    remainder: R_gk, shape (P, d, n_r, 3); remainder_group: (n_r,)
    lowest, highest: mass factors of the groups, (G,)
    """

    terms: Array
    kind: Array
    group: Array
    constant: Array
    constant_group: Array
    remainder: Array
    remainder_group: Array
    lowest: Array
    highest: Array

    def middle(self) -> Array:
        """The load with every parameter at the middle of its interval: coefficients of (u, x, 1), shape (P, d, 3)."""
        nominal = np.flatnonzero(self.kind == 0)
        mass = 0.5 * (self.lowest + self.highest)[self.group[nominal]]
        return np.einsum("pdnk,n->pdk", self.terms[:, :, nominal], mass)


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


def cut_affine(polygons: Polygons, rows: Array, names: Array) -> None:
    """Cut with rows a u + b x + c <= 0, shape (P, F, 3), of the names (F,)."""
    _cut_affine(polygons.vertices, polygons.rows, polygons.names, polygons.count, np.ascontiguousarray(rows), names)


def cut_family(polygons: Polygons, B: Array, loads: Loads, base: Array, base_terms: Array, names: Array) -> None:
    """Cut with a row family.

    B: (F, d), or (P, F, d) where the rows differ from point to point
    base: affine part of its own, (P, F, 3), or (0, 0, 3) for none
    base_terms: what each constant interval term of the loads adds to the row by itself, (P, F, n_c), or (0, 0, 0)
    names: index of each row's name, (F,)
    """
    points, d, n, _ = loads.terms.shape
    finished = _cut_family(
        polygons.vertices, polygons.rows, polygons.names, polygons.count,
        np.ascontiguousarray(B if B.ndim == 3 else B[None]),
        np.ascontiguousarray(loads.terms).reshape(points, d, 3 * n), loads.kind, loads.group,
        np.ascontiguousarray(loads.constant), loads.constant_group,
        np.ascontiguousarray(loads.remainder), loads.remainder_group,
        loads.lowest, loads.highest, base, base_terms, names,
    )  # fmt: skip
    if not finished:
        raise SolverFailed(f"a feasible polygon at a grid point has more than {MAX_VERTICES} edges")


@nb.njit(cache=True)
def _clip(V, R, L, valid, n, a, b, c, name, V2, R2, L2, valid2):  # type: ignore[no-untyped-def]
    """Keep the part of a polygon with a u + b x + c <= 0; the new edge takes the row's name. Returns the vertex count."""
    m = 0
    before = a * V[n - 1, 0] + b * V[n - 1, 1] + c
    for k in range(n):
        value = a * V[k, 0] + b * V[k, 1] + c
        if (value > 0.0) != (before > 0.0):
            share = before / (before - value)
            p = k - 1 if k > 0 else n - 1
            V2[m, 0] = V[p, 0] + share * (V[k, 0] - V[p, 0])
            V2[m, 1] = V[p, 1] + share * (V[k, 1] - V[p, 1])
            valid2[m] = False
            if value > 0.0:
                R2[m, 0], R2[m, 1], R2[m, 2] = a, b, c
                L2[m] = name
            else:
                R2[m, 0], R2[m, 1], R2[m, 2] = R[p, 0], R[p, 1], R[p, 2]
                L2[m] = L[p]
            m += 1
        if value <= 0.0:
            V2[m, 0], V2[m, 1] = V[k, 0], V[k, 1]
            R2[m, 0], R2[m, 1], R2[m, 2] = R[k, 0], R[k, 1], R[k, 2]
            L2[m] = L[k]
            valid2[m] = valid[k]
            m += 1
        before = value
    for k in range(m):
        V[k, 0], V[k, 1] = V2[k, 0], V2[k, 1]
        R[k, 0], R[k, 1], R[k, 2] = R2[k, 0], R2[k, 1], R2[k, 2]
        L[k] = L2[k]
        valid[k] = valid2[k]
    return m


@nb.njit(cache=True)
def _cut_affine(vertices, edge_rows, edge_names, count, rows, names):  # type: ignore[no-untyped-def]
    V2 = np.empty((MAX_VERTICES, 2))
    R2 = np.empty((MAX_VERTICES, 3))
    L2 = np.empty(MAX_VERTICES, np.int64)
    valid = np.zeros(MAX_VERTICES, np.bool_)
    valid2 = np.zeros(MAX_VERTICES, np.bool_)
    for i in range(len(count)):
        n = count[i]
        for f in range(rows.shape[1]):
            if n < 3:
                break
            n = _clip(vertices[i], edge_rows[i], edge_names[i], valid, n, rows[i, f, 0], rows[i, f, 1], rows[i, f, 2],
                      names[f], V2, R2, L2, valid2)  # fmt: skip
        count[i] = n if n >= 3 else 0


@nb.njit(cache=True)
def _cut_family(vertices, edge_rows, edge_names, count, B, terms, kind, group, constant, constant_group, remainder,
                remainder_group, lowest, highest, base, base_terms, names):  # type: ignore[no-untyped-def]  # fmt: skip
    F, d = B.shape[1], B.shape[2]
    n_terms, n_constant, n_remainder, G = len(kind), len(constant_group), len(remainder_group), len(lowest)
    V2 = np.empty((MAX_VERTICES, 2))
    R2 = np.empty((MAX_VERTICES, 3))
    L2 = np.empty(MAX_VERTICES, np.int64)
    valid2 = np.zeros(MAX_VERTICES, np.bool_)
    valid = np.zeros(MAX_VERTICES, np.bool_)
    margin = np.zeros((F, G))
    box = np.zeros((G, d))
    sums = np.zeros(G)
    for i in range(len(count)):
        n = count[i]
        if n < 3:
            continue
        rows = B[i] if B.shape[0] > 1 else B[0]
        coefficients = np.dot(rows, terms[i])
        if n_constant:
            products = np.dot(rows, constant[i])
            if base_terms.shape[0]:
                products += base_terms[i]
            margin[:] = 0.0
            for f in range(F):
                for k in range(n_constant):
                    margin[f, constant_group[k]] += abs(products[f, k])
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
            u, x = vertices[i, vertex, 0], vertices[i, vertex, 1]
            if n_remainder:
                box[:] = 0.0
                for k in range(n_remainder):
                    for j in range(d):
                        box[remainder_group[k], j] += abs(
                            remainder[i, j, k, 0] * u + remainder[i, j, k, 1] * x + remainder[i, j, k, 2])  # fmt: skip
            worst, worst_row = TOLERANCE, -1
            if n_terms == 1 and n_remainder == 0 and base.shape[0] == 0 and G == 1:
                for f in range(F):
                    value = (coefficients[f, 0] * u + coefficients[f, 1] * x + coefficients[f, 2]) + margin[f, 0]
                    if value > worst:
                        worst, worst_row = value, f
            else:
                for f in range(F):
                    value = 0.0
                    if base.shape[0]:
                        value = base[i, f, 0] * u + base[i, f, 1] * x + base[i, f, 2]
                    for g in range(G):
                        sums[g] = margin[f, g]
                    for k in range(n_terms):
                        term = coefficients[f, 3 * k] * u + coefficients[f, 3 * k + 1] * x + coefficients[f, 3 * k + 2]
                        sums[group[k]] += term if kind[k] == 0 else abs(term)
                    for g in range(G):
                        if n_remainder:
                            for j in range(d):
                                sums[g] += abs(rows[f, j]) * box[g, j]
                        value += sums[g] * (highest[g] if sums[g] > 0.0 else lowest[g])
                    if value > worst:
                        worst, worst_row = value, f
            if worst_row < 0:
                valid[vertex] = True
                continue
            f = worst_row
            a, b, c = 0.0, 0.0, 0.0
            if base.shape[0]:
                a, b, c = base[i, f, 0], base[i, f, 1], base[i, f, 2]
            for g in range(G):
                ga, gb, gc = 0.0, 0.0, margin[f, g]
                for k in range(n_terms):
                    if group[k] == g:
                        ta, tb, tc = coefficients[f, 3 * k], coefficients[f, 3 * k + 1], coefficients[f, 3 * k + 2]
                        sign = -1.0 if kind[k] == 1 and ta * u + tb * x + tc < 0.0 else 1.0
                        ga, gb, gc = ga + sign * ta, gb + sign * tb, gc + sign * tc
                for k in range(n_remainder):
                    if remainder_group[k] == g:
                        for j in range(d):
                            ta, tb, tc = remainder[i, j, k, 0], remainder[i, j, k, 1], remainder[i, j, k, 2]
                            weight = abs(rows[f, j]) * (-1.0 if ta * u + tb * x + tc < 0.0 else 1.0)
                            ga, gb, gc = ga + weight * ta, gb + weight * tb, gc + weight * tc
                scale = highest[g] if ga * u + gb * x + gc > 0.0 else lowest[g]
                a, b, c = a + scale * ga, b + scale * gb, c + scale * gc
            n = _clip(vertices[i], edge_rows[i], edge_names[i], valid, n, a, b, c, names[f], V2, R2, L2, valid2)
            if n < 3:
                n, finished = 0, True
                break
            if n > MAX_VERTICES - 2:
                break
        if not finished:
            return False
        count[i] = n
    return True
