"""Search for the worst parameters of a timing, without any bound of the planner.

Masses, centres of mass and joint acceleration errors enter the wrenches exactly, squares and products included; each
contact point is displaced by itself, and the friction cone of every displaced patch is built anew. The result is a
lower bound of the worst case, so the fastest timing that satisfies all cases ever found bounds the duration of the
best robust plan from below.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from robustopt.arrays import Array, Flags
from robustopt.config import Config
from robustopt.config.load import with_values
from robustopt.geometry import convex_hull, rotation
from robustopt.limits import TimeScalingProblem
from robustopt.limits.bodies import INERTIA_TERMS
from robustopt.limits.cones import about_point, patch_facets
from robustopt.limits.formulas import evaluate
from robustopt.limits.names import LimitKind, LimitName
from robustopt.limits.polygons import Family, facet_family
from robustopt.limits.uncertainty import acceleration_error, bodies
from robustopt.scene.patches import Patch, patches
from robustopt.scene.placement import placements
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

CHUNK = 16
"""Ends of intervals whose bounds are evaluated at once, to save memory."""

VIOLATION = 1e-6
"""Fraction of the weight, or of a torque limit, by which a worst case must exceed it to become a row."""

SEARCHED = LimitName("worst case", "search")
"""Name of the rows that the search adds."""

ROUNDS, CLIMBS = 40, 8
"""Most rounds of cuts, and most sweeps over the parameters from one start; both usually end earlier."""


@dataclass(frozen=True)
class Box:
    """The uncertain parameters in units of their intervals, z in [-1, 1], and the inertial parameters for them.

    Attributes:
        names: Bodies.
        masses: Lowest and highest mass, shape (n, 2), [kg].
        arms: Centres of mass, carrier frame, shape (n, 3), [m].
        central: Inertia about them per mass, shape (n, 3, 3), [m^2].
        reaches: Full displacements of the centre of mass along the axes of each body, as columns, shape (n, 3, 3), [m].
        middle: Middle of the acceleration error of each joint, [rad/s^2 or m/s^2].
        radius: Half-width of it.
    """

    names: tuple[str, ...]
    masses: Array
    arms: Array
    central: Array
    reaches: Array
    middle: Array
    radius: Array

    @property
    def size(self) -> int:
        return 4 * len(self.names) + len(self.radius)

    @property
    def free(self) -> Flags:
        """Return whether each parameter has an interval of any width, (size,)."""
        return np.r_[
            self.masses[:, 0] < self.masses[:, 1], np.abs(self.reaches).max(axis=1).ravel() > 0, self.radius > 0
        ]

    def error(self, z: Array) -> Array:
        return self.middle + z[:, 4 * len(self.names) :] * self.radius

    def inertial(self, z: Array) -> Array:
        """Return m, m r and I_o of every body for z (M, size), shape (M, n, 10)."""
        n = len(self.names)
        mass = self.masses.mean(axis=1) + z[:, :n] * np.diff(self.masses)[:, 0] / 2
        r = self.arms + np.einsum("nij,mnj->mni", self.reaches, z[:, n : 4 * n].reshape(-1, n, 3))
        squares = np.einsum("mni,mni->mn", r, r)[:, :, None, None] * np.eye(3)
        inertia = self.central + squares - r[:, :, :, None] * r[:, :, None, :]
        terms = np.stack([inertia[:, :, i, j] for i, j in INERTIA_TERMS], axis=2)
        return mass[:, :, None] * np.concatenate([np.ones_like(r[:, :, :1]), r, terms], axis=2)


def box_of(config: Config, joints: int) -> Box:
    certain = with_values(config, {"uncertainty": {}})
    placed, uncertain = placements(config), config.uncertainty
    names, masses, arms, central, reaches = [], [], [], [], []
    for name, body in bodies(certain).items():
        arm = body.psi[1:4]
        about_origin = np.zeros((3, 3))
        for value, (i, j) in zip(body.psi[4:], INERTIA_TERMS, strict=True):
            about_origin[i, j] = about_origin[j, i] = value
        turn = placed[name].rotation if name in placed else np.eye(3)
        names.append(name)
        masses.append(uncertain.mass.get(name, body.mass))
        arms.append(arm)
        central.append(about_origin - (arm @ arm * np.eye(3) - np.outer(arm, arm)))
        reaches.append(turn * np.array(uncertain.center_of_mass.get(name, (0.0, 0.0, 0.0))))
    error = acceleration_error(config, joints, 0)
    return Box(tuple(names), *map(np.array, (masses, arms, central, reaches)), *error.arrays)


@dataclass(frozen=True)
class Limit:
    """Rows over the required wrench of some bodies about the carrier's origin: of a contact, or of the joint torques.

    Attributes:
        facets: Rows as fractions of the limit, (F, 6) for all displaced patches of a contact, (P, F, 6) for torques.
        own: Affine part of each row, (P, F, 3), 0 for a contact.
        own_error: Share of the acceleration errors z in [-1, 1] in each row, (P, F, n), 0 for a contact.
        carried: Whether each body of the box loads it, (n,).
        family: The same rows with the planner's bounds; they only choose the start of the search.
    """

    facets: Array
    own: Array
    own_error: Array
    carried: Array
    family: Family

    def rows(self, points: Array, row: Array, z: Array) -> tuple[Array, Array]:
        """Return the row (M, 6) and its own part (M, 3) at each point, for parameters z (M, size)."""
        if self.facets.ndim == 2:
            return self.facets[row], np.zeros((len(row), 3))
        own = self.own[points, row].copy()
        errors = self.own_error[points, row]
        own[:, 2] += np.einsum("mj,mj->m", errors, z[:, z.shape[1] - errors.shape[1] :])
        return self.facets[points, row], own

    def values(self, points: Array, wrench: Array, timing: Array, z: Array) -> Array:
        """Return the values of all rows for the wrenches (M, 6) at (u, x, 1) (M, 3), (M, F)."""
        if self.facets.ndim == 2:
            return wrench @ self.facets.T
        own = np.einsum("mfk,mk->mf", self.own[points], timing)
        errors = self.own_error[points]
        own += np.einsum("mfj,mj->mf", errors, z[:, z.shape[1] - errors.shape[2] :])
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
    family = Family(limits.B, limits.loads, limits.base, limits.base_terms, every)
    own_error = np.concatenate([per_limit, -per_limit], axis=1)
    return Limit(limits.B, limits.base, own_error, np.ones(len(box.names), dtype=bool), family)


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


def coefficients(problem: TimeScalingProblem, box: Box, limit: Limit, points: Array, z: Array) -> Array:
    """Return the required wrench of the bodies of a limit about the carrier's origin for parameters z (M, size).

    Returns:
        Coefficients of (u, x, 1), shape (M, 6, 3).
    """
    phi = np.einsum("mnj,n->mj", box.inertial(z), limit.carried.astype(float))
    per_rate = np.einsum("mkij,mj->mik", problem.limits.motion.wrench_map[points], phi)
    result = per_rate[:, :, :3].copy()
    result[:, :, 2] += np.einsum("mik,mk->mi", per_rate[:, :, 3:], box.error(z))
    return result


def worst_draws(
    problem: TimeScalingProblem,
    box: Box,
    limit: Limit,
    points: Array,
    u: Array,
    x: Array,
    rng: np.random.Generator,
) -> tuple[Array, Array, Array]:
    """Return the worst value found at each point, its row and its parameters: (M,), (M,), (M, size).

    The search goes coordinate by coordinate from random corners. A row is affine in each mass and each error, and
    quadratic in each centre of mass, so an end of the interval or the vertex of the parabola is best.
    """
    M, timing = len(points), np.stack([u, x, np.ones_like(u)], axis=1)

    def wrench(z: Array) -> Array:
        return np.einsum("mik,mk->mi", coefficients(problem, box, limit, points, z), timing)

    def value_of(row: Array, z: Array) -> Array:
        normals, own = limit.rows(points, row, z)
        return np.einsum("mi,mi->m", normals, wrench(z)) + np.einsum("mk,mk->m", own, timing)

    likely = _likely_rows(limit, points, u, x)
    best = np.full(M, -np.inf)
    facet, parameters = np.zeros(M, dtype=np.int64), np.zeros((M, box.size))
    for trial in range(STARTS * likely.shape[1]):
        row = likely[:, trial % likely.shape[1]]
        z = np.where(box.free, rng.choice([-1.0, 1.0], size=(M, box.size)), 0.0)
        value = np.full(M, -np.inf)
        for _ in range(CLIMBS):
            for k in np.flatnonzero(box.free):
                levels = [value_of(row, _at(z, k, level)) for level in (-1.0, 0.0, 1.0)]
                z = _at(z, k, _best_level(*levels))
            values = limit.values(points, wrench(z), timing, z)
            row, reached = np.argmax(values, axis=1), values.max(axis=1)
            if (reached <= value + 1e-12).all():
                break
            value = reached
        better = value > best
        best[better], facet[better], parameters[better] = value[better], row[better], z[better]
    return best, facet, parameters


def _likely_rows(limit: Limit, points: Array, u: Array, x: Array) -> Array:
    """Return the rows with the largest bounds at each point, (M, up to WORST_ROWS).

    Other rows are violated less, if at all.
    """
    B, loads, base, base_terms, _ = limit.family
    chosen = []
    for k in range(0, len(points), CHUNK):
        part = slice(k, k + CHUNK)
        here = points[part]
        rows, own = B[here] if len(B) > 1 else B[0], base[here] if base.size else base
        terms = base_terms[here] if base_terms.size else base_terms
        bounds = evaluate(rows, loads.at(here), own, terms, u[part], x[part])
        chosen.append(np.argsort(-bounds, axis=1)[:, :WORST_ROWS])
    return np.concatenate(chosen)


def _at(z: Array, k: int, level: Array | float) -> Array:
    """Return z with one coordinate at a level."""
    result = z.copy()
    result[:, k] = level
    return result


def _best_level(lowest: Array, middle: Array, highest: Array) -> Array:
    """Return the maximiser in [-1, 1] of the parabola through the values at -1, 0 and 1."""
    slope, bend = (highest - lowest) / 2, (highest + lowest) / 2 - middle
    vertex = np.clip(-slope / (2 * np.where(bend < 0, bend, -1.0)), -1.0, 1.0)
    return np.where(bend < 0, vertex, np.where(highest >= lowest, 1.0, -1.0))


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
    points, still = np.arange(len(problem.s)), np.array([0.0, 0.0, 1.0])
    middle = np.zeros((len(points), box.size))
    wrench = coefficients(problem, box, limit, points, middle)[:, :, 2]
    values = limit.values(points, wrench, np.broadcast_to(still, (len(points), 3)), middle)
    return points, _rows_of(problem, box, limit, points, np.argmax(values, axis=1), middle)


def _violated_rows(problem: TimeScalingProblem, box: Box, limit: Limit, plan: Plan, rng: np.random.Generator) -> Cuts:
    """Return the rows that a plan violates for the worst parameters found."""
    u, x, points = interval_ends(problem, plan.x, plan.u)
    value, facet, z = worst_draws(problem, box, limit, points, u, x, rng)
    hit = value > VIOLATION
    return points[hit], _rows_of(problem, box, limit, points[hit], facet[hit], z[hit])


def _rows_of(problem: TimeScalingProblem, box: Box, limit: Limit, points: Array, row: Array, z: Array) -> Array:
    """Return rows of a limit as coefficients of (u, x, 1) for parameters z (M, size), (M, 3)."""
    normals, own = limit.rows(points, row, z)
    return np.einsum("mi,mik->mk", normals, coefficients(problem, box, limit, points, z)) + own


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
