"""The files of a plan in a run folder."""

from __future__ import annotations

import json
from pathlib import Path

from robustopt.exports.cycles import at_jerk_steps
from robustopt.exports.messages import joint_trajectory
from robustopt.exports.tables import write_plan_csv, write_trajectory_csv
from robustopt.files import write_text
from robustopt.solvers import Plan
from robustopt.solvers.trajectory import Trajectory


def write_folder(plan: Plan, folder: Path | str, period: float | None = None) -> list[Path]:
    """Write a plan into a folder, see `Plan.export`.

    Args:
        plan: the plan.
        folder: the folder, which is made if it does not exist.
        period: period of the trajectory, or longest time between points where the jerk steps [s]; default:
            `output.period`.

    Raises:
        Infeasible: the plan has no timing.
        ConfigError: the period is not positive and finite, or too short for the duration.
    """
    folder, period = Path(folder), plan.problem.config.output.period if period is None else period
    every_period = Trajectory.from_plan(plan).every(period)  # may fail, and then leaves no folder behind
    samples = every_period if plan.steady else at_jerk_steps(plan, period).samples
    folder.mkdir(parents=True, exist_ok=True)
    files = [folder / name for name in ("plan.csv", "trajectory.csv", "joint_trajectory.json")]
    write_plan_csv(plan, files[0])
    write_trajectory_csv(plan, period, files[1])
    write_text(files[2], json.dumps(joint_trajectory(samples, plan.problem.robot.joint_names)) + "\n")
    return files
