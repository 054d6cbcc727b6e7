"""Several parameters at once from success or failure alone (problem: paper, 7.1; the algorithms are ours).

theta lies in a box [a, b], a optimistic and b conservative. f*(theta), the duration of its plan, grows with every
parameter and costs only computing; whether its execution succeeds is monotone too, and costs an execution. Wanted is
the fastest plan that succeeds. Points are those of the unit cube (`parameters`).
"""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from typing import ClassVar, TypeVar

import numpy as np

from robustopt.errors import ConfigError
from robustopt.learning.learner import Belief, End, Learner, Result, Row, State, Trial
from robustopt.learning.monotone import Knowledge
from robustopt.learning.parameters import Array, Cost, CostMap, Parameter, Point
from robustopt.learning.settings import require_positive


@dataclass(frozen=True)
class BranchState(State):
    """points: of the rows; point: of the trial under way."""

    points: tuple[Point, ...] = ()
    point: Point = ()


B = TypeVar("B", bound="BranchAndBound")


@dataclass(frozen=True, kw_only=True)
class BranchAndBound(Learner[BranchState]):
    """What the three learners share: what is known, incumbent, lower bound, and when to stop.

    A plan counts as a success when `executions_per_plan` executions in a row succeed, as a failure at the first that
    does not. The incumbent is the cheapest success. The lower bound is the least f* over what no failure rules out; it
    is attained at the corners of that region, where f* is evaluated exactly. The gap is incumbent / lower bound - 1.

    By condition 3 of the paper b succeeds, so at first nothing that costs more than b is looked at, and b is not
    executed. An incumbent is only what was executed: where nothing else succeeded when the search ends, or when the
    budget leaves one more test, b is tested. If b fails, condition 3 does not hold and no plan is known to succeed.

    A plan is worth a test where it is faster than the incumbent by half of `gap`: with less room between the tests and
    the bound to be proven, no number of failures would prove it.

    It ends when the gap is at most `gap`, when no undecided box has a side over `delta`, or when the budget leaves no
    further test. A belief that turns out to have no plan rules out all that is more conservative, and counts as one of
    the budget.

    cost: f*, a pure function; delta: side of a box, of the unit cube; budget: executions; plans: evaluations of f* for
    the grid that guides the search
    """

    state_type: ClassVar[type[State]] = BranchState

    parameters: tuple[Parameter, ...]
    cost: Cost
    delta: float = 0.05
    gap: float = 0.01
    budget: int = 40
    executions_per_plan: int = 1
    plans: int = 1000

    def __post_init__(self) -> None:
        require_positive(delta=self.delta, gap=self.gap)
        require_positive(budget=self.budget, executions_per_plan=self.executions_per_plan, plans=self.plans)
        if self.budget < self._room:
            expected = f"at least learning.executions_per_plan, {self._room}"
            raise ConfigError(f"found {self.budget}; expected {expected}", key="learning.budget")
        if not self.parameters:
            raise ConfigError(f"found none; expected at least one for {self.name}", key="learning.parameters")
        keys = [parameter.key for parameter in self.parameters]
        if len(set(keys)) < len(keys):
            raise ConfigError(f"found {', '.join(keys)}; expected different keys", key="learning.parameters")

    @abstractmethod
    def _propose(self, state: BranchState, known: Knowledge, cut: float) -> Point | None:
        """The point to test next, which is undecided and whose f* is under `cut`; None where none is worth it."""

    # What is known ----------------------------------------------------------------------------------------

    @cached_property
    def map(self) -> CostMap:
        """f* over the unit cube."""
        return CostMap(self.parameters, self.cost, self.plans)

    @property
    def k(self) -> int:
        return len(self.parameters)

    def knowledge(self, state: BranchState) -> Knowledge:
        """The points that succeeded, failed, and had no plan."""

        def points(result: Result) -> list[Point]:
            return [point for row, point in zip(state.rows, state.points, strict=True) if row.result is result]

        return Knowledge.of(self.k, points(Result.SUCCESS), points(Result.FAILURE), points(Result.INFEASIBLE))

    def best(self, state: BranchState) -> Row | None:
        """The incumbent: the cheapest plan that succeeded, the earliest of equals; None without one."""
        index = self._incumbent_index(state)
        return None if index is None else state.rows[index]

    def incumbent(self, state: BranchState) -> float | None:
        """f* of the incumbent [s]; None without one."""
        index = self._incumbent_index(state)
        return None if index is None else float(self.map.exact(np.array([state.points[index]]))[0])

    def lower_bound(self, state: BranchState) -> float:
        """Least f* over what is not ruled out [s]; never above the incumbent; inf where there is no plan."""
        incumbent = self.incumbent(state)
        return min(self._least(state), np.inf if incumbent is None else incumbent)

    def _incumbent_index(self, state: BranchState) -> int | None:
        succeeded = [i for i, row in enumerate(state.rows) if row.result is Result.SUCCESS]
        if not succeeded:
            return None
        costs = self.map.exact(np.array([state.points[i] for i in succeeded]))
        return succeeded[int(np.argmin(costs))]

    def _least(self, state: BranchState) -> float:
        """Least f* over what no failure rules out [s]."""
        return float(self.map.exact(self.knowledge(state).lower_corners()).min(initial=np.inf))

    # The contract -----------------------------------------------------------------------------------------

    def initial(self) -> BranchState:
        """Raises ConfigError where f* falls along a parameter, against condition 1, or does not depend on one."""
        self.map.require_growth()
        state = BranchState()
        return self._next(state, self.lower_bound(state), None)

    def _wanted(self, state: BranchState, trial: Trial) -> tuple[int, float]:
        return self.executions_per_plan - trial.executions, 1.0

    def _infeasible(self, state: BranchState, trial: Trial) -> BranchState:
        return self._after(state, trial, Result.INFEASIBLE)

    def _executed(self, state: BranchState, trial: Trial) -> BranchState:
        if trial.failures:
            return self._after(state, trial, Result.FAILURE)
        if trial.successes < self.executions_per_plan:
            return replace(state, trial=trial)
        return self._after(state, trial, Result.SUCCESS)

    def _after(self, state: BranchState, trial: Trial, result: Result) -> BranchState:
        """The state after a trial that is over."""
        rows = (*state.rows, Row(len(state.rows) + 1, trial, result))
        state = replace(state, rows=rows, points=(*state.points, state.point), trial=None)
        bound, incumbent = self.lower_bound(state), self.incumbent(state)
        finite = bound if np.isfinite(bound) else None
        gap = None if incumbent is None or finite is None else incumbent / finite - 1
        row = replace(rows[-1], lower_bound=finite, gap=gap, contradictions=self.knowledge(state).contradictions())
        return self._next(replace(state, rows=(*rows[:-1], row)), bound, incumbent)

    def _next(self, state: BranchState, bound: float, incumbent: float | None) -> BranchState:
        """The state with its next trial, or its end."""
        if not state.rows and not np.isfinite(bound):
            return replace(state, end=End.NO_PLAN)
        left = self.budget - state.executed - sum(row.result is Result.INFEASIBLE for row in state.rows)
        if left < self._room:
            return replace(state, end=End.BUDGET)
        conservative = (1.0,) * self.k
        untested = incumbent is None and conservative not in state.points
        if untested and left < 2 * self._room:
            return self._testing(state, conservative)
        cut = self._to_beat(incumbent) / (1 + self.gap / 2)
        proven = (self._conservative if incumbent is None else incumbent) <= bound * (1 + self.gap)
        point = None if proven else self._propose(state, self.knowledge(state), cut)
        if point is not None:
            return self._testing(state, point)
        if untested:
            return self._testing(state, conservative)
        end = End.NO_SUCCESS if incumbent is None else End.GAP if proven else End.BOXES
        return replace(state, end=end)

    @property
    def _room(self) -> int:
        """Executions that a test may take."""
        return self.executions_per_plan

    def _to_beat(self, incumbent: float | None) -> float:
        """f* that a plan must beat [s]: that of the incumbent, or of b, which succeeds by assumption."""
        return self._conservative if incumbent is None else incumbent

    @cached_property
    def _conservative(self) -> float:
        """f* of b [s]; where b has no plan, against condition 3, the longest duration of the grid."""
        duration = float(self.map.exact(np.ones((1, self.k)))[0])
        return duration if np.isfinite(duration) else self.map.longest()

    def _testing(self, state: BranchState, point: Point) -> BranchState:
        keys = [parameter.key for parameter in self.parameters]
        numbers = [parameter.value(t) for parameter, t in zip(self.parameters, point, strict=True)]
        belief = Belief(parameters=tuple(zip(keys, numbers, strict=True)))
        return replace(state, trial=Trial(belief), point=point)

    # Boxes ------------------------------------------------------------------------------------------------

    def _widest(self, known: Knowledge, cut: float, along_diagonal: bool = False) -> Point | None:
        """The point of the undecided box that is most worth a test; None without a box.

        From the unit cube down, every box is contracted to what is undecided in it, dropped where its optimistic corner
        costs `cut` or more by the interpolated f* or no side is over `delta`, and split in 2^k at its point where that
        is decided already. The point is the middle of the box, or of what is undecided of its diagonal, as long as that
        is more than `FRACTION` of it. The worth of a box is its volume times log(cut / f* of its optimistic corner).
        Parts are never worth more than the whole, so boxes of less worth than the best point found need no look.
        """
        best, point = 0.0, None
        low, high, worth = self._useful(known, cut, np.zeros((1, self.k)), np.ones((1, self.k)))
        while len(low):
            first = np.argsort(-worth, kind="stable")[:TOGETHER]
            share, worth_a_test = self._places(known, cut, low[first], high[first], along_diagonal)
            middle = low[first] + share[:, None] * (high[first] - low[first])
            for index in np.flatnonzero(worth_a_test)[:1]:
                if worth[first[index]] > best:
                    best, point = float(worth[first[index]]), tuple(middle[index].tolist())
            divided = first[~worth_a_test]
            parts = self._useful(known, cut, *_split(low[divided], middle[~worth_a_test], high[divided]))
            low, high, worth = (
                np.concatenate([np.delete(old, first, axis=0), new])
                for old, new in zip((low, high, worth), parts, strict=True)
            )
            left = worth > best
            low, high, worth = low[left], high[left], worth[left]
        return point

    def _useful(self, known: Knowledge, cut: float, low: Array, high: Array) -> tuple[Array, Array, Array]:
        """Boxes (m, k), contracted, without those of no use, and what each is worth, (m,)."""
        low, high = known.contract(low, high)
        size = high - low
        wide = np.all(size > 0, axis=1) & np.any(size > self.delta, axis=1)
        low, high, size = low[wide], high[wide], size[wide]
        worth = np.prod(size, axis=1) * np.log(cut / self.map.guide(low))
        return low[worth > 0], high[worth > 0], worth[worth > 0]

    def _places(
        self, known: Knowledge, cut: float, low: Array, high: Array, along_diagonal: bool
    ) -> tuple[Array, Array]:
        """Place of each box's point on its diagonal, (m,), and whether it is worth a test, (m,)."""
        size = high - low
        if not along_diagonal:
            middle = low + 0.5 * size
            return np.full(len(low), 0.5), known.undecided(middle) & (self.map.guide(middle) < cut)
        first, last = known.diagonal(low, high)
        cheap, dear = np.zeros(len(low)), np.ones(len(low))
        for _ in range(HALVINGS):
            place = (cheap + dear) / 2
            under = self.map.guide(low + place[:, None] * size) < cut
            cheap, dear = np.where(under, place, cheap), np.where(under, dear, place)
        last = np.minimum(last, dear)
        return np.clip((first + last) / 2, 0.05, 0.95), last - first > FRACTION


TOGETHER = 64
"""Boxes that are looked at together."""

HALVINGS = 6
"""Of the diagonal of a box, to find where it gets too expensive."""

FRACTION = 0.125
"""Of the diagonal of a box: what is left undecided when the box is split (our choice)."""


def _split(low: Array, middle: Array, high: Array) -> tuple[Array, Array]:
    """The 2^k parts of boxes (m, k) at their points: lower and upper corners."""
    sides = [np.array(side) for side in product((False, True), repeat=low.shape[1])]
    lows = [np.where(side, middle, low) for side in sides]
    highs = [np.where(side, high, middle) for side in sides]
    return np.vstack(lows), np.vstack(highs)


@dataclass(frozen=True, kw_only=True)
class Midpoint(BranchAndBound):
    """Tests the middle of the box most worth splitting."""

    name: ClassVar[str] = "bnb-midpoint"

    def _propose(self, state: BranchState, known: Knowledge, cut: float) -> Point | None:
        return self._widest(known, cut)


@dataclass(frozen=True, kw_only=True)
class Diagonal(BranchAndBound):
    """Bisects along the diagonal of the box most worth splitting, to the boundary of success, then splits there."""

    name: ClassVar[str] = "bnb-diagonal"

    def _propose(self, state: BranchState, known: Knowledge, cut: float) -> Point | None:
        return self._widest(known, cut, along_diagonal=True)
