"""Learners: they move beliefs about friction and acceleration errors by what executions show.

`learner` is the contract; `bisection` (paper, Alg. 1), `acceleration_interval` (paper, page 8), `ilrobs` (paper,
Alg. 2) and `calibrated` (ours) are learners; `confidence`, `earned` and `sequential` say how sure one may be.
`branch_and_bound` and `informed` learn several parameters at once (problem: paper, 7.1; algorithms: ours).
"""

from __future__ import annotations

from typing import Any

from robustopt.confidence import Reading
from robustopt.config import FirstBelief, LearningConfig
from robustopt.errors import ConfigError, RobustOptError
from robustopt.learning.acceleration_interval import AccelerationInterval
from robustopt.learning.bisection import Bisection
from robustopt.learning.branch_and_bound import BranchAndBound, Diagonal, Midpoint
from robustopt.learning.calibrated import Calibrated
from robustopt.learning.ilrobs import Ilrobs
from robustopt.learning.informed import Informed
from robustopt.learning.learner import Belief, Learner
from robustopt.learning.moments import ErrorInterval
from robustopt.learning.parameters import Cost, Parameter

LEARNERS: tuple[type[Learner[Any]], ...] = (
    Bisection, AccelerationInterval, Ilrobs, Calibrated, Midpoint, Diagonal, Informed,
)  # fmt: skip

BRANCH_AND_BOUND: tuple[type[BranchAndBound], ...] = (Midpoint, Diagonal, Informed)
"""Those that learn `learning.parameters`, and need f*."""


def learner_of(settings: LearningConfig, cost: Cost | None = None) -> Learner[Any]:
    """The learner that a configuration asks for.

    `ilrobs-calibrated` searches friction geometrically, so a lower end of 0 stands for `delta`.

    cost: f* of values of `learning.parameters`, which the branch-and-bound learners need: (m, k) in their order ->
    durations (m,) [s], inf where there is no plan; a pure function that remembers what it evaluated

    Raises ConfigError where the algorithm is none of `LEARNERS`, or a setting does not suit it.
    """
    low, high = settings.friction
    reading = Reading(settings.reading)
    match settings.algorithm:
        case Bisection.name:
            return Bisection(friction=(low, high), delta=settings.delta, epsilon=settings.epsilon)
        case AccelerationInterval.name:
            return AccelerationInterval(
                K=settings.K, executions=settings.executions, threshold=settings.threshold,
                iterations=settings.iterations,
            )  # fmt: skip
        case Ilrobs.name:
            return Ilrobs(
                K=settings.K, friction=(low, high), delta=settings.delta, reading=reading, try_upper=settings.try_upper
            )
        case Calibrated.name:
            return Calibrated(
                rate=settings.success_rate, confidence=settings.confidence, friction=(low or settings.delta, high),
                resolution=settings.resolution, K_values=settings.K_values, futility=settings.futility,
                patience=settings.patience, first=_first_belief(settings.first),
            )  # fmt: skip
    for kind in BRANCH_AND_BOUND:
        if settings.algorithm == kind.name:
            return _branch_and_bound(kind, settings, cost)
    names = ", ".join(learner.name for learner in LEARNERS)
    raise ConfigError(f"found {settings.algorithm}; expected one of {names}", key="learning.algorithm")


def _first_belief(first: FirstBelief | None) -> Belief | None:
    if first is None:
        return None
    error = first.joint_acceleration
    mean, deviation = (value if isinstance(value, tuple) else (value,) for value in (error.mean, error.deviation))
    return Belief(first.friction, ErrorInterval(mean, deviation, error.K))


def _branch_and_bound(kind: type[BranchAndBound], settings: LearningConfig, cost: Cost | None) -> BranchAndBound:
    if cost is None:
        raise RobustOptError(f"{kind.name}: found no cost; expected f* of the parameters")
    return kind(
        parameters=tuple(Parameter(p.key, p.optimistic, p.conservative) for p in settings.parameters),
        cost=cost,
        delta=settings.delta,
        gap=settings.gap,
        budget=settings.budget,
        executions_per_plan=settings.executions_per_plan,
        plans=settings.plans,
    )
