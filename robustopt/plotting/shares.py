"""Share of the duration in which each limit binds."""

from __future__ import annotations

from collections.abc import Mapping

from matplotlib.figure import Figure

from robustopt.plotting.style import GREY, limit_colours, percent

MOST_BARS = 12
"""Number of limits that have a bar of their own."""


def shares_figure(shares: Mapping[str, float], title: str, of: str = "duration") -> Figure:
    """Draw shares of a whole as horizontal bars, for example the share of the duration in which each limit binds.

    Args:
        shares: share by limit, in [0, 1], largest first; the first is drawn at the top.
        title: title of the figure.
        of: name of the whole.

    Returns:
        The figure; limits beyond the twelfth share one bar.
    """
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
