"""What binds for how long, and how much of the friction and of the support each contact uses."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from robustopt.plotting.style import BLUE, GREY, INK, ORANGE, limit_colours, percent

Array = NDArray[np.float64]

MOST_BARS = 12


class Utilisation(NamedTuple):
    """Used part of what a contact interface can bear over time, 1 at the limit, all of shape (T,).

    Attributes:
        times: [s].
        slip, tipping: used part of the friction, and of the contact patch.
    """

    times: Array
    slip: Array
    tipping: Array


def shares_figure(shares: Mapping[str, float], title: str) -> Figure:
    """Horizontal bars: the share of the duration in which each limit binds, largest at the top."""
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
    axes.set_xlim(0, 1.15 * max(shown.values()))
    axes.xaxis.set_major_formatter(lambda share, _: f"{100 * share:.0f} %")
    axes.set_xlabel("share of the duration")
    axes.set_title(title)
    return figure


def contacts_figure(utilisation: Mapping[str, Utilisation], title: str) -> Figure:
    """One row per interface: used part of the friction and of the contact patch over time, 1 at the limit."""
    figure = Figure(figsize=(9, 0.9 + 1.5 * len(utilisation)))
    rows = figure.subplots(len(utilisation), 1, sharex=True, sharey=True, squeeze=False)[:, 0]
    highest = 1.0
    for axes, (name, used) in zip(rows, utilisation.items(), strict=True):
        axes.axhline(1.0, color=INK, linewidth=0.8)
        axes.plot(used.times, used.slip, color=BLUE, label="slip")
        axes.plot(used.times, used.tipping, color=ORANGE, label="tipping")
        axes.set_title(name)
        axes.set_xlim(used.times[0], used.times[-1])
        highest = max(highest, float(np.nanmax(used.slip)), float(np.nanmax(used.tipping)))
    rows[0].set_ylim(0, 1.08 * highest)
    rows[0].legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
    rows[-1].set_xlabel("time [s]")
    figure.supylabel("used part of the limit [1]", fontsize=9)
    figure.suptitle(title, x=0.01, ha="left")
    return figure
