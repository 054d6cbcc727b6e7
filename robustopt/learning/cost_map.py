"""The duration f* over the unit cube of the parameters: exact at single points, interpolated as a guide."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from robustopt.arrays import Array
from robustopt.errors import ConfigError
from robustopt.learning.parameters import Cost, Parameter, values

LARGE = 1e3
"""Factor on the longest duration that a node without a plan gets in the interpolation of f*."""

MOST_NODES = 33
"""Largest number of nodes of one axis of the grid."""

FALL = 0.005
"""Largest relative decrease of f* towards the conservative end that is accepted: solvers leave 5e-5, and few desired
gaps are smaller.
"""

FLAT = 1e-4
"""Largest relative change of f* over a whole interval that counts as none: solvers leave 5e-5."""

FLAT_NODES = 5
"""Smallest number of nodes of one axis that shows that f* does not change."""

BITS = 30
"""Binary digits to which durations are compared: about 9 decimal digits, of which 11 are the same on two processors."""


def settled(values: Array) -> Array:
    """Round values to `BITS` binary digits, so that equal ones are equal and no last bit decides between them.

    Args:
        values: durations, or values made from them, of any shape; inf stays inf.

    Returns:
        Rounded values of the same shape.
    """
    mantissa, exponent = np.frexp(values)
    return np.asarray(np.ldexp(np.round(mantissa * 2.0**BITS) / 2.0**BITS, exponent))


def interpolated(nodes: Array, points: Array) -> Array:
    """Interpolate values at the nodes of a grid over the unit cube multilinearly.

    Args:
        nodes: M values at each node, (n, ..., n, M).
        points: points of the unit cube, (m, k).

    Returns:
        Values, (m, M).
    """
    k, count = nodes.ndim - 1, len(nodes)
    place = np.asarray(points) * (count - 1)
    cell = np.minimum(place.astype(int), count - 2)
    share, table = place - cell, nodes.reshape(-1, nodes.shape[-1])
    strides = count ** np.arange(k - 1, -1, -1)
    total = np.zeros((len(place), nodes.shape[-1]))
    for corner in np.ndindex(*(2,) * k):
        weight = np.prod(np.where(corner, share, 1 - share), axis=1)
        total += weight[:, None] * table[(cell + np.array(corner)) @ strides]
    return total


class CostMap:
    """The duration f* over the unit cube: exact at single points, and interpolated from a grid as a guide.

    All durations are `settled`: learners compare them, and f* is often the same over a whole region, where another
    limit binds than the ones that the parameters move.

    The interpolation is multilinear in log f*, so it grows with every parameter if f* does. It chooses the points at
    which f* is evaluated; no bound rests on it.
    """

    def __init__(self, parameters: Sequence[Parameter], cost: Cost, plans: int) -> None:
        """Prepare the map; nothing is evaluated yet.

        Args:
            parameters: the k parameters.
            cost: f* of values of the parameters.
            plans: largest number of evaluations of f* for the grid.
        """
        self._parameters, self._cost, self._plans = tuple(parameters), cost, plans
        self._nodes: Array | None = None
        self._longest = np.inf

    def exact(self, points: Array) -> Array:
        """Return f* at points.

        Args:
            points: points of the unit cube, (m, k).

        Returns:
            Durations, (m,) [s]; inf for no plan.
        """
        if len(points) == 0:
            return np.zeros(0)
        return settled(np.asarray(self._cost(values(self._parameters, points)), dtype=float))

    def longest(self) -> float:
        """Return the duration of the longest plan of the grid [s]; inf if the grid has no plan."""
        self.guide(np.zeros((1, len(self._parameters))))
        return self._longest

    def guide(self, points: Array) -> Array:
        """Return the interpolated f* at points; the first call evaluates the grid.

        Args:
            points: points of the unit cube, (m, k).

        Returns:
            Durations, (m,) [s].
        """
        nodes = self._nodes = self._grid() if self._nodes is None else self._nodes
        return settled(np.exp(interpolated(nodes[..., None], points)[:, 0]))

    def require_growth(self) -> None:
        """Check that f*, at the nodes of the grid, depends on every parameter and never decreases along one.

        Nodes without a plan count as the largest durations.

        Raises:
            ConfigError: f* decreases along a parameter, or does not depend on one.
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
        """Describe the largest decrease of f* along an axis.

        `nodes` is log f* at the nodes, (n, ..., n); `falls` is the decrease from the largest node before each, same
        shape.
        """
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
        """Return log f* at the nodes, (n, ..., n)."""
        k = len(self._parameters)
        count = min(MOST_NODES, max(2, int(self._plans ** (1 / k) + 1e-9)))
        axes = np.meshgrid(*[np.linspace(0, 1, count)] * k, indexing="ij")
        found = self.exact(np.stack(axes, axis=-1).reshape(-1, k))
        planned = found[np.isfinite(found)]
        self._longest = float(planned.max()) if len(planned) else np.inf
        most = LARGE * min(self._longest, 1e100)
        return np.log(np.where(np.isfinite(found), found, most)).reshape((count,) * k)
