"""Trials over time: slip, tilt and tracking error, and accelerations and contact forces against the plan."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from robustopt.arrays import Array, Flags
from robustopt.plotting.style import BLUE, CONTACT_COLOURS, GREY, INK, LIMIT_COLOURS, PALE, joint_unit
from robustopt.robot import Robot
from robustopt.simulation.trace import Trace
from robustopt.solvers.contact_forces import ContactForces

CONTACT_LABELS = (
    "normal force [N]", "tangential / normal force [1]", "centre of pressure, x [m]", "centre of pressure, y [m]",
)  # fmt: skip

MOVEMENTS = {"slip": (1e3, "slip [mm]"), "tilt": (float(np.degrees(1.0)), "tilt [°]")}
"""Factor from SI units to the axis and label of the axis, by kind of movement."""

SHOWN = 1.5
"""Largest value on an axis, in thresholds: once an object has fallen, more is of no interest."""

FAR = 10.0
"""A threshold that exceeds all values by this factor is left out, so that the values can be seen."""

FAILURE: dict[str, Any] = {"color": INK, "linewidth": 1.2, "linestyle": "--"}

STILL_SHADED = "grey: the robot stands still"

STILL = 1e-3
"""A coordinate with less than this share of the largest acceleration counts as still."""

LOADED = 0.05
"""Share of the largest planned force on a contact below which its friction and centre of pressure are meaningless."""


def trials_figure(traces: Sequence[Trace], robot: Robot, title: str) -> Figure:
    """Draw slip and tilt of all held bodies and the tracking error of the joints over time, one column per trial.

    Args:
        traces: the trials.
        robot: the robot that executed them.
        title: the title of the figure.

    Returns:
        The figure.
    """
    figure = Figure(figsize=(max(3.6 * len(traces), 5.0) + 1.6, 6.4))
    axes = figure.subplots(3, len(traces), sharex="col", sharey="row", squeeze=False)
    shown = _shown_joints(traces)
    for column, trace in enumerate(traces):
        _draw_trial(list(axes[:, column]), trace, shown)
    for axis, (kind, (factor, label)) in zip(axes[:, 0], MOVEMENTS.items(), strict=False):
        axis.set_ylabel(label)
        axis.set_ylim(0, factor * _top(traces, kind))
    largest = max(np.abs(trace.tracking_error[_before_failure(trace)]).max(initial=1e-9) for trace in traces)
    axes[2, 0].set_ylim(-1.3e3 * largest, 1.3e3 * largest)
    axes[2, 0].set_ylabel(f"tracking error [{joint_unit('mrad', robot.hinges[robot.motors])}]")
    for row in (0, 2):
        axes[row, -1].legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
    figure.suptitle(f"{title}; {STILL_SHADED}", x=0.01, ha="left")
    return figure


def _draw_trial(axes: Sequence[Axes], trace: Trace, joints: Sequence[int]) -> None:
    """Draw the column of a trial: slip, tilt, and the tracking error of the given joints."""
    for axis, (kind, (factor, _)) in zip(axes, MOVEMENTS.items(), strict=False):
        thresholds = {factor * own[kind] for own in trace.thresholds.values() if kind in own}
        for colour, (name, motion) in zip(LIMIT_COLOURS, trace.objects.items(), strict=False):
            axis.plot(trace.t, factor * getattr(motion, kind), color=colour, label=_words(name))
        for threshold in thresholds:
            axis.axhline(threshold, color=INK, linewidth=0.8)
    axes[0].plot([], [], color=INK, linewidth=0.8, label="threshold of a failure")
    if trace.outcome.what:
        axes[0].plot([], [], **FAILURE, label="failure")
    for colour, joint in zip(LIMIT_COLOURS, joints, strict=False):
        name, error = _words(trace.joint_names[joint]), 1e3 * trace.tracking_error[:, joint]
        axes[2].plot(trace.t, error, color=colour, linewidth=1.0, label=name)
    axes[0].set_title(_heading(trace))
    axes[2].set_xlabel("time [s]")
    for axis in axes:
        _mark(axis, trace)


def accelerations_figure(trace: Trace, robot: Robot, title: str) -> Figure:
    """Draw the low-passed acceleration of a trial against the plan, one row per coordinate that the plan moves.

    Args:
        trace: the trial.
        robot: the robot that executed it.
        title: the title of the figure.

    Returns:
        The figure.
    """
    peaks = np.abs(trace.planned).max(axis=0)
    moved = np.flatnonzero(peaks > STILL * peaks.max())
    figure = Figure(figsize=(6.5, 0.8 + 1.1 * len(moved)))
    axes = figure.subplots(len(moved), 1, sharex=True, squeeze=False)[:, 0]
    shown = np.convolve(trace.moving, np.ones(101), mode="same") > 0
    for axis, k in zip(axes, moved, strict=True):
        axis.plot(trace.t[shown], trace.executed[shown, k], color=BLUE, linewidth=1.0, label="executed")
        axis.plot(trace.t[shown], trace.planned[shown, k], color=INK, linewidth=0.8, label="planned")
        peak = np.abs(trace.planned[shown, k]).max(initial=1e-6)
        axis.set_ylim(-2.0 * peak, 2.0 * peak)
        axis.set_ylabel(_words(robot.joint_names[k]).replace(" ", "\n"))
        _mark(axis, trace)
    axes[-1].set_xlabel("time [s]")
    unit = joint_unit("rad/s²", robot.hinges[moved])
    axes[0].set_title(f"acceleration [{unit}], trial {trace.outcome.trial}")
    axes[0].legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
    figure.suptitle(f"{title}; {STILL_SHADED}", x=0.01, ha="left")
    return figure


def contact_trials_figure(traces: Sequence[Trace], title: str) -> Figure:
    """Draw measured and planned normal force, used friction and centre of pressure of each environment contact.

    Args:
        traces: the trials, one column each.
        title: title of the figure.

    Returns:
        The figure.
    """
    figure = Figure(figsize=(max(3.6 * len(traces), 5.0) + 1.6, 8.4))
    axes = figure.subplots(4, len(traces), sharex="col", sharey="row", squeeze=False)
    for column, trace in enumerate(traces):
        _draw_contacts(list(axes[:, column]), trace)
    for axis, label in zip(axes[:, 0], CONTACT_LABELS, strict=True):
        axis.set_ylabel(label)
    _scale_contacts(list(axes[:, 0]), traces)
    axes[1, -1].plot([], [], color=INK, linewidth=0.8, linestyle=":", label="actual friction")
    for row in (0, 1):
        axes[row, -1].legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
    legend = f"pale: measured, low-passed; thin: planned\n{STILL_SHADED}, or loaded soles, planned"
    figure.suptitle(f"{title}; {legend}", x=0.01, ha="left")
    return figure


def _scale_contacts(axes: Sequence[Axes], traces: Sequence[Trace]) -> None:
    """Scale the axes of normal force, friction and centre of pressure to the plan, so that peaks do not hide it."""
    plans = [_planned(trace) for trace in traces]
    most = max(_planned_load(planned, name) for planned in plans for name in planned.forces)
    axes[0].set_ylim(0, 1.3 * most)
    axes[1].set_ylim(0, 1.6 * max(mu for trace in traces for mu in trace.outcome.friction.values()))
    for axis, k in ((axes[2], 0), (axes[3], 1)):
        places = np.concatenate([points[..., k].ravel() for planned in plans for points in planned.points.values()])
        axis.set_ylim(places.min() - 0.03, places.max() + 0.03)


def _draw_contacts(axes: Sequence[Axes], trace: Trace) -> None:
    """Draw the column of a trial: force, friction and centre of pressure of each contact, measured and planned."""
    planned = _planned(trace)
    for name, contact in trace.contacts.items():
        colour, least = CONTACT_COLOURS[name], LOADED * _planned_load(planned, name)
        pale: dict[str, Any] = {"color": colour, "alpha": 0.45, "linewidth": 2.4}
        thin: dict[str, Any] = {"color": colour, "linewidth": 0.9}
        force, wanted = contact.force, planned.pressed(name)
        axes[0].plot(trace.t, force[:, 2], **pale)
        axes[0].plot(planned.t, wanted[:, 2], label=_words(name), **thin)
        pressed, wanted_pressed = force[:, 2] > least, wanted[:, 2] > least
        axes[1].plot(trace.t, _ratio(force, pressed), **pale)
        axes[1].plot(planned.t, _ratio(wanted, wanted_pressed), **thin)
        axes[1].axhline(trace.outcome.friction[name], color=colour, linewidth=0.8, linestyle=":")
        place = np.where(pressed[:, None], contact.center_of_pressure, np.nan)
        wanted_place = np.where(wanted_pressed[:, None], planned.center_of_pressure(name), np.nan)
        for k, axis in enumerate(axes[2:]):
            sole, loaded = planned.points[name][..., k], wanted_pressed.tolist()
            axis.fill_between(planned.t, sole.min(axis=1), sole.max(axis=1), where=loaded, color=PALE, linewidth=0)
            axis.plot(trace.t, place[:, k], **pale)
            axis.plot(planned.t, wanted_place[:, k], **thin)
    axes[0].set_title(_heading(trace))
    axes[-1].set_xlabel("time [s]")
    for axis in axes:
        _mark(axis, trace)


def _ratio(force: Array, pressed: Flags) -> Array:
    """Return tangential over normal force (N,); nan while the contact is not pressed."""
    normal = np.where(pressed, force[:, 2], np.nan)
    return np.asarray(np.hypot(force[:, 0], force[:, 1]) / normal)


def _planned(trace: Trace) -> ContactForces:
    assert trace.planned_forces is not None, "a trace with contacts has planned forces"
    return trace.planned_forces


def _planned_load(planned: ContactForces, contact: str) -> float:
    return float(planned.pressed(contact)[:, 2].max())


def _shown_joints(traces: Sequence[Trace]) -> list[int]:
    """Return the joints whose tracking error is drawn: all, or the ones with the largest errors, in their order."""
    errors = [np.abs(trace.tracking_error[_before_failure(trace)]).max(axis=0, initial=0.0) for trace in traces]
    stray = np.max(errors, axis=0)
    return sorted(np.argsort(-stray, kind="stable")[: len(LIMIT_COLOURS)].tolist())


def _top(traces: Sequence[Trace], kind: str) -> float:
    """Return the end of an axis: a little beyond the threshold, unless every value is far below it."""
    limits = [own[kind] for trace in traces for own in trace.thresholds.values() if kind in own]
    limit = max(limits, default=0.0)
    parts = [getattr(motion, kind)[_before_failure(trace)] for trace in traces for motion in trace.objects.values()]
    largest = max(float(np.nanmax(part)) for part in parts if np.isfinite(part).any())
    return SHOWN * limit if largest > limit / FAR and limit > 0.0 else SHOWN * max(largest, 1e-9)


def _heading(trace: Trace) -> str:
    outcome = trace.outcome
    what = f" ({_words(outcome.what)})" if outcome.what else ""
    return f"trial {outcome.trial}: {outcome.status.value}{what}"


def _words(name: str) -> str:
    return name.replace("_", " ")


def _before_failure(trace: Trace) -> Flags:
    """Return the steps before the trial failed."""
    return trace.t < trace.outcome.time if trace.outcome.what else np.ones(len(trace.t), dtype=bool)


def _mark(axis: Axes, trace: Trace) -> None:
    """Shade the time during which the robot stands still, and mark the failure."""
    moving = trace.t[trace.moving]
    for start, end in ((trace.t[0], moving[0]), (moving[-1], trace.t[-1])):
        axis.axvspan(start, end, color=GREY, alpha=0.25, linewidth=0)
    axis.set_xlim(trace.t[0], trace.t[-1])
    if trace.outcome.what:
        axis.axvline(trace.outcome.time, **FAILURE)
