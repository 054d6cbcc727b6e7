"""The learner that a configuration names."""

from __future__ import annotations

from typing import Any

from robustopt.confidence import Reading
from robustopt.config import FirstBelief, LearningConfig
from robustopt.errors import ConfigError, RobustOptError
from robustopt.learning.acceleration_interval import AccelerationInterval
from robustopt.learning.bisection import Bisection
from robustopt.learning.branch_and_bound import BranchAndBound, Diagonal, Midpoint
from robustopt.learning.calibrated import Calibrated
from robustopt.learning.foresight import Foresight
from robustopt.learning.ilrobs import Ilrobs
from robustopt.learning.informed import Informed
from robustopt.learning.learner import Learner
from robustopt.learning.moments import ErrorInterval
from robustopt.learning.outcomes import Belief
from robustopt.learning.parameters import Cost, Parameter
from robustopt.learning.physics import Physics

LEARNERS: tuple[type[Learner[Any]], ...] = (
    Bisection, AccelerationInterval, Ilrobs, Calibrated, Midpoint, Diagonal, Informed, Physics,
)  # fmt: skip

DELTA = 0.05
"""Width of the friction interval at which the learners of friction stop by default (paper)."""

SMALLEST_SIDE = 0.005
"""Smallest side of a box of parameters by default: with one of 0.05, searches for 1 % ended above it (our choice)."""

BRANCH_AND_BOUND: tuple[type[BranchAndBound], ...] = (Midpoint, Diagonal, Informed)
"""The learners of `learning.parameters`, which need f*."""


def learner_of(settings: LearningConfig, cost: Cost | None = None, foresight: Foresight | None = None) -> Learner[Any]:
    """Return the learner that a configuration names, with its settings.

    `ilrobs-calibrated` bisects friction geometrically, so it reads a lower end of 0 as `delta`.

    Args:
        settings: the section `learning`.
        cost: f* of values of `learning.parameters`, which the branch-and-bound learners need: a pure function
            (m, k) -> durations (m,) [s], inf for no plan, that remembers its results.
        foresight: forecast of the executions of plans for such values, which `physics` needs.

    Returns:
        The learner.

    Raises:
        ConfigError: the algorithm is none of `LEARNERS`, or a setting does not suit it.
    """
    low, high = settings.friction
    delta = DELTA if settings.delta is None else settings.delta
    reading = Reading(settings.reading)
    match settings.algorithm:
        case Bisection.name:
            return Bisection(friction=(low, high), delta=delta, epsilon=settings.epsilon)
        case AccelerationInterval.name:
            return AccelerationInterval(
                K=settings.K, executions=settings.executions, threshold=settings.threshold,
                iterations=settings.iterations,
            )  # fmt: skip
        case Ilrobs.name:
            return Ilrobs(
                K=settings.K, friction=(low, high), delta=delta, reading=reading, try_upper=settings.try_upper
            )
        case Calibrated.name:
            return Calibrated(
                rate=settings.success_rate, confidence=settings.confidence, friction=(low or delta, high),
                resolution=settings.resolution, K_values=settings.K_values, futility=settings.futility,
                patience=settings.patience, first=_first_belief(settings.first),
            )  # fmt: skip
    for kind in BRANCH_AND_BOUND:
        if settings.algorithm == kind.name:
            return kind(**_branch_and_bound(kind.name, settings, cost))
    if settings.algorithm == Physics.name:
        if foresight is None:
            raise RobustOptError(f"{Physics.name}: found no foresight; expected a forecast of the executions of plans")
        return Physics(foresight=foresight, **_branch_and_bound(Physics.name, settings, cost))
    names = ", ".join(learner.name for learner in LEARNERS)
    raise ConfigError(f"found {settings.algorithm}; expected one of {names}", key="learning.algorithm")


def _first_belief(first: FirstBelief | None) -> Belief | None:
    if first is None:
        return None
    error = first.joint_acceleration
    mean, deviation = (value if isinstance(value, tuple) else (value,) for value in (error.mean, error.deviation))
    return Belief(first.friction, ErrorInterval(mean, deviation, error.K))


def _branch_and_bound(name: str, settings: LearningConfig, cost: Cost | None) -> dict[str, Any]:
    """Return the settings that the learners of several parameters share."""
    if cost is None:
        raise RobustOptError(f"{name}: found no cost; expected f* of the parameters")
    return {
        "parameters": tuple(Parameter(p.key, p.optimistic, p.conservative) for p in settings.parameters),
        "cost": cost,
        "delta": SMALLEST_SIDE if settings.delta is None else settings.delta,
        "gap": settings.gap,
        "budget": settings.budget,
        "executions_per_plan": settings.executions_per_plan or 1,
        "plans": settings.plans,
    }
