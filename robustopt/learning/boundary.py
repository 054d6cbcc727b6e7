"""Bayesian model of the boundary between success and failure, represented by samples (ours).

A sample is a margin over the unit cube that grows with every parameter, up to small bends h,

    m(theta) = (sum_j w_j theta_j^(r_j p))^(1/p) - c + h(theta),

with a power mean of warped parameters. For p far below 0 it is the minimum: every parameter must reach its own
threshold. For p = 1 the parameters compensate for one another. For large p it is the maximum. The bends are waves with
random weights, nearly a Gaussian process, for shapes outside this family. Neighbouring points have nearly the same
bend, so many failures in one place do not count as independent evidence against the whole sample. An execution succeeds
with probability Phi(m / sigma), except for outcomes that no margin explains, such as a success below a failure; these
have the probability `LAPSE`. In a world without noise sigma is a small remaining misfit; in a noisy world it is part of
the sample.

The samples come from a sequential Monte Carlo sampler. Each execution weights them by its likelihood. Then moves that
preserve the posterior (Metropolis, with proposals from differences of samples and from the prior) spread them again.
Every step has its own random stream, so the samples are a function of the executions alone.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr

from robustopt.arrays import Array, Flags
from robustopt.learning.parameters import Point

SAMPLES = 256
"""Number of samples of the posterior."""

MOVES = 10
"""Number of moves of every sample after each execution."""

MISFIT = 0.01
"""sigma in a world without noise, in units of the cube."""

BEND = 0.04
"""Standard deviation of the bends, in units of the cube."""

SPAN = 0.3
"""Length over which the bends change, in units of the cube."""

BENDS = 16
"""Number of waves that make up the bends."""

NOISE = 0.06
"""Prior median of sigma in a noisy world, known within a factor of about 2, in units of the cube."""

LAPSE = 1e-3
"""Probability of an outcome that is independent of the margin."""

LEAST = 1e-4
"""Smallest coordinate in a power mean, because negative powers of 0 are infinite."""

POWERS = (-25.0, 8.0)
"""Smallest and largest p: close enough to the minimum and the maximum."""


@dataclass(frozen=True)
class Cloud:
    """Samples of the boundary.

    Attributes:
        z: samples (M, 2 k + 3 + BENDS), standard normal a priori: warps, weights, exponent, level, noise, bends.
        noisy: whether executions of one plan vary.
    """

    z: Array
    noisy: bool

    @property
    def k(self) -> int:
        """Number of parameters."""
        return (self.z.shape[1] - 3 - BENDS) // 2

    @property
    def sigma(self) -> Array:
        """Standard deviation of the noise of each sample, (M, 1), in units of the cube."""
        if not self.noisy:
            return np.full((len(self.z), 1), MISFIT)
        return NOISE * np.exp(0.7 * self.z[:, 2 * self.k + 2, None])

    def thinned(self) -> Cloud:
        """Return every fourth sample, which is enough for a rough estimate at many points."""
        return Cloud(self.z[::4], self.noisy)

    def margin(self, points: Array) -> Array:
        """Return the margin of points by every sample.

        Args:
            points: points of the unit cube, (m, k).

        Returns:
            Margins, (M, m), in units of the cube.
        """
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
        return np.exp(total / power) - level + BEND * z[:, 2 * k + 3 :] @ _waves(points).T

    def chances(self, margin: Array) -> Array:
        """Return the probability of success at a margin, by every sample.

        Args:
            margin: margins, (M, m), in units of the cube.

        Returns:
            Probabilities, (M, m).
        """
        return LAPSE + (1 - 2 * LAPSE) * ndtr(margin / self.sigma)

    def log_likelihood(self, points: Array, outcomes: Flags) -> Array:
        """Return the logarithm of the probability of outcomes, by every sample.

        Args:
            points: executed points, (m, k).
            outcomes: success of each execution, (m,).

        Returns:
            Logarithms, (M,).
        """
        margin = self.margin(points)
        return np.log(self.chances(np.where(outcomes, margin, -margin))).sum(axis=1)


def _waves(points: Array) -> Array:
    """Return the waves at points (m, k), (m, BENDS); their sum with normal weights is nearly a Gaussian process."""
    k = points.shape[1]
    random = np.random.default_rng([k, 1])
    frequency, phase = random.normal(0, 1 / SPAN, (k, BENDS)), random.uniform(0, 2 * np.pi, BENDS)
    return np.sqrt(2 / BENDS) * np.cos(points @ frequency + phase)


def _power(z: Array) -> Array:
    """Return p for a standard normal z: 1 in the middle, towards the minimum and the maximum in the tails, never 0."""
    power = np.clip(1 - 4 * np.maximum(0.3 - z, 0) ** 1.5 + 2 * np.maximum(z - 0.3, 0), *POWERS)
    return np.where(np.abs(power) < 0.05, 0.05, power)


_CLOUDS: OrderedDict[tuple[int, bool, tuple[Point, ...], tuple[bool, ...]], Cloud] = OrderedDict()
"""The latest clouds, because each cloud is made from the previous one."""

KEPT = 64
"""Number of clouds that are kept."""


def cloud(k: int, noisy: bool, points: Sequence[Point], outcomes: Sequence[bool]) -> Cloud:
    """Return the posterior after executions, which is the same for the same executions.

    Args:
        k: number of parameters.
        noisy: whether executions of one plan vary.
        points: executed points of the unit cube, in order.
        outcomes: success of each execution.

    Returns:
        Samples of the posterior.
    """
    points, outcomes = tuple(points), tuple(outcomes)

    def key(n: int) -> tuple[int, bool, tuple[Point, ...], tuple[bool, ...]]:
        return k, noisy, points[:n], outcomes[:n]

    known = next((n for n in range(len(points), -1, -1) if key(n) in _CLOUDS), None)
    if known is None:
        _CLOUDS[key(0)] = Cloud(np.random.default_rng([k, 0]).normal(size=(SAMPLES, 2 * k + 3 + BENDS)), noisy)
        known = 0
    found = _CLOUDS[key(known)]
    for n in range(known + 1, len(points) + 1):
        found = _CLOUDS[key(n)] = _moved(found, np.array(points[:n]), np.array(outcomes[:n]))
    while len(_CLOUDS) > KEPT:
        _CLOUDS.popitem(last=False)
    return found


def _moved(before: Cloud, points: Array, outcomes: Flags) -> Cloud:
    """Return the posterior with the last of the executions: weight the samples, resample, and move them."""
    random = np.random.default_rng([before.k, len(points)])
    now = Cloud(resampled(before.z, before.log_likelihood(points[-1:], outcomes[-1:]), random), before.noisy)
    likelihood = now.log_likelihood(points, outcomes)
    for number in range(MOVES):
        z, prior = differences(now.z, random) if number % 2 else autoregression(now.z, random)
        moved = Cloud(z, now.noisy)
        proposed = moved.log_likelihood(points, outcomes)
        taken = np.log(random.random(len(z))) < proposed - likelihood + prior
        now = Cloud(np.where(taken[:, None], z, now.z), now.noisy)
        likelihood = np.where(taken, proposed, likelihood)
    return now


def resampled(z: Array, log_weights: Array, random: np.random.Generator) -> Array:
    """Return samples (M, d) drawn again by their weights, whose logarithms are given (M,)."""
    weights = np.exp(log_weights)
    steps = (random.random() + np.arange(len(weights))) / len(weights)
    chosen = np.searchsorted(np.cumsum(weights) / weights.sum(), steps)
    return np.asarray(z[np.minimum(chosen, len(weights) - 1)])


def differences(z: Array, random: np.random.Generator) -> tuple[Array, Array]:
    """Propose steps along differences of other samples, in some coordinates; return the change of the log prior too."""
    one, other = z[random.permutation(len(z))], z[random.permutation(len(z))]
    scale = random.choice([0.3, 0.6, 1.0], size=(len(z), 1))
    some = random.random(z.shape) < 0.5
    moved = z + some * (scale * (one - other) + 0.05 * random.normal(size=z.shape))
    return moved, (np.sum(z**2, axis=1) - np.sum(moved**2, axis=1)) / 2


def autoregression(z: Array, random: np.random.Generator) -> tuple[Array, Array]:
    """Propose steps towards the middle of the prior with added noise, which preserve the prior."""
    step = random.choice([0.1, 0.3, 0.6], size=(len(z), 1))
    return np.sqrt(1 - step**2) * z + step * random.normal(size=z.shape), np.zeros(len(z))
