"""Convex polygons in a plane, and axes of contacts.

A polygon is an array of its corners, shape (n, 2), counter-clockwise, [m]; an empty one has shape (0, 2).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from robustopt.arrays import Array

RESOLUTION = 1e-9
"""Lengths below a nanometre count as zero: far above rounding errors, far below any real object."""

PARALLEL = 1e-6
"""Sine of the angle below which two edges count as parallel: the sides' normals then separate them as well."""


def rectangle(center: Array, size: Array, yaw: float = 0.0) -> Array:
    """Return the corners of a rectangle, counter-clockwise, (4, 2) [m].

    Args:
        center: centre of the rectangle, (2,) or longer; only x and y are used [m].
        size: edge lengths along x and y, (2,) or longer [m].
        yaw: rotation of the rectangle about its centre [rad].
    """
    corners = 0.5 * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]]) * np.asarray(size)[:2]
    return np.asarray(center)[:2] + corners @ rotation(yaw).T


def regular_polygon(center: Array, radius: float, points: int, yaw: float = 0.0) -> Array:
    """Return the corners of a regular polygon inscribed in a circle, counter-clockwise, (points, 2) [m].

    Args:
        center: centre of the circle, (2,) or longer; only x and y are used [m].
        radius: radius of the circle [m].
        points: number of corners.
        yaw: angle of the first corner from the x axis [rad].
    """
    angle = yaw + 2.0 * np.pi * np.arange(points) / points
    return np.asarray(center)[:2] + radius * np.column_stack([np.cos(angle), np.sin(angle)])


def rotation(yaw: float) -> Array:
    """Return the rotation matrix in the plane, (2, 2).

    Args:
        yaw: angle of the rotation, counter-clockwise [rad].
    """
    c, s = np.cos(yaw), np.sin(yaw)
    matrix: Array = np.array([[c, -s], [s, c]])
    return matrix


def half_planes(polygon: Array) -> tuple[Array, Array]:
    """Return outward unit normals n (n, 2) and offsets h (n,) [m] of the edges; the polygon is {p: n p <= h}."""
    edge = np.roll(polygon, -1, axis=0) - polygon
    normal = np.column_stack([edge[:, 1], -edge[:, 0]])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    return normal, np.einsum("ij,ij->i", normal, polygon)


def area(polygon: Array) -> float:
    """Return the area of a polygon by the shoelace formula [m^2]; 0 for an empty polygon.

    Args:
        polygon: corners (n, 2) [m].
    """
    x, y = polygon[:, 0], polygon[:, 1]
    return 0.5 * float(x @ np.roll(y, -1) - y @ np.roll(x, -1))


def clip(polygon: Array, other: Array) -> Array:
    """Return the intersection of two convex polygons.

    Args:
        polygon: corners of the first polygon (n, 2) [m].
        other: corners of the second polygon (m, 2) [m].

    Returns:
        Corners (k, 2) [m]; empty if the polygons do not overlap.
    """
    return _cut(polygon, *half_planes(other))


def erode(polygon: Array, distance: float, yaw: float = 0.0) -> Array:
    """Return the part of a polygon that is certain when each of its corners may be displaced along x and y.

    The certain part is {p: p + d in polygon for every d in the square [-distance, distance]^2 rotated by `yaw`}. Each
    edge n p <= h moves inwards by the extent of the square along n, distance (|n_x| + |n_y|) in the axes of the square.
    Every point of the result lies in the convex hull of the displaced corners, by the separating-line theorem (our
    choice).

    Args:
        polygon: corners (n, 2) [m].
        distance: largest displacement of each corner along x and along y [m].
        yaw: rotation of these axes [rad].

    Returns:
        Corners (k, 2) [m]; empty if no part is certain.
    """
    normal, offset = half_planes(polygon)
    reach = distance * np.abs(normal @ rotation(yaw)).sum(axis=1)
    return _cut(polygon, normal, offset - reach)


def contains(polygon: Array, point: Array, tolerance: float = RESOLUTION) -> bool:
    """Return whether a point lies in a convex polygon.

    Args:
        polygon: corners (n, 2) [m]; a polygon with fewer than three contains nothing.
        point: the point, (2,) or longer; only x and y are used [m].
        tolerance: largest distance outside an edge that still counts as inside [m].
    """
    if len(polygon) < 3:
        return False
    normal, offset = half_planes(polygon)
    return bool(np.all(normal @ np.asarray(point)[:2] <= offset + tolerance))


def prism(outline: Array, half_height: float) -> Array:
    """Return the corners of a prism about the origin, those of the base first, (2 k, 3) [m].

    Args:
        outline: corners of the convex base, (k, 2) [m].
        half_height: half the extent along z [m].
    """
    flat = np.ones(len(outline)) * half_height
    return np.vstack([np.column_stack([outline, -flat]), np.column_stack([outline, flat])])


def apart(first: Array, second: Array) -> bool:
    """Return whether two convex prisms do not overlap, by the theorem of the separating axis.

    Args:
        first: corners of the one prism as of `prism`, in any common frame, (2 k, 3) [m].
        second: corners of the other prism (2 m, 3) [m].
    """
    edges, axes = [], []
    for corners in (first, second):
        base, top = np.split(corners, 2)
        sides, upright = np.roll(base, -1, axis=0) - base, top[0] - base[0]
        edges.append(np.vstack([sides, upright]))
        axes += [upright[None], np.cross(sides, upright)]
    edges = [edge / np.linalg.norm(edge, axis=1, keepdims=True) for edge in edges]
    crossed = np.cross(edges[0][:, None], edges[1][None]).reshape(-1, 3)
    axes.append(crossed[np.linalg.norm(crossed, axis=1) > PARALLEL])
    directions = np.vstack(axes)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    a, b = first @ directions.T, second @ directions.T
    gaps = np.maximum(a.min(axis=0) - b.max(axis=0), b.min(axis=0) - a.max(axis=0))
    return bool(gaps.max() > -RESOLUTION)


def convex_hull(points: Array) -> Array:
    """Return the corners of the convex hull of points in the plane, (k, 2), by Andrew's monotone chain.

    Args:
        points: the points (n, 2).
    """
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
    """Return the part of a convex polygon in all half-planes n p <= h (Sutherland and Hodgman)."""
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
    """Return a direction along which every force in the friction cones of several contacts has a positive component.

    A direction at an angle a from a contact's normal has this property for its cone if a + atan(mu) < 90 degrees. For
    two normals, the result is the middle of the allowed angles between them. Without such a direction the contacts
    could press against each other with any force (our choice).

    Args:
        normals: unit normals of the contacts, (3,) each; at most two distinct ones.
        friction: coefficient of friction of each contact.

    Returns:
        Unit vector (3,), or None if there is no such direction.
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
    """Return the axes of a contact as columns (3, 3): z along its normal, x along a direction projected onto its plane.

    Args:
        normal: normal of the contact (3,), of any non-zero length.
        along: the direction (3,), of any non-zero length, not parallel to the normal.
    """
    z = np.asarray(normal, dtype=float) / np.linalg.norm(normal)
    x = np.asarray(along, dtype=float) - (np.asarray(along) @ z) * z
    x /= np.linalg.norm(x)
    return np.column_stack([x, np.cross(z, x), z])


def rotation_rpy(rpy: Sequence[float]) -> Array:
    """Return the rotation matrix (3, 3) of roll, pitch and yaw about the fixed x, y and z axes.

    Args:
        rpy: roll, pitch and yaw (3,) [rad].
    """
    (cx, cy, cz), (sx, sy, sz) = np.cos(rpy), np.sin(rpy)
    return np.array(
        [
            [cz * cy, cz * sy * sx - sz * cx, cz * sy * cx + sz * sx],
            [sz * cy, sz * sy * sx + cz * cx, sz * sy * cx - cz * sx],
            [-sy, cy * sx, cy * cx],
        ]
    )


def yaw_matrix(yaw: float) -> Array:
    """Return the matrix (3, 3) of a rotation about z.

    Args:
        yaw: angle of the rotation [rad].
    """
    matrix = np.eye(3)
    matrix[:2, :2] = rotation(yaw)
    return matrix
