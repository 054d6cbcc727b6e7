"""Measure how tight the bounds of robust plans are, one kind of interval at a time.

    python experiments/bound_tightness.py [--points N] [--out results/benchmarks]

Writes bound_tightness.csv and .md.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
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
TALL_BLOCK = {
    "center_of_mass": "{block: [0.06, 0.06, 0.2]}",
    "joint_acceleration": "{deviation: 0.1}",
}
TALL = (
    "objects.block.size=[0.15, 0.15, 0.56]",
    "objects.block.mass=1.0",
    "contact.friction=0.2",
    "robot.collision.check=false",
)
TASKS = {
    "two_blocks": (("contact.friction=0.6",), TWO_BLOCKS),
    "side_by_side": (("contact.friction=0.4",), SIDE_BY_SIDE),
    "heavy": (("robot.joint_friction=false",), HEAVY),
    "one_block": (TALL, TALL_BLOCK),
}
"""Overrides of each task, and intervals as wide as is sensible: the wider an interval, the looser its bound.

Joint torque binds in the third task. The last one is a tall block whose mass may lie almost anywhere in it.
"""

PRODUCT = ("joint_acceleration", "center_of_mass")
"""The two kinds with the largest products."""

KNOWN, REALIZABLE, FACTOR = "[1, 1]", "realizable", "[0.5, 1.5]"
"""Values of `uncertainty.inertia` for objects whose centre of mass has an interval."""

GOALS = {KNOWN: 0.3, FACTOR: 0.3, REALIZABLE: 1.0}
"""Largest loss that is allowed [%]."""

LEAST_PRICE = 1e-4
"""Price of the intervals, as a part of the duration, below which a share of it means nothing."""

COLUMNS = (
    Column("task", "task"),
    Column("intervals", "intervals on"),
    Column("inertia", "inertia"),
    Column("nominal", "without intervals [s]", ".4f"),
    Column("robust", "with the bounds [s]", ".4f"),
    Column("possible", "lower bound of any robust plan [s]", ".4f"),
    Column("loss", "loss of duration, at most [%]", ".3f"),
    Column("goal", "goal [%]", ".1f"),
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
  mass, inertias and errors climb to their worst from random corners, squares and products of them included, and contact
  points are displaced one by one (`worst_parameters.py`). No robust plan is faster than that, so the loss of our plan
  is at most the difference.
- "Inertia" is the value of `uncertainty.inertia` for the objects whose centre of mass has an interval: known but for a
  factor, or that of any distribution of the mass within the shape (`realizable`, the default). For the latter the
  search places masses at corners of a box, at ends of chords of a cylinder, or in planes, lines and points between them
  (`worst_bodies.py`).
- In the task "heavy" joint torque binds: there the torques of all joints are searched in the same way. Its joints have
  no viscous friction, whose tangent is a bound of another kind.
- "Share of the price" is this difference as a part of what the intervals cost against the plan without them.
- Each kind by itself is exact or nearly so. Products of an acceleration error, which all bodies share, with masses,
  centres of mass and inertias are exact too: the worst error is found for all of them together. What is left is that
  the squares of a displaced centre of mass, or the second moments of a realizable body, come from a set that contains
  those of all possible bodies, but also others: the set does not depend on where the centre of mass is.
- In the task "one_block" with both kinds, the tall block all but tips over from the error alone. At N = 25 its bound is
  at most 0.3 % of the weight too large for known inertia, and 1 % for a realizable one, but little is left of the
  margin against tipping, so that this costs more time than the goal allows.
"""


def with_intervals(task: str, uncertainty: str, points: int) -> dict[str, float]:
    """Return the duration of the plan and a lower bound for any robust plan [s], and the number of worst cases."""
    overrides = [*TASKS[task][0], f"solver.collocation_points={points}", f"uncertainty={uncertainty}"]
    config = load_config(ROOT / "configs" / f"waiter_{task}.yaml", overrides)
    robot = load_robot(config)
    problem = build_rows(config, robot, build_path(config, robot))
    plan = solve(problem, "reachability")
    if plan.status is not Status.SOLVED:
        raise SystemExit(f"{task} with {uncertainty}: {plan.message}")
    found = tightness(problem, plan, config.seed)
    return {"robust": found.robust, "possible": found.possible, "rows": found.rows}


def record(task: str, kinds: tuple[str, ...], points: int, inertia: str = KNOWN) -> dict[str, float | int | str]:
    """Return the line of a task with intervals of some kinds; the inertia counts if a centre of mass has one."""
    _, intervals = TASKS[task]
    given, moves = {kind: intervals[kind] for kind in kinds}, "center_of_mass" in kinds
    if moves:
        names = load_config(ROOT / "configs" / f"waiter_{task}.yaml").objects
        given["inertia"] = "{" + ", ".join(f"{name}: {inertia}" for name in names) + "}"
    found = with_intervals(task, "{" + ", ".join(f"{kind}: {value}" for kind, value in given.items()) + "}", points)
    nominal = with_intervals(task, "{}", points)["robust"]
    gap = max(found["robust"] - found["possible"], 0.0)  # below 0 by rounding errors alone
    price = found["robust"] - nominal
    return {
        "task": task,
        "intervals": "all" if len(kinds) == len(intervals) else " and ".join(kinds),
        "inertia": inertia if moves else "",
        "nominal": nominal,
        **found,
        "rows": int(found["rows"]),
        "loss": 100 * gap / found["possible"],
        "goal": GOALS[inertia],
        "share": 100 * gap / price if price > LEAST_PRICE * nominal else nan,
    }


def cases(intervals: Mapping[str, str]) -> list[tuple[tuple[str, ...], str]]:
    """Return the kinds of intervals of each line of a task, and the inertia there."""
    together = [PRODUCT] if len(intervals) == len(PRODUCT) else [PRODUCT, tuple(intervals)]
    return [
        *((kinds, KNOWN) for kinds in [*((kind,) for kind in intervals), *together]),
        (("center_of_mass",), FACTOR),
        *((kinds, REALIZABLE) for kinds in [("center_of_mass",), *together]),
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description="How tight the bounds of robust plans are.")
    parser.add_argument("--points", type=int, default=60, help="number of collocation points")
    parser.add_argument("--out", type=Path, default=ROOT / "results" / "benchmarks", help="folder that is written to")
    chosen = parser.parse_args()
    records = []
    for task, (_, intervals) in TASKS.items():
        for kinds, inertia in cases(intervals):
            records.append(record(task, kinds, chosen.points, inertia))
            print(" ".join(str(value) for value in records[-1].values()), flush=True)
    table = Table(COLUMNS, tuple(records))
    chosen.out.mkdir(parents=True, exist_ok=True)
    (chosen.out / "bound_tightness.csv").write_text(csv_text(table), encoding="utf-8")
    text = ABOVE.format(points=chosen.points) + "\n" + markdown_text(table) + BELOW
    (chosen.out / "bound_tightness.md").write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
