"""How contacts share the load: the least of their limits that the joints of the limbs need. One program per grid point.

    minimise t + penalty m   such that   G lambda = w + m r,   |tau - J^T G lambda| <= (1 + t) tau_max,   lambda, m >= 0

G holds the friction edges of all contacts, w is the wrench they must exert, tau are the torques of the joints that
carry them, without contact forces, r is a wrench well inside the cone. t is what the joint that is used most exceeds
its limit by, as a fraction of it, with the best sharing there is; m, what is missing of a wrench at the very edge of
the cone. The dual is a row over the load, which holds for every sharing: where some value of the parameters violates
it, the outer program lacks it (our choice).
"""

from __future__ import annotations

import numpy as np

from robustopt.arrays import Array, Flags, Indices
from robustopt.config import BASE_COORDINATES as BASE
from robustopt.limits.contact_limit import NO_BASE, NO_TERMS
from robustopt.limits.formulas import evaluate, worst_wrench
from robustopt.limits.load_sharing import distribute, willingness
from robustopt.limits.torque import SharedRow, Sharing
from robustopt.solvers.linear_program import LinearProgram

VIOLATION = 1e-7
"""Fraction of a torque limit by which a torque may exceed it."""

PENALTY = 1e3
"""Of what is missing of a wrench: more than any torque row gains from it."""

MISS = 1e-5
"""Fraction of the weight by which explicit forces may miss the wrench, a thousandth of what half a torque limit is."""

ROUNDS = 4
"""A dual changes which parameters are worst, they may have another dual."""

STILL = 1e-8
"""Part of the largest u and x by which they may have changed where rows are not looked for again."""

LESS_DOUBTFUL = 0.2
"""The same where these forces are those for the parameters that the contacts like least."""

CHUNKS = 8
"""Parts in which the facets of a stance are evaluated, for the sake of memory."""

DOUBTFUL = 0.5
"""A program is not solved where explicit forces leave the joints more than this fraction of their limits in reserve;
nor is it solved again, for the parameters that are worst for its row, where the row leaves as much."""


class SharingProgram:
    """The program of one grid point; the load is its right-hand side.

    generators: (6, K) wrenches about the world's origin; pull: torque that each generator takes off the m joints that
    carry the contacts, (m, K); limit: of these joints (m,)
    """

    def __init__(self, generators: Array, pull: Array, limit: Array, weight: float) -> None:
        self.limit, self.weight = limit, weight
        self.scale = np.r_[np.ones(3), np.full(3, 1.0 / np.abs(generators[3:]).max())]
        wrench = np.column_stack([generators, -generators.mean(axis=1), np.zeros(6)]) * self.scale[:, None]
        share = pull * weight / limit[:, None]
        none, one = np.zeros((len(limit), 1)), np.ones((len(limit), 1))
        upper = np.hstack([-share, none, -one])
        matrix = np.vstack([wrench, upper, np.hstack([share, none, -one])])
        rows, columns = matrix.shape
        cost = np.r_[np.zeros(columns - 2), PENALTY, 1.0]
        self.program = LinearProgram(matrix, cost, np.r_[np.zeros(columns - 1), -1.0])
        self.open = np.full(rows - 6, -np.inf)

    def solve(self, wrench: Array, torque: Array) -> tuple[float, Array, Array, float, Array]:
        """t; the row y_w, y_tau, constant, y_w w + y_tau tau + constant = t at the load; the forces of the generators.

        wrench: (6,); torque: of the joints without contact forces (m,)
        """
        right = np.r_[wrench * self.scale / self.weight, 1.0 - torque / self.limit, 1.0 + torque / self.limit]
        z, dual = self.program.solve(np.r_[right[:6], self.open], right)
        m = len(self.limit)
        on_wrench = dual[:6] * self.scale / self.weight
        on_torque = (dual[6 + m :] - dual[6 : 6 + m]) / self.limit
        constant = float(dual[6:].sum())
        value = float(on_wrench @ wrench + on_torque @ torque + constant)
        return value, on_wrench, on_torque, constant, self.weight * z[:-2]


def program_at(sharing: Sharing, point: int, counted: Flags) -> tuple[SharingProgram, Indices]:
    """The program of a grid point where contacts share the load, and the indices of the joints in it.

    counted: (n,) which joints' limits count
    """
    stance = int(sharing.standing[point])
    family, generators = sharing.contacts[stance], sharing.contacts[stance].system.generators
    joints = np.flatnonzero(~sharing.known[point] & counted)
    pull = np.zeros((len(joints), generators.shape[1]))
    for name, part in sharing.parts(stance).items():
        pull[:, part] = sharing.dynamics.contact_jacobians[name][point][:, joints].T @ generators[:, part]
    return SharingProgram(generators, pull, sharing.limit[joints], family.weight), joints


class SharingSearch:
    """Looks for rows on joint torques that timings violate where contacts share the load, one timing after the other.

    counted: (n,) which joints' limits count; programs: those made so far with the indices of their joints, by grid
    point; settled: (M, 2) u and x at each end of an interval at which no row was missing, nan where one was
    """

    def __init__(self, counted: Flags) -> None:
        self.counted = counted
        self.programs: dict[int, tuple[SharingProgram, Indices]] = {}
        self.settled = np.full((0, 2), np.nan)

    def missing_rows(self, sharing: Sharing, points: Indices, u: Array, x: Array) -> tuple[list[SharedRow], int]:
        """Rows that a timing violates, and programs solved; points, u, x: (M,), the same points each time."""
        timing = np.stack([u, x], axis=1)
        if len(self.settled) != len(timing):
            self.settled = np.full(timing.shape, np.nan)
        still = (np.abs(timing - self.settled) <= STILL * np.abs(timing).max(axis=0)).all(axis=1)
        shared = (~sharing.known[points] & self.counted).any(axis=1)
        look = np.flatnonzero(shared & ~still)
        self.settled[look] = timing[look]
        found, solved = [], 0
        for k, load in self._doubtful(sharing, points[look], u[look], x[look]):
            end, point = look[k], int(points[look[k]])
            if point not in self.programs:
                self.programs[point] = program_at(sharing, point, self.counted)
            rows, count = _rows_from(sharing, self.programs[point], point, load, (u[[end]], x[[end]]))
            self.settled[end] = np.nan if rows else timing[end]
            found += rows
            solved += count
        return found, solved

    def _doubtful(self, sharing: Sharing, points: Indices, u: Array, x: Array) -> list[tuple[int, Array]]:
        """Which of the ends (M,) explicit forces leave too little in reserve, each with the load (n,) that says so."""
        if not len(points):
            return []
        affine = np.stack([u, x, np.ones(len(u))], axis=1)
        middle = np.einsum("mdk,mk->md", sharing.loads.middle()[points], affine)
        worst = _worst_for_contacts(sharing, points, u, x)
        few = _explicit_use(sharing, self.counted, points, middle) > 1.0 - DOUBTFUL
        fewer = _explicit_use(sharing, self.counted, points, worst) > 1.0 - LESS_DOUBTFUL
        return [(int(k), worst[k] if fewer[k] else middle[k]) for k in np.flatnonzero(few | fewer)]


def _rows_from(
    sharing: Sharing, program: tuple[SharingProgram, Indices], point: int, load: Array, at: tuple[Array, Array]
) -> tuple[list[SharedRow], int]:
    """Rows that are violated at a grid point, and programs solved: from a load (n,) to begin with to the row of its
    dual, to the load that is worst for that, and again. at: u and x, (1,) each."""
    (solver, joints), here = program, sharing.loads.at(np.array([point]))
    found, solved, best = [], 0, -np.inf
    for _ in range(ROUNDS):
        _, on_wrench, on_torque, constant, _ = solver.solve(load[:BASE], load[joints])
        solved += 1
        row = np.zeros(len(load))
        row[:BASE], row[joints] = on_wrench, on_torque
        value = float(evaluate(row[None], here, NO_BASE, NO_TERMS, *at)[0, 0]) + constant
        if value > VIOLATION and np.any(on_torque):
            found.append(SharedRow(point, row, constant, int(joints[np.argmax(np.abs(on_torque))])))
        if value <= max(best, -DOUBTFUL) + VIOLATION:
            break
        best, load = value, worst_wrench(here, row[None], *at)[0]
    return found, solved


def _worst_for_contacts(sharing: Sharing, points: Indices, u: Array, x: Array) -> Array:
    """Loads (M, n) for the parameters that leave the contacts the least in reserve; points, u, x: (M,).

    Then a weak limb may have to make up for what the others cannot carry.
    """
    worst = np.empty((len(points), len(sharing.limit)))
    for stance in np.unique(sharing.standing[points]):
        family = sharing.contacts[stance]
        for here in np.array_split(np.flatnonzero(sharing.standing[points] == stance), CHUNKS):
            at = (u[here], x[here])
            values = evaluate(family.system.facets, family.loads.at(points[here]), NO_BASE, NO_TERMS, *at)
            direction = np.zeros((len(here), len(sharing.limit)))
            direction[:, :BASE] = family.system.facets[np.argmax(values, axis=1)]
            worst[here] = worst_wrench(sharing.loads.at(points[here]), direction, *at)
    return worst


def _explicit_use(sharing: Sharing, counted: Flags, points: Indices, load: Array) -> Array:
    """Share of their limits that the joints use with the smallest contact forces for loads (M, n) at grid points (M,)
    where they are shared, (M,); infinite where the forces miss the wrench."""
    use = np.empty(len(points))
    for k in np.unique(sharing.standing[points]):
        here, system = np.flatnonzero(sharing.standing[points] == k), sharing.contacts[k].system
        parts = sharing.parts(int(k))
        every = np.ones((len(here), system.generators.shape[1]))
        for name, part in parts.items():
            every[:, part] = willingness(name)
        center = np.array([-system.generators[4].mean(), system.generators[3].mean(), 0.0])
        wrench = load[here, :BASE].copy()
        wrench[:, 3:] -= np.cross(center, wrench[:, :3])
        forces, miss = distribute(system.about([center]).generators, every, wrench, sharing.contacts[k].weight)
        left = load[here].copy()
        for name, part in parts.items():
            push = forces[:, part] @ system.generators[:, part].T
            left -= (np.swapaxes(sharing.dynamics.contact_jacobians[name][points[here]], 1, 2) @ push[:, :, None])[
                :, :, 0
            ]
        shares = np.abs(left / sharing.limit)[:, counted & ~sharing.known[points[here[0]]]]
        use[here] = np.where(miss > MISS, np.inf, shares.max(axis=1))
    return use
