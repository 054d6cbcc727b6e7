"""Parameters that are learned together: values of the configuration as points of the unit cube."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import exp, isfinite, log

import numpy as np

from robustopt.arrays import Array
from robustopt.errors import ConfigError

Point = tuple[float, ...]
"""A point of the unit cube; each coordinate goes from 0, optimistic, to 1, conservative."""

Cost = Callable[[Array], Array]
"""f*: values of the parameters (m, k), in their order, -> durations of the plans (m,) [s], inf for no plan."""


@dataclass(frozen=True)
class Parameter:
    """A numeric nominal value of the configuration and the interval in which it is searched.

    If both ends have the same sign, equal steps in the unit cube are equal ratios of the value, because durations are
    powers of friction and mass; otherwise they are equal differences (our choice).

    Attributes:
        key: key in the configuration, such as "contact.friction.upper".
        optimistic: end of the interval with the fastest plans.
        conservative: end of the interval with the slowest plans.
    """

    key: str
    optimistic: float
    conservative: float

    def __post_init__(self) -> None:
        ends = (self.optimistic, self.conservative)
        if not all(map(isfinite, ends)) or ends[0] == ends[1]:
            raise ConfigError(
                f"found {ends[0]:g} and {ends[1]:g} for {self.key}; expected two different numbers",
                key="learning.parameters",
            )

    def value(self, t: float) -> float:
        """Return the value at a coordinate of the unit cube.

        Args:
            t: coordinate, from 0 to 1.

        Returns:
            The value; exactly the ends at 0 and 1.
        """
        a, b = self.optimistic, self.conservative
        if t in (0.0, 1.0):
            return b if t else a
        return a * exp(t * log(b / a)) if a * b > 0 else a + t * (b - a)


def values(parameters: Sequence[Parameter], points: Array) -> Array:
    """Return the values of the parameters at points of the unit cube.

    Args:
        parameters: the k parameters.
        points: points, (m, k).

    Returns:
        Values, (m, k).
    """
    columns = zip(parameters, np.asarray(points).T, strict=True)
    return np.array([[parameter.value(t) for t in column] for parameter, column in columns]).T
