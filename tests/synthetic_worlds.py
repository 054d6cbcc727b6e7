"""Worlds of known thresholds and known noise, for learners to be tested in without a planner or a robot.

A plan for the friction mu and an acceleration error of half-width w needs the friction

    demand = min(mu (1 - margin w), knee) * speed^2

where `knee` is the friction from which other limits bind, and takes as long as friction or they make it take. One
execution offers the friction threshold + noise * Z, Z standard normal or logistic, and succeeds where that is at least
the demand. So the success rate of a plan, and what a learner does on the way, are known in closed form.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property, lru_cache
from math import exp, sqrt
from typing import Any

import numpy as np
from scipy.special import ndtr

from robustopt.learning.foresight import STEPS, Mechanism
from robustopt.learning.learner import Belief, Executed, Learner, Planned, Request, tell_all
from robustopt.learning.moments import ErrorInterval, Moments
from robustopt.learning.sequential import SequentialTest, Verdict

BLOCK = 1000
"""Executions of a seed whose random numbers are drawn together."""


@dataclass(frozen=True)
class World:
    """threshold, noise, logistic: of the friction that an execution offers; margin: relative loss of demanded friction
    per half-width [1 / (rad/s^2)]; knee: friction from which other limits bind; shortest: duration there [s];
    feasible: (slope, offset), there is a plan where half-width <= slope mu + offset; mean, deviation: of the
    acceleration error of each joint; samples: of it per execution, 0: the moments are those of the distribution
    """

    threshold: float = 0.5
    noise: float = 0.0
    logistic: bool = False
    margin: float = 0.0
    knee: float = 0.33
    shortest: float = 3.23
    feasible: tuple[float, float] = (0.0, np.inf)
    mean: tuple[float, ...] = (0.1, -0.2)
    deviation: tuple[float, ...] = (0.3, 0.5)
    samples: int = 0

    def effective(self, belief: Belief) -> float:
        """Friction that a plan may use once the margin for acceleration errors is taken off, at most the knee."""
        return min(friction(belief) * (1 - self.margin * half_width(belief)), self.knee)

    def duration(self, belief: Belief) -> float | None:
        slope, offset = self.feasible
        use = self.effective(belief)
        if half_width(belief) > slope * friction(belief) + offset or use <= 0:
            return None
        return self.shortest * sqrt(self.knee / use)

    def success_rate(self, belief: Belief, speed: float = 1.0) -> float:
        demand = self.effective(belief) * speed**2
        if self.noise == 0:
            return float(demand <= self.threshold)
        z = (self.threshold - demand) / self.noise
        return 1 / (1 + exp(-z)) if self.logistic else float(ndtr(z))

    def execute(self, belief: Belief, speed: float, number: int, seed: int) -> Executed:
        """Execution `number` of the seed; it depends on nothing else but the plan."""
        success = uniform(seed, number) < self.success_rate(belief, speed)
        return Executed(bool(success), self._errors(number, seed))

    def _errors(self, number: int, seed: int) -> Moments:
        if self.samples == 0:
            return self.exact
        draws = np.random.default_rng([seed, number]).normal(self.mean, self.deviation, (self.samples, len(self.mean)))
        return Moments.of_means(self.samples, draws.mean(axis=0).tolist(), (draws**2).mean(axis=0).tolist())

    @cached_property
    def exact(self) -> Moments:
        squares = [u * u + d * d for u, d in zip(self.mean, self.deviation, strict=True)]
        return Moments.of_means(1000, self.mean, squares)


def cost(values: np.ndarray) -> np.ndarray:
    """f* of frictions (m, k) -> (m,) [s], where friction alone binds; inf at no friction."""
    with np.errstate(divide="ignore"):
        return np.asarray(World.shortest * np.sqrt(World.knee / np.mean(values, axis=1)))


class Forecast:
    """Foresight of the worlds: one object slides, the sooner the less friction it finds."""

    mechanisms = (Mechanism("block", ("slid",)),)

    def strengths(self, values: np.ndarray) -> np.ndarray:
        return np.log(np.maximum(values.mean(axis=1, keepdims=True), 1e-3))

    def needed(self, values: np.ndarray) -> np.ndarray:
        demand = np.minimum(values.mean(axis=1), World.knee)
        rise = np.minimum(np.linspace(0.0, 2.0, STEPS + 1), 1.0)
        return np.log(np.maximum(demand[:, None] * rise, 1e-3))[..., None]


CONFIGURED = 0.3
"""Friction of a belief that leaves it as configured."""


def friction(belief: Belief) -> float:
    """Of several parameters, their mean: they make up for each other."""
    if belief.parameters:
        return float(np.mean([value for _, value in belief.parameters]))
    return CONFIGURED if belief.friction is None else belief.friction


def half_width(belief: Belief) -> float:
    return max((belief.error or ErrorInterval()).half_width, default=0.0)


def uniform(seed: int, number: int) -> float:
    return float(_block(seed, number // BLOCK)[number % BLOCK])


@lru_cache(maxsize=4)
def _block(seed: int, block: int) -> np.ndarray:
    return np.random.default_rng([seed, block]).random(BLOCK)


def answer(world: World, request: Request, seed: int = 0) -> Planned | Executed:
    """The outcome of what a learner asks for."""
    if request.executions == 0:
        return Planned(world.duration(request.belief))
    return world.execute(request.belief, request.speed, request.first, seed)


def states(learner: Learner[Any], world: World, seed: int = 0) -> Iterator[Any]:
    """Every state from the initial to the final one."""
    state = learner.initial()
    yield state
    while (request := learner.ask(state)) is not None:
        state = learner.tell(state, answer(world, request, seed))
        yield state


def run(learner: Learner[Any], world: World, seed: int = 0, start: Any = None) -> Any:
    """The final state."""
    state = learner.initial() if start is None else start
    while (request := learner.ask(state)) is not None:
        state = learner.tell(state, answer(world, request, seed))
    return state


def run_batched(learner: Learner[Any], world: World, size: Callable[[], int], seed: int = 0) -> tuple[Any, int]:
    """The final state when executions are run ahead in batches, and how many were run."""
    state, ran = learner.initial(), 0
    while (request := learner.ask(state)) is not None:
        if request.executions == 0:
            state = learner.tell(state, answer(world, request))
            continue
        count = min(size(), request.executions)
        batch = [world.execute(request.belief, request.speed, request.first + i, seed) for i in range(count)]
        state, used = tell_all(learner, state, batch)
        ran += count
        assert used <= count
    return state, ran


# Laws: exact probabilities, by recursion over decisions -----------------------------------------------------


def acceptance_probability(test: SequentialTest, rate: float, verdict: Verdict = Verdict.ACCEPTED) -> float:
    """Exact probability that a sequential test ends with the verdict when the success rate is `rate`."""
    alive, total = {0: 1.0}, 0.0
    for n in range(test.limit + 1):
        following: dict[int, float] = {}
        for successes, probability in alive.items():
            found = test.verdict(successes, n - successes)
            total += probability * (found is verdict)
            if found is Verdict.OPEN:
                following[successes + 1] = following.get(successes + 1, 0.0) + probability * rate
                following[successes] = following.get(successes, 0.0) + probability * (1 - rate)
        alive = following
    assert not alive
    return total


Law = dict[float | None, float]
"""Probability of each coefficient of friction that a learner may return; None: no success."""


def bisection_law(world: World, low: float, high: float, delta: float, epsilon: float) -> Law:
    """What Alg. 1 returns, from the text of the paper: every decision with its probability."""
    law: Law = {}

    def decide(mu: float, low: float, high: float, best: float | None, probability: float) -> None:
        if probability == 0:
            return
        plain, fast = (world.success_rate(Belief(mu), speed) for speed in (1.0, 1.0 + epsilon))
        law[mu] = law.get(mu, 0.0) + probability * plain * (1 - fast)
        for chance, ends, found in ((1 - plain, (low, mu), best), (plain * fast, (mu, high), mu)):
            if ends[1] - ends[0] > delta:
                decide(sum(ends) / 2, *ends, found, probability * chance)
            else:
                law[found] = law.get(found, 0.0) + probability * chance

    decide(high, low, high, None, 1.0)
    return law


def ilrobs_law(world: World, K: float, executions: int, delta: float, try_upper: bool) -> tuple[Law, float]:
    """mu_low that Alg. 2 ends with on [0, 1], and its mean number of executions, errors being those of the world."""
    law: Law = {}
    later = ErrorInterval(world.mean, world.deviation, K)

    def decide(mu: float, low: float, high: float, best: float | None, error: ErrorInterval, p: float) -> float:
        rate = world.success_rate(Belief(mu, error))
        passed = rate**executions
        ran = executions if rate == 1 else (1 - passed) / (1 - rate)
        for chance, ends, found in ((1 - passed, (low, mu), best), (passed, (mu, high), mu)):
            if ends[1] - ends[0] > delta:
                ran += chance * decide(sum(ends) / 2, *ends, found, later, p * chance)
            else:
                law[found] = law.get(found, 0.0) + p * chance
        return ran

    mean = decide(1.0 if try_upper else 0.5, 0.0, 1.0, None, ErrorInterval(), 1.0)
    return law, mean
