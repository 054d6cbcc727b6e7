"""Where the boundary of success may lie: a Bayesian model of monotone success, as a cloud of samples (ours).

A sample is a margin over the unit cube that grows with every parameter,

    m(theta) = (sum_j w_j theta_j^(r_j p))^(1/p) - c,

a power mean of warped parameters: p far below 0 is the minimum, every parameter must reach its own threshold; p = 1
lets them make up for each other; p large is the maximum. An execution succeeds with probability Phi(m / sigma), up to
`LAPSE` for what no margin explains, such as a success below a failure. In a world without noise sigma is the misfit of
the family, in a noisy world it is a part of the sample.

Samples are the states of a sequential Monte Carlo sampler: each execution weighs them by its likelihood, and moves that
leave the posterior as it is (Metropolis, with proposals from differences of samples, and from the prior) spread them
again. Every step has a random stream of its own number, so the cloud is a function of the executions alone.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr

from robustopt.learning.parameters import Array, Point

SAMPLES = 256
"""Of the posterior."""

MOVES = 10
"""Of every sample after each execution."""

MISFIT = 0.03
"""sigma in a world without noise, in units of the cube."""

NOISE = 0.06
"""Median of sigma in a noisy world, within a factor of 2 or so, in units of the cube."""

LAPSE = 1e-3
"""Probability that an outcome has nothing to do with the margin."""

LEAST = 1e-4
"""Parameters below it count as so large, since powers of 0 are infinite."""

POWERS = (-25.0, 8.0)
"""Least and largest p: near enough to the minimum and the maximum."""


@dataclass(frozen=True)
class Cloud:
    """z: samples (M, 2 k + 3), standard normal a priori: warps, weights, exponent, level, noise."""

    z: Array
    noisy: bool

    @property
    def k(self) -> int:
        return (self.z.shape[1] - 3) // 2

    @property
    def sigma(self) -> Array:
        """Noise of each sample, (M, 1), in units of the cube."""
        if not self.noisy:
            return np.full((len(self.z), 1), MISFIT)
        return NOISE * np.exp(0.7 * self.z[:, -1:])

    def thinned(self) -> Cloud:
        """Every fourth sample: enough for a first look at many points."""
        return Cloud(self.z[::4], self.noisy)

    def margin(self, points: Array) -> Array:
        """Margin of points (m, k) by every sample -> (M, m)."""
        z, k = self.z, self.k
        warp = np.exp(0.4 * z[:, :k])
        weights = np.exp(0.8 * z[:, k : 2 * k])
        weights /= weights.sum(axis=1, keepdims=True)
        power = _power(z[:, 2 * k])[:, None]
        level = ndtr(z[:, 2 * k + 1])[:, None]
        logs = np.log(np.maximum(points, LEAST)).T
        terms = [power * warp[:, j, None] * logs[j] + np.log(weights[:, j, None]) for j in range(k)]
        most = np.max(terms, axis=0)
        total = most + np.log(sum(np.exp(term - most) for term in terms))
        return np.exp(total / power) - level

    def chances(self, margin: Array) -> Array:
        """Probability of success at a margin, by every sample, (M, m) -> (M, m)."""
        return LAPSE + (1 - 2 * LAPSE) * ndtr(margin / self.sigma)

    def log_likelihood(self, points: Array, outcomes: Array) -> Array:
        """Log probability of outcomes (m,) at points (m, k) by every sample -> (M,)."""
        margin = self.margin(points)
        return np.log(self.chances(np.where(outcomes, margin, -margin))).sum(axis=1)


def _power(z: Array) -> Array:
    """p of a standard normal: 1 in the middle, the minimum and the maximum in its tails; never 0."""
    power = np.clip(1 - 4 * np.maximum(0.3 - z, 0) ** 1.5 + 2 * np.maximum(z - 0.3, 0), *POWERS)
    return np.where(np.abs(power) < 0.05, 0.05, power)


_CLOUDS: OrderedDict[tuple[int, bool, tuple[Point, ...], tuple[bool, ...]], Cloud] = OrderedDict()
"""The clouds that were made last, since a cloud is made from the one before it."""

KEPT = 64
"""Clouds that are kept."""


def cloud(k: int, noisy: bool, points: Sequence[Point], outcomes: Sequence[bool]) -> Cloud:
    """The posterior after executions at points of the unit cube, in their order; the same for the same executions."""
    points, outcomes = tuple(points), tuple(outcomes)

    def key(n: int) -> tuple[int, bool, tuple[Point, ...], tuple[bool, ...]]:
        return k, noisy, points[:n], outcomes[:n]

    known = next((n for n in range(len(points), -1, -1) if key(n) in _CLOUDS), None)
    if known is None:
        _CLOUDS[key(0)] = Cloud(np.random.default_rng([k, 0]).normal(size=(SAMPLES, 2 * k + 3)), noisy)
        known = 0
    found = _CLOUDS[key(known)]
    for n in range(known + 1, len(points) + 1):
        found = _CLOUDS[key(n)] = _moved(found, np.array(points[:n]), np.array(outcomes[:n]))
    while len(_CLOUDS) > KEPT:
        _CLOUDS.popitem(last=False)
    return found


def _moved(before: Cloud, points: Array, outcomes: Array) -> Cloud:
    """The cloud with the last of the executions: weighted, drawn again, and moved."""
    random = np.random.default_rng([before.k, len(points)])
    weights = np.exp(before.log_likelihood(points[-1:], outcomes[-1:]))
    steps = (random.random() + np.arange(len(weights))) / len(weights)
    chosen = np.searchsorted(np.cumsum(weights) / weights.sum(), steps)
    now = Cloud(before.z[np.minimum(chosen, len(weights) - 1)], before.noisy)
    likelihood = now.log_likelihood(points, outcomes)
    for number in range(MOVES):
        z, prior = _differences(now.z, random) if number % 2 else _autoregression(now.z, random)
        moved = Cloud(z, now.noisy)
        proposed = moved.log_likelihood(points, outcomes)
        taken = np.log(random.random(len(z))) < proposed - likelihood + prior
        now = Cloud(np.where(taken[:, None], z, now.z), now.noisy)
        likelihood = np.where(taken, proposed, likelihood)
    return now


def _differences(z: Array, random: np.random.Generator) -> tuple[Array, Array]:
    """Proposals by differences of other samples in some coordinates, and the change of the log prior."""
    one, other = z[random.permutation(len(z))], z[random.permutation(len(z))]
    scale = random.choice([0.3, 0.6, 1.0], size=(len(z), 1))
    some = random.random(z.shape) < 0.5
    moved = z + some * (scale * (one - other) + 0.05 * random.normal(size=z.shape))
    return moved, (np.sum(z**2, axis=1) - np.sum(moved**2, axis=1)) / 2


def _autoregression(z: Array, random: np.random.Generator) -> tuple[Array, Array]:
    """Proposals that shrink to the middle of the prior and add noise, which leaves the prior as it is."""
    step = random.choice([0.1, 0.3, 0.6], size=(len(z), 1))
    return np.sqrt(1 - step**2) * z + step * random.normal(size=z.shape), np.zeros(len(z))
