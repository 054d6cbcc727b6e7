"""Force closure on exact Coulomb cones: whether contact forces balance a wrench, and how far it is from the limit.

K blocks balance if the cones of all contact points contain forces whose wrenches sum to the required wrench w (6 K,)
and whose closing forces have the given values. All such sums form a convex cone C.

The gauge of rest + move, with rows `rest` inside the cone as the reference, is

    gamma = min {g >= 0: g rest + move in C}.

It is 1 at the limit and |f_t| / (mu f_z) for a block that slides. For a block that tips it is the distance of the
centre of pressure from its place at rest, as a share of the distance to the edge of the patch. The gauge is the optimum
of a second-order cone program and of its dual,

    min g  s.t.  sum_i A_i f_i - g rest = move,  f_i in the cone of point i,
    max -y move  s.t.  A_i^T y in the (self-dual) cone of point i,  y rest <= 1,

which a primal-dual interior-point method solves, with Nesterov-Todd scaling and Mehrotra's predictor and corrector. All
iterates y are feasible, so each bounds gamma from below; forces that balance bound it from above.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from robustopt.arrays import Array, Flags
from robustopt.certificate.cone_program import solve
from robustopt.certificate.contact_points import Contacts, even_pressure

GAP = 1e-8
"""Width of the bracket of gamma, and residual as a share of the wrench, at which a program is solved: a hundredth of
the violation that a certificate accepts, and above the rounding errors of the normal equations (about 1e-9).
"""

ROUGH_GAP = 2e-7
"""The same for a program whose accuracy is limited by rounding errors, for example because of degenerate patches."""

NEARLY = 1e-4
"""Residual, as a share of the wrench, that is accepted if rounding errors end a program early; a second program
balances it.
"""

MOST = 1e4
"""A gauge above this counts as infinite: g rest + move lies outside the cone for every g."""

CHUNK = 1024
"""Number of programs whose matrices are in memory together."""


@dataclass(frozen=True)
class Gauge:
    """Solutions of T programs.

    Attributes:
        value: gamma, from forces that balance; infinite if there are none (T,).
        lower: lower bound of gamma (T,).
        y: the nearest limit, y w >= 0 for all w in the cone (rows, T).
    """

    value: Array
    lower: Array
    y: Array


def gauge(contacts: Contacts, rest: Array, move: Array, good_enough: Array | float = 0.0, gap: float = GAP) -> Gauge:
    """Return the smallest g with g rest + move in the cone, to within `gap`.

    The accuracy is best if forces are divided by the weight and lengths by the size of the patch.

    Args:
        contacts: contact points of T programs.
        rest: reference (rows, T).
        move: rows that the motion adds (rows, T).
        good_enough: gauge below which the search may stop (T,).
        gap: accuracy.
    """
    count = rest.shape[-1]
    enough = np.broadcast_to(np.asarray(good_enough, dtype=float), (count,))
    rules = (gap, max(gap, ROUGH_GAP), GAP, MOST)
    value, lower, y = np.empty(count), np.empty(count), np.empty(rest.shape)
    for begin in range(0, count, CHUNK):
        part = slice(begin, begin + CHUNK)
        own, here = contacts[part], rest[:, part]
        arrays = own.matrix.T, here.T, move[:, part].T, contacts.inside, _units(own).T, enough[part]
        g, lower[part], limit, reached, left_over = solve(*(np.array(array, order="C") for array in arrays), rules)
        lost = np.isinf(g) & np.isfinite(reached) & (np.linalg.norm(left_over, axis=1) < NEARLY)
        if lost.any() and gap < NEARLY:
            g[lost] = _with_left_over(own[np.flatnonzero(lost)], here[:, lost], reached[lost], left_over[lost].T)
        value[part], y[:, part] = g, limit.T
    return Gauge(value, lower, y)


def _units(contacts: Contacts) -> Array:
    """Return the unit of the residual of each row, (rows, T or 1): rows of friction are in units of the least one."""
    blocks = 1 + max(face.above for face in contacts.faces)
    unit = np.ones((contacts.rows, contacts.mu.shape[-1]))
    for row in (0, 1, 5):
        unit[row : 6 * blocks : 6] = 1.0 / np.minimum(contacts.mu.min(axis=0), 1.0)
    return unit


def _with_left_over(contacts: Contacts, rest: Array, reached: Array, left_over: Array) -> Array:
    """Return the gauges (T,) of programs that rounding errors keep from balancing to the last digits.

    Let r be the residual wrench. Forces balance g rest + move - r, and with the gauge h of r they balance h rest + r,
    so they balance (g + h) rest + move. h is proportional to the length of r, which is small.

    Args:
        contacts: contact points of T programs.
        rest: reference (rows, T).
        reached: g of the best iterate (T,).
        left_over: its residual (rows, T).
    """
    size = np.linalg.norm(left_over, axis=0)
    direction = left_over / np.maximum(size, 1e-300)
    return np.asarray(reached + size * gauge(contacts, rest, direction, gap=NEARLY).value)


def seen_from(contacts: Contacts, held: Flags, rest: Array, move: Array) -> tuple[Array, Array]:
    """Return `rest` and `move`, with an even pressure as the reference in place of any `rest` that is not held."""
    if held.all():
        return rest, move
    even = even_pressure(contacts, rest.shape[-1])
    return np.where(held, rest, even), np.where(held, move, rest + move - even)
