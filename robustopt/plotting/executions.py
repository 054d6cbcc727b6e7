"""Trials over time: how far objects, contacts and joints stray, accelerations and contact forces against the plan."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from robustopt.plotting.style import BLUE, CONTACT_COLOURS, GREY, INK, LIMIT_COLOURS, PALE, VERMILLION, joint_unit
from robustopt.robot import Robot
from robustopt.simulation.trace import Trace

SHOWN = 1.5
"""What exceeds this many times its threshold is cut off: an object on the floor says nothing more."""

FAR = 10.0
"""A threshold this many times further off than anything came is left out, so that what there is can be seen."""

STILL = 1e-3
"""A coordinate that is accelerated by less than this part of the one that is accelerated most is not moved."""

LOADED = 0.05
"""Part of the largest planned force on a contact below which its friction and centre of pressure say nothing."""


def trials_figure(traces: Sequence[Trace], robot: Robot, title: str) -> Figure:
    """Slip and tilt of everything that friction holds and tracking error of joints over time, a column per trial."""
    figure = Figure(figsize=(max(3.6 * len(traces), 5.0) + 1.6, 6.4))
    axes = figure.subplots(3, len(traces), sharex="col", sharey="row", squeeze=False)
    rows = (("slip", 1e3, "slip [mm]"), ("tilt", np.degrees(1.0), "tilt [°]"))
    shown = _shown_joints(traces)
    for column, trace in enumerate(traces):
        for row, (kind, factor, _) in enumerate(rows):
            for colour, (name, motion) in zip(LIMIT_COLOURS, trace.objects.items(), strict=False):
                axes[row, column].plot(trace.t, factor * getattr(motion, kind), color=colour, label=_words(name))
            axes[row, column].axhline(factor * trace.thresholds[kind], color=INK, linewidth=0.8)
        for colour, joint in zip(LIMIT_COLOURS, shown, strict=False):
            name, error = _words(trace.joint_names[joint]), 1e3 * trace.tracking_error[:, joint]
            axes[2, column].plot(trace.t, error, color=colour, linewidth=1.0, label=name)
        axes[0, column].set_title(_heading(trace))
        axes[2, column].set_xlabel("time [s]")
        for axis in axes[:, column]:
            _mark(axis, trace)
    for row, (kind, factor, label) in enumerate(rows):
        axes[row, 0].set_ylabel(label)
        axes[row, 0].set_ylim(0, factor * _top(traces, kind))
    before = [np.abs(trace.tracking_error[_sound(trace)]).max(initial=1e-9) for trace in traces]
    axes[2, 0].set_ylim(-1.3e3 * max(before), 1.3e3 * max(before))
    driven = robot.hinges[len(robot.hinges) - len(traces[0].joint_names) :]
    axes[2, 0].set_ylabel(f"tracking error [{joint_unit('mrad', driven)}]")
    for row in (0, 2):
        axes[row, -1].legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
    figure.suptitle(title, x=0.01, ha="left")
    return figure


def accelerations_figure(trace: Trace, robot: Robot, title: str) -> Figure:
    """Acceleration of a trial, low-passed, against the plan, a row for each coordinate that the plan moves."""
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
    axes[0].set_title(f"{'' if trace.contacts else 'joint '}acceleration [{unit}], trial {trace.outcome.trial}")
    axes[0].legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
    figure.suptitle(title, x=0.01, ha="left")
    return figure


def foot_contacts_figure(traces: Sequence[Trace], title: str) -> Figure:
    """Normal force, used friction and centre of pressure of each contact over time beside the planned ones.

    A column per trial of a robot on its feet.
    """
    figure = Figure(figsize=(max(3.6 * len(traces), 5.0) + 1.6, 8.4))
    axes = figure.subplots(4, len(traces), sharex="col", sharey="row", squeeze=False)
    labels = ("normal force [N]", "tangential / normal force", "centre of pressure, x [m]", "centre of pressure, y [m]")
    for column, trace in enumerate(traces):
        _draw_contacts(list(axes[:, column]), trace)
        axes[0, column].set_title(_heading(trace))
        axes[-1, column].set_xlabel("time [s]")
        for axis in axes[:, column]:
            _mark(axis, trace)
    for axis, label in zip(axes[:, 0], labels, strict=True):
        axis.set_ylabel(label)
    most = max(_planned_load(trace, name) for trace in traces for name in trace.contacts)
    axes[0, 0].set_ylim(0, 1.3 * most)
    axes[1, 0].set_ylim(0, 1.6 * max(mu for trace in traces for mu in trace.outcome.friction.values()))
    for row, spread in ((2, 0), (3, 1)):
        places = np.concatenate([p[..., spread].ravel() for trace in traces for p in _soles(trace)])
        axes[row, 0].set_ylim(places.min() - 0.03, places.max() + 0.03)
    axes[0, -1].legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
    axes[1, -1].plot([], [], color=INK, linewidth=0.8, linestyle=":", label="true friction")
    axes[1, -1].legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
    figure.suptitle(
        f"{title}: pale: as measured, low-passed; thin: as planned; grey: loaded soles as planned", x=0.01, ha="left"
    )
    return figure


def _draw_contacts(axes: Sequence[Axes], trace: Trace) -> None:
    planned = trace.planned_forces
    assert planned is not None
    load, friction, along, across = axes
    for name, contact in trace.contacts.items():
        colour, label, least = CONTACT_COLOURS[name], _words(name), LOADED * _planned_load(trace, name)
        force, wanted = contact.force, planned.pressed(name)
        pressed, wanted_pressed = force[:, 2] > least, wanted[:, 2] > least
        pale: dict[str, Any] = {"color": colour, "alpha": 0.45, "linewidth": 2.4}
        thin: dict[str, Any] = {"color": colour, "linewidth": 0.9}
        load.plot(trace.t, force[:, 2], **pale)
        load.plot(planned.t, wanted[:, 2], label=label, **thin)
        friction.plot(trace.t, _ratio(force, pressed), **pale)
        friction.plot(planned.t, _ratio(wanted, wanted_pressed), **thin)
        friction.axhline(trace.outcome.friction[name], color=colour, linewidth=0.8, linestyle=":")
        place = np.where(pressed[:, None], contact.center_of_pressure, np.nan)
        wanted_place = np.where(wanted_pressed[:, None], planned.center_of_pressure(name), np.nan)
        for axis, k in ((along, 0), (across, 1)):
            sole = planned.points[name][..., k]
            axis.fill_between(
                planned.t, sole.min(axis=1), sole.max(axis=1), where=wanted_pressed.tolist(), color=PALE, linewidth=0
            )
            axis.plot(trace.t, place[:, k], **pale)
            axis.plot(planned.t, wanted_place[:, k], **thin)


def _ratio(force: np.ndarray, pressed: np.ndarray) -> np.ndarray:
    """Tangential over normal force (N,), nan where the contact is not pressed."""
    normal = np.where(pressed, force[:, 2], np.nan)
    return np.asarray(np.hypot(force[:, 0], force[:, 1]) / normal)


def _planned_load(trace: Trace, contact: str) -> float:
    assert trace.planned_forces is not None
    return float(trace.planned_forces.pressed(contact)[:, 2].max())


def _soles(trace: Trace) -> list[np.ndarray]:
    assert trace.planned_forces is not None
    return list(trace.planned_forces.points.values())


def _shown_joints(traces: Sequence[Trace]) -> list[int]:
    """Joints whose tracking error is drawn: all, or those that stray the most, in their order."""
    stray = np.max([np.abs(trace.tracking_error[_sound(trace)]).max(axis=0, initial=0.0) for trace in traces], axis=0)
    return sorted(np.argsort(-stray, kind="stable")[: len(LIMIT_COLOURS)].tolist())


def _top(traces: Sequence[Trace], kind: str) -> float:
    """End of an axis: a little beyond the threshold, unless nothing comes anywhere near it."""
    limit = max(trace.thresholds[kind] for trace in traces)
    parts = [getattr(motion, kind)[_sound(trace)] for trace in traces for motion in trace.objects.values()]
    largest = max(float(np.nanmax(part)) for part in parts if np.isfinite(part).any())
    return SHOWN * limit if largest > limit / FAR else SHOWN * max(largest, 1e-9)


def _heading(trace: Trace) -> str:
    outcome = trace.outcome
    what = f" {_words(outcome.what)}" if outcome.what else ""
    return f"trial {outcome.trial}: {outcome.status.value}{what}"


def _words(name: str) -> str:
    return name.replace("_", " ")


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
