"""Contact laws: the wrenches that a contact can transmit, and the force that presses it together.

A wrench is extended by the forces F that press the part against the tool: the vacuum of each cup, the closing force of
a gripper. In these coordinates (w, F) every law is a cone {G lambda, lambda >= 0} with rows A (w, F) <= 0:

- friction: the edges of the friction cones, (g, 0); there is no F.
- suction: the edges at the lips, (g, 0), and for each cup its vacuum, (-n, e_k), which pulls the part against the lip.
  Lips with one coefficient of friction have the rows of the friction cone of their hull, A (w + sum_k F_k n_k) <= 0.
  Several cups of a part are one contact with a force each: part and tool are rigid, so their lips share the wrench as
  the points of one lip do.
- grip: the edges of the driven pad, (g, 1), and of the fixed pad, (g, 0): the normal forces of the driven pad sum to F.

If the pressure is prescribed, rows for the twist come on top (see `twist`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import groupby

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from robustopt.arrays import Array, Flags
from robustopt.geometry import convex_hull
from robustopt.limits.cones import (
    FACET_MERGE,
    FACET_TOLERANCE,
    MOST_GENERATORS,
    about_point,
    into_axes,
    merge_close,
    patch_cone,
    scaled,
    tipping_facets,
    wrench_generators,
)
from robustopt.limits.names import LimitKind, LimitName
from robustopt.limits.twist import elastic_rows, grip_rows
from robustopt.scene.patches import Law, Patch, eroded

NO_ROWS, NO_TIPS = np.zeros((0, 6)), np.zeros(0, dtype=bool)


@dataclass(frozen=True, eq=False)
class Link:
    """A contact of an object: a patch, all cups that hold it, or the two pads of a gripper.

    Wrenches act on the object, moments about the carrier's origin, carrier axes. The forces F are the last of the d
    coordinates: none, one per cup, or that of the gripper.

    Attributes:
        patches: the patches.
        generators: edges of the friction cones, then the vacuums if there are any (d, k).
        edges_of_friction: number of the first kind.
        rows: rows of the cone (F, d).
        tips: whether each row bounds tipping or peeling (F,).
        complete: whether the rows describe the whole cone; otherwise they are too many, cannot be resolved, or are
            unknown.
        twist: rows of the twist, if the pressure is prescribed (T, d).
    """

    patches: tuple[Patch, ...]
    generators: Array
    edges_of_friction: int
    rows: Array
    tips: Flags
    complete: bool
    twist: Array

    @property
    def object(self) -> str:
        """Return the object that the contact holds."""
        return self.patches[0].object

    @property
    def forces(self) -> int:
        """Return the number of forces that press the object against the tool."""
        return len(self.generators) - 6

    @property
    def names(self) -> tuple[LimitName, ...]:
        """Return the limits that the contact imposes: for rows that slip, rows that tip, and rows of the twist."""
        patch = self.patches[0]
        place = patch.object, patch.support
        if patch.law is Law.FRICTION:
            kinds = (LimitKind.SLIP, LimitKind.TIPPING, *([LimitKind.TWIST] if patch.fixed else []))
            return tuple(LimitName(kind, *place) for kind in kinds)
        if patch.law is Law.SUCTION:
            return tuple(LimitName(kind, *place) for kind in (LimitKind.SLIP, LimitKind.PEEL, LimitKind.TWIST))
        grip = LimitName(LimitKind.GRIP, patch.object)
        return grip, grip, LimitName(LimitKind.TWIST, *place)


ContactLaw = Callable[[Patch, float, int], Array]
"""A contact law of a user: returns the edges of the cone of the wrenches that a patch can transmit, (6, k).

Its arguments are the patch, its coefficient of friction, and the number of edges of each friction cone; wrenches act on
the object, moments about the carrier's origin, carrier axes; the edges of a contact point stand side by side.
"""


def links(
    patches: Sequence[Patch],
    friction: Mapping[str, float],
    edges: int,
    shift: Mapping[str, float],
    laws: Mapping[str, ContactLaw] | None = None,
) -> tuple[Link, ...]:
    """Return the contacts that some patches form.

    If contact points are uncertain, the cones are those of the eroded patches. The twist needs the nominal ones too,
    because the pressure moves with its points.

    Args:
        patches: the patches; the cups of a part, and the two pads of a gripper, follow each other.
        friction: coefficient of friction of each patch by its name.
        edges: number of edges of each friction cone.
        shift: largest displacement of each contact point along x and y, by contact; 0 if it is missing [m].
        laws: laws of a user, by the name of the contact of an object that stands on its support.
    """
    found, own = [], laws or {}
    for _, group in groupby(patches, lambda patch: (patch.object, patch.support)):
        nominal = tuple(group)
        reach = tuple(shift.get(patch.name, 0.0) for patch in nominal)
        parts = tuple(eroded(patch, distance) for patch, distance in zip(nominal, reach, strict=True))
        first, mu = parts[0], tuple(friction[patch.name] for patch in parts)
        if first.name in own:
            found.append(_users(first, own[first.name](first, mu[0], edges)))
        elif first.law is Law.FRICTION:
            found.append(_friction(first, mu[0], edges, nominal[0], reach[0]))
        elif first.law is Law.SUCTION:
            found.append(_suction(parts, mu, edges, nominal, reach))
        else:
            found.append(_grip(parts, mu, edges, nominal, reach))
    return tuple(found)


@lru_cache(maxsize=256)
def _centred(patch: Patch) -> tuple[Array, Array]:
    """Return the centre of a patch in the carrier frame (3,) and the patch about it, in its plane (n, 2)."""
    middle = patch.polygon.mean(axis=0)
    return patch.origin + patch.axes[:, :2] @ middle, patch.polygon - middle


@lru_cache(maxsize=256)
def _into_patch(patch: Patch) -> Array:
    """Return the matrix (6, 6) that turns wrenches about the carrier's origin into the frame of a patch."""
    centre, _ = _centred(patch)
    return into_axes(patch.axes) @ about_point(centre)


def _rows(patch: Patch, mu: float | None, edges: int) -> tuple[Array, Flags, bool]:
    """Return rows of the friction cone of a patch, whether each of them tips, and whether they are all.

    Those that tip are always among them; `mu` is None if it differs between the points.
    """
    _, local = _centred(patch)
    cone = None if mu is None else patch_cone(local, edges)
    if cone is None or mu is None:
        return tipping_facets(local) @ _into_patch(patch), np.ones(len(local), dtype=bool), False
    return scaled(cone, local, mu) @ _into_patch(patch), cone.tips, True


def _users(patch: Patch, generators: Array) -> Link:
    """Return a contact with the law of a user, for which programs find the rows."""
    return Link((patch,), generators, generators.shape[1], NO_ROWS, NO_TIPS, False, NO_ROWS)


def _friction(patch: Patch, mu: float, edges: int, nominal: Patch, reach: float) -> Link:
    """Return the contact of an object with its support; `patch` is the eroded one."""
    generators, twist = wrench_generators(patch.points, mu, edges, patch.axes), NO_ROWS
    if patch.fixed:
        twist = _elastic(patch, (nominal,), (mu,), edges, (reach,))[:, :6]
    return Link((patch,), generators, generators.shape[1], *_rows(patch, mu, edges), twist)


def _elastic(
    whole: Patch, nominal: tuple[Patch, ...], mu: tuple[float, ...], edges: int, reach: tuple[float, ...]
) -> Array:
    """Return the twist rows of patches in the plane of `whole`, over the wrench and a vacuum at each patch."""
    centre, _ = _centred(whole)
    local = [(patch.points - centre) @ whole.axes[:, :2] for patch in nominal]
    # points move in squares along the axes of the support; those along the axes of the patch around them are larger
    around = abs(np.cos(whole.turn)) + abs(np.sin(whole.turn))
    return _extended(elastic_rows(local, mu, edges, [around * distance for distance in reach]), _into_patch(whole))


def _suction(
    lips: tuple[Patch, ...], mu: tuple[float, ...], edges: int, nominal: tuple[Patch, ...], reach: tuple[float, ...]
) -> Link:
    """Return the contact of all cups of a part, whose lips lie in one plane; `lips` are the eroded ones."""
    cones = [wrench_generators(lip.points, own, edges, lip.axes) for lip, own in zip(lips, mu, strict=True)]
    normal = lips[0].axes[:, 2]
    press = np.array([[*normal, *np.cross(_centred(lip)[0], normal)] for lip in lips]).T
    generators = np.block(
        [[*cones, -press], [np.zeros((len(lips), sum(cone.shape[1] for cone in cones))), np.eye(len(lips))]]
    )
    whole = _hull(lips)
    rows, tips, complete = _rows(whole, mu[0] if len(set(mu)) == 1 else None, edges)
    rows = np.column_stack([rows, rows @ press])
    twist = np.zeros((0, 6 + len(lips)))
    if whole.fixed:
        twist = _elastic(whole, nominal, mu, edges, reach)
    return Link(lips, generators, generators.shape[1] - len(lips), rows, tips, complete, twist)


@lru_cache(maxsize=64)
def _hull(lips: tuple[Patch, ...]) -> Patch:
    """Return the patch whose corners are the convex hull of some lips: forces elsewhere are combinations of those."""
    if len(lips) == 1:
        return lips[0]
    first = lips[0]
    corners = convex_hull(np.vstack([(lip.points - first.origin) @ first.axes[:, :2] for lip in lips]))
    corners.setflags(write=False)
    return replace(first, polygon=corners)


def _extended(rows: Array, into: Array) -> Array:
    """Return rows over a local wrench and F (k, d) as rows over the wrench that `into` (6, 6) turns into it, and F."""
    return np.column_stack([rows[:, :6] @ into, rows[:, 6:]])


def _grip(
    pads: tuple[Patch, ...], mu: tuple[float, ...], edges: int, nominal: tuple[Patch, ...], reach: tuple[float, ...]
) -> Link:
    """Return the contact of two pads, of which `pads` are the eroded ones."""
    driven, fixed = pads
    sides = [wrench_generators(patch.points, m, edges, patch.axes) for patch, m in zip(pads, mu, strict=True)]
    closing = np.repeat([1.0, 0.0], [side.shape[1] for side in sides])
    generators = np.vstack([np.hstack(sides), closing])
    centre, _ = _centred(fixed)
    facets = _grip_facets(driven, fixed, mu, edges)
    rows = np.zeros((0, 7)) if facets is None else facets
    twist = np.zeros((0, 7))
    if driven.fixed:
        opposite, local = ((pad.points - centre) @ fixed.axes[:, :2] for pad in nominal)
        twist = _extended(grip_rows(opposite, local, mu, edges, reach), _into_patch(fixed))
    tips = np.zeros(len(rows), dtype=bool)
    return Link(pads, generators, generators.shape[1], rows, tips, facets is not None, twist)


@lru_cache(maxsize=64)
def _grip_facets(driven: Patch, fixed: Patch, mu: tuple[float, ...], edges: int) -> Array | None:
    """Return the facets of the cone of two opposed pads in (w, F), scaled to -1 at equal forces along all generators.

    With n the normal of the fixed pad, all generators have 2 F + n f = 1, which makes a section of the cone.
    """
    corners = len(driven.polygon) + len(fixed.polygon)
    if corners * edges > MOST_GENERATORS:
        return None
    into = _into_patch(fixed)
    parts = [
        into @ wrench_generators(patch.points, m, edges, patch.axes)
        for patch, m in zip((driven, fixed), mu, strict=True)
    ]
    section = np.vstack([np.hstack(parts)[[0, 1, 3, 4, 5]], np.repeat([1.0, 0.0], [part.shape[1] for part in parts])]).T
    middle = section.mean(axis=0)
    size = np.abs(section - middle).max(axis=0)
    try:
        equations = ConvexHull((section - middle) / size).equations
    except QhullError:
        return None
    normals = equations[:, :6] / size
    offset = equations[:, 6] - normals @ middle  # normals @ section + offset (2 F + n f) <= 0
    rows = np.column_stack([normals[:, :2], offset, normals[:, 2:5], normals[:, 5] + 2.0 * offset])
    rows /= -(rows @ _at_rest(section))[:, None]
    rows = merge_close(rows[np.sort(np.unique(np.round(rows / FACET_MERGE), axis=0, return_index=True)[1])])
    outside = np.column_stack([section[:, :2], 1.0 - 2.0 * section[:, 5], section[:, 2:]]) @ rows.T
    return None if outside.max() > FACET_TOLERANCE else _extended(rows, into)


def _at_rest(section: Array) -> Array:
    """Return (w, F) of equal forces along all generators per unit of F, for a section without n f."""
    mean = section.mean(axis=0)
    return np.asarray(np.array([*mean[:2], 1.0 - 2.0 * mean[5], *mean[2:]]) / mean[5])
