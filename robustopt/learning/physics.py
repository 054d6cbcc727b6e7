"""A learner that knows the mechanics of its task: `physics` (ours)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np

from robustopt.learning.branch_and_bound import BranchState
from robustopt.learning.foresight import Foresight, NeedMap
from robustopt.learning.informed import SUSPICION, Informed
from robustopt.learning.outcomes import Result
from robustopt.learning.world import Posteriors, Tested, Worlds, posterior, prior


@dataclass(frozen=True, kw_only=True)
class Physics(Informed):
    """A learner that infers the actual parameters from the kind, the object and the time of every failure.

    It chooses executions as `bnb-informed` does, by a posterior of worlds (`world`) in the place of a boundary, and
    ends when no plan that is faster by more than `gap` survives by this posterior. The lower bound of its table is as
    reliable as the model.

    Attributes:
        foresight: forecast of the executions of plans.
    """

    name: ClassVar[str] = "physics"
    halves: ClassVar[bool] = False

    foresight: Foresight

    @cached_property
    def needs(self) -> NeedMap:
        """Strength that plans need over the unit cube."""
        return NeedMap(self.parameters, self.foresight)

    def posterior(self, state: BranchState) -> Worlds:
        """Return samples of the world, given all executions so far.

        Args:
            state: the state.
        """
        tested = [
            Tested(point, row.trial.duration or 0.0, next(iter(row.trial.failed), None))
            for row, point in zip(state.rows, state.points, strict=True)
            if row.result is not Result.INFEASIBLE
        ]
        return posterior(self._prior, tested, self._posteriors)

    def _least(self, state: BranchState) -> float:
        """Return the cost below which no plan survives by the model, with a chance of `SUSPICION` that it is wrong."""
        proven = super()._least(state)
        if self.noisy:
            return proven
        points = self._spread(state, self.knowledge(state))
        costs = self.map.guide(points)
        order = np.argsort(costs, kind="stable")
        survives = self.posterior(state).margin(points[order]) >= 0.0
        cheapest = np.where(survives.any(axis=1), costs[order][survives.argmax(axis=1)], np.inf)
        return max(proven, float(np.quantile(cheapest, SUSPICION, method="lower")))

    @cached_property
    def _prior(self) -> Worlds:
        return prior(self.parameters, self.needs, self.noisy)

    @cached_property
    def _posteriors(self) -> Posteriors:
        return Posteriors()
