"""Facets of the wrench cone of a patch with three or four corners, in closed form, which a hull takes much longer for.

A row is the power of a wrench in a motion of the body: t = (v_x, v_y, w) in the plane of the patch, which moves corner
p_k by t_k = (v_x, v_y) + w (-p_ky, p_kx), and a part h(p), affine in p, across it. It holds for all contact forces if

    h(p_k) + N(t_k) <= 0   for every corner,   N(t_k) = max over the edges e of e t_k   (mu = 1).

A corner *touches* if this holds with equality, and t is at a *kink* of a corner if t_k lies between the sectors of two
edges, so that both forces do no power. A facet is determined up to scale by five independent forces that do none:

- no motion in the plane: two corners touch with all their edges (tipping),
- three corners touch, and t is at kinks of two of them,
- four corners touch, and t is at a kink of one of them.

The kinks of a corner are planes in the space of t, half as many as edges. In such a plane N(t_k) is linear for all
corners between rays in which it meets the planes of other corners. The second kind lies on these rays, and the third
kind between two rays where the four points (p_k, N(t_k)) become coplanar (our choice).
"""

from __future__ import annotations

import numpy as np

from robustopt.arrays import Array

MOST_CORNERS = 4
"""Largest number of corners: with five or more, there are facets without a kink."""

ROUNDING = 1e-11
"""Value of h(p_k) + N(t_k), for a patch of unit size, below which it counts as zero."""


def slip_facets(corners: Array, edges: int) -> Array:
    """Return the facets that bound slip at mu = 1, each scaled to -1 of the normal force, (F, 6).

    Args:
        corners: corners of the patch, in convex position about the origin, three or four (m, 2).
        edges: number of edges of each friction cone, a multiple of four.
    """
    found = [part for k in range(len(corners)) for part in _facets_at(corners, edges, k)]
    t, h = (np.concatenate(parts) for parts in zip(*found, strict=True))
    rows = np.column_stack([t[:, :2], h[:, 0], h[:, 2], -h[:, 1], t[:, 2]])
    return np.asarray(rows / -h[:, :1])


def _facets_at(corners: Array, edges: int, k: int) -> list[tuple[Array, Array]]:
    """Return motions (F, 3) and parts h as coefficients of (1, x, y), (F, 3), of the facets with a kink at corner k."""
    others = [i for i in range(len(corners)) if i != k]
    t, crossed = _rays(corners, edges, k, others)
    n = _resistances(t, corners, edges)
    found = []
    for i in others:
        at = (crossed == i) if i > k else np.zeros_like(crossed, dtype=bool)
        at |= crossed == k
        found += _touching_three(corners, k, i, t[at], n[at])
    if len(others) == 3:
        found.append(_touching_four(corners, t, n))
    return found


def _rays(corners: Array, edges: int, k: int, others: list[int]) -> tuple[Array, Array]:
    """Return the rays in the planes of corner k in cyclic order, (edges / 2, r, 3), and whose plane they lie on.

    The first one of each plane, which is also the last one, and the one half-way are rotations about corner k itself.
    """
    angle = np.pi / edges * (2 * np.arange(edges // 2) + 1)
    x, y = corners[k]
    turn, slide = np.array([y, -x, 1.0]), np.column_stack([np.cos(angle), np.sin(angle), np.zeros(len(angle))])
    normal = np.array(
        [np.column_stack([-np.sin(angle), np.cos(angle), np.column_stack([np.cos(angle), np.sin(angle)]) @ corners[i]])
         for i in others]
    ).reshape(-1, 3)  # fmt: skip
    along, across = slide @ normal.T, normal @ turn
    phase = np.arctan2(-np.broadcast_to(across, along.shape), along) % np.pi
    owner = np.repeat(others, len(angle))
    order = np.argsort(phase, axis=1, kind="stable")
    phase, owner = np.take_along_axis(phase, order, axis=1), owner[order]
    zero, own = np.zeros((len(angle), 1)), np.full((len(angle), 1), k)
    phase = np.hstack([zero, phase, zero + np.pi, phase + np.pi, zero + 2.0 * np.pi])
    rays = np.cos(phase)[:, :, None] * turn + np.sin(phase)[:, :, None] * slide[:, None]
    return rays, np.hstack([own, owner, own, owner, -np.ones_like(own)])


def _resistances(t: Array, corners: Array, edges: int) -> Array:
    """Return N(t_k) of motions (..., 3) at all corners, (..., m)."""
    v_x, v_y = t[..., :1] - t[..., 2:] * corners[:, 1], t[..., 1:2] + t[..., 2:] * corners[:, 0]
    angle, sector = np.arctan2(v_y, v_x), 2.0 * np.pi / edges
    return np.asarray(np.hypot(v_x, v_y) * np.cos(angle - sector * np.round(angle / sector)))


def _touching_three(corners: Array, k: int, i: int, t: Array, n: Array) -> list[tuple[Array, Array]]:
    """Return the facets for which corners k, i and one more touch: at most one on each side of the line k, i."""
    line = corners[i] - corners[k]
    found = []
    for j in range(len(corners)):
        if j in (k, i):
            continue
        side = float(line[0] * (corners[j] - corners[k])[1] - line[1] * (corners[j] - corners[k])[0])
        if abs(side) > ROUNDING:
            found.append(_valid(corners, [k, i, j], t, n))
    return found


def _touching_four(corners: Array, t: Array, n: Array) -> tuple[Array, Array]:
    """Return the facets between neighbouring rays (p, r, 3) for which all four corners touch."""
    dependence = np.linalg.svd(np.column_stack([np.ones(4), corners]).T)[2][-1]
    fold = n @ dependence
    before, after = fold[:, :-1], fold[:, 1:]
    p, r = np.nonzero((before * after <= 0.0) & (np.abs(before - after) > ROUNDING))
    share = (before[p, r] / (before[p, r] - after[p, r]))[:, None]
    between = [(1.0 - share) * values[p, r] + share * values[p, r + 1] for values in (t, n)]
    return _valid(corners, [0, 1, 2, 3], *between)


def _valid(corners: Array, touching: list[int], t: Array, n: Array) -> tuple[Array, Array]:
    """Return the motions, and the parts h of the facets that some corners touch, for which the others hold too."""
    affine = np.column_stack([np.ones(len(corners)), corners])
    h = -n[:, touching] @ np.linalg.pinv(affine[touching]).T
    holds = h[:, 0] < -ROUNDING
    for place, resistance in zip(affine, n.T, strict=True):
        holds &= h @ place + resistance <= ROUNDING
    return t[holds], h[holds]
