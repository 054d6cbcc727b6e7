"""Posterior of the actual parameters of a world, from executions and a forecast of their failures (ours).

A sample is a possible world: actual values of the parameters, and the error of the forecast. An object survives a
mechanism as long as the strength L of the interface exceeds the strength R(t) that the plan needs up to the time t
(`foresight`), both as logarithms. The error of the forecast consists of a bias of each L, of a second bias of strengths
that follow from the time of a failure, of a spread sigma from one execution to the next, and of a lag of the failures
behind the plan; all are estimated with the parameters.

    success                  product over all mechanisms of Phi((L - R(end)) / sigma)
    failure of one at t      N(R(t - lag); L, tau) times the product over all others of Phi((L - R(t - lag)) / tau)

where tau contains the uncertainty of the time. The name of a failure may be wrong (`WRONG`), and an execution may have
another cause altogether (`LAPSE`). If the time is unknown, only the end counts. The samples come from the same
sequential Monte Carlo sampler as those of `boundary`, and are a function of the executions alone.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import log_ndtr, ndtr

from robustopt.arrays import Array
from robustopt.evidence import Failure
from robustopt.learning.boundary import autoregression, differences, resampled
from robustopt.learning.foresight import STEPS, NeedMap, blame
from robustopt.learning.parameters import Parameter, Point, values

SAMPLES = 256
"""Number of samples of the posterior."""

MOVES = 12
"""Number of moves of every sample after each execution."""

BIAS = 0.06
"""Prior standard deviation of the bias of each strength, of its logarithm."""

SPREAD, NOISE = 0.005, 0.02
"""Prior median of sigma where executions do not vary, and where they do, known within a factor of about 2."""

LAG = 0.005
"""Prior mean and standard deviation of the lag [s]: drives and contacts yield before they hold."""

SHAKE = 0.004
"""Standard deviation of the time of a failure about its forecast [s]."""

LATE = 0.04
"""Prior standard deviation of the bias of the strength at the time of a failure, of its logarithm: slow creep."""

LOOSE = 0.02
"""Prior median of the remaining error of this strength."""

WRONG = 0.1
"""Probability that the name of a failure is wrong."""

LAPSE = 0.01
"""Probability that an outcome is unrelated to the mechanisms of the model."""


@dataclass(frozen=True)
class Run:
    """An execution.

    Attributes:
        point: point of the unit cube that it was planned for (k,).
        duration: duration of the plan [s].
        failure: its failure, None for a success.
    """

    point: Point
    duration: float
    failure: Failure | None


@dataclass(frozen=True)
class Worlds:
    """Samples of the world.

    Attributes:
        z: samples (J, k + M + 4), standard normal a priori: parameters, biases of the strengths, bias, lag and error at
            the time of a failure, sigma.
        parameters: the k parameters.
        needs: strength that plans need.
        noisy: whether executions of one plan vary.
    """

    z: Array
    parameters: tuple[Parameter, ...]
    needs: NeedMap
    noisy: bool

    @property
    def points(self) -> Array:
        """Actual parameters of each sample, as points of the unit cube (J, k)."""
        return np.asarray(ndtr(self.z[:, : len(self.parameters)]))

    @property
    def sigma(self) -> Array:
        """Spread from one execution to the next of each sample (J, 1)."""
        return np.asarray((NOISE if self.noisy else SPREAD) * np.exp(0.7 * self.z[:, -1:]))

    @property
    def loose(self) -> Array:
        """Error of the strength at the time of a failure, of each sample (J, 1)."""
        return np.asarray(LOOSE * np.exp(0.7 * self.z[:, -2:-1]))

    @property
    def strengths(self) -> Array:
        """Strength of each mechanism with its bias (J, M)."""
        k = len(self.parameters)
        actual = self.needs.foresight.strengths(values(self.parameters, self.points))
        return np.asarray(actual + BIAS * self.z[:, k:-4])

    def thinned(self) -> Worlds:
        """Return every fourth sample, which is enough for a rough estimate at many points."""
        return replace(self, z=self.z[::4])

    def margin(self, points: Array) -> Array:
        """Return the least margin of all mechanisms with which each sample survives the plans of points.

        Args:
            points: points of the unit cube (m, k).

        Returns:
            Margins (J, m).
        """
        return np.asarray((self.strengths[:, None] - self.needs.guide(points)[None]).min(axis=2))

    def log_likelihood(self, tested: Sequence[Run]) -> Array:
        """Return the logarithm of the probability of executions, by every sample, (J,).

        Args:
            tested: the executions.
        """
        strengths, sigma = self.strengths, self.sigma
        lag, late = LAG * (1.0 + self.z[:, -3]), LATE * self.z[:, -4, None]
        total = np.zeros(len(self.z))
        for item in tested:
            needed = self.needs.exact(item.point)
            if np.isnan(needed).any():
                continue  # no forecast of this plan
            if item.failure is None:
                logs = log_ndtr((strengths - needed[-1]) / sigma).sum(axis=1)
            elif item.failure.t is None:
                logs = _failed_sometime(item.failure, strengths - needed[-1], sigma, self.needs)
            else:
                logs = _failed_at(item, needed, strengths + late, np.hypot(sigma, self.loose), lag, self.needs)
            total += np.logaddexp(np.log1p(-LAPSE) + logs, np.log(LAPSE / 2))
        return total


def _weights(failure: Failure, needs: NeedMap) -> Array | None:
    """Return the chance that each mechanism is the cause (M,); None if it is none of them."""
    named = blame(failure, needs.foresight.mechanisms)
    return (1.0 - WRONG) * named + WRONG / len(named) if named.any() else None


def _failed_sometime(failure: Failure, margins: Array, sigma: Array, needs: NeedMap) -> Array:
    """Return the log-probability that a mechanism of those blamed fails before the end, (J,)."""
    weights = _weights(failure, needs)
    if weights is None:
        return np.zeros(len(margins))
    chance = ndtr(-margins / sigma) @ weights
    return np.asarray(np.log(np.maximum(chance, 1e-300)))


def _failed_at(item: Run, needed: Array, strengths: Array, error: Array, lag: Array, needs: NeedMap) -> Array:
    """Return the log-density of a failure at its time, (J,)."""
    assert item.failure is not None
    assert item.failure.t is not None
    step = item.duration / STEPS
    place = np.clip((item.failure.t - lag) / step, 0.0, STEPS)
    i = np.minimum(place.astype(int), STEPS - 1)
    share = (place - i)[:, None]
    then = (1.0 - share) * needed[i] + share * needed[i + 1]
    wide = max(round(SHAKE / step), 1)
    slope = 0.5 * (needed[np.minimum(i + wide, STEPS)] - needed[np.maximum(i - wide, 0)])
    tau = np.hypot(error, slope)
    distance = (strengths - then) / tau
    survives, weights = log_ndtr(distance), _weights(item.failure, needs)
    if weights is None:  # all objects survived until then
        return np.asarray(survives.sum(axis=1))
    density = -0.5 * distance**2 - np.log(tau) + survives.sum(axis=1, keepdims=True) - survives
    most = density.max(axis=1, keepdims=True)
    chance = np.exp(density - most) @ weights
    return np.asarray(most[:, 0] + np.log(chance))


Posteriors = OrderedDict[tuple[Run, ...], Worlds]
"""The latest posteriors by their executions; each is made from the previous one."""

KEPT = 64
"""Number of posteriors that are kept."""


def posterior(prior: Worlds, tested: Sequence[Run], known: Posteriors) -> Worlds:
    """Return the posterior after executions, which is the same for the same executions.

    Args:
        prior: samples of the prior.
        tested: the executions, in order.
        known: posteriors of the same prior, to which the new ones are added.
    """
    tested = tuple(tested)
    done = next((n for n in range(len(tested), 0, -1) if tested[:n] in known), 0)
    found = known[tested[:done]] if done else prior
    for n in range(done + 1, len(tested) + 1):
        found = known[tested[:n]] = _moved(found, tested[:n])
    while len(known) > KEPT:
        known.popitem(last=False)
    return found


def prior(parameters: tuple[Parameter, ...], needs: NeedMap, noisy: bool) -> Worlds:
    """Return samples of the prior.

    Args:
        parameters: the k parameters.
        needs: strength that plans need.
        noisy: whether executions of one plan vary.
    """
    size = (SAMPLES, len(parameters) + len(needs.foresight.mechanisms) + 4)
    return Worlds(np.random.default_rng([len(parameters), 2]).normal(size=size), parameters, needs, noisy)


def _moved(before: Worlds, tested: Sequence[Run]) -> Worlds:
    """Return the posterior with the last of the executions: weight the samples, resample, and move them."""
    random = np.random.default_rng([len(before.parameters), len(tested), 2])
    now = replace(before, z=resampled(before.z, before.log_likelihood(tested[-1:]), random))
    likelihood = now.log_likelihood(tested)
    for number in range(MOVES):
        z, prior = differences(now.z, random) if number % 2 else autoregression(now.z, random)
        proposed = replace(now, z=z).log_likelihood(tested)
        taken = np.log(random.random(len(z))) < proposed - likelihood + prior
        now = replace(now, z=np.where(taken[:, None], z, now.z))
        likelihood = np.where(taken, proposed, likelihood)
    return now
