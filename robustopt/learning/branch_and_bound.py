"""Learners of several parameters from success or failure alone (problem: paper, section 7.1; algorithms: ours).

The parameters theta lie in a box [a, b], a optimistic and b conservative. The duration f*(theta) of the plan grows with
every parameter and costs only computing time. The success of its execution is monotone too, and costs an execution. The
learners search for the fastest plan that succeeds. All points are points of the unit cube (`parameters`).
"""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from typing import ClassVar

import numpy as np

from robustopt.arrays import Array, Flags
from robustopt.errors import ConfigError
from robustopt.learning.cost_map import CostMap, settled
from robustopt.learning.learner import Learner, Row, State, Trial
from robustopt.learning.monotone import Knowledge
from robustopt.learning.outcomes import Belief, End, Result
from robustopt.learning.parameters import Cost, Parameter, Point
from robustopt.learning.settings import require_positive


@dataclass(frozen=True)
class BranchState(State):
    """The state of a learner of several parameters.

    Attributes:
        points: points of the rows.
        point: point of the trial under way.
    """

    points: tuple[Point, ...] = ()
    point: Point = ()


@dataclass(frozen=True, kw_only=True)
class BranchAndBound(Learner[BranchState]):
    """A learner of several parameters: knowledge, incumbent, lower bound and end; subclasses choose the points to test.

    A plan counts as a success if `executions_per_plan` executions in a row succeed, and as a failure at the first
    execution that fails. The incumbent is the cheapest success. The lower bound is the least f* over the region that no
    failure rules out; it is attained at a corner of that region, and f* is evaluated exactly at all corners. The gap is
    incumbent / lower bound - 1.

    By condition 3 of the paper, b succeeds. So plans that cost more than b are never tested, and b is not executed at
    first. But an incumbent must have been executed: if nothing else has succeeded when the search ends, or when the
    budget leaves only one more test, b is tested. If b fails, condition 3 does not hold and no plan is known to
    succeed.

    A plan is tested only if it is faster than the incumbent by at least half of `gap`. Without this room between the
    tests and the desired bound, no number of failures would prove the bound.

    The search ends when the gap is at most `gap`, when no undecided box has a side over `delta`, or when the budget
    leaves no further test. A point without a plan rules out all points that are more conservative, and counts as one
    execution of the budget.

    Attributes:
        parameters: the k parameters.
        cost: f*, a pure function.
        delta: smallest side of a box that is searched, in the unit cube.
        gap: relative gap at which the search ends.
        budget: largest number of executions.
        executions_per_plan: successes in a row that a plan needs.
        plans: largest number of evaluations of f* for the grid that guides the search.
        exhausted: reason of the end if no point is worth a test.
    """

    state_type: ClassVar[type[State]] = BranchState
    exhausted: ClassVar[End] = End.BOXES

    parameters: tuple[Parameter, ...]
    cost: Cost
    delta: float = 0.005
    gap: float = 0.005
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
        """Return the next point to test, undecided and with an f* under `cut`; None if no point is worth a test."""

    # Knowledge --------------------------------------------------------------------------------------------

    @cached_property
    def map(self) -> CostMap:
        """The duration f* over the unit cube."""
        return CostMap(self.parameters, self.cost, self.plans)

    @property
    def k(self) -> int:
        """Number of parameters."""
        return len(self.parameters)

    def knowledge(self, state: BranchState) -> Knowledge:
        """Return the points that succeeded, failed, or had no plan.

        Args:
            state: the state.

        Returns:
            The points whose outcome is known.
        """

        def points(result: Result) -> list[Point]:
            return [point for row, point in zip(state.rows, state.points, strict=True) if row.result is result]

        return Knowledge.of(self.k, points(Result.SUCCESS), points(Result.FAILURE), points(Result.INFEASIBLE))

    def best(self, state: BranchState) -> Row | None:
        """Return the incumbent, the cheapest plan that succeeded, or the earliest of several.

        Args:
            state: the state.

        Returns:
            Its row; None if no plan succeeded.
        """
        index = self._incumbent_index(state)
        return None if index is None else state.rows[index]

    def incumbent(self, state: BranchState) -> float | None:
        """Return f* of the incumbent.

        Args:
            state: the state.

        Returns:
            A duration [s]; None if no plan succeeded.
        """
        index = self._incumbent_index(state)
        return None if index is None else float(self.map.exact(np.array([state.points[index]]))[0])

    def lower_bound(self, state: BranchState) -> float:
        """Return the least f* over the region that is not ruled out.

        Args:
            state: the state.

        Returns:
            A duration [s], at most f* of the incumbent; inf if there is no plan.
        """
        incumbent = self.incumbent(state)
        return min(self._least(state), np.inf if incumbent is None else incumbent)

    def _incumbent_index(self, state: BranchState) -> int | None:
        succeeded = [i for i, row in enumerate(state.rows) if row.result is Result.SUCCESS]
        if not succeeded:
            return None
        costs = self.map.exact(np.array([state.points[i] for i in succeeded]))
        return succeeded[int(np.argmin(costs))]

    def _least(self, state: BranchState) -> float:
        """Return the least f* over the region that no failure rules out [s]."""
        return float(self.map.exact(self.knowledge(state).lower_corners()).min(initial=np.inf))

    # The contract -----------------------------------------------------------------------------------------

    def initial(self) -> BranchState:
        """Return the state before the first execution.

        Raises:
            ConfigError: f* falls along a parameter, against condition 1, or does not depend on one.
        """
        self.map.require_growth()
        state = BranchState()
        return self._next(state, self.lower_bound(state), None)

    def wanted(self, state: BranchState, trial: Trial) -> tuple[int, float]:
        """Return the executions that the plan still lacks."""
        return self.executions_per_plan - trial.executions, 1.0

    def infeasible(self, state: BranchState, trial: Trial) -> BranchState:
        """Rule out all points that are more conservative."""
        return self._after(state, trial, Result.INFEASIBLE)

    def executed(self, state: BranchState, trial: Trial) -> BranchState:
        """Record a failure, or the last of the successes in a row that a plan needs."""
        if trial.failures:
            return self._after(state, trial, Result.FAILURE)
        if trial.successes < self.executions_per_plan:
            return replace(state, trial=trial)
        return self._after(state, trial, Result.SUCCESS)

    def _after(self, state: BranchState, trial: Trial, result: Result) -> BranchState:
        """Return the state after a finished trial."""
        rows = (*state.rows, Row(len(state.rows) + 1, trial, result))
        state = replace(state, rows=rows, points=(*state.points, state.point), trial=None)
        bound, incumbent = self.lower_bound(state), self.incumbent(state)
        finite = bound if np.isfinite(bound) else None
        gap = None if incumbent is None or finite is None else incumbent / finite - 1
        row = replace(rows[-1], lower_bound=finite, gap=gap, contradictions=self.knowledge(state).contradictions())
        return self._next(replace(state, rows=(*rows[:-1], row)), bound, incumbent)

    def _next(self, state: BranchState, bound: float, incumbent: float | None) -> BranchState:
        """Return the state with its next trial, or with its end."""
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
        end = End.NO_SUCCESS if incumbent is None else End.GAP if proven else self.exhausted
        return replace(state, end=end)

    @property
    def _room(self) -> int:
        """Largest number of executions of a test."""
        return self.executions_per_plan

    def _to_beat(self, incumbent: float | None) -> float:
        """Return the f* that a plan must beat [s]: the incumbent's, or that of b, which succeeds by assumption."""
        return self._conservative if incumbent is None else incumbent

    @cached_property
    def _conservative(self) -> float:
        """Duration f* of b [s]; if b has no plan, against condition 3, the longest duration of the grid."""
        duration = float(self.map.exact(np.ones((1, self.k)))[0])
        return duration if np.isfinite(duration) else self.map.longest()

    def _testing(self, state: BranchState, point: Point) -> BranchState:
        keys = [parameter.key for parameter in self.parameters]
        numbers = [parameter.value(t) for parameter, t in zip(self.parameters, point, strict=True)]
        belief = Belief(parameters=tuple(zip(keys, numbers, strict=True)))
        return replace(state, trial=Trial(belief), point=point)

    # Boxes ------------------------------------------------------------------------------------------------

    def _widest(self, known: Knowledge, cut: float, along_diagonal: bool = False) -> Point | None:
        """Return the most valuable point to test among those of the undecided boxes; None without such a box.

        The search starts from the unit cube. Every box is contracted to its undecided part. It is dropped if the
        interpolated f* of its optimistic corner is at least `cut`, or if no side is over `delta`. The point of a box is
        its middle, or the middle of the undecided part of its diagonal as long as that part exceeds `FRACTION` of the
        diagonal. If the point is already decided, the box is split there in 2^k. The value of a box is its volume times
        log(cut / f* of its optimistic corner). A part is never worth more than the whole, so boxes of less value than
        the best point found are skipped.
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
        """Return boxes (m, k), contracted and without useless ones, and the value of each, (m,)."""
        low, high = known.contract(low, high)
        size = high - low
        wide = np.all(size > 0, axis=1) & np.any(size > self.delta, axis=1)
        low, high, size = low[wide], high[wide], size[wide]
        worth = settled(np.prod(size, axis=1) * np.log(cut / self.map.guide(low)))
        return low[worth > 0], high[worth > 0], worth[worth > 0]

    def _places(
        self, known: Knowledge, cut: float, low: Array, high: Array, along_diagonal: bool
    ) -> tuple[Array, Flags]:
        """Return the place of each box's point on its diagonal, (m,), and whether it is worth a test, (m,)."""
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
"""Number of boxes that are examined together."""

HALVINGS = 6
"""Number of halvings of the diagonal of a box that find its first point that is too expensive."""

FRACTION = 0.125
"""Undecided part of the diagonal of a box below which the box is split (our choice)."""


def _split(low: Array, middle: Array, high: Array) -> tuple[Array, Array]:
    """Split boxes (m, k) in 2^k parts at their points; return the lower and the upper corners."""
    sides = [np.array(side) for side in product((False, True), repeat=low.shape[1])]
    lows = [np.where(side, middle, low) for side in sides]
    highs = [np.where(side, high, middle) for side in sides]
    return np.vstack(lows), np.vstack(highs)


@dataclass(frozen=True, kw_only=True)
class Midpoint(BranchAndBound):
    """The baseline, which tests the middle of the most valuable box.

    This is plain branch and bound, kept for comparison with `bnb-diagonal` and `bnb-informed`, which need fewer
    executions.
    """

    name: ClassVar[str] = "bnb-midpoint"

    def _propose(self, state: BranchState, known: Knowledge, cut: float) -> Point | None:
        return self._widest(known, cut)


@dataclass(frozen=True, kw_only=True)
class Diagonal(BranchAndBound):
    """Bisection along the diagonal of the most valuable box, up to the boundary of success."""

    name: ClassVar[str] = "bnb-diagonal"

    def _propose(self, state: BranchState, known: Knowledge, cut: float) -> Point | None:
        return self._widest(known, cut, along_diagonal=True)
