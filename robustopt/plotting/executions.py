"""Trials over time: how far objects and joints stray, and the executed acceleration against the plan."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from robustopt.config_model import FailureConfig
from robustopt.execution.trace import Trace
from robustopt.plotting.style import BLUE, GREY, INK, LIMIT_COLOURS, VERMILLION

SHOWN = 1.5
"""What exceeds this many times its threshold is cut off: an object on the floor says nothing more."""


def trials_figure(traces: Sequence[Trace], joint_names: Sequence[str], failure: FailureConfig, title: str) -> Figure:
    """Slip and tilt of every object and tracking error of every joint over time, a column per trial."""
    figure = Figure(figsize=(max(3.6 * len(traces), 5.0) + 1.6, 6.4))
    axes = figure.subplots(3, len(traces), sharex="col", sharey="row", squeeze=False)
    rows = (("slip", 1e3, failure.slip, "slip [mm]"), ("tilt", np.degrees(1.0), failure.tilt, "tilt [°]"))
    for column, trace in enumerate(traces):
        for row, (kind, factor, limit, _) in enumerate(rows):
            for colour, (name, motion) in zip(LIMIT_COLOURS, trace.objects.items(), strict=False):
                axes[row, column].plot(trace.t, factor * getattr(motion, kind), color=colour, label=name)
            axes[row, column].axhline(factor * limit, color=INK, linewidth=0.8)
        for colour, name, error in zip(LIMIT_COLOURS, joint_names, 1e3 * trace.tracking_error.T, strict=False):
            axes[2, column].plot(trace.t, error, color=colour, linewidth=1.0, label=name)
        outcome = trace.outcome
        axes[0, column].set_title(f"trial {outcome.trial}: {outcome.status.value} {outcome.what}".rstrip())
        axes[2, column].set_xlabel("time [s]")
        for axis in axes[:, column]:
            _mark(axis, trace)
    for row, (_, factor, limit, label) in enumerate(rows):
        axes[row, 0].set_ylabel(label)
        axes[row, 0].set_ylim(0, SHOWN * factor * limit)
    before = [np.abs(trace.tracking_error[_sound(trace)]).max(initial=1e-9) for trace in traces]
    axes[2, 0].set_ylim(-1.3e3 * max(before), 1.3e3 * max(before))
    axes[2, 0].set_ylabel("tracking error [mrad]")
    for row in (0, 2):
        axes[row, -1].legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
    figure.suptitle(title, x=0.01, ha="left")
    return figure


def accelerations_figure(trace: Trace, joint_names: Sequence[str], title: str) -> Figure:
    """Joint acceleration of a trial, low-passed, against the plan, a row per joint."""
    figure = Figure(figsize=(6.5, 0.8 + 1.1 * len(joint_names)))
    axes = figure.subplots(len(joint_names), 1, sharex=True, squeeze=False)[:, 0]
    shown = np.convolve(trace.moving, np.ones(101), mode="same") > 0
    for joint, (axis, name) in enumerate(zip(axes, joint_names, strict=True)):
        axis.plot(trace.t[shown], trace.executed[shown, joint], color=BLUE, linewidth=1.0, label="executed")
        axis.plot(trace.t[shown], trace.planned[shown, joint], color=INK, linewidth=0.8, label="planned")
        peak = np.abs(trace.planned[shown, joint]).max(initial=1e-6)
        axis.set_ylim(-2.0 * peak, 2.0 * peak)
        axis.set_ylabel(name)
        _mark(axis, trace)
    axes[-1].set_xlabel("time [s]")
    axes[0].set_title(f"joint acceleration [rad/s²], trial {trace.outcome.trial}")
    axes[0].legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
    figure.suptitle(title, x=0.01, ha="left")
    return figure


def _sound(trace: Trace) -> np.ndarray:
    """Steps before the trial failed."""
    return trace.t < trace.outcome.time if trace.outcome.what else np.ones(len(trace.t), dtype=bool)


def _mark(axis: Axes, trace: Trace) -> None:
    """Shade the time the robot stands still, and mark where the trial failed."""
    moving = trace.t[trace.moving]
    for start, end in ((trace.t[0], moving[0]), (moving[-1], trace.t[-1])):
        axis.axvspan(start, end, color=GREY, alpha=0.25, linewidth=0)
    axis.set_xlim(trace.t[0], trace.t[-1])
    if trace.outcome.what:
        axis.axvline(trace.outcome.time, color=VERMILLION, linewidth=1.2)
