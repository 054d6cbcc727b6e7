"""Synthetic problems in several parameters whose cost and success are monotone, with optima known by brute force.

A problem lives in the unit cube, 0 optimistic and 1 conservative. Its cost is made of terms like the duration of a plan
that friction limits, mu^-e with mu falling from 1 to mu0. Its success is the sign of a margin that grows with every
parameter; in a noisy world an execution succeeds with probability Phi(margin / noise).

The learners' constants were chosen on the shapes in `TUNING`, and not on the shapes in `HELD_OUT`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from statistics import NormalDist

import numpy as np
from scipy.special import ndtr

Array = np.ndarray
Margin = Callable[[Array], Array]
"""Margin of points (m, k) -> (m,), in units of the parameters."""

SCATTER = 20_000
"""Number of points of the boundary from which the brute-force search for the optimum starts."""


def orthant(random: np.random.Generator, k: int) -> Margin:
    """Require every parameter to reach a threshold of its own."""
    threshold = random.uniform(0.15, 0.85, k)
    return lambda points: np.min(points - threshold, axis=1)


def half_space(random: np.random.Generator, k: int) -> Margin:
    """Require a weighted mean to reach a threshold: parameters make up for each other."""
    threshold, weights = random.uniform(0.15, 0.85, k), random.dirichlet(3 * np.ones(k))
    return lambda points: (points - threshold) @ weights


def product(random: np.random.Generator, k: int) -> Margin:
    """Require a power mean of negative exponent to reach a threshold, a shape between the two others."""
    threshold, weights = random.uniform(0.15, 0.85, k), random.dirichlet(3 * np.ones(k))
    power = random.uniform(1.5, 4.0)

    def margin(points: Array) -> Array:
        powers = np.maximum(points / threshold, 1e-9) ** -power
        return threshold.mean() * ((powers @ weights) ** (-1 / power) - 1)

    return margin


def staircase(random: np.random.Generator, k: int) -> Margin:
    """Require a point to dominate one of three corners."""
    corners = random.uniform(0.1, 0.9, (3, k))
    return lambda points: np.max([np.min(points - corner, axis=1) for corner in corners], axis=0)


def two_planes(random: np.random.Generator, k: int) -> Margin:
    """Require two weighted means to reach thresholds."""
    sides = [half_space(random, k), half_space(random, k)]
    return lambda points: np.minimum(sides[0](points), sides[1](points))


def ball(random: np.random.Generator, k: int) -> Margin:
    """Require a point to be within a distance of the conservative corner."""
    weights, power = random.dirichlet(3 * np.ones(k)), random.uniform(1.5, 3.0)
    radius = random.uniform(0.25, 0.8)
    return lambda points: radius - (np.maximum(1 - points, 0) ** power @ weights) ** (1 / power)


def both(random: np.random.Generator, k: int) -> Margin:
    """Require every parameter to reach a threshold of its own, and a weighted mean to reach another one."""
    sides = [orthant(random, k), half_space(random, k)]
    return lambda points: np.minimum(sides[0](points) + 0.15, sides[1](points))


def either(random: np.random.Generator, k: int) -> Margin:
    """Require thresholds of all parameters, or one of a weighted mean: the feasible region is not convex."""
    sides = [orthant(random, k), half_space(random, k)]
    return lambda points: np.maximum(sides[0](points), sides[1](points) - 0.1)


def saturating(random: np.random.Generator, k: int) -> Margin:
    """Require a weighted mean of S-shaped terms: each parameter helps most near its threshold, then hardly."""
    threshold, weights = random.uniform(0.15, 0.85, k), random.dirichlet(3 * np.ones(k))
    width, least = random.uniform(0.1, 0.3, k), random.uniform(0.4, 0.7)
    return lambda points: 0.5 * ((1 / (1 + np.exp((threshold - points) / width))) @ weights - least)


TUNING = (orthant, half_space, product, staircase, two_planes, ball)
HELD_OUT = (both, either, saturating)


@dataclass(frozen=True)
class Problem:
    """A problem in the unit cube.

    Attributes:
        margin: margin of success.
        weights: weights of the terms of the cost, (k,).
        floor: coefficient mu0 of each term, (k,).
        exponent: exponent e of each term, (k,).
        power: exponent of their power mean: 1 is a sum, a large one a maximum.
        noise: standard deviation of the margin from one execution to the next.
        rate: required success rate of a noisy problem.
        name: name of the shape.
    """

    margin: Margin
    weights: Array
    floor: Array
    exponent: Array
    power: float = 1.0
    noise: float = 0.0
    rate: float = 0.5
    name: str = field(default="", compare=False)

    @property
    def k(self) -> int:
        return len(self.weights)

    def cost(self, points: Array) -> Array:
        """Return the cost of points (m, k), (m,); 1 at the optimistic corner."""
        friction = 1 - (1 - self.floor) * np.asarray(points)
        terms = friction ** (-self.exponent * self.power)
        return (terms @ self.weights) ** (1 / self.power)

    def success_rate(self, points: Array) -> Array:
        """Return the probability of success of points (m, k), (m,)."""
        margin = self.margin(np.atleast_2d(points))
        return ndtr(margin / self.noise) if self.noise else (margin >= 0).astype(float)

    def execute(self, point: Array, seed: int, number: int) -> bool:
        """Return the outcome of execution `number` of a seed."""
        return bool(np.random.default_rng([seed, number]).random() < self.success_rate(point)[0])

    @cached_property
    def optimum(self) -> float:
        """Least cost of a point whose success rate is at least `rate`, by brute force on the boundary."""
        random = np.random.default_rng(0)
        points = self._boundary(random.random((SCATTER, self.k)))
        for scale in (0.1, 0.03, 0.01, 0.003, 0.001, 0.0003):
            best = points[np.argsort(self.cost(points))[:20]]
            moved = best[:, None] + random.normal(0, scale, (len(best), SCATTER // 100, self.k))
            points = np.vstack([best, self._boundary(np.clip(moved.reshape(-1, self.k), 0, 1))])
        return float(self.cost(points).min())

    def _boundary(self, points: Array) -> Array:
        """Move points along the diagonal direction, clipped to the cube, onto the boundary of success."""
        least = NormalDist().inv_cdf(self.rate) * self.noise
        low, high = np.full(len(points), -1.0), np.ones(len(points))
        for _ in range(45):
            middle = (low + high) / 2
            reached = self.margin(np.clip(points + middle[:, None], 0, 1)) >= least
            low, high = np.where(reached, low, middle), np.where(reached, middle, high)
        return np.clip(points + high[:, None], 0, 1)


def problem(
    k: int, seed: int, shapes: tuple[Callable[[np.random.Generator, int], Margin], ...] = HELD_OUT,
    noise: float = 0.0, rate: float = 0.5,
) -> Problem:  # fmt: skip
    """Return the problem of a seed; shapes take turns, and the conservative corner has a success rate over `rate`."""
    random = np.random.default_rng([k, seed])
    shape = shapes[seed % len(shapes)]
    while True:
        made = Problem(
            margin=shape(random, k),
            weights=random.dirichlet(2 * np.ones(k)),
            floor=random.uniform(0.05, 0.2, k),
            exponent=random.uniform(0.3, 0.7, k),
            power=float(random.choice([1.0, 4.0] if shapes is TUNING else [1.0, 2.0, 8.0])),
            noise=noise,
            rate=rate,
            name=shape.__name__,
        )
        corners = np.array([np.zeros(k), np.ones(k)])
        low, high = made.success_rate(corners)
        if low < 0.5 and high > max(rate, 0.5) + 0.4 * (1 - max(rate, 0.5)):
            return made
