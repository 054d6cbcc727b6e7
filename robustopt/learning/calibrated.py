"""Search for the fastest plan with a given success rate at a given confidence: `ilrobs-calibrated` (ours)."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from math import ceil, log, log1p, log2, sqrt
from typing import ClassVar

from robustopt.errors import ConfigError
from robustopt.learning.learner import Learner, Row, State, Trial
from robustopt.learning.moments import ErrorInterval, Moments, interval_of
from robustopt.learning.outcomes import Belief, End, Result
from robustopt.learning.sequential import SequentialTest, Verdict, shortest_acceptance
from robustopt.learning.settings import require_friction, require_level, require_positive


@dataclass(frozen=True)
class CalibratedState(State):
    """The state of the calibrated search.

    Attributes:
        low: lower end of the interval of mu in the current chain.
        high: its upper end.
        chain: index of the current K.
        halvings: number of halvings in the current chain.
        errors: acceleration errors of the executions in the first chain.
    """

    low: float = 0.0
    high: float = 1.0
    chain: int = 0
    halvings: int = 0
    errors: Moments = field(default_factory=Moments)


@dataclass(frozen=True, kw_only=True)
class Calibrated(Learner[CalibratedState]):
    """A search over (mu, K) for the fastest plan with a success rate of at least p, by sequential tests.

    For each K one chain bisects mu geometrically between its bounds. If there is no plan, or one that is not faster
    than the best accepted plan by `resolution`, mu rises without an execution. A plan that its test accepts becomes the
    best, and mu rises; any other plan lowers mu. The first chain has K = 0, that is, plans without acceleration errors;
    its executions give U and Delta for the other chains. A chain ends when the durations at its two ends differ by
    `resolution`, assuming that friction alone binds, T ~ 1 / sqrt(mu). A first belief, such as the best one of ILROBS,
    may be tested before all chains: if it is accepted, the result is not slower.

    **Error.** At most M tests are made: (number of K) * (halvings of a chain), plus 1 for a first belief. Each has the
    level (1 - confidence) / M and executions of its own. Given all earlier outcomes, and so the choice of the plan, the
    j-th test accepts a plan of a rate below p with probability at most its level (`SequentialTest`), hence also without
    this condition. By the union bound over j, the probability that *any* plan of a rate below p is ever accepted is at
    most 1 - confidence. This assumes that executions of one plan are independent with one success rate. It assumes
    neither monotone success nor correct U and Delta, which only help to find a fast plan.

    Attributes:
        rate: success rate p.
        confidence: probability that no plan of a lower rate is accepted.
        friction: bounds of mu, above 0.
        resolution: relative difference of durations that matters.
        K_values: values of K, 0 first.
        futility: largest probability that a test rejects a plan of a rate of at least p.
        patience: a test gives up after this many times the executions of the shortest acceptance.
        first: belief that is tested before all chains; None for none.
    """

    name: ClassVar[str] = "ilrobs-calibrated"
    state_type: ClassVar[type[State]] = CalibratedState

    rate: float = 0.9
    confidence: float = 0.95
    friction: tuple[float, float] = (0.05, 1.0)
    resolution: float = 0.01
    K_values: tuple[float, ...] = (0.0, 0.5, 1.0, 2.0)
    futility: float = 0.05
    patience: float = 4.0
    first: Belief | None = None

    def __post_init__(self) -> None:
        require_friction(self.friction)
        require_positive(resolution=self.resolution, friction=self.friction[0])
        require_level(success_rate=self.rate, confidence=self.confidence, futility=self.futility)
        if not self.K_values or self.K_values[0] != 0 or any(K <= 0 for K in self.K_values[1:]):
            raise ConfigError(
                f"found {list(self.K_values)}; expected 0 and then positive numbers", key="learning.K_values"
            )
        if self.patience < 1:
            raise ConfigError(f"found {self.patience:g}; expected at least 1", key="learning.patience")

    @cached_property
    def depth(self) -> int:
        """Number of halvings of a chain, after which its ends differ by at most (1 + resolution)^2 in mu."""
        low, high = self.friction
        return max(1, ceil(log2(log(high / low) / (2 * log1p(self.resolution)))))

    @property
    def tests(self) -> int:
        """Largest number M of tests."""
        return len(self.K_values) * self.depth + (self.first is not None)

    @cached_property
    def test(self) -> SequentialTest:
        """The test of every plan."""
        level = (1 - self.confidence) / self.tests
        return SequentialTest(
            self.rate, level, self.futility, ceil(self.patience * shortest_acceptance(self.rate, level))
        )

    def initial(self) -> CalibratedState:
        """Return the state before the first plan, which is for the first belief, if given."""
        low, high = map(float, self.friction)
        state = CalibratedState(low=low, high=high)
        return self._advance(state) if self.first is None else replace(state, trial=Trial(self.first))

    def wanted(self, state: CalibratedState, trial: Trial) -> tuple[int, float]:
        """Return the executions after which the test gives up."""
        return self.test.limit - trial.executions, 1.0

    def infeasible(self, state: CalibratedState, trial: Trial) -> CalibratedState:
        """Raise mu."""
        return self._next(state, trial, Result.INFEASIBLE)

    def planned(self, state: CalibratedState, trial: Trial) -> CalibratedState:
        """Execute the plan if it is faster than the best one by `resolution`; otherwise raise mu."""
        best = self.best(state)
        if best is None or _duration(trial) * (1 + self.resolution) <= _duration(best.trial):
            return replace(state, trial=trial)
        return self._next(state, trial, Result.NOT_FASTER)

    def executed(self, state: CalibratedState, trial: Trial) -> CalibratedState:
        """Continue the test, or move mu by its verdict."""
        verdict = self.test.verdict(trial.successes, trial.failures)
        if verdict is Verdict.OPEN:
            return replace(state, trial=trial)
        if state.chain == 0:
            state = replace(state, errors=state.errors + trial.errors)
        results = {
            Verdict.ACCEPTED: Result.SUCCESS,
            Verdict.REJECTED: Result.FAILURE,
            Verdict.UNDECIDED: Result.UNDECIDED,
        }
        return self._next(state, trial, results[verdict])

    def _next(self, state: CalibratedState, trial: Trial, result: Result) -> CalibratedState:
        if not state.rows and self.first is not None:
            return self._advance(replace(state, rows=(Row(1, trial, result, state.low, state.high),)))
        if result in (Result.FAILURE, Result.UNDECIDED):
            state = replace(state, high=trial.friction)
        else:
            state = replace(state, low=trial.friction)
        row = Row(len(state.rows) + 1, trial, result, state.low, state.high)
        return self._advance(replace(state, rows=(*state.rows, row), halvings=state.halvings + 1))

    def _advance(self, state: CalibratedState) -> CalibratedState:
        """Return the state with the next trial: the middle of the chain, or of the next one if the chain is done."""
        if state.halvings == self.depth:
            low, high = map(float, self.friction)
            state = replace(state, chain=state.chain + 1, halvings=0, low=low, high=high)
        error = self._error(state)
        if error is None:
            end = End.INTERVAL if self.best(state) else End.NO_SUCCESS
            return replace(state, trial=None, end=end)
        return replace(state, trial=Trial(Belief(sqrt(state.low * state.high), error)))

    def _error(self, state: CalibratedState) -> ErrorInterval | None:
        """Return the error interval of the chain; None after the last chain, and if no error was observed."""
        if state.chain == 0:
            return ErrorInterval()
        if state.chain == len(self.K_values):
            return None
        error = interval_of(state.errors, self.K_values[state.chain])
        return None if error.is_zero else error


def _duration(trial: Trial) -> float:
    assert trial.duration is not None
    return trial.duration
