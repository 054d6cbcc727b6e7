"""Learns the interval of the joint acceleration error alone, at a fixed belief of friction (paper, top of page 8)."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import ClassVar

from robustopt.errors import ConfigError
from robustopt.learning.learner import Belief, End, Learner, Result, Row, State, Trial
from robustopt.learning.moments import ErrorInterval, endpoint_change, interval_of, shrunk
from robustopt.learning.settings import require_positive


@dataclass(frozen=True)
class AccelerationIntervalState(State):
    """interval: [U - K Delta, U + K Delta] of the latest executions; change: how far its endpoints moved last."""

    interval: ErrorInterval = field(default_factory=ErrorInterval)
    change: float | None = None
    iteration: int = 1


@dataclass(frozen=True, kw_only=True)
class AccelerationInterval(Learner[AccelerationIntervalState]):
    """Plan for an interval, execute, estimate U and Delta, set the interval to U -+ K Delta, until it is stable.

    It is stable when no endpoint of any joint moved by `threshold` or more from one iteration to the next. Nothing
    proves that it settles, so there is a limit of iterations (our choice). Whether an execution succeeds does not
    matter to the interval; the best plan is the latest one all of whose executions succeeded.

    friction: belief to plan with, None as configured; start: interval of the first plan; executions: of each plan;
    threshold: [rad/s^2]
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
        return AccelerationIntervalState(trial=self._trial(self.start), interval=self.start)

    def _wanted(self, state: AccelerationIntervalState, trial: Trial) -> tuple[int, float]:
        return self.executions - trial.executions, 1.0

    def _infeasible(self, state: AccelerationIntervalState, trial: Trial) -> AccelerationIntervalState:
        row = Row(state.iteration, trial, Result.INFEASIBLE)
        state = replace(state, rows=(*state.rows, row))
        smaller = shrunk(trial.belief.error)
        if smaller is None:
            return replace(state, trial=None, end=End.NO_PLAN)
        return replace(state, trial=self._trial(smaller))

    def _executed(self, state: AccelerationIntervalState, trial: Trial) -> AccelerationIntervalState:
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
