"""Trajectories as CSV files."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np

from robustopt.arrays import Array
from robustopt.files import written
from robustopt.solvers import Plan
from robustopt.solvers.trajectory import Samples, Trajectory


def write_plan_csv(plan: Plan, path: Path) -> None:
    """Write a plan at its grid points as CSV: t, s, sd, sdd, q_<joint>, qd_<joint>, qdd_<joint>.

    There is one row per grid point, see `Trajectory.at_gridpoints`; a stop has two. Every number reads back exactly.

    Args:
        plan: a plan with a timing.
        path: name of the file.

    Raises:
        Infeasible: the plan is empty.
    """
    write_csv(Trajectory.from_plan(plan).at_gridpoints(), plan.problem.robot.joint_names, path)


def write_trajectory_csv(plan: Plan, period: float, path: Path, speed: float = 1.0) -> None:
    """Write a plan sampled at a constant period as CSV, with the columns of `write_plan_csv`.

    The first sample is at t = 0 and the last exactly at the end, see `sample_times`.

    Args:
        plan: a plan with a timing.
        period: time between samples [s].
        path: name of the file.
        speed: factor on the speed of the plan.

    Raises:
        Infeasible: the plan is empty.
        ConfigError: the period is not positive, or too short.
    """
    write_csv(Trajectory.from_plan(plan, speed).every(period), plan.problem.robot.joint_names, path)


def write_csv(samples: Samples, joint_names: tuple[str, ...], path: Path) -> None:
    """Write samples as CSV, with the columns of `columns`.

    Args:
        samples: the samples.
        joint_names: names of the joints.
        path: name of the file.
    """
    heads, rows = columns(samples, joint_names)
    with written(path) as beside, beside.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(heads)
        writer.writerows(rows.tolist())


def columns(samples: Samples, joint_names: tuple[str, ...]) -> tuple[list[str], Array]:
    """Return a table of samples with columns t, s, sd, sdd, q_<joint>, qd_<joint>, qdd_<joint>.

    Args:
        samples: the samples.
        joint_names: names of the joints.

    Returns:
        Column headings, and rows (T, columns).
    """
    scalars = np.stack([samples.t, samples.s, samples.sd, samples.sdd], axis=1)
    rows = np.hstack([scalars, samples.q, samples.qd, samples.qdd])
    heads = ["t", "s", "sd", "sdd", *(f"{quantity}_{name}" for quantity in ("q", "qd", "qdd") for name in joint_names)]
    return heads, rows + 0.0  # -0.0 + 0.0 is 0.0
