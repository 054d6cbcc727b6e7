"""The manual executor: a scripted person runs each trajectory, says what came of it, and may come back another day."""

import csv
import io
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from learning_tasks import remember_plans, task

from robustopt import cli
from robustopt.config.load import dump
from robustopt.evidence import UNKNOWN, Failure
from robustopt.learning.learner import Belief
from robustopt.learning.moments import Moments
from robustopt.learning.outcomes import Executed
from robustopt.runs.beliefs import Planner
from robustopt.runs.journal import Execution, Journal
from robustopt.runs.manual import NEXT, Manual, errors_of_log
from robustopt.runs.store import read_summary
from robustopt.simulation.feedback import PARTS
from robustopt.solvers.trajectory import Trajectory

TABLE_1 = "n\n\n\nn\n\n\nn\n\n\ny\n\nn\n\n\n"
"""Failures at 1, 0.5 and 0.25, success at 0.125, failure of the same path 5 % faster; of
the failures nothing is known, and there are no logs."""

ENDS = (3, 6, 9, 11, 14)
"""Number of answers up to the end of each execution."""


@pytest.fixture
def config_file(tmp_path) -> Path:
    path = tmp_path / "task.yaml"
    path.write_text(dump(task("bisection", delta=0.01)))
    return path


def learn(folder: Path, answers: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    """In a process of its own."""
    command = [sys.executable, "-m", "robustopt", "learn", *arguments, "--no-figures"]
    return subprocess.run(command, cwd=folder, input=answers, capture_output=True, text=True)


@pytest.fixture
def learn_here(tmp_path, monkeypatch, capsys):
    """In this process, which is quicker."""
    monkeypatch.chdir(tmp_path)
    remember_plans(monkeypatch)

    def call(answers: str, *arguments: str) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "stdin", io.StringIO(answers))
        code = cli.run(["learn", *arguments, "--no-figures"])
        return code, *capsys.readouterr()

    return call


def lines(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


# A run ----------------------------------------------------------------------------------------------------


def test_a_person_learns_as_in_the_papers_table_1(tmp_path, config_file):
    done = learn(tmp_path, TABLE_1, "task.yaml", "--executor", "manual", "--out", "run")
    assert done.returncode == 0, done.stderr
    rows = lines(tmp_path / "run" / "iterations.csv")
    assert [row["friction"] for row in rows] == ["1.0", "0.5", "0.25", "0.125"]
    assert [row["result"] for row in rows] == ["failure", "failure", "failure", "success"]
    assert [row["sped_up"] for row in rows] == ["", "", "", "no"]
    told = lines(tmp_path / "run" / "executions.csv")
    assert [row["success"] for row in told] == ["no", "no", "no", "yes", "no"]
    assert [row["speed"] for row in told] == ["1.0"] * 4 + ["1.05"]
    summary = read_summary(tmp_path / "run")
    assert (summary.status, summary.learning.end) == ("learned", "near-optimal")
    assert summary.learning.best.success_rate is None
    assert done.stderr.count("Did it succeed? [y/n]") == 5
    assert f"Execution 5: run run/{NEXT}" in done.stderr
    assert "1.05 times as fast as planned" in done.stderr
    assert not (tmp_path / "run" / NEXT).exists()
    assert "near-optimal" in done.stdout


def test_days_later_it_goes_on_where_the_person_left(tmp_path, config_file, learn_here):
    answers, manual = TABLE_1.splitlines(keepends=True), ("task.yaml", "--executor", "manual")
    assert learn_here(TABLE_1, *manual, "--out", "whole")[0] == 0
    for answered in range(len(answers)):
        parts = f"parts{answered}"
        code, _, err = learn_here("".join(answers[:answered]), *manual, "--out", parts)
        assert code == 130
        assert err.endswith(
            f"error: interrupted; all executions so far are kept: robustopt learn --resume --out {parts}\n"
        )
        assert (tmp_path / parts / NEXT).is_file()
        done = sum(end <= answered for end in ENDS)  # an execution without the last answer is asked for again
        code, _, err = learn_here("".join(answers[[0, *ENDS][done] :]), "--resume", "--out", parts)
        assert code == 0
        assert err.startswith(f"Execution {done + 1}: run {parts}/{NEXT}")
        for name in ("iterations.csv", "executions.csv", "plan.csv"):
            assert (tmp_path / parts / name).read_bytes() == (tmp_path / "whole" / name).read_bytes()


def test_stdin_that_is_closed_in_the_middle_keeps_what_was_told(tmp_path, config_file):
    first = learn(tmp_path, "n\n\n\nn\n", "task.yaml", "--executor", "manual", "--out", "run")
    assert first.returncode == 130
    assert "Traceback" not in first.stderr
    assert [len(entry.executions) for entry in Journal.open(tmp_path / "run").entries()] == [1, 0]


def test_persons_and_simulations_are_never_mixed(tmp_path, config_file, learn_here):
    assert learn_here("n\n\n\n", "task.yaml", "--executor", "manual", "--out", "run")[0] == 130
    code, out, err = learn_here("", "--resume", "--out", "run", "--executor", "simulation")
    assert (code, out, err) == (2, "", "error: run: was begun with --executor manual; expected the same\n")
    assert len(next(Journal.open(tmp_path / "run").entries()).executions) == 1


# One execution --------------------------------------------------------------------------------------------


class Person:
    """Answers in turn; remembers what was asked and said."""

    def __init__(self, *answers: str) -> None:
        self.answers, self.asked, self.told = list(answers), list[str](), list[str]()

    def ask(self, question: str) -> str:
        self.asked.append(question)
        if not self.answers:
            raise EOFError
        return self.answers.pop(0) + "\n"


@pytest.fixture(scope="module")
def planned():
    return Planner(task("bisection")).plan(Belief(0.3))


def execute(folder, planned, person, speed=1.0):
    return Manual(folder, person.ask, person.told.append).run(planned, [4], speed)[0]


@pytest.mark.parametrize(
    ("answer", "success"), [("y", True), ("YES", True), (" s ", True), ("n", False), ("failure", False)]
)
def test_answers(tmp_path, planned, answer, success):
    execution = execute(tmp_path, planned, Person(answer, *([""] if success else ["", ""])))
    failure = None if success else Failure(UNKNOWN)
    assert execution == Execution(4, Executed(success, Moments(), failure))
    assert execution.outcome.status == ("success" if success else "failure")


def test_an_answer_that_is_none_is_asked_for_again(tmp_path, planned):
    person = Person("perhaps", "", "y", "")
    assert execute(tmp_path, planned, person).outcome.success
    assert person.told[1:] == ["Found 'perhaps'; expected y or n.", "Found ''; expected y or n."]


def test_nobody_answers(tmp_path, planned):
    for answers in ((), ("y",), ("maybe",), ("n", "block, slid")):
        with pytest.raises(KeyboardInterrupt):
            execute(tmp_path, planned, Person(*answers))


@pytest.mark.parametrize(
    ("answer", "kind", "what", "against", "t"),
    [
        ("block, tipped, 0.25", "tipped", "block", "tray", 0.25),
        ("0.5,block", UNKNOWN, "block", "tray", 0.5),
        (" lost contact ", "lost contact", "", "", None),
        ("x, torque saturated", "torque saturated", "x", "", None),
    ],
)
def test_what_is_known_of_a_failure_comes_in_any_order(tmp_path, planned, answer, kind, what, against, t):
    failure = execute(tmp_path, planned, Person("n", answer, "")).outcome.failure
    assert (failure.kind, failure.what, failure.against, failure.t) == (kind, what, against, t)
    if t is None:
        assert failure.s is None
    else:
        assert failure.s == pytest.approx(Trajectory.from_plan(planned.plan).sample(np.array([t])).s[0])


@pytest.mark.parametrize("answer", ["blok, slid", "block, slided", "block, -1", "block, 99", "nan", "0.1, 0.2"])
def test_a_failure_that_is_none_is_asked_for_again(tmp_path, planned, answer):
    person = Person("n", answer, "block", "")
    assert execute(tmp_path, planned, person).outcome.failure == Failure(UNKNOWN, "block", "tray")
    wrong = {"blok, slid": "blok", "0.1, 0.2": "0.1, 0.2 together"}.get(answer, answer.split(", ")[-1])
    assert person.told[1].startswith(f"Found '{wrong}'; expected a name (block, x), a kind (slid, ")


@pytest.mark.parametrize("speed", [1.0, 1.05])
def test_the_trajectory_to_run_is_that_of_the_plan_at_its_speed(tmp_path, planned, speed):
    person = Person("y", "")
    execute(tmp_path, planned, person, speed)
    samples = lines(tmp_path / NEXT)
    assert float(samples[-1]["t"]) == pytest.approx(planned.plan.duration / speed)
    assert float(samples[-1]["q_x"]) == pytest.approx(1.0)
    assert person.told == [
        f"Execution 5: run {tmp_path / NEXT}, {planned.plan.duration / speed:.4f} s"
        + (", 1.05 times as fast as planned." if speed != 1.0 else ".")
    ]


# Logs -----------------------------------------------------------------------------------------------------


def log(path: Path, times: np.ndarray, accelerations: np.ndarray, head: str = "t,qdd_x") -> Path:
    rows = "\n".join(f"{t!r},{a!r}" for t, a in zip(times.tolist(), accelerations.tolist(), strict=True))
    path.write_text(f"{head}\n{rows}\n")
    return path


@pytest.fixture
def trajectory(planned):
    return Trajectory.from_plan(planned.plan)


def test_a_log_gives_the_error_of_its_samples_of_motion(tmp_path, trajectory):
    times = np.linspace(-0.5, trajectory.duration + 0.5, 301)
    moving = (times > 0) & (times < trajectory.duration)
    planned = np.zeros(301)
    planned[moving] = trajectory.sample(times[moving]).qdd[:, 0]
    errors = np.where(moving, np.random.default_rng(0).normal(0.1, 0.3, 301), 50.0)
    found, series = errors_of_log(log(tmp_path / "log.csv", times, planned + errors), trajectory, ("x",))
    assert np.mean(series) == pytest.approx(errors[moving].mean(), abs=0.01)
    assert len(series) == PARTS
    assert found.count == moving.sum()
    assert found.mean[0] == pytest.approx(errors[moving].mean())
    assert found.deviation[0] == pytest.approx(errors[moving].std())


def test_columns_may_stand_in_any_order_among_others(tmp_path, trajectory):
    (tmp_path / "log.csv").write_text("qdd_x, q_x, t\n1.0, 99, 0.1\n\n3.0, 99, 0.2\n\n")
    found, _ = errors_of_log(tmp_path / "log.csv", trajectory, ("x",))
    planned = trajectory.sample(np.array([0.1, 0.2])).qdd[:, 0]
    assert found.count == 2
    assert found.mean[0] == pytest.approx(2.0 - planned.mean())


@pytest.mark.parametrize("kind", ["q", "qd"])
def test_accelerations_are_differentiated_from_positions_or_velocities(tmp_path, trajectory, kind):
    """The joint oscillates about the plan by 1 mm at 3 Hz; samples are every 4 ms, give or take 1 ms."""
    times = np.linspace(0.0, trajectory.duration, round(trajectory.duration / 0.004))
    times[1:-1] += np.random.default_rng(0).uniform(-0.001, 0.001, len(times) - 2)
    turn = 2 * np.pi * 3.0
    swing = {"q": np.sin(turn * times), "qd": turn * np.cos(turn * times)}[kind]
    values = getattr(trajectory.sample(times), kind)[:, 0] + 0.001 * swing
    found, series = errors_of_log(log(tmp_path / "log.csv", times, values, f"t,{kind}_x"), trajectory, ("x",))
    assert found.deviation[0] == pytest.approx(0.001 * turn**2 / np.sqrt(2), rel=0.1)
    middle = (np.arange(PARTS) + 0.5) / PARTS * trajectory.duration
    wanted = -0.001 * turn**2 * np.sin(turn * middle)
    np.testing.assert_allclose(np.array(series)[2:-2, 0], wanted[2:-2], atol=0.1)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("t,q_x\n0.1,1\n0.2,1\n", "2 samples of the motion; expected 8 or more"),
        ("t,qd_x\n" + "0.1,1\n" * 9, "times that do not rise"),
        ("", "no column t, qdd_x; expected the columns t, qdd_x, or those of qdd, qd or q"),
        ("t,qdd_other\n0.1,1\n", "no column qdd_x"),
        ("t,qdd_x\n", "no samples"),
        ("t,qdd_x\n0.1,fast\n", "a line has a cell that is not a number"),
        ("t,qdd_x\n0.1\n", "a line has a cell that is not a number"),
        ("t,qdd_x\n0.1,nan\n", "not finite"),
        ("t,qdd_x\n-1,1\n100,1\n", "no sample between 0 and"),
        ("t,qdd_x\n0.2,1\n0.1,1\n", "times that do not rise"),
    ],
)
def test_a_bad_log_is_refused(tmp_path, trajectory, text, message):
    (tmp_path / "log.csv").write_text(text)
    with pytest.raises(ValueError, match=message):
        errors_of_log(tmp_path / "log.csv", trajectory, ("x",))


def test_a_bad_log_is_said_and_asked_for_again(tmp_path, planned):
    (tmp_path / "bad.csv").write_text("t\n")
    (tmp_path / "binary.csv").write_bytes(b"t,qdd_x\n\xff\xfe\n")
    good = log(tmp_path / "good.csv", np.array([0.1]), np.array([2.0]))
    names = ["missing.csv", ".", "bad.csv", "binary.csv", "good.csv"]
    person = Person("y", *(str(tmp_path / name) for name in names))
    shown = execute(tmp_path, planned, person).outcome
    assert (shown.errors, shown.error_series) == errors_of_log(good, Trajectory.from_plan(planned.plan), ("x",))
    said = person.told[1:]
    assert len(said) == 4
    assert said[0] == f"{tmp_path}/missing.csv: cannot be read: No such file or directory"
    assert said[2].startswith(f"{tmp_path}/bad.csv: no column qdd_x")


def test_logs_move_the_interval_of_the_error(tmp_path, planned):
    trajectory = Trajectory.from_plan(planned.plan)
    times = np.linspace(0.0, trajectory.duration, 200)
    path = log(tmp_path / "log.csv", times, trajectory.sample(times).qdd[:, 0] + 0.25)
    errors = execute(tmp_path, planned, Person("y", str(path))).outcome.errors
    assert errors.mean[0] == pytest.approx(0.25)
    assert errors.deviation[0] == pytest.approx(0.0, abs=1e-6)
