"""Compare plans with and without jerk limits: duration, jumps of the acceleration, and executions in simulation.

    python experiments/jerk.py [--trials 50] [--out results/benchmarks]

Writes jerk.csv and jerk.md in a few minutes.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from robustopt.certificate import certify
from robustopt.config.load import load_config
from robustopt.simulation import Executions
from robustopt.simulation.execute import execute
from robustopt.solvers import Plan, Status, build_problem, solve
from robustopt.solvers.trajectory import Trajectory
from robustopt.tables import Column, Table, csv_text, markdown_text

ROOT = Path(__file__).resolve().parents[1]

TASKS: dict[str, tuple[str, ...]] = {
    "waiter_one_block": (),
    "waiter_two_blocks": ("contact.friction=0.25",),
    "waiter_side_by_side": (),
    "waiter_bridge": (),
    "pick_suction": (),
    "pick_gripper": (),
}
"""Configurations and their overrides; with its own friction, the plan of two blocks has no margin."""

LIMITS = (np.inf, 1000.0, 300.0, 100.0)
"""Limits of the jerk of all joints [rad/s^3]."""

PERIOD = 0.002
"""Period of the samples whose steps are measured [s]."""

COLUMNS = (
    Column("task", "task"),
    Column("limit", "jerk limit [rad/s³]", ".0f"),
    Column("duration", "duration [s]", ".4f"),
    Column("cost", "longer [%]", ".2f"),
    Column("sampled", "largest sampled jerk [rad/s³]", ".0f"),
    Column("margin", "margin of the certificate [%]", ".2f"),
    Column("successes", "successes [%]", ".0f"),
    Column("tracking", "tracking error [mrad]", ".2f"),
    Column("slip", "slip [mm]", ".2f"),
    Column("tilt", "tilt [mrad]", ".2f"),
)

TEXT = """# Plans with jerk limits

Written by `python experiments/jerk.py`.

{table}
- The tasks are those in `configs/`, two blocks with a friction of 0.25. They are planned by `reachability` on their
  grids, each with the same jerk limit for all joints; without a number, jerk is not limited. {trials} trials each,
  in the world of the section `execution`.
- "Largest sampled jerk": difference of neighbouring samples of the planned joint accelerations, every {period:g} ms,
  per period. Without a limit it grows as the period shrinks.
- "Tracking error": median over the trials of the largest distance of a joint from its planned position.
- "Slip" and "tilt": median over the trials of the largest one of any object.
"""


def main() -> None:
    """Plan and execute all tasks, and write the table."""
    parser = argparse.ArgumentParser(description="Compares plans with and without jerk limits.")
    parser.add_argument("--trials", type=int, default=50, help="trials of each plan")
    parser.add_argument("--out", type=Path, default=ROOT / "results" / "benchmarks", help="folder for the table")
    arguments = parser.parse_args()
    records = [record for name in TASKS for record in compare(name, arguments.trials)]
    table = Table(COLUMNS, tuple(records))
    (arguments.out / "jerk.csv").write_text(csv_text(table), encoding="utf-8")
    text = TEXT.format(table=markdown_text(table), trials=arguments.trials, period=1e3 * PERIOD)
    (arguments.out / "jerk.md").write_text(text, encoding="utf-8")


def compare(name: str, trials: int) -> list[dict[str, object]]:
    """Return a record for each jerk limit of a task."""
    records: list[dict[str, object]] = []
    for limit in LIMITS:
        overrides = [*TASKS[name], *([f"robot.limits.all={{jerk: {limit}}}"] if np.isfinite(limit) else [])]
        plan = solve(build_problem(load_config(ROOT / "configs" / f"{name}.yaml", overrides=overrides)), "reachability")
        assert plan.status is Status.SOLVED, plan.message
        first = records[0]["duration"] if records else plan.duration
        executions = execute(plan, trials=trials)
        records.append(
            {
                "task": name,
                "limit": limit if np.isfinite(limit) else None,
                "duration": plan.duration,
                "cost": 100.0 * (plan.duration / float(first) - 1.0),  # type: ignore[arg-type]
                "sampled": sampled_jerk(plan),
                "margin": 100.0 * certify(plan).margin,
                **outcomes(executions),
            }
        )
        print(records[-1], flush=True)
    return records


def sampled_jerk(plan: Plan) -> float:
    """Return the largest difference of neighbouring samples of the joint accelerations, per period [rad/s^3]."""
    qdd = Trajectory.from_plan(plan).every(PERIOD).qdd
    return float(np.abs(np.diff(np.vstack([0 * qdd[:1], qdd[:-1]]), axis=0)).max() / PERIOD)


def outcomes(executions: Executions) -> dict[str, object]:
    """Return the share of successes and the medians of errors of executions."""
    trials = executions.outcomes
    slip = [max(found.slip for found in trial.objects.values()) for trial in trials]
    tilt = [max(found.tilt for found in trial.objects.values()) for trial in trials]
    return {
        "successes": 100.0 * executions.successes / len(trials),
        "tracking": 1e3 * float(np.median([trial.tracking_error for trial in trials])),
        "slip": 1e3 * float(np.median(slip)),
        "tilt": 1e3 * float(np.median(tilt)),
    }


if __name__ == "__main__":
    main()
