"""Figure of the computing times over the number of collocation points, log-log, each curve labelled at its end."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import log10
from pathlib import Path

from contenders import COPP, IPOPT, OURS, PLAN, TOPPRA
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import EngFormatter

from robustopt.plotting import style

Record = Mapping[str, float | int | str]

CURVES = (
    # part, solver, uncertainty, label, colour, line
    ("paper's split", IPOPT, "none", "ipopt with inner programs, no uncertainty", style.VERMILLION, "-"),
    ("whole plan", PLAN, "all five", "whole plan, all five kinds of intervals", style.INDIGO, "--"),
    ("whole plan", PLAN, "none", "whole plan, no uncertainty", style.INDIGO, "-"),
    ("solver stage", TOPPRA, None, "toppra (seidel)", style.GREEN, "-"),
    ("solver stage", COPP, None, "copp-py (topp2_ra)", style.ORANGE, "-"),
    ("solver stage", OURS, None, "reachability (passes)", style.BLUE, "-"),
)

LABEL_GAP = 0.17
"""Least distance between two labels, in decades of seconds."""


def write_figure(records: Sequence[Record], folder: Path) -> list[Path]:
    """Write planning.svg and planning.png and return the files."""
    with style.house_style():
        return style.save(times_figure(records), folder, "planning")


def times_figure(records: Sequence[Record]) -> Figure:
    figure = Figure(figsize=(8.4, 5.4))
    axes = figure.subplots()
    ends = []
    for part, solver, uncertainty, label, colour, line in CURVES:
        points, seconds = curve(records, part, solver, uncertainty)
        axes.plot(points, seconds, line, color=colour, marker="o", markersize=3.5)
        ends.append((points[-1], seconds[-1], label, colour))
    paper = [r for r in records if "paper_seconds" in r and r["uncertainty"] == "none"]
    if paper:
        points, seconds = [int(r["N"]) for r in paper], [float(r["paper_seconds"]) for r in paper]
        axes.plot(points, seconds, ":", color=style.INK, marker="D", markersize=5)
        ends.append((points[-1], seconds[-1], "paper, read off its figure 3", style.INK))
    axes.set_xscale("log")
    axes.set_yscale("log")
    _label(axes, ends)
    ticks = sorted({int(r["N"]) for r in records if r["part"] in ("solver stage", "paper's split")})
    axes.set_xticks(ticks, [str(n) for n in ticks])
    axes.minorticks_off()
    axes.yaxis.set_major_formatter(EngFormatter(unit="s"))
    axes.grid(color=style.PALE, linewidth=0.6)
    axes.set_axisbelow(True)
    axes.set_xlabel("collocation points N")
    axes.set_ylabel("computing time, median")
    axes.set_title("Two blocks on a tray: time to plan, and time of the solvers alone on the same rows")
    return figure


def curve(records: Sequence[Record], part: str, solver: str, uncertainty: str | None) -> tuple[list[int], list[float]]:
    """Return N and the median seconds of a solver on the two-block task."""
    wanted = (part, "waiter_two_blocks", solver, uncertainty)
    fits = [r for r in records if (r["part"], r["config"], r["solver"], r.get("uncertainty")) == wanted]
    return [int(r["N"]) for r in fits], [float(r["seconds"]) for r in fits]


def _label(axes: Axes, ends: Sequence[tuple[int, float, str, str]]) -> None:
    """Label the curves that reach the right edge beside it, without overlap, and the others above their ends."""
    right, height = max(end[0] for end in ends), -99.0
    for points, seconds, label, colour in sorted(ends, key=lambda end: end[1]):
        if points < right:
            axes.annotate(label, (points, seconds), (0, 7), textcoords="offset points", color=colour, ha="right")
            continue
        height = max(log10(seconds), height + LABEL_GAP)
        text = axes.annotate(label, (points, 10**height), (8, 0), textcoords="offset points", color=colour, va="center")
        text.set_annotation_clip(False)
