"""Where plans are executed for a learner: in simulation, or by a person with a robot (`manual`)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from robustopt.config import Config
from robustopt.learning.moments import Moments
from robustopt.processes import cores
from robustopt.runs.experiment import PlanResult
from robustopt.runs.journal import Execution
from robustopt.simulation import TrialOutcome, Workers, execute
from robustopt.simulation.monte_carlo import CHUNK, is_random

JUDGED = 1_000_000_000
"""Number of the first fresh execution: far from those of any learner, so that no plan is judged by what chose it.

All plans are judged by the same numbers, hence in the same worlds.
"""


class Executor(Protocol):
    """Runs a plan and says what came of it."""

    fresh: bool
    """Whether it can run as many executions as one likes, so that a success rate can be estimated."""

    def ahead(self, wanted: int, done: int) -> int:
        """How many executions to run together, of those `wanted` at most, when `done` of the same plan are known."""

    def run(self, planned: PlanResult, numbers: Sequence[int], speed: float) -> list[Execution]:
        """Run executions by their numbers, in this order.

        planned: the plan, with the configuration it was made from; speed: it is run so many times as fast
        """


class Simulated:
    """Executions in the simulated world of the configuration's `execution` section."""

    fresh = True

    def __init__(self, config: Config, workers: Workers | int = 1) -> None:
        self._config = config
        self._alike = config.execution is not None and not is_random(config.execution)
        self._workers = Workers(workers) if isinstance(workers, int) else workers

    def ahead(self, wanted: int, done: int) -> int:
        """Twice as many as are known already: few are wasted on a plan that fails at once. All where all are alike."""
        if self._alike:
            return wanted
        return min(wanted, max(cores(), done), CHUNK * self._workers.processes)

    def run(self, planned: PlanResult, numbers: Sequence[int], speed: float) -> list[Execution]:
        """Run trials with the numbers of the executions; the world is that of the configuration, never of the belief.

        Raises KeyboardInterrupt where it was interrupted.
        """
        executions = execute(planned.plan, self._config, speed=speed, numbers=numbers, workers=self._workers)
        if executions.interrupted:
            raise KeyboardInterrupt
        return [_of(outcome) for outcome in executions.outcomes]


def _of(outcome: TrialOutcome) -> Execution:
    failed = not outcome.success
    errors = Moments.of_means(outcome.error_steps, outcome.error_mean, outcome.error_square)
    return Execution(
        outcome.trial, outcome.success, outcome.status.value, outcome.what,
        outcome.time if failed else None, outcome.s if failed else None, errors,
    )  # fmt: skip
