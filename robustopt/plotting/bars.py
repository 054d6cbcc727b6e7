"""What binds for how long, and how much of the friction and of the support each contact uses."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from robustopt.plotting.style import BLUE, GREEN, GREY, INK, ORANGE, limit_colours, percent

Array = NDArray[np.float64]

Utilisation = Mapping[str, tuple[Array, Array]]
"""Used part of the friction (slip) and of the contact patch (tipping), 1 at the limit, (M,) each, by contact."""

MOST_BARS = 12

FAR = 2.0
"""Utilisations beyond this, up to that of an object that lifts off, which is infinite, are drawn here."""


def shares_figure(shares: Mapping[str, float], title: str, of: str = "duration") -> Figure:
    """Draw horizontal bars of shares of a whole, e.g. of the duration in which each limit binds, from the top."""
    colours = limit_colours(shares)
    shown = dict(list(shares.items())[:MOST_BARS])
    rest = sum(shares.values()) - sum(shown.values())
    hidden = len(shares) - len(shown)
    if hidden:
        shown[f"{hidden} more"] = rest
    figure = Figure(figsize=(7, 1.0 + 0.28 * len(shown)))
    axes = figure.subplots()
    bars = axes.barh(
        range(len(shown)), list(shown.values()), height=0.68,
        color=[colours.get(name, GREY) for name in shown],
    )  # fmt: skip
    axes.bar_label(bars, [percent(share) for share in shown.values()], padding=4)
    axes.set_yticks(range(len(shown)), list(shown))
    axes.set_ylim(len(shown) - 0.5, -0.5)
    axes.tick_params(axis="y", length=0)
    axes.set_xlim(0, 1.15 * max(shown.values(), default=1.0))
    axes.xaxis.set_major_formatter(lambda share, _: f"{100 * share:.0f} %")
    axes.set_xlabel(f"share of the {of}")
    axes.set_title(title)
    return figure


def contacts_figure(
    times: Array,
    utilisation: Utilisation,
    title: str,
    worst: Mapping[str, float] | None = None,
    what: str = "contacts at the configured values",
) -> Figure:
    """One row per contact: used part of the friction and of the contact patch over time, 1 at the limit.

    Args:
        times: shape (M,), [s].
        utilisation: slip and tipping at the configured values, both of shape (M,), by the name of the contact; a bridge
            has the balance of all its contacts and no tipping, which is nan throughout.
        title: title of the figure.
        worst: largest utilisation over all uncertain parameters, by the name of the contact.
        what: the curves show.
    """
    figure = Figure(figsize=(9, 1.1 + 1.5 * len(utilisation)))
    rows = figure.subplots(len(utilisation), 1, sharex=True, sharey=True, squeeze=False)[:, 0]
    for axes, (name, (slip, tipping)) in zip(rows, utilisation.items(), strict=True):
        bridge = bool(np.isnan(tipping).all())
        axes.axhline(1.0, color=INK, linewidth=0.8)
        axes.plot(times, np.minimum(slip, FAR), color=GREEN if bridge else BLUE, label="balance" if bridge else "slip")
        if not bridge:
            axes.plot(times, np.minimum(tipping, FAR), color=ORANGE, label="tipping")
        axes.set_title(name + (f", at worst {100 * worst[name]:.1f} %" if worst and name in worst else ""))
    finite = np.minimum(np.stack([curve for pair in utilisation.values() for curve in pair]), FAR)
    rows[0].set_ylim(0, 1.08 * max(1.0, float(np.nanmax(finite))))
    rows[0].set_xlim(times[0], times[-1])
    handles = {label: line for axes in rows for line, label in zip(*axes.get_legend_handles_labels(), strict=True)}
    figure.legend(list(handles.values()), list(handles), loc="outside lower left", ncols=len(handles))
    rows[-1].set_xlabel("time [s]")
    figure.supylabel("used part of the limit [1]", fontsize=9)
    figure.suptitle(f"{title}, {what}", x=0.01, ha="left")
    return figure
