"""Executions by a person with a robot: writes the next trajectory to a file, and asks how it went."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from robustopt.arrays import Array
from robustopt.exports.tables import write_trajectory_csv
from robustopt.files import MOST_BYTES, read_text
from robustopt.learning.moments import Moments
from robustopt.runs.journal import Execution
from robustopt.runs.plan_run import PlanResult
from robustopt.solvers.trajectory import Trajectory

NEXT = "next_trajectory.csv"

_ANSWERS = {"y": True, "yes": True, "s": True, "success": True, "n": False, "no": False, "f": False, "failure": False}


class Manual:
    """Executor that asks a person; the answers are in the journal, so that the next day goes on after the last one."""

    fresh = False

    def __init__(self, folder: Path, ask: Callable[[str], str], say: Callable[[str], None]) -> None:
        """Make an executor.

        Args:
            folder: of the run; the trajectory to be executed is written into it.
            ask: shows a question and returns the answer, or raises EOFError if nobody answers any more.
            say: shows a text.
        """
        self._folder, self._ask, self._say = folder, ask, say

    def ahead(self, wanted: int, done: int) -> int:
        """Return 1: a robot executes one trajectory at a time."""
        return min(wanted, 1)

    def run(self, planned: PlanResult, numbers: Sequence[int], speed: float) -> list[Execution]:
        """Ask the user to execute a plan and to report the outcomes.

        Args:
            planned: the plan and its certificate.
            numbers: numbers of the executions.
            speed: factor on the speed of the plan.

        Raises:
            KeyboardInterrupt: nobody answers any more.
        """
        try:
            return [self._one(planned, number, speed) for number in numbers]
        except EOFError:
            raise KeyboardInterrupt from None

    def _one(self, planned: PlanResult, number: int, speed: float) -> Execution:
        plan, path = planned.plan, self._folder / NEXT
        write_trajectory_csv(plan, planned.config.output.period, path, speed)
        faster = "" if speed == 1.0 else f", {speed:g} times as fast as planned"
        self._say(f"Execution {number + 1}: run {path}, {plan.duration / speed:.4f} s{faster}.")
        success = self._success()
        errors = self._errors(Trajectory.from_plan(plan, speed), plan.problem.robot.joint_names)
        return Execution(number, success, "success" if success else "failure", "", None, None, errors)

    def _success(self) -> bool:
        while (answer := self._ask("Did it succeed? [y/n] ").strip().lower()) not in _ANSWERS:
            self._say(f"Found {answer!r}; expected y or n.")
        return _ANSWERS[answer]

    def _errors(self, trajectory: Trajectory, joints: tuple[str, ...]) -> Moments:
        while text := self._ask("Acceleration log, a CSV file (Enter for none): ").strip():
            try:
                return errors_of_log(Path(text).expanduser(), trajectory, joints)
            except OSError as error:
                self._say(f"{text}: cannot be read: {error.strerror or error}")
            except (ValueError, csv.Error) as error:
                self._say(f"{text}: {error}")
        return Moments()


def errors_of_log(path: Path, trajectory: Trajectory, joints: tuple[str, ...]) -> Moments:
    """Return the moments of the executed minus the planned joint acceleration in a log.

    Samples before the start and after the end of the motion are left out.

    Args:
        path: CSV with the columns t, the time since the start of the motion [s], and qdd_<joint> [rad/s^2 or m/s^2]
            for every joint.
        trajectory: that was executed.
        joints: their names.

    Raises:
        ValueError: the file is not such a log.
        OSError: the file cannot be read.
    """
    times, accelerations = _read_log(path, joints)
    moving = (times > 0) & (times < trajectory.duration)
    if not moving.any():
        raise ValueError(
            f"no sample between 0 and {trajectory.duration:.4g} s, the motion; expected times since its start"
        )
    error = accelerations[moving] - trajectory.sample(times[moving]).qdd
    return Moments.of_means(int(moving.sum()), error.mean(axis=0).tolist(), (error**2).mean(axis=0).tolist())


def _read_log(path: Path, joints: tuple[str, ...]) -> tuple[Array, Array]:
    """Return the times (T,) and the joint accelerations (T, n) of a log."""
    rows = list(csv.reader(io.StringIO(read_text(path, MOST_BYTES), newline="")))
    wanted = ["t", *(f"qdd_{name}" for name in joints)]
    missing = [name for name in wanted if not rows or name not in rows[0]]
    if missing:
        raise ValueError(f"no column {', '.join(missing)}; expected the columns {', '.join(wanted)}")
    columns = [rows[0].index(name) for name in wanted]
    try:
        values = np.array([[row[i] for i in columns] for row in rows[1:]], dtype=float)
    except (ValueError, IndexError):
        raise ValueError("a line has a cell that is not a number; expected numbers in every line") from None
    if not values.size or not np.isfinite(values).all():
        raise ValueError("no samples, or numbers that are not finite; expected finite numbers")
    return values[:, 0], values[:, 1:]
