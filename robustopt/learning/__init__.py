"""Learners: they move beliefs about friction and acceleration errors by what executions show.

`learner` is the contract; `bisection` (paper, Alg. 1), `acceleration_interval` (paper, page 8), `ilrobs` (paper,
Alg. 2) and `calibrated` (ours) are learners; `confidence`, `earned` and `sequential` say how sure one may be.
"""

from __future__ import annotations

from typing import Any

from robustopt.config_model import LearningConfig
from robustopt.errors import ConfigError
from robustopt.learning.acceleration_interval import AccelerationInterval
from robustopt.learning.bisection import Bisection
from robustopt.learning.calibrated import Calibrated
from robustopt.learning.ilrobs import Ilrobs
from robustopt.learning.learner import Learner

LEARNERS: tuple[type[Learner[Any]], ...] = (Bisection, AccelerationInterval, Ilrobs, Calibrated)


def learner_of(settings: LearningConfig) -> Learner[Any]:
    """The learner that a configuration asks for.

    `ilrobs-calibrated` searches friction geometrically, so a lower end of 0 stands for `delta`.

    Raises ConfigError where the algorithm is none of `LEARNERS`, or a setting does not suit it.
    """
    low, high = settings.friction
    match settings.algorithm:
        case Bisection.name:
            return Bisection(friction=(low, high), delta=settings.delta, epsilon=settings.epsilon)
        case AccelerationInterval.name:
            return AccelerationInterval(K=settings.K)
        case Ilrobs.name:
            return Ilrobs(K=settings.K, friction=(low, high), delta=settings.delta)
        case Calibrated.name:
            return Calibrated(friction=(low or settings.delta, high))
    names = ", ".join(learner.name for learner in LEARNERS)
    raise ConfigError(f"found {settings.algorithm}; expected one of {names}", key="learning.algorithm")
