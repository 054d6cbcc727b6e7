"""Uncertainty: intervals on masses, centres of mass, friction, contact points and joint acceleration.

The wrench that a body needs is linear in its inertial parameters phi = (m, m r, I_o), ten numbers about the tray's
origin: w = Y(a, alpha, omega) phi. So an interval on mass and centre of mass is a zonotope of parameters, constant
along the path: phi = m (psi_0 + sum_k zeta_k psi_k), zeta in [-1, 1], m in [m_lo, m_hi]. The part linear in the
displacement of the centre of mass is exact. Its squares enter the inertia about the origin alone; they are bounded
term by term (`remainder`). Joint acceleration error e adds the columns of the tray's Jacobian to the acceleration
and is exact for bodies of known centre of mass; its product with a displacement of the centre of mass is again
bounded term by term.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from robustopt.config import BASE_COORDINATES, Config, ObjectConfig, TrayConfig
from robustopt.errors import ConfigError
from robustopt.scene.placement import placements

Array = np.ndarray

INERTIA_TERMS = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
"""Order of the six entries of an inertia in phi: xx, yy, zz, xy, xz, yz."""

FIRST, SECOND = np.array(INERTIA_TERMS).T


@dataclass(frozen=True, eq=False)
class Body:
    """The tray or an object on it; inertial parameters per unit of mass, about the tray's origin, tray frame.

    mass: (lowest, highest) mass [kg]
    psi: m r and I_o of a unit mass in front of them, (1, r, I_o / m), shape (10,)
    linear: change of psi per displacement of the centre of mass, each the full displacement, shape (3, 10)
    remainder: terms of second order in the displacement, each with a factor in [-1, 1], shape (6, 10)
    """

    name: str
    mass: tuple[float, float]
    psi: Array
    linear: Array
    remainder: Array

    @property
    def nominal(self) -> Array:
        """phi at the middle of the mass interval, shape (10,)."""
        return 0.5 * (self.mass[0] + self.mass[1]) * self.psi


def bodies(config: Config) -> dict[str, Body]:
    """The tray (under the name `tray`) and every object, by name."""
    placed = placements(config)
    items: dict[str, TrayConfig | ObjectConfig] = {"tray": config.carried_tray, **config.objects}
    result = {}
    for name, item in items.items():
        position, yaw = (0.0, 0.0, 0.0), 0.0
        if name in placed:
            position, yaw = tuple(placed[name].position.tolist()), placed[name].yaw
        mass = config.uncertainty.mass.get(name, (item.mass, item.mass))
        reach = config.uncertainty.center_of_mass.get(name, (0.0, 0.0, 0.0))
        result[name] = _body(name, item, mass, reach, position, yaw)
    return result


def friction(config: Config) -> dict[str, float]:
    """The smallest believed coefficient of friction under each object, or each foot: less friction is always worse."""
    point, interval = config.contact.friction, config.uncertainty.friction
    values = {}
    for name in config.interfaces:
        value = point.get(name, point.get("default", np.nan)) if isinstance(point, dict) else point
        bounds = interval.get(name, interval.get("default")) if isinstance(interval, dict) else interval
        values[name] = bounds[0] if bounds is not None else value
    return values


def contact_shift(config: Config) -> dict[str, float]:
    """How far each contact point under an object, or a foot, may lie from its place along x and y [m]."""
    shift = config.uncertainty.contact_points
    if isinstance(shift, dict):
        return {name: shift.get(name, shift.get("default", 0.0)) for name in config.interfaces}
    return dict.fromkeys(config.interfaces, shift or 0.0)


def acceleration_error(config: Config, joints: int) -> tuple[Array, Array]:
    """Middle and half-width of the interval of joint acceleration error, U and K D (paper eq. 9), (n,) [rad/s^2].

    The first joints of a robot on its feet are the coordinates of its base, which has an error of its own.
    """
    error, base = config.uncertainty.joint_acceleration, BASE_COORDINATES if config.walks else 0
    middle, radius = np.zeros(joints), np.zeros(joints)
    if config.walks:
        radius[:base] = config.uncertainty.base_acceleration
    if error is not None:
        middle[base:] = _per_joint("mean", error.mean, joints - base)
        radius[base:] = error.K * _per_joint("deviation", error.deviation, joints - base)
    return middle, radius


def _per_joint(name: str, given: float | tuple[float, ...], joints: int) -> Array:
    """One value for all joints, or one for each."""
    values = np.atleast_1d(np.asarray(given, dtype=float))
    if len(values) not in (1, joints):
        found = f"found {len(values)} values; expected one, or one for each of the {joints} joints [rad/s^2 or m/s^2]"
        raise ConfigError(found, f"uncertainty.joint_acceleration.{name}")
    return np.broadcast_to(values, (joints,)).copy()


@lru_cache(maxsize=256)
def _body(
    name: str,
    item: TrayConfig | ObjectConfig,
    mass: tuple[float, float],
    reach: tuple[float, float, float],
    position: tuple[float, float, float],
    yaw: float,
) -> Body:
    """A body at a place on the tray: `mass` interval, `reach` of its centre of mass along its own axes."""
    cosine, sine = np.cos(yaw), np.sin(yaw)
    turn = np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])
    inertia = turn @ (inertia_matrix(item) / item.mass) @ turn.T
    arm = np.array(position) + turn @ np.array(item.center_of_mass)
    return uncertain_body(name, mass, arm, inertia, turn * np.array(reach))


def uncertain_body(name: str, mass: tuple[float, float], arm: Array, inertia: Array, reaches: Array) -> Body:
    """A body from its interval of mass [kg], its centre of mass `arm` (3,) [m] and the inertia about that per unit of
    mass (3, 3) [m^2]; the centre of mass may be off by the columns of `reaches` (3, 3) [m], each either way."""
    steps = np.ascontiguousarray(reaches.T)
    psi, linear, remainder = np.zeros(10), np.zeros((3, 10)), np.zeros((6, 10))
    psi[0], psi[1:4], psi[4:] = 1.0, arm, inertia[FIRST, SECOND] + _product(arm, arm)
    linear[:, 1:4] = steps
    linear[:, 4:] = 2.0 * _product(steps, arm)  # change of -skew(r)^2 to first order when r moves by a step
    remainder[:3, 4:] = 0.5 * _product(steps, steps)  # a square in [0, 1] is a half plus or minus a half
    remainder[3:, 4:] = 2.0 * _product(steps[[0, 0, 1]], steps[[1, 2, 2]])
    return Body(name=name, mass=mass, psi=psi + remainder[:3].sum(axis=0), linear=linear, remainder=remainder)


def _product(a: Array, b: Array) -> Array:
    """-(skew(a) skew(b) + skew(b) skew(a)) / 2, which is a b I - (a b^T + b a^T) / 2, of vectors (..., 3), as the
    inertia in phi, (..., 6)."""
    entries: Array = -0.5 * (a[..., FIRST] * b[..., SECOND] + a[..., SECOND] * b[..., FIRST])
    entries[..., :3] += (a * b).sum(axis=-1)[..., None]
    return entries


def inertia_matrix(item: TrayConfig | ObjectConfig) -> Array:
    """Inertia about the centre of mass, axes of the body, shape (3, 3) [kg m^2]."""
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
    """Y of w = Y phi without spin: wrench about the tray's origin per inertial parameter, shape (..., 6, 10).

    acceleration: of the tray's origin minus gravity; angular: angular acceleration, (..., 3). With h = m r and
    I = I_o, f = m a + alpha x h and tau = h x a + I alpha.
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
    """What an angular velocity omega (..., 3) adds to Y: f = omega x (omega x h), tau = omega x I omega."""
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
