"""`bnb-informed`: the execution that is expected to gain most, by a model of where the boundary may lie (ours)."""

from __future__ import annotations

from dataclasses import dataclass
from statistics import NormalDist
from typing import ClassVar

import numpy as np

from robustopt.learning.boundary import Cloud, cloud
from robustopt.learning.branch_and_bound import BranchAndBound, BranchState
from robustopt.learning.learner import Result, Trial
from robustopt.learning.monotone import Knowledge
from robustopt.learning.parameters import Array, Point

CANDIDATES = 2000
"""Points of the whole cube that are looked at; about as many lie near what succeeded."""

FINALISTS = 250
"""Candidates whose gain is looked two executions ahead."""

DOUBT = 0.1
"""Weight of the chance by distances beside that of the model, which may be wrong."""

TRUST = 0.6
"""Posterior chance that a plan meets the rate with which it may be the incumbent in a noisy world."""

SUSPICION = 0.05
"""In a noisy world a point is ruled out where the posterior chance that it meets the rate is under it."""


@dataclass(frozen=True, kw_only=True)
class Informed(BranchAndBound):
    """Tests the point of the largest expected gain of this execution and the next.

    With P the posterior chance of success, U the cost to beat and f the cost of a candidate,

        value(c) = P(c) (U - f(c)) + max_d P(c and d) (f(c) - f(d))^+ + max_d P(not c, and d) (U - f(d)).

    The samples of `boundary` give the joint chances. P(c) in the first term is mixed with the chance by distances to
    the decided regions, so that a boundary like none of the samples is found too.

    In one dimension every boundary is a threshold, and the middle of what is undecided is tested.

    **Noisy world** (`executions_per_plan` N over 1). Success means a rate of at least 1 - 1/N, about Phi(K) for
    N = N_e(K). Every execution is a trial of its own and moves the posterior; with M(d), "d meets the rate", and B the
    cost of b,

        value(c) = max_d P(success at c, M(d)) (B - f(d)) + max_d P(failure at c, M(d)) (B - f(d)),

    the expected saving of the best choice after the execution. The incumbent is the cheapest success of which P(M) is
    at least `TRUST`, so it changes when later failures make it doubtful. A point is ruled out where P(M) is under
    `SUSPICION`: the lower bound then holds by the model, not for certain.
    """

    name: ClassVar[str] = "bnb-informed"

    @property
    def noisy(self) -> bool:
        return self.executions_per_plan > 1

    @property
    def rate(self) -> float:
        """Success rate that is asked for in a noisy world."""
        return 1 - 1 / self.executions_per_plan

    @property
    def _room(self) -> int:
        return 1

    def _wanted(self, state: BranchState, trial: Trial) -> tuple[int, float]:
        return 1, 1.0

    def _executed(self, state: BranchState, trial: Trial) -> BranchState:
        return self._after(state, trial, Result.FAILURE if trial.failures else Result.SUCCESS)

    # What is known ----------------------------------------------------------------------------------------

    def posterior(self, state: BranchState) -> Cloud:
        """Samples of the boundary, given all executions so far."""
        pairs = [
            (point, row.result is Result.SUCCESS)
            for row, point in zip(state.rows, state.points, strict=True)
            if row.result is not Result.INFEASIBLE
        ]
        return cloud(self.k, self.noisy, [point for point, _ in pairs], [success for _, success in pairs])

    def meets(self, model: Cloud, margin: Array) -> Array:
        """Whether a margin means success, by every sample, (M, m) -> (M, m)."""
        return margin >= model.sigma * (NormalDist().inv_cdf(self.rate) if self.noisy else 0.0)

    def _chance(self, model: Cloud, points: Array) -> Array:
        """Posterior chance that points (m, k) meet what is asked for, (m,)."""
        return np.mean(self.meets(model, model.margin(points)), axis=0)

    def _incumbent_index(self, state: BranchState) -> int | None:
        if not self.noisy:
            return super()._incumbent_index(state)
        succeeded = [i for i, row in enumerate(state.rows) if row.result is Result.SUCCESS]
        if not succeeded:
            return None
        points = np.array([state.points[i] for i in succeeded])
        trusted = self._chance(self.posterior(state), points) >= TRUST
        costs = np.where(trusted, self.map.exact(points), np.inf)
        return succeeded[int(np.argmin(costs))] if trusted.any() else None

    def _to_beat(self, incumbent: float | None) -> float:
        return super()._to_beat(None if self.noisy else incumbent)

    def _least(self, state: BranchState) -> float:
        if not self.noisy:
            return super()._least(state)
        points = np.vstack([np.zeros((1, self.k)), np.random.default_rng(0).random((CANDIDATES, self.k))])
        left = points[self._chance(self.posterior(state).thinned(), points) >= SUSPICION]
        return float(self.map.exact(left[[np.argmin(self.map.guide(left))]])[0]) if len(left) else np.inf

    # The next execution -----------------------------------------------------------------------------------

    def _propose(self, state: BranchState, known: Knowledge, cut: float) -> Point | None:
        widest = None if self.noisy else self._widest(known, cut)
        if not self.noisy and (widest is None or self.k == 1):
            return widest
        points = self._candidates(state, known, cut)
        if len(points):
            model, costs = self.posterior(state), self.map.guide(points)
            hope = (self._chance(model.thinned(), points) + SUSPICION) * (cut - costs)
            kept = np.argsort(-hope, kind="stable")[:FINALISTS]
            value = self._value(model, known, points[kept], costs[kept], cut)
            for index in kept[np.argsort(-value, kind="stable")][:ATTEMPTS]:
                if self.map.exact(points[[index]])[0] < cut:
                    return tuple(points[index].tolist())
        return widest

    def _candidates(self, state: BranchState, known: Knowledge, cut: float) -> Array:
        """Points (m, k) under the cost, undecided where there is no noise: over the cube and near what succeeded."""
        random = np.random.default_rng([self.k, len(state.rows)])
        sets = [random.random((CANDIDATES, self.k))]
        best = known.successes[np.argsort(self.map.exact(known.successes), kind="stable")[:NEAR]]
        if not len(best):
            sets.append(np.repeat(random.random((CANDIDATES, 1)), self.k, axis=1))
        for point in best:
            for scale in (0.15, 0.04):
                moved = point + random.normal(0, scale, (CANDIDATES // 6, self.k))
                sets.append(np.clip(moved, 0, 1))
            sets.append(point * random.random((CANDIDATES // 6, self.k)) ** 0.3)
        points = np.vstack(sets)
        points = points[self.map.guide(points) < cut]
        return points if self.noisy else points[known.undecided(points)]

    def _value(self, model: Cloud, known: Knowledge, points: Array, costs: Array, cut: float) -> Array:
        """Expected gain of testing each candidate and then the best of what follows, (m,) [s]."""
        margin = model.margin(points)
        meets = self.meets(model, margin).astype(float)
        if self.noisy:
            both = model.chances(margin).T @ meets / len(meets)
            return np.max(both * (cut - costs), axis=1) + np.max((meets.mean(axis=0) - both) * (cut - costs), axis=1)
        both, chance = meets.T @ meets / len(meets), meets.mean(axis=0)
        after_success = np.max(both * np.maximum(costs[:, None] - costs, 0), axis=1)
        after_failure = np.max((chance - both) * (cut - costs), axis=1)
        chance = (1 - DOUBT) * chance + DOUBT * _chance_by_distance(known, points)
        return chance * (cut - costs) + after_success + after_failure


ATTEMPTS = 20
"""Best candidates of which one must cost little enough by f* itself, not only by its interpolation."""

NEAR = 3
"""Cheapest successes near which candidates are drawn."""


def _chance_by_distance(known: Knowledge, points: Array) -> Array:
    """Chance of success from the distances to what failed and to what succeeded, (m,); a and b stand for these too."""
    k = points.shape[1]
    failures, successes = np.vstack([np.zeros((1, k)), known.failures]), np.vstack([np.ones((1, k)), known.successes])
    up = np.min([np.linalg.norm(np.maximum(points - failure, 0), axis=1) for failure in failures], axis=0)
    down = np.min([np.linalg.norm(np.maximum(success - points, 0), axis=1) for success in successes], axis=0)
    return up / (up + down + 1e-12)
