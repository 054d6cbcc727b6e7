"""Measure how tight the bounds of robust plans are, one kind of interval at a time.

    python experiments/bound_tightness.py [--points N] [--out results/benchmarks]

Writes bound_tightness.csv and .md.
"""

from __future__ import annotations

import argparse
from math import nan
from pathlib import Path

from worst_parameters import tightness

from robustopt.config.load import load_config
from robustopt.path import build_path
from robustopt.robot import load_robot
from robustopt.solvers import Status, build_rows, solve
from robustopt.tables import Column, Table, csv_text, markdown_text

ROOT = Path(__file__).resolve().parents[1]

TWO_BLOCKS = {
    "friction": "[0.35, 0.8]",
    "joint_acceleration": "{deviation: 0.3}",
    "contact_points": "0.004",
    "center_of_mass": "{lower: [0.005, 0.005, 0.02], upper: [0.005, 0.005, 0.02]}",
    "mass": "{lower: [0.4, 0.6], upper: [0.4, 0.6]}",
}
SIDE_BY_SIDE = {
    "friction": "{bottle: [0.3, 0.4], crate: [0.35, 0.45], lid: [0.4, 0.6]}",
    "joint_acceleration": "{deviation: 0.3}",
    "contact_points": "{bottle: 0.004, crate: 0.006, lid: 0.003}",
    "center_of_mass": "{bottle: [0.004, 0.004, 0.02], crate: [0.01, 0.01, 0.01], lid: [0.005, 0.005, 0.002]}",
    "mass": "{bottle: [0.5, 1.1], crate: [1.0, 1.4], lid: [0.1, 0.3]}",
}
HEAVY = {
    "joint_acceleration": "{deviation: 0.3}",
    "center_of_mass": "{casting: [0.01, 0.01, 0.01]}",
    "mass": "{casting: [11.0, 13.0]}",
}
TASKS = {
    "two_blocks": ("contact.friction=0.6", TWO_BLOCKS),
    "side_by_side": ("contact.friction=0.4", SIDE_BY_SIDE),
    "heavy": ("robot.joint_friction=false", HEAVY),
}
"""Override of each task, and intervals as wide as is sensible: the wider an interval, the looser its bound.

Joint torque binds in the last task.
"""

PRODUCT = ("joint_acceleration", "center_of_mass")
"""The two kinds whose product is bounded term by term."""

LEAST_PRICE = 1e-4
"""Price of the intervals, as a part of the duration, below which a share of it means nothing."""

COLUMNS = (
    Column("task", "task"),
    Column("intervals", "intervals on"),
    Column("nominal", "without intervals [s]", ".4f"),
    Column("robust", "with the bounds [s]", ".4f"),
    Column("possible", "lower bound of any robust plan [s]", ".4f"),
    Column("loss", "loss of duration, at most [%]", ".3f"),
    Column("share", "share of the price of robustness, at most [%]", ".2f"),
    Column("rows", "worst cases found"),
)

ABOVE = """# How tight the bounds are

Written by `python experiments/bound_tightness.py` with N = {points} collocation points.
"""

BELOW = """
- A plan holds for every value in its intervals because its rows bound the worst case. Where a bound is not exact, the
  plan is slower than it would have to be. "With the bounds" is our plan. "Lower bound of any robust plan" is the
  fastest timing for those values of the parameters that a search has found to violate faster ones: masses, centres of
  mass and errors climb to their worst from random corners, squares and products of them included, and contact points
  are displaced one by one (`worst_parameters.py`). No robust plan is faster than that, so the loss of our plan is at
  most the difference.
- In the task "heavy" joint torque binds: there the torques of all joints are searched in the same way. Its joints have
  no viscous friction, whose tangent is a bound of another kind.
- "Share of the price" is this difference as a part of what the intervals cost against the plan without them.
- Each kind by itself is exact or nearly so. What costs is the product of an acceleration error and a displacement of a
  centre of mass, which is bounded term by term as if every term could be at its worst at once.
"""


def with_intervals(task: str, uncertainty: str, points: int) -> dict[str, float]:
    """Return the duration of the plan and a lower bound for any robust plan [s], and the number of worst cases."""
    override, _ = TASKS[task]
    overrides = [override, f"solver.collocation_points={points}", f"uncertainty={uncertainty}"]
    config = load_config(ROOT / "configs" / f"waiter_{task}.yaml", overrides)
    robot = load_robot(config)
    problem = build_rows(config, robot, build_path(config, robot))
    plan = solve(problem, "reachability")
    if plan.status is not Status.SOLVED:
        raise SystemExit(f"{task} with {uncertainty}: {plan.message}")
    found = tightness(problem, plan, config.seed)
    return {"robust": found.robust, "possible": found.possible, "rows": found.rows}


def record(task: str, kinds: tuple[str, ...], points: int) -> dict[str, float | int | str]:
    _, intervals = TASKS[task]
    uncertainty = "{" + ", ".join(f"{kind}: {intervals[kind]}" for kind in kinds) + "}"
    found = with_intervals(task, uncertainty, points)
    nominal = with_intervals(task, "{}", points)["robust"]
    gap, price = found["robust"] - found["possible"], found["robust"] - nominal
    return {
        "task": task,
        "intervals": "all" if len(kinds) == len(intervals) else " and ".join(kinds),
        "nominal": nominal,
        **found,
        "rows": int(found["rows"]),
        "loss": 100 * gap / found["possible"],
        "share": 100 * gap / price if price > LEAST_PRICE * nominal else nan,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description="How tight the bounds of robust plans are.")
    parser.add_argument("--points", type=int, default=60, help="number of collocation points")
    parser.add_argument("--out", type=Path, default=ROOT / "results" / "benchmarks", help="folder that is written to")
    chosen = parser.parse_args()
    records = []
    for task, (_, intervals) in TASKS.items():
        for kinds in [*((kind,) for kind in intervals), PRODUCT, tuple(intervals)]:
            records.append(record(task, kinds, chosen.points))
            print(" ".join(str(value) for value in records[-1].values()), flush=True)
    table = Table(COLUMNS, tuple(records))
    chosen.out.mkdir(parents=True, exist_ok=True)
    (chosen.out / "bound_tightness.csv").write_text(csv_text(table), encoding="utf-8")
    text = ABOVE.format(points=chosen.points) + "\n" + markdown_text(table) + BELOW
    (chosen.out / "bound_tightness.md").write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
