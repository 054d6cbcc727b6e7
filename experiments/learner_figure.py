"""Figure of the learners' regret: median against executions, one panel per problem."""

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
"""Smallest regret that is drawn; a smaller one is drawn at the lower edge [%]."""


Panel = tuple[str, Sequence[Mapping[str, Value]]]
"""Title, and records of the methods: `method` and, in percent, `regret_N` for all N of `marks`."""


def write_figure(rows: Sequence[Sequence[Panel]], marks: Sequence[int], folder: Path, name: str) -> list[Path]:
    """Write NAME.svg and return the files."""
    with style.house_style():
        return style.save(regret_figure(rows, marks), folder, name, formats=("svg",))


def regret_figure(rows: Sequence[Sequence[Panel]], marks: Sequence[int]) -> Figure:
    figure = Figure(figsize=(8.4, 0.6 + 2.4 * len(rows)))
    every = figure.subplots(len(rows), len(rows[0]), sharex=True, sharey=True, squeeze=False)
    methods = {record["method"] for row in rows for _, records in row for record in records}
    shown = [method for method in LINES if method in methods]
    for row, axes_of_row in zip(rows, every, strict=True):
        for (title, records), axes in zip(row, axes_of_row, strict=True):
            for record in records:
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
            axes.set_title(title)
        axes_of_row[0].set_ylabel("regret, median [%]")
    for axes in every[-1]:
        axes.set_xlabel("executions")
    handles = [Line2D([], [], color=LINES[m][0], linestyle=LINES[m][1], label=m) for m in shown]
    figure.legend(handles=handles, loc="outside lower center", ncols=len(shown), fontsize=8)
    return figure
