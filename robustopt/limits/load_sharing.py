"""How contacts share a load: the smallest forces along the friction edges that make a wrench, for many loads at once.

    minimise  1/2 sum_k lambda_k^2 / a_k + 1/(2 eps) |G lambda - w|^2   such that  lambda >= 0

G holds the wrenches of the friction edges, w is the wrench to be made, and a_k how willingly edge k is used. The dual
is an unconstrained concave program in six variables, max y w - 1/2 sum_k a_k max(0, G_k y)^2 - eps/2 |y|^2, solved for
all loads together by Newton's method (our choice); its solution moves continuously with w and a.
"""

from __future__ import annotations

import numpy as np

from robustopt.config import FEET

Array = np.ndarray

SOFTNESS = 1e-10
"""eps: how far, relative to the weight, the forces may miss the wrench; about a millionth where it is hard to make."""

LENGTH = 0.1
"""Unit of length of the programs [m]: about half a foot."""

STEPS, HALVINGS = 60, 12
"""Newton steps and halvings of one; about ten steps are usual."""

DONE = 1e-9
"""Residual of the dual's gradient, relative to the weight, at which an instant is solved."""


HAND_SHARE = 0.2
"""How willingly the edges of a hand are used, against 1 for those of a foot: arms are weaker than legs (our choice)."""


def willingness(contact: str) -> float:
    """The a_k of the edges of a contact that holds: a foot or a hand."""
    return 1.0 if contact in FEET else HAND_SHARE


def distribute(generators: Array, shares: Array, wrench: Array, weight: float) -> tuple[Array, Array]:
    """Forces along the generators (M, K) for wrenches (M, 6) [N, N m], and the miss (M,) as a fraction of the weight.

    generators: (6, K), moments about a point between the contacts; shares: (M, K), the a of the program
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
    """Lengths (M,) of Newton steps, halved until the dual's value rises enough (Armijo's rule)."""
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
