"""Algebra of second-order cones (3,) and of small symmetric matrices, vectorised along the last axis."""

from __future__ import annotations

import numpy as np

from robustopt.arrays import Array

REGULAR = 1e-14
"""Smallest pivot of the normal equations as a share of their trace: a patch that is a line or a point has no stiffness
in some directions."""


class Scaling:
    """Nesterov-Todd scaling W of each cone, with W^-1 force = W slack."""

    def __init__(self, force: Array, slack: Array) -> None:
        force_size, slack_size = np.sqrt(square(force)), np.sqrt(square(slack))
        force, slack = force / force_size, slack / slack_size
        w = force + slack * np.array([1.0, -1.0, -1.0])[:, None, None]
        self.w = w / np.sqrt(2.0 * (1.0 + (force * slack).sum(axis=0)))
        self.eta = np.sqrt(force_size / slack_size)

    def __call__(self, c: Array) -> Array:
        """Return W c, (3, n, T)."""
        w0, w1, w2 = self.w
        along = w1 * c[1] + w2 * c[2]
        factor = c[0] + along / (1.0 + w0)
        out = np.empty(c.shape)
        out[0] = w0 * c[0] + along
        out[1] = c[1] + w1 * factor
        out[2] = c[2] + w2 * factor
        out *= self.eta
        return out

    def matrix(self) -> Array:
        """Return W itself, (3, 3, n, T)."""
        w0, w1, w2 = self.w * self.eta
        lean = self.w / (1.0 + self.w[0])
        return np.stack(
            [
                np.stack([w0, w1, w2]),
                np.stack([w1, self.eta + lean[1] * w1, lean[1] * w2]),
                np.stack([w2, lean[2] * w1, self.eta + lean[2] * w2]),
            ]
        )


def square(c: Array) -> Array:
    """Return c_0^2 - c_1^2 - c_2^2, positive inside the cone."""
    return np.asarray(c[0] ** 2 - c[1] ** 2 - c[2] ** 2)


def ray(value: Array, step: Array) -> Array:
    """Return the longest step that keeps a positive value positive."""
    return np.where(step < 0.0, -value / step, np.inf)


def reach(c: Array, d: Array) -> Array:
    """Return the largest a with c + a d in the cone, for c inside it, (n, T)."""
    bend, inside = square(d), np.maximum(square(c), 0.0)
    cross = c[0] * d[0] - c[1] * d[1] - c[2] * d[2]
    root = np.sqrt(np.maximum(cross**2 - bend * inside, 0.0))
    longest = np.where(cross < 0.0, inside / (root - cross), np.where(bend < 0.0, (cross + root) / -bend, np.inf))
    return np.where((bend >= 0.0) & (d[0] >= 0.0), np.inf, longest)


def divide(scaled: Array, target: Array, force: Array, slack: Array) -> Array:
    """Return q with scaled o q = target e - scaled o scaled - force o slack; o is the Jordan product of the cone."""
    c0, c1, c2 = scaled
    r0 = target - (scaled * scaled + force * slack).sum(axis=0)
    r1 = -2.0 * c0 * c1 - force[0] * slack[1] - force[1] * slack[0]
    r2 = -2.0 * c0 * c2 - force[0] * slack[2] - force[2] * slack[0]
    q0 = (c0 * r0 - c1 * r1 - c2 * r2) / square(scaled)
    return np.stack([q0, (r1 - c1 * q0) / c0, (r2 - c2 * q0) / c0])


def cholesky(matrix: Array) -> Array:
    """Return the lower Cholesky factor of symmetric matrices (d, d, T), computed in place."""
    smallest = REGULAR * np.trace(matrix)
    for j in range(len(matrix)):
        pivot = np.sqrt(np.maximum(matrix[j, j], smallest))
        matrix[j, j] = pivot
        matrix[j + 1 :, j] /= pivot
        for k in range(j + 1, len(matrix)):
            matrix[k:, k] -= matrix[k:, j] * matrix[k, j]
    return matrix


def solve(factor: Array, right: Array) -> Array:
    """Return the solution of L L^T x = right, (d, T)."""
    x = right.copy()
    for i in range(len(x)):
        x[i] /= factor[i, i]
        x[i + 1 :] -= factor[i + 1 :, i] * x[i]
    for i in reversed(range(len(x))):
        x[i] /= factor[i, i]
        x[:i] -= factor[i, :i] * x[i]
    return x
