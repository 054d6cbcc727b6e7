"""Rigid bodies with uncertain inertial parameters, and the wrenches that their motion requires.

The required wrench of a body is linear in its inertial parameters phi = (m, m r, I_o), ten numbers about the origin of
the frame that the body is rigid to: w = Y(a, alpha, omega) phi. So an interval on mass and centre of mass is a zonotope
of parameters, constant along the path: phi = m (psi_0 + sum_k zeta_k psi_k), zeta in [-1, 1], m in [m_lo, m_hi]. The
part that is linear in the displacement of the centre of mass is exact. The squares of the displacement enter the
inertia about the origin alone; they are bounded term by term (`remainder`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from robustopt.arrays import Array
from robustopt.config import ObjectConfig, TrayConfig

INERTIA_TERMS = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
"""Order of the six entries of an inertia in phi: xx, yy, zz, xy, xz, yz."""

FIRST, SECOND = np.array(INERTIA_TERMS).T


@dataclass(frozen=True, eq=False)
class Body:
    """A body with an interval of its mass and of its centre of mass, in the frame that it is rigid to.

    Attributes:
        name: name of the body.
        mass: lowest and highest mass [kg].
        psi: inertial parameters of a unit mass, (1, r, I_o / m), (10,).
        linear: change of psi for the full displacement of the centre of mass along each axis (3, 10).
        remainder: terms of second order in the displacement, each with a factor in [-1, 1], (6, 10).
    """

    name: str
    mass: tuple[float, float]
    psi: Array
    linear: Array
    remainder: Array

    @property
    def nominal(self) -> Array:
        """Return phi at the middle of the mass interval, (10,)."""
        return 0.5 * (self.mass[0] + self.mass[1]) * self.psi


def uncertain_body(name: str, mass: tuple[float, float], arm: Array, inertia: Array, reaches: Array) -> Body:
    """Return a body whose mass and centre of mass lie in intervals.

    Args:
        name: name of the body.
        mass: lowest and highest mass [kg].
        arm: nominal centre of mass (3,) [m].
        inertia: inertia about the centre of mass per unit of mass (3, 3) [m^2].
        reaches: largest displacements of the centre of mass, in either direction, as columns (3, 3) [m].
    """
    steps = np.ascontiguousarray(reaches.T)
    psi, linear, remainder = np.zeros(10), np.zeros((3, 10)), np.zeros((6, 10))
    psi[0], psi[1:4], psi[4:] = 1.0, arm, inertia[FIRST, SECOND] + _product(arm, arm)
    linear[:, 1:4] = steps
    linear[:, 4:] = 2.0 * _product(steps, arm)  # change of -skew(r)^2 to first order when r moves by a step
    remainder[:3, 4:] = 0.5 * _product(steps, steps)  # a square in [0, 1] is a half plus or minus a half
    remainder[3:, 4:] = 2.0 * _product(steps[[0, 0, 1]], steps[[1, 2, 2]])
    return Body(name=name, mass=mass, psi=psi + remainder[:3].sum(axis=0), linear=linear, remainder=remainder)


def _product(a: Array, b: Array) -> Array:
    """Return a b I - (a b^T + b a^T) / 2 of vectors (..., 3), in the order of the inertia in phi, (..., 6)."""
    entries: Array = -0.5 * (a[..., FIRST] * b[..., SECOND] + a[..., SECOND] * b[..., FIRST])
    entries[..., :3] += (a * b).sum(axis=-1)[..., None]
    return entries


def inertia_matrix(item: TrayConfig | ObjectConfig) -> Array:
    """Return the inertia about the centre of mass, axes of the body, (3, 3) [kg m^2].

    Args:
        item: the tray or an object; without an inertia of its own its density is uniform.
    """
    if item.inertia is not None:
        matrix = np.zeros((3, 3))
        for value, (i, j) in zip(item.inertia, INERTIA_TERMS, strict=False):
            matrix[i, j] = matrix[j, i] = value
        return matrix
    if isinstance(item, ObjectConfig) and item.shape == "cylinder":
        assert item.radius is not None
        assert item.height is not None
        side = (3 * item.radius**2 + item.height**2) / 12
        return item.mass * np.diag([side, side, item.radius**2 / 2])
    assert item.size is not None
    x, y, z = (edge**2 for edge in item.size)
    return item.mass / 12 * np.diag([y + z, x + z, x + y])


def regressor(acceleration: Array, angular: Array) -> Array:
    """Return the matrix Y of w = Y phi for a body that accelerates but does not spin.

    With h = m r, f = m a + alpha x h and tau = h x a + I_o alpha (Newton and Euler).

    Args:
        acceleration: acceleration of the frame's origin minus gravity (..., 3) [m/s^2].
        angular: angular acceleration of the frame (..., 3) [rad/s^2].

    Returns:
        Wrench about the origin per inertial parameter (..., 6, 10).
    """
    Y = np.zeros((*acceleration.shape[:-1], 6, 10))
    Y[..., :3, 0] = acceleration
    Y[..., :3, 1:4] = _skews(angular)
    Y[..., 3:, 1:4] = -_skews(acceleration)
    for column, (i, j) in enumerate(INERTIA_TERMS):
        Y[..., 3 + i, 4 + column] = angular[..., j]
        Y[..., 3 + j, 4 + column] = angular[..., i]
    return Y


def spin_regressor(omega: Array) -> Array:
    """Return the contribution of an angular velocity to Y: f = omega x (omega x h), tau = omega x I_o omega (Euler).

    Args:
        omega: angular velocity of the frame (..., 3) [rad/s].

    Returns:
        Wrench about the origin per inertial parameter (..., 6, 10).
    """
    Y = np.zeros((*omega.shape[:-1], 6, 10))
    spin = _skews(omega)
    Y[..., :3, 1:4] = spin @ spin
    rates = np.zeros((*omega.shape[:-1], 3, 6))
    for column, (i, j) in enumerate(INERTIA_TERMS):
        rates[..., i, column] = omega[..., j]
        rates[..., j, column] = omega[..., i]
    Y[..., 3:, 4:] = spin @ rates
    return Y


def _skews(vectors: Array) -> Array:
    result = np.zeros((*vectors.shape[:-1], 3, 3))
    x, y, z = vectors[..., 0], vectors[..., 1], vectors[..., 2]
    result[..., 0, 1], result[..., 0, 2] = -z, y
    result[..., 1, 0], result[..., 1, 2] = z, -x
    result[..., 2, 0], result[..., 2, 1] = -y, x
    return result
