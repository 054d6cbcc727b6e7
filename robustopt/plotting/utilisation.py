"""Utilisation of the contacts over time: the used part of each limit at the worst values in the intervals."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import cycle

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from robustopt.arrays import Array, Indices
from robustopt.plotting.style import DARK_GREY, GREY, INK, limit_colours
from robustopt.solvers.plan import Plan
from robustopt.solvers.trajectory import Trajectory, binding_shares

DASHES = ("--", ":", "-.")
"""Line styles of the limits that never bind; the binding ones have the colours of the other figures."""


def contact_utilisation(plan: Plan) -> list[dict[str, Array]]:
    """Return the used part of each contact limit on every interval that has a length: the larger one of its two ends.

    The used part is 1 less the margin of the plan's own rows at the worst values in the intervals. The margin is a
    fraction of the holding force or, for contacts that only press, of the weight; if the largest margin at standstill
    exceeds this, it is a fraction of that margin (our choice). A limit that binds has 1. Contacts without explicit rows
    count with the rows that the solver added, which bound their cone from outside.

    Args:
        plan: a plan with a timing.

    Returns:
        For each group of held bodies the used part by the name of the limit (M,), nan while the contact does not exist.
    """
    ends = _ends(plan)
    u, x = np.stack([plan.u, plan.u_end], axis=1)[ends[:, 0]].ravel(), plan.x[ends].ravel()
    groups: dict[tuple[str, ...], dict[str, Array]] = {}
    for limit in plan.problem.limits.contacts:
        group = groups.setdefault(limit.system.objects, {})
        full = limit.with_all_facets()
        standing = full.excess(np.zeros_like(u), np.zeros_like(x), ends.ravel())
        unit = np.maximum(1.0, -standing.min(axis=0, initial=0.0, where=np.isfinite(standing)))
        excess = full.excess(u, x, ends.ravel()).reshape(*ends.shape, -1).max(axis=1) / unit
        for name, values in zip(limit.names, excess.T, strict=True):
            used = np.where(np.isfinite(values), np.maximum(1.0 + values, 0.0), np.nan)
            if not np.isnan(used).all():
                group[name] = np.fmax(group.get(name, used), used)
    return [group for group in groups.values() if group]


def _ends(plan: Plan) -> Indices:
    """Return the grid points at both ends of every interval that has a length, (M, 2)."""
    return np.flatnonzero(plan.problem.ds > 0)[:, None] + (0, 1)


def contacts_figure(plan: Plan, title: str) -> Figure:
    """Draw the used part of each contact limit over time, one row per group of held bodies.

    Args:
        plan: a plan with a timing, whose problem has contact limits.
        title: the title of the figure.

    Returns:
        The figure.
    """
    t, groups = Trajectory.from_plan(plan).times[_ends(plan)].ravel(), contact_utilisation(plan)
    heights = [max(1.5, 0.3 + 0.2 * len(group)) for group in groups]
    figure = Figure(figsize=(9, 0.9 + sum(heights)))
    rows = figure.subplots(len(groups), 1, sharex=True, sharey=True, squeeze=False, height_ratios=heights)[:, 0]
    colours = limit_colours(binding_shares(plan))
    for axes, group in zip(rows, groups, strict=True):
        axes.axhline(1.0, color=INK, linewidth=0.8)
        _draw(axes, t, group, [colours.get(name, DARK_GREY) for name in group])
        axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
    most = max(np.nanmax(used) for group in groups for used in group.values())
    rows[0].set_ylim(0.0, 1.08 * max(1.0, float(most)))
    rows[0].set_xlim(t[0], t[-1])
    rows[0].yaxis.set_major_formatter(lambda part, _: f"{100 * part:.0f} %")
    rows[-1].set_xlabel("time [s]")
    figure.supylabel("used part of the limit", fontsize=9)
    figure.suptitle(f"{title}, contacts at the worst values in the intervals", x=0.01, ha="left")
    return figure


def _draw(axes: Axes, t: Array, group: dict[str, Array], colours: Sequence[str]) -> None:
    """Draw lines over the times of both ends of the intervals (2 M,), with gaps where the robot pauses."""
    dashes, pauses = cycle(DASHES), 2 * np.flatnonzero(np.diff(t)[1::2] > 0.0) + 2
    t = np.insert(t, pauses, np.nan)
    for colour, (name, used) in zip(colours, group.items(), strict=True):
        style = next(dashes) if colour in (GREY, DARK_GREY) else "-"
        label = f"{name}, up to {100 * np.nanmax(used):.1f} %"
        axes.plot(t, np.insert(np.repeat(used, 2), pauses, np.nan), color=colour, linestyle=style, label=label)
