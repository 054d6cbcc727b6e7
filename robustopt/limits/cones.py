"""Cones of wrenches that a flat patch with Coulomb friction can transmit.

A wrench is force then moment. A patch presses along the z axis of its own axes. Its contact forces are combinations of
the edges of the friction cones at its corners; the cone of their wrenches has explicit facets, one for each facet of
the hull of its section by unit normal force.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from robustopt.arrays import Array, Flags, Indices
from robustopt.limits.facets import slip_facets

COARSE_EDGES, FINE_EDGES = 16, 72
"""Edges of each friction cone if they are chosen automatically. Fine ones are affordable for a single patch of three or
four corners, whose facets have a closed form. They lose at most 0.1 % of friction, so 0.05 % of a duration."""

MOST_GENERATORS = 192
"""Largest number of friction edges of a patch for which its facets are computed: a rectangle with 16 edges has 588
facets, a round patch of 8 points 1976, the hull of the lips of four cups, 12 points, 5140 (half a second)."""

FACET_TOLERANCE = 1e-8
"""Fraction of the normal force by which a facet may cut off a generator; the hull code is accurate to about 1e-12."""

FACET_MERGE = 1e-9
"""Difference of unit normals below which two facets are parts of one facet that the hull code has triangulated."""

FAR = 1e300
"""Entries of facets that fill the last blocks while facets are ordered."""

ABOVE = np.array([0.0, 0.0, 1.0])
"""Point above a patch of unit size about which facets are compared, near typical centres of mass: with blocks of facets
that are similar about this point, a third fewer may bind than with blocks that are similar about the patch's origin."""


def about_point(point: Array) -> Array:
    """Return the matrix (6, 6) that turns a wrench about the origin into the same wrench about another point.

    Args:
        point: the other point (3,) [m].
    """
    transform, (x, y, z) = np.eye(6), point
    transform[3, 1], transform[3, 2], transform[4, 0] = z, -y, -z
    transform[4, 2], transform[5, 0], transform[5, 1] = x, y, -x
    return transform


def into_axes(axes: Array) -> Array:
    """Return the matrix (6, 6) that expresses a wrench in other axes.

    Args:
        axes: the other axes as columns (3, 3).
    """
    transform = np.zeros((6, 6))
    transform[:3, :3] = transform[3:, 3:] = axes.T
    return transform


def friction_edges(mu: float, edges: int) -> Array:
    """Return the edges of the inner approximation of a friction cone, each with unit normal force, (edges, 3).

    Args:
        mu: coefficient of friction.
        edges: number of edges; the first one lies along x.
    """
    angle = 2 * np.pi * np.arange(edges) / edges
    return np.array([mu * np.cos(angle), mu * np.sin(angle), np.ones(edges)]).T


def wrench_generators(points: Array, mu: float, edges: int, axes: Array | None = None) -> Array:
    """Return the wrenches of the edge forces at contact points.

    Args:
        points: contact points (n, 3) [m].
        mu: coefficient of friction.
        edges: number of edges of each friction cone.
        axes: axes of the contact as columns (3, 3), its normal last; by default the axes of the points.

    Returns:
        Wrenches about the origin, the edges of a point side by side, (6, n * edges).
    """
    forces = friction_edges(mu, edges).T
    fx, fy, fz = forces if axes is None else axes @ forces
    x, y, z = points.T[:, :, None]
    wrenches = np.empty((6, len(points), edges))
    wrenches[0], wrenches[1], wrenches[2] = fx, fy, fz
    wrenches[3], wrenches[4], wrenches[5] = y * fz - z * fy, z * fx - x * fz, x * fy - y * fx
    return wrenches.reshape(6, -1)


@dataclass(frozen=True, eq=False)
class UnitCone:
    """The wrench cone of a flat patch of unit size at mu = 1, moments about the patch's origin.

    Attributes:
        facets: rows (F, 6), each scaled to -1 of the normal force, so that its value is a fraction of that force;
            similar rows are neighbours.
        tips: whether a row bounds tipping rather than slip (F,).
    """

    facets: Array
    tips: Flags


@lru_cache(maxsize=256)
def _unit_cone(polygon: tuple[tuple[float, float], ...], edges: int) -> UnitCone | None:
    """Return the cone of a patch, or None if the hull code fails or its facets cut off a generator.

    The section f_z = 1 of the cone is the hull of the generators, all of which have f_z = 1.
    """
    points = np.column_stack([np.array(polygon), np.zeros(len(polygon))])
    generators = wrench_generators(points, 1.0, edges)
    try:
        equations = ConvexHull(generators[[0, 1, 3, 4, 5]].T).equations
    except QhullError:
        return None
    facets = np.column_stack([equations[:, :2], equations[:, 5], equations[:, 2:5]])
    _, first = np.unique(np.round(facets / FACET_MERGE), axis=0, return_index=True)
    facets = merge_close(facets[np.sort(first)])
    facets /= -facets[:, 2:3]
    facets = facets[_by_likeness(facets @ about_point(-ABOVE), np.arange(len(facets)))]
    outside = (facets @ generators).max()
    return None if outside > FACET_TOLERANCE else UnitCone(facets, tipping_rows(facets, generators, edges))


@lru_cache(maxsize=256)
def _fine_cone(polygon: tuple[tuple[float, float], ...]) -> UnitCone:
    """Return the cone of a patch of three or four corners with fine edges, from facets in closed form."""
    corners = np.array(polygon)
    slip, tipping = slip_facets(corners, FINE_EDGES), tipping_facets(corners)
    facets = np.concatenate([tipping, _distinct(slip)])
    order = _blocks_of_like(facets @ about_point(-ABOVE))
    return UnitCone(facets[order], order < len(tipping))


def merge_close(facets: Array) -> Array:
    """Return the facets without those that repeat another one to within rounding, sorted.

    Args:
        facets: rows (F, d).
    """
    order = np.lexsort(np.round(facets, 6).T)
    facets = facets[order]
    new = np.r_[True, np.abs(np.diff(facets, axis=0)).max(axis=1) > 1e3 * FACET_MERGE]
    return np.asarray(facets[new])


def _by_likeness(facets: Array, indices: Indices) -> Indices:
    """Return the indices (k,) in an order in which similar facets (F, d) are neighbours, by repeated bisection.

    Every part but the last has a power of two of facets, so the blocks of 2^k facets that the polygons bound together
    are such parts.
    """
    if len(indices) <= 2:
        return indices
    part = facets[indices]
    widest = int(np.argmax(part.max(axis=0) - part.min(axis=0)))
    indices = indices[np.argsort(part[:, widest], kind="stable")]
    half = 1 << (len(indices) - 1).bit_length() - 1
    return np.concatenate([_by_likeness(facets, indices[:half]), _by_likeness(facets, indices[half:])])


def _distinct(facets: Array) -> Array:
    """Return facets (F, 6) without those that repeat another one to within rounding."""
    order = np.argsort(facets @ np.sqrt(np.arange(2.0, 8.0)), kind="stable")
    facets = facets[order]
    return np.asarray(facets[np.r_[True, np.abs(np.diff(facets, axis=0)).max(axis=1) > 1e3 * FACET_MERGE]])


def _blocks_of_like(facets: Array, size: int = 16) -> Indices:
    """Return indices of facets (F, d) in an order in which blocks of similar ones follow each other, by bisection."""
    width = size * 2 ** max(0, int(np.ceil(np.log2(len(facets) / size))))
    values = np.full((facets.shape[1], width), FAR)
    values[:, : len(facets)] = facets.T
    order = np.arange(width)
    while width > size:
        parts = values.reshape(len(values), -1, width)
        widest = np.argmax(parts.max(axis=2) - parts.min(axis=2), axis=0)
        key = parts[widest, np.arange(len(widest))]
        halves = (np.argpartition(key, width // 2, axis=1) + np.arange(0, len(order), width)[:, None]).ravel()
        values, order = values[:, halves], order[halves]
        width //= 2
    return order[order < len(facets)]


def patch_cone(polygon: Array, edges: int) -> UnitCone | None:
    """Return the unit cone of a patch, moments about the origin of its plane.

    Args:
        polygon: corners of the patch (n, 2) [m].
        edges: number of edges of each friction cone.

    Returns:
        The cone, or None if it has too many generators, and so thousands of facets, or if its hull cannot be computed.
    """
    unit = tuple(map(tuple, np.round(polygon / _size(polygon), 12).tolist()))
    if edges == FINE_EDGES:
        return _fine_cone(unit)
    return None if len(polygon) * edges > MOST_GENERATORS else _unit_cone(unit, edges)


def tipping_facets(polygon: Array) -> Array:
    """Return the rows that keep a body from tipping over the edges of its patch, scaled as those of `patch_facets`.

    Args:
        polygon: corners of the patch, counter-clockwise about the origin (n, 2) [m].

    Returns:
        Rows (n, 6), moments about the origin of the plane.
    """
    along = np.roll(polygon, -1, axis=0) - polygon
    normal = np.column_stack([along[:, 1], -along[:, 0]])
    normal /= (normal * polygon).sum(axis=1, keepdims=True)
    none, unit = np.zeros(len(polygon)), np.ones(len(polygon))
    return np.column_stack([none, none, -unit, normal[:, 1], -normal[:, 0], none])


def patch_facets(polygon: Array, mu: float, edges: int) -> Array:
    """Return the facets of the wrench cone of a flat patch, moments about the origin of its plane, (F, 6).

    The cone scales exactly with the coefficient of friction, A_mu = A_1 diag(1/mu, 1/mu, 1, 1, 1, 1/mu), and with the
    size of the patch, so one hull serves all (our choice). The origin must lie inside the patch; then every facet
    bounds the normal force from below, and is scaled so that the coefficient of the normal force is -1.

    Args:
        polygon: corners of the patch (n, 2) [m].
        mu: coefficient of friction.
        edges: number of edges of each friction cone.

    Raises:
        QhullError: the convex hull cannot be computed.
    """
    cone = _unit_cone(tuple(map(tuple, np.round(polygon / _size(polygon), 12).tolist())), edges)
    if cone is None:
        raise QhullError("the hull of the friction cone's section cannot be resolved")
    return scaled(cone, polygon, mu)


def _size(polygon: Array) -> float:
    return float(np.abs(polygon).max())


def scaled(cone: UnitCone, polygon: Array, mu: float) -> Array:
    """Return the facets of a unit cone for a coefficient of friction and the size of a patch, (F, 6).

    Args:
        cone: the unit cone.
        polygon: corners of the patch (n, 2) [m].
        mu: coefficient of friction.
    """
    size = _size(polygon)
    return np.asarray(cone.facets / np.array([mu, mu, 1.0, size, size, mu * size]))


def tipping_rows(rows: Array, generators: Array, edges: int) -> Flags:
    """Return whether each row bounds tipping over contact points rather than slip, (F,).

    A row is the power of a motion of the body. If all friction edges of a contact point lie on it, the motion leaves
    that point in place; if only some do, the point slides; otherwise the point lifts off. Tipping is a motion in which
    points lift off and none slides. Everything else, including pivoting, is slip (our choice).

    Args:
        rows: the rows (F, d).
        generators: friction edges (d, k), those of a contact point side by side.
        edges: number of edges of each contact point.
    """
    products = np.abs(rows @ generators)
    flat = products <= 1e-7 * products.max(axis=1, keepdims=True)
    flat = flat.reshape(len(rows), -1, edges)
    stays, touches = flat.all(axis=2), flat.any(axis=2)
    return np.asarray((stays == touches).all(axis=1))
