"""Search for the worst parameters of a timing, without any bound of the planner.

Masses, centres of mass, inertias and joint acceleration errors enter the wrenches exactly, squares and products
included, and all bodies share one acceleration error; each contact point is displaced by itself, and the friction cone
of every displaced patch is built anew. The result is a lower bound of the worst case, so the fastest timing that
satisfies all cases ever found bounds the duration of the best robust plan from below.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from worst_bodies import Box, box_of

from robustopt.arrays import Array, Indices
from robustopt.config import Config
from robustopt.geometry import convex_hull, rotation
from robustopt.limits import TimeScalingProblem
from robustopt.limits.cones import about_point, patch_facets
from robustopt.limits.formulas import evaluate
from robustopt.limits.names import LimitKind, LimitName
from robustopt.limits.polygons import Family, facet_family
from robustopt.scene.patches import Patch, patches
from robustopt.solvers import Plan, Status
from robustopt.solvers.plan import interval_ends
from robustopt.solvers.reachability import solve_reachability

STARTS = 3
"""Random corners of the box from which the search climbs, per row; more of them found nothing new."""

DISPLACEMENTS = 16
"""Random displacements of the contact points of a patch, beside the systematic ones."""

NOTHING = np.zeros((0, 0, 3))
"""Own part of rows without one."""

WORST_ROWS = 6
"""Number of rows that are searched at each end of an interval: the ones with the largest bounds."""

FAR = -0.01
"""Bound below which a row is not searched, as a fraction of the limit."""

CHUNK = 16
"""Ends of intervals whose bounds are evaluated at once, to save memory."""

VIOLATION = 1e-6
"""Fraction of the weight, or of a torque limit, by which a worst case must exceed it to become a row."""

SEARCHED = LimitName("worst case", "search")
"""Name of the rows that the search adds."""

ROUNDS, CLIMBS = 40, 8
"""Most rounds of cuts, and most sweeps over the parameters from one start; both usually end earlier."""


@dataclass(frozen=True)
class Limit:
    """Rows over the required wrench of some bodies about the carrier's origin: of a contact, or of the joint torques.

    Attributes:
        facets: Rows as fractions of the limit, (F, 6) for all displaced patches of a contact, (P, F, 6) for torques.
        own: Affine part of each row, (P, F, 3), 0 for a contact.
        own_error: Share of the acceleration errors in [-1, 1] in each row, (P, F, n), 0 for a contact.
        carried: Whether each body of the box loads it, (n,).
        family: The same rows with the planner's bounds; they only choose the start of the search.
    """

    facets: Array
    own: Array
    own_error: Array
    carried: Array
    family: Family

    def rows(self, points: Array, row: Array, error: Array) -> tuple[Array, Array]:
        """Return the row (M, 6) and its own part (M, 3) at each point, for errors in [-1, 1] (M, n)."""
        if self.facets.ndim == 2:
            return self.facets[row], np.zeros((len(row), 3))
        own = self.own[points, row].copy()
        own[:, 2] += np.einsum("mj,mj->m", self.own_error[points, row], error)
        return self.facets[points, row], own

    def values(self, points: Array, wrench: Array, timing: Array, error: Array) -> Array:
        """Return the values of all rows for the wrenches (M, 6) at (u, x, 1) (M, 3), (M, F)."""
        if self.facets.ndim == 2:
            return wrench @ self.facets.T
        own = np.einsum("mfk,mk->mf", self.own[points], timing)
        own += np.einsum("mfj,mj->mf", self.own_error[points], error)
        return own + np.einsum("mfi,mi->mf", self.facets[points], wrench)


def interfaces(problem: TimeScalingProblem, box: Box, rng: np.random.Generator) -> list[Limit]:
    config, uncertainty = problem.config, problem.limits.uncertainty
    lowest, shift = uncertainty.worst_friction, dict(uncertainty.contact_points)
    found = []
    for family in problem.limits.contacts:
        (name,), (load,) = family.system.objects, family.system.loads
        patch = next(patch for patch in patches(config) if patch.object == name)
        facets = np.concatenate(
            [_facets(config, patch, corners, lowest[name]) for corners in _displaced(patch, shift.get(name, 0.0), rng)]
        )
        facets /= family.weight
        point = family.system.points[0]
        bounds = facet_family(facets @ np.linalg.inv(about_point(point)), family.loads, np.arange(len(facets)))
        found.append(Limit(facets, NOTHING, NOTHING, np.isin(box.names, load), bounds))
    return found


def torque(problem: TimeScalingProblem, box: Box) -> Limit:
    """Return the torque limits of an arm without viscous friction."""
    limits = problem.limits.torque
    per_limit = problem.limits.motion.dynamics.mass_matrix * box.radius / problem.robot.limits.torque[:, None]
    every = np.arange(2 * problem.robot.n)
    family = Family(limits.load_rows, limits.loads, limits.base, limits.base_terms, every)
    own_error = np.concatenate([per_limit, -per_limit], axis=1)
    return Limit(limits.load_rows, limits.base, own_error, np.ones(len(box.names), dtype=bool), family)


def _facets(config: Config, patch: Patch, corners: Array, mu: float) -> Array:
    corners = convex_hull(corners)
    centre = np.append(corners.mean(axis=0), patch.origin[2])
    return patch_facets(corners - centre[:2], mu, config.contact.cone_edges) @ about_point(centre)


def _displaced(patch: Patch, shift: float, rng: np.random.Generator) -> Iterator[Array]:
    """Yield the patch with its corners displaced: all alike, all towards the middle, and at random."""
    if shift == 0.0:
        yield patch.polygon
        return
    turn = rotation(patch.turn)
    inwards = np.sign(np.round((patch.polygon.mean(axis=0) - patch.polygon) @ turn, 9))
    moves = [np.broadcast_to(move, patch.polygon.shape) for move in product((-1.0, 1.0), repeat=2)] + [inwards]
    moves += [rng.choice([-1.0, 1.0], size=patch.polygon.shape) for _ in range(DISPLACEMENTS)]
    moves += [np.where(inwards == 0, rng.choice([-1.0, 1.0], size=inwards.shape), inwards) for _ in range(4)]
    for move in moves:
        yield patch.polygon + shift * move @ turn.T


@dataclass(frozen=True)
class Search:
    """A limit at M ends of intervals, whose worst parameters are searched.

    Attributes:
        problem: The problem.
        box: The uncertain parameters.
        limit: The limit.
        points: Grid points, shape (M,).
        timing: (u, x, 1), shape (M, 3).
    """

    problem: TimeScalingProblem
    box: Box
    limit: Limit
    points: Array
    timing: Array

    def prices(self, normals: Array) -> Array:
        """Return the values of rows (M, 6) per u, x, 1 and error, and per inertial parameter, (M, k, 10)."""
        return np.einsum("mi,mkij->mkj", normals, self.problem.limits.motion.wrench_map[self.points])

    def price(self, prices: Array, z: Array) -> Array:
        """Return the values of rows per inertial parameter for parameters z (M, size), (M, 10)."""
        return np.einsum("mk,mkj->mj", np.hstack([self.timing, self.box.error(z)]), prices)

    def phi(self, z: Array) -> Array:
        """Return the inertial parameters of everything that loads the limit, (M, 10)."""
        return np.einsum("mnj,n->mj", self.box.inertial(z), self.limit.carried.astype(float))

    def coefficients(self, row: Array, z: Array) -> Array:
        """Return a row at each point as coefficients of (u, x, 1) for parameters z (M, size), (M, 3)."""
        normals, own = self.limit.rows(self.points, row, self.box.units(z))
        per_rate = np.einsum("mkj,mj->mk", self.prices(normals), self.phi(z))
        result = own + per_rate[:, :3]
        result[:, 2] += np.einsum("mk,mk->m", per_rate[:, 3:], self.box.error(z))
        return result

    def required(self, z: Array) -> Array:
        """Return the required wrenches about the carrier's origin for parameters z (M, size), (M, 6)."""
        rates = np.hstack([self.timing, self.box.error(z)])
        regressor = np.einsum("mk,mkij->mij", rates, self.problem.limits.motion.wrench_map[self.points])
        return np.einsum("mij,mj->mi", regressor, self.phi(z))

    def values(self, z: Array) -> Array:
        """Return the values of all rows for parameters z (M, size), (M, F)."""
        return self.limit.values(self.points, self.required(z), self.timing, self.box.units(z))

    def at(self, ends: Indices) -> Search:
        """Return the same limit at some of the ends."""
        return replace(self, points=self.points[ends], timing=self.timing[ends])

    def climb(self, row: Array, z: Array) -> tuple[Array, Array, Array]:
        """Return the value, row and parameters that are reached from a row and parameters at each end.

        The search goes coordinate by coordinate. A row is affine in each mass and each error. For a centre of mass the
        ends, the middle and the vertex of the parabola through them are tried, each with its worst inertia.
        """
        value, row, z = np.full(len(row), -np.inf), row.copy(), z.copy()
        climbing = np.arange(len(row))
        for _ in range(CLIMBS):
            if not len(climbing):
                break
            here = self.at(climbing)
            z[climbing] = here._sweep(row[climbing], z[climbing])
            values = here.values(z[climbing])
            row[climbing], reached = np.argmax(values, axis=1), values.max(axis=1)
            better = reached > value[climbing] + 0.1 * VIOLATION
            value[climbing] = reached
            climbing = climbing[better]
        return value, row, z

    def _sweep(self, row: Array, z: Array) -> Array:
        """Return z after a step along each free parameter, for a row at each point."""
        box, n = self.box, len(self.box.names)
        normals, _ = self.limit.rows(self.points, row, box.units(z))
        prices = self.prices(normals)
        z = self._at_worst(z, self.price(prices, z))
        for k in np.flatnonzero(box.free):
            price = self.price(prices, z)
            tried, values = [], []
            for level in (-1.0, 1.0, 0.0, None) if n <= k < 4 * n else (-1.0, 1.0):
                changed = z.copy()
                changed[:, k] = _vertex(*values) if level is None else level
                tried.append(self._at_worst(changed, price) if n <= k < 4 * n else changed)
                own = self.limit.rows(self.points, row, box.units(changed))[1]
                bodies = np.einsum("mj,mj->m", self.price(prices, tried[-1]), self.phi(tried[-1]))
                values.append(bodies + np.einsum("mk,mk->m", own, self.timing))
            z = np.array(tried)[np.argmax(values, axis=0), np.arange(len(z))]
        return z

    def _at_worst(self, z: Array, price: Array) -> Array:
        return self.box.with_worst_moments(z, price, self.limit.carried)


def _vertex(low: Array, high: Array, middle: Array) -> Array:
    """Return the maximiser in [-1, 1] of the parabola with these values at -1, 1 and 0; 0 for one without maximum."""
    slope, bend = (high - low) / 2, (high + low) / 2 - middle
    return np.clip(np.where(bend < 0, -slope / (2 * np.where(bend < 0, bend, -1.0)), 0.0), -1.0, 1.0)


def worst_draws(search: Search, rng: np.random.Generator) -> tuple[Array, Array, Array, Indices]:
    """Return the worst values found, their rows, their parameters, and the ends of intervals where they are.

    The search climbs from random corners of the box for each row that is likely to be violated.
    """
    box = search.box
    ends, first = _likely_rows(search)
    search = search.at(ends)
    value, row, parameters = np.full(len(ends), -np.inf), first.copy(), box.nominal(len(ends))
    for _ in range(STARTS):
        z = box.nominal(len(ends))
        corner = rng.choice([-1.0, 1.0], size=(len(ends), len(box.free)))
        z[:, : len(box.free)] = np.where(box.free, corner, 0.0)
        reached, last, z = search.climb(first, z)
        better = reached > value
        value[better], row[better], parameters[better] = reached[better], last[better], z[better]
    return value, row, parameters, ends


def _likely_rows(search: Search) -> tuple[Indices, Indices]:
    """Return the rows with the largest bounds, up to WORST_ROWS at each end of an interval: the ends and their rows.

    Other rows are violated less, if at all.
    """
    B, wrench, base, base_terms, _ = search.limit.family
    ends, rows = [], []
    for first in range(0, len(search.points), CHUNK):
        part = slice(first, first + CHUNK)
        here, (u, x, _) = search.points[part], search.timing[part].T
        facets, own = B[here] if len(B) > 1 else B[0], base[here] if base.size else base
        terms = base_terms[here] if base_terms.size else base_terms
        bounds = evaluate(facets, wrench.at(here), own, terms, u, x)
        largest = np.argsort(-bounds, axis=1)[:, :WORST_ROWS]
        end, place = np.nonzero(np.take_along_axis(bounds, largest, axis=1) > FAR)
        ends.append(first + end)
        rows.append(largest[end, place])
    return np.concatenate(ends), np.concatenate(rows)


@dataclass(frozen=True)
class Tightness:
    """The result of the search.

    Attributes:
        robust: Duration of the plan with the bounds [s].
        possible: Lower bound of the duration of any robust plan [s].
        rows: Number of worst cases found.
    """

    robust: float
    possible: float
    rows: int


def tightness(problem: TimeScalingProblem, plan: Plan, seed: int) -> Tightness:
    """Compare a plan with the fastest timing for all worst cases that the search finds.

    Joint torques are searched if there is no viscous friction, whose tangent is another kind of bound; otherwise the
    bounds of the torques stay.
    """
    rng = np.random.default_rng(seed)
    box = box_of(problem.config, problem.robot.n)
    found, searched = interfaces(problem, box, rng), {LimitKind.SLIP, LimitKind.TIPPING}
    if not problem.limits.torque.viscous.any():
        found.append(torque(problem, box))
        searched.add(LimitKind.TORQUE)
    exact = problem.only([name for name in problem.limits.names if name.kind not in searched])
    current = _with_rows(exact, [_standing_rows(exact, box, item) for item in found])
    count, best = 0, solve_reachability(current)
    for _ in range(ROUNDS):
        assert best.status is Status.SOLVED, "the bounds have a plan, so some of their rows have one"
        cuts = [_violated_rows(current, box, item, best, rng) for item in found]
        added = sum(len(cut[0]) for cut in cuts)
        if not added:
            break
        count += added
        current = _with_rows(current, cuts)
        best = solve_reachability(current)
    return Tightness(plan.duration, best.duration, count)


Cuts = tuple[Array, Array]
"""Grid points (R,), and rows a, b, c there (R, 3)."""


def _standing_rows(problem: TimeScalingProblem, box: Box, limit: Limit) -> Cuts:
    """Return the row at every grid point that standing still nearly violates, at nominal parameters, as a start."""
    points = np.arange(len(problem.s))
    search = Search(problem, box, limit, points, np.tile([0.0, 0.0, 1.0], (len(points), 1)))
    nominal = box.nominal(len(points))
    return points, search.coefficients(np.argmax(search.values(nominal), axis=1), nominal)


def _violated_rows(problem: TimeScalingProblem, box: Box, limit: Limit, plan: Plan, rng: np.random.Generator) -> Cuts:
    """Return the rows that a plan violates for the worst parameters found."""
    u, x, points = interval_ends(plan)
    search = Search(problem, box, limit, points, np.stack([u, x, np.ones_like(u)], axis=1))
    value, row, z, ends = worst_draws(search, rng)
    hit = value > VIOLATION
    return points[ends[hit]], search.at(ends[hit]).coefficients(row[hit], z[hit])


def _with_rows(problem: TimeScalingProblem, cuts: list[Cuts]) -> TimeScalingProblem:
    """Return the problem with more rows, in as many columns as the grid point with most of them needs."""
    points = np.concatenate([cut[0] for cut in cuts])
    rows = np.concatenate([cut[1] for cut in cuts])
    order = np.argsort(points, kind="stable")
    points, rows = points[order], rows[order]
    slot = np.arange(len(points)) - np.searchsorted(points, points)
    extra = np.zeros((len(problem.s), int(slot.max(initial=-1)) + 1, 3))
    extra[:, :, 2] = -1.0
    extra[points, slot] = rows
    a, b, c = (np.hstack([old, extra[:, :, k]]) for k, old in enumerate((problem.a, problem.b, problem.c)))
    return replace(problem, a=a, b=b, c=c, row_names=(*problem.row_names, *[SEARCHED] * extra.shape[1]))
