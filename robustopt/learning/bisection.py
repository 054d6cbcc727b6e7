"""Bisection on the coefficient of friction from success or failure alone (paper, Alg. 1)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

from robustopt.learning.learner import Learner, Row, State, Trial
from robustopt.learning.outcomes import Belief, End, Result
from robustopt.learning.settings import require_friction, require_positive


@dataclass(frozen=True)
class BisectionState(State):
    """The state of a bisection.

    Attributes:
        low: mu_low, lower end of the remaining interval.
        high: mu_upp, its upper end.
    """

    low: float = 0.0
    high: float = 1.0


@dataclass(frozen=True, kw_only=True)
class Bisection(Learner[BisectionState]):
    """Bisection on mu with a sped-up execution that tests for near-optimality (paper, Alg. 1, read off Table 1).

    mu starts at the upper end mu_init. A failure lowers mu_upp to mu. A success raises mu_low to mu, and the same plan
    is executed (1 + epsilon) times as fast: if that fails, the plan is epsilon-near-optimal and the search ends.
    Otherwise mu becomes the middle of [mu_low, mu_upp]. The search also ends when mu_upp - mu_low <= delta.

    If there is no plan for mu, then mu_low rises to mu, because less friction permits even less. That is not a success
    (our choice).

    Attributes:
        friction: the first mu_low and mu_upp.
        delta: width of the interval at which the search ends.
        epsilon: relative speed-up.
    """

    name: ClassVar[str] = "bisection"
    state_type: ClassVar[type[State]] = BisectionState

    friction: tuple[float, float] = (0.0, 1.0)
    delta: float = 0.05
    epsilon: float = 0.05

    def __post_init__(self) -> None:
        require_friction(self.friction)
        require_positive(delta=self.delta, epsilon=self.epsilon)

    def initial(self) -> BisectionState:
        """Return the state before the first plan, which is for mu_init."""
        low, high = map(float, self.friction)
        return BisectionState(trial=Trial(Belief(high)), low=low, high=high)

    def wanted(self, state: BisectionState, trial: Trial) -> tuple[int, float]:
        """Return one execution at planned speed, and after its success one that is sped up."""
        return (1, 1.0) if trial.successes == 0 else (1, 1.0 + self.epsilon)

    def infeasible(self, state: BisectionState, trial: Trial) -> BisectionState:
        """Raise mu_low to mu."""
        return self._next(replace(state, low=trial.friction), trial, Result.INFEASIBLE)

    def executed(self, state: BisectionState, trial: Trial) -> BisectionState:
        """Move the end of the interval that the execution has decided."""
        if trial.failures:
            return self._next(replace(state, high=trial.friction), trial, Result.FAILURE)
        state = replace(state, low=trial.friction)
        if trial.sped_up is None:
            return replace(state, trial=trial)
        return self._next(state, trial, Result.SUCCESS)

    def _next(self, state: BisectionState, trial: Trial, result: Result) -> BisectionState:
        row = Row(len(state.rows) + 1, trial, result, state.low, state.high)
        state = replace(state, rows=(*state.rows, row))
        if trial.sped_up is False:
            return replace(state, trial=None, end=End.NEAR_OPTIMAL)
        if state.high - state.low <= self.delta:
            end = End.INTERVAL if self.best(state) else End.NO_SUCCESS
            return replace(state, trial=None, end=end)
        return replace(state, trial=Trial(Belief((state.low + state.high) / 2)))
