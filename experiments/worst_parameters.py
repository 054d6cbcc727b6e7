"""A search for the parameters that a timing likes least, which shares no bound with the planner.

Masses, centres of mass and joint acceleration errors are put into the wrenches as they are, squares and products
included; each contact point is displaced by itself, and the friction cone of every displaced patch is built anew. What
the search finds is a lower bound of the worst case, so the fastest timing that satisfies all that it has ever found is
a lower bound of the duration of the best robust plan.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from robustopt.config import Config, with_values
from robustopt.config.geometry import Patch, convex_hull, patches, placements, rotation
from robustopt.contact import about_point, patch_facets
from robustopt.problem import TimeScalingProblem
from robustopt.problem.polygons import Loads
from robustopt.problem.rows import evaluate
from robustopt.problem.uncertainty import INERTIA_TERMS, acceleration_error, bodies, contact_shift, friction
from robustopt.timescaling import Plan, Status
from robustopt.timescaling.plan import interval_ends
from robustopt.timescaling.reachability import solve_reachability

Array = np.ndarray

STARTS = 3
"""Random corners of the box that the search climbs from, per row; more of them found nothing more."""

DISPLACEMENTS = 16
"""Random displacements of the contact points of a patch beside the systematic ones."""

WORST_ROWS = 6
"""Facets that are searched at each end of an interval: those whose bound is largest, where it is violated at all."""

CHUNK = 16
"""Ends of intervals whose bounds are evaluated at once, for the sake of memory."""

VIOLATION = 1e-6
"""Fraction of the weight by which a worst case may leave the cone before it becomes a row."""

ROUNDS, CLIMBS = 40, 8
"""Most rounds of cuts, and sweeps over the parameters from one start; both end by themselves before that."""


@dataclass(frozen=True)
class Box:
    """The uncertain parameters in units of their intervals, z in [-1, 1], and the inertial parameters for them.

    masses: (lowest, highest) per body, (n, 2); arms: centres of mass in the tray frame (n, 3); central: inertia about
    them per mass, (n, 3, 3); reaches: columns are the full displacements along the axes of each body (n, 3, 3);
    middle, radius: of the joint acceleration error
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
    def free(self) -> Array:
        """Which parameters have an interval of any width, (size,)."""
        return np.r_[
            self.masses[:, 0] < self.masses[:, 1], np.abs(self.reaches).max(axis=1).ravel() > 0, self.radius > 0
        ]

    def error(self, z: Array) -> Array:
        return self.middle + z[:, 4 * len(self.names) :] * self.radius

    def inertial(self, z: Array) -> Array:
        """m, m r and I_o of every body for z (M, size), shape (M, n, 10)."""
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
        turn = np.eye(3)
        turn[:2, :2] = rotation(placed[name].yaw if name in placed else 0.0)
        names.append(name)
        masses.append(uncertain.mass.get(name, body.mass))
        arms.append(arm)
        central.append(about_origin - (arm @ arm * np.eye(3) - np.outer(arm, arm)))
        reaches.append(turn * np.array(uncertain.center_of_mass.get(name, (0.0, 0.0, 0.0))))
    return Box(tuple(names), *map(np.array, (masses, arms, central, reaches)), *acceleration_error(config, joints))


@dataclass(frozen=True)
class Interface:
    """One interface: facets of the cones of all displaced patches about the tray's origin, as fractions of the weight.

    carried: which bodies of the box load it, (n,); loads: the same with the planner's bounds, about `point`; they only
    choose where the search begins
    """

    facets: Array
    carried: Array
    loads: Loads
    point: Array


def interfaces(problem: TimeScalingProblem, box: Box, rng: np.random.Generator) -> list[Interface]:
    config = problem.config
    lowest, shift = friction(config), contact_shift(config)
    found = []
    for family in problem.limits.contacts:
        (name,), (load,) = family.system.objects, family.system.loads
        patch = next(patch for patch in patches(config) if patch.object == name)
        facets = [
            _facets(config, patch, corners, lowest[name]) for corners in _displaced(patch, shift.get(name, 0.0), rng)
        ]
        found.append(
            Interface(
                np.concatenate(facets) / family.weight, np.isin(box.names, load), family.loads, family.system.points[0]
            )
        )
    return found


def _facets(config: Config, patch: Patch, corners: Array, mu: float) -> Array:
    corners = convex_hull(corners)
    centre = np.append(corners.mean(axis=0), patch.z)
    return patch_facets(corners - centre[:2], mu, config.contact.cone_edges) @ about_point(centre)


def _displaced(patch: Patch, shift: float, rng: np.random.Generator) -> Iterator[Array]:
    """The patch with its corners displaced: all alike, all towards the middle, and at random."""
    if shift == 0.0:
        yield patch.polygon
        return
    turn = rotation(patch.yaw)
    inwards = np.sign(np.round((patch.polygon.mean(axis=0) - patch.polygon) @ turn, 9))
    moves = [np.broadcast_to(move, patch.polygon.shape) for move in product((-1.0, 1.0), repeat=2)] + [inwards]
    moves += [rng.choice([-1.0, 1.0], size=patch.polygon.shape) for _ in range(DISPLACEMENTS)]
    moves += [np.where(inwards == 0, rng.choice([-1.0, 1.0], size=inwards.shape), inwards) for _ in range(4)]
    for move in moves:
        yield patch.polygon + shift * move @ turn.T


def coefficients(problem: TimeScalingProblem, box: Box, interface: Interface, points: Array, z: Array) -> Array:
    """Wrench of an interface for parameters z (M, size): coefficients of u, x, 1 about the tray's origin, (M, 6, 3)."""
    phi = np.einsum("mnj,n->mj", box.inertial(z), interface.carried.astype(float))
    per_rate = np.einsum("mkij,mj->mik", problem.limits.motion.regressors[points], phi)
    result = per_rate[:, :, :3].copy()
    result[:, :, 2] += np.einsum("mik,mk->mi", per_rate[:, :, 3:], box.error(z))
    return result


def worst_draws(
    problem: TimeScalingProblem,
    box: Box,
    interface: Interface,
    points: Array,
    u: Array,
    x: Array,
    rng: np.random.Generator,
) -> tuple[Array, Array, Array]:
    """For each point the worst value found, its facet and its parameters: (M,), (M,), (M, size).

    Coordinate by coordinate from random corners: a row is affine in each mass and each error, and a parabola in each
    centre of mass, so an end or the vertex of the parabola is the best of a coordinate.
    """
    M, timing = len(points), np.stack([u, x, np.ones_like(u)], axis=1)

    def wrench(z: Array) -> Array:
        return np.einsum("mik,mk->mi", coefficients(problem, box, interface, points, z), timing)

    likely = _likely_rows(interface, points, u, x)
    best = np.full(M, -np.inf)
    facet, parameters = np.zeros(M, dtype=np.int64), np.zeros((M, box.size))
    for trial in range(STARTS * WORST_ROWS):
        row = likely[:, trial % WORST_ROWS]
        z = np.where(box.free, rng.choice([-1.0, 1.0], size=(M, box.size)), 0.0)
        value = np.full(M, -np.inf)
        for _ in range(CLIMBS):
            normals = interface.facets[row]
            for k in np.flatnonzero(box.free):
                levels = [np.einsum("mi,mi->m", normals, wrench(_at(z, k, level))) for level in (-1.0, 0.0, 1.0)]
                z = _at(z, k, _best_level(*levels))
            values = wrench(z) @ interface.facets.T
            row, reached = np.argmax(values, axis=1), values.max(axis=1)
            if (reached <= value + 1e-12).all():
                break
            value = reached
        better = value > best
        best[better], facet[better], parameters[better] = value[better], row[better], z[better]
    return best, facet, parameters


def _likely_rows(interface: Interface, points: Array, u: Array, x: Array) -> Array:
    """The facets of largest bound at each point, (M, WORST_ROWS): others are violated less, or by nothing at all."""
    facets = interface.facets @ np.linalg.inv(about_point(interface.point))
    none, no_terms = np.zeros((0, 0, 3)), np.zeros((0, 0, 0))
    chosen = []
    for k in range(0, len(points), CHUNK):
        part = slice(k, k + CHUNK)
        bounds = evaluate(facets, interface.loads.at(points[part]), none, no_terms, u[part], x[part])
        chosen.append(np.argsort(-bounds, axis=1)[:, :WORST_ROWS])
    return np.concatenate(chosen)


def _at(z: Array, k: int, level: Array | float) -> Array:
    """z with coordinate k at a level."""
    result = z.copy()
    result[:, k] = level
    return result


def _best_level(lowest: Array, middle: Array, highest: Array) -> Array:
    """Where in [-1, 1] the parabola through the values at -1, 0 and 1 is largest."""
    slope, bend = (highest - lowest) / 2, (highest + lowest) / 2 - middle
    vertex = np.clip(-slope / (2 * np.where(bend < 0, bend, -1.0)), -1.0, 1.0)
    return np.where(bend < 0, vertex, np.where(highest >= lowest, 1.0, -1.0))


@dataclass(frozen=True)
class Tightness:
    """robust: duration of the plan of the bounds; possible: lower bound of that of any robust plan [s]; rows: cuts"""

    robust: float
    possible: float
    rows: int


def tightness(problem: TimeScalingProblem, plan: Plan, seed: int) -> Tightness:
    """How much faster than a plan another robust plan could be: the fastest one for all draws that the search finds."""
    rng = np.random.default_rng(seed)
    box = box_of(problem.config, problem.robot.n)
    found = interfaces(problem, box, rng)
    exact = problem.only([name for name in problem.limits.names if not name.startswith(("slip", "tipping"))])
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
"""Grid points (R,) and rows a, b, c there (R, 3)."""


def _standing_rows(problem: TimeScalingProblem, box: Box, interface: Interface) -> Cuts:
    """At every grid point the row that standing still comes nearest to, with parameters at their middle: a start."""
    points = np.arange(len(problem.s))
    middle = coefficients(problem, box, interface, points, np.zeros((len(points), box.size)))
    rows = np.einsum("fi,mik->mfk", interface.facets, middle)
    return points, rows[points, np.argmax(rows[:, :, 2], axis=1)]


def _violated_rows(
    problem: TimeScalingProblem, box: Box, interface: Interface, plan: Plan, rng: np.random.Generator
) -> Cuts:
    """Rows that a plan violates for the worst parameters found."""
    u, x, points = interval_ends(problem, plan.x, plan.u)
    value, facet, z = worst_draws(problem, box, interface, points, u, x, rng)
    hit = value > VIOLATION
    per_rate = coefficients(problem, box, interface, points[hit], z[hit])
    return points[hit], np.einsum("mi,mik->mk", interface.facets[facet[hit]], per_rate)


def _with_rows(problem: TimeScalingProblem, cuts: list[Cuts]) -> TimeScalingProblem:
    """The problem with more rows, in as many columns as the grid point with most of them needs."""
    points = np.concatenate([cut[0] for cut in cuts])
    rows = np.concatenate([cut[1] for cut in cuts])
    order = np.argsort(points, kind="stable")
    points, rows = points[order], rows[order]
    slot = np.arange(len(points)) - np.searchsorted(points, points)
    extra = np.zeros((len(problem.s), int(slot.max(initial=-1)) + 1, 3))
    extra[:, :, 2] = -1.0
    extra[points, slot] = rows
    a, b, c = (np.hstack([old, extra[:, :, k]]) for k, old in enumerate((problem.a, problem.b, problem.c)))
    return replace(problem, a=a, b=b, c=c, row_names=(*problem.row_names, *["contact"] * extra.shape[1]))
