"""Choice of the execution with the largest expected gain, by a model of the boundary: `bnb-informed` (ours)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from statistics import NormalDist
from typing import ClassVar, Protocol

import numpy as np
from scipy.special import betaincc

from robustopt.arrays import Array, Flags
from robustopt.learning.boundary import cloud
from robustopt.learning.branch_and_bound import BranchAndBound, BranchState
from robustopt.learning.learner import Trial
from robustopt.learning.monotone import Knowledge
from robustopt.learning.outcomes import Result
from robustopt.learning.parameters import Point

CANDIDATES = 2000
"""Number of candidates in the whole cube; about as many lie near the cheapest successes."""

FINALISTS = 250
"""Number of candidates whose expected gain is computed two executions ahead."""

DOUBT = 0.03
"""Weight of the chance by distances, beside the chance by the model, which may be wrong."""

PROBES = (0.5, 0.8)
"""Smallest chances of meeting the rate with which a plan is executed in a noisy world, in turn."""

TRUST = 0.8
"""Smallest chance of meeting the rate with which a plan is the incumbent in a noisy world."""

PLAIN = 0.3
"""Weight of the chance by monotony alone, beside the chance by the model, in a noisy world."""

SUSPICION = 0.05
"""Posterior chance of meeting the rate below which a point is ruled out in a noisy world."""


class Model(Protocol):
    """Samples of a model of success; see `Cloud`."""

    @property
    def sigma(self) -> Array:
        """Return the standard deviation of the margin from one execution to the next, by every sample, (M, 1)."""

    def thinned(self) -> Model:
        """Return some of the samples."""

    def margin(self, points: Array) -> Array:
        """Return the margin of points (m, k) of the unit cube by every sample, (M, m)."""


@dataclass(frozen=True, kw_only=True)
class Informed(BranchAndBound):
    """A learner that tests the point with the largest expected gain of this execution and the next.

    With P the posterior chance of success, U the cost to beat and f the cost of a candidate,

        value(c) = P(c) (U - f(c)) + max_d P(c and d) (f(c) - f(d))^+ + max_d P(not c, and d) (U - f(d)).

    The samples of `boundary` give the joint chances. In the first term, P(c) is mixed with a chance that depends only
    on the distances to the decided regions, so that a boundary unlike all samples is found too.

    If the boundary is unlike all samples, the model is wrongly certain that nothing cheaper succeeds and proposes
    unlikely, distant points. Therefore, while at most one of the last `RECENT` executions succeeded, every second point
    is chosen without the model (`_along_axes`).

    In one dimension every boundary is a threshold, and the middle of the undecided interval is tested.

    **Noisy world** (`executions_per_plan` N over 1). Success means a rate of at least 1 - 1/N, about Phi(K) for N =
    N_e(K). Every execution is a trial of its own and updates the posterior. The chance that a point meets the rate is
    the chance by the model, mixed with `_chance_by_monotony`, which uses no model. The cheapest point with a chance of
    at least one of `PROBES`, in turn, is executed, whether it is new or not. The incumbent is the cheapest success with
    a chance of at least `TRUST`, so it changes when later failures make it doubtful. A point is ruled out if its chance
    by the model is under `SUSPICION`: the lower bound is then as reliable as the model, not certain.
    """

    name: ClassVar[str] = "bnb-informed"

    @property
    def noisy(self) -> bool:
        """Whether executions of one plan vary."""
        return self.executions_per_plan > 1

    @property
    def rate(self) -> float:
        """Success rate that a plan must meet in a noisy world."""
        return 1 - 1 / self.executions_per_plan

    @property
    def _room(self) -> int:
        return 1

    def wanted(self, state: BranchState, trial: Trial) -> tuple[int, float]:
        """Return one execution at planned speed."""
        return 1, 1.0

    def executed(self, state: BranchState, trial: Trial) -> BranchState:
        """Record the outcome, which ends the trial."""
        return self._after(state, trial, Result.FAILURE if trial.failures else Result.SUCCESS)

    # Knowledge --------------------------------------------------------------------------------------------

    def posterior(self, state: BranchState) -> Model:
        """Return samples of the boundary, given all executions so far.

        Args:
            state: the state.

        Returns:
            Samples of the posterior.
        """
        pairs = [
            (point, row.result is Result.SUCCESS)
            for row, point in zip(state.rows, state.points, strict=True)
            if row.result is not Result.INFEASIBLE
        ]
        return cloud(self.k, self.noisy, [point for point, _ in pairs], [success for _, success in pairs])

    def meets(self, model: Model, margin: Array) -> Flags:
        """Return whether each margin means success according to every sample.

        Args:
            model: the samples.
            margin: margins, (M, m), in units of the cube.

        Returns:
            Whether each margin is large enough, (M, m).
        """
        return margin >= model.sigma * (NormalDist().inv_cdf(self.rate) if self.noisy else 0.0)

    def _chance(self, model: Model, points: Array) -> Array:
        """Return the posterior chance that tests of points (m, k) succeed, (m,)."""
        return np.mean(self.meets(model, model.margin(points)), axis=0)

    def _confidence(self, state: BranchState, model: Model, points: Array) -> Array:
        """Return the chance that points (m, k) meet the rate in a noisy world, by model and monotony, (m,)."""
        plain = _chance_by_monotony(self.knowledge(state), points, self.rate)
        return (1 - PLAIN) * self._chance(model, points) + PLAIN * plain

    def _incumbent_index(self, state: BranchState) -> int | None:
        if not self.noisy:
            return super()._incumbent_index(state)
        succeeded = [i for i, row in enumerate(state.rows) if row.result is Result.SUCCESS]
        if not succeeded:
            return None
        points = np.array([state.points[i] for i in succeeded])
        trusted = self._confidence(state, self.posterior(state), points) >= TRUST
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
        if self.noisy:
            return self._probe(state, known, cut)
        widest = self._widest(known, cut)
        if widest is None or self.k == 1:
            return widest
        if self._stalled(state) and (point := self._along_axes(known, cut)) is not None:
            return point
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

    def _stalled(self, state: BranchState) -> bool:
        """Return whether the next point is chosen without the model: every second time while its points fail."""
        executed = [row.result is Result.SUCCESS for row in state.rows if row.result is not Result.INFEASIBLE]
        return len(executed) >= RECENT and sum(executed[-RECENT:]) <= 1 and len(executed) % 2 == 0

    def _along_axes(self, known: Knowledge, cut: float) -> Point | None:
        """Move one parameter of the cheapest success halfway to a value that is known to fail.

        Return the cheapest of these points; None if no success is known, or if none of these points is undecided and
        costs less than `cut`.
        """
        if not len(known.successes):
            return None
        best = known.successes[np.argmin(self.map.exact(known.successes))]
        points = np.tile(best, (self.k, 1))
        for axis in range(self.k):
            rest = np.arange(self.k) != axis
            above = known.failures[np.all(known.failures[:, rest] >= best[rest], axis=1), axis]
            points[axis, axis] = (best[axis] + above.max(initial=0.0)) / 2
        points = points[known.undecided(points)]
        costs = self.map.exact(points)
        return tuple(points[np.argmin(costs)].tolist()) if costs.min(initial=np.inf) < cut else None

    def _probe(self, state: BranchState, known: Knowledge, cut: float) -> Point | None:
        """Return the cheapest candidate that is likely enough to meet the rate; without one, the likeliest."""
        points = np.vstack([self._candidates(state, known, cut), known.successes, known.failures])
        points = points[np.argsort(self.map.guide(points), kind="stable")]
        least = PROBES[len(state.rows) % len(PROBES)]
        model = self.posterior(state)
        rough = self._confidence(state, model.thinned(), points)
        hopeful = points[rough >= least - ROUGH]
        for first in range(0, len(hopeful), TOGETHER):
            some = hopeful[first : first + TOGETHER]
            for point in some[self._confidence(state, model, some) >= least]:
                if self.map.exact(point[None])[0] < cut:
                    return tuple(point.tolist())
        for point in points[np.argsort(-rough, kind="stable")][:ATTEMPTS]:
            if self.map.exact(point[None])[0] < cut:
                return tuple(point.tolist())
        return None

    def _candidates(self, state: BranchState, known: Knowledge, cut: float) -> Array:
        """Return candidates (m, k) that cost less than `cut`; without noise they are undecided too."""
        points = self._spread(state, known)
        if self.noisy:
            known = replace(known, successes=known.successes[:0], failures=known.failures[:0])
        return points[(self.map.guide(points) < cut) & known.undecided(points)]

    def _spread(self, state: BranchState, known: Knowledge) -> Array:
        """Return random points in the whole cube and near the cheapest successes (m, k)."""
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
        return np.vstack(sets)

    def _value(self, model: Model, known: Knowledge, points: Array, costs: Array, cut: float) -> Array:
        """Return the expected gain of testing each candidate and then the best next one, (m,) [s]."""
        margin = model.margin(points)
        meets = self.meets(model, margin).astype(float)
        both, chance = meets.T @ meets / len(meets), meets.mean(axis=0)
        after_success = np.max(both * np.maximum(costs[:, None] - costs, 0), axis=1)
        after_failure = np.max((chance - both) * (cut - costs), axis=1)
        chance = (1 - DOUBT) * chance + DOUBT * _chance_by_distance(known, points)
        return chance * (cut - costs) + after_success + after_failure


ROUGH = 0.2
"""Largest deficit of the chance by a part of the samples for which the chance by all samples is computed."""

RECENT = 4
"""Number of executions, at most one of which succeeded, after which every second point is chosen without the model."""

TOGETHER = 64
"""Number of candidates that are examined together."""

ATTEMPTS = 20
"""Number of best candidates whose f* is computed exactly until one is cheap enough."""

NEAR = 3
"""Number of cheapest successes near which candidates are sampled."""


def _chance_by_distance(known: Knowledge, points: Array) -> Array:
    """Return the chance of success from the distances to the nearest failure and success, (m,).

    The ends a and b count as a failure and a success.
    """
    k = points.shape[1]
    failures, successes = np.vstack([np.zeros((1, k)), known.failures]), np.vstack([np.ones((1, k)), known.successes])
    up = np.min([np.linalg.norm(np.maximum(points - failure, 0), axis=1) for failure in failures], axis=0)
    down = np.min([np.linalg.norm(np.maximum(success - points, 0), axis=1) for success in successes], axis=0)
    return up / (up + down + 1e-12)


def _chance_by_monotony(known: Knowledge, points: Array, rate: float) -> Array:
    """Return the chance that points meet a rate by a beta posterior for each, (m,); its prior has weight 2.

    A success at a more optimistic point counts for a point, and a failure at a more conservative one against it: by
    monotony, success is at most as likely at the former, and at least as likely at the latter, as at the point itself.
    """
    for_it = np.all(known.successes[None] <= points[:, None], axis=2).sum(axis=1)
    against = np.all(known.failures[None] >= points[:, None], axis=2).sum(axis=1)
    (for_it, against), which = np.unique([for_it, against], axis=1, return_inverse=True)
    return np.asarray(betaincc(2 * rate + for_it, 2 * (1 - rate) + against, rate))[which]
