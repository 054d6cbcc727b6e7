"""Inertia of bodies that can exist: the mass lies in the shape of the body and has a given centre of mass.

The second moment S of a unit mass about its centre of mass determines the inertia, I = tr(S) 1 - S. If a linear
function of S is largest, the mass is at the corners of a box, within one of its planes or lines, or at one point. All
extreme distributions over the corners are enumerated: they have at most four corners, because they satisfy four
equations. In a cylinder the mass is at the ends of chords through the centre of mass, at the upper and the lower face.
"""

from __future__ import annotations

from functools import lru_cache
from itertools import combinations, product

import numpy as np

from robustopt.arrays import Array

ENTRIES = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
"""Order of the entries of a symmetric matrix."""

FIRST, SECOND = np.array(ENTRIES).T

CORNERS = np.array(list(product((-1.0, 1.0), repeat=3)))
"""Corners of a box, in units of its half extents."""

CHORDS = 12
"""Number of directions of chords in a disc."""

SINGULAR = 1e-9
"""Determinant of the equations for four corners below which they lie in a plane with the centre of mass or worse."""


def inertia_of(moments: Array) -> Array:
    """Return the inertia per unit mass, (..., 6), of second moments (..., 6), and the reverse but for a factor.

    Args:
        moments: entries of S in the order of `ENTRIES` (..., 6) [m^2].
    """
    inertia = -moments
    inertia[..., :3] += moments[..., :3].sum(axis=-1, keepdims=True)
    return inertia


def extreme_inertias(half: Array, is_round: bool, center: Array) -> Array:
    """Return the inertias per unit mass of extreme distributions with a given centre of mass, (k, 6) [m^2].

    Args:
        half: half extents of a box, or radius, radius and half the height of a cylinder (3,) [m].
        is_round: whether the body is a cylinder.
        center: centre of mass from the centre of the shape (3,) [m].
    """
    return _extremes(tuple(half.tolist()), is_round, tuple(center.tolist()))


@lru_cache(maxsize=1024)
def _extremes(half: tuple[float, ...], is_round: bool, center: tuple[float, ...]) -> Array:
    moments = _in_cylinder if is_round else _in_box
    found = moments(np.array(half), np.array(center))
    kept = np.array(list(product((0.0, 1.0), repeat=3)))  # a mass that is not spread along an axis lies in a plane
    scaled = found[:, None] * (kept[:, FIRST] * kept[:, SECOND])
    inertias = inertia_of(np.unique(scaled.reshape(-1, 6), axis=0))
    inertias.setflags(write=False)
    return inertias


def _in_box(half: Array, center: Array) -> Array:
    """Return the second moments of all extreme distributions over the corners of a box, (k, 6)."""
    share = center / half
    found = []
    for four in combinations(range(8), 4):
        corners = CORNERS[list(four)]
        equations = np.vstack([np.ones(4), corners.T])
        if abs(np.linalg.det(equations)) > SINGULAR:
            weights = np.linalg.solve(equations, np.r_[1.0, share])
            if weights.min() >= -SINGULAR:
                apart = (corners - share) * half
                found.append(np.einsum("k,ki,kj->ij", np.maximum(weights, 0.0), apart, apart))
    return np.array(found)[:, FIRST, SECOND]


def _in_cylinder(half: Array, center: Array) -> Array:
    """Return the second moments of distributions over the ends of a chord, above and below, (k, 6)."""
    upper = 0.5 * (1.0 + center[2] / half[2])
    found = []
    for angle in np.arange(CHORDS) * np.pi / CHORDS:
        n = np.array([np.cos(angle), np.sin(angle)])
        along = n @ center[:2]
        root = np.sqrt(max(half[0] ** 2 - center[:2] @ center[:2] + along**2, 0.0))
        length, ahead = 2.0 * root, 0.5 * (1.0 + along / root) if root > 0.0 else 0.5
        for both in (min(ahead, upper), max(0.0, ahead + upper - 1.0)):  # ends of the range of P(ahead and above)
            S = np.zeros((3, 3))
            S[:2, :2] = ahead * (1.0 - ahead) * length**2 * np.outer(n, n)
            S[2, 2] = upper * (1.0 - upper) * (2.0 * half[2]) ** 2
            S[:2, 2] = S[2, :2] = (both - ahead * upper) * length * 2.0 * half[2] * n
            found.append(S)
    return np.array(found)[:, FIRST, SECOND]


def random_inertias(half: Array, is_round: bool, center: Array, rng: np.random.Generator, extreme: bool) -> Array:
    """Return the inertias per unit mass of random distributions with given centres of mass, (6, D) [m^2].

    Args:
        half: half extents of a box, or radius, radius and half the height of a cylinder (3,) [m].
        is_round: whether the body is a cylinder.
        center: centres of mass from the centre of the shape (3, D) [m].
        rng: generator of random numbers.
        extreme: whether the mass is as far from its centre as possible along some axes, and not spread along others.
    """
    count = center.shape[1]
    axes = np.repeat(np.eye(3)[:, :, None], count, axis=2)
    along, reach = center.copy(), np.repeat(half[:, None], count, axis=1)
    if is_round:
        angle = np.pi * rng.random(count)
        axes[:2, 0], axes[:2, 1] = (np.cos(angle), np.sin(angle)), (-np.sin(angle), np.cos(angle))
        along[:2] = np.einsum("ikd,id->kd", axes[:2, :2], center[:2])
        reach[0], reach[1] = np.sqrt(np.maximum(half[0] ** 2 - along[1] ** 2, 0.0)), np.abs(along[1])
    share = 0.5 * (1.0 + along / np.where(reach > 0.0, reach, np.inf))
    spread = rng.random((3, count))
    spread = np.where(spread < 0.5, 0.0, 1.0) if extreme else spread
    # The coordinates have two values each, and grow together or one as the other shrinks.
    sign = rng.choice([-1.0, 1.0], size=(3, count))
    rising = np.where(sign > 0.0, share, 1.0 - share)
    S = np.zeros((3, 3, count))
    for i, j in product(range(3), repeat=2):
        joint = np.minimum(rising[i], rising[j]) - rising[i] * rising[j]
        S[i, j] = sign[i] * sign[j] * joint * 4.0 * reach[i] * reach[j] * spread[i] * spread[j]
    S = np.einsum("ikd,kld,jld->ijd", axes, S, axes)
    return np.moveaxis(inertia_of(np.moveaxis(S[FIRST, SECOND], 0, -1)), -1, 0)
