"""The command line: what each command prints and writes, and what bad input is answered with."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from robustopt import __version__
from robustopt.certificate import Margin, Worst
from robustopt.config.load import load_config
from robustopt.errors import RobustOptError
from robustopt.interruption import interruptions, on_interrupt
from robustopt.report import certificate_rows
from robustopt.runs import plan_run
from robustopt.runs.records import CertificateRecord, Summary
from robustopt.runs.store import read_provenance, read_summary

ROOT = Path(__file__).parents[1]
WAITER = ROOT / "configs" / "waiter_two_blocks.yaml"
SMALL = ["solver.collocation_points=90", "--no-figures"]


@pytest.fixture(autouse=True)
def no_interruptions():
    yield
    interruptions.clear()


def files(folder: Path) -> set[str]:
    return {str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file()}


# Commands -------------------------------------------------------------------------------------------------


def test_plan_writes_a_whole_run_folder_and_prints_its_summary(run, tmp_path):
    code, out, err = run("plan", WAITER, "solver.collocation_points=90", "output.period=0.01", "--seed", "3")
    assert (code, err) == (0, "")
    (folder,) = (tmp_path / "results" / "waiter-two-blocks").iterdir()
    written = files(folder)
    data = {"config.yaml", "provenance.json", "summary.json", "plan.csv", "trajectory.csv", "joint_trajectory.json"}
    assert data | {"report.html"} <= written
    for name in ("phase_plane", "joints", "contacts", "binding"):
        assert {f"figures/{name}.svg", f"figures/{name}.png"} <= written
    summary = read_summary(folder)
    assert summary.status == "solved"
    assert summary.certificate.passed is True
    assert sum(summary.binding.values()) == pytest.approx(1.0)
    assert f"waiter-two-blocks: solved; the motion takes {summary.duration:.4f} s, planned by ipopt" in out
    for said in ("Binding limits", "Certificate", "passed", next(iter(summary.binding)), folder.name):
        assert said in out
    stored = load_config(folder / "config.yaml")
    assert (stored.seed, stored.solver.collocation_points, stored.output.period) == (3, 90, 0.01)
    assert read_provenance(folder).seed == 3
    last = (folder / "trajectory.csv").read_text().splitlines()[-1]
    assert float(last.split(",")[0]) == pytest.approx(summary.duration, abs=1e-12)
    assert (folder / "report.html").read_text().count("data:image/svg+xml") == 3


def test_the_stored_configuration_gives_the_same_plan(run, tmp_path):
    assert run("plan", WAITER, *SMALL, "--out", "first", "--quiet") == (0, "", "")
    assert run("plan", "first/config.yaml", "--no-figures", "--out", "second", "--quiet")[0] == 0
    for name in ("plan.csv", "trajectory.csv", "joint_trajectory.json", "config.yaml"):
        assert (tmp_path / "first" / name).read_bytes() == (tmp_path / "second" / name).read_bytes()


def test_json_is_one_object_with_the_summary(run, tmp_path):
    code, out, err = run("plan", WAITER, *SMALL, "--method", "reachability", "--json", "--out", "here")
    data = json.loads(out)
    assert (code, err) == (0, "")
    assert (data["status"], data["method"], data["folder"]) == ("solved", "reachability", "here")
    del data["folder"]
    assert data == json.loads((tmp_path / "here" / "summary.json").read_text())
    assert Summary.model_validate(data) == read_summary(tmp_path / "here")


def test_report_prints_a_stored_run_again(run):
    first = run("plan", WAITER, *SMALL, "--out", "here")[1]
    assert run("report", "here") == (0, first, "")
    assert json.loads(run("report", "here", "--json")[1])["status"] == "solved"
    code, _, err = run("report", "elsewhere")
    assert code == 2
    assert "elsewhere: no such run folder; expected a folder that `robustopt plan` wrote" in err


def test_dry_run_shows_the_configuration_and_the_size_and_writes_nothing(run, tmp_path):
    code, out, _ = run("plan", WAITER, "solver.collocation_points=20", "contact.friction=0.25", "--dry-run")
    assert code == 0
    assert list(tmp_path.iterdir()) == []
    text, size = out.split("\nProblem\n")
    (tmp_path / "again.yaml").write_text(text)
    assert load_config(tmp_path / "again.yaml").contact.friction == 0.25
    data = json.loads(run("plan", tmp_path / "again.yaml", "--dry-run", "--json")[1])
    assert data["size"]["grid_points"] == 20 + 3  # three sweeps, each with its own first and last point
    assert data["size"]["rows"] > data["size"]["rows_after_pruning"] > 0
    assert (data["size"]["objects"], data["size"]["contacts"]) == (2, 2)
    assert data["size"]["friction_edges"] == 2 * 4 * 16  # contacts, corners of the patch, edges of the cone
    assert f"friction edges      {data['size']['friction_edges']}" in size
    assert data["config"]["contact"]["friction"] == 0.25


def test_validate_looks_at_the_robot_and_the_path(run, tmp_path):
    text = WAITER.read_text().replace("tool: flange", "tool: hand")
    (tmp_path / "task.yaml").write_text(text)
    line = 1 + next(i for i, row in enumerate(text.splitlines()) if "tool: hand" in row)
    code, out, err = run("validate", "task.yaml")
    assert (code, out) == (2, "")
    assert err.startswith(f"error: task.yaml:{line}: robot.tool: tx90l.xml has no site or body 'hand'")
    code, out, err = run("validate", WAITER, "path.tray_poses.0.position=[9, 0, 0]")
    assert (code, out) == (2, "")
    assert "path.tray_poses" in err


def test_validate_says_valid_or_every_mistake(run):
    assert run("validate", WAITER) == (0, f"{WAITER}: valid\n", "")
    assert json.loads(run("validate", WAITER, "--json")[1]) == {"valid": True, "name": "waiter-two-blocks"}
    code, out, err = run("validate", WAITER, "tray.mass=-1", "seed=x")
    assert (code, out) == (2, "")
    assert err.splitlines() == [
        "error: override 'tray.mass=-1': tray.mass: found -1; expected a number from 1e-06 to 1000000 in kilograms "
        "(mass of the tray)",
        "error: override 'seed=x': seed: found the text 'x'; expected a whole number of at least 0 "
        "(seed of all random numbers of the run)",
    ]


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="a device of Linux that is always full")
@pytest.mark.parametrize("arguments", [("--json",), ()])
def test_a_full_disk_under_standard_output_is_said_in_a_line(arguments):
    command = [sys.executable, "-m", "robustopt", "validate", str(WAITER), *arguments]
    with open("/dev/full", "w") as full:
        done = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True)
    message = "error: the output of the command cannot be written: No space left on device\n"
    assert (done.returncode, done.stderr) == (2, message)


def test_version(run):
    assert run("--version") == (0, f"robustopt {__version__}\n", "")


def test_help_imports_nothing_heavy():
    program = (
        "import sys; from robustopt import cli\n"
        "code = cli.run(['--help'])\n"
        "heavy = {'casadi', 'mujoco', 'numba', 'matplotlib', 'numpy', 'scipy', 'pandas', 'pydantic', 'rich'}\n"
        "sys.exit(code or sorted(heavy & set(sys.modules)) or None)"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert "plan" in done.stdout


# Bad input ------------------------------------------------------------------------------------------------

BAD_CONFIGS = {
    "not YAML": ("name: [1, 2\n", "not YAML: "),
    "list at top level": ("- 1\n", "found the list [1]; expected keys and values, such as `name: my-task`"),
    "unknown key": (["solver.metod=ipopt"], "solver.metod: unknown key; did you mean method? expected one of method, "),
    "wrong unit": (
        ["tray.size=[300 mm, 0.3, 0.01]"],
        "found the text '300 mm'; expected a plain number from 1e-06 to 100 in m",
    ),
    "wrong type": (["objects=[1]"], "objects: found the list [1]; expected a mapping of names to sections"),
    "NaN": (["tray.mass=.nan"], "tray.mass: found nan; expected a number from 1e-06 to 1000000 in kilograms"),
    "infinity": (["contact.friction=.inf"], "contact.friction: found inf; expected a number from 1e-06 to 100"),
    "reversed interval": (["uncertainty.friction=[0.6, 0.4]"], "expected the lowest value first: [0.4, 0.6]"),
    "negative mass": (
        ["objects.upper.mass=-0.5"],
        "objects.upper.mass: found -0.5; expected a number from 1e-06 to 1000000 in kil",
    ),
    "zero-size object": (
        ["objects.upper.size=[0, 0.1, 0.1]"],
        "objects.upper.size[0]: found 0; expected a number from 1e-06",
    ),
    "unknown support": (
        ["objects.upper.on=shelf"],
        "objects.upper.on: nothing is called shelf; expected one of tray, l",
    ),
    "circular support": (["objects.lower.on=upper"], "lower stands on upper, which stands on lower; expected a chain"),
    "object off the tray": (["objects.lower.at=[0.4, 0]"], "objects.lower.at: its base, with its centre at [0.4, 0]"),
    "unknown robot": (
        ["robot.model=r2d2"],
        "robot.model: unknown robot 'r2d2'; give a shipped robot (humanoid, tx90l)",
    ),
    "missing model file": (["robot.model=arm.xml"], "robot.model: there is no file"),
    "unknown tool": (["robot.tool=hand"], "robot.tool: "),
    "one waypoint": (["path={tray_poses: [{position: [0.75, 0, 0.75]}]}"], "found 1 waypoint; expected at least two"),
    "repeated waypoints": (
        ["path={tray_poses: [{position: [0.75, 0, 0.75]}, {position: [0.75, 0, 0.75]}]}"],
        "path.tray_poses[1]: found the same waypoint as path.tray_poses[0]; expected it once",
    ),
    "unreachable pose": (["path.tray_poses.1={position: [5, 0, 0.75]}"], "path.tray_poses[1]: "),
    "friction 0": (["contact.friction=0"], "contact.friction: found 0; expected a number from 1e-06 to 100"),
    "2 grid points": (["solver.collocation_points=2"], "found 2; expected a whole number from 10 to 20000"),
    "1,000,000 grid points": (
        ["solver.collocation_points=1000000"],
        "found 1000000; expected a whole number from 10 t",
    ),
    "no override": (["contact.friction"], "found no key=value; expected for example solver.collocation_points=500"),
}


@pytest.mark.parametrize("case", BAD_CONFIGS)
def test_bad_input_is_answered_with_exit_code_2_place_and_remedy(run, tmp_path, case):
    change, message = BAD_CONFIGS[case]
    path, overrides = WAITER, change
    if isinstance(change, str):
        path, overrides = tmp_path / "task.yaml", []
        path.write_text(change)
    before = files(tmp_path)
    code, out, err = run("plan", path, *overrides)
    assert (code, out) == (2, "")
    assert message in err
    place = f"override '{overrides[0]}'" if overrides else f"{path}:"
    assert all(line.startswith(f"error: {place}") for line in err.splitlines()), err
    assert files(tmp_path) == before
    assert not (tmp_path / "results").exists()
    code, out, err = run("plan", path, *overrides, "--json")
    error = json.loads(out)["error"]
    assert (code, err, error["exit_code"]) == (2, "", 2)
    assert any(message in f"{problem['key']}: {problem['message']}" for problem in error["problems"])


@pytest.mark.parametrize(
    ("content", "message"),
    [("<mujoco><worldbody></mujoco>", "robot.model: "), ("<mujoco/>", "robot.model: ")],
    ids=["does not parse", "without joints"],
)
def test_a_model_file_that_is_no_robot_is_answered_in_a_line(run, tmp_path, content, message):
    (tmp_path / "arm.xml").write_text(content)
    code, out, err = run("plan", WAITER, f"robot.model={tmp_path / 'arm.xml'}")
    assert (code, out, len(err.splitlines())) == (2, "", 1)
    assert message in err


def test_a_tray_that_cannot_hold_its_objects_at_rest_is_infeasible_and_says_why(run, tmp_path):
    tilted = "path.tray_poses.0={position: [0.75, -0.5, 0.75], rpy: [0.4, 0, -0.588]}"
    code, out, err = run("plan", WAITER, tilted, "contact.friction=0.3", *SMALL, "--out", "here")
    assert (code, err) == (3, "")
    assert "waiter-two-blocks: infeasible" in out
    assert "at tray_poses[0]" in out
    assert "slip of lower on tray" in out
    assert "contact.friction: at least" in out
    assert files(tmp_path / "here") == {"config.yaml", "provenance.json", "summary.json", "report.html"}
    data = json.loads(run("plan", WAITER, tilted, "contact.friction=0.3", *SMALL, "--json")[1])
    assert (data["status"], data["error"]["kind"]) == ("infeasible", "infeasible")


@pytest.fixture
def too_fast(monkeypatch):
    """Make every plan exceed its limits."""
    honest = plan_run.solve

    def hasty(problem):
        from dataclasses import replace

        plan = honest(problem)
        return replace(plan, x=1.5 * plan.x, u=1.5 * plan.u, duration=plan.duration / 1.5**0.5)

    monkeypatch.setattr(plan_run, "solve", hasty)


@pytest.mark.usefixtures("too_fast")
def test_a_plan_that_fails_its_certificate_is_not_reported_as_solved(run):
    code, out, err = run("plan", WAITER, *SMALL, "--out", "here")
    assert (code, err) == (4, "")
    assert "waiter-two-blocks: certificate failed" in out
    assert "solved" not in out
    code, out, _ = run("plan", WAITER, *SMALL, "--json")
    assert json.loads(out)["error"]["kind"] == "certificate failed"


@pytest.mark.usefixtures("too_fast")
@pytest.mark.parametrize("command", ["plan", "execute"])
def test_a_rejected_plan_leaves_nothing_to_run(run, tmp_path, command):
    assert run(command, WAITER, *SMALL, "--out", "here", "--quiet")[0] == 4
    assert files(tmp_path / "here") == {"config.yaml", "provenance.json", "summary.json", "report.html"}
    assert "is rejected" in (tmp_path / "here" / "report.html").read_text()
    (listed,) = json.loads(run("runs", ".", "--json")[1])["runs"]
    assert (listed["state"], listed["status"]) == ("rejected", "certificate failed")
    code, out, err = run("execute", "here", "--out", "there")
    assert (code, out) == (2, "")
    assert err == "error: here: its plan failed its certificate and was rejected; expected one that passed\n"
    assert not (tmp_path / "there").exists()


def test_a_limit_that_no_forces_hold_is_the_smallest_margin():
    """A margin of -inf, null in a summary: it was shown as "none of the limit", and passed over on the grid."""
    worst = Worst("slip of cup on tray", -np.inf, 0.0, 0.0, True, {})
    margins = {"joint3 position": Margin(0.17, 0.17), worst.limit: Margin(-np.inf, -0.2)}
    effort = {
        "level": "quick",
        "seed": 0,
        "samples": 0,
        "tests": 9,
        "instants": 1,
        "intervals": 1,
    }
    found = {"worst": worst, "margins": margins, "passed": False, "margin": -np.inf, "seconds": 0.1, **effort}
    lines = certificate_rows(CertificateRecord.model_validate(found))
    assert [line.value for line in lines[1:3]] == ["not held by any forces: slip of cup on tray"] * 2
    assert str(worst).startswith("slip of cup on tray: not held by any forces at t = 0.000 s")


@pytest.mark.parametrize("out", ["file/run", "/proc/run"])
def test_a_results_folder_that_cannot_be_written_is_found_before_planning(run, tmp_path, monkeypatch, out):
    monkeypatch.setattr(plan_run, "plan_task", lambda *_: pytest.fail("planned"))
    (tmp_path / "file").write_text("")
    code, printed, err = run("plan", WAITER, "--out", out)
    assert (code, printed) == (2, "")
    assert err.startswith(f"error: {out}: cannot be written: ")
    assert err.rstrip().endswith("; expected a writable folder")


def test_an_earlier_run_is_not_overwritten(run, tmp_path):
    assert run("plan", WAITER, *SMALL, "--out", "here", "-q")[0] == 0
    before = (tmp_path / "here" / "summary.json").read_bytes()
    code, _, err = run("plan", WAITER, *SMALL, "--out", "here")
    assert code == 2
    assert "here: holds an earlier run of robustopt; expected a new folder, or remove that one first" in err
    assert (tmp_path / "here" / "summary.json").read_bytes() == before


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["plan"], "Missing argument 'CONFIG'"),
        (["plan", "x.yaml", "--fast"], "No such option: --fast"),
        (["plan", "x.yaml", "--certify", "half"], "'half' is not one of 'quick', 'full'"),
        (["plan", "x.yaml", "--seed", "pi"], "Invalid value for '--seed'"),
        (["plot"], "No such command 'plot'"),
        (["plan", "x.yaml"], "x.yaml: no such file; expected the path of a YAML file"),
        (["validate", "."], "this is a folder; expected a YAML file"),
    ],
)
def test_wrong_usage_has_exit_code_2_and_one_line(run, arguments, message):
    code, out, err = run(*arguments)
    assert (code, out, len(err.splitlines())) == (2, "", 1)
    assert message in err
    code, out, err = run(*arguments, "--json")
    assert (code, err) == (2, "")
    assert message in json.loads(out)["error"]["message"]


# Interruption ---------------------------------------------------------------------------------------------


def test_an_interruption_has_exit_code_130_and_leaves_nothing(run, tmp_path, monkeypatch):
    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(plan_run, "write_run", interrupted)
    code, out, err = run("plan", WAITER, *SMALL)
    assert (code, out, err) == (130, "", "error: interrupted; no incomplete files are left\n")
    assert list(tmp_path.iterdir()) == []


def test_an_interruption_that_a_library_swallows_still_counts(run, tmp_path, monkeypatch):
    honest = plan_run.solve

    def swallowing(problem):
        with pytest.raises(KeyboardInterrupt):
            on_interrupt(signal.SIGINT, None)
        return honest(problem)

    monkeypatch.setattr(plan_run, "solve", swallowing)
    assert run("plan", WAITER, *SMALL)[0] == 130
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("error", [ImportError("initialization failed"), EOFError(), RobustOptError("odd")])
def test_an_interrupt_that_an_extension_module_turns_into_another_error_is_an_interrupt(
    run, tmp_path, monkeypatch, error
):
    def interrupted(problem):
        with pytest.raises(KeyboardInterrupt):
            on_interrupt(signal.SIGINT, None)
        raise error

    monkeypatch.setattr(plan_run, "solve", interrupted)
    assert run("plan", WAITER, *SMALL)[0] == 130
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "number", [pytest.param(signal.SIGINT, marks=pytest.mark.slow, id="Ctrl-C"), pytest.param(signal.SIGTERM, id="end")]
)
def test_ctrl_c_in_the_middle_leaves_nothing(tmp_path, number):
    command = [sys.executable, "-m", "robustopt", "plan", str(WAITER), "solver.collocation_points=5000"]
    process = subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    deadline = time.monotonic() + 60
    while not list(tmp_path.glob("results/*/.*")) and time.monotonic() < deadline:
        time.sleep(0.01)
    assert list(tmp_path.glob("results/*/.*.partial-*")), "the run never started"
    time.sleep(1.0)
    os.kill(process.pid, number)
    out, err = process.communicate(timeout=60)
    assert (process.returncode, out) == (130, "")
    assert err.splitlines()[-1] == "error: interrupted; no incomplete files are left"
    assert "Traceback" not in err
    assert list(tmp_path.iterdir()) == []
