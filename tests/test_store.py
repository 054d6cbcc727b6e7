"""Run folders: whole or not at all, and with their origin."""

import errno
import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from robustopt.config import Config
from robustopt.config.load import dump, load_config
from robustopt.errors import RunFolderError
from robustopt.models import MODELS
from robustopt.runs import origin, store
from robustopt.runs.origin import write_origin
from robustopt.runs.records import Checkout, LimitMargin, RunStatus, Summary
from robustopt.runs.store import (
    CONFIG,
    JOURNAL,
    PROVENANCE,
    SUMMARY,
    json_text,
    new_run,
    read_provenance,
    read_summary,
    write_record,
)

MODEL = MODELS / "tx90l.xml"


def config() -> Config:
    return Config.model_validate(
        {"name": "t", "robot": {"model": "tx90l"}, "tray": {"size": (1, 1, 1), "mass": 1}, "path": {}, "seed": 7}
    )


SOLVED = Summary(kind="plan", name="t", status=RunStatus.SOLVED, message="Solved.", duration=1 / 3)


def fill(folder: Path) -> None:
    write_origin(folder, config(), ["plan", "t.yaml"])
    write_record(folder / SUMMARY, SOLVED)


def test_a_run_appears_at_the_end_of_its_block_and_not_before(tmp_path):
    with new_run("task", root=tmp_path) as run:
        fill(run.folder)
        assert not run.place.exists()
        assert not any((tmp_path / "task").glob("[!.]*"))
    assert run.place.parent == tmp_path / "task"
    assert [entry.name for entry in (tmp_path / "task").iterdir()] == [run.place.name]
    assert read_summary(run.place) == SOLVED


def test_runs_of_the_same_second_get_numbers(tmp_path, monkeypatch):
    class Clock(store.datetime):
        @classmethod
        def now(cls, tz=None):
            return cls(2026, 1, 2, 3, 4, 5, tzinfo=tz)

    monkeypatch.setattr(store, "datetime", Clock)
    places = []
    for _ in range(3):
        with new_run("task", root=tmp_path) as run:
            fill(run.folder)
        places.append(run.place.name)
    assert places == ["2026-01-02T03-04-05Z", "2026-01-02T03-04-05Z-2", "2026-01-02T03-04-05Z-3"]


def test_runs_written_at_the_same_time_do_not_meet(tmp_path):
    program = (
        "import sys; from pathlib import Path; from robustopt.runs.store import new_run\n"
        "with new_run('task', root=Path(sys.argv[1])) as run:\n"
        "    (run.folder / 'file').write_text('x')\n"
    )
    workers = [subprocess.Popen([sys.executable, "-c", program, str(tmp_path)]) for _ in range(4)]
    assert [worker.wait() for worker in workers] == [0] * 4
    runs = list((tmp_path / "task").iterdir())
    assert len(runs) == 4
    assert all((run / "file").read_text() == "x" for run in runs)


@pytest.mark.parametrize("existing", [False, True])
def test_out_is_the_run_folder_itself(tmp_path, existing):
    out = tmp_path / "deep" / "run"
    if existing:
        out.mkdir(parents=True)
    with new_run("task", out) as run:
        fill(run.folder)
    assert run.place == out
    assert {entry.name for entry in out.iterdir()} == {PROVENANCE, CONFIG, SUMMARY}


def test_a_folder_with_something_in_it_is_refused_before_anything_is_computed(tmp_path):
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "notes.txt").write_text("keep")
    (tmp_path / "file").write_text("keep")
    with new_run("task", tmp_path / "earlier") as run:
        fill(run.folder)
    cases = [("mine", "is not empty"), ("file", "is a file"), ("earlier", "holds an earlier run of robustopt")]
    for name, message in cases:
        with pytest.raises(RunFolderError, match=f"{message}; expected a new folder"), new_run("t", tmp_path / name):
            pytest.fail("the block was entered")
    assert (tmp_path / "mine" / "notes.txt").read_text() == "keep"
    assert {entry.name for entry in tmp_path.iterdir()} == {"mine", "file", "earlier"}


@pytest.mark.parametrize("place", ["file/run", "/proc/run"])
def test_a_place_that_cannot_be_written_is_found_before_anything_is_computed(tmp_path, place):
    (tmp_path / "file").write_text("a regular file")
    message = r"cannot be written: .*; expected a writable folder"
    with pytest.raises(RunFolderError, match=message), new_run("task", tmp_path / place):
        pytest.fail("the block was entered")


KILLED = (
    "import os, sys; from pathlib import Path; from robustopt.runs.store import new_run\n"
    "with new_run('task', Path(sys.argv[1])) as run:\n"
    "    (run.folder / 'file').write_text('x')\n"
    "    print('begun', flush=True); sys.stdin.read()\n"
)


def test_folders_that_a_killed_process_left_are_removed_by_the_next_run_beside_them(tmp_path):
    writing = [
        subprocess.Popen(
            [sys.executable, "-c", KILLED, str(tmp_path / name)], stdin=subprocess.PIPE, stdout=subprocess.PIPE
        )
        for name in ("killed", "alive")
    ]
    for process in writing:
        assert process.stdout is not None
        assert process.stdout.readline() == b"begun\n"
    writing[0].kill()
    writing[0].communicate()
    elsewhere = tmp_path / f".other.partial-another.machine-{writing[0].pid}"
    elsewhere.mkdir()
    mine = tmp_path / ".notes.partial-mine"
    mine.mkdir()
    assert len(list(tmp_path.glob(".*"))) == 4
    with new_run("task", tmp_path / "next") as run:
        fill(run.folder)
    left = {path.name for path in tmp_path.iterdir()}
    assert not any(name.startswith(".killed") for name in left)
    assert any(name.startswith(".alive") for name in left)
    assert {elsewhere.name, mine.name, "next"} < left
    writing[1].communicate()
    assert writing[1].returncode == 0
    assert (tmp_path / "alive" / "file").read_text() == "x"


def test_a_second_interruption_does_not_stop_the_cleaning_up(tmp_path, monkeypatch):
    remove = store.shutil.rmtree

    def interrupted(*arguments, **options):
        signal.raise_signal(signal.SIGINT)
        remove(*arguments, **options)

    monkeypatch.setattr(store.shutil, "rmtree", interrupted)
    with pytest.raises(KeyboardInterrupt), new_run("task", root=tmp_path):
        raise KeyboardInterrupt
    assert not list(tmp_path.rglob("*"))


@pytest.mark.parametrize("error", [KeyboardInterrupt, ValueError, SystemExit])
def test_a_block_that_fails_leaves_nothing_behind(tmp_path, error):
    def block() -> None:
        with new_run("task", root=tmp_path / "results") as run:
            fill(run.folder)
            raise error

    with pytest.raises(error):
        block()
    assert list(tmp_path.iterdir()) == []


def test_other_runs_survive_a_block_that_fails(tmp_path):
    with new_run("task", root=tmp_path) as kept:
        fill(kept.folder)
    with pytest.raises(KeyboardInterrupt), new_run("task", root=tmp_path):
        raise KeyboardInterrupt
    assert [entry.name for entry in (tmp_path / "task").iterdir()] == [kept.place.name]


def test_a_full_disk_is_an_error_that_leaves_nothing_behind(tmp_path, monkeypatch):
    def full(handle: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(store.os, "fsync", full)
    out = tmp_path / "results" / "run"
    with pytest.raises(RunFolderError, match="could not be written: No space left on device"), new_run("t", out) as run:
        fill(run.folder)
    assert list(tmp_path.iterdir()) == []


def test_the_origin_says_what_it_takes_to_run_again(tmp_path):
    write_origin(tmp_path, config(), ["plan", "t.yaml", "seed=7"])
    written = read_provenance(tmp_path)
    assert written.arguments == ("robustopt", "plan", "t.yaml", "seed=7")
    assert written.seed == 7
    assert written.versions["python"] == ".".join(map(str, sys.version_info[:3]))
    assert {"robustopt", "numpy", "scipy", "mujoco", "casadi", "highspy", "numba"} <= set(written.versions)
    assert all(written.versions.values())
    assert written.machine.cpus == os.cpu_count()
    assert (tmp_path / CONFIG).read_text() == dump(config())
    digest = subprocess.run(["sha256sum", tmp_path / CONFIG, MODEL], capture_output=True, text=True, check=True).stdout
    assert [line.split()[0] for line in digest.splitlines()] == [
        written.config_sha256,
        written.robot_model.sha256,
    ]


def test_the_stored_configuration_plans_the_same_task(tmp_path):
    write_origin(tmp_path, config(), [])
    with pytest.raises(Exception, match="exactly one of tray_poses, tool_poses, joints and steps"):
        load_config(tmp_path / CONFIG)
    again = load_config(tmp_path / CONFIG, ["path={joints: [[0, 0], [1, 1]]}"])
    assert again.seed == 7


def test_the_commit_is_that_of_the_package_and_of_no_other_checkout(tmp_path):
    def git(*arguments: str) -> str:
        identity = ["-c", "user.name=t", "-c", "user.email=t@example.org", "-c", "commit.gpgsign=false"]
        done = subprocess.run(["git", *identity, *arguments], cwd=tmp_path, capture_output=True, text=True, check=True)
        return done.stdout.strip()

    assert origin._git(tmp_path) is None
    git("init", "-q")
    (tmp_path / "file").write_text("1")
    git("add", "file")
    git("commit", "-qm", "first")
    assert origin._git(tmp_path) == Checkout(commit=git("rev-parse", "HEAD"), dirty=False)
    (tmp_path / "file").write_text("2")
    assert origin._git(tmp_path).dirty is True
    (tmp_path / "site-packages").mkdir()
    assert origin._git(tmp_path / "site-packages") is None


def test_numbers_that_json_does_not_know_become_null(tmp_path):
    text = json_text({"a": float("inf"), "b": [float("nan"), 1.5], "c": {"d": 2}})
    assert json.loads(text) == {"a": None, "b": [None, 1.5], "c": {"d": 2}}
    write_record(tmp_path / "a.json", LimitMargin(on_grid=float("-inf"), between=0.5))
    assert json.loads((tmp_path / "a.json").read_text()) == {"on_grid": None, "between": 0.5}


def test_a_summary_holds_the_sections_that_it_was_given(tmp_path):
    fill(tmp_path)
    data = json.loads((tmp_path / SUMMARY).read_text())
    assert data == {"kind": "plan", "name": "t", "status": "solved", "message": "Solved.", "duration": 1 / 3}
    with pytest.raises(ValueError, match="status"):
        Summary.model_validate(data | {"status": "excellent"})


@pytest.mark.parametrize(
    ("change", "found"),
    [
        ({"duration": "x"}, "duration: Input should be a valid number"),
        ({"status": "excellent"}, "status: Input should be 'solved', "),
        ({"certificate": {"a": 1}}, "certificate.passed: Field required"),
        ({"learner": {}}, "learner: Extra inputs are not permitted"),
    ],
)
def test_a_summary_that_was_changed_is_refused_with_the_field(tmp_path, change, found):
    fill(tmp_path)
    data = json.loads((tmp_path / SUMMARY).read_text())
    (tmp_path / SUMMARY).write_text(json.dumps(data | change))
    with pytest.raises(RunFolderError) as caught:
        read_summary(tmp_path)
    start = f"{tmp_path / SUMMARY}: cannot be read: it has been changed, or is of another version of robustopt ({found}"
    assert str(caught.value).startswith(start)


def test_a_folder_that_is_no_run_is_not_read(tmp_path):
    with pytest.raises(RunFolderError, match="no such run folder"):
        read_summary(tmp_path / "none")
    with pytest.raises(RunFolderError, match="not a run folder of robustopt"):
        read_summary(tmp_path)
    (tmp_path / JOURNAL).touch()
    with pytest.raises(RunFolderError, match="unfinished; expected a complete run: robustopt learn --resume --out"):
        read_summary(tmp_path)
    fill(tmp_path)
    (tmp_path / SUMMARY).write_text("{")
    with pytest.raises(RunFolderError, match="cannot be read"):
        read_summary(tmp_path)


def test_arguments_that_are_no_text_for_the_system_are_kept(tmp_path):
    given = ("täsk.yaml".encode(), b"\xe4")  # in a locale of ASCII; in another encoding
    arguments = ["plan", *(name.decode("ascii", "surrogateescape") for name in given)]
    write_origin(tmp_path, config(), arguments)
    assert read_provenance(tmp_path).arguments == ("robustopt", "plan", "täsk.yaml", "\ufffd")
