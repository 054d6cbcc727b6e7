"""Contact: which forces can hold an object in place, and which wrench they must transmit.

Everything is expressed in the axes of the tray frame, moments about one point per balanced object. A `ContactSystem`
is a set of objects whose contact forces must be found together: the required wrenches of its objects, stacked, must
lie in the cone of its generators. An object on one support is a system of its own, because everything above it loads
that one interface, and then the cone has explicit facets. A bridge shares its load between its supports, which is
statically indeterminate, so the bridge and its supports form one system without facets.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from robustopt.config import Config
from robustopt.scene.patches import Patch, eroded, patches
from robustopt.scene.placement import supports

Array = np.ndarray

MOST_GENERATORS = 128
"""Edges of all friction cones of a patch up to which its facets are made: 588 for a rectangle at 16 edges, 1976 for a
round patch of 8 points; at 192 generators there are 5556."""

FACET_TOLERANCE = 1e-8
"""Part of the normal force by which a facet may cut off a generator; the hull code merges facets to about 1e-12."""

FACET_MERGE = 1e-9
"""Facets whose unit normals agree to this are one facet that the hull code has triangulated."""

ABOVE = np.array([0.0, 0.0, 1.0])
"""Point above a patch of unit size that the moments are about when facets are compared, nearer to where centres of mass
are: in blocks of facets that are alike there, a third fewer may bind than in those alike about the patch's origin."""


@dataclass(frozen=True)
class ContactSystem:
    """Objects whose contact forces must be found together.

    objects: the balanced objects; their wrenches are stacked, d = 6 * len(objects)
    loads: per balanced object the bodies whose weight and inertia it must carry, itself included
    points: per balanced object the point its moments are about, tray frame (3,) [m]
    generators: contact wrenches of the edges of all friction cones, shape (d, k); what the supports can exert is the
        cone of the columns
    facets: the same cone as facets @ w <= 0, shape (F, d), or None where only the generators are used
    kinds: which of the names each facet belongs to, (F,)
    names: of the limits the system imposes: (slip, tipping) of one interface, or (balance,) of a bridge
    edges: friction edges per contact point, which are neighbouring columns of the generators
    interfaces: contacts by the names that the configuration has for their friction
    """

    objects: tuple[str, ...]
    loads: tuple[tuple[str, ...], ...]
    points: tuple[Array, ...]
    generators: Array
    facets: Array | None
    kinds: Array
    names: tuple[str, ...]
    edges: int
    interfaces: tuple[str, ...]

    @property
    def dimension(self) -> int:
        return 6 * len(self.objects)

    @property
    def interior(self) -> Array:
        """A wrench well inside the cone: equal forces along all generators, of unit mean, shape (d,)."""
        return self.generators.mean(axis=1)

    def about(self, points: Sequence[Array]) -> ContactSystem:
        """The same system with the moments of each balanced object about another point (3,)."""
        moved, facets = self.generators.copy(), None if self.facets is None else self.facets.copy()
        for k, (new, old) in enumerate(zip(points, self.points, strict=True)):
            block = slice(6 * k, 6 * k + 6)
            moved[block] = about_point(new - old) @ moved[block]
            if facets is not None:
                facets[:, block] = facets[:, block] @ about_point(old - new)
        return replace(self, points=tuple(points), generators=moved, facets=facets)

    def kind_of(self, rows: Array) -> Array:
        """Which of the system's names facets or duals (F, d) belong to, shape (F,)."""
        if len(self.names) == 1 or not len(rows):
            return np.zeros(len(rows), dtype=np.int64)
        return tips(rows, self.generators, self.edges).astype(np.int64)


def skew(vector: Array) -> Array:
    """Matrix of the cross product: skew(a) @ b = a x b, shape (3, 3)."""
    x, y, z = vector
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def about_point(point: Array) -> Array:
    """Matrix that takes a wrench about the origin to one about `point`, shape (6, 6)."""
    transform, (x, y, z) = np.eye(6), point
    transform[3, 1], transform[3, 2], transform[4, 0] = z, -y, -z
    transform[4, 2], transform[5, 0], transform[5, 1] = x, y, -x
    return transform


def friction_edges(mu: float, edges: int) -> Array:
    """Unit-normal edges of the friction cone's inner approximation, first edge along x, shape (edges, 3)."""
    angle = 2 * np.pi * np.arange(edges) / edges
    return np.array([mu * np.cos(angle), mu * np.sin(angle), np.ones(edges)]).T


def wrench_generators(points: Array, mu: float, edges: int, axes: Array | None = None) -> Array:
    """Wrenches about the origin of edge forces at `points` (n, 3), shape (6, n * edges).

    axes: of the contact as columns (3, 3), its normal last; those of the points without
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
    """The wrench cone of a flat patch at mu = 1, moments about the patch's origin.

    facets: (F, 6), each scaled to -1 of the normal force, so that its value is a fraction of that, like next to like;
    kinds: which of slip (0) and tipping (1) each bounds, (F,)
    """

    facets: Array
    kinds: Array


@lru_cache(maxsize=256)
def _unit_cone(polygon: tuple[tuple[float, float], ...], edges: int) -> UnitCone | None:
    """The cone of a patch, or None where the hull code gives up or gives facets that cut off a generator.

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
    facets = _merge_close(facets[np.sort(first)])
    facets /= -facets[:, 2:3]
    facets = facets[_by_likeness(facets @ about_point(-ABOVE), np.arange(len(facets)))]
    outside = (facets @ generators).max()
    return None if outside > FACET_TOLERANCE else UnitCone(facets, tips(facets, generators, edges).astype(np.int64))


def _merge_close(facets: Array) -> Array:
    """Drop facets that repeat an earlier one to within rounding."""
    order = np.lexsort(np.round(facets, 6).T)
    facets = facets[order]
    new = np.r_[True, np.abs(np.diff(facets, axis=0)).max(axis=1) > 1e3 * FACET_MERGE]
    return facets[new]


def _by_likeness(facets: Array, indices: Array) -> Array:
    """The indices (k,) in an order in which facets (F, d) that are alike are neighbours: cut in two, again and again.

    Each half but the last has a power of two, so the blocks of 2^k that the polygons bound together are such parts.
    """
    if len(indices) <= 2:
        return indices
    part = facets[indices]
    widest = int(np.argmax(part.max(axis=0) - part.min(axis=0)))
    indices = indices[np.argsort(part[:, widest], kind="stable")]
    half = 1 << (len(indices) - 1).bit_length() - 1
    return np.concatenate([_by_likeness(facets, indices[:half]), _by_likeness(facets, indices[half:])])


def patch_facets(polygon: Array, mu: float, edges: int) -> Array:
    """Facets of the wrench cone of a flat patch, moments about the origin of its plane, shape (F, 6).

    polygon: vertices (n, 2) [m]. The cone scales exactly with the coefficient of friction,
    A_mu = A_1 diag(1/mu, 1/mu, 1, 1, 1, 1/mu), and with the size of the patch, so one hull serves all. The origin must
    lie inside the patch; then every facet bounds the normal force from below, and is scaled to a coefficient -1 of it,
    so that a row's value is a fraction of the normal force. Raises QhullError where the hull code fails.
    """
    cone = _cone(polygon, edges)
    if cone is None:
        raise QhullError("the hull of the friction cone's section cannot be resolved")
    return _scaled(cone, polygon, mu)


def _size(polygon: Array) -> float:
    return float(np.abs(polygon).max())


def _cone(polygon: Array, edges: int) -> UnitCone | None:
    """The unit cone of a patch of unit size."""
    return _unit_cone(tuple(map(tuple, np.round(polygon / _size(polygon), 12).tolist())), edges)


def _scaled(cone: UnitCone, polygon: Array, mu: float) -> Array:
    """The facets of a unit cone for a coefficient of friction and the size of a patch."""
    size = _size(polygon)
    return cone.facets / np.array([mu, mu, 1.0, size, size, mu * size])


def tips(rows: Array, generators: Array, edges: int) -> Array:
    """Which rows (F, d) are tipping over contact points whose friction edges are neighbouring generators (d, k), (F,).

    A row is the power of a motion of the body. Where all friction edges of a contact point lie on it, the motion
    leaves that point where it is; where only some do, the point slides; the others lift off. A motion that lets
    points lift off around such that stay, and none slide, is tipping; everything else is slip, pivoting included.
    """
    products = np.abs(rows @ generators)
    flat = products <= 1e-7 * products.max(axis=1, keepdims=True)
    flat = flat.reshape(len(rows), -1, edges)
    stays, touches = flat.all(axis=2), flat.any(axis=2)
    tips: Array = stays.any(axis=1) & (stays == touches).all(axis=1)
    return tips


def contact_systems(
    config: Config, friction: Mapping[str, float], shift: Mapping[str, float]
) -> tuple[ContactSystem, ...]:
    """Contact systems of a scene.

    friction: coefficient of friction of the interface under each object
    shift: how far each contact point under an object may lie from its place along x and y [m]. The patch is eroded
        by that square: every displaced patch contains the eroded one, which for a rectangle is itself a
        displaced patch, so the bound is sound, and exact for rectangles (our choice).
    """
    left = tuple(eroded(patch, shift.get(patch.object, 0.0)) for patch in patches(config))
    return tuple(_system(config, group, left, friction) for group in _groups(config))


def carried(config: Config, name: str) -> tuple[str, ...]:
    """The object and everything that stands on it, directly or not, in the config's order."""
    above = {name}
    while True:
        more = {other for other in config.objects if above & set(supports(config.objects[other]))} | above
        if more == above:
            return tuple(other for other in config.objects if other in above)
        above = more


def _is_determinate(config: Config, name: str) -> bool:
    """Whether all that an object carries rests on the tray through this object's one support alone."""
    if len(supports(config.objects[name])) > 1:
        return False
    above = set(carried(config, name))
    return all(set(supports(config.objects[other])) <= above for other in above - {name})


def _groups(config: Config) -> list[tuple[str, ...]]:
    """Objects whose contact forces must be found together: one each, or all that a bridge couples."""
    determinate = [name for name in config.objects if _is_determinate(config, name)]
    groups: list[set[str]] = []
    for name in config.objects:
        if name in determinate:
            continue
        linked = {name} | {
            other for other in supports(config.objects[name]) if other in config.objects and other not in determinate
        }
        touching = [group for group in groups if group & linked]
        groups = [group for group in groups if not group & linked] + [linked.union(*touching)]
    indeterminate = [tuple(name for name in config.objects if name in group) for group in groups]
    return [(name,) for name in determinate] + indeterminate


def _system(
    config: Config, group: tuple[str, ...], all_patches: tuple[Patch, ...], friction: Mapping[str, float]
) -> ContactSystem:
    edges = config.contact.cone_edges
    own = [patch for patch in all_patches if patch.object in group]
    blocks = []
    for patch in own:
        generators = wrench_generators(_corners(patch), friction[patch.object], edges)
        column = np.zeros((6 * len(group), generators.shape[1]))
        row = 6 * group.index(patch.object)
        column[row : row + 6] = generators
        if patch.support in group:
            row = 6 * group.index(patch.support)
            column[row : row + 6] = -generators
        blocks.append(column)
    bridges = [name for name in group if len(supports(config.objects[name])) > 1]
    balance = " and ".join(f"balance of {name} on {' and '.join(supports(config.objects[name]))}" for name in bridges)
    facets = _facets(own[0], friction[own[0].object], edges) if len(own) == 1 else None
    interface = [f"slip of {own[0].object} on {own[0].support}", f"tipping of {own[0].object} over {own[0].support}"]
    return ContactSystem(
        objects=group,
        loads=tuple(_load(config, name, group) for name in group),
        points=tuple(np.zeros(3) for _ in group),
        generators=np.hstack(blocks),
        facets=None if facets is None else facets[0],
        kinds=np.zeros(0, dtype=np.int64) if facets is None else facets[1],
        names=(balance,) if bridges else tuple(interface),
        edges=edges,
        interfaces=group,
    )


def _load(config: Config, name: str, group: tuple[str, ...]) -> tuple[str, ...]:
    """The bodies that one object of a group carries, apart from those that the group balances by themselves."""
    if len(group) == 1:
        return carried(config, name)
    direct = [other for other in config.objects if supports(config.objects[other]) == (name,) and other not in group]
    above = {body for other in direct for body in carried(config, other)}
    return tuple(body for body in config.objects if body == name or body in above)


def _corners(patch: Patch) -> Array:
    return patch.points


def _facets(patch: Patch, mu: float, edges: int) -> tuple[Array, Array] | None:
    """Facets of one interface about the tray's origin, (F, 6), and their kinds (F,).

    None where the force-level program is the better way: for cones of many generators, whose facets are thousands, and
    where the hull code gives up on a section whose symmetry it cannot resolve, or its facets cut off a generator.
    """
    if len(patch.polygon) * edges > MOST_GENERATORS:
        return None
    centre, local, cone = _local_cone(patch, edges)
    return None if cone is None else (_scaled(cone, local, mu) @ about_point(centre), cone.kinds)


@lru_cache(maxsize=256)
def _local_cone(patch: Patch, edges: int) -> tuple[Array, Array, UnitCone | None]:
    """Centre of a patch (3,) in the tray frame, the patch about it (n, 2), and its unit cone."""
    centre = np.append(patch.polygon.mean(axis=0), patch.origin[2])
    local = patch.polygon - centre[:2]
    return centre, local, _cone(local, edges)
