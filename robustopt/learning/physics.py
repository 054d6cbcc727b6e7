"""A learner that knows the mechanics of its task: `physics` (ours)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import ClassVar

import numpy as np

from robustopt.arrays import Array
from robustopt.errors import ConfigError
from robustopt.evidence import DIVERGED, Failure
from robustopt.learning.branch_and_bound import BranchAndBound, BranchState
from robustopt.learning.foresight import Foresight, NeedMap
from robustopt.learning.informed import ATTEMPTS, SUSPICION, Informed
from robustopt.learning.learner import Row, Trial
from robustopt.learning.monotone import Knowledge
from robustopt.learning.outcomes import End, Result
from robustopt.learning.parameters import Point
from robustopt.learning.world import Posteriors, Run, Worlds, posterior, prior

BOLD = 0.2
"""Chance with which a plan survives that is executed before any plan has failed."""

RISK = 0.4
"""Chance with which a plan fails that is executed later; halved with every failure in a row from the second on."""


@dataclass(frozen=True, kw_only=True)
class Physics(Informed):
    """A learner that infers the actual parameters from the kind, the object and the time of every failure.

    It chooses executions as `bnb-informed` does, by a posterior of worlds (`world`) in the place of a boundary, and
    ends when no plan that is faster by more than `gap` survives by this posterior, or when too many of them have failed
    in a row. The lower bound of its table is as reliable as the model. Where a plan needs several successes in a row
    (`executions_per_plan`), the search makes one execution of each; at its end it confirms the incumbent by as many
    as are needed, and goes on if one of them fails.

    Attributes:
        foresight: forecast of the executions of plans.
    """

    name: ClassVar[str] = "physics"
    exhausted: ClassVar[End] = End.UNLIKELY

    foresight: Foresight

    @cached_property
    def needs(self) -> NeedMap:
        """Strength that plans need over the unit cube."""
        return NeedMap(self.parameters, self.foresight)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.budget < self.executions_per_plan:
            expected = f"at least learning.executions_per_plan, {self.executions_per_plan}, which confirm the result"
            raise ConfigError(f"found {self.budget}; expected {expected}", key="learning.budget")

    # Outcomes ---------------------------------------------------------------------------------------------

    def wanted(self, state: BranchState, trial: Trial) -> tuple[int, float]:
        """Return one execution in the search, and `executions_per_plan` in a row to confirm a plan that succeeded."""
        return (self.executions_per_plan if state.point in state.points else 1) - trial.executions, 1.0

    def executed(self, state: BranchState, trial: Trial) -> BranchState:
        """Record a failure, or the last success that is wanted."""
        if trial.failures:
            return self._after(state, trial, Result.FAILURE)
        if self.wanted(state, trial)[0] > 0:
            return replace(state, trial=trial)
        return self._after(state, trial, Result.SUCCESS)

    def knowledge(self, state: BranchState) -> Knowledge:
        """Return the points that failed, and those that succeeded and are not more optimistic than one that failed.

        Args:
            state: the state.
        """
        known = super().knowledge(state)
        lucky = np.all(known.successes[:, None] <= known.failures[None], axis=2).any(axis=1)
        return replace(known, successes=known.successes[~lucky])

    def _incumbent_index(self, state: BranchState) -> int | None:
        """Return the latest row of the cheapest success that is not more optimistic than a failure."""
        clean = self.knowledge(state).successes
        if not len(clean):
            return None
        best = tuple(clean[np.argmin(self.map.exact(clean))].tolist())
        return len(state.points) - 1 - state.points[::-1].index(best)

    def _to_beat(self, incumbent: float | None) -> float:
        return BranchAndBound._to_beat(self, incumbent)

    def _next(self, state: BranchState, bound: float, incumbent: float | None) -> BranchState:
        """Return the state with its next trial; at the end of the search, the incumbent is confirmed or fails."""
        after, index = super()._next(state, bound, incumbent), self._incumbent_index(state)
        times = self.executions_per_plan
        if times == 1 or index is None:
            return after
        if state.rows[index].trial.successes >= times:
            proven = incumbent is not None and incumbent <= bound * (1 + self.gap)
            return replace(state, trial=None, end=End.GAP if proven else End.UNLIKELY)
        left = self.budget - state.executed - sum(row.result is Result.INFEASIBLE for row in state.rows)
        if left < times:
            return replace(state, trial=None, end=End.BUDGET)
        return self._testing(state, state.points[index]) if after.end is not None or left < 2 * times else after

    # The model --------------------------------------------------------------------------------------------

    def posterior(self, state: BranchState) -> Worlds:
        """Return samples of the world, given all executions so far.

        Args:
            state: the state.
        """
        tested = [
            Run(point, row.trial.duration or 0.0, failure)
            for row, point in zip(state.rows, state.points, strict=True)
            for failure in _outcomes(row)
        ]
        return posterior(self._prior, tested, self._posteriors)

    def _propose(self, state: BranchState, known: Knowledge, cut: float) -> Point | None:
        """Return the fastest plan that survives with a sufficient chance; without one, the one with the largest gain.

        A plan that fails tells more than one that succeeds, so that the chance may be small until one has failed. The
        model may be wrong: while plans fail, the next is slower than all of them by a step that doubles.
        """
        points = self._candidates(state, known, cut)
        costs, streak = self.map.guide(points), _failures_in_a_row(state)
        slower = costs >= self._step(state, streak)
        points, costs = points[slower], costs[slower]
        if not len(points):
            return None
        chance = self._chance(self.posterior(state), points)
        likely = chance >= (1.0 - RISK / 2 ** max(streak - 1, 0) if len(known.failures) else BOLD)
        gain = np.where(likely, 1.0, chance) * (cut - costs) + np.where(likely, cut, 0.0)  # likely ones come first
        order = np.argsort(-gain, kind="stable")
        for index in order[:ATTEMPTS]:
            if self.map.exact(points[[index]])[0] < cut:
                return tuple(points[index].tolist())
        return None

    def _candidates(self, state: BranchState, known: Knowledge, cut: float) -> Array:
        points = self._spread(state, known)
        return points[(self.map.guide(points) < cut) & known.undecided(points)]

    def _step(self, state: BranchState, streak: int) -> float:
        """Return the least cost of the next plan: the more plans have failed in a row, the slower."""
        if streak < 2:
            return 0.0
        failed = [point for row, point in zip(state.rows, state.points, strict=True) if row.result is Result.FAILURE]
        return float(self.map.exact(np.array(failed[-streak:])).max()) * (1.0 + self.gap * 2 ** (streak - 1))

    def _least(self, state: BranchState) -> float:
        """Return the cost below which no plan survives by the model, with a chance of `SUSPICION` that it is wrong."""
        proven, model = BranchAndBound._least(self, state), self.posterior(state)
        points = self._spread(state, self.knowledge(state))
        costs = self.map.guide(points)
        order = np.argsort(costs, kind="stable")
        survives = self.meets(model, model.margin(points[order]))
        cheapest = np.where(survives.any(axis=1), costs[order][survives.argmax(axis=1)], np.inf)
        return max(proven, float(np.quantile(cheapest, SUSPICION, method="lower")))

    @cached_property
    def _prior(self) -> Worlds:
        return prior(self.parameters, self.needs, self.noisy)

    @cached_property
    def _posteriors(self) -> Posteriors:
        return Posteriors()


def _outcomes(row: Row) -> list[Failure | None]:
    """Return the outcomes of a plan that tell something: None for a success, or a failure as far as it is known."""
    failed = [next(iter(row.trial.failed), Failure())] if row.trial.failures else []
    return [*[None] * row.trial.successes, *(item for item in failed if item.kind != DIVERGED)]


def _failures_in_a_row(state: BranchState) -> int:
    """Return the number of latest executions that failed."""
    executed = [row.result is Result.SUCCESS for row in state.rows if row.result is not Result.INFEASIBLE]
    return next((n for n, success in enumerate(reversed(executed)) if success), len(executed))
