"""Inner programs: can contact forces transmit the wrench that a timing demands? One linear program per grid point.

    minimise t   such that   G lambda = w + t r,   lambda >= 0

G holds the friction edges of all contact points, w is the required wrench and r a wrench well inside the cone, as heavy
as the load. t > 0 is what is missing, as a fraction of the weight; the dual y is the facet of the cone that says so,
y w <= 0 with y r = -1, the row that the outer program lacks (paper section 4, its split; normalisation our choice).
"""

from __future__ import annotations

import numpy as np

from robustopt.limits.polygons import Loads
from robustopt.limits.rows import ContactFamily, evaluate, worst_wrench
from robustopt.solvers.linear_program import LinearProgram

Array = np.ndarray

VIOLATION = 1e-7
"""Fraction of the weight by which a wrench may leave the cone: the tolerance of the linear programs."""

ROUNDS = 4
"""A dual changes which parameters are worst, they may have another dual; two rounds were enough wherever we looked."""

SECOND_LOOK, LEAST_CORNERS, MOST_CORNERS = 8000, 4, 20
"""Programs of a second look without facets, in all, and the random corners of the box of the parameters that it tries
at each end of an interval. A row found at one grid point holds at all, so a fine grid needs fewer at each."""

CHUNK = 64
"""Ends of intervals at which all facets are evaluated at once, for the sake of memory."""


class ForceProgram:
    """The inner program of one contact system; only its right-hand side changes from call to call."""

    def __init__(self, family: ContactFamily) -> None:
        generators = family.system.generators
        self.reference = family.system.interior * family.weight
        force = np.abs(generators[[k for k in range(len(generators)) if k % 6 < 3]]).max()
        moment = np.abs(generators[[k for k in range(len(generators)) if k % 6 >= 3]]).max()
        self.scale = np.tile(np.repeat([1.0 / force, 1.0 / moment], 3), len(generators) // 6) / family.weight
        matrix = np.column_stack([generators * family.weight, -self.reference]) * self.scale[:, None]
        k = matrix.shape[1]
        self.program = LinearProgram(matrix, np.r_[np.zeros(k - 1), 1.0], np.r_[np.zeros(k - 1), -np.inf])

    def solve(self, wrench: Array) -> tuple[float, Array]:
        """t and the dual row y, (d,), such that y w = t for the wrench w, as a fraction of the weight."""
        right = wrench * self.scale
        dual = self.program.solve(right, right)[1] * self.scale
        return float(dual @ wrench), dual


def missing_rows(
    family: ContactFamily, program: ForceProgram, known: Array, points: Array, u: Array, x: Array
) -> tuple[Array, float, int]:
    """Rows that a timing violates for some value of the parameters, (F, d), the worst violation, and programs solved.

    known: rows (K, d) that the outer program has; they say which parameters are worst to begin with
    """
    wrenches = family.wrench(points, u, x)
    if len(known):
        loads = family.loads.at(points)
        values = evaluate(known, loads, np.zeros((0, 0, 3)), np.zeros((0, 0, 0)), u, x)
        wrenches = worst_wrench(loads, known[np.argmax(values, axis=1)], u, x)
    rows, worst, solved = _rows_from(wrenches, family, program, points, u, x)
    return _distinct(rows, known), worst, solved


def overlooked_rows(
    family: ContactFamily, program: ForceProgram, known: Array, points: Array, u: Array, x: Array
) -> tuple[Array, int]:
    """Rows that `missing_rows` has not found though a timing violates them, (F, d), and programs solved.

    A dual and the parameters that are worst for it can agree with each other while another dual, for other parameters,
    is violated. Where the facets of the cone are known, all of them are looked at, so that nothing is overlooked. Where
    they are not, programs are solved for other corners of the box of the parameters, those worst for random directions:
    no proof, but of 180 tasks with wide intervals, none kept a violation above 1e-6 of the weight.
    """
    if _is_certain(family.loads):
        return known[:0], 0
    if family.system.facets is not None:
        return _distinct(_violated_facets(family, points, u, x), known), 0
    loads, rng = family.loads.at(points), np.random.default_rng(len(known))
    found, solved = [], 0
    for _ in range(int(np.clip(SECOND_LOOK // max(len(points), 1), LEAST_CORNERS, MOST_CORNERS))):
        directions = rng.normal(size=(len(points), family.system.dimension)) * program.scale
        rows, _, programs = _rows_from(worst_wrench(loads, directions, u, x), family, program, points, u, x)
        found.append(rows)
        solved += programs
    return _distinct(np.concatenate(found), known), solved


def _is_certain(loads: Loads) -> bool:
    """Whether the parameters have no intervals, so that a program's answer is final."""
    intervals = len(loads.group) + len(loads.constant_group) + len(loads.remainder_group)
    return intervals == 0 and bool(np.all(loads.lowest == loads.highest))


def _violated_facets(family: ContactFamily, points: Array, u: Array, x: Array) -> Array:
    """The worst facet of each point for its worst parameters, where it is violated, (F, d)."""
    assert family.system.facets is not None
    facets, found = family.system.facets / family.weight, []
    for k in range(0, len(points), CHUNK):
        part = slice(k, k + CHUNK)
        loads = family.loads.at(points[part])
        values = evaluate(facets, loads, np.zeros((0, 0, 3)), np.zeros((0, 0, 0)), u[part], x[part])
        found.append(np.argmax(values, axis=1)[values.max(axis=1) > VIOLATION])
    return facets[np.unique(np.concatenate(found))]


def _rows_from(
    wrenches: Array, family: ContactFamily, program: ForceProgram, points: Array, u: Array, x: Array
) -> tuple[Array, float, int]:
    """Rows found from wrenches (M, d) to begin with: program, dual, the parameters worst for it, and again."""
    loads = family.loads.at(points)
    wrenches = wrenches.copy()
    found, worst, solved = [], -np.inf, 0
    duals = np.zeros_like(wrenches)
    pending = np.arange(len(points))
    reached = np.full(len(points), -np.inf)
    for _ in range(ROUNDS):
        for k in pending:
            _, duals[k] = program.solve(wrenches[k])
        solved += len(pending)
        u_p, x_p = u[pending], x[pending]
        again = worst_wrench(loads.at(pending), duals[pending], u_p, x_p)
        value = np.einsum("md,md->m", duals[pending], again)
        found.append(duals[pending][value > VIOLATION])
        worst = max(worst, float(value.max(initial=-np.inf)))
        better = value > reached[pending] + VIOLATION
        moved = np.abs(again - wrenches[pending]).max(axis=1) > VIOLATION * family.weight
        reached[pending] = np.maximum(value, reached[pending])
        wrenches[pending] = again
        pending = pending[better & moved & (value > -ROBUST_BAND)]
        if not len(pending):
            break
    return np.concatenate(found), worst, solved


ROBUST_BAND = 0.5
"""Wrenches with more than this fraction of the weight in reserve are not asked for a second opinion."""


def _distinct(rows: Array, known: Array) -> Array:
    """Rows that differ from each other and from the known ones."""
    if not len(rows):
        return rows
    scale = np.abs(rows).max()
    _, first = np.unique(np.round(rows / scale, 7), axis=0, return_index=True)
    rows = rows[np.sort(first)]
    if len(known):
        close = np.array([np.abs(known - row).max(axis=1).min() <= 1e-7 * scale for row in rows])
        rows = rows[~close]
    return rows
