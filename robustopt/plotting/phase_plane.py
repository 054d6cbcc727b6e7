"""Phase plane (s, sd): the plan between the velocity limit curves, coloured by the limit that binds."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.legend_handler import HandlerTuple
from matplotlib.lines import Line2D

from robustopt.arrays import Array, Flags
from robustopt.limits import TimeScalingProblem
from robustopt.plotting.style import GREY, INK, OTHER, PALE, VERMILLION, limit_colours, percent
from robustopt.plotting.velocity_limit import velocity_limits
from robustopt.solvers.plan import Plan
from robustopt.solvers.trajectory import NO_LIMIT, binding_shares

PIECES_PER_INTERVAL = 8
"""Number of straight lines that approximate sd on an interval, where sd^2 is linear in s."""


def phase_plane(plan: Plan, title: str) -> Figure:
    """Draw sd over s with the velocity limit curves, above one strip per limit that shows on which intervals it binds.

    The profile has the colour of the binding limit; if several bind, of the one with the largest share of the duration.
    The strips show all of them. The figure of an empty plan has only the curves. It marks the points at which no speed
    is admissible, the stops at which the robot cannot stand still, and the conflict that the solver found.

    Args:
        plan: a plan, or an empty one.
        title: title of the figure.

    Returns:
        The figure.
    """
    if plan.x.size == 0:
        figure = Figure(figsize=(9, 4))
        plane = figure.subplots()
        _draw_velocity_limits(plane, plan.problem, top=None)
        _draw_conflict(plane, plan)
        plane.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
        plane.set_xlabel("position along the path, s [1]")
    else:
        figure = _with_strips(plan)
        plane = figure.axes[0]
    plane.set_title(title)
    plane.set_ylabel("speed along the path, sd [1/s]")
    plane.set_xlim(plan.problem.s[0], plan.problem.s[-1])
    return figure


def _with_strips(plan: Plan) -> Figure:
    shares = binding_shares(plan)
    colours = limit_colours(shares)
    strips = _strips(shares, colours)
    height = 4.2 + 0.24 * len(strips)
    figure = Figure(figsize=(9, height))
    plane, strip = figure.subplots(2, 1, sharex=True, height_ratios=[height - 0.24 * len(strips), 0.24 * len(strips)])
    sd = np.sqrt(np.maximum(plan.x, 0.0))
    _draw_velocity_limits(plane, plan.problem, top=float(sd.max()))
    _draw_profile(plane, plan, shares, colours)
    _draw_legend(plane, [colours[name] for name in shares][:3])
    _draw_strips(strip, plan, strips, shares, colours)
    return figure


def _draw_velocity_limits(plane: Axes, problem: TimeScalingProblem, top: float | None) -> None:
    """Draw the curves, the region outside of them, and the points at which no speed is admissible.

    `top` is the largest sd of the plan, which the axis is scaled to; None shows all of the curves.
    """
    low, high = velocity_limits(problem)
    ceiling = _ceiling(high, top)
    shown = np.minimum(high, 2 * ceiling)
    plane.fill_between(problem.s, shown, 2 * ceiling, color=PALE, linewidth=0)
    plane.plot(problem.s, shown, color=INK, linewidth=1.0, label="maximum velocity")
    if np.nanmax(low, initial=0.0) > 0:
        plane.fill_between(problem.s, low, color=PALE, linewidth=0)
        plane.plot(problem.s, low, color=INK, linewidth=1.0, linestyle="--", label="minimum velocity")
    impossible = np.isnan(high)
    if impossible.any():
        plane.fill_between(
            problem.s, 0, 1, where=_widened(impossible), transform=plane.get_xaxis_transform(),
            color=VERMILLION, alpha=0.35, linewidth=0, label="no speed is admissible",
        )  # fmt: skip
    plane.set_ylim(0, ceiling)


def _ceiling(high: Array, top: float | None) -> float:
    """Return the largest sd of the axis: it shows all of the plan, and part of the curve even if that is far above."""
    finite = high[np.isfinite(high)]
    highest = float(finite.max(initial=0.0)) or 1.0
    if top is None:
        return 1.05 * highest
    lowest = float(finite.min(initial=highest))
    return max(1.15 * top, min(1.05 * highest, max(1.6 * top, 1.3 * lowest)))


def _draw_conflict(plane: Axes, plan: Plan) -> None:
    """Mark the stops at which the robot cannot stand still, and the grid point of the conflict."""
    low, _ = velocity_limits(plan.problem)
    stops = plan.problem.rest & (low > 0)
    if stops.any():
        plane.plot(
            plan.problem.s[stops], np.zeros(stops.sum()), "o", color=VERMILLION, clip_on=False, zorder=4,
            label="must stop, cannot stand still",
        )  # fmt: skip
    if plan.stuck >= 0:
        s = plan.problem.s[plan.stuck]
        plane.plot(
            [s, s], [0.0, 1.0], transform=plane.get_xaxis_transform(), color=INK, linewidth=1.4, linestyle=":",
            marker="v", markevery=[1], clip_on=False, zorder=4, label=f"conflict at s = {s:.3g}",
        )  # fmt: skip


def _widened(mask: Flags) -> Flags:
    """Return the mask with its neighbours set too: an area needs two points."""
    padded = np.pad(mask, 1)
    return padded[:-2] | padded[1:-1] | padded[2:]


def _draw_profile(plane: Axes, plan: Plan, shares: dict[str, float], colours: dict[str, str]) -> None:
    """Draw the profile as one curve per interval, in the colour of its most important limit."""
    rank = {name: k for k, name in enumerate(shares)}
    names = [min(active, key=rank.__getitem__) if active else NO_LIMIT for active in plan.active]
    at = np.linspace(0.0, 1.0, PIECES_PER_INTERVAL + 1)
    s = plan.s[:-1, None] + np.diff(plan.s)[:, None] * at
    sd = np.sqrt(np.maximum(plan.x[:-1, None] + np.diff(plan.x)[:, None] * at, 0.0))
    curves = np.stack([s, sd], axis=2)
    plane.add_collection(
        LineCollection(
            list(curves), colors=[colours[name] for name in names], linewidths=2.6, capstyle="round", zorder=3,
            clip_on=False,
        )
    )  # fmt: skip


def _draw_legend(plane: Axes, colours: list[str]) -> None:
    """Draw the legend, in which the profile is a line of several colours."""
    handles, labels = plane.get_legend_handles_labels()
    profile = tuple(Line2D([], [], color=colour, linewidth=2.6) for colour in colours)
    names = ["plan, coloured by the binding limit", *labels]
    several = {tuple: HandlerTuple(ndivide=None, pad=0)}
    plane.legend([profile, *handles], names, loc="upper left", bbox_to_anchor=(1.0, 1.0), handler_map=several)


def _strips(shares: dict[str, float], colours: dict[str, str]) -> dict[str, frozenset[str]]:
    """Return the limits of each strip by its label: one strip per limit with a colour of its own, one for the rest."""
    own = {name: frozenset([name]) for name in shares if colours[name] != GREY}
    others = frozenset(name for name in shares if colours[name] == GREY)
    return {**own, OTHER: others} if others else own


def _draw_strips(
    strip: Axes, plan: Plan, strips: dict[str, frozenset[str]], shares: dict[str, float], colours: dict[str, str]
) -> None:
    """Draw one row per limit: bars on the intervals it binds on, and its name and share at the right."""
    labels = []
    for row, (label, members) in enumerate(strips.items()):
        binds = [bool(members & set(active or (NO_LIMIT,))) for active in plan.active]
        spans = [(plan.s[i], plan.s[i + 1] - plan.s[i]) for i in np.flatnonzero(binds) if plan.s[i + 1] > plan.s[i]]
        strip.broken_barh(_joined(spans), (row - 0.32, 0.64), facecolors=colours[label], linewidth=0)
        labels.append(f"{label}, {percent(sum(shares[name] for name in members))}")
    strip.set_yticks(range(len(strips)), labels)
    strip.set_ylim(len(strips) - 0.5, -0.5)
    strip.yaxis.tick_right()
    strip.tick_params(axis="y", length=0)
    strip.spines["left"].set_visible(False)
    strip.set_xlabel("position along the path, s [1]")


def _joined(spans: list[tuple[float, float]]) -> list[tuple[float, float]]:
    """Join adjacent (start, length) spans, so that no hairline is left between them."""
    joined: list[tuple[float, float]] = []
    for start, length in spans:
        if joined and start <= sum(joined[-1]) + 1e-12:
            joined[-1] = (joined[-1][0], start + length - joined[-1][0])
        else:
            joined.append((start, length))
    return joined
