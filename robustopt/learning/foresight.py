"""Task model of the learner `physics`: how objects can fail, and the strength that a plan needs (ours)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from robustopt.arrays import Array
from robustopt.evidence import UNKNOWN, Failure
from robustopt.learning.cost_map import interpolated
from robustopt.learning.parameters import Parameter, values

STEPS = 400
"""Number of equal time steps of a motion at which the needed strength is known."""

MOST_NODES = (33, 12, 6, 4, 3)
"""Number of nodes along each axis for 1, 2, ... parameters."""

SLIDES, TIPS = ("slid",), ("tipped",)
"""Kinds of failure that name one way to fail."""

OPEN = ("fell", "lost contact", UNKNOWN)
"""Kinds of failure that can result from either."""

NO_PLAN = 10.0
"""Needed strength at a node without a plan, far above all others, as a logarithm."""


@dataclass(frozen=True)
class Mechanism:
    """A way in which an object fails against its support.

    Attributes:
        what: the object.
        kinds: kinds of failure that name it.
    """

    what: str
    kinds: tuple[str, ...]


class Foresight(Protocol):
    """Forecast of the executions of plans; a pure function of the values that they are planned with.

    The strength of a mechanism is the friction of a contact against sliding, and against tipping the part of the base
    that remains when its contact points lie further inside. An object survives as long as its strength exceeds the
    needed one. All strengths are logarithms.
    """

    @property
    def mechanisms(self) -> tuple[Mechanism, ...]:
        """Return the M ways to fail."""

    def strengths(self, values: Array) -> Array:
        """Return the strength of each mechanism in worlds with some values of the parameters.

        Args:
            values: actual values (m, k).

        Returns:
            Strengths (m, M).
        """

    def needed(self, values: Array) -> Array:
        """Return the strength with which each mechanism survives the plan for some values, up to each time.

        Args:
            values: values to plan with (m, k).

        Returns:
            Strengths at equal time steps (m, STEPS + 1, M); nan without a plan.
        """


class NeedMap:
    """Strength that plans need over the unit cube of the parameters: exact at single points, interpolated elsewhere."""

    def __init__(self, parameters: Sequence[Parameter], foresight: Foresight) -> None:
        """Prepare the map; nothing is planned yet.

        Args:
            parameters: the k parameters.
            foresight: the forecast.
        """
        self._parameters, self.foresight = tuple(parameters), foresight
        self._nodes: Array | None = None
        self._known: dict[tuple[float, ...], Array] = {}

    def exact(self, point: tuple[float, ...]) -> Array:
        """Return the strength that the plan of a point needs up to each time, (STEPS + 1, M).

        Args:
            point: point of the unit cube (k,).
        """
        if point not in self._known:
            self._known[point] = self.foresight.needed(values(self._parameters, np.array([point])))[0]
        return self._known[point]

    def guide(self, points: Array) -> Array:
        """Return the interpolated strength that plans need to the end; the first call plans the nodes.

        Args:
            points: points of the unit cube (m, k).

        Returns:
            Strengths (m, M); large near nodes without a plan.
        """
        nodes = self._nodes = self._grid() if self._nodes is None else self._nodes
        return interpolated(nodes, points)

    def _grid(self) -> Array:
        """Return the strength at the nodes (n, ..., n, M); a large one without a plan."""
        k = len(self._parameters)
        count = MOST_NODES[k - 1] if k <= len(MOST_NODES) else 2
        axes = np.meshgrid(*[np.linspace(0, 1, count)] * k, indexing="ij")
        found = self.foresight.needed(values(self._parameters, np.stack(axes, axis=-1).reshape(-1, k)))[:, -1]
        return np.where(np.isnan(found), NO_PLAN, found).reshape(*(count,) * k, -1)


def blame(failure: Failure, mechanisms: Sequence[Mechanism]) -> Array:
    """Return the mechanisms that may have caused a failure, with weights that sum up to 1, (M,).

    All weights are 0 if the failure is none of an object, such as a joint torque at its limit.

    Args:
        failure: the failure, as far as it is known.
        mechanisms: the M mechanisms.
    """
    named = any(failure.kind in item.kinds for item in mechanisms)
    if not named and failure.kind not in OPEN:
        return np.zeros(len(mechanisms))
    fits = np.array(
        [
            (not failure.what or item.what == failure.what) and (not named or failure.kind in item.kinds)
            for item in mechanisms
        ],
        dtype=float,
    )
    return fits / max(fits.sum(), 1.0)
