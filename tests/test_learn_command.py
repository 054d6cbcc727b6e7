"""The command `learn`: what it prints and writes, how it is interrupted and continued, and what bad input leads to."""

import csv
import io
import json
import os
import random
import re
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest
from learning_tasks import remember_plans, task
from rich.console import Console

from robustopt import __version__, report
from robustopt.cli import terminal
from robustopt.config.load import dump, load_config
from robustopt.errors import RunFolderError, SolverFailed
from robustopt.interruption import interruptions, on_interrupt
from robustopt.runs import beliefs, executors, learning_run, learning_table, origin
from robustopt.runs.journal import Journal
from robustopt.runs.records import Iteration
from robustopt.runs.store import JOURNAL, read_summary
from robustopt.simulation import Status

TABLES = ("iterations.csv", "executions.csv", "plan.csv")


@pytest.fixture
def run(run, tmp_path, monkeypatch):
    """Runs a command in a folder with `task.yaml`."""
    remember_plans(monkeypatch)
    (tmp_path / "task.yaml").write_text(dump(task("bisection", trials=5)))
    return run


LEARN = ("learn", "task.yaml", "--no-figures")


def table(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def same(a: Path, b: Path) -> bool:
    return all((a / name).read_bytes() == (b / name).read_bytes() for name in TABLES)


def begun(*arguments: str) -> list[str]:
    """A command of another process."""
    return [sys.executable, "-m", "robustopt", *arguments]


def learned_so_far(folder: Path) -> int:
    """Plans and executions in the journal of a folder, without touching its lock."""
    journal = Journal.open(folder)
    entries = list(journal.entries())
    journal.close()
    return sum(1 + len(entry.executions) for entry in entries)


# A whole run ----------------------------------------------------------------------------------------------


def test_a_task_is_learned_into_a_whole_run_folder(run, tmp_path):
    code, out, err = run("learn", "task.yaml", "--out", "here")
    assert (code, err) == (0, "")
    folder = tmp_path / "here"
    summary, rows = read_summary(folder), table(folder / "iterations.csv")
    assert summary.kind == "learning"
    assert summary.status == "learned"
    assert [row["friction"] for row in rows[:2]] == ["1.0", "0.5"]
    assert summary.learning.plans == len(rows)
    assert summary.duration == min(float(row["duration"]) for row in rows if row["result"] == "success")
    assert float(table(folder / "plan.csv")[-1]["t"]) == pytest.approx(summary.duration)
    told = table(folder / "executions.csv")
    assert [int(row["execution"]) for row in told] == list(range(summary.learning.executions))
    assert (told[0]["status"], told[0]["what"]) == ("slid", "block")
    assert 0 < float(told[0]["t"]) < float(rows[0]["duration"])
    assert rows[0]["fresh_trials"] == "5"
    expected = {"config.yaml", "provenance.json", "plan.csv", "trajectory.csv", "joint_trajectory.json", "figures"}
    expected |= {"summary.json", "report.html", "journal.db", "iterations.csv", "executions.csv"}
    assert {path.name for path in folder.iterdir()} == expected
    figures = {path.name for path in (folder / "figures").iterdir()}
    assert {"learning.svg", "learning.png", "phase_plane.svg", "contacts.svg"} <= figures
    page = (folder / "report.html").read_text()
    assert "Iterations" in page
    assert page.count("data:image/svg+xml") >= 4
    assert "test: learned a plan of" in out
    assert "Rslt" in out
    assert "Files in here" in out


def test_without_a_configuration_it_is_the_papers_task(run, tmp_path):
    quick = ("solver.method=reachability", "solver.collocation_points=30", "learning.trials=5")
    code, out, err = run("learn", *quick, "learning.judged=result", "--K", 0.5, "--no-figures")
    assert (code, err) == (0, "")
    (folder,) = (tmp_path / "results" / "paper-one-block").iterdir()
    config = load_config(folder / "config.yaml")
    assert config.learning is not None
    assert (config.learning.algorithm, config.learning.K) == ("ilrobs", 0.5)
    rows = table(folder / "iterations.csv")
    assert rows[0]["friction"] == "1.0"
    assert rows[-1]["result"] == "not executed"
    accepted = [row for row in rows if row["result"] == "success"]
    assert {row["executions"] for row in accepted} == {"4"}
    assert "4 successes in a row show" in " ".join(out.split())


def test_options_are_short_for_keys(run, tmp_path):
    code, _, err = run(
        *LEARN, "--algorithm", "ilrobs", "--K", 0.5, "--seed", 3, "learning.delta=0.3", "--out", "a", "-q"
    )
    assert (code, err) == (0, "")
    config = load_config(tmp_path / "a" / "config.yaml")
    assert config.learning is not None
    assert (config.learning.algorithm, config.learning.K, config.learning.delta) == ("ilrobs", 0.5, 0.3)
    assert config.seed == 3


def test_json_and_quiet(run):
    code, out, err = run(*LEARN, "--out", "a", "--json")
    data = json.loads(out)
    assert (code, err, data["status"], data["folder"]) == (0, "", "learned", "a")
    assert data["learning"]["rows"][0]["friction"] == 1.0
    assert run(*LEARN, "--out", "b", "--quiet") == (0, "", "")


def test_the_same_seed_gives_the_same_files(run, tmp_path):
    for name in ("a", "b"):
        assert run(*LEARN, "--out", name, "-q")[0] == 0
    assert same(tmp_path / "a", tmp_path / "b")
    assert run(*LEARN, "--seed", 1, "--out", "c", "-q")[0] == 0
    first = [read_summary(tmp_path / name).learning.rows[0].error_mean for name in "abc"]
    assert first[0] == first[1] != first[2]


def test_nothing_succeeds(run, tmp_path):
    code, _, err = run(*LEARN, "learning.friction=[0.8, 1]", "--out", "a", "-q")
    assert code == 3
    assert err.startswith("test: no success: No plan ")
    assert not (tmp_path / "a" / "plan.csv").exists()
    assert read_summary(tmp_path / "a").duration is None
    code, _, err = run("execute", "a", "-q")
    assert code == 2
    assert "the run has no plan (no success)" in err
    assert run(*LEARN, "learning.friction=[0.8, 1]", "--resume", "--out", "a", "-q")[0] == 3


def test_every_simulation_diverged(run, tmp_path, monkeypatch):
    execute = executors.execute

    def diverging(*arguments, **options):
        executions = execute(*arguments, **options)
        return replace(executions, outcomes=tuple(replace(o, status=Status.DIVERGED) for o in executions.outcomes))

    monkeypatch.setattr(executors, "execute", diverging)
    assert run(*LEARN, "--out", "a", "-q")[0] == 5
    assert read_summary(tmp_path / "a").status == "simulation failed"
    assert run("learn", "--resume", "--out", "a", "-q")[0] == 5


# Stored runs ----------------------------------------------------------------------------------------------


def test_a_learned_run_is_reported_and_its_plan_executed(run, tmp_path):
    assert run(*LEARN, "--out", "a", "-q")[0] == 0
    code, out, _ = run("report", "a")
    assert code == 0
    assert "bisection" in out
    assert "Rslt" in out
    code, out, _ = run("execute", "a", "--trials", 5, "--out", "b", "--no-figures", "--json")
    assert code == 0
    executed = json.loads(out)
    assert executed["duration"] == read_summary(tmp_path / "a").duration
    assert executed["success_rate"] == 1.0


def test_a_plan_that_a_learner_made_on_a_finer_grid_is_executed(run, tmp_path, monkeypatch):
    monkeypatch.setattr(beliefs, "FINER_GRIDS", (2,))
    own = "solver.collocation_points=15"  # a configuration of no other test, whose plans are remembered
    assert run(*LEARN, own, "--out", "a", "-q")[0] == 0
    assert read_summary(tmp_path / "a").size.collocation_points == 30
    code, out, err = run("execute", "a", "--trials", 2, "--out", "b", "--no-figures", "--json")
    assert (code, err) == (0, "")
    assert json.loads(out)["duration"] == read_summary(tmp_path / "a").duration
    assert run("execute", "b", "--trials", 2, "--out", "c", "--no-figures", "-q")[0] == 0


def test_runs_are_listed_with_their_state(run, tmp_path, interrupted):
    assert run("runs") == (0, "no runs in results\n", "")
    assert run(*LEARN, "-q")[0] == 0
    interrupted("results/test/unfinished")
    (tmp_path / "results" / "broken").mkdir()
    (tmp_path / "results" / "broken" / "provenance.json").write_text("{")
    torn = tmp_path / "results" / "torn"
    interrupted("results/torn")
    (torn / JOURNAL).write_bytes(b"x" * 5000)
    held = Journal.open(tmp_path / "results" / "test" / "unfinished")
    states = {}
    for state in ("running", "resumable"):
        code, out, _ = run("runs", "--json")
        assert code == 0
        records = {record["folder"]: record for record in json.loads(out)["runs"]}
        states[state] = records["results/test/unfinished"]["state"]
        held.close()
    assert states == {"running": "running", "resumable": "resumable"}
    assert records["results/broken"]["state"] == records["results/torn"]["state"] == "damaged"
    (complete,) = (record for record in records.values() if record["state"] == "complete")
    assert (complete["kind"], complete["status"], complete["name"]) == ("learning", "learned", "test")
    name = "a-folder-that-is-wider-than-a-terminal-of-80-columns-and-must-be-copied-in-one-piece"
    (tmp_path / complete["folder"]).rename(tmp_path / "results" / name)
    code, out, _ = run("runs")
    assert code == 0
    assert "resumable" in out
    assert "learned" in out
    assert f"results/{name}" in out


def test_runs_are_found_above_the_current_folder(run, tmp_path, monkeypatch):
    assert run(*LEARN, "-q")[0] == 0
    (tmp_path / ".deep").mkdir()
    monkeypatch.chdir(tmp_path / ".deep")
    assert "complete" in run("runs", "..")[1]


# Interrupted and continued --------------------------------------------------------------------------------


@pytest.fixture
def interrupted(run, monkeypatch):
    """Interrupts a run in the place of its k-th call of the simulation."""

    def call(out: str, after: int = 2, *arguments: str) -> tuple[int, str, str]:
        simulate, calls = executors.Simulated.run, 0

        def stopping(*values):
            nonlocal calls
            calls += 1
            if calls > after:
                raise KeyboardInterrupt
            return simulate(*values)

        with monkeypatch.context() as patch:
            patch.setattr(executors.Simulated, "run", stopping)
            return run(*LEARN, "--out", out, *arguments)

    return call


def test_an_interruption_that_something_swallows_ends_learning_soon(run, tmp_path, monkeypatch):
    simulate, calls = executors.Simulated.run, 0

    def swallowing(*values):
        nonlocal calls
        calls += 1
        with pytest.raises(KeyboardInterrupt):
            on_interrupt(signal.SIGINT, None)
        return simulate(*values)

    monkeypatch.setattr(executors.Simulated, "run", swallowing)
    try:
        code, _, err = run(*LEARN, "--out", "a")
    finally:
        interruptions.clear()
    assert (code, calls) == (130, 1)
    assert "all executions so far are kept" in err


def test_an_interrupted_run_says_how_to_go_on_and_ends_the_same(run, tmp_path, interrupted):
    assert run(*LEARN, "--out", "whole", "-q")[0] == 0
    code, out, err = interrupted("parts")
    assert (code, out) == (130, "")
    assert err == "error: interrupted; all executions so far are kept: robustopt learn --resume --out parts\n"
    assert not (tmp_path / "parts" / "summary.json").exists()
    for command in ("report", "execute"):
        code, _, err = run(command, "parts")
        assert (code, err) == (
            2,
            "error: parts: unfinished; expected a complete run: robustopt learn --resume --out parts\n",
        )
    code, _, err = run(*LEARN, "--out", "parts")
    assert code == 2
    assert "holds an unfinished run; continue it with --resume" in err
    assert run("learn", "--resume", "--out", "parts", "--no-figures", "-q") == (0, "", "")
    assert same(tmp_path / "whole", tmp_path / "parts")


def test_an_interruption_in_json(interrupted):
    code, out, err = interrupted("parts", 2, "--json")
    assert (code, err) == (130, "")
    assert json.loads(out)["error"]["kind"] == "Interrupted"


def test_a_complete_run_is_shown_and_stays_as_it_is(run, tmp_path):
    assert run(*LEARN, "--out", "a", "-q")[0] == 0
    before = {path: path.stat().st_mtime_ns for path in (tmp_path / "a").iterdir()}
    for arguments in (("learn",), LEARN):
        code, out, err = run(*arguments, "--resume", "--out", "a")
        assert (code, err) == (0, "")
        assert "test: learned a plan of" in out
    assert {path: path.stat().st_mtime_ns for path in (tmp_path / "a").iterdir()} == before


def test_the_latest_unfinished_run_of_the_same_configuration_is_continued(run, tmp_path, interrupted):
    for name, *changes in (("first",), ("second", "learning.delta=0.3"), ("third", "learning.delta=0.2")):
        interrupted(f"results/test/{name}", 2, *changes)
    code, out, _ = run(*LEARN, "--resume", "--json", "learning.delta=0.3")
    assert (code, json.loads(out)["folder"]) == (0, "results/test/second")
    code, out, _ = run(*LEARN, "--resume", "--json")
    assert (code, json.loads(out)["folder"]) == (0, "results/test/first")
    code, _, err = run(*LEARN, "--resume", "learning.delta=0.1")
    assert code == 2
    assert "results/test/third: was begun with another configuration: learning.delta was 0.2 and is 0.1" in err


def test_resume_begins_where_there_is_nothing_to_resume(run, tmp_path):
    assert run(*LEARN, "--resume", "--out", "new", "-q")[0] == 0
    assert run(*LEARN, "--resume", "-q")[0] == 0
    assert len(list((tmp_path / "results" / "test").iterdir())) == 1


def test_a_changed_configuration_is_refused_with_the_difference(run, interrupted):
    interrupted("a")
    changes = ("--seed", 4, "solver.collocation_points=30", "uncertainty.friction=[0.9, 1.1]", "learning.K_values=[0]")
    code, out, err = run(*LEARN, "--resume", "--out", "a", *changes)
    assert (code, out) == (2, "")
    for difference in (
        "seed was 0 and is 4",
        "solver.collocation_points was 20 and is 30",
        "uncertainty.friction was not given and is [0.9, 1.1]",
        "learning.K_values was [0.0, 1.0] and is [0.0]",
    ):
        assert difference in err
    assert err.startswith("error: a: was begun with another configuration: ")
    assert err.endswith("Expected the same one, or a new run\n")


def test_keys_without_a_file_are_those_of_the_run_that_is_resumed(run, interrupted):
    interrupted("a")
    code, _, err = run("learn", "--resume", "--out", "a", "--seed", "4")
    assert code == 2
    assert err == (
        "error: a: was begun with another configuration: seed was 0 and is 4. Expected the same one, or a new run\n"
    )
    assert run("learn", "--resume", "--out", "a", "--seed", "0", "--no-figures")[0] == 0


def test_files_that_were_changed_are_refused(run, tmp_path, interrupted):
    interrupted("a")
    config, provenance = tmp_path / "a" / "config.yaml", tmp_path / "a" / "provenance.json"
    text, known = config.read_text(), provenance.read_text()
    config.write_text(text + "\n")
    assert "a: config.yaml has changed since the run was begun" in run("learn", "--resume", "--out", "a")[2]
    config.write_text(text)
    provenance.write_text(known.replace(json.loads(known)["robot_model"]["sha256"], "0" * 64))
    assert "or one that it names, has changed since the run was begun" in run("learn", "--resume", "--out", "a")[2]
    provenance.write_text("{}")
    assert "a/provenance.json: cannot be read: it has been changed" in run("learn", "--resume", "--out", "a")[2]
    provenance.write_text(known)
    config.unlink()
    assert "a/config.yaml: cannot be read: No such file or directory" in run("learn", "--resume", "--out", "a")[2]
    config.write_text(text)
    assert run("learn", "--resume", "--out", "a", "--no-figures", "-q")[0] == 0


def test_waypoints_that_were_changed_are_refused_even_where_no_plan_shows_it(run, tmp_path, interrupted):
    (tmp_path / "way.csv").write_text("0.0\n1.0\n")
    task_file = tmp_path / "task.yaml"
    task_file.write_text(re.sub(r"joints:\n( +- .*\n)+", f"joints: {tmp_path / 'way.csv'}\n", task_file.read_text()))
    interrupted("a")
    resume, refused = (
        ("learn", "--resume", "--out", "a", "--no-figures"),
        f"a: the waypoints {tmp_path / 'way.csv'} have",
    )
    (tmp_path / "way.csv").write_text("0.0\n1.0000001\n")
    assert run(*resume) == (
        2,
        "",
        f"error: {refused} changed since the run was begun; expected no change, or a new run\n",
    )
    (tmp_path / "way.csv").unlink()
    assert refused in run(*resume)[2]
    (tmp_path / "way.csv").write_text("0.0\n1.0\n")
    assert run(*resume)[0] == 0


@pytest.mark.parametrize("name", ["config.yaml", "provenance.json"])
def test_a_run_is_not_complete_without_what_it_was_begun_with(run, tmp_path, monkeypatch, name):
    def removing(*values):
        (tmp_path / "a" / name).unlink(missing_ok=True)
        return simulate(*values)

    simulate = executors.Simulated.run
    monkeypatch.setattr(executors.Simulated, "run", removing)
    code, out, err = run(*LEARN, "--out", "a")
    assert (code, out) == (2, "")
    assert err.startswith(f"error: a: the run could not be completed: {name} removed while the run was at work")
    assert not (tmp_path / "a" / "summary.json").exists()


def test_executions_of_other_versions_are_refused_unless_a_person_makes_them(run, tmp_path, interrupted, monkeypatch):
    interrupted("a")
    before = learned_so_far(tmp_path / "a")
    monkeypatch.setattr(origin, "versions", lambda: {"robustopt": __version__, "mujoco": "99.0"})
    code, out, err = run("learn", "--resume", "--out", "a")
    assert (code, out) == (2, "")
    assert err.startswith("error: a: was begun with other versions: mujoco was ")
    assert err.endswith(" and is 99.0. Expected the same ones, or a new run\n")
    assert learned_so_far(tmp_path / "a") == before
    assert "begun with other versions" not in run("learn", "task.yaml", "--executor", "manual", "--out", "b")[2]


def test_a_damaged_journal_is_refused(run, tmp_path, interrupted):
    interrupted("a")
    (tmp_path / "a" / JOURNAL).write_bytes(b"x" * 5000)
    code, _, err = run("learn", "--resume", "--out", "a")
    assert code == 2
    assert "not a journal of robustopt, or damaged" in err
    assert (tmp_path / "a" / JOURNAL).read_bytes() == b"x" * 5000


@pytest.mark.parametrize("fails", [OSError(28, "No space left on device"), KeyboardInterrupt()])
@pytest.mark.parametrize("where", ["write_page", "complete"])
def test_what_was_half_written_at_the_end_is_written_anew(run, tmp_path, monkeypatch, fails, where):
    def failing(*_):
        raise fails

    assert run(*LEARN, "--out", "whole", "-q")[0] == 0
    with monkeypatch.context() as patch:
        patch.setattr(report if where == "write_page" else learning_run, where, failing)
        code, _, err = run("learn", "task.yaml", "--out", "a")
    if isinstance(fails, OSError):
        assert code == 2
        assert err == (
            "error: a: the run could not be completed: No space left on device; it can be continued by --resume\n"
        )
    else:
        assert code == 130
    (tmp_path / "a" / "figures" / "phase_plane.svg").write_text("half")
    (tmp_path / "a" / "iterations.csv").write_text("half")
    (tmp_path / "a" / ".partial-summary.json").write_text("{")
    assert run("learn", "--resume", "--out", "a", "--no-figures", "-q") == (0, "", "")
    assert same(tmp_path / "whole", tmp_path / "a")
    assert {path.name for path in (tmp_path / "a").iterdir()} == {path.name for path in (tmp_path / "whole").iterdir()}


# Two processes, signals -----------------------------------------------------------------------------------


def wait_for(folder: Path, process: subprocess.Popen) -> None:
    """Wait until a run has something in its journal."""
    for _ in range(1200):
        if (folder / JOURNAL).is_file() and (folder / JOURNAL).stat().st_size > 40_000:
            return
        assert process.poll() is None, process.communicate()
        time.sleep(0.05)
    raise AssertionError("nothing was learned")


@pytest.fixture
def long_run(run, tmp_path):
    """A run that takes for ever, in a process group of its own."""
    processes = []

    def start(workers: int = 1) -> subprocess.Popen:
        options = ("learning.trials=1000000", "--workers", str(workers), "--out", "a")
        process = subprocess.Popen(
            begun(*LEARN, *options), cwd=tmp_path, start_new_session=True, stdout=subprocess.PIPE,
            stderr=subprocess.PIPE, text=True,
        )  # fmt: skip
        processes.append(process)
        wait_for(tmp_path / "a", process)
        return process

    yield start
    for process in processes:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
        process.communicate()


def test_a_second_process_is_refused(run, tmp_path, long_run):
    process = long_run()
    code, out, err = run("learn", "--resume", "--out", "a")
    assert (code, out) == (2, "")
    assert err == "error: a: another process is at work on this run; expected to be the only one\n"
    assert process.poll() is None
    assert "running" in run("runs", ".")[1]


@pytest.mark.parametrize("workers", [pytest.param(1, marks=pytest.mark.slow), 2])
def test_ctrl_c_in_a_terminal_keeps_what_was_learned(tmp_path, long_run, workers):
    process = long_run(workers)
    os.killpg(process.pid, signal.SIGINT)  # as a terminal does: all processes of the group
    out, err = process.communicate(timeout=120)
    assert process.returncode == 130
    assert out == ""
    assert err == "error: interrupted; all executions so far are kept: robustopt learn --resume --out a\n"
    assert learned_so_far(tmp_path / "a") >= 1


def test_a_person_who_watches_sees_that_the_first_plans_are_made(monkeypatch):
    class Terminal(io.StringIO):
        def isatty(self):
            return True

    watched = Terminal()
    monkeypatch.setattr(sys, "stderr", watched)
    with terminal.learning_table(silent=False):
        pass
    assert "planning" in watched.getvalue()


@pytest.mark.parametrize("count", [2, 5])
def test_many_parameters_fit_into_a_terminal(count):
    keys = ["contact.friction.lower", "contact.friction.upper", "objects.upper.mass", "tray.mass", "seed"][:count]
    row = {"duration": 3.2345, "result": "success", "incumbent": 3.301, "lower_bound": 3.102, "executions": 1}
    fresh = {"successes": 1, "success_rate": 1.0, "success_low": 0.963, "success_high": 1.0}
    rows = [Iteration(iteration=12, parameters=dict.fromkeys(keys, 0.4444), **row, **fresh)]
    shown = io.StringIO()
    Console(file=shown, width=80).print(report.iterations_table(rows))
    text = shown.getvalue()
    assert text.count("0.444") == count
    assert all(cell in text for cell in ("12", "3.235", "3.301", "3.102", "1/1", "100 % (96-100)"))
    heads, _ = learning_table.table(rows)
    assert heads[1 : count + 1] == (["lower", "upper"] if count == 2 else ["p1", "p2", "p3", "p4", "p5"])
    assert all(f"p{i}: {key};" in learning_table.legend(rows) for i, key in enumerate(keys, 1)) == (count == 5)


@pytest.mark.parametrize("width", [40, 80])
def test_no_cell_of_the_iterations_is_cut(width):
    """At 80 columns 7/7 was shown as 7/ beside acceleration errors, an interval and fresh executions."""
    row = {"iteration": 6, "friction": 0.09375, "planned_half_width": [1.4], "duration": 2.313, "executions": 7}
    row |= {"friction_high": 0.09375, "friction_low": 0.0625, "successes": 7, "bad_luck": 0.12, "success_rate": 1.0}
    row |= {"result": "not executed", "success_low": 0.69, "success_high": 1.0}
    shown = io.StringIO()
    console = Console(file=shown, width=width)
    report.print_whole(report.iterations_table([Iteration(**row)]), console)
    assert console.width == width
    for cell in learning_table.table([Iteration(**row)])[1][0]:
        assert cell in shown.getvalue()


def test_the_legend_says_what_is_shown():
    rows = [Iteration(iteration=1, friction=0.5, duration=1.0, result="success", incumbent=1.0)]
    assert learning_table.legend(rows).startswith("Rslt: S success")
    assert "best: shortest plan" in learning_table.legend(rows)
    assert "Spdup" not in learning_table.legend(rows)


def test_without_an_iteration_there_is_no_table(run, tmp_path):
    """On a tray that leans by 0.1 rad nothing stands with a friction of 0.02: there is nothing to execute."""
    parameters = "learning.parameters=[{key: contact.friction.block, optimistic: 0.02, conservative: 0.01}]"
    tilted = "gravity=[1, 0, -9.7]"
    code, out, _ = run(*LEARN, "--algorithm", "bnb-midpoint", parameters, tilted, "--out", "a")
    assert code == 3
    assert "There is no plan, even for the most optimistic belief." in " ".join(out.split())
    assert "\n.\n" not in out
    assert "Iterations" not in (tmp_path / "a" / "report.html").read_text()


def test_it_says_so_where_the_most_conservative_parameters_fail(run, tmp_path):
    """They shall not; how likely bad luck was is no question of theirs."""
    parameters = "learning.parameters=[{key: contact.friction.block, optimistic: 1, conservative: 0.7}]"
    few = ("learning.budget=3", "learning.executions_per_plan=1")
    code, _, err = run(*LEARN, "--algorithm", "bnb-midpoint", parameters, *few, "--out", "a", "-q")
    assert code == 3
    assert "Even the conservative values of all parameters failed" in err
    assert "bad_luck" not in table(tmp_path / "a" / "iterations.csv")[-1]


@pytest.mark.slow
def test_it_says_so_where_one_success_says_little(run):
    """True friction varies about what the best plan needs; so do its fresh executions."""
    parameters = "learning.parameters=[{key: contact.friction.block, optimistic: 0.6, conservative: 0.2}]"
    varying = ("execution.truth.variation.friction=0.1", "learning.budget=6", "learning.trials=40")
    told = {}
    for times in (1, 2):
        asked = f"learning.executions_per_plan={times}"
        code, out, _ = run(*LEARN, "--algorithm", "bnb-midpoint", parameters, *varying, asked, "--out", f"a{times}")
        assert code == 0
        told[times] = "learning.executions_per_plan=7 asks for a rate of about 0.86" in " ".join(out.split())
    assert told == {1: True, 2: False}


# Bad input ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("missing.yaml",), "missing.yaml"),
        (("task.yaml", "--algorithm", "magic"), "learning.algorithm"),
        (
            ("task.yaml", "learning.friction=[0.5, 0.2]"),
            "expected the lowest value first: [0.2, 0.5]",
        ),
        (("task.yaml", "learning.nonsense=1"), "learning.nonsense"),
        (("task.yaml", "objects={}"), "objects: found no objects; expected at least one"),
        (("task.yaml", "robot.tool=hook"), "robot.tool"),
        (("task.yaml", "path.joints=[[0],[0]]"), "path.joints"),
        (("task.yaml", "--K", "9"), "--K"),
        (("task.yaml", "--executor", "magic"), "--executor"),
        (("task.yaml", "--workers", "0"), "--workers"),
        (("task.yaml", "--resume", "--out", "full"), "full: nothing to resume; expected the folder of a run"),
        (("--resume", "--out", "nowhere"), "nowhere: no run to resume; expected the folder of a run"),
        (("task.yaml", "--out", "full"), "full: is not empty; expected a new folder"),
        (("task.yaml", "--out", "task.yaml"), "task.yaml: is a file"),
    ],
)
@pytest.mark.parametrize("json_too", [False, True])
def test_bad_input_is_one_error_and_leaves_nothing_behind(run, tmp_path, arguments, message, json_too):
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "notes.txt").write_text("keep")
    code, out, err = run("learn", *arguments, *(["--json"] if json_too else []))
    assert code == 2
    told = json.loads(out)["error"]["message"] if json_too else err
    assert message in told
    assert sorted(path.name for path in tmp_path.rglob("*")) == ["full", "notes.txt", "task.yaml"]


def test_an_error_before_anything_is_learned_leaves_nothing_behind(run, tmp_path, monkeypatch):
    def failing(*_):
        raise SolverFailed("no plan")

    monkeypatch.setattr(beliefs.Planner, "_make", failing)
    assert run("learn", "task.yaml")[0] == 4
    assert [path.name for path in tmp_path.iterdir()] == ["task.yaml"]
    (tmp_path / "mine").mkdir()
    assert run("learn", "task.yaml", "--out", "mine/a")[0] == 4
    assert [path.name for path in tmp_path.rglob("mine*")] == ["mine"]


def test_an_error_later_keeps_what_was_learned(run, tmp_path, interrupted, monkeypatch):
    interrupted("a")
    known = learned_so_far(tmp_path / "a")

    def failing(*_):
        raise RunFolderError("disk gone")

    with monkeypatch.context() as patch:
        patch.setattr(Journal, "_write", failing)
        assert run("learn", "--resume", "--out", "a")[0] == 2
    assert learned_so_far(tmp_path / "a") == known > 0


def test_an_unfinished_run_with_nothing_in_it_is_kept_when_resuming_fails(run, tmp_path, interrupted):
    interrupted("a", 0)
    (tmp_path / "a" / "notes.txt").write_text("keep")
    assert run(*LEARN, "--resume", "--out", "a", "--executor", "manual")[0] == 2
    assert (tmp_path / "a" / "notes.txt").is_file()


def test_help_names_the_commands(run):
    _, out, _ = run("--help")
    assert "learn" in out
    assert "runs" in out
    assert "--resume" in run("learn", "--help")[1]


# Killed at any moment -------------------------------------------------------------------------------------


@pytest.fixture
def small(tmp_path) -> tuple[str, ...]:
    """A task of some seconds, half of them executions."""
    (tmp_path / "task.yaml").write_text(dump(task("ilrobs", trials=60)))
    return ("learn", "task.yaml", "--no-figures", "--quiet")


@pytest.mark.slow
def test_killed_at_30_random_moments_it_writes_the_same_tables(tmp_path, small):
    """Each kill falls into a run of its own or into one that was killed before, and into any part of its work."""
    start = time.monotonic()
    subprocess.run(begun(*small, "--out", "whole"), cwd=tmp_path, check=True)
    whole = time.monotonic() - start
    moments, folder, kills, compared = random.Random(5), None, 0, 0
    while kills < 30 or folder is not None:
        name = folder or f"run{kills}"
        command = begun(*small, "--resume", "--out", name)
        with subprocess.Popen(
            command, cwd=tmp_path, start_new_session=True, stderr=subprocess.PIPE, text=True
        ) as process:
            try:
                _, err = process.communicate(timeout=moments.uniform(0.0, 1.1 * whole) if kills < 30 else None)
                assert process.returncode == 0, err
                assert same(tmp_path / "whole", tmp_path / name)
                assert not list(tmp_path.glob(".*"))
                compared, folder = compared + 1, None
            except subprocess.TimeoutExpired:
                os.killpg(process.pid, signal.SIGKILL)
                kills, folder = kills + 1, name
    assert compared >= 3


@pytest.mark.slow
def test_any_number_of_workers_writes_the_same_tables(tmp_path, small):
    for workers in ("1", "2"):
        command = begun(*small, "--K", "2", "--workers", workers, "--out", workers)
        subprocess.run(command, cwd=tmp_path, check=True)
    assert same(tmp_path / "1", tmp_path / "2")
