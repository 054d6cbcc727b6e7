"""Sharing of wrenches: the smallest forces along the friction edges that supply a wrench, for many wrenches at once.

    minimise  1/2 sum_k lambda_k^2 / a_k + 1/(2 eps) |G lambda - w|^2   such that  lambda >= 0

G holds the wrenches of the friction edges, w is the required wrench, and a_k the willingness of edge k. The dual is an
unconstrained concave program in six variables, max y w - 1/2 sum_k a_k max(0, G_k y)^2 - eps/2 |y|^2, solved for all
wrenches together by Newton's method (our choice). Its solution moves continuously with w and a.
"""

from __future__ import annotations

import numpy as np

from robustopt.arrays import Array
from robustopt.config import FEET

SOFTNESS = 1e-10
"""The eps of the program, relative to the weight: at the edge of the cone the forces miss the wrench by about a
millionth of the weight."""

LENGTH = 0.1
"""Unit of length of the programs [m]: about half a foot."""

STEPS, HALVINGS = 60, 12
"""Largest numbers of Newton steps and of halvings of a step; about ten steps are usual."""

DONE = 1e-9
"""Residual of the dual's gradient, relative to the weight, at which a program is solved."""

HAND_SHARE = 0.2
"""Willingness of the edges of a hand, relative to 1 for a foot: arms are weaker than legs (our choice)."""


def willingness(contact: str) -> float:
    """Return the willingness a_k of the friction edges of a contact.

    Args:
        contact: name of a foot or a hand.
    """
    return 1.0 if contact in FEET else HAND_SHARE


def distribute(generators: Array, shares: Array, wrench: Array, weight: float) -> tuple[Array, Array]:
    """Return the smallest forces along generators that supply some wrenches.

    Args:
        generators: wrenches of the friction edges about a point between the contacts (6, K).
        shares: willingness of each edge, the a of the program (M, K).
        wrench: required wrenches about the same point (M, 6) [N, N m].
        weight: weight of the robot, the unit of forces [N].

    Returns:
        Forces (M, K) [N], and the largest part of each wrench that they miss, as a fraction of the weight (M,).
    """
    scale = np.concatenate([np.ones(3), np.full(3, 1.0 / LENGTH)])
    G = (generators * scale[:, None]).T
    squares = (G[:, :, None] * G[:, None, :]).reshape(len(G), 36)
    w = wrench * scale / weight
    soft = SOFTNESS * np.eye(6)
    y = np.linalg.solve((shares @ squares).reshape(-1, 6, 6) + soft, w[:, :, None])[:, :, 0]
    pending = np.arange(len(w))
    for _ in range(STEPS):
        along = y[pending] @ G.T
        pressed = shares[pending] * np.maximum(along, 0.0)
        gradient = w[pending] - pressed @ G - SOFTNESS * y[pending]
        left = np.abs(gradient).max(axis=1) > DONE
        pending, along, gradient = pending[left], along[left], gradient[left]
        if not len(pending):
            break
        hessian = ((shares[pending] * (along > 0.0)) @ squares).reshape(-1, 6, 6) + soft
        step = np.linalg.solve(hessian, gradient[:, :, None])[:, :, 0]
        y[pending] += _step_lengths(G, shares[pending], w[pending], y[pending], step, gradient)[:, None] * step
    forces = shares * np.maximum(y @ G.T, 0.0)
    return forces * weight, np.abs(w - forces @ G).max(axis=1)


def _step_lengths(G: Array, shares: Array, w: Array, y: Array, step: Array, gradient: Array) -> Array:
    """Return the lengths of Newton steps (M,), halved until the dual's value rises enough (Armijo's rule)."""
    along, change = y @ G.T, step @ G.T
    rise = (gradient * step).sum(axis=1)
    length = np.ones(len(y))

    def value(at: Array) -> Array:
        z = y + at[:, None] * step
        pressed = np.maximum(along + at[:, None] * change, 0.0)
        return np.asarray(
            (z * w).sum(axis=1) - 0.5 * (shares * pressed**2).sum(axis=1) - 0.5 * SOFTNESS * (z * z).sum(axis=1)
        )

    start = value(np.zeros(len(y)))
    for _ in range(HALVINGS):
        short = value(length) < start + 1e-4 * length * rise - 1e-15 * np.abs(start)
        if not short.any():
            break
        length[short] *= 0.5
    return length
