"""Write the durations of the two-block waiter task at the paper's friction coefficients, beside the paper's Table 1.

    python experiments/table_durations.py [--points N] [--out results/tables]

`make reproduce-tables` writes durations.csv, durations.md and durations.tex. All numbers of ours come from plans that
are made here; the same code gives the same files.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from math import sqrt
from pathlib import Path

from learned import Bench

from robustopt.config.load import load_config
from robustopt.limits import TimeScalingProblem
from robustopt.path import build_path
from robustopt.robot import load_robot
from robustopt.solvers import Plan, Status, build_rows, solve
from robustopt.solvers.trajectory import binding_shares
from robustopt.tables import Column, Table, write_table

ROOT = Path(__file__).resolve().parents[1]
CONFIG = ROOT / "configs" / "waiter_two_blocks.yaml"

PAPER_TABLE_1 = {1.0: 3.229, 0.5: 3.232, 0.25: 3.704, 0.1875: 4.276, 0.125: 5.237}
"""Duration [s] by friction coefficient: the paper's Table 1, "execution time of optimized path", on hardware."""

FINE = 25
"""Collocation points of the fine grid per collocation point of the table."""

COLUMNS = (
    Column("friction", "mu", "g", r"$\mu$"),
    Column("ipopt", "ipopt [s]", ".3f"),
    Column("reachability", "reachability [s]", ".3f"),
    Column("fine", "fine grid [s]", ".3f"),
    Column("ratio", "ratio to the line above", ".4f"),
    Column("friction_alone", "if friction alone binds", ".4f"),
    Column("paper", "paper [s]", ".3f"),
    Column("paper_ratio", "paper's ratio", ".4f"),
    Column("against_paper", "ours / paper", ".3f"),
    Column("binds", "binds longest"),
)

ABOVE = """# Two blocks on a tray: duration against friction

Written by `make reproduce-tables`.
"""

BELOW = """
- Ours: `configs/waiter_two_blocks.yaml` with N = {points} collocation points and no interval on anything; only the
  coefficient of friction changes. "Fine grid" is `reachability` at N = {fine}.
- Paper: Table 1, "execution time of optimized path", from a bisection on hardware that ran at mu = 1, 0.5, 0.25, 0.125
  and 0.1875 in this order. These numbers are copied from there; all others come from the run that wrote this file.
- What differs: the paper's path, the sizes and masses of its blocks, the inertia of its arm and how it approximates the
  friction cone are not known to us. Our path is three straight sweeps of 1 m with a stop at each end, our blocks are
  8 x 8 x 12 cm and 0.5 kg each, the inertia of our links is that of solid cylinders and capsules, and our cones have 16
  edges. So the durations can be near each other, and need not be the same.
- What is physics: a motion slowed by a factor k needs horizontal forces smaller by k^2 under the same weight. While
  friction alone binds on a level tray, the duration is therefore proportional to 1 / sqrt(mu), whatever path and
  masses: sqrt(0.25 / 0.1875) = 1.1547 and sqrt(0.1875 / 0.125) = 1.2247, in our plans and in the paper's executions.
- With more friction, tipping and the arm's own limits bind, and still more gains little: from mu = 0.5 to 1 neither our
  duration nor the paper's changes by more than 0.1 %.
"""


def problem_at(friction: float, points: int) -> TimeScalingProblem:
    overrides = [f"contact.friction={friction}", f"solver.collocation_points={points}", "uncertainty={}"]
    config = load_config(CONFIG, overrides)
    robot = load_robot(config)
    return build_rows(config, robot, build_path(config, robot))


def solved(problem: TimeScalingProblem, method: str) -> Plan:
    plan = solve(problem, method)
    if plan.status is not Status.SOLVED:
        raise SystemExit(f"friction {problem.config.contact.friction}, {method}: {plan.message}")
    return plan


def durations(frictions: Sequence[float], points: int) -> list[dict[str, float | str]]:
    """Return one record per friction coefficient, with its ratios to the one before."""
    records: list[dict[str, float | str]] = []
    for friction in frictions:
        problem = problem_at(friction, points)
        fastest = solved(problem, "reachability")
        name, share = next(iter(binding_shares(fastest).items()))
        ours: dict[str, float] = {
            "friction": friction,
            "ipopt": solved(problem, "ipopt").duration,
            "reachability": fastest.duration,
            "fine": solved(problem_at(friction, FINE * points), "reachability").duration,
            "paper": PAPER_TABLE_1[friction],
            "against_paper": fastest.duration / PAPER_TABLE_1[friction],
        }
        if records:
            before = {key: float(records[-1][key]) for key in ours}
            ours["ratio"] = ours["reachability"] / before["reachability"]
            ours["friction_alone"] = sqrt(before["friction"] / friction)
            ours["paper_ratio"] = ours["paper"] / before["paper"]
        records.append({**ours, "binds": f"{name} {100 * share:.0f} %"})
    return records


def write(out: Path, place: Bench, points: int = 200) -> list[Path]:
    """Plan at every friction coefficient and write the table."""
    place.say(f"{len(PAPER_TABLE_1)} coefficients of friction")
    records = durations(tuple(PAPER_TABLE_1), points)
    caption = f"Duration of the two-block waiter task by coefficient of friction, {points} collocation points."
    below = BELOW.format(points=points, fine=FINE * points)
    return write_table(Table(COLUMNS, tuple(records), caption), out, "durations", ABOVE, below)


def main() -> None:
    parser = argparse.ArgumentParser(description="Durations against friction, beside the paper's.")
    parser.add_argument("--points", type=int, default=200, help="collocation points")
    parser.add_argument("--out", type=Path, default=ROOT / "results" / "tables")
    arguments = parser.parse_args()
    for path in write(arguments.out, Bench(arguments.out), arguments.points):
        print(path)


if __name__ == "__main__":
    main()
