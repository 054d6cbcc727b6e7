"""Estimation of the joint acceleration error at a fixed coefficient of friction (paper, top of page 8)."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import ClassVar

from robustopt.errors import ConfigError
from robustopt.learning.learner import Learner, Row, State, Trial
from robustopt.learning.moments import ErrorInterval, endpoint_change, interval_of, shrunk
from robustopt.learning.outcomes import Belief, End, Result
from robustopt.learning.settings import require_positive


@dataclass(frozen=True)
class AccelerationIntervalState(State):
    """The state of the iteration on the error interval.

    Attributes:
        interval: [U - K Delta, U + K Delta] of the latest executions.
        change: largest distance by which an end of the interval moved last [rad/s^2]; None before the first execution.
        iteration: number of the current iteration, from 1.
    """

    interval: ErrorInterval = field(default_factory=ErrorInterval)
    change: float | None = None
    iteration: int = 1


@dataclass(frozen=True, kw_only=True)
class AccelerationInterval(Learner[AccelerationIntervalState]):
    """A learner that plans for an error interval, executes, and estimates the interval again, until it is stable.

    The interval is U -+ K Delta of the latest executions. It is stable if no end of any joint's interval moved by
    `threshold` or more in the last iteration. Convergence is not proven, so the number of iterations is limited (our
    choice). The interval does not depend on the success of the executions; the best plan is the latest one whose
    executions all succeeded.

    Attributes:
        K: number of standard deviations.
        friction: coefficient of friction to plan with; None for the configured one.
        start: interval of the first plan.
        executions: number of executions of each plan.
        threshold: largest change of a stable interval [rad/s^2].
        iterations: largest number of iterations.
    """

    name: ClassVar[str] = "acceleration_interval"
    state_type: ClassVar[type[State]] = AccelerationIntervalState

    K: float = 1.0
    friction: float | None = None
    start: ErrorInterval = field(default_factory=ErrorInterval)
    executions: int = 1
    threshold: float = 0.05
    iterations: int = 20

    def __post_init__(self) -> None:
        require_positive(threshold=self.threshold)
        if self.K < 0 or self.executions < 1 or self.iterations < 1:
            raise ConfigError("expected K >= 0, and at least one execution and one iteration", key="learning")

    def initial(self) -> AccelerationIntervalState:
        """Return the state before the first plan, which is for the interval `start`."""
        return AccelerationIntervalState(trial=self._trial(self.start), interval=self.start)

    def wanted(self, state: AccelerationIntervalState, trial: Trial) -> tuple[int, float]:
        """Return the executions that the plan still lacks."""
        return self.executions - trial.executions, 1.0

    def infeasible(self, state: AccelerationIntervalState, trial: Trial) -> AccelerationIntervalState:
        """Try a smaller interval; end the search if there is none."""
        row = Row(state.iteration, trial, Result.INFEASIBLE)
        state = replace(state, rows=(*state.rows, row))
        smaller = shrunk(trial.belief.error)
        if smaller is None:
            return replace(state, trial=None, end=End.NO_PLAN)
        return replace(state, trial=self._trial(smaller))

    def executed(self, state: AccelerationIntervalState, trial: Trial) -> AccelerationIntervalState:
        """Estimate the interval again after the last execution of a plan."""
        if trial.executions < self.executions:
            return replace(state, trial=trial)
        result = Result.FAILURE if trial.failures else Result.SUCCESS
        interval = interval_of(trial.errors, self.K) if trial.errors.count else state.interval
        change = endpoint_change(state.interval, interval)
        rows = (*state.rows, Row(state.iteration, trial, result))
        state = replace(state, rows=rows, interval=interval, change=change, iteration=state.iteration + 1)
        if trial.errors.count and change < self.threshold:
            return replace(state, trial=None, end=End.STABLE)
        if state.iteration > self.iterations:
            return replace(state, trial=None, end=End.ITERATION_LIMIT)
        return replace(state, trial=self._trial(interval))

    def _trial(self, interval: ErrorInterval) -> Trial:
        return Trial(Belief(self.friction, interval))
