"""Write the paper's Figure 3: computing time over the number of collocation points, two blocks, both solvers.

python experiments/figure_3.py [--out results/tables]
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from learned import TWO_BLOCKS, Bench, task
from matplotlib.figure import Figure
from matplotlib.ticker import EngFormatter
from reproduce import run_alone
from timing import interleaved, machine_facts

from robustopt.path import build_path
from robustopt.plotting import style
from robustopt.robot import load_robot
from robustopt.solvers import build_rows, solve
from robustopt.tables import Column, Table, write_table

PAPER_FIGURE_3 = {200: 10.0, 2000: 40.0}
"""Seconds by N, read off the paper's figure 3: about 10 s, and over 40 s."""

PACKAGES = ("numpy", "numba", "casadi", "highspy", "mujoco")

POINTS = (50, 100, 200, 500, 1000, 2000)
METHODS = ("ipopt", "reachability")
REPETITIONS = 5

COLUMNS = (
    Column("N", "N"),
    *(Column(method, f"{method} [s]", ".4f") for method in METHODS),
    *(Column(f"{method}_duration", f"duration by {method} [s]", ".4f") for method in METHODS),
    Column("paper", "paper [s]", "g"),
)

ABOVE = """# Figure 3: computing time against the number of collocation points

Written by `make reproduce-tables`. Two blocks, 8 contact points, mu = 0.5: from path to plan, rows made anew each time;
medians of {repetitions}, the solvers and grids taking turns. {machine}

![computing time](figure_3.svg)
"""

BELOW = """
- `ipopt` is the paper's split, Ipopt with linear programs over the contact forces inside; `reachability` is ours.
- Paper: read off its figure 3, "about 10 s at N = 200" and over 40 s at N = 2000, by SNOPT and GLPK on a laptop of
  2.9 GHz, with its own path; copied. Everything else comes from the run, and times change from run to run.
"""


def write(out: Path, place: Bench, points: Sequence[int] = POINTS, repetitions: int = REPETITIONS) -> list[Path]:
    """Measure, and write the table and the figure."""
    base = task(("uncertainty={}",), TWO_BLOCKS)
    robot = load_robot(base)
    path = build_path(base, robot)
    configs = {n: task((f"solver.collocation_points={n}", "uncertainty={}"), TWO_BLOCKS) for n in points}

    def plan(n: int, method: str):
        return solve(build_rows(configs[n], robot, path), method)

    calls = {(n, method): lambda n=n, method=method: plan(n, method) for n in points for method in METHODS}
    place.say(f"{len(calls)} cases, {repetitions} times each")
    seconds = interleaved(calls, repetitions)
    lines = [
        {
            "N": n,
            **{method: float(np.median(seconds[n, method])) for method in METHODS},
            **{f"{method}_duration": plan(n, method).duration for method in METHODS},
            "paper": PAPER_FIGURE_3.get(n),
        }
        for n in points
    ]
    above = ABOVE.format(repetitions=repetitions, machine=machine_facts(PACKAGES))
    caption = "Computing time against the number of collocation points, two blocks."
    paths = write_table(Table(COLUMNS, tuple(lines), caption), out, "figure_3", above, BELOW)
    with style.house_style():
        return paths + style.save(figure(lines), out, "figure_3")


def figure(lines: Sequence[dict]) -> Figure:
    drawn = Figure(figsize=(6.4, 4.0))
    axes = drawn.subplots()
    for method, colour in zip(METHODS, (style.VERMILLION, style.BLUE), strict=True):
        axes.plot([r["N"] for r in lines], [r[method] for r in lines], marker="o", color=colour, label=method)
    paper = [r for r in lines if r["paper"] is not None]
    axes.plot([r["N"] for r in paper], [r["paper"] for r in paper], ":D", color=style.INK, label="paper, read off")
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_xticks([r["N"] for r in lines], [str(r["N"]) for r in lines])
    axes.minorticks_off()
    axes.yaxis.set_major_formatter(EngFormatter(unit="s"))
    axes.set_xlabel("collocation points N")
    axes.set_ylabel("computing time, median")
    axes.set_title("Two blocks on a tray: time to plan")
    axes.grid(color=style.PALE, linewidth=0.6)
    axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
    return drawn


if __name__ == "__main__":
    run_alone("figure_3", write)
