"""Uncertain parameters of bodies, and a search for the mass distribution in a shape that is worst for a row.

A row is linear, tr(G S), in the second moment S of a unit mass about its centre of mass c. Along the spread axes the
mass is at the corners of a box, or at the ends of a chord of a disc; each extreme distribution over corners is
enumerated. Along the other axes its place depends linearly on that along the spread ones, which is best if G is
negative there. All of these distributions exist, so the result is a lower bound.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from itertools import combinations, product

import numpy as np

from robustopt.arrays import Array, Flags
from robustopt.config import Config, ObjectConfig
from robustopt.config.load import with_values
from robustopt.limits.bodies import INERTIA_TERMS, inertia_matrix
from robustopt.limits.uncertainty import acceleration_error, bodies
from robustopt.scene.placement import placements

DIRECTIONS = 24
"""Number of directions of the chords in a disc."""

SLACK = 1e-9
"""Rounding error of weights, whose sum is 1 if none of them is negative."""


@dataclass(frozen=True)
class Shape:
    """The second moments that a body of unit mass can have, axes of the body.

    Attributes:
        given: Second moments about the centre of mass, of which one is the worst; none if the body is realizable.
        half: Half extents of the box, or radius, radius and half the height of the cylinder, shape (3,), [m].
        round: Whether it is a cylinder.
        center: Nominal centre of mass from the centre of the shape, shape (3,), [m].
    """

    given: tuple[Array, ...]
    half: Array
    round: bool
    center: Array

    @property
    def certain(self) -> bool:
        return len(self.given) == 1

    def worst(self, G: Array, displacement: Array) -> Array:
        """Return the second moments with the largest tr(G S) found, for displaced centres of mass.

        Args:
            G: Coefficients, symmetric, shape (M, 3, 3).
            displacement: Displacements of the centre of mass, shape (M, 3), [m].
        """
        best, value = np.zeros_like(G), np.full(len(G), -np.inf)
        c = self.center + displacement
        for S in self.given or (_in_cylinder(G, c, self.half) if self.round else _in_box(G, c, self.half)):
            reached = np.einsum("mij,mij->m", G, np.broadcast_to(S, G.shape))
            better = reached > value
            best[better], value[better] = np.broadcast_to(S, G.shape)[better], reached[better]
        return best


def shape_of(config: Config, name: str) -> Shape:
    """Return the second moments that the tray or an object can have."""
    body = config.tray if name == "tray" else config.objects[name]
    assert body is not None
    inertia, factor = inertia_matrix(body) / body.mass, config.inertia_of(name)
    nominal = 0.5 * np.trace(inertia) * np.eye(3) - inertia
    given = () if factor == "realizable" else tuple(value * nominal for value in dict.fromkeys(factor))
    if isinstance(body, ObjectConfig) and body.shape == "cylinder":
        assert body.radius is not None
        assert body.height is not None
        return Shape(given, np.array([body.radius, body.radius, body.height / 2]), True, np.array(body.center_of_mass))
    return Shape(given, np.array(body.size) / 2, False, np.array(body.center_of_mass))


@dataclass(frozen=True)
class Box:
    """The uncertain parameters z, and the inertial parameters of the n bodies for them.

    In turn: the masses (n,), the displacements of the centres of mass (3n,), and the acceleration errors, all in units
    of their intervals, z in [-1, 1]; and the second moments about the centres of mass, axes of the body (9n,) [m^2].

    Attributes:
        names: Bodies.
        masses: Lowest and highest mass, shape (n, 2), [kg].
        arms: Centres of mass, carrier frame, shape (n, 3), [m].
        turns: Rotation of each body in the carrier frame, shape (n, 3, 3).
        reaches: Largest displacements of the centre of mass along the axes of each body, shape (n, 3), [m].
        shapes: Second moments that each body can have.
        middle: Middle of the acceleration error of each joint, [rad/s^2 or m/s^2].
        radius: Half-width of it.
    """

    names: tuple[str, ...]
    masses: Array
    arms: Array
    turns: Array
    reaches: Array
    shapes: tuple[Shape, ...]
    middle: Array
    radius: Array

    @property
    def size(self) -> int:
        return self.first_moment + 9 * len(self.names)

    @property
    def first_moment(self) -> int:
        """Return the index of the first second moment."""
        return 4 * len(self.names) + len(self.radius)

    @property
    def free(self) -> Flags:
        """Return whether each parameter but the second moments has an interval of any width."""
        return np.r_[self.masses[:, 0] < self.masses[:, 1], self.reaches.ravel() > 0, self.radius > 0]

    def units(self, z: Array) -> Array:
        """Return the acceleration errors in units of their intervals, (M, joints)."""
        return z[:, 4 * len(self.names) : self.first_moment]

    def error(self, z: Array) -> Array:
        """Return the acceleration errors, (M, joints), [rad/s^2 or m/s^2]."""
        return self.middle + self.units(z) * self.radius

    def displacements(self, z: Array) -> Array:
        """Return the displacements of the centres of mass, axes of the bodies, shape (M, n, 3), [m]."""
        n = len(self.names)
        return self.reaches * z[:, n : 4 * n].reshape(-1, n, 3)

    def inertial(self, z: Array) -> Array:
        """Return m, m r and I_o of every body for z (M, size), shape (M, n, 10)."""
        n = len(self.names)
        mass = self.masses.mean(axis=1) + z[:, :n] * np.diff(self.masses)[:, 0] / 2
        r = self.arms + np.einsum("nij,mnj->mni", self.turns, self.displacements(z))
        moments = z[:, self.first_moment :].reshape(-1, n, 3, 3)
        S = np.einsum("nij,mnjk,nlk->mnil", self.turns, moments, self.turns) + r[:, :, :, None] * r[:, :, None, :]
        inertia = np.trace(S, axis1=2, axis2=3)[:, :, None, None] * np.eye(3) - S
        terms = np.stack([inertia[:, :, i, j] for i, j in INERTIA_TERMS], axis=2)
        return mass[:, :, None] * np.concatenate([np.ones_like(r[:, :, :1]), r, terms], axis=2)

    def nominal(self, count: int) -> Array:
        """Return the nominal parameters, (count, size); the second moments are some that the bodies can have."""
        z = np.zeros((count, self.size))
        for k, shape in enumerate(self.shapes):
            first = self.first_moment + 9 * k
            z[:, first : first + 9] = shape.worst(np.zeros((1, 3, 3)), np.zeros((1, 3))).ravel()
        return z

    def with_worst_moments(self, z: Array, price: Array, carried: Flags) -> Array:
        """Return z with the second moments of carried bodies at their worst.

        Args:
            z: Parameters, shape (M, size).
            price: Change of the value per inertial parameter of any body, shape (M, 10).
            carried: Whether each body counts, shape (n,).
        """
        Y, result, displacements = np.zeros((len(z), 3, 3)), z.copy(), self.displacements(z)
        for value, (i, j) in zip(price[:, 4:].T, INERTIA_TERMS, strict=True):
            Y[:, i, j] = Y[:, j, i] = value if i == j else value / 2
        G = np.trace(Y, axis1=1, axis2=2)[:, None, None] * np.eye(3) - Y
        for k, shape in enumerate(self.shapes):
            if carried[k] and not shape.certain:
                first = self.first_moment + 9 * k
                turned = np.einsum("ji,mjk,kl->mil", self.turns[k], G, self.turns[k])
                result[:, first : first + 9] = shape.worst(turned, displacements[:, k]).reshape(-1, 9)
        return result


def box_of(config: Config, joints: int) -> Box:
    certain = with_values(config, {"uncertainty": {}})
    placed, uncertain = placements(config), config.uncertainty
    names, masses, arms, turns, reaches = [], [], [], [], []
    for name, body in bodies(certain).items():
        names.append(name)
        masses.append(uncertain.mass.get(name, body.mass))
        arms.append(body.psi[1:4])
        turns.append(placed[name].rotation if name in placed else np.eye(3))
        reaches.append(uncertain.center_of_mass.get(name, (0.0, 0.0, 0.0)))
    shapes = tuple(shape_of(config, name) for name in names)
    error = acceleration_error(config, joints, 0)
    return Box(tuple(names), *map(np.array, (masses, arms, turns, reaches)), shapes, *error.arrays)


@cache
def _simplices(axes: int) -> tuple[Array, Array]:
    """Return the second moments of n + 1 masses at corners of a cube about its centre, for a mean.

    Returns:
        Weights of the corners of each simplex per (1, mean), shape (K, n + 1, n + 1), and their products of
        coordinates, shape (K, n + 1, n n).
    """
    corners = np.array(list(product((-1.0, 1.0), repeat=axes)))
    inverses, products = [], []
    for some in map(list, combinations(range(len(corners)), axes + 1)):
        equations = np.vstack([np.ones(axes + 1), corners[some].T])
        if abs(np.linalg.det(equations)) > 0.5:  # an integer
            inverses.append(np.linalg.inv(equations))
            products.append((corners[some][:, :, None] * corners[some][:, None, :]).reshape(axes + 1, -1))
    return np.array(inverses), np.array(products)


def _in_box(G: Array, c: Array, half: Array) -> Iterator[Array]:
    """Yield second moments (M, 3, 3) of distributions in a box with centres of mass c (M, 3)."""
    yield np.zeros_like(G)
    for count in (1, 2, 3):
        inverses, products = _simplices(count)
        for spread in map(list, combinations(range(3), count)):
            share = c[:, spread] / half[spread]
            weights = np.hstack([np.ones((len(c), 1)), share]) @ inverses.reshape(-1, count + 1).T
            weights = np.maximum(weights.reshape(len(c), -1, count + 1), 0.0)
            possible = np.abs(weights.sum(axis=2) - 1.0) < SLACK
            moments = np.einsum("mka,kab->mkb", weights, products).reshape(len(c), -1, count, count)
            moments -= (share[:, :, None] * share[:, None, :])[:, None]
            moments *= np.outer(half[spread], half[spread])
            span = half[spread] + np.abs(c[:, spread])
            follow = _following(G, spread, span, half - np.abs(c))
            inner = np.swapaxes(follow, 1, 2) @ G @ follow
            values = np.einsum("mij,mkij->mk", inner, moments)
            choice = np.argmax(np.where(possible, values, -np.inf), axis=1)
            yield follow @ moments[np.arange(len(c)), choice] @ np.swapaxes(follow, 1, 2)


def _following(G: Array, spread: list[int], span: Array, room: Array) -> Array:
    """Return the best place along all axes per place along the spread ones, (M, 3, k).

    Args:
        G: Coefficients, shape (M, 3, 3).
        spread: The spread axes, k of them.
        span: Largest distance from the centre of mass along them, shape (M, k), [m].
        room: Distance from the centre of mass to the surface along all axes, shape (M, 3), [m].
    """
    rest = [axis for axis in range(3) if axis not in spread]
    slopes = np.zeros((len(G), 3, len(spread)))
    slopes[:, spread] = np.eye(len(spread))
    if not rest:
        return slopes
    inner, mixed = G[:, rest][:, :, rest], G[:, rest][:, :, spread]
    falls = inner[:, 0, 0] < 0.0
    if len(rest) == 2:
        falls &= np.linalg.det(inner) > 0.0
    best = -np.linalg.solve(np.where(falls[:, None, None], inner, -np.eye(len(rest))), mixed)
    best *= falls[:, None, None]
    most = np.einsum("mik,mk->mi", np.abs(best), span)
    slopes[:, rest] = best * np.minimum(1.0, room[:, rest] / np.maximum(most, 1e-300))[:, :, None]
    return slopes


def _in_cylinder(G: Array, c: Array, half: Array) -> Iterator[Array]:
    """Yield second moments (M, 3, 3) of distributions in a cylinder with centres of mass c (M, 3)."""
    power = half[0] ** 2 - np.einsum("mi,mi->m", c[:, :2], c[:, :2])  # of the centre of mass: the product of both parts
    upper = 0.5 * (1.0 + c[:, 2] / half[2])
    vertical = np.zeros_like(G)
    vertical[:, 2, 2] = half[2] ** 2 - c[:, 2] ** 2
    yield np.zeros_like(G)
    yield vertical
    for angle in np.arange(DIRECTIONS) * np.pi / DIRECTIONS:
        n = np.array([np.cos(angle), np.sin(angle)])
        along = c[:, :2] @ n
        root = np.sqrt(power + along**2)
        ahead = 0.5 * (1.0 + along / root)  # share of the mass at the end of the chord in direction n
        S = np.zeros_like(G)
        S[:, :2, :2] = power[:, None, None] * np.outer(n, n)
        yield S
        for both in (np.minimum(ahead, upper), np.maximum(0.0, ahead + upper - 1.0)):
            mixed = S + vertical
            covariance = (both - ahead * upper) * 4.0 * root * half[2]
            mixed[:, :2, 2] = mixed[:, 2, :2] = covariance[:, None] * n
            yield mixed
        # A plane that is tilted along the chord, as steep as is best or as fits.
        slope = np.where(G[:, 2, 2] < 0.0, -(G[:, 2, :2] @ n) / np.minimum(G[:, 2, 2], -1e-300), 0.0)
        fits = (half[2] - np.abs(c[:, 2])) / (root + np.abs(along))
        slope = np.clip(slope, -fits, fits)
        tilted = S.copy()
        tilted[:, :2, 2] = tilted[:, 2, :2] = (power * slope)[:, None] * n
        tilted[:, 2, 2] = power * slope**2
        yield tilted
