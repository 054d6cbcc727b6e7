"""Measure the jerk of exported motions between their points, interpolated as by the controllers of ROS.

    python experiments/quintics.py [--out results/benchmarks]

Writes quintics.md in half a minute.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from jerk import TASKS

from robustopt.config import Config
from robustopt.config.load import load_config
from robustopt.exports.cycles import Motion, at_jerk_steps, whole_cycles
from robustopt.exports.quintics import largest_jerk
from robustopt.solvers import Status, build_problem, solve
from robustopt.tables import Column, Table, markdown_text

ROOT = Path(__file__).resolve().parents[1]

LIMITS = (1000.0, 300.0)
"""Limits of the jerk of all joints [rad/s^3]."""

PERIODS = (0.001, 0.002, 0.004, 0.008)
"""Periods of motions on whole control cycles [s]."""

LONGEST = 0.004
"""Longest time between points at the steps of the jerk [s]."""

WAYPOINTS = (5, 30, 100)
"""Numbers of waypoints of the paths of seven joints."""

COLUMNS = (
    Column("task", "task"),
    Column("limit", "jerk limit [rad/s³]", ".0f"),
    *(Column(f"{period}", f"every {1e3 * period:g} ms [%]", ".1f") for period in PERIODS),
    Column("steps", "at the steps [%]", ".2f"),
    Column("points", "points", ".0f"),
    Column("shortest", "shortest step [ms]", ".2f"),
)

TEXT = """# Jerk between the points of exported motions

Written by `python experiments/quintics.py`.

{table}
- The largest jerk of polynomials of fifth degree between the points, as a percentage of its limit: on whole control
  cycles, and with a point at every step of the jerk and at most {longest:g} ms between points. "Points" and "shortest
  step" are of the latter.
- The tasks are those of `jerk.md`, and smooth random paths of seven joints with a velocity limit of 2 rad/s and an
  acceleration limit of 10 rad/s². They are planned by `reachability` on their grids.
"""


def main() -> None:
    """Plan all tasks, and write the table."""
    parser = argparse.ArgumentParser(description="Measures the jerk of exported motions between their points.")
    parser.add_argument("--out", type=Path, default=ROOT / "results" / "benchmarks", help="folder for the table")
    arguments = parser.parse_args()
    records = [record(name, limit, shipped(name, limit)) for name in TASKS for limit in LIMITS]
    records += [
        record(f"seven joints, {count} waypoints", limit, waypoints(count, limit))
        for count in WAYPOINTS
        for limit in LIMITS
    ]
    text = TEXT.format(table=markdown_text(Table(COLUMNS, tuple(records))), longest=1e3 * LONGEST)
    (arguments.out / "quintics.md").write_text(text, encoding="utf-8")


def shipped(name: str, limit: float) -> Config:
    """Return a shipped task with a jerk limit."""
    return load_config(ROOT / "configs" / f"{name}.yaml", [*TASKS[name], f"robot.limits.all={{jerk: {limit}}}"])


def waypoints(count: int, limit: float) -> Config:
    """Return the task of a smooth random path of seven joints."""
    rng = np.random.default_rng(count)
    place = np.linspace(0.0, 2.0 * np.pi, count)[:, None]
    joints = 0.8 * np.sin(place * rng.uniform(0.3, 1.2, 7) + rng.uniform(0.0, 2.0 * np.pi, 7))
    limits = {"all": {"velocity": 2.0, "acceleration": 10.0, "jerk": limit}}
    model = str(ROOT / "tests" / "fixtures" / "seven_joints.xml")
    keys = {"robot": {"model": model, "tool": "tool", "limits": limits}, "path": {"joints": joints.tolist()}}
    return load_config({"name": f"seven_joints_{count}", **keys})


def record(name: str, limit: float, config: Config) -> dict[str, object]:
    """Return the row of a task."""
    plan = solve(build_problem(config), "reachability")
    assert plan.status is Status.SOLVED, plan.message
    steps = at_jerk_steps(plan, LONGEST)
    even = {f"{period}": _percent(whole_cycles(plan, period), limit) for period in PERIODS}
    shortest = 1e3 * float(np.diff(steps.samples.t).min())
    found = {"task": name, "limit": limit, **even, "steps": _percent(steps, limit), "points": len(steps.samples.t)}
    return found | {"shortest": shortest}


def _percent(motion: Motion, limit: float) -> float:
    return 100.0 * float(largest_jerk(motion.samples).max()) / limit


if __name__ == "__main__":
    main()
