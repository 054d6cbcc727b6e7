"""Parameters that are learned several at once: values of the configuration, as points of the unit cube."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import exp, isfinite, log

import numpy as np

from robustopt.errors import ConfigError

Array = np.ndarray
Point = tuple[float, ...]
"""A point of the unit cube: 0 where a parameter is optimistic, 1 where it is conservative."""

Cost = Callable[[Array], Array]
"""f*: values of the parameters (m, k), in their order, -> durations of the plans (m,) [s], inf where there is none."""


@dataclass(frozen=True)
class Parameter:
    """A numeric belief of the configuration and the interval in which it is searched.

    Where both ends have one sign, equal steps in the unit cube are equal ratios of the value, else equal differences:
    durations go with powers of friction and mass (our choice).
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
        """The value at t in [0, 1]; exactly the ends at 0 and 1."""
        a, b = self.optimistic, self.conservative
        if t in (0.0, 1.0):
            return b if t else a
        return a * exp(t * log(b / a)) if a * b > 0 else a + t * (b - a)


def values(parameters: Sequence[Parameter], points: Array) -> Array:
    """Values of points of the unit cube, (m, k) -> (m, k)."""
    columns = zip(parameters, np.asarray(points).T, strict=True)
    return np.array([[parameter.value(t) for t in column] for parameter, column in columns]).T


LARGE = 1e3
"""A node without a plan counts as so many times the longest duration when f* is interpolated."""

MOST_NODES = 33
"""Nodes of one axis that are enough for the interpolation of f*."""


FALL = 0.005
"""Largest relative fall of f* towards the conservative end: solvers leave 5e-5, and few gaps asked for are smaller."""

FLAT = 1e-4
"""Relative change of f* over all of an interval that counts as none: solvers leave 5e-5."""

FLAT_NODES = 5
"""Nodes of one axis that are enough to say so."""


class CostMap:
    """f* over the unit cube: exact where it is asked for, and interpolated from a grid where it is only a guide.

    The interpolation is multilinear in log f*, so it grows with every parameter where f* does. It chooses what is
    looked at; no bound rests on it.

    cost: in values of the parameters; plans: most evaluations of f* for the grid
    """

    def __init__(self, parameters: Sequence[Parameter], cost: Cost, plans: int) -> None:
        self._parameters, self._cost, self._plans = tuple(parameters), cost, plans
        self._nodes: Array | None = None
        self._longest = np.inf

    def exact(self, points: Array) -> Array:
        """f* at points (m, k) -> (m,) [s]."""
        if len(points) == 0:
            return np.zeros(0)
        return np.asarray(self._cost(values(self._parameters, points)), dtype=float)

    def longest(self) -> float:
        """Duration of the longest plan of the grid [s]; inf where it has none."""
        self.guide(np.zeros((1, len(self._parameters))))
        return self._longest

    def guide(self, points: Array) -> Array:
        """Interpolated f* at points (m, k) -> (m,) [s]; the grid is evaluated at the first call."""
        nodes = self._nodes = self._grid() if self._nodes is None else self._nodes
        place = np.asarray(points) * (len(nodes) - 1)
        cell = np.minimum(place.astype(int), len(nodes) - 2)
        share = place - cell
        table = nodes.ravel()
        strides = len(nodes) ** np.arange(nodes.ndim - 1, -1, -1)
        total = np.zeros(len(place))
        for corner in np.ndindex(*(2,) * nodes.ndim):
            weight = np.prod(np.where(corner, share, 1 - share), axis=1)
            total += weight * table[(cell + np.array(corner)) @ strides]
        return np.exp(total)

    def require_growth(self) -> None:
        """Raise ConfigError where f*, at the nodes of the grid, falls along a parameter, or depends on others alone.

        Without a plan f* is largest.
        """
        self.guide(np.zeros((1, len(self._parameters))))
        nodes = self._nodes
        assert nodes is not None
        flat = [float(np.ptp(nodes, axis=axis).max()) < FLAT for axis in range(nodes.ndim)]
        for axis, parameter in enumerate(self._parameters):
            if flat[axis] and not all(flat) and len(nodes) >= FLAT_NODES:
                raise ConfigError(
                    f"found the same plans for every {parameter.key} from {parameter.optimistic:g} to "
                    f"{parameter.conservative:g}; expected parameters that durations depend on: give the conservative "
                    "value to the configuration, which costs nothing, and leave the parameter out",
                    key="learning.parameters",
                )
            falls = np.maximum.accumulate(nodes, axis=axis) - nodes
            if falls.max() > np.log1p(FALL):
                raise ConfigError(self._fall(axis, nodes, falls), key="learning.parameters")

    def _fall(self, axis: int, nodes: Array, falls: Array) -> str:
        """The largest fall of f* along an axis in words, from its nodes and how far each is below one before it."""
        parameter = self._parameters[axis]
        node = np.unravel_index(np.argmax(falls), nodes.shape)
        line = np.moveaxis(nodes, axis, 0)[(slice(None), *np.delete(node, axis))]
        points = np.tile(np.array(node, dtype=float), (2, 1))
        points[0, axis] = np.argmax(line[: node[axis]])
        points /= len(nodes) - 1
        numbers = values(self._parameters, points)
        plans = [f"a plan of {f:.4g} s" if np.isfinite(f) else "no plan" for f in self.exact(points)]
        slower, faster = (f"{plans[i]} for {parameter.key} = {numbers[i, axis]:.4g}" for i in (0, 1))
        others = [f"{p.key} = {numbers[0, i]:.4g}" for i, p in enumerate(self._parameters) if i != axis]
        place = f" (with {', '.join(others)})" if others else ""
        return (
            f"found {slower} and {faster}, which is nearer to the conservative end{place}; expected plans that never "
            f"get faster from optimistic ({parameter.optimistic:g}) to conservative ({parameter.conservative:g}): swap "
            "the two, or search on one side of the fastest value"
        )

    def _grid(self) -> Array:
        """log f* at the nodes, (n, ..., n)."""
        k = len(self._parameters)
        count = min(MOST_NODES, max(2, int(self._plans ** (1 / k) + 1e-9)))
        axes = np.meshgrid(*[np.linspace(0, 1, count)] * k, indexing="ij")
        found = self.exact(np.stack(axes, axis=-1).reshape(-1, k))
        planned = found[np.isfinite(found)]
        self._longest = float(planned.max()) if len(planned) else np.inf
        most = LARGE * min(self._longest, 1e100)
        return np.log(np.where(np.isfinite(found), found, most)).reshape((count,) * k)
