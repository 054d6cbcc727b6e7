"""Convex polygons in the tray plane, and where the objects of a configuration stand.

A polygon is an array of its corners, shape (n, 2), counter-clockwise, [m]; an empty one has shape (0, 2).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from robustopt.config.model import Config, ObjectConfig, RailConfig
from robustopt.errors import ConfigError

Array = NDArray[np.float64]

RESOLUTION = 1e-9
"""Lengths below a nanometre count as zero: far above rounding errors, far below any real object."""


# Polygons -------------------------------------------------------------------------------------------------


def rectangle(center: Array, size: Array, yaw: float = 0.0) -> Array:
    """Rectangle of edge lengths `size` (2,) about `center` (2,), turned by `yaw` [rad], shape (4, 2)."""
    corners = 0.5 * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]]) * np.asarray(size)[:2]
    return np.asarray(center)[:2] + corners @ rotation(yaw).T


def regular_polygon(center: Array, radius: float, points: int, yaw: float = 0.0) -> Array:
    """Regular polygon inscribed in a circle, first corner at angle `yaw` [rad], shape (points, 2)."""
    angle = yaw + 2.0 * np.pi * np.arange(points) / points
    return np.asarray(center)[:2] + radius * np.column_stack([np.cos(angle), np.sin(angle)])


def rotation(yaw: float) -> Array:
    """Rotation matrix in the plane, shape (2, 2)."""
    c, s = np.cos(yaw), np.sin(yaw)
    matrix: Array = np.array([[c, -s], [s, c]])
    return matrix


def half_planes(polygon: Array) -> tuple[Array, Array]:
    """Outward unit normals n, shape (n, 2), and offsets h, shape (n,): the polygon is {p: n p <= h}."""
    edge = np.roll(polygon, -1, axis=0) - polygon
    normal = np.column_stack([edge[:, 1], -edge[:, 0]])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    return normal, np.einsum("ij,ij->i", normal, polygon)


def area(polygon: Array) -> float:
    """Area of a polygon [m^2], by the shoelace formula; 0 for an empty one."""
    x, y = polygon[:, 0], polygon[:, 1]
    return 0.5 * float(x @ np.roll(y, -1) - y @ np.roll(x, -1))


def clip(polygon: Array, other: Array) -> Array:
    """Intersection of two convex polygons, shape (n, 2); empty where they do not overlap."""
    return _cut(polygon, *half_planes(other))


def erode(polygon: Array, distance: float, yaw: float = 0.0) -> Array:
    """What is left of a polygon when each of its corners may be `distance` off along x and y.

    {p: p + d in polygon for every d in the square [-distance, distance]^2 turned by `yaw`}: each edge n p <= h
    moves inwards by the square's reach along n, distance (|n_x| + |n_y|) in the square's own axes. Every point
    of the result is inside the hull of the corners wherever in their squares they are (separating line).
    """
    normal, offset = half_planes(polygon)
    reach = distance * np.abs(normal @ rotation(yaw)).sum(axis=1)
    return _cut(polygon, normal, offset - reach)


def contains(polygon: Array, point: Array, tolerance: float = RESOLUTION) -> bool:
    """Whether a point is inside a convex polygon, or at most `tolerance` [m] outside one of its edges."""
    if len(polygon) < 3:
        return False
    normal, offset = half_planes(polygon)
    return bool(np.all(normal @ np.asarray(point)[:2] <= offset + tolerance))


def convex_hull(points: Array) -> Array:
    """Corners of the convex hull of points in the plane (n, 2), by Andrew's monotone chain."""
    ordered = sorted(map(tuple, points))

    def chain(sequence: list[tuple[float, ...]]) -> list[tuple[float, ...]]:
        corners: list[tuple[float, ...]] = []
        for p in sequence:
            while len(corners) > 1 and _turn(corners[-2], corners[-1], p) <= RESOLUTION**2:
                corners.pop()
            corners.append(p)
        return corners[:-1]

    return np.array(chain(ordered) + chain(ordered[::-1])).reshape(-1, 2)


def _turn(a: tuple[float, ...], b: tuple[float, ...], c: tuple[float, ...]) -> float:
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


def _cut(polygon: Array, normal: Array, offset: Array) -> Array:
    """The part of a convex polygon in all half-planes n p <= h (Sutherland and Hodgman)."""
    for n, h in zip(normal, offset, strict=True):
        depth = polygon @ n - h
        inside = depth <= RESOLUTION
        if inside.all():
            continue
        corners = []
        for i, p in enumerate(polygon):
            j = (i + 1) % len(polygon)
            if inside[i]:
                corners.append(p)
            if inside[i] != inside[j]:
                corners.append(p + depth[i] / (depth[i] - depth[j]) * (polygon[j] - p))
        polygon = _without_repetitions(np.array(corners).reshape(-1, 2))
        if len(polygon) < 3:
            return np.empty((0, 2))
    return polygon if area(polygon) > RESOLUTION**2 else np.empty((0, 2))


def _without_repetitions(polygon: Array) -> Array:
    step = np.linalg.norm(polygon - np.roll(polygon, 1, axis=0), axis=1)
    return np.asarray(polygon[step > RESOLUTION])


def common_direction(normals: Sequence[Array], friction: Sequence[float]) -> Array | None:
    """A unit vector (3,) that all forces in the friction cones of some contacts have a positive part along, or None.

    normals: of the contacts, (3,) each, not more than two different ones; friction: coefficient of each. A direction at
    an angle a from a normal is such for its cone if a + atan(mu) < 90 degrees; between two normals the middle of what
    both allow is taken. Without one, contacts could press against each other with any force (our choice).
    """
    first, cones = normals[0], np.arctan(friction)
    angles = np.arccos(np.clip(np.array(normals) @ first, -1.0, 1.0))
    angle, other = float(angles.max()), normals[int(np.argmax(angles))]
    if angle < 1e-6:
        return first
    here = angles < 0.5 * angle
    low = max(0.0, angle + float(cones[~here].max()) - 0.5 * np.pi)
    high = min(angle, 0.5 * np.pi - float(cones[here].max()))
    if low >= high or angle > np.pi - 1e-6:
        return None
    across = other - np.cos(angle) * first
    middle = 0.5 * (low + high)
    return np.asarray(np.cos(middle) * first + np.sin(middle) * across / np.linalg.norm(across))


def contact_axes(normal: Sequence[float] | Array, along: Sequence[float] | Array) -> Array:
    """Axes of a contact as columns (3, 3): z is its normal, x what of a direction is at a right angle to that.

    The vectors may have any length, but must not be parallel.
    """
    z = np.asarray(normal, dtype=float) / np.linalg.norm(normal)
    x = np.asarray(along, dtype=float) - (np.asarray(along) @ z) * z
    x /= np.linalg.norm(x)
    return np.column_stack([x, np.cross(z, x), z])


RAIL_EDGE, RAIL_HEIGHT = 0.01, 0.02
"""A rail is this much wider than the palm on each side, and this high [m]."""


def rail_box(rail: RailConfig) -> tuple[Array, Array, Array]:
    """A rail as a box: its middle (3,) [m], axes as columns (3, 3) and half its edge lengths (3,) [m]."""
    axes = contact_axes(rail.normal, rail.along)
    half = 0.5 * np.array([rail.length, rail.size[1] + 2.0 * RAIL_EDGE, RAIL_HEIGHT])
    return np.array(rail.at) - half[2] * axes[:, 2], axes, half


# Where the objects stand ----------------------------------------------------------------------------------


@dataclass(frozen=True)
class Placement:
    """An object upright on the tray: `position` of its centre in the tray frame (3,) [m], its `yaw` [rad]."""

    position: Array
    yaw: float
    half_height: float


@dataclass(frozen=True, eq=False)
class Patch:
    """Overlap of an object's base with the upper face of what it stands on.

    `polygon`: tray frame, shape (k, 2), counter-clockwise [m]; `z`: its height in the tray frame [m];
    `yaw`: turn of the supporting body against the tray [rad].
    """

    object: str
    support: str
    polygon: Array
    z: float
    yaw: float


def supports(body: ObjectConfig) -> tuple[str, ...]:
    """Names of what an object stands on: one, or two for a bridge."""
    return (body.on,) if isinstance(body.on, str) else body.on


def half_height(body: ObjectConfig) -> float:
    """Half the vertical extent of an object [m]."""
    height = body.size[2] if body.size is not None else body.height
    assert height is not None, "checked when the configuration was read"
    return 0.5 * height


def standing_order(objects: Mapping[str, ObjectConfig]) -> tuple[str, ...]:
    """Names of the objects, each after what it stands on; ConfigError where there is no such order."""
    order: list[str] = []
    while len(order) < len(objects):
        placed = {"tray", *order}
        ready = [name for name, body in objects.items() if name not in placed and placed.issuperset(supports(body))]
        if not ready:
            left = ", ".join(name for name in objects if name not in placed)
            raise ConfigError(f"{left}: what they stand on does not lead to the tray", key="objects")
        order += ready
    return tuple(order)


Solids = tuple[tuple[str, ObjectConfig], ...]


def solids(config: Config) -> Solids:
    """Names and shapes of the objects, without what does not matter for where they stand."""
    return tuple((name, _without_mass(body)) for name, body in config.objects.items())


@lru_cache(maxsize=64)
def _without_mass(body: ObjectConfig) -> ObjectConfig:
    return body.model_copy(update={"mass": 1.0, "center_of_mass": (0.0, 0.0, 0.0), "inertia": None})


def placements(config: Config) -> dict[str, Placement]:
    """Where each object stands, by name; supports come before what stands on them."""
    return dict(_placements(config.carried_tray.size, solids(config)))


@lru_cache(maxsize=64)
def _placements(tray_size: tuple[float, float, float], solids: Solids) -> dict[str, Placement]:
    tray = Placement(position=np.zeros(3), yaw=0.0, half_height=0.5 * tray_size[2])
    placed, objects = {"tray": tray}, dict(solids)
    for name in standing_order(objects):
        body = objects[name]
        below = [placed[support] for support in supports(body)]
        frame = below[0] if len(below) == 1 else tray
        top = below[0].position[2] + below[0].half_height
        base = frame.position[:2] + rotation(frame.yaw) @ np.array(body.at)
        h = half_height(body)
        position = np.array([*base, top + h])
        position.setflags(write=False)
        placed[name] = Placement(position=position, yaw=frame.yaw + body.yaw, half_height=h)
    del placed["tray"]
    return placed


def footprint(body: ObjectConfig, placement: Placement, points: int) -> Array:
    """Outline of an object seen from above, tray frame, shape (k, 2); a round one has `points` corners."""
    if body.size is not None:
        return rectangle(placement.position, np.array(body.size), placement.yaw)
    assert body.radius is not None, "checked when the configuration was read"
    return regular_polygon(placement.position, body.radius, points, placement.yaw)


def patches(config: Config) -> tuple[Patch, ...]:
    """Contact patch of every interface, in the order of `placements`; a bridge has two."""
    return _patches(config.carried_tray.size, solids(config), config.contact.patch_points)


@lru_cache(maxsize=64)
def _patches(tray_size: tuple[float, float, float], solids: Solids, points: int) -> tuple[Patch, ...]:
    objects = dict(solids)
    faces = {"tray": rectangle(np.zeros(2), np.array(tray_size))}
    yaws = {"tray": 0.0}
    found = []
    for name, placement in _placements(tray_size, solids).items():
        body = objects[name]
        faces[name] = footprint(body, placement, points)
        yaws[name] = placement.yaw
        z = float(placement.position[2]) - placement.half_height
        for support in supports(body):
            polygon = clip(faces[name], faces[support])
            polygon.setflags(write=False)
            found.append(Patch(name, support, polygon, z, yaws[support]))
    return tuple(found)


@lru_cache(maxsize=256)
def eroded(patch: Patch, distance: float) -> Array:
    """What is left of a patch when each of its corners may be `distance` off along x and y of the supporting body."""
    polygon = erode(patch.polygon, distance, patch.yaw) if distance > 0 else patch.polygon
    polygon.setflags(write=False)
    return polygon


@lru_cache(maxsize=64)
def base_outline(patches: tuple[Patch, ...]) -> Array:
    """Convex hull of contact patches, shape (k, 2)."""
    return convex_hull(np.vstack([patch.polygon for patch in patches]))


@lru_cache(maxsize=64)
def overlaps(tray_size: tuple[float, float, float], solids: Solids, points: int) -> tuple[tuple[str, str], ...]:
    """Pairs of objects that are in each other; `points` corners for the outline of a round one."""
    objects, placed = dict(solids), _placements(tray_size, solids)
    outline = {name: footprint(objects[name], place, points) for name, place in placed.items()}
    found = []
    for first, second in combinations(placed, 2):
        a, b = placed[first], placed[second]
        overlap = a.half_height + b.half_height - abs(a.position[2] - b.position[2])
        if overlap > RESOLUTION and area(clip(outline[first], outline[second])) > 0:
            found.append((first, second))
    return tuple(found)
