"""Iterative learning with robust optimization and binary search: ILROBS(K) (paper, Alg. 2)."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import ClassVar

from robustopt.confidence import Reading, paper_executions
from robustopt.learning.learner import Belief, End, Learner, Result, Row, State, Trial
from robustopt.learning.moments import ErrorInterval, interval_of, shrunk
from robustopt.learning.settings import require_friction, require_positive


@dataclass(frozen=True)
class IlrobsState(State):
    """low, high: [mu_low, mu_upp]; error: U and Delta of the latest executions; returning: planning the answer."""

    low: float = 0.0
    high: float = 1.0
    error: ErrorInterval = field(default_factory=ErrorInterval)
    iteration: int = 1
    returning: bool = False


@dataclass(frozen=True, kw_only=True)
class Ilrobs(Learner[IlrobsState]):
    """Bisection on mu in which a plan must succeed N_e(K) times in a row (paper, Alg. 2).

    Every plan survives the errors U -+ K Delta that the executions of the plan before it showed, up to its first
    failure; U = Delta = 0 at first. The first failure sets mu_upp to mu, N_e(K) = ceil(1 / (1 - Phi(K))) successes set
    mu_low to mu; it ends when mu_upp - mu_low <= delta. What it returns, (mu_low, U, Delta), was never executed as
    such: that belief is planned at the end, as the last row of the history, beside the best plan that was executed.

    The text's loop begins with the middle of the interval, and halving [0, 1] to delta = 0.05 takes 5 iterations. The
    paper's run took 6, from an initial estimate of 1, so by default mu_init itself is tried first, as in Alg. 1.

    A belief without a plan: the error interval is given up in halves (see `shrunk`). If not even the problem without
    errors has a plan, mu_low rises to mu, because less friction leaves even less (our choice).

    friction: first mu_low and mu_upp; K: deviations; delta: width at which to stop; reading: of Phi;
    try_upper: whether mu_init is tried first
    """

    name: ClassVar[str] = "ilrobs"
    state_type: ClassVar[type[State]] = IlrobsState

    K: float = 1.0
    friction: tuple[float, float] = (0.0, 1.0)
    delta: float = 0.05
    reading: Reading = Reading.ONE_SIDED
    try_upper: bool = True

    def __post_init__(self) -> None:
        require_friction(self.friction)
        require_positive(delta=self.delta)
        paper_executions(self.K, self.reading)

    @cached_property
    def executions(self) -> int:
        """N_e(K)."""
        return paper_executions(self.K, self.reading)

    def initial(self) -> IlrobsState:
        low, high = map(float, self.friction)
        first = high if self.try_upper else (low + high) / 2
        return IlrobsState(trial=Trial(Belief(first, ErrorInterval())), low=low, high=high)

    def _wanted(self, state: IlrobsState, trial: Trial) -> tuple[int, float]:
        return self.executions - trial.executions, 1.0

    def _planned(self, state: IlrobsState, trial: Trial) -> IlrobsState:
        if not state.returning:
            return replace(state, trial=trial)
        rows = (*state.rows, self._row(state, trial, Result.NOT_EXECUTED))
        return replace(state, rows=rows, trial=None, end=End.INTERVAL)

    def _infeasible(self, state: IlrobsState, trial: Trial) -> IlrobsState:
        smaller = shrunk(trial.belief.error)
        if smaller is not None:
            rows = (*state.rows, self._row(state, trial, Result.INFEASIBLE))
            return replace(state, rows=rows, trial=Trial(Belief(trial.friction, smaller)))
        if state.returning:
            rows = (*state.rows, self._row(state, trial, Result.INFEASIBLE))
            return replace(state, rows=rows, trial=None, end=End.INTERVAL)
        return self._next(replace(state, low=trial.friction), trial, Result.INFEASIBLE)

    def _executed(self, state: IlrobsState, trial: Trial) -> IlrobsState:
        if trial.failures == 0 and trial.successes < self.executions:
            return replace(state, trial=trial)
        if trial.errors.count:
            state = replace(state, error=interval_of(trial.errors, self.K))
        if trial.failures:
            return self._next(replace(state, high=trial.friction), trial, Result.FAILURE)
        return self._next(replace(state, low=trial.friction), trial, Result.SUCCESS)

    def _next(self, state: IlrobsState, trial: Trial, result: Result) -> IlrobsState:
        state = replace(state, rows=(*state.rows, self._row(state, trial, result)))
        if state.high - state.low > self.delta:
            middle = (state.low + state.high) / 2
            return replace(state, trial=Trial(Belief(middle, state.error)), iteration=state.iteration + 1)
        best = self.best(state)
        if best is None:
            return replace(state, trial=None, end=End.NO_SUCCESS)
        return replace(state, trial=Trial(Belief(best.trial.friction, state.error)), returning=True)

    def _row(self, state: IlrobsState, trial: Trial, result: Result) -> Row:
        return Row(state.iteration, trial, result, state.low, state.high)
