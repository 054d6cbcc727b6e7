"""Rigid bodies with uncertain inertial parameters, and the wrenches that their motion requires.

The required wrench of a body is linear in its inertial parameters phi = (m, m r, I_o), ten numbers about the origin of
the frame that the body is rigid to: w = Y(a, alpha, omega) phi. Per unit of mass,

    phi / m = psi + sum_k zeta_k psi_k + sum_ab (T_ab - T0_ab) psi_ab,   zeta_k in [-1, 1],   T in a set.

The part that is linear in the displacement of the centre of mass is exact. T is a second moment of the mass about the
nominal centre of mass, in units of the reaches d along three axes: T_aa in [0, 1] and |T_ab| <= (T_aa + T_bb) / 2. If
the inertia about the centre of mass is known, T is the square of the displacement, and d its interval. If the body only
has to exist within its shape, all of its inertia is in T, and d^2 is the largest second moment that a mass in the shape
can have: h^2 - c^2 + 2 |c| e along an axis with half the edge length h and a centre of mass within c +- e. A cylinder
has T_xx + T_yy <= 1. These sets contain all possible bodies (our choice).
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
    """A body with an interval of its mass and sets of its other inertial parameters, in the frame that it is rigid to.

    Attributes:
        name: name of the body.
        mass: lowest and highest mass [kg].
        psi: inertial parameters of a unit mass, (10,).
        linear: half-widths of psi, each with a factor in [-1, 1], (k, 10).
        moments: change of psi per entry of T, in the order of `INERTIA_TERMS`, (6, 10), or (0, 10) for none.
        usual: the entries of T0, which psi contains, (6,) or (0,).
        round: whether T_xx + T_yy <= 1.
    """

    name: str
    mass: tuple[float, float]
    psi: Array
    linear: Array
    moments: Array
    usual: Array
    round: bool = False

    @property
    def nominal(self) -> Array:
        """Return phi with the mass at the middle of its interval and all else nominal, (10,)."""
        return 0.5 * (self.mass[0] + self.mass[1]) * self.psi


def uncertain_body(
    name: str,
    mass: tuple[float, float],
    arm: Array,
    inertia: Array,
    reaches: Array,
    factor: tuple[float, float] = (1.0, 1.0),
) -> Body:
    """Return a body whose mass, centre of mass and inertia about it lie in intervals.

    Args:
        name: name of the body.
        mass: lowest and highest mass [kg].
        arm: nominal centre of mass (3,) [m].
        inertia: inertia about the centre of mass per unit of mass (3, 3) [m^2].
        reaches: largest displacements of the centre of mass, in either direction, as columns (3, 3) [m].
        factor: lowest and highest factor on the inertia about the centre of mass.
    """
    psi, scaled = _point_mass(arm), np.zeros((1, 10))
    psi[4:] += 0.5 * (factor[0] + factor[1]) * inertia[FIRST, SECOND]
    scaled[0, 4:] = 0.5 * (factor[1] - factor[0]) * inertia[FIRST, SECOND]
    linear = np.vstack([_displacements(arm, reaches), scaled])
    moments = _second_moments(reaches)
    return Body(name, mass, psi, linear[linear.any(axis=1)], moments, np.zeros(len(moments)))


def realizable_body(
    name: str, mass: tuple[float, float], arm: Array, inertia: Array, reaches: Array, extents: Array, round_: bool
) -> Body:
    """Return a body whose mass may be distributed in any way that gives it a centre of mass in its interval.

    Args:
        name: name of the body.
        mass: lowest and highest mass [kg].
        arm: nominal centre of mass (3,) [m].
        inertia: nominal inertia about the centre of mass per unit of mass (3, 3) [m^2].
        reaches: largest displacements of the centre of mass, in either direction, as columns (3, 3) [m].
        extents: largest second moments about the nominal centre of mass, as columns: the root of each along its axis
            (3, 3) [m].
        round_: whether the first two axes of `extents` are those of a disc, whose second moments have a common bound.
    """
    psi, linear, moments = _point_mass(arm), _displacements(arm, reaches), _second_moments(extents)
    psi[4:] += inertia[FIRST, SECOND]
    lengths = np.linalg.norm(extents, axis=0)
    per_unit = extents / np.where(lengths > 0.0, lengths, np.inf) ** 2
    usual = per_unit.T @ (0.5 * np.trace(inertia) * np.eye(3) - inertia) @ per_unit
    return Body(name, mass, psi, linear[linear.any(axis=1)], moments, usual[FIRST, SECOND][: len(moments)], round_)


def _point_mass(arm: Array) -> Array:
    """Return the inertial parameters of a unit mass at a point (3,), (10,)."""
    return np.concatenate([[1.0], arm, _product(arm, arm)])


def _displacements(arm: Array, reaches: Array) -> Array:
    """Return the change of a point mass' parameters for each displacement, columns (3, 3), to first order, (3, 10)."""
    steps, linear = np.ascontiguousarray(reaches.T), np.zeros((3, 10))
    linear[:, 1:4] = steps
    linear[:, 4:] = 2.0 * _product(steps, arm)  # change of -skew(r)^2 to first order when r moves by a step
    return linear


def _second_moments(extents: Array) -> Array:
    """Return the change of psi per entry of T in units of the extents, columns (3, 3), (6, 10); (0, 10) for none."""
    steps, moments = np.ascontiguousarray(extents.T), np.zeros((6, 10))
    moments[:3, 4:] = _product(steps, steps)
    moments[3:, 4:] = 2.0 * _product(steps[FIRST[3:]], steps[SECOND[3:]])
    return moments if moments.any() else moments[:0]


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
