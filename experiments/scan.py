"""Brute force: find the fastest plan over (mu, K) that reaches a success rate, as a reference for learned plans.

The plans of a grid are visited from the fastest on. Each is executed in the same fresh trials, until it has too many
failures to reach the rate in `trials` executions, or until its rate is certainly below it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from learned import Bench

from robustopt.confidence import upper_bound
from robustopt.config import Config
from robustopt.learning.cost_map import settled
from robustopt.learning.learner import Belief
from robustopt.learning.moments import ErrorInterval
from robustopt.runs.beliefs import Planner, learned_from
from robustopt.runs.executors import Simulated
from robustopt.runs.journal import Journal
from robustopt.runs.store import JOURNAL
from robustopt.simulation.monte_carlo import CHUNK
from robustopt.solvers.batch import BatchPlanner

FRESH = 2_000_000_000
"""Number of the first trial; learned plans are judged by other trials."""

BEYOND_DOUBT = 0.9999
"""Confidence that the rate of a plan that is dropped early is below the required one."""


@dataclass(frozen=True)
class Grid:
    """A grid of plans: friction from low to high, each `ratio` times the one before, and values of K.

    Attributes:
        low: Lowest friction coefficient.
        high: Highest friction coefficient.
        ratio: Factor between neighbouring friction coefficients.
        error: The interval of the acceleration error whose K is varied.
        K_values: Values of K.
    """

    error: ErrorInterval
    low: float
    high: float
    ratio: float = 1.03
    K_values: tuple[float, ...] = (0.0, 1.0, 2.0)

    @property
    def beliefs(self) -> list[Belief]:
        count = int(np.log(self.high / self.low) / np.log(self.ratio)) + 1
        frictions = self.low * self.ratio ** np.arange(count)
        error = self.error
        return [
            Belief(float(mu), ErrorInterval(error.mean, error.deviation, K) if K else ErrorInterval())
            for K in self.K_values
            for mu in frictions
        ]


@dataclass(frozen=True)
class Found:
    """A plan that reaches the rate: its setting, its duration [s], its successes, and its number of trials."""

    belief: Belief
    duration: float
    successes: int
    trials: int


def fastest(
    config: Config, beliefs: Sequence[Belief], rates: Sequence[float], trials: int, name: str, place: Bench
) -> list[Found]:
    """Return the fastest plan for each of the ascending rates; a journal keeps the results for the next run."""
    folder = place.work / name
    folder.mkdir(parents=True, exist_ok=True)
    if not (folder / JOURNAL).is_file():
        Journal.create(folder)
    journal = Journal.open(folder)
    try:
        return list(_Walk(config, beliefs, journal, trials, place).found(rates))
    finally:
        journal.close()


def _settings(beliefs: Sequence[Belief]) -> list[dict[str, float | tuple[float, ...]]]:
    """Return the grid as settings of a batch."""
    section = "uncertainty.joint_acceleration"
    settings: list[dict[str, float | tuple[float, ...]]] = []
    for belief in beliefs:
        setting: dict[str, float | tuple[float, ...]] = dict(belief.parameters)
        if belief.friction is not None:
            setting["contact.friction"] = belief.friction
        if belief.error is not None and not belief.error.is_zero:
            error = {"mean": belief.error.mean, "deviation": belief.error.deviation, "K": belief.error.K}
            setting |= {f"{section}.{key}": value for key, value in error.items()}
        settings.append(setting)
    return settings


class _Walk:
    """A walk through the plans of a grid from the fastest to the slowest."""

    def __init__(self, config: Config, beliefs: Sequence[Belief], journal: Journal, trials: int, place: Bench) -> None:
        self.planner, self.executor = Planner(config, certified=False), Simulated(config, place.workers)
        self.journal, self.trials, self.place = journal, trials, place
        self.plans = self._planned(beliefs)
        durations = settled(np.array([self._duration(i) for i in range(len(self.plans))]))
        self.order = [i for i in np.argsort(durations, kind="stable").tolist() if self.plans[i][1]]

    def _planned(self, beliefs: Sequence[Belief]) -> list[tuple[Belief, float | None]]:
        known = [(entry.belief, entry.duration) for entry in self.journal.entries()]
        assert [belief for belief, _ in known] == list(beliefs[: len(known)])
        new = beliefs[len(known) :]
        self.place.say(f"scan, {len(new)} plans")
        keys = [key for key, _ in beliefs[0].parameters]
        durations = BatchPlanner(learned_from(self.planner.config, keys), self.place.workers).durations(_settings(new))
        for belief, duration in zip(new, durations, strict=True):
            known.append((belief, float(duration) if np.isfinite(duration) else None))
            self.journal.add_plan(*known[-1])
        return known

    def _duration(self, i: int) -> float:
        return self.plans[i][1] or np.inf

    def found(self, rates: Sequence[float]) -> Iterator[Found]:
        at = 0
        for rate in rates:
            while at < len(self.order) and not self._reaches(self.order[at], rate):
                at += 1
            if at == len(self.order):
                raise SystemExit(f"no plan of the grid reaches a success rate of {rate:g}")
            i = self.order[at]
            successes, trials = self._known(i)
            yield Found(self.plans[i][0], self._duration(i), successes, trials)

    def _known(self, i: int) -> tuple[int, int]:
        found = self.journal.judgements(i).values()
        return sum(success for success, _ in found), len(found)

    def _reaches(self, i: int, rate: float) -> bool:
        successes, done = self._known(i)
        while True:
            if done - successes > (1 - rate) * self.trials + 1e-9 or upper_bound(successes, done, BEYOND_DOUBT) < rate:
                return False
            if done == self.trials:
                return True
            self.place.say(f"scan for {rate:g}: {self._duration(i):.4f} s, {successes} of {done}")
            numbers = range(FRESH + done, FRESH + min(done + CHUNK, self.trials))
            self.journal.add_judgements(i, self.executor.run(self.planner.plan(self.plans[i][0]), numbers, 1.0))
            successes, done = self._known(i)
