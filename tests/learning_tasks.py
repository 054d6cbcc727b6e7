"""A quick task for learners, an executor of known threshold, and a planner that does not make a plan twice."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from scenes import FLAT, scene

from robustopt.config import Config
from robustopt.config.load import dump
from robustopt.evidence import Failure, Peak
from robustopt.learning.learner import Belief
from robustopt.learning.moments import Moments
from robustopt.learning.outcomes import Executed
from robustopt.runs import beliefs
from robustopt.runs.journal import Execution
from robustopt.runs.plan_run import PlanResult

THRESHOLD = 0.4

ALGORITHMS = ("bisection", "ilrobs", "acceleration_interval", "ilrobs-calibrated")

CHEAP = {
    "success_rate": 0.5, "confidence": 0.8, "resolution": 0.05, "K_values": [0.0, 1.0], "trials": 10,
}  # fmt: skip
"""Settings with which every learner takes a few plans."""


def task(algorithm: str = "ilrobs", believed: float = 1.0, **learning: Any) -> Config:
    """A block on a slide, friction believed to be 1 and being 0.4."""
    return scene(
        objects={"block": FLAT}, contact={"friction": believed}, solver={"collocation_points": 20},
        learning={"algorithm": algorithm, **CHEAP, **learning},
        execution={"truth": {"friction": THRESHOLD}, "disturbance": {"force_deviation": [0.5, 0.5, 0.0]}},
    )  # fmt: skip


class Threshold:
    """Succeeds where the friction that a plan needs is at most what execution `number` offers, 0.4 + noise Z.

    batch: how many executions it runs together; deviation: of the joint acceleration error; calls: numbers it was
    asked to run; stop: raise KeyboardInterrupt in the place of this call, counted from 0
    """

    def __init__(
        self, noise: float = 0.0, batch: int = 1, deviation: float = 0.3, fresh: bool = True, stop: int | None = None
    ) -> None:
        self.noise, self.batch, self.deviation, self.fresh, self.stop = noise, batch, deviation, fresh, stop
        self.calls: list[tuple[int, ...]] = []

    def ahead(self, wanted: int, done: int) -> int:
        return min(wanted, self.batch)

    def run(self, planned: PlanResult, numbers: Sequence[int], speed: float) -> list[Execution]:
        if self.stop == len(self.calls):
            raise KeyboardInterrupt
        self.calls.append(tuple(numbers))
        assert isinstance(planned.config.contact.friction, float)
        needed = planned.config.contact.friction * speed**2
        return [self._one(number, needed, planned.plan.problem.robot.n) for number in numbers]

    def _one(self, number: int, needed: float, joints: int) -> Execution:
        random = np.random.default_rng(number)
        success = needed <= THRESHOLD + self.noise * random.normal()
        errors = self.deviation * random.normal(size=(50, joints))
        moments = Moments.of_means(50, errors.mean(axis=0).tolist(), (errors**2).mean(axis=0).tolist())
        if success:
            return Execution(number, Executed(True, moments, peaks=(Peak("block", 0.001, 0.002),)))
        return Execution(number, Executed(False, moments, Failure("slid", "block", "tray", 0.1, 0.2)))


_PLANS: dict[tuple[str, str, Belief], PlanResult] = {}


def remember_plans(monkeypatch: Any) -> None:
    """Make every plan of a configuration and a belief once for all tests of a process."""
    make = beliefs.Planner._make

    def remembered(self: beliefs.Planner, belief: Belief) -> PlanResult:
        key = dump(self.config), repr(self.config.robot), belief  # the text has a path relative to the configuration
        if key not in _PLANS:
            _PLANS[key] = make(self, belief)
        return _PLANS[key]

    monkeypatch.setattr(beliefs.Planner, "_make", remembered)
