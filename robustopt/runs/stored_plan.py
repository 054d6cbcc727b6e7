"""Reads the plan of a run folder back, number for number."""

from __future__ import annotations

import csv
import io
from pathlib import Path

import numpy as np

from robustopt.arrays import Array
from robustopt.config import Config
from robustopt.errors import RunFolderError, SolverFailed
from robustopt.files import MOST_BYTES, read_text
from robustopt.limits import rows_along
from robustopt.limits.grid import Grid
from robustopt.limits.track import build_track
from robustopt.path import Path as RobotPath
from robustopt.path import build_path
from robustopt.robot import load_robot
from robustopt.solvers import Plan
from robustopt.solvers.plan import jerk_plan, solved_plan
from robustopt.solvers.trajectory import Trajectory

SAME_PATH = 1e-9
"""Joint positions of a stored plan and of its rebuilt path differ by rounding alone, if at all [rad or m]."""

SAME_TIME = 1e-9
"""Times of a stored plan and of its speeds differ by rounding alone, if at all: share of the duration."""


def read_plan(config: Config, path: Path) -> Plan:
    """Return the plan of a configuration from a file that `Plan.export` wrote.

    The file holds sd, and x = sd^2; a square root gives back sd exactly.

    Args:
        config: the plan was made from it.
        path: of the file `plan.csv`.

    Raises:
        RunFolderError: the file is no plan of the configuration.
    """
    robot = load_robot(config)
    line = build_path(config, robot)
    head, numbers = _read(path)
    _require_joints(path, head, robot.joint_names)
    s, sd, q = numbers[:, 1], numbers[:, 2], numbers[:, 4 : 4 + robot.n]
    grid = _grid_of(s, line)
    if grid is None or np.abs(line.evaluate(s, grid.piece) - q).max() > SAME_PATH:
        raise _changed(path, "not on the path of the configuration beside it")
    problem = rows_along(build_track(robot, line, grid), config)
    if np.isfinite(robot.limits.jerk).any():
        plan = jerk_plan(problem, sd**2, np.where(problem.rest, 0.0, numbers[:, 3]), "stored", {})
    else:
        plan = solved_plan(problem, sd**2, "stored", {})
    if (sd < 0).any() or not _same_times(plan, numbers[:, 0]):
        raise _changed(path, "its times are not those of its speeds sd")
    return plan


def _grid_of(s: Array, line: RobotPath) -> Grid | None:
    """Return the grid of stored points (P,), None unless they lead from end to end with a stop at every break."""
    doubled = np.diff(s, prepend=-1.0) == 0.0
    ends = len(s) > 1 and s[0] == 0.0 and s[-1] == 1.0 and bool((np.diff(s) >= 0.0).all())
    if not ends or not np.array_equal(s[doubled], line.breaks[1:-1]):
        return None
    return Grid(s, np.cumsum(doubled, dtype=np.intp))


def _read(path: Path) -> tuple[list[str], Array]:
    """Return the head and the numbers of a file."""
    try:
        head, *lines = csv.reader(io.StringIO(read_text(path, MOST_BYTES), newline=""))
        short = next((i for i, line in enumerate(lines, 2) if len(line) != len(head)), None)
        if short is not None:
            raise _changed(path, f"line {short} is cut short, or has been changed")
        numbers = np.array(lines, dtype=float).reshape(-1, len(head))
    except (OSError, ValueError, csv.Error) as error:
        found = getattr(error, "strerror", None) or error
        raise RunFolderError(f"{path}: cannot be read as a plan: {found}") from None
    if not np.isfinite(numbers).all():
        row = int(np.flatnonzero(~np.isfinite(numbers).all(axis=1))[0])
        raise _changed(path, f"line {row + 2} has a number that is not finite")
    return head, numbers


def _require_joints(path: Path, head: list[str], names: tuple[str, ...]) -> None:
    expected = ["t", "s", "sd", "sdd", *(f"{kind}_{name}" for kind in ("q", "qd", "qdd") for name in names)]
    if head != expected:
        theirs = ", ".join(column.removeprefix("q_") for column in head if column.startswith("q_"))
        raise RunFolderError(f"{path}: a plan of the joints {theirs}; expected one of {', '.join(names)}")


def _same_times(plan: Plan, times: Array) -> bool:
    try:
        expected = Trajectory.from_plan(plan).times
    except SolverFailed:  # it never ends
        return False
    return bool(np.abs(expected - times).max() <= SAME_TIME * expected[-1])


def _changed(path: Path, found: str) -> RunFolderError:
    return RunFolderError(f"{path}: {found}; expected the plan as it was written")
