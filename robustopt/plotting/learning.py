"""Figure of a learner: the shrinking interval, and the duration and success of every plan that was tried."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from robustopt.plotting.style import BLUE, GREEN, GREY, INK, VERMILLION
from robustopt.runs.records import Iteration

MARKS = {
    "success": ("o", GREEN), "failure": ("x", VERMILLION), "undecided": ("x", GREY), "infeasible": ("s", GREY),
    "not faster": (".", GREY), "not executed": ("D", BLUE),
}  # fmt: skip
"""Marker and colour by result."""


def learning_figure(records: Sequence[Iteration], target_rate: float, title: str) -> Figure:
    """Draw the learned interval, the duration and the success rate of every plan in order.

    Args:
        records: records of the plans.
        target_rate: success rate in question, drawn as a line.
        title: title of the figure.
    """
    panels = [_beliefs, _durations]
    if any(record.success_rate is not None for record in records):
        panels.append(_successes)
    figure = Figure(figsize=(max(5.0, 1.5 + 0.28 * len(records)) + 1.6, 1.0 + 1.9 * len(panels)))
    axes = figure.subplots(len(panels), 1, sharex=True, squeeze=False)[:, 0]
    for panel, axis in zip(panels, axes, strict=True):
        panel(axis, records)
    if len(panels) == 3:
        label = f"success rate in\nquestion: {100 * target_rate:.3g} %"
        axes[2].axhline(100 * target_rate, color=INK, linewidth=0.8, linestyle="--", zorder=0, label=label)
        axes[2].legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
    axes[-1].set_xlabel("plan")
    axes[-1].set_xlim(0.4, len(records) + 0.6)
    axes[-1].xaxis.set_major_locator(MaxNLocator(integer=True))
    _legend(axes[0], records)
    figure.align_ylabels(axes)
    figure.suptitle(title, x=0.01, ha="left")
    return figure


def _beliefs(axis: Axes, records: Sequence[Iteration]) -> None:
    """Draw the interval of the coefficient of friction, or the widest interval of the acceleration error."""
    if any(record.friction_high is not None for record in records):
        edges = 0.5 + np.arange(len(records) + 1)
        low, high = ([getattr(record, key) for record in records] for key in ("friction_low", "friction_high"))
        axis.stairs(high, edges, baseline=low, fill=True, color=BLUE, alpha=0.15)
        axis.stairs(high, edges, baseline=None, color=BLUE, linewidth=1.0)
        axis.stairs(low, edges, baseline=None, color=BLUE, linewidth=1.0)
        axis.use_sticky_edges = False  # else a mark at the end of the interval is cut
        _mark(axis, records, _numbers(records, "friction"))
        axis.set_ylabel("coefficient of friction")
    elif any(record.incumbent is not None for record in records):
        x = 1 + np.arange(len(records))
        for key, colour, label in (("incumbent", GREEN, "best so far"), ("lower_bound", BLUE, "lower bound")):
            axis.step(x, _numbers(records, key), where="post", color=colour, linewidth=1.2, label=label)
        axis.set_ylabel("duration [s]")
    else:
        _mark(axis, records, [max(record.planned_half_width, default=0.0) for record in records])
        axis.set_ylabel("error interval, ±\n[rad/s² or m/s²]")


def _durations(axis: Axes, records: Sequence[Iteration]) -> None:
    _mark(axis, records, _numbers(records, "duration"))
    axis.set_ylabel("duration [s]")


def _successes(axis: Axes, records: Sequence[Iteration]) -> None:
    for i, record in enumerate(records):
        if record.success_low is not None and record.success_high is not None:
            ends = [100 * record.success_low, 100 * record.success_high]
            label = None if axis.get_legend_handles_labels()[1] else "confidence interval"
            axis.plot([i + 1, i + 1], ends, color=GREY, linewidth=3.0, solid_capstyle="butt", zorder=1, label=label)
    _mark(axis, records, [100 * rate for rate in _numbers(records, "success_rate")], joined=False)
    axis.set_ylim(-4, 104)
    axis.set_ylabel("fresh successes [%]")


def _numbers(records: Sequence[Iteration], key: str) -> list[float]:
    """Return one field of all records, nan for None."""
    values = [getattr(record, key) for record in records]
    return [np.nan if value is None else value for value in values]


def _mark(axis: Axes, records: Sequence[Iteration], values: Sequence[float], joined: bool = True) -> None:
    """Mark the plans by their results, joined by lines unless the search begins anew."""
    starts = [0, *(i for i in range(1, len(records)) if _begins_anew(records[i - 1], records[i])), len(records)]
    for start, end in pairwise(starts) if joined else ():
        axis.plot(1 + np.arange(start, end), values[start:end], color=INK, linewidth=0.6, zorder=1)
    for i, (record, value) in enumerate(zip(records, values, strict=True)):
        marker, colour = MARKS[str(record.result)]
        axis.plot(i + 1, value, marker=marker, color=colour, markersize=6, zorder=2)


def _begins_anew(before: Iteration, record: Iteration) -> bool:
    """Return whether the interval of friction is wider than before, which means that a search for the next K begins."""
    low, high = before.friction_low, before.friction_high
    if low is None or high is None or record.friction_low is None or record.friction_high is None:
        return False
    return record.friction_low < low or record.friction_high > high


def _legend(axis: Axes, records: Sequence[Iteration]) -> None:
    for result in dict.fromkeys(str(record.result) for record in records):
        marker, colour = MARKS[result]
        axis.plot([], [], marker=marker, color=colour, linestyle="none", label=result)
    axis.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
