"""Figure of the learners' regret: median against executions, one panel per world and number of parameters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from robustopt.plotting import style
from robustopt.tables import Value

LINES = {
    # method: colour, line
    "bnb-informed": (style.BLUE, "-"),
    "bnb-diagonal": (style.VERMILLION, "-"),
    "bnb-midpoint": (style.ORANGE, "-"),
    "random": (style.INK, ":"),
    "grid": (style.GREY, "--"),
    "optuna TPE": (style.GREEN, "--"),
    "optuna GP": (style.PURPLE, "--"),
}

LEAST = 0.3
"""Regret under it is drawn at the lower edge [%]."""


def write_figure(records: Sequence[Mapping[str, Value]], marks: Sequence[int], folder: Path) -> list[Path]:
    """Write learners.svg and return the files."""
    with style.house_style():
        return style.save(regret_figure(records, marks), folder, "learners", formats=("svg",))


def regret_figure(records: Sequence[Mapping[str, Value]], marks: Sequence[int]) -> Figure:
    worlds = list(dict.fromkeys(str(record["world"]) for record in records))
    sizes = list(dict.fromkeys(record["k"] for record in records))
    figure = Figure(figsize=(8.4, 0.6 + 2.4 * len(worlds)))
    panels = figure.subplots(len(worlds), len(sizes), sharex=True, sharey=True, squeeze=False)
    shown = [method for method in LINES if any(record["method"] == method for record in records)]
    for world, row in zip(worlds, panels, strict=True):
        for k, axes in zip(sizes, row, strict=True):
            for record in records:
                if (record["world"], record["k"]) == (world, k):
                    colour, line = LINES[str(record["method"])]
                    regrets = [max(float(record[f"regret_{n}"] or 0), LEAST) for n in marks]
                    axes.plot(marks, regrets, line, color=colour)
            axes.axhline(5, color=style.PALE, linewidth=2, zorder=0)
            axes.set_xscale("log")
            axes.set_yscale("log")
            axes.set_ylim(LEAST, 300)
            axes.set_xticks([1, 2, 5, 10, 20, 40], ["1", "2", "5", "10", "20", "40"])
            axes.set_yticks([0.5, 1, 5, 10, 50, 100], ["0.5", "1", "5", "10", "50", "100"])
            axes.minorticks_off()
            axes.set_title(f"{k} parameters, {world}")
        row[0].set_ylabel("regret, median [%]")
    for axes in panels[-1]:
        axes.set_xlabel("executions")
    handles = [Line2D([], [], color=LINES[m][0], linestyle=LINES[m][1], label=m) for m in shown]
    figure.legend(handles=handles, loc="outside lower center", ncols=len(shown), fontsize=8)
    return figure
