"""Shared wrenches: contact forces that keep the joint torques within their limits, one linear program per grid point.

    minimise t + penalty m   such that   G lambda = w + m r,   |tau - J^T G lambda| <= (1 + t) tau_max,   lambda, m >= 0

The columns of G are the friction edges of all contacts, w is the required wrench, tau are the torques without contact
forces of the joints that carry the contacts, and r is a wrench well inside the cone. With the best sharing, t is the
excess of the most loaded joint over its limit, as a fraction of the limit. m is the missing part of a wrench at the
very edge of the cone. The dual is a row over the generalised force that holds for every sharing. If some parameters
violate it, the outer program lacks it (our choice).
"""

from __future__ import annotations

import numpy as np

from robustopt.arrays import Array, Flags, Indices
from robustopt.config import BASE_COORDINATES as BASE
from robustopt.limits.contact_limit import NO_BASE, NO_TERMS
from robustopt.limits.formulas import evaluate, worst_wrench
from robustopt.limits.load_sharing import distribute, willingness
from robustopt.limits.torque_sharing import SharedRow, Sharing
from robustopt.solvers.linear_program import LinearProgram

VIOLATION = 1e-7
"""Fraction of a torque limit by which a torque may exceed it."""

PENALTY = 1e3
"""Cost of a missing part of the wrench: more than any torque row gains from it."""

MISS = 1e-5
"""Fraction of the weight by which explicit forces may miss the wrench: a thousandth of half a torque limit."""

ROUNDS = 4
"""Number of rounds: a dual changes which parameters are worst, and these may have another dual."""

STILL = 1e-8
"""Change of u and x, as a fraction of the largest ones, below which an interval end is not searched again."""

CHUNKS = 8
"""Number of parts in which the facets of a stance are evaluated, to save memory."""

DOUBTFUL, LESS_DOUBTFUL = 0.5, 0.2
"""Margin, as a fraction of the torque limits, above which explicit forces make a program unnecessary: for the nominal
parameters, and for the worst parameters of the contacts. With the first margin a row needs no further rounds either."""


class SharingProgram:
    """The program of one grid point; the generalised force is its right-hand side.

    Attributes:
        limit: torque limits of the m joints that carry the contacts (m,) [N m].
        weight: weight of the robot, the unit of forces [N].
        scale: factors on the coordinates of a wrench (6,).
        program: the linear program.
        open: lower bounds of the torque rows (2 m,).
    """

    def __init__(self, generators: Array, pull: Array, limit: Array, weight: float) -> None:
        """Make the program.

        Args:
            generators: wrenches of the friction edges about the world's origin (6, K).
            pull: torque that each generator takes off each joint (m, K).
            limit: torque limits of the joints (m,) [N m].
            weight: weight of the robot [N].
        """
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
        """Return t, the row of its dual, and the forces along the generators.

        Args:
            wrench: required wrench about the world's origin (6,) [N, N m].
            torque: torques of the joints without contact forces (m,) [N m].

        Returns:
            The excess t; the parts y_w (6,), y_tau (m,) and c of the row, with y_w w + y_tau tau + c = t; and the
            forces (K,) [N].
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
    """Return the program of a grid point at which contacts share a wrench, and the indices of its joints.

    Args:
        sharing: the sharing of the problem.
        point: the grid point.
        counted: whether the limit of each joint counts (n,).
    """
    stance = int(sharing.standing[point])
    family, generators = sharing.contacts[stance], sharing.contacts[stance].system.generators
    joints = np.flatnonzero(~sharing.known[point] & counted)
    pull = np.zeros((len(joints), generators.shape[1]))
    for name, part in sharing.parts(stance).items():
        pull[:, part] = sharing.motion.dynamics.contact_jacobians[name][point][:, joints].T @ generators[:, part]
    return SharingProgram(generators, pull, sharing.limit[joints], family.weight), joints


class SharingSearch:
    """Search for the torque rows that successive timings violate if contacts share a wrench.

    Attributes:
        counted: whether the limit of each joint counts (n,).
        programs: programs made so far, with the indices of their joints, by grid point.
        settled: u and x at each interval end at which no row was missing, else nan (M, 2).
    """

    def __init__(self, counted: Flags) -> None:
        """Make a search; `counted` tells whether the limit of each joint counts (n,)."""
        self.counted = counted
        self.programs: dict[int, tuple[SharingProgram, Indices]] = {}
        self.settled = np.full((0, 2), np.nan)

    def missing_rows(self, sharing: Sharing, points: Indices, u: Array, x: Array) -> tuple[list[SharedRow], int]:
        """Return the rows that a timing violates, and the number of programs solved.

        Args:
            sharing: the sharing of the problem.
            points: grid points, the same in every call (M,).
            u: sdd (M,).
            x: sd^2 (M,).
        """
        timing = np.stack([u, x], axis=1)
        if len(self.settled) != len(timing):
            self.settled = np.full(timing.shape, np.nan)
        still = (np.abs(timing - self.settled) <= STILL * np.abs(timing).max(axis=0)).all(axis=1)
        shared = (~sharing.known[points] & self.counted).any(axis=1)
        look = np.flatnonzero(shared & ~still)
        self.settled[look] = timing[look]
        found, solved = [], 0
        for k, force in self._doubtful(sharing, points[look], u[look], x[look]):
            end, point = look[k], int(points[look[k]])
            if point not in self.programs:
                self.programs[point] = program_at(sharing, point, self.counted)
            rows, count = _rows_from(sharing, self.programs[point], point, force, (u[[end]], x[[end]]))
            self.settled[end] = np.nan if rows else timing[end]
            found += rows
            solved += count
        return found, solved

    def _doubtful(self, sharing: Sharing, points: Indices, u: Array, x: Array) -> list[tuple[int, Array]]:
        """Return the interval ends at which explicit forces leave too little margin, and a generalised force (n,)."""
        if not len(points):
            return []
        affine = np.stack([u, x, np.ones(len(u))], axis=1)
        middle = np.einsum("mdk,mk->md", sharing.loads.middle()[points], affine)
        worst = _worst_for_contacts(sharing, points, u, x)
        few = _explicit_use(sharing, self.counted, points, middle) > 1.0 - DOUBTFUL
        fewer = _explicit_use(sharing, self.counted, points, worst) > 1.0 - LESS_DOUBTFUL
        return [(int(k), worst[k] if fewer[k] else middle[k]) for k in np.flatnonzero(few | fewer)]


def _rows_from(
    sharing: Sharing, program: tuple[SharingProgram, Indices], point: int, force: Array, at: tuple[Array, Array]
) -> tuple[list[SharedRow], int]:
    """Return the rows that are violated at a grid point, and the number of programs solved.

    A generalised force (n,) has a dual row, for which another one is worst, and so on. `at` is u and x, (1,) each.
    """
    (solver, joints), here = program, sharing.loads.at(np.array([point]))
    found, solved, best = [], 0, -np.inf
    for _ in range(ROUNDS):
        _, on_wrench, on_torque, constant, _ = solver.solve(force[:BASE], force[joints])
        solved += 1
        row = np.zeros(len(force))
        row[:BASE], row[joints] = on_wrench, on_torque
        worst = worst_wrench(here, row[None], *at)[0]
        value = float(row @ worst) + constant
        if value > VIOLATION and np.any(on_torque):
            found.append(SharedRow(point, row, constant, int(joints[np.argmax(np.abs(on_torque))])))
        if value <= max(best, -DOUBTFUL) + VIOLATION:
            break
        best, force = value, worst
    return found, solved


def _worst_for_contacts(sharing: Sharing, points: Indices, u: Array, x: Array) -> Array:
    """Return the generalised forces (M, n) for the parameters with the least margin of the contacts.

    With these parameters a weak limb may have to carry a load that the other limbs cannot carry.
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


def _explicit_use(sharing: Sharing, counted: Flags, points: Indices, force: Array) -> Array:
    """Return the share of their limits that the joints use with the smallest contact forces, (M,).

    `force` is the generalised force (M, n) at grid points (M,). The share is infinite if the forces miss the wrench.
    """
    use = np.empty(len(points))
    for k in np.unique(sharing.standing[points]):
        here, system = np.flatnonzero(sharing.standing[points] == k), sharing.contacts[k].system
        parts = sharing.parts(int(k))
        every = np.ones((len(here), system.generators.shape[1]))
        for name, part in parts.items():
            every[:, part] = willingness(name)
        center = np.array([-system.generators[4].mean(), system.generators[3].mean(), 0.0])
        wrench = force[here, :BASE].copy()
        wrench[:, 3:] -= np.cross(center, wrench[:, :3])
        forces, miss = distribute(system.about([center]).generators, every, wrench, sharing.contacts[k].weight)
        left = force[here].copy()
        for name, part in parts.items():
            push = forces[:, part] @ system.generators[:, part].T
            jacobian = sharing.motion.dynamics.contact_jacobians[name][points[here]]
            left -= (np.swapaxes(jacobian, 1, 2) @ push[:, :, None])[:, :, 0]
        shares = np.abs(left / sharing.limit)[:, counted & ~sharing.known[points[here[0]]]]
        use[here] = np.where(miss > MISS, np.inf, shares.max(axis=1))
    return use
