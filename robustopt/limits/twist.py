"""Twist of a patch whose pressure is prescribed: rows for `pressure: fixed`.

The distribution of a normal force over a patch is statically indeterminate. If the patch is twisted about its normal, a
cone that is free to choose the distribution promises more than elastic lips, bases or pads give. So the distribution is
prescribed: the normal force of each contact point is a linear function N_i of the wrench and of the force that presses
the part against the tool, as of elastic lips and bases, or of uniform pads. The tangential forces that are then
possible form a Minkowski sum of friction polygons, and the forces across the normal and the moment about it,
t = (f_x, f_y, m_z), must lie in it:

    y t <= mu sum_i N_i h(v_i(y)),   v_i(y) = (y_x, y_y) + y_z (-p_iy, p_ix),

for every motion y of the part in the plane of the patch; h is the support function of the polygon for mu = 1. The
facets of the sum belong to motions for which two contact points slide across edges of their polygons, or one point
stays: the rotation centres lie where lines along such edges through two points meet, or at a point. If they meet
nowhere the part slips without rotation, which the free cone bounds alike. So the rows are finitely many and linear, and
with those of the free cone they are exact (our choice).

Near the limit of peel N_i is negative at some points. Real lips only press, and if such a part is twisted as well, the
rows of an eight-point lip promise more than these hold: up to 3 % of the acceleration in a scan of parts that hang
beside a cup, 6 % in MuJoCo. Lips of four points are exact there too. No convex set that contains all forces without
twist can do better.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from itertools import product

import numpy as np

from robustopt.arrays import Array

SAME_CENTRE = 1e-9
"""Distance below which two rotation centres of a patch of unit size count as the same."""

FARTHEST = 1e6
"""Distance, in sizes of the patch, beyond which a rotation centre counts as infinitely far: the motion is a slip."""

MOST_ROWS = 60_000
"""Rows above which friction polygons of fewer edges are taken: 55,552 for a lip of 8 points at 64 edges."""


def affordable_edges(points: int, edges: int, placements: int = 1) -> int:
    """Return the largest number of edges, halved from the configured one, that needs no more than `MOST_ROWS` rows.

    Args:
        points: number of contact points.
        edges: configured number of edges of a friction polygon.
        placements: number of placements of the points.
    """
    lines = _edge_directions(edges)
    while placements * points * (points - 1) * lines * (lines - 1) > MOST_ROWS:
        edges //= 2
        lines = _edge_directions(edges)
    return edges


def _edge_directions(edges: int) -> int:
    """Return how many directions the edges of a friction polygon have."""
    return edges // 2 if edges % 2 == 0 else edges


@lru_cache(maxsize=64)
def _rotation_centres(points: tuple[tuple[float, float], ...], edges: int) -> Array:
    """Return the rotation centres (k, 2) at which facets of the Minkowski sum may lie, for points of unit size."""
    p = np.array(points)
    angle = 2 * np.pi * (np.arange(_edge_directions(edges)) + 0.5) / edges + np.pi / 2
    direction = np.column_stack([np.cos(angle), np.sin(angle)])
    found = [p]
    for i in range(len(p)):
        for j in range(i + 1, len(p)):
            found.append(_meetings(p[i], p[j], direction))
    centres = np.vstack(found)
    centres = centres[np.abs(centres).max(axis=1) < FARTHEST]
    _, first = np.unique(np.round(centres / SAME_CENTRE), axis=0, return_index=True)
    return np.asarray(centres[np.sort(first)])


def _meetings(a: Array, b: Array, direction: Array) -> Array:
    """Return the points (k, 2) at which lines through a and through b along the directions (m, 2) meet."""
    first, second = np.repeat(direction, len(direction), axis=0), np.tile(direction, (len(direction), 1))
    across = first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]
    crossing = np.abs(across) > 1e-9
    first, second, across = first[crossing], second[crossing], across[crossing]
    way = ((b - a)[0] * second[:, 1] - (b - a)[1] * second[:, 0]) / across
    return np.asarray(a + way[:, None] * first)


def motions(points: Array, edges: int) -> Array:
    """Return the motions y at which the twist of a patch must be bounded.

    Args:
        points: contact points in the plane of the patch, about its centre (n, 2) [m].
        edges: number of edges of a friction polygon.

    Returns:
        Velocities of the centre and rate of rotation about the normal, (k, 3) [m/s, m/s, rad/s].
    """
    size = float(np.abs(points).max())
    centres = size * _rotation_centres(tuple(map(tuple, np.round(points / size, 12).tolist())), edges)
    turns = np.column_stack([centres[:, 1], -centres[:, 0], np.ones(len(centres))])
    return np.vstack([turns, -turns])


def resistance(points: Array, y: Array, edges: int, reach: Array) -> Array:
    """Return the least h(v_i(y)) of every contact point for every motion, (k, n): power of friction per mu and N_i.

    A point may be anywhere in its square, which changes its velocity by up to reach |y_z| along each axis.

    Args:
        points: nominal contact points in the plane of the patch (n, 2) [m].
        y: motions (k, 3).
        edges: number of edges of a friction polygon.
        reach: largest displacement of each point along each axis (n,) [m].
    """
    angle = 2 * np.pi * np.arange(edges) / edges
    across = np.stack([-points[:, 1], points[:, 0]], axis=1)
    velocity = y[:, None, :2] + y[:, 2:, None] * across[None]
    swing = np.abs(y[:, 2:]) * reach
    best = np.zeros(velocity.shape[:2])
    for c, s in zip(np.cos(angle), np.sin(angle), strict=True):
        best = np.maximum(best, velocity[..., 0] * c + velocity[..., 1] * s - (abs(c) + abs(s)) * swing)
    return best


def displaced(points: Array, reach: Array) -> tuple[Array, ...]:
    """Return the placements of contact points that give the rows: nominal, drawn in, and shifted as a whole.

    The least friction of each point is exact for any placement of the others (see `resistance`). The motions and the
    elastic pressure are taken from these placements alone (our choice); the certificate searches all placements.

    Args:
        points: nominal contact points about the centre (n, 2) [m].
        reach: largest displacement of each point along each axis (n,) [m].
    """
    if not np.any(reach):
        return (points,)
    d = reach[:, None]
    shifts = [np.array(sign) * d for sign in product((-1.0, 1.0), repeat=2)]
    drawn_in = np.sign(points) * np.maximum(np.abs(points) - d, 0.0)
    return points, drawn_in, *(points + shift for shift in shifts)


def elastic_rows(patches: Sequence[Array], mu: Sequence[float], edges: int, reach: Sequence[float]) -> Array:
    """Return the twist rows of K patches with elastic pressure, over their wrench and vacuum forces, (k, 6 + K).

    The vacuums pull at the centres of their lips; there are none under an object that stands on its support. The object
    is rigid, so the normal forces of all patches are one linear function of the place: those of least squares among all
    that supply the normal force f_z + sum F_k and the moments.

    Args:
        patches: nominal contact points of each patch about a common point, in common axes (n, 2) [m].
        mu: coefficient of friction of each patch.
        edges: number of edges of a friction polygon.
        reach: largest displacement of the contact points of each patch along each axis [m].

    Returns:
        Rows on (f, m, F), wrench about that point in these axes, scaled to -1 of the normal force.
    """
    sizes = [len(own) for own in patches]
    points, friction, swing = np.vstack(patches), np.repeat(mu, sizes), np.repeat(reach, sizes)
    places = displaced(points, swing)
    edges = affordable_edges(len(points), edges, len(places))
    pulls = np.array([[1.0, *(own.mean(axis=0) @ [[0.0, -1.0], [1.0, 0.0]])] for own in patches]).T
    found = []
    for place in places:
        y = motions(place, edges)
        balance = np.stack([np.ones(len(points)), place[:, 1], -place[:, 0]])
        normals = balance.T @ np.linalg.inv(balance @ balance.T)
        power = resistance(points, y, edges, swing) * friction @ normals
        rows = np.zeros((len(y), 6 + len(patches)))
        rows[:, [0, 1, 5]] = y
        rows[:, [2, 3, 4]] = -power
        rows[:, 6:] = -power @ pulls
        found.append(rows / power[:, :1])
    return np.vstack(found)


def grip_rows(driven: Array, fixed: Array, mu: Sequence[float], edges: int, reach: Sequence[float]) -> Array:
    """Return the twist rows of a grip with uniform normals, over the wrench and the closing force, (k, 7).

    Each of the n corners of the driven pad presses with F / n, each corner of the fixed pad with (F + f_z) / n.

    Args:
        driven: nominal contact points of the driven pad in the plane of the fixed pad, about its centre (n, 2) [m].
        fixed: nominal contact points of the fixed pad there (n, 2) [m].
        mu: coefficients of friction of the two pads.
        edges: number of edges of a friction polygon.
        reach: largest displacement of the contact points of each pad along each axis [m].

    Returns:
        Rows on (f, m, F), wrench about the centre of the pads in the axes of the fixed pad, scaled to -1 of F.
    """
    points, swing = np.vstack([driven, fixed]), np.repeat(reach, [len(driven), len(fixed)])
    places = displaced(points, swing)
    edges = affordable_edges(len(points), edges, len(places))
    y = np.vstack([motions(place, edges) for place in places])
    least = resistance(points, y, edges, swing)
    on_driven = mu[0] * least[:, : len(driven)].mean(axis=1)
    on_fixed = mu[1] * least[:, len(driven) :].mean(axis=1)
    rows = np.zeros((len(y), 7))
    rows[:, [0, 1, 5]] = y
    rows[:, 2] = -on_fixed
    rows[:, 6] = -(on_driven + on_fixed)
    return np.asarray(rows / (on_driven + on_fixed)[:, None])
