"""Progress of a learning run: interval of the parameter, duration and success of every plan in order."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from robustopt.plotting.style import BLUE, GREEN, GREY, INK, VERMILLION

Record = Mapping[str, Any]

MARKS = {
    "success": ("o", GREEN), "failure": ("x", VERMILLION), "undecided": ("x", GREY), "infeasible": ("s", GREY),
    "not faster": (".", GREY), "not executed": ("D", BLUE),
}  # fmt: skip
"""Marker and colour by result."""


def learning_figure(records: Sequence[Record], target_rate: float, title: str) -> Figure:
    """Draw the interval of the parameter, the duration and the success rate of every plan in order.

    Args:
        records: The plans in order, as in the summary of a run.
        target_rate: The success rate in question, in [0, 1]; it is drawn as a line.
        title: The title of the figure.

    Returns:
        The figure; it has a panel of success rates if any plan has one.
    """
    panels = [_draw_intervals, _draw_durations]
    if any(record.get("success_rate") is not None for record in records):
        panels.append(_draw_successes)
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


def _draw_intervals(axis: Axes, records: Sequence[Record]) -> None:
    """Draw the interval of the friction coefficient, the bounds of the duration, or the interval of the error."""
    if any(record.get("friction_high") is not None for record in records):
        edges = 0.5 + np.arange(len(records) + 1)
        low, high = ([record[key] for record in records] for key in ("friction_low", "friction_high"))
        axis.stairs(high, edges, baseline=low, fill=True, color=BLUE, alpha=0.15)
        axis.stairs(high, edges, baseline=None, color=BLUE, linewidth=1.0)
        axis.stairs(low, edges, baseline=None, color=BLUE, linewidth=1.0)
        axis.use_sticky_edges = False  # otherwise a mark at the end of the interval is cut off
        _mark(axis, records, [record["friction"] for record in records])
        axis.set_ylabel("friction coefficient")
    elif any(record.get("incumbent") is not None for record in records):
        x = 1 + np.arange(len(records))
        for key, colour, label in (("incumbent", GREEN, "best so far"), ("lower_bound", BLUE, "lower bound")):
            values = [np.nan if record.get(key) is None else record[key] for record in records]
            axis.step(x, values, where="post", color=colour, linewidth=1.2, label=label)
        axis.set_ylabel("duration [s]")
    else:
        _mark(axis, records, [max(record["planned_half_width"], default=0.0) for record in records])
        axis.set_ylabel("error interval, ±\n[rad/s² or m/s²]")


def _draw_durations(axis: Axes, records: Sequence[Record]) -> None:
    _mark(axis, records, [np.nan if record["duration"] is None else record["duration"] for record in records])
    axis.set_ylabel("duration [s]")


def _draw_successes(axis: Axes, records: Sequence[Record]) -> None:
    for i, record in enumerate(records):
        if record.get("success_rate") is not None:
            low, high = 100 * record["success_low"], 100 * record["success_high"]
            axis.plot([i + 1, i + 1], [low, high], color=GREY, linewidth=3.0, solid_capstyle="butt", zorder=1)
    rates = [np.nan if record.get("success_rate") is None else 100 * record["success_rate"] for record in records]
    _mark(axis, records, rates, joined=False)
    axis.set_ylim(-4, 104)
    axis.set_ylabel("fresh successes [%]")


def _mark(axis: Axes, records: Sequence[Record], values: Sequence[float], joined: bool = True) -> None:
    """Mark the plans by their results and join them by a line, which breaks if a new search begins."""
    starts = [0, *(i for i in range(1, len(records)) if _begins_anew(records[i - 1], records[i])), len(records)]
    for start, end in pairwise(starts) if joined else ():
        axis.plot(1 + np.arange(start, end), values[start:end], color=INK, linewidth=0.6, zorder=1)
    for i, (record, value) in enumerate(zip(records, values, strict=True)):
        marker, colour = MARKS[record["result"]]
        axis.plot(i + 1, value, marker=marker, color=colour, markersize=6, zorder=2)


def _begins_anew(before: Record, record: Record) -> bool:
    """Return whether the interval of friction has widened, as it does when the search for the next K begins."""
    low, high = (record.get(key) for key in ("friction_low", "friction_high"))
    return low is not None and (low < before["friction_low"] or high > before["friction_high"])


def _legend(axis: Axes, records: Sequence[Record]) -> None:
    for result in dict.fromkeys(record["result"] for record in records):
        marker, colour = MARKS[result]
        axis.plot([], [], marker=marker, color=colour, linestyle="none", label=result)
    axis.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
