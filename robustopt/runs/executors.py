"""Executors of a learner's plans: their protocol, and the simulation; `manual` is a person with a robot."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from robustopt.config import Config
from robustopt.learning.moments import Moments
from robustopt.learning.outcomes import Executed
from robustopt.processes import cores
from robustopt.runs.journal import Execution
from robustopt.runs.plan_run import PlanResult
from robustopt.simulation import TrialOutcome, Workers, execute
from robustopt.simulation.monte_carlo import CHUNK, is_random

JUDGED = 1_000_000_000
"""Number of the first fresh execution: far from all numbers of a learner, so that no plan is judged by the executions
that chose it. All plans are judged by the same numbers, hence in the same worlds."""


class Executor(Protocol):
    """Runner of plans."""

    fresh: bool
    """Whether it can run any number of executions, so that a success rate can be estimated; a robot cannot."""

    def ahead(self, wanted: int, done: int) -> int:
        """Return the number of executions to run together, at most `wanted`.

        Args:
            wanted: number of executions that the learner wants.
            done: number of executions of the same plan so far.
        """

    def run(self, planned: PlanResult, numbers: Sequence[int], speed: float) -> list[Execution]:
        """Run executions by their numbers, in this order.

        Args:
            planned: the plan, with its configuration.
            numbers: of the executions; each has a random stream of its own.
            speed: factor on the speed of the plan.
        """


class Simulated:
    """Executor in the simulated world of the `execution` section."""

    fresh = True

    def __init__(self, config: Config, workers: Workers | int = 1) -> None:
        self._config = config
        self._alike = config.execution is not None and not is_random(config.execution)
        self._workers = Workers(workers) if isinstance(workers, int) else workers

    def ahead(self, wanted: int, done: int) -> int:
        """Return as many as are known already, so that few are wasted on a plan that fails; all if all are alike."""
        if self._alike:
            return wanted
        return min(wanted, max(cores(), done), CHUNK * self._workers.processes)

    def run(self, planned: PlanResult, numbers: Sequence[int], speed: float) -> list[Execution]:
        """Run trials in the world of the configuration, which does not depend on the belief.

        Args:
            planned: the plan and its certificate.
            numbers: numbers of the executions, which are those of the trials.
            speed: factor on the speed of the plan.

        Raises:
            KeyboardInterrupt: the user interrupted the trials.
        """
        executions = execute(planned.plan, self._config, speed=speed, numbers=numbers, workers=self._workers)
        if executions.interrupted:
            raise KeyboardInterrupt
        return [_of(outcome) for outcome in executions.outcomes]


def _of(outcome: TrialOutcome) -> Execution:
    errors = Moments.of_means(outcome.error_steps, outcome.error_mean, outcome.error_square)
    shown = Executed(outcome.success, errors, outcome.failure, outcome.peaks, outcome.error_series)
    return Execution(outcome.trial, shown)
