"""Executions by a person with a robot: writes the next trajectory to a file, and asks how it went."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Sequence
from math import nan
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline

from robustopt.arrays import Array
from robustopt.evidence import UNKNOWN, Failure
from robustopt.exports.tables import write_trajectory_csv
from robustopt.files import MOST_BYTES, read_text
from robustopt.learning.moments import Moments, Values
from robustopt.learning.outcomes import Executed
from robustopt.runs.journal import Execution
from robustopt.runs.plan_run import PlanResult
from robustopt.scene.placement import supports
from robustopt.simulation import Status
from robustopt.simulation.feedback import low_passed, means_of_parts
from robustopt.solvers.trajectory import Trajectory

NEXT = "next_trajectory.csv"

KINDS = tuple(status.value for status in Status if status not in (Status.SUCCESS, Status.DIVERGED))
"""Ways in which an execution fails."""

LEAST_SAMPLES = 8
"""Smallest number of samples from which accelerations are differentiated (our choice)."""

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
        trajectory = Trajectory.from_plan(plan, speed)
        success = self._success()
        failure = None if success else self._failure(planned, trajectory)
        end = trajectory.duration if failure is None or failure.t is None else failure.t
        errors, series = self._errors(trajectory, plan.problem.robot.joint_names, end)
        return Execution(number, Executed(success, errors, failure, error_series=series))

    def _success(self) -> bool:
        while (answer := self._ask("Did it succeed? [y/n] ").strip().lower()) not in _ANSWERS:
            self._say(f"Found {answer!r}; expected y or n.")
        return _ANSWERS[answer]

    def _failure(self, planned: PlanResult, trajectory: Trajectory) -> Failure:
        """Ask what is known of a failure: any of a name, a kind and a time, in any order."""
        config, robot = planned.config, planned.plan.problem.robot
        names = (*config.objects, *robot.contacts, *robot.joint_names)
        example = f"{names[0]}, {KINDS[0]}, {0.5 * trajectory.duration:.2f}"
        tests: dict[str, Callable[[str], bool]] = {
            "what": names.__contains__, "kind": KINDS.__contains__,
            "time": lambda word: 0.0 <= _number(word) <= trajectory.duration,
        }  # fmt: skip
        while True:
            answer = self._ask(f"What failed first, how, and when [s], such as `{example}` (Enter if unknown)? ")
            words = [word.strip() for word in answer.split(",") if word.strip()]
            told = {kind: [word for word in words if test(word)] for kind, test in tests.items()}
            wrong = [word for word in words if not any(word in some for some in told.values())]
            wrong += [f"{', '.join(some)} together" for some in told.values() if len(some) > 1]
            if not wrong:
                break
            self._say(
                f"Found {wrong[0]!r}; expected a name ({', '.join(names)}), a kind ({', '.join(KINDS)}), or a time "
                f"from 0 to {trajectory.duration:.4g} s, each at most once."
            )
        what, kind, time = ("".join(told[part]) for part in tests)
        t = float(time) if time else None
        against = " and ".join(supports(config.objects[what])) if what in config.objects else ""
        s = None if t is None else float(trajectory.sample(np.array([t])).s[0])
        return Failure(kind or UNKNOWN, what, against, t, s)

    def _errors(
        self, trajectory: Trajectory, joints: tuple[str, ...], end: float
    ) -> tuple[Moments, tuple[Values, ...]]:
        while text := self._ask("Log of the motion, a CSV file (Enter for none): ").strip():
            try:
                return errors_of_log(Path(text).expanduser(), trajectory, joints, end)
            except OSError as error:
                self._say(f"{text}: cannot be read: {error.strerror or error}")
            except (ValueError, csv.Error) as error:
                self._say(f"{text}: {error}")
        return Moments(), ()


def errors_of_log(
    path: Path, trajectory: Trajectory, joints: tuple[str, ...], end: float | None = None
) -> tuple[Moments, tuple[Values, ...]]:
    """Return the executed minus the planned joint acceleration in a log: its moments, and its means over time.

    Samples before the start and after the end of the motion, or after its failure, are left out. The errors of
    velocities and positions are differentiated, and low-passed as those of a simulation are.

    Args:
        path: CSV with the columns t, the time since the start of the motion [s], and qdd_<joint>, qd_<joint> or
            q_<joint> for every joint [rad or m, and per s or s^2]; the first of these that the file has is used.
        trajectory: that was executed.
        joints: their names.
        end: time of the failure [s]; None without one.

    Raises:
        ValueError: the file is not such a log.
        OSError: the file cannot be read.
    """
    times, kind, values = _read_log(path, joints)
    last = trajectory.duration if end is None else end
    moving = (times > 0) & (times < last)
    if not moving.any():
        raise ValueError(f"no sample between 0 and {last:.4g} s, the motion; expected times since its start")
    times = times[moving]
    error = values[moving] - getattr(trajectory.sample(times), kind)
    if kind != "qdd":
        times, error = _differentiated(times, error, 1 if kind == "qd" else 2)
    moments = Moments.of_means(len(error), error.mean(axis=0).tolist(), (error**2).mean(axis=0).tolist())
    return moments, means_of_parts(error, times / trajectory.duration)


def _number(text: str) -> float:
    """Return a text as a number, nan if it is none."""
    try:
        return float(text)
    except ValueError:
        return nan


def _differentiated(times: Array, values: Array, order: int) -> tuple[Array, Array]:
    """Return equal time steps (T,) and the low-passed derivative of some order of values (T, n) at them."""
    if len(times) < LEAST_SAMPLES:
        raise ValueError(f"{len(times)} samples of the motion; expected {LEAST_SAMPLES} or more to differentiate")
    even = np.linspace(times[0], times[-1], len(times))
    return even, low_passed(CubicSpline(times, values)(even, order), even[1] - even[0])


def _read_log(path: Path, joints: tuple[str, ...]) -> tuple[Array, str, Array]:
    """Return the times (T,) of a log, the kind of its columns, and their values (T, n)."""
    text = io.StringIO(read_text(path, MOST_BYTES), newline="")
    rows = [row for row in csv.reader(text, skipinitialspace=True) if row]
    heads = rows[0] if rows else []
    expected = {kind: ["t", *(f"{kind}_{name}" for name in joints)] for kind in ("qdd", "qd", "q")}
    kind = next((kind for kind, wanted in expected.items() if set(wanted) <= set(heads)), "")
    if not kind:
        begun = next((wanted for wanted in expected.values() if set(wanted[1:]) & set(heads)), expected["qdd"])
        missing = ", ".join(name for name in begun if name not in heads)
        raise ValueError(f"no column {missing}; expected the columns {', '.join(begun)}, or those of qdd, qd or q")
    columns = [heads.index(name) for name in expected[kind]]
    try:
        values = np.array([[row[i] for i in columns] for row in rows[1:]], dtype=float)
    except (ValueError, IndexError):
        raise ValueError("a line has a cell that is not a number; expected numbers in every line") from None
    if not values.size or not np.isfinite(values).all():
        raise ValueError("no samples, or numbers that are not finite; expected finite numbers")
    if not (np.diff(values[:, 0]) > 0).all():
        raise ValueError("times that do not rise; expected samples in their order")
    return values[:, 0], kind, values[:, 1:]
