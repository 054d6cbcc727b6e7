"""Exports a plan, or the plan of a stored run, without planning again."""

from __future__ import annotations

from pathlib import Path

from robustopt.exports.write import Exported, Format, export_plan
from robustopt.runs.origin import unchanged_config
from robustopt.runs.plan_run import PLAN
from robustopt.runs.store import require_plan
from robustopt.runs.stored_plan import read_plan
from robustopt.solvers import Plan


def export(
    source: Plan | Path | str, *, format: Format = "ros", period: float | None = None, out: Path | str | None = None
) -> Exported:
    """Write a motion for a controller: a plan at every control cycle, slowed down so that it ends on a whole one.

    A plan with jerk limits is written as a message without a period: its points are where the jerk steps, and at most
    `output.period` apart. A controller that interpolates by polynomials of fifth degree then keeps the jerk limits.

    Args:
        source: a plan, or the folder of a run with a plan.
        format: `csv`, `ros` (a `trajectory_msgs/JointTrajectory`), `moveit` (a `moveit_msgs/RobotTrajectory`),
            `urscript` (a program for Universal Robots) or `npz` (arrays t, q, qd, qdd and joint_names).
        period: time between samples [s]; default: `output.period` of the configuration, and for messages with jerk
            limits the steps of the jerk.
        out: name of the file; the messages are JSON or YAML by its suffix. By default a file with the period in its
            name, in the folder of the run, or in the current one for a plan.

    Returns:
        The file, and the difference between the motion and the plan.

    Raises:
        Infeasible: the plan has no timing.
        ConfigError: the format is unknown or does not suit the robot, or the period is not positive or too short.
        RunFolderError: the run has no plan or a rejected one, or is not as it was written; or the file cannot be
            written.
    """
    if isinstance(source, Plan):
        return export_plan(source, format, period, out, Path())
    folder = Path(source)
    require_plan(folder)
    return export_plan(read_plan(unchanged_config(folder), folder / PLAN), format, period, out, folder)
