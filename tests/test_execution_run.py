"""The command `execute`: what it prints and writes, for a task and for a stored run, and what bad input leads to."""

import csv
import json
import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scenes import CONFIGS

from robustopt import cli
from robustopt.config.execution_model import VariationConfig
from robustopt.config.load import load_config
from robustopt.robot.model_file import resolve_package
from robustopt.runs import execution_run
from robustopt.runs.store import read_summary
from robustopt.runs.stored_plan import read_plan
from robustopt.simulation import execute
from robustopt.simulation.video import HEIGHT, STRIP, WIDTH, write_film
from robustopt.solvers import solve

SHIPPED = sorted(CONFIGS.glob("*.yaml"))
LONG = ("humanoid_rail", "humanoid_tray", "waiter_side_by_side")
"""Configurations whose trials take several seconds."""
WAITER = CONFIGS / "waiter_one_block.yaml"
QUICK = ("solver.method=reachability", "solver.collocation_points=80", "uncertainty={}", "--no-figures")
TRUTH = (
    "execution.truth={friction: 0.5, variation: {friction: 0.1}}",
    "execution.disturbance.force_deviation=[2, 2, 0]",
)


def table(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


# A task ---------------------------------------------------------------------------------------------------


def test_a_task_is_planned_and_executed_into_a_whole_run_folder(run, tmp_path):
    code, out, err = run(
        "execute", WAITER, *QUICK, *TRUTH, "--trials", 12, "--seed", 3, "--speed", 1.02, "--out", "here"
    )
    assert (code, err) == (0, "")
    summary, rows = read_summary(tmp_path / "here"), table(tmp_path / "here" / "executions.csv")
    assert [int(row["trial"]) for row in rows] == list(range(12))
    successes = sum(row["status"] == "success" for row in rows)
    assert 0 < successes < 12
    assert summary.success_rate == successes / 12
    low, high = summary.success_interval
    assert 0 < low < summary.success_rate < high < 1
    told = summary.executions
    assert (told.trials, told.requested, told.successes) == (12, 12, successes)
    assert (told.seed, told.speed, told.confidence) == (3, 1.02, 0.95)
    assert told.duration == pytest.approx(summary.duration / 1.02)
    assert told.statuses["slid"] == 12 - successes
    assert len(told.feedback.deviation) == 6
    assert f"{successes} of 12 trials succeeded" in out
    assert "slid" in out
    assert "Executions" in (tmp_path / "here" / "report.html").read_text()
    assert summary.certificate.passed is True
    assert {"plan.csv", "config.yaml", "provenance.json"} <= {path.name for path in (tmp_path / "here").iterdir()}
    frictions = [float(row["friction_block"]) for row in rows]
    slid = [friction for friction, row in zip(frictions, rows, strict=True) if row["status"] == "slid"]
    assert max(slid) < max(frictions)
    failed = next(row for row in rows if row["status"] == "slid")
    assert 0 < float(failed["t"]) < told.duration
    assert 0 < float(failed["s"]) < 1
    assert float(failed["slip_block"]) > 0.005


def test_the_figures_show_a_failing_trial_beside_a_succeeding_one(run, tmp_path, stored):
    assert run("execute", stored, "--trials", 12, "--seed", 3, "--out", "a", "--quiet")[0] == 0
    assert {"trials.svg", "accelerations.png"} <= {path.name for path in (tmp_path / "a" / "figures").iterdir()}
    drawn = (tmp_path / "a" / "figures" / "trials.svg").read_text()
    assert "success" in drawn
    assert "slid (block)" in drawn
    assert (tmp_path / "a" / "report.html").read_text().count("data:image/svg+xml") == 2
    assert run("execute", "a", "--out", "b", "--quiet")[0] == 0
    for name in ("trials.svg", "accelerations.svg"):
        assert (tmp_path / "a" / "figures" / name).read_bytes() == (tmp_path / "b" / "figures" / name).read_bytes()


@pytest.mark.slow
def test_a_video_is_a_film_and_a_strip_of_both_trials(tmp_path, stored):
    """In a process of its own, because MuJoCo chooses how it draws when it is imported."""
    command = [
        sys.executable,
        "-m",
        "robustopt",
        "execute",
        str(stored),
        "--trials",
        "12",
        "--seed",
        "3",
        "--video",
    ]
    environment = {key: value for key, value in os.environ.items() if key != "DISPLAY"}
    done = subprocess.run([*command, "--no-figures", "--out", "a"], cwd=tmp_path, env=environment, capture_output=True)
    if b"set MUJOCO_GL" in done.stderr:
        pytest.skip("this machine has no EGL to draw with")
    assert (done.returncode, done.stderr) == (0, b"")
    written = {path.name: path for path in (tmp_path / "a" / "figures").iterdir()}
    assert written.keys() in ({"trials.webp", "trials_strip.png"}, {"trials.mp4", "trials_strip.png"})
    picture = np.asarray(Image.open(written["trials_strip.png"]))
    assert picture.shape == (STRIP * HEIGHT, 2 * WIDTH, 3)
    frames = picture.reshape(STRIP, HEIGHT, 2, WIDTH, 3).astype(float)
    assert frames.std(axis=(1, 3)).min() > 5.0
    assert np.abs(frames[0, :, 0] - frames[-1, :, 0]).max() > 50
    apart = np.abs(frames[:, :, 0] - frames[:, :, 1]).mean(axis=(1, 2, 3))
    assert 2 * apart[0] < apart[-1]


def _moving_square() -> list[np.ndarray]:
    """Twelve frames in which a light square goes from left to right over a dark ground."""
    frames = np.full((12, 64, 160, 3), 20, dtype=np.uint8)
    for k, frame in enumerate(frames):
        frame[16:48, 10 * k : 10 * k + 32] = (230, 120, 40)
    return list(frames)


def test_with_ffmpeg_a_film_is_an_mp4_that_shows_the_frames(tmp_path):
    ffmpeg = shutil.which("ffmpeg")
    if ffmpeg is None:
        pytest.skip("this machine has no ffmpeg")
    frames = _moving_square()
    film, strip = write_film(frames, tmp_path)
    assert (film.name, strip.name) == ("trials.mp4", "trials_strip.png")
    raw = [ffmpeg, "-loglevel", "error", "-i", str(film), "-f", "rawvideo", "-pix_fmt", "rgb24", "-"]
    shown = np.frombuffer(subprocess.run(raw, capture_output=True, check=True).stdout, dtype=np.uint8)
    assert np.abs(shown.reshape(12, 64, 160, 3).astype(float) - frames).mean() < 8.0


@pytest.mark.parametrize("ffmpeg", ["absent", "broken"])
def test_without_an_ffmpeg_that_works_a_film_is_an_animated_webp(tmp_path, monkeypatch, ffmpeg):
    monkeypatch.setenv("PATH", str(tmp_path))
    if ffmpeg == "broken":
        (tmp_path / "ffmpeg").write_text("#!/bin/sh\nexit 1\n")
        (tmp_path / "ffmpeg").chmod(0o755)
    frames = _moving_square()
    film, _ = write_film(frames, tmp_path / "figures")
    assert sorted(path.name for path in (tmp_path / "figures").iterdir()) == ["trials.webp", "trials_strip.png"]
    with Image.open(film) as picture:
        assert picture.n_frames == 12
        for k in (0, 11):
            picture.seek(k)
            assert np.abs(np.asarray(picture.convert("RGB")).astype(float) - frames[k]).mean() < 8.0


def test_the_file_has_the_outcomes_number_for_number(run, tmp_path):
    assert run("execute", WAITER, *QUICK, *TRUTH, "--trials", 3, "--out", "here", "--quiet")[0] == 0
    config = load_config(tmp_path / "here" / "config.yaml")
    executions = execute(read_plan(config, tmp_path / "here" / "plan.csv"), config)
    for row, outcome in zip(table(tmp_path / "here" / "executions.csv"), executions.outcomes, strict=True):
        assert float(row["slip_block"]) == outcome.objects["block"].slip
        assert float(row["tracking_error"]) == outcome.tracking_error
        assert float(row["friction_block"]) == outcome.friction["block"]
        assert (row["status"], row["what"]) == (outcome.status.value, outcome.what)
        assert row["t"] == ("" if outcome.success else repr(outcome.time))


@pytest.mark.parametrize(
    "file",
    [pytest.param(file, id=file.stem, marks=pytest.mark.slow if file.stem in LONG else ()) for file in SHIPPED],
)
def test_every_shipped_configuration_executes(run, tmp_path, file):
    config = load_config(file)
    if config.robot.model.startswith("package://") and resolve_package(config.robot.model) is None:
        pytest.skip("needs the optional package example-robot-data: pip install robustopt[robots]")
    assert config.execution is not None
    varied = config.execution.truth.variation != VariationConfig()
    assert varied or any(config.execution.disturbance.force_deviation)
    small = ("solver.method=reachability", "--no-figures")
    code, _, err = run("execute", file, *small, "--trials", 2, "--speed", 0.9, "--out", "here", "--quiet")
    assert (code, err) == (0, "")
    assert read_summary(tmp_path / "here").executions.statuses == {"success": 2}


def test_an_infeasible_task_is_not_executed(run, tmp_path):
    code, _, err = run(
        "execute", WAITER, *QUICK, "contact.friction=0.2", "gravity=[3, 0, -9.81]", "--out", "x", "--quiet"
    )
    assert code == 3
    assert "infeasible" in err
    assert not (tmp_path / "x" / "executions.csv").exists()


# A stored run ---------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def stored(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("runs") / "planned"
    assert cli.run(["plan", str(WAITER), *QUICK, *TRUTH, "execution.trials=30", "--out", str(folder), "--quiet"]) == 0
    return folder


def test_a_stored_plan_reads_back_number_for_number(stored):
    config = load_config(stored / "config.yaml")
    plan = read_plan(config, stored / "plan.csv")
    made = solve(plan.problem)
    assert np.array_equal(np.sqrt(plan.x), np.sqrt(np.maximum(made.x, 0)))
    assert plan.duration == pytest.approx(made.duration, rel=1e-12)


def test_a_stored_plan_and_its_task_have_the_same_executions(run, tmp_path, stored):
    assert run("execute", stored, "--no-figures", "--out", "a", "--quiet") == (0, "", "")
    assert run("execute", WAITER, *QUICK, *TRUTH, "execution.trials=30", "--out", "b", "--quiet") == (0, "", "")
    for name in ("executions.csv", "plan.csv"):
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()
    first, second = (read_summary(tmp_path / name) for name in "ab")
    assert first.executions == second.executions
    assert first.plan_of == str(stored)


@pytest.mark.slow
def test_more_workers_and_a_run_of_a_run_change_no_byte(run, tmp_path, stored, monkeypatch):
    from robustopt.simulation import monte_carlo

    monkeypatch.setattr(monte_carlo, "cores", lambda: 2)
    assert run("execute", stored, "--out", "a", "--quiet")[0] == 0
    assert run("execute", "a", "--out", "b", "--workers", 2, "--quiet")[0] == 0
    assert (tmp_path / "a" / "executions.csv").read_bytes() == (tmp_path / "b" / "executions.csv").read_bytes()


def test_of_a_stored_run_only_execution_and_seed_may_change(run, stored):
    code, out, _ = run(
        "execute", stored, "execution.truth={friction: 0.2}", "--trials", 3, "--seed", 9, "--json", "--out", "c"
    )
    data = json.loads(out)
    assert (code, data["kind"], data["success_rate"], data["executions"]["seed"]) == (0, "execution", 0.0, 9)
    code, _, err = run("execute", stored, "contact.friction=0.2")
    assert code == 2
    assert "'contact.friction=0.2': a stored plan depends on it; expected keys of execution and seed" in err


def test_a_run_that_was_edited_is_refused(run, tmp_path, stored):
    def copy(name: str) -> Path:
        folder = tmp_path / name
        folder.mkdir()
        for path in stored.iterdir():
            if path.is_file():
                (folder / path.name).write_bytes(path.read_bytes())
        return folder

    config = copy("config") / "config.yaml"
    config.write_text(config.read_text().replace("mass: 0.5", "mass: 0.6"))
    code, _, err = run("execute", "config")
    assert code == 2
    assert "config: config.yaml has changed since the run was begun" in err
    plan = copy("numbers") / "plan.csv"
    lines = plan.read_text().splitlines()
    lines[5] = ",".join(["nan", *lines[5].split(",")[1:]])
    plan.write_text("\n".join(lines))
    assert "line 6 has a number that is not finite" in run("execute", "numbers")[2]
    plan = copy("joints") / "plan.csv"
    plan.write_text(plan.read_text().replace("joint6", "wrist"))
    assert (
        "a plan of the joints joint1, joint2, joint3, joint4, joint5, wrist; expected one of"
        in run("execute", "joints")[2]
    )
    plan = copy("path") / "plan.csv"
    lines = plan.read_text().splitlines()
    cells = lines[9].split(",")
    cells[4] = str(float(cells[4]) + 1e-6)
    plan.write_text("\n".join([*lines[:9], ",".join(cells), *lines[10:]]))
    assert "not on the path of the configuration beside it" in run("execute", "path")[2]
    plan = copy("speeds") / "plan.csv"
    lines = [line.split(",") for line in plan.read_text().splitlines()]
    faster = [[*line[:2], repr(2 * float(line[2])), *line[3:]] for line in lines[1:]]
    plan.write_text("\n".join(map(",".join, [lines[0], *faster])))
    assert "its times are not those of its speeds sd" in run("execute", "speeds")[2]
    slower = [[*line[:2], "0.0", *line[3:]] for line in lines[1:]]
    (copy("stands") / "plan.csv").write_text("\n".join(map(",".join, [lines[0], *slower])))
    code, _, err = run("execute", "stands")
    assert code == 2
    assert "its times are not those of its speeds sd" in err
    plan = copy("short") / "plan.csv"
    plan.write_text(plan.read_text()[:5000])
    assert "is cut short, or has been changed" in run("execute", "short")[2]
    (copy("gone") / "plan.csv").unlink()
    assert "plan.csv: cannot be read as a plan" in run("execute", "gone")[2]
    assert "no such file" in run("execute", "nowhere.yaml")[2]
    assert not (tmp_path / "results").exists()


@pytest.mark.parametrize("change", [{"duration": "x"}, {"certificate": {"a": 1}}, {"kind": None, "size": 3}])
def test_a_summary_that_was_edited_is_refused_and_hides_no_other_run(run, tmp_path, stored, change):
    for name in ("edited", "whole"):
        (tmp_path / "runs" / name).mkdir(parents=True)
        for path in stored.iterdir():
            if path.is_file():
                (tmp_path / "runs" / name / path.name).write_bytes(path.read_bytes())
    summary = tmp_path / "runs" / "edited" / "summary.json"
    summary.write_text(json.dumps(json.loads(summary.read_text()) | change))
    for command in ("report", "execute"):
        code, _, err = run(command, "runs/edited")
        assert code == 2
        assert "summary.json" in err
        assert "has been changed" in err
    code, out, _ = run("runs", "runs")
    assert code == 0
    assert "runs/whole" in out


# What goes wrong ------------------------------------------------------------------------------------------


def test_where_every_simulation_diverges_the_exit_code_is_5(run, tmp_path, stored):
    """A force of 1e12 N on the tray, which MuJoCo answers with a warning and numbers that mean nothing."""
    force = "execution.disturbance.force_deviation=[1e12, 0, 0]"
    code, out, err = run("execute", stored, force, "--trials", 3, "--out", "d", "--no-figures")
    assert (code, err) == (5, "")
    assert "0 of 3 trials succeeded" in " ".join(out.split())
    assert "Of the others: 3 simulation diverged." in " ".join(out.split())
    assert "waiter-one-block: simulation failed; the motion takes" in out
    summary, rows = read_summary(tmp_path / "d"), table(tmp_path / "d" / "executions.csv")
    assert (summary.status, summary.success_rate) == ("simulation failed", 0.0)
    assert summary.executions.statuses == {"simulation diverged": 3}
    assert summary.executions.feedback is summary.executions.first_failure is None
    assert {(row["status"], row["t"], row["slip_block"]) for row in rows} == {("simulation diverged", "", "")}
    assert {path.name for path in tmp_path.iterdir()} == {"d"}
    assert run("execute", stored, force, "--trials", 3, "--out", "q", "--quiet")[0] == 5


def test_a_full_disk_leaves_nothing(run, tmp_path, stored, monkeypatch):
    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(execution_run, "write_executions_csv", full)
    code, _, err = run("execute", stored, "--trials", 1, "--out", "d")
    assert code == 2
    assert "No space left on device" in err
    assert list(tmp_path.iterdir()) == []


SAYS_WHAT_IS_DONE = """
import sys
from contextlib import contextmanager
from robustopt import cli
from robustopt.cli import commands

@contextmanager
def told(silent):
    yield lambda done, total, successes: print("done", done, file=sys.stderr, flush=True)

commands.trials_bar = told
cli.main()
"""


@pytest.mark.slow
@pytest.mark.parametrize("workers", [1, 2])
def test_ctrl_c_keeps_what_was_done(tmp_path, stored, workers):
    arguments = [
        "execute",
        str(stored),
        "--trials",
        "100000",
        "--out",
        "kept",
        "--workers",
        str(workers),
        "--no-figures",
    ]
    command = [sys.executable, "-c", SAYS_WHAT_IS_DONE, *arguments]
    process = subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert process.stderr is not None
    assert process.stderr.readline().startswith("done")
    os.kill(process.pid, signal.SIGINT)
    out, err = process.communicate(timeout=120)
    assert process.returncode == 130, err
    assert "Traceback" not in out + err
    summary, rows = read_summary(tmp_path / "kept"), table(tmp_path / "kept" / "executions.csv")
    assert summary.status == "interrupted"
    assert len(rows) == summary.executions.trials
    assert 0 < len(rows) < 100000
    assert len(rows) % 25 == 0
    assert f"Interrupted after {len(rows):,} of 100,000 trials." in " ".join(out.split())
    again = [
        "execute",
        str(tmp_path / "kept"),
        "--trials",
        "2",
        "--out",
        str(tmp_path / "again"),
        "--quiet",
        "--no-figures",
    ]
    assert cli.run(again) == 0
    assert read_summary(tmp_path / "again").status == "solved"


def test_help_names_the_command(run):
    assert "execute" in run("--help")[1]
