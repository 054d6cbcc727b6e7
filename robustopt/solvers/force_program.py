"""Inner programs: contact forces that supply the required wrench of a timing, one linear program per grid point.

    minimise t   such that   G lambda = w + t r,   T_c lambda_c <= 0,   lambda >= 0

The columns of G are the friction edges of all contacts. w is the required wrench, extended by the forces that press
parts against the tool. r is a wrench well inside the cone, as large as the weight of the payload. If t > 0, t is the
missing part of the wrench as a fraction of the weight. The dual y is then a facet of the cone, y w <= 0 with y r = -1,
that the outer program lacks (split as in paper section 4; the normalisation is our choice). T_c bounds the twist of a
contact c with prescribed pressure; its rows are added when a solution violates them.
"""

from __future__ import annotations

import numpy as np

from robustopt.arrays import Array, Indices
from robustopt.limits import polygons
from robustopt.limits.contact_limit import NO_BASE, NO_TERMS, ContactLimit
from robustopt.limits.formulas import evaluate, worst_wrench
from robustopt.limits.polygons import RequiredWrench, facet_family
from robustopt.limits.systems import ContactSystem
from robustopt.solvers.linear_program import LinearProgram

Rows = tuple[Array, Indices]
"""Rows (F, d) as fractions of the weight, and the index of the name of each (F,)."""

VIOLATION = 1e-7
"""Fraction of the weight by which a wrench may leave the cone: the tolerance of the linear programs."""

ROUNDS = 4
"""A dual changes which parameters are worst, and these may have another dual; two rounds were enough in all our
tasks."""

SECOND_LOOK, LEAST_CORNERS, MOST_CORNERS = 8000, 4, 20
"""Number of programs of a second look without facets, and bounds on the random corners of the box of the parameters
that it tries per end of an interval. A row found at one grid point holds at all, so a fine grid needs fewer at each."""

ROBUST_BAND = 0.5
"""Margin, as a fraction of the weight, beyond which a wrench is not tried again with its worst parameters."""


class ForceProgram:
    """The inner program of one contact system; only its right-hand side changes between calls.

    Attributes:
        reference: the wrench r (d,) [N, N m].
        scale: factors on the coordinates that give all generators a size of 1 (d,).
        program: the linear program.
        transform: matrix from the coordinates of the system to those that the generators supply (d', d); None for the
            identity.
    """

    def __init__(self, limit: ContactLimit) -> None:
        """Make the program of a limit."""
        system, weight = limit.system, limit.weight
        self.reference = system.interior * weight
        self.scale = _scale(system) / weight
        matrix = np.column_stack([system.generators * weight, -self.reference]) * self.scale[:, None]
        k = matrix.shape[1]
        self.program = LinearProgram(matrix, np.r_[np.zeros(k - 1), 1.0], np.r_[np.zeros(k - 1), -np.inf])
        self.transform = system.transform

    def solve(self, wrench: Array) -> tuple[float, Array]:
        """Solve the program for a wrench.

        Args:
            wrench: required wrench (d,) [N, N m].

        Returns:
            The missing part t as a fraction of the weight, and the dual row y (d,) with y w = t.
        """
        supplied = wrench if self.transform is None else self.transform @ wrench
        right = supplied * self.scale
        _, dual = self.program.solve(right, right)
        dual = dual * self.scale
        row = dual if self.transform is None else dual @ self.transform
        return float(row @ wrench), row


def _scale(system: ContactSystem) -> Array:
    """Return the units of the coordinates of a system, in which generators are of size 1, (d,)."""
    stacked = 6 * len(system.objects)
    wrenches = system.generators[:stacked]
    turns = np.arange(stacked) % 6 >= 3
    force, moment = np.abs(wrenches[~turns]).max(), np.abs(wrenches[turns]).max()
    return np.r_[np.where(turns, 1.0 / moment, 1.0 / force), np.full(len(system.pressed), 1.0 / force)]


def missing_rows(
    limit: ContactLimit, program: ForceProgram, points: Indices, u: Array, x: Array
) -> tuple[Rows, float, int]:
    """Return the rows that a timing violates for some uncertain quantity, the worst violation, and programs solved.

    The program is first solved for the uncertain quantities that are worst for the rows that are already imposed.

    Args:
        limit: the limit.
        program: the force program of its system.
        points: grid points (M,).
        u: sdd (M,).
        x: sd^2 (M,).
    """
    wrenches, known = limit.wrench(points, u, x), limit.facets
    if len(known):
        loads = limit.loads.at(points)
        values = evaluate(known, loads, NO_BASE, NO_TERMS, u, x)
        wrenches = worst_wrench(loads, known[np.argmax(values, axis=1)], u, x)
    rows, worst, solved = _rows_from(wrenches, limit, program, points, u, x)
    return _new(rows, limit), worst, solved


def overlooked_rows(
    limit: ContactLimit, program: ForceProgram, points: Indices, u: Array, x: Array
) -> tuple[Rows, int]:
    """Return the violated rows that `missing_rows` has not found, and the number of programs solved.

    A dual and its worst parameters can agree with each other while another dual, for other parameters, is violated. If
    all rows of the cone are explicit, all are evaluated, so that none is overlooked. Otherwise programs are solved for
    other corners of the box of the parameters, the worst ones for random directions. That is no proof, but none of 180
    tasks with wide intervals kept a violation above 1e-6 of the weight (our choice).

    Args:
        limit: the limit.
        program: the force program of its system.
        points: grid points (M,).
        u: sdd (M,).
        x: sd^2 (M,).
    """
    certain = _is_certain(limit.loads)
    explicit = limit.facets[:0], limit.kinds[:0]
    if not certain or limit.system.bounds_twist:
        explicit = _violated_facets(limit, points, u, x)
    if limit.system.complete or certain:
        return explicit, 0
    loads, rng = limit.loads.at(points), np.random.default_rng(len(limit.facets))
    found, solved = [np.zeros((0, limit.system.dimension))], 0
    for _ in range(int(np.clip(SECOND_LOOK // max(len(points), 1), LEAST_CORNERS, MOST_CORNERS))):
        directions = rng.normal(size=(len(points), limit.system.dimension)) * program.scale
        rows, _, programs = _rows_from(worst_wrench(loads, directions, u, x), limit, program, points, u, x)
        found.append(rows)
        solved += programs
    rows, kinds = _new(np.concatenate(found), limit)
    return (np.concatenate([explicit[0], rows]), np.concatenate([explicit[1], kinds])), solved


def _is_certain(loads: RequiredWrench) -> bool:
    """Return whether no parameter has an interval, so that the answer of a program is final."""
    intervals = len(loads.group) + len(loads.moment_group) + len(loads.constant_group)
    return intervals == 0 and bool(np.all(loads.lowest == loads.highest))


def _violated_facets(limit: ContactLimit, points: Indices, u: Array, x: Array) -> Rows:
    """Return the explicit row of a system that is worst at each point, if it is violated and not known yet."""
    facets = limit.system.facets / limit.weight
    if not len(facets):
        return limit.facets[:0], limit.kinds[:0]
    values = polygons.evaluate(facet_family(facets, limit.loads, limit.system.kinds), points, u, x)
    index = np.unique(np.argmax(values, axis=1)[values.max(axis=1) > VIOLATION])
    new = _distinct(facets[index], limit.facets)
    return facets[index][new], limit.system.kinds[index][new]


def _rows_from(
    wrenches: Array, limit: ContactLimit, program: ForceProgram, points: Indices, u: Array, x: Array
) -> tuple[Array, float, int]:
    """Return rows found from wrenches (M, d): solve the program, find the worst parameters for its dual, and repeat."""
    loads = limit.loads.at(points)
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
        moved = np.abs(again - wrenches[pending]).max(axis=1) > VIOLATION * limit.weight
        reached[pending] = np.maximum(value, reached[pending])
        wrenches[pending] = again
        pending = pending[better & moved & (value > -ROBUST_BAND)]
        if not len(pending):
            break
    return np.concatenate(found), worst, solved


def _new(rows: Array, limit: ContactLimit) -> Rows:
    """Return the rows that the limit does not have yet, with the index of the name of each."""
    rows = rows[_distinct(rows, limit.facets)]
    return rows, limit.system.kind_of(rows)


def _distinct(rows: Array, known: Array) -> Indices:
    """Return the indices of rows that differ from each other and from the known ones."""
    if not len(rows):
        return np.zeros(0, dtype=np.intp)
    scale = np.abs(rows).max()
    _, first = np.unique(np.round(rows / scale, 7), axis=0, return_index=True)
    first = np.sort(first)
    if len(known):
        close = np.array([np.abs(known - row).max(axis=1).min() <= 1e-7 * scale for row in rows[first]])
        first = first[~close]
    return np.asarray(first)
