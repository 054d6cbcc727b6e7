"""Iterative learning with robust optimization and binary search: ILROBS(K) (paper, Alg. 2)."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import ClassVar

from robustopt.confidence import Reading, paper_executions
from robustopt.learning.learner import Learner, Row, State, Trial
from robustopt.learning.moments import ErrorInterval, interval_of, shrunk
from robustopt.learning.outcomes import Belief, End, Result
from robustopt.learning.settings import require_friction, require_positive


@dataclass(frozen=True)
class IlrobsState(State):
    """The state of ILROBS.

    Attributes:
        low: mu_low, lower end of the remaining interval.
        high: mu_upp, its upper end.
        error: interval from U and Delta of the latest executions.
        iteration: number of the current iteration, from 1.
        returning: whether the current trial plans the answer of the algorithm.
    """

    low: float = 0.0
    high: float = 1.0
    error: ErrorInterval = field(default_factory=ErrorInterval)
    iteration: int = 1
    returning: bool = False


@dataclass(frozen=True, kw_only=True)
class Ilrobs(Learner[IlrobsState]):
    """Bisection on mu in which a plan must succeed N_e(K) times in a row (paper, Alg. 2).

    Every plan is robust to the errors U -+ K Delta observed in the executions of the previous plan, up to its first
    failure; at first U = Delta = 0. The first failure lowers mu_upp to mu; N_e(K) = ceil(1 / (1 - Phi(K))) successes
    raise mu_low to mu. The search ends when mu_upp - mu_low <= delta. The paper's answer (mu_low, U, Delta) was never
    executed as such: it is planned at the end, as the last row of the history, beside the best plan that was executed.

    The paper's listing starts in the middle of the interval, and halving [0, 1] to delta = 0.05 takes 5 iterations. The
    paper's run took 6, from an initial estimate of 1, so by default mu_init itself is tried first, as in Alg. 1.

    If there is no plan, the error interval is halved (see `shrunk`). If there is no plan even without errors, mu_low
    rises to mu, because less friction permits even less (our choice).

    Attributes:
        K: number of standard deviations.
        friction: the first mu_low and mu_upp.
        delta: width of the interval at which the search ends.
        reading: definition of Phi.
        try_upper: whether mu_init is tried first.
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
        """Number N_e(K) of successes in a row that a plan needs."""
        return paper_executions(self.K, self.reading)

    def initial(self) -> IlrobsState:
        """Return the state before the first plan, which is for mu_init without errors."""
        low, high = map(float, self.friction)
        first = high if self.try_upper else (low + high) / 2
        return IlrobsState(trial=Trial(Belief(first, ErrorInterval())), low=low, high=high)

    def wanted(self, state: IlrobsState, trial: Trial) -> tuple[int, float]:
        """Return the executions that the plan still lacks."""
        return self.executions - trial.executions, 1.0

    def planned(self, state: IlrobsState, trial: Trial) -> IlrobsState:
        """Execute the plan, or end the search if it is the answer."""
        if not state.returning:
            return replace(state, trial=trial)
        rows = (*state.rows, self._row(state, trial, Result.NOT_EXECUTED))
        return replace(state, rows=rows, trial=None, end=End.INTERVAL)

    def infeasible(self, state: IlrobsState, trial: Trial) -> IlrobsState:
        """Try a smaller error interval; without one, raise mu_low to mu."""
        smaller = shrunk(trial.belief.error)
        if smaller is not None:
            rows = (*state.rows, self._row(state, trial, Result.INFEASIBLE))
            return replace(state, rows=rows, trial=Trial(Belief(trial.friction, smaller)))
        if state.returning:
            rows = (*state.rows, self._row(state, trial, Result.INFEASIBLE))
            return replace(state, rows=rows, trial=None, end=End.INTERVAL)
        return self._next(replace(state, low=trial.friction), trial, Result.INFEASIBLE)

    def executed(self, state: IlrobsState, trial: Trial) -> IlrobsState:
        """Move an end of the interval at the first failure or the last success."""
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
