"""Files, numbers and streams that should not be: each is answered with one clear message, at once, and nothing follows
a link to the files of somebody else."""

import json
import os
import resource
import subprocess
import sys
import warnings
from pathlib import Path

import numpy as np
import pytest

from robustopt.cli import app
from robustopt.cli.terminal import show_warnings_as_notes
from robustopt.config.load import load_config
from robustopt.errors import ConfigError, PathError, RobotError, RobustOptError, RunFolderError
from robustopt.files import read_bytes, read_text, write_text, written
from robustopt.models import MODELS
from robustopt.path import joint_waypoints
from robustopt.robot import load_robot
from robustopt.robot.model_file import model_file, model_hash
from robustopt.runs.journal import Journal
from robustopt.runs.learning_run import resumed
from robustopt.runs.store import new_run, read_summary
from robustopt.simulation.execute import _require_usable
from robustopt.solvers.trajectory import Trajectory

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="pipes, devices and /proc as on Linux")

ROOT = Path(__file__).parents[1]
WAITER, STEP = ROOT / "configs" / "waiter_two_blocks.yaml", ROOT / "configs" / "humanoid_step.yaml"
ARM = (MODELS / "tx90l.xml").read_text()
NOT_REGULAR = "is not a regular file, but a pipe, a device or the like; expected a regular file"


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """The current folder, with a pipe that nobody writes to."""
    monkeypatch.chdir(tmp_path)
    os.mkfifo("fifo")
    return tmp_path


# Files that are read --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "why"),
    [
        ("fifo", NOT_REGULAR),
        ("/dev/zero", NOT_REGULAR),
        ("/proc/kmsg", NOT_REGULAR),
        ("/proc/version", NOT_REGULAR),
        (".", "is a folder"),
        ("a\0b", "no file can have this name"),
        ("x" * 5000, "File name too long"),
        ("\udcff", "No such file"),
        ("large", "has 11 bytes; expected at most 10"),
        ("latin", "byte 1 is not UTF-8 text"),
    ],
)
def test_only_regular_files_of_bounded_size_are_read(folder, name, why):
    (folder / "large").write_bytes(b"x" * 11)
    (folder / "latin").write_bytes(b"x\xff")
    with pytest.raises(OSError, match=r".") as caught:
        read_text(Path(name), 10)
    assert why in str(caught.value.strerror)


def test_what_is_regular_is_read_as_it_is(folder):
    (folder / "file").write_bytes(b"\xef\xbb\xbfa\r\nb")
    (folder / "link").symlink_to("file")
    (folder / "empty").touch()
    assert read_text(Path("link")) == "a\r\nb"
    assert read_bytes(Path("file"), 8) == b"\xef\xbb\xbfa\r\nb"
    assert read_text(Path("empty")) == ""


@pytest.mark.parametrize("name", ["fifo", "/dev/zero", "/proc/version", "a\0b", "x" * 5000])
def test_a_configuration_and_a_run_that_are_no_files_are_named(folder, name):
    with pytest.raises(ConfigError, match=r"cannot be read as a YAML file: (is not|no file|File name)"):
        load_config(name)
    with pytest.raises(RunFolderError, match="no such run folder"):
        read_summary(Path(name))


@pytest.mark.parametrize(
    ("content", "why"),
    [
        ("1,2," + "x" * 200_000, "cannot be read: field larger than field limit"),
        (
            "0,0\n1e300,0",
            r"path.joints\[1\]: found 1e\+300; expected joint positions of at most 10000 rad or m in size",
        ),
        ("0,0\n" * 60_000, "found more than 50,000 waypoints"),
        ("0,0\n" + "9" * 300 + ",0", r"found 1e\+300; expected"),
    ],
)
def test_waypoints_in_a_file_are_bounded(folder, content, why):
    (folder / "way.csv").write_text(content)
    config = load_config({"name": "t", "robot": {"model": "tx90l"}, "path": {"joints": "way.csv"}})
    with pytest.raises(PathError, match=why):
        joint_waypoints.joint_waypoints(config, ("a", "b"), np.ones(2, dtype=bool))


# Model files ----------------------------------------------------------------------------------------------


def robot_of(text: str | None, name: str = "arm.xml") -> None:
    if text is not None:
        Path(name).write_text(text)
    config = load_config(WAITER.read_text(), [f"robot.model={name}"], folder=".")
    load_robot(config)
    model_hash(model_file(config))


def with_asset(text: str) -> str:
    return ARM.replace("<worldbody>", f"<asset>{text}</asset><worldbody>", 1)


MODELS_REFUSED = {
    "attaches itself": (
        '<mujoco><asset><model name="m" file="arm.xml"/></asset><worldbody><body><attach model="m" body="b" '
        'prefix="x"/></body></worldbody></mujoco>',
        "names .*arm.xml, which names it in turn; expected no circle",
    ),
    "attaches itself, written otherwise": (
        "<mujoco><asset><model file = 'a&#114;m.xml' name='m'/></asset></mujoco>",
        "which names it in turn",
    ),
    "model without a file": ('<mujoco><asset><model name="m"/></asset></mujoco>', "an element model names no file"),
    "pipe as texture": (with_asset('<texture type="2d" name="a" file="fifo"/>'), f"names .*fifo.* {NOT_REGULAR}"),
    "pipe as side": (with_asset('<texture type="cube" name="a" fileright="fifo"/>'), f"names .*fifo.* {NOT_REGULAR}"),
    "device as mesh": (with_asset('<mesh name="a" file="/dev/zero"/>'), f"names /dev/zero, .* {NOT_REGULAR}"),
    "proc as include": ('<mujoco><include file="/proc/kmsg"/></mujoco>', f"names /proc/kmsg, .* {NOT_REGULAR}"),
    "long name": (with_asset(f'<mesh name="a" file="{"x" * 5000}.stl"/>'), "MuJoCo cannot use the model: .*Error open"),
    "deep": ("<mujoco>" + "<body>" * 100_000 + "</body>" * 100_000 + "</mujoco>", "nested more than 400 elements deep"),
    "deep URDF": ("<robot>" + "<link>" * 100_000 + "</link>" * 100_000 + "</robot>", "nested more than 400 elements"),
    "copies": (
        '<mujoco><worldbody><replicate count="100000000"><geom size="1"/></replicate></worldbody></mujoco>',
        "the element replicate makes more than 1,000 parts",
    ),
    "copies of copies": (
        '<mujoco><worldbody><replicate count="100"><replicate count="100"/></replicate></worldbody></mujoco>',
        "the element replicate makes more than 1,000 parts",
    ),
    "height field": (with_asset('<hfield name="h" nrow="99999" ncol="99999" size="1 1 1 1"/>'), "element hfield makes"),
    "texture": (with_asset('<texture builtin="flat" width="99999" height="99999"/>'), "the element texture makes more"),
    "user data": ('<mujoco><size nuserdata="100000000"/></mujoco>', "the element size makes more than 10,000,000"),
    "reserved name": (
        ARM.replace("<worldbody>", '<worldbody><site name="robustopt_tray"/>', 1),
        "site robustopt_tray: names that begin with robustopt_ are reserved",
    ),
    "large": ("<mujoco>" + " " * 10_000_000 + "</mujoco>", "has 10,000,017 bytes; expected at most 10,000,000"),
    "two joints of a name": (
        '<robot name="r"><link name="a"/><link name="b"/><joint name="j" type="fixed"><parent link="a"/>'
        '<child link="b"/></joint><joint name="j" type="fixed"><parent link="a"/><child link="b"/></joint></robot>',
        "found 2 joints called 'j'",
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", MODELS_REFUSED)
def test_a_model_file_is_checked_before_mujoco_reads_it(folder, case):
    text, why = MODELS_REFUSED[case]
    with pytest.raises(RobotError, match=why) as caught:
        robot_of(text)
    assert len(str(caught.value)) < 1000


@pytest.mark.parametrize("name", ["fifo", "/dev/zero", "/proc/version", "."])
def test_a_model_that_is_no_regular_file_is_named(folder, name):
    with pytest.raises(RobotError, match=f"cannot be read: ({NOT_REGULAR}|is a folder)"):
        robot_of(None, name)


def test_a_chain_of_files_has_an_end(folder):
    for k in range(12):
        Path(f"{k}.xml").write_text(f'<mujoco><asset><model name="m" file="{k + 1}.xml"/></asset></mujoco>')
    with pytest.raises(RobotError, match="is named by a file that is named by a file, 8 times"):
        robot_of(None, "0.xml")


def test_names_in_comments_are_not_read(folder):
    robot_of(
        ARM.replace("<worldbody>", f'<!-- file="{"x" * 5000}" file="fifo" <replicate count="99999"> --><worldbody>')
    )


# Configurations -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("file", "override", "why"),
    [
        (STEP, "path.start.rigth=[0, 0]", "path.start.rigth: unknown key; did you mean right"),
        (WAITER, "contact.friction=\udcff", "found a byte that is not UTF-8; expected printable text"),
        (WAITER, "path.joints=[[1e300, 0], [0, 0]]", r"found 1e\+300; expected a number of at most 1e\+12 in size"),
        (WAITER, "path.tray_poses.0.quaternion=[1e300, 0, 0, 0]", r"quaternion\[0\]: found 1e\+300; expected a number"),
        (WAITER, "robot.base.rpy=[-1e300, 0, 0]", r"rpy\[0\]: found -1e\+300; expected a number of at most"),
        (WAITER, "execution.disturbance.hold=1e-300", "found 1e-300; expected a number of at least 1e-12"),
        (WAITER, "output.period=1e-6", "output.period: found 1e-06; expected a number from 1e-05 to"),
        (WAITER, "solver.collocation_points=20001", "found 20001; expected a whole number from 10 to 20000"),
        (WAITER, f"seed=1{'0' * 300}", "seed: found a whole number of more than 20 digits; expected a whole number"),
        (WAITER, f"learning.budget=1{'0' * 300}", "found a whole number of more than 20 digits; expected a whole"),
        (STEP, f"path.steps=[{'{foot: left, to: [0, 0]}, ' * 201}]", "found 201 steps; expected at most 200"),
        (WAITER, f"path.tray_poses=[{'{position: [0, 0, 0]}, ' * 1001}]", "found 1,001 poses; expected at most 1,000"),
    ],
)  # fmt: skip
def test_values_are_bounded_before_the_work_begins(file, override, why):
    with pytest.raises(ConfigError, match=why) as caught:
        load_config(file, [override])
    assert "0" * 150 not in str(caught.value)


@pytest.mark.parametrize("key", ["timestep", "disturbance.hold"])
def test_a_trial_has_a_bounded_number_of_steps_and_of_forces(key):
    config = load_config(WAITER, [f"execution.{key}=1e-9"])
    times = np.array([0.0, 3.0])
    still, piece = np.zeros(1), np.zeros(2, dtype=np.intp)
    trajectory = Trajectory(times, times / 3, np.ones(2), still, still, piece, None)  # type: ignore
    with pytest.raises(ConfigError, match=rf"execution.{key}: found 1e-09 s, so a trial of 3.8 s has 3,800,"):
        _require_usable(trajectory, config.execution)


# Files that are written -----------------------------------------------------------------------------------


def test_a_file_is_written_whole_or_not_at_all(folder):
    path = folder / "file.txt"
    path.write_text("before")
    with pytest.raises(IndexError), written(path) as beside:
        [][beside.write_text("half")]
    assert path.read_text() == "before"
    write_text(path, "after\n")
    assert path.read_bytes() == b"after\n"
    assert {entry.name for entry in folder.iterdir()} == {"file.txt", "fifo"}


@pytest.mark.parametrize("name", ["file.txt", ".partial-file.txt"])
def test_no_link_is_followed(folder, name):
    (folder / "victim").write_text("keep")
    (folder / name).symlink_to("victim")
    if name == "file.txt":
        with pytest.raises(OSError, match="is a link; expected a file of its own"):
            write_text(folder / "file.txt", "mine")
    else:
        write_text(folder / "file.txt", "mine")
    assert (folder / "victim").read_text() == "keep"


@pytest.mark.parametrize(("name", "target"), [("plan.csv", "../victim"), ("figures", "../theirs")])
def test_a_run_with_links_in_it_is_not_continued(folder, name, target):
    (folder / "run").mkdir()
    Journal.create(folder / "run")
    (folder / "run" / name).symlink_to(target)
    with pytest.raises(RunFolderError, match=f"run/{name}: is a link; expected the files and folders of the run"):
        resumed(folder / "run", None)


@pytest.mark.parametrize(
    ("out", "why"),
    [
        ("empty/.", None),
        ("link", None),
        ("dangling", None),
        (".", r"\.: is the current folder"),
        ("new/..", "is the current folder"),
        ("fifo", "is a file"),
        ("x" * 300, "cannot be written: File name too long"),
        ("a\0b", "no folder can have this name"),
    ],
)
def test_an_out_that_cannot_be_used_is_found_before_anything_is_computed(tmp_path, monkeypatch, out, why):
    (tmp_path / "here" / "empty").mkdir(parents=True)
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    if out in (".", "new/.."):
        Path("empty").rmdir()
    elif out == "fifo":
        os.mkfifo("fifo")
    else:
        Path("link").symlink_to(tmp_path / "elsewhere")
        Path("dangling").symlink_to(tmp_path / "nowhere")
    if why is not None:
        with pytest.raises(RunFolderError, match=why), new_run("t", Path(out)):
            pytest.fail("the block was entered")
        return
    with new_run("t", Path(out)) as run:
        (run.folder / "file").write_text("x")
    assert (Path(out) / "file").read_text() == "x"


# Streams --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("closed", ["2>&-", ">&-", "<&- >&- 2>&-"])
def test_a_closed_stream_is_no_mistake(tmp_path, closed):
    command = f"{sys.executable} -m robustopt validate {WAITER} contact.friction=x {closed}; echo $? > code"
    subprocess.run(["sh", "-c", command], cwd=tmp_path, capture_output=True, timeout=120)
    assert (tmp_path / "code").read_text() == "2\n"
    command = f"{sys.executable} -m robustopt runs {tmp_path} {closed}; echo $? > code"
    done = subprocess.run(["sh", "-c", command], cwd=tmp_path, capture_output=True, text=True, timeout=120)
    assert (tmp_path / "code").read_text() == "0\n"
    assert "Traceback" not in done.stdout + done.stderr


def test_warnings_of_libraries_are_notes(capsys, monkeypatch):
    monkeypatch.setattr(warnings, "showwarning", warnings.showwarning)
    with warnings.catch_warnings():
        warnings.simplefilter("always")
        for quiet in (False, True):
            show_warnings_as_notes(quiet)
            warnings.warn("a glyph\n is missing", UserWarning, stacklevel=1)
    assert capsys.readouterr() == ("", "note: a glyph is missing\n")


def test_too_little_memory_is_said(run, monkeypatch):
    def too_large(*_: object) -> None:
        raise MemoryError("Unable to allocate 41 GiB")

    monkeypatch.setattr(app, "check_task", too_large)
    code, out, err = run("validate", WAITER)
    assert (code, out) == (2, "")
    assert (
        err == "error: the memory is not enough: Unable to allocate 41 GiB; expected a smaller task, or fewer workers\n"
    )
    assert json.loads(run("validate", WAITER, "--json")[1])["error"]["kind"] == "MemoryError"


def test_large_broken_files_take_seconds_and_little_memory(folder):
    """Patterns that could go through the text again from each of its characters."""
    limits = resource.getrlimit(resource.RLIMIT_AS)
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + 2_000_000_000, limits[1]))
    try:
        for text in ("<a '", "<!-", "<a b=", "<!--", "<a>", '<a b="', "</a"):
            with pytest.raises(RobustOptError):
                robot_of("<mujoco>" + text * (1_000_000 // len(text)))
    finally:
        resource.setrlimit(resource.RLIMIT_AS, limits)
