"""Synthetic problems in several parameters whose cost and success are monotone, with optima known by brute force.

A problem lives in the unit cube, 0 optimistic and 1 conservative. Its cost is made of terms like the duration of a plan
that friction limits, mu^-e with mu falling from 1 to mu0. Its success is the sign of a margin that grows with every
parameter; in a noisy world an execution succeeds with probability Phi(margin / noise).

`TUNING` are the shapes that the learners' constants were chosen on, `HELD_OUT` those that they were not.
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
"""Points of the boundary from which the brute-force search for the optimum starts."""


def orthant(random: np.random.Generator, k: int) -> Margin:
    """Every parameter must reach a threshold of its own."""
    threshold = random.uniform(0.15, 0.85, k)
    return lambda points: np.min(points - threshold, axis=1)


def half_space(random: np.random.Generator, k: int) -> Margin:
    """A weighted mean must reach a threshold: parameters make up for each other."""
    threshold, weights = random.uniform(0.15, 0.85, k), random.dirichlet(3 * np.ones(k))
    return lambda points: (points - threshold) @ weights


def product(random: np.random.Generator, k: int) -> Margin:
    """A power mean of negative exponent: between the two others."""
    threshold, weights = random.uniform(0.15, 0.85, k), random.dirichlet(3 * np.ones(k))
    power = random.uniform(1.5, 4.0)

    def margin(points: Array) -> Array:
        powers = np.maximum(points / threshold, 1e-9) ** -power
        return threshold.mean() * ((powers @ weights) ** (-1 / power) - 1)

    return margin


def staircase(random: np.random.Generator, k: int) -> Margin:
    """One of three corners must be dominated."""
    corners = random.uniform(0.1, 0.9, (3, k))
    return lambda points: np.max([np.min(points - corner, axis=1) for corner in corners], axis=0)


def two_planes(random: np.random.Generator, k: int) -> Margin:
    """Two weighted means must reach thresholds."""
    sides = [half_space(random, k), half_space(random, k)]
    return lambda points: np.minimum(sides[0](points), sides[1](points))


def ball(random: np.random.Generator, k: int) -> Margin:
    """The conservative corner must be within a distance."""
    weights, power = random.dirichlet(3 * np.ones(k)), random.uniform(1.5, 3.0)
    radius = random.uniform(0.25, 0.8)
    return lambda points: radius - (np.maximum(1 - points, 0) ** power @ weights) ** (1 / power)


TUNING = (orthant, half_space, product)
HELD_OUT = (staircase, two_planes, ball)


@dataclass(frozen=True)
class Problem:
    """weights, floor, exponent: of the terms of the cost, (k,); power: of their power mean, 1 a sum, large a maximum;
    noise: deviation of the margin from one execution to the next; rate: success rate that is asked for where noisy
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
        """Cost of points (m, k) -> (m,); 1 at the optimistic corner."""
        friction = 1 - (1 - self.floor) * np.asarray(points)
        terms = friction ** (-self.exponent * self.power)
        return (terms @ self.weights) ** (1 / self.power)

    def success_rate(self, points: Array) -> Array:
        """Probability of success of points (m, k) -> (m,)."""
        margin = self.margin(np.atleast_2d(points))
        return ndtr(margin / self.noise) if self.noise else (margin >= 0).astype(float)

    def execute(self, point: Array, seed: int, number: int) -> bool:
        """Outcome of execution `number` of a seed."""
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
        """The points moved along the diagonal direction, clipped to the cube, onto the boundary of success."""
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
    """The problem of a seed; shapes take turns, and every conservative corner succeeds with probability over `rate`."""
    random = np.random.default_rng([k, seed])
    shape = shapes[seed % len(shapes)]
    while True:
        made = Problem(
            margin=shape(random, k),
            weights=random.dirichlet(2 * np.ones(k)),
            floor=random.uniform(0.05, 0.2, k),
            exponent=random.uniform(0.3, 0.7, k),
            power=1.0 if shapes is TUNING else float(random.choice([1.0, 4.0])),
            noise=noise,
            rate=rate,
            name=shape.__name__,
        )
        corners = np.array([np.zeros(k), np.ones(k)])
        low, high = made.success_rate(corners)
        if low < 0.5 and high > max(rate, 0.5) + 0.4 * (1 - max(rate, 0.5)):
            return made
