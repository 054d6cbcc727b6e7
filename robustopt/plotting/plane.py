"""Plane of two learned parameters: executions, the regions they decide, and contour lines of f* (paper, Fig. 8)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from robustopt.arrays import Array, Flags
from robustopt.plotting.style import BLUE, DARK_GREY, GREEN, INK, VERMILLION

TICKS = (0.0, 0.25, 0.5, 0.75, 1.0)


@dataclass(frozen=True)
class Plane:
    """A learning run of two parameters in the unit square; 0 is the optimistic end of each, 1 the conservative one.

    Attributes:
        labels: names of the two parameters.
        ticks: values of the parameters at TICKS (2, 5).
        durations: f* on a square grid, optimistic corner first (n, n) [s]; infinite without a plan.
        points: the executed plans in order (m, 2).
        succeeded: whether each of them succeeded (m,).
    """

    labels: tuple[str, str]
    ticks: Array
    durations: Array
    points: Array
    succeeded: Flags


def plane_figure(planes: Sequence[tuple[str, Plane]], after: Sequence[int]) -> Figure:
    """Draw one row for each learner and one column for each number of executed plans.

    Args:
        planes: the planes, each with the name of its learner.
        after: numbers of executed plans.

    Returns:
        The figure.
    """
    rows, columns = len(planes), len(after)
    figure = Figure(figsize=(2.4 * columns + 1.2, 2.5 * rows + 0.5))
    axes = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    for row, (name, plane) in enumerate(planes):
        for column, count in enumerate(after):
            axis = axes[row, column]
            _draw(axis, plane, count)
            done = min(count, len(plane.points))
            axis.set_title(f"{name}, {done} plans" if column == 0 else f"{done} plans")
        axes[row, 0].set_ylabel(plane.labels[1])
    for axis in axes[-1]:
        axis.set_xlabel(planes[-1][1].labels[0])
    return figure


def _draw(axis: Axes, plane: Plane, count: int) -> None:
    points, succeeded = plane.points[:count], plane.succeeded[:count]
    _shade(axis, points[succeeded], conservative=True)
    _shade(axis, points[~succeeded], conservative=False)
    _contours(axis, plane.durations)
    for success, marker, colour in ((True, "o", GREEN), (False, "x", VERMILLION)):
        chosen = points[succeeded == success]
        axis.plot(chosen[:, 0], chosen[:, 1], marker, color=colour, markersize=4.5, zorder=3)
    best = _best(plane, points, succeeded)
    if best is not None:
        axis.plot(*best, "o", color=BLUE, markersize=7, markerfacecolor="none", markeredgewidth=1.6, zorder=4)
    axis.set_xlim(-0.03, 1.03)
    axis.set_ylim(-0.03, 1.03)
    for set_ticks, values in ((axis.set_xticks, plane.ticks[0]), (axis.set_yticks, plane.ticks[1])):
        set_ticks(TICKS, [f"{value:.3g}" for value in values])


def _shade(axis: Axes, points: Array, conservative: bool) -> None:
    """Shade the points that are at least as conservative as one of the given ones, or at least as optimistic."""
    edges = np.unique(np.concatenate([[0.0, 1.0], points[:, 0]]))
    middle = (edges[:-1] + edges[1:])[:, None] / 2
    decided = points[:, 0] <= middle if conservative else points[:, 0] >= middle
    if conservative:
        heights, base, colour = np.where(decided, points[:, 1], 1.0).min(axis=1, initial=1.0), 1.0, GREEN
    else:
        heights, base, colour = np.where(decided, points[:, 1], 0.0).max(axis=1, initial=0.0), 0.0, VERMILLION
    axis.stairs(heights, edges, baseline=base, fill=True, color=colour, alpha=0.22, linewidth=0)


def _contours(axis: Axes, durations: Array) -> None:
    side = np.linspace(0.0, 1.0, len(durations))
    lines = axis.contour(
        side, side, np.ma.masked_invalid(durations).T, levels=8, colors=DARK_GREY, linewidths=0.7, zorder=2
    )
    axis.clabel(lines, fmt="%.3g s", fontsize=6, colors=INK)


def _best(plane: Plane, points: Array, succeeded: Flags) -> Array | None:
    """Return the point of the fastest plan that succeeded, by f* at the nearest point of the grid."""
    chosen = points[succeeded]
    if not len(chosen):
        return None
    nearest = np.rint(chosen * (len(plane.durations) - 1)).astype(int)
    return np.asarray(chosen[np.argmin(plane.durations[nearest[:, 0], nearest[:, 1]])])
