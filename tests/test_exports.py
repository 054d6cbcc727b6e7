"""Exports of plans and stored runs: whole control cycles, formats that other programs read, and bad input."""

import csv
import json
import re
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from scenes import CONFIGS, plan_of, scene
from scipy.interpolate import BPoly

import robustopt as ro
from robustopt.exports.cycles import at_jerk_steps, whole_cycles
from robustopt.exports.quintics import largest_jerk
from robustopt.solvers.trajectory import Trajectory

FORMATS = ("csv", "ros", "moveit", "urscript", "npz")


@pytest.fixture(scope="module")
def arm() -> ro.Plan:
    small = ["solver.method=reachability", "solver.collocation_points=60", "uncertainty={}"]
    return plan_of(ro.load_config(CONFIGS / "waiter_one_block.yaml", small))


@pytest.fixture(scope="module")
def smooth() -> ro.Plan:
    """A plan with a jerk limit, a pause and a stop."""
    small = ["solver.method=reachability", "solver.collocation_points=60", "uncertainty={}"]
    changes = ["robot.limits.all={jerk: 100}", "path.pauses=[{waypoint: 1, time: 0.01}]"]
    return plan_of(ro.load_config(CONFIGS / "waiter_two_blocks.yaml", [*small, *changes]))


@pytest.fixture(scope="module")
def slide() -> ro.Plan:
    return plan_of(scene())


def read(file: Path) -> tuple[np.ndarray, ...]:
    """Times, positions, velocities and accelerations in a file of any format but urscript."""
    if file.suffix == ".npz":
        with np.load(file) as data:
            return tuple(data[name] for name in ("t", "q", "qd", "qdd"))
    if file.suffix == ".csv":
        with file.open() as lines:
            head, *rows = csv.reader(lines)
        table, parts = np.array(rows, dtype=float), ("q_", "qd_", "qdd_")
        return table[:, 0], *(table[:, [h.startswith(part) for h in head]] for part in parts)
    message = yaml.safe_load(file.read_text())
    points = message.get("joint_trajectory", message)["points"]
    t = [point["time_from_start"]["sec"] + 1e-9 * point["time_from_start"]["nanosec"] for point in points]
    return np.array(t), *(np.array([p[k] for p in points]) for k in ("positions", "velocities", "accelerations"))


# Whole cycles ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("period", [0.001, 0.008, 0.03, 1.0])
def test_a_motion_is_slowed_down_to_a_whole_number_of_periods(arm, period):
    motion, plan = whole_cycles(arm, period), Trajectory.from_plan(arm)
    cycles = int(np.ceil(plan.duration / period))
    k = cycles * period / plan.duration
    assert motion.factor == pytest.approx(k, rel=1e-14)
    np.testing.assert_allclose(motion.samples.t, period * np.arange(cycles + 1), rtol=1e-14)
    expected = plan.sample(np.minimum(motion.samples.t / k, plan.duration))
    np.testing.assert_allclose(motion.samples.q, expected.q, atol=1e-11)
    np.testing.assert_allclose(motion.samples.qd, expected.qd / k, atol=1e-9)
    np.testing.assert_allclose(motion.samples.qdd[:-1], expected.qdd[:-1] / k**2, atol=1e-6)
    np.testing.assert_array_equal(motion.samples.q[-1], arm.problem.path(1.0)[0])
    np.testing.assert_array_equal(motion.samples.qd[-1], 0)
    (note,) = motion.notes
    assert f"slowed down uniformly by {100 * (k - 1):.3g} %" in note


@pytest.mark.parametrize("cycles", [1, 3, 7, 1000])
def test_a_plan_that_ends_on_a_whole_period_is_not_changed(slide, cycles):
    motion = whole_cycles(slide, slide.duration / cycles)
    assert (motion.factor, motion.notes, len(motion.samples.t)) == (1.0, (), cycles + 1)
    assert motion.duration == pytest.approx(slide.duration, rel=1e-12)


def test_a_motion_shorter_than_a_period_says_so(slide):
    motion = whole_cycles(slide, 2.0 * slide.duration)
    assert len(motion.samples.t) == 2
    assert "by 100 %" in motion.notes[0]
    assert "shorter than one period, so only its start and its end are left" in motion.notes[0]


def test_a_slower_motion_that_the_certificate_does_not_cover_says_so(slide):
    c = slide.problem.c.copy()
    c[3, 0] = 0.1
    falling = replace(slide, problem=replace(slide.problem, c=c))
    assert len(whole_cycles(slide, 0.3).notes) == 1
    assert "the certificate of the plan does not cover the slower motion" in whole_cycles(falling, 0.3).notes[1]
    assert whole_cycles(falling, slide.duration / 3).notes == ()


# Steps of the jerk ----------------------------------------------------------------------------------------


def interpolated_jerk(t, q, qd, qdd) -> np.ndarray:
    """Largest jerk of polynomials of fifth degree, at many places, (n,)."""
    polynomial = BPoly.from_derivatives(t, np.stack([q, qd, qdd], axis=1)).derivative(3)
    places = (t[:-1, None] + np.diff(t)[:, None] * np.linspace(1e-6, 1.0 - 1e-6, 21)).ravel()
    return np.abs(polynomial(places)).max(axis=0)


def test_points_at_the_steps_of_the_jerk_keep_its_limit_between_them(smooth, tmp_path):
    exported = ro.export(smooth, format="ros", out=tmp_path / "a.json")
    t, q, qd, qdd = read(exported.file)
    plan = Trajectory.from_plan(smooth)
    jerk = interpolated_jerk(t, q, qd, qdd).max()
    assert 0.99 < jerk / 100.0 < 1.001
    assert exported.jerk == pytest.approx(jerk / 100.0, rel=1e-4)
    assert exported.duration == pytest.approx(smooth.duration, abs=1e-9)
    assert np.diff(t).max() <= 0.004 + 1e-9
    assert np.abs(t[:, None] - plan.times).min(axis=0).max() <= 1e-9
    np.testing.assert_allclose(q, plan.sample(np.minimum(t, plan.duration)).q, rtol=0.0, atol=1e-12)
    (note,) = exported.notes
    assert note.startswith("polynomials of fifth degree between the samples, as in ROS controllers, reach 100.0 %")


@pytest.mark.parametrize("period", [0.002, 0.008])
def test_whole_cycles_say_how_far_the_jerk_between_them_exceeds_its_limit(smooth, tmp_path, period):
    exported = ro.export(smooth, period=period, out=tmp_path / "a.json")
    samples = whole_cycles(smooth, period).samples
    jerk = interpolated_jerk(samples.t, samples.q, samples.qd, samples.qdd)
    np.testing.assert_allclose(largest_jerk(samples), jerk, rtol=1e-3)
    assert exported.jerk == pytest.approx(jerk.max() / 100.0, rel=1e-3)
    assert exported.jerk > 1.1
    assert exported.notes[-1].endswith("ros and moveit without a period have a sample at every step of the jerk")
    assert ro.export(smooth, format="urscript", period=0.008, out=tmp_path / "a.script").jerk is None


def test_only_messages_have_points_at_the_steps_of_the_jerk(smooth, arm, tmp_path):
    assert ro.export(smooth, format="moveit", out=tmp_path / "a.json").at_jerk_steps
    assert not ro.export(smooth, format="csv", out=tmp_path / "a.csv").at_jerk_steps
    assert not ro.export(arm, format="ros", out=tmp_path / "a.json").at_jerk_steps
    assert ro.export(arm, format="ros", out=tmp_path / "a.json").jerk is None
    *_, message = smooth.export(tmp_path / "folder", period=0.1)
    np.testing.assert_array_equal(read(message)[1], at_jerk_steps(smooth, 0.1).samples.q)


# Formats --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["a.csv", "a.json", "a.yaml", "a.npz"])
def test_files_read_back_to_the_same_numbers(arm, tmp_path, name):
    formats = {"a.csv": ["csv"], "a.npz": ["npz"]}.get(name, ["ros", "moveit"])
    for kind in formats:
        exported = ro.export(arm, format=kind, period=0.008, out=tmp_path / name)
        samples = whole_cycles(arm, 0.008).samples
        t, *values = read(exported.file)
        assert (exported.file, exported.samples, exported.duration) == (tmp_path / name, len(t), samples.t[-1])
        np.testing.assert_allclose(t, samples.t, atol=1e-9)
        for found, expected in zip(values, (samples.q, samples.qd, samples.qdd), strict=True):
            np.testing.assert_array_equal(found, expected)


def test_arrays_name_their_joints(arm, tmp_path):
    with np.load(ro.export(arm, format="npz", out=tmp_path / "a.npz").file) as data:
        assert tuple(data["joint_names"]) == arm.problem.robot.joint_names


def message_of(typestore, kind: str, data):
    """A message of a typestore from plain data; as in ROS, sequences that are missing are empty."""
    from rosbags.interfaces import Nodetype

    def field(node, value):
        nodetype, detail = node
        if nodetype == Nodetype.NAME:
            return message_of(typestore, detail, value)
        if nodetype == Nodetype.BASE:
            return value
        (inner, name), _ = detail
        items = value or []
        if inner == Nodetype.NAME:
            return [message_of(typestore, name, item) for item in items]
        return list(items) if name[0] == "string" else np.array(items, dtype=name[0])

    fields = typestore.fielddefs[kind][1]
    assert set(data) <= {name for name, _ in fields}
    return typestore.types[kind](**{name: field(node, data.get(name)) for name, node in fields})


def test_a_parser_of_ros_reads_the_message_as_cdr_and_back(arm, tmp_path):
    rosbags = pytest.importorskip("rosbags.typesys", reason="needs rosbags: pip install robustopt[test]")
    typestore, kind = rosbags.get_typestore(rosbags.Stores.ROS2_HUMBLE), "trajectory_msgs/msg/JointTrajectory"
    samples = whole_cycles(arm, 0.008).samples
    for name in ("a.json", "a.yaml"):
        file = ro.export(arm, format="ros", period=0.008, out=tmp_path / name).file
        message = message_of(typestore, kind, yaml.safe_load(file.read_text()))
        read = typestore.deserialize_cdr(typestore.serialize_cdr(message, kind), kind)
        assert tuple(read.joint_names) == arm.problem.robot.joint_names
        np.testing.assert_array_equal([point.positions for point in read.points], samples.q)
        np.testing.assert_array_equal([point.accelerations for point in read.points], samples.qdd)
        times = [point.time_from_start.sec * 10**9 + point.time_from_start.nanosec for point in read.points]
        assert times == [8_000_000 * k for k in range(len(times))]


def test_a_moveit_message_has_no_floating_joints(slide, tmp_path):
    message = json.loads(ro.export(slide, format="moveit", out=tmp_path / "a.json").file.read_text())
    assert set(message) == {"joint_trajectory", "multi_dof_joint_trajectory"}
    assert message["multi_dof_joint_trajectory"]["points"] == []


def test_a_program_checks_its_start_and_follows_the_motion(arm, tmp_path):
    exported = ro.export(arm, format="urscript", period=0.008, out=tmp_path / "a.script")
    text = exported.file.read_text()
    lines = re.findall(r"^  servoj\(\[(.*?)\], t=0\.008, lookahead_time=0\.1, gain=300\)$", text, re.MULTILINE)
    samples = whole_cycles(arm, 0.008).samples
    np.testing.assert_allclose([[float(v) for v in line.split(", ")] for line in lines], samples.q[1:], atol=1e-9)
    start = re.search(r"^  start = \[(.*)\]$", text, re.MULTILINE)
    np.testing.assert_allclose([float(v) for v in start[1].split(", ")], samples.q[0], atol=1e-9)
    assert text.count("def robustopt_waiter_one_block():") == 1
    opened = len(re.findall(r"^ *(?:def|if|while) .*:$", text, re.MULTILINE))
    assert opened == len(re.findall(r"^ *end$", text, re.MULTILINE))
    assert len(exported.notes) == 1
    assert "multiple" in ro.export(arm, format="urscript", period=0.005, out=tmp_path / "a.script").notes[1]


def test_a_program_is_for_arms_with_six_revolute_joints(slide, tmp_path):
    with pytest.raises(ro.ConfigError, match="six revolute joints; the robot has x;"):
        ro.export(slide, format="urscript", out=tmp_path / "a.script")
    assert not list(tmp_path.iterdir())


# Runs -----------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def stored(tmp_path_factory) -> Path:
    from robustopt.cli import run

    folder = tmp_path_factory.mktemp("runs") / "stored"
    small = ["solver.method=reachability", "solver.collocation_points=60", "uncertainty={}", "--no-figures"]
    assert run(["plan", str(CONFIGS / "waiter_one_block.yaml"), *small, "--out", str(folder), "-q"]) == 0
    return folder


@pytest.fixture
def folder(stored, tmp_path) -> Path:
    return Path(shutil.copytree(stored, tmp_path / "run"))


def test_a_run_is_exported_as_its_plan(run, folder, arm, tmp_path):
    code, out, err = run("export", folder, "--format", "csv", "--period", "0.008")
    assert (code, err) == (0, "")
    file = folder / "trajectory_0.008s.csv"
    expected = ro.export(arm, format="csv", period=0.008, out=tmp_path / "plan.csv")
    assert file.read_bytes() == expected.file.read_bytes()
    assert f"{file}: {expected.samples} samples every 0.008 s, {expected.duration:.6g} s" in out
    assert f"note: {expected.notes[0]}" in out


@pytest.mark.parametrize("kind", FORMATS)
def test_every_format_is_written_beside_the_files_of_the_run(run, folder, kind):
    before = {path: path.read_bytes() for path in folder.iterdir() if path.is_file()}
    code, out, _ = run("export", folder, "--format", kind, "--json")
    data = json.loads(out)
    assert (code, data["format"], data["period"]) == (0, kind, 0.004)
    assert Path(data["file"]).parent == folder
    assert {path: path.read_bytes() for path in before} == before
    assert ro.export(folder, format=kind).file == Path(data["file"])


def test_bad_exports_are_one_line(run, folder, tmp_path):
    nowhere = tmp_path / "nowhere" / "a.csv"
    for arguments, told in (
        ((folder, "--format", "urdf"), "'urdf' is not one of 'csv', 'ros', 'moveit', 'urscript', 'npz'"),
        ((folder, "--period", "0"), "period: found 0.0; expected a number above 0"),
        ((folder, "--period", "-1"), "period: found -1.0; expected a number above 0"),
        ((folder, "--period", "nan"), "period: found nan; expected a number above 0"),
        ((folder, "--period", "1e-9"), "expected a longer period"),
        ((tmp_path / "no",), "no such run folder"),
        ((tmp_path,), "not a run folder"),
        ((folder, "--out", "a.txt"), "out: found the suffix '.txt'; expected .json, .yaml or .yml"),
        ((folder, "--out", nowhere, "--format", "csv"), f"{nowhere}: cannot be written: No such file"),
        ((folder, "--out", tmp_path, "--format", "csv"), f"{tmp_path}: cannot be written: Is a directory"),
    ):
        code, out, err = run("export", *arguments)
        assert (code, out, err.count("\n")) == (2, "", 1), err
        assert told in err
    with pytest.raises(ro.ConfigError, match="format: found 'urdf'; expected one of csv, ros"):
        ro.export(folder, format="urdf")


def test_a_rejected_run_is_not_exported(run, folder):
    record = json.loads((folder / "summary.json").read_text())
    record["certificate"]["passed"] = False
    (folder / "summary.json").write_text(json.dumps(record))
    assert run("export", folder) == (
        2, "", f"error: {folder}: its plan failed its certificate and was rejected; expected one that passed\n"
    )  # fmt: skip


def test_a_run_without_a_plan_is_not_exported(run, tmp_path):
    task = CONFIGS / "waiter_one_block.yaml"
    heavy = ["solver.collocation_points=60", "gravity=[9, 0, -9.81]", "--no-figures", "--out", "none", "-q"]
    assert run("plan", task, *heavy)[0] == 3
    code, _, err = run("export", "none")
    assert (code, err.count("\n")) == (2, 1)
    assert "none: the run has no plan (infeasible)" in err
