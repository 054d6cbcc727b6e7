"""The journal: what is read is what was written, by one process at a time, and damage is said."""

import shutil
import sqlite3
import subprocess
import sys
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from robustopt.errors import RunFolderError, RunInUse
from robustopt.evidence import Failure, Peak
from robustopt.learning.learner import Belief
from robustopt.learning.moments import ErrorInterval, Moments
from robustopt.learning.outcomes import Executed
from robustopt.runs import journal as journal_module
from robustopt.runs.journal import MANUAL, SIMULATION, Execution, Journal
from robustopt.runs.store import JOURNAL

random = np.random.default_rng(4)
AWKWARD = (0.1 + 0.2, -0.0, 5e-324, 1.7976931348623157e308, 1 / 3, np.nextafter(1.0, 2.0).item())


def numbers(size: int) -> tuple[float, ...]:
    """Floats of all magnitudes: their bits are random."""
    bits = random.integers(0, 2**64, size=4 * size, dtype=np.uint64).view(float)
    return tuple(bits[np.isfinite(bits)][:size].tolist())


def bits(values: tuple[float, ...]) -> bytes:
    return np.array(values).tobytes()


BELIEFS = [
    Belief(),
    Belief(0.1 + 0.2),
    Belief(1 / 3, ErrorInterval(AWKWARD, numbers(6), 1.3, 0.125)),
    Belief(None, ErrorInterval((), (), 2.0)),
    Belief(parameters=(("contact.friction.upper", 0.7), ("objects.upper.mass", 0.1))),
]


def execution(number: int, success: bool = True, moments: Moments | None = None) -> Execution:
    moments = moments or Moments(7 * number + 1, numbers(6), numbers(6))
    if success:
        return Execution(number, Executed(True, moments, None, (Peak("a", 1 / 3, None),), (numbers(6), AWKWARD)))
    failure = Failure("slid", 'a "block", ü', "tray", 0.1 + 0.2, 1 / 3)
    return Execution(number, Executed(False, moments, failure, (Peak("a", 0.1, 5e-324), Peak("b", None, 0.2))))


def begun(folder: Path, executor: str = SIMULATION) -> Journal:
    Journal.create(folder, executor)
    return Journal.open(folder)


def test_everything_reads_back_bit_for_bit_after_the_file_was_closed(tmp_path):
    journal = begun(tmp_path)
    written = []
    for i, belief in enumerate(BELIEFS):
        duration = None if i == 1 else AWKWARD[i]
        journal.add_plan(belief, duration)
        done = [execution(10 * i + k, success=k != 1) for k in range(i)]
        done += [execution(10 * i + 8, moments=Moments(6, AWKWARD, AWKWARD)), execution(10 * i + 9, False, Moments())]
        journal.add_executions(1.05 if i == 3 else 1.0, done)
        written.append((belief, duration, done))
    journal.close()
    entries = list(Journal.open(tmp_path).entries())
    assert len(entries) == len(BELIEFS)
    for (belief, duration, done), entry in zip(written, entries, strict=True):
        assert entry.belief == belief
        assert entry.duration == duration
        if belief.error is not None:
            assert entry.belief.error is not None
            assert bits(entry.belief.error.mean) == bits(belief.error.mean)
            assert bits(entry.belief.error.deviation) == bits(belief.error.deviation)
        assert [item for _, item in entry.executions] == done
        for (speed, found), item in zip(entry.executions, done, strict=True):
            assert speed == (1.05 if belief is BELIEFS[3] else 1.0)
            assert bits(found.outcome.errors.total) == bits(item.outcome.errors.total)
            assert bits(found.outcome.errors.squares) == bits(item.outcome.errors.squares)
            assert found.outcome.success is item.outcome.success


def test_errors_that_are_not_finite_read_back(tmp_path):
    journal = begun(tmp_path)
    journal.add_plan(Belief(0.5), 1.0)
    journal.add_executions(1.0, [execution(0, moments=Moments(1, (np.inf, -np.inf), (np.nan, 0.0)))])
    (_, found), *_ = next(journal.entries()).executions
    assert bits(found.outcome.errors.total) == bits((np.inf, -np.inf))
    assert np.isnan(found.outcome.errors.squares[0])


def test_fresh_executions_belong_to_their_plan(tmp_path):
    journal = begun(tmp_path)
    for mu in (1.0, 0.5):
        journal.add_plan(Belief(mu), 1.0)
    journal.add_judgements(0, [execution(5), execution(6, success=False)])
    journal.add_judgements(1, [execution(5, success=False)])
    journal.close()
    journal = Journal.open(tmp_path)
    assert journal.judgements(0) == {5: (True, "success"), 6: (False, "slid")}
    assert journal.judgements(1) == {5: (False, "slid")}
    assert journal.judgements(2) == {}


@pytest.mark.parametrize("executor", [SIMULATION, MANUAL])
def test_it_knows_who_executes(tmp_path, executor):
    assert begun(tmp_path, executor).executor == executor
    assert Journal.in_memory().executor == SIMULATION


def test_a_batch_is_written_as_a_whole_or_not_at_all(tmp_path):
    journal = begun(tmp_path)
    journal.add_plan(Belief(0.5), 1.0)
    journal.add_executions(1.0, [execution(0)])
    with pytest.raises(RunFolderError, match="cannot be written: UNIQUE constraint failed"):
        journal.add_executions(1.0, [execution(1), execution(0)])
    assert [item.number for _, item in next(journal.entries()).executions] == [0]
    journal.add_executions(1.0, [execution(1)])


HOLD = """
import sys
from pathlib import Path
from robustopt.runs.journal import Journal
from robustopt.learning.learner import Belief
journal = Journal.open(Path(sys.argv[1]))
journal.add_plan(Belief(0.5), 1.0)
print("held", flush=True)
sys.stdin.read()
"""


@pytest.fixture
def holder(tmp_path):
    """A process that holds the journal in `tmp_path`."""
    Journal.create(tmp_path)
    process = subprocess.Popen(
        [sys.executable, "-c", HOLD, str(tmp_path)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "held\n"
    yield process
    process.kill()
    process.communicate()


def test_a_second_process_is_refused_until_the_first_is_gone(tmp_path, holder, monkeypatch):
    monkeypatch.setattr(journal_module, "PATIENCE", 0.1)
    for _ in range(2):
        with pytest.raises(RunInUse, match="another process is at work on this run; expected to be the only one"):
            Journal.open(tmp_path)
    holder.kill()
    holder.wait()
    assert [entry.belief for entry in Journal.open(tmp_path).entries()] == [Belief(0.5)]


def test_an_open_journal_is_held_before_anything_is_written(tmp_path, monkeypatch):
    monkeypatch.setattr(journal_module, "PATIENCE", 0.1)
    journal = begun(tmp_path)
    with pytest.raises(RunInUse):
        Journal.open(tmp_path)
    journal.close()
    Journal.open(tmp_path).close()


def filled(folder: Path) -> Path:
    journal = begun(folder)
    journal.add_plan(Belief(0.5), 1.0)
    for k in range(200):
        journal.add_executions(1.0, [execution(k)])
    journal.close()
    return folder / JOURNAL


@pytest.mark.parametrize("content", [b"", b"not a database at all, but long enough to be looked at" * 100])
def test_a_file_that_is_no_journal_is_refused(tmp_path, content):
    (tmp_path / JOURNAL).write_bytes(content)
    with pytest.raises(RunFolderError, match="not a journal of robustopt, or damaged"):
        Journal.open(tmp_path)
    if content:
        assert (tmp_path / JOURNAL).read_bytes() == content


def test_another_database_is_refused(tmp_path):
    with sqlite3.connect(tmp_path / JOURNAL) as other:
        other.execute("CREATE TABLE plans (name TEXT)")
    other.close()
    with pytest.raises(RunFolderError, match="not a journal of robustopt"):
        Journal.open(tmp_path)


def test_a_missing_journal_is_not_made(tmp_path):
    with pytest.raises(RunFolderError, match="no such file"):
        Journal.open(tmp_path)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("part", [0.3, 0.6, 0.9])
def test_a_journal_cut_short_is_damaged(tmp_path, part):
    path = filled(tmp_path)
    content = path.read_bytes()
    path.write_bytes(content[: int(part * len(content))])
    with pytest.raises(RunFolderError, match="damaged"):
        Journal.open(tmp_path)


def test_pages_that_were_overwritten_are_damage(tmp_path):
    path = filled(tmp_path)
    content = bytearray(path.read_bytes())
    middle = len(content) // 2
    content[middle : middle + 4096] = bytes(4096)
    path.write_bytes(content)
    with pytest.raises(RunFolderError, match="damaged"):
        Journal.open(tmp_path)


@pytest.mark.parametrize(
    ("command", "found"),
    [
        ("UPDATE plans SET belief = '{' WHERE plan = 1", "plan 1"),
        ("UPDATE plans SET duration = x'00ff' WHERE plan = 1", "plan 1"),
        ("UPDATE executions SET total = '[1, \"x' WHERE number = 0", "execution 0"),
        ("UPDATE executions SET total = 'null' WHERE number = 0", "execution 0"),
        ("UPDATE executions SET success = 1 - success WHERE number = 0", "execution 0"),
    ],
)
@pytest.mark.parametrize("old", [False, True])
def test_entries_that_make_no_sense_are_damage(tmp_path, command, found, old):
    journal = begun(tmp_path)
    for k in range(2):
        journal.add_plan(Belief(0.5), 1.0)
        journal.add_executions(1.0, [execution(k)])
    journal.close()
    with sqlite3.connect(tmp_path / JOURNAL) as other:
        other.execute(command)
    other.close()
    if old:
        without_checksums(tmp_path / JOURNAL)
        if "1 - success" in command:  # nothing tells
            return
    with pytest.raises(RunFolderError, match=f"damaged: {'(plan|execution) ' if old else found}"):
        list(Journal.open(tmp_path).entries())


OLD_TABLES = """
CREATE TABLE origin (executor TEXT NOT NULL);
CREATE TABLE plans (plan INTEGER PRIMARY KEY, belief TEXT NOT NULL, duration REAL);
CREATE TABLE executions (
    number INTEGER PRIMARY KEY, plan INTEGER NOT NULL REFERENCES plans, speed REAL NOT NULL, success INTEGER NOT NULL,
    status TEXT NOT NULL, what TEXT NOT NULL, t REAL, s REAL,
    count INTEGER NOT NULL, total TEXT NOT NULL, squares TEXT NOT NULL
);
CREATE TABLE judgements (
    plan INTEGER NOT NULL REFERENCES plans, number INTEGER NOT NULL, success INTEGER NOT NULL, status TEXT NOT NULL,
    PRIMARY KEY (plan, number)
);
"""


def without_checksums(path: Path) -> None:
    """Make a journal one of version 0.1."""
    with closing(sqlite3.connect(path, isolation_level=None)) as connection:
        tables = ("origin", "plans", "executions", "judgements")
        rows = {table: connection.execute(f"SELECT * FROM {table}").fetchall() for table in tables}
        for table in tables:
            connection.execute(f"DROP TABLE {table}")
        connection.executescript(OLD_TABLES)
        for table in tables:
            for row in rows[table]:
                values = row[: -2 if table == "executions" else -1]
                connection.execute(f"INSERT INTO {table} VALUES ({', '.join('?' * len(values))})", values)


def test_a_journal_of_an_earlier_version_is_continued(tmp_path):
    journal = begun(tmp_path)
    journal.add_plan(Belief(0.5), 1.0)
    journal.add_executions(1.0, [execution(0)])
    journal.close()
    without_checksums(tmp_path / JOURNAL)
    with closing(Journal.open(tmp_path)) as journal:
        journal.add_executions(1.0, [execution(1, success=False)])
        journal.add_plan(Belief(0.25), None)
        journal.add_judgements(0, [execution(7)])
    with closing(Journal.open(tmp_path)) as journal:
        first, second = journal.entries()
        assert [item.outcome.success for _, item in first.executions] == [True, False]
        assert (second.belief, second.duration) == (Belief(0.25), None)
        assert journal.judgements(0) == {7: (True, "success")}
        assert journal.executor == SIMULATION


def content(folder: Path) -> list[object]:
    with closing(Journal.open(folder)) as journal:
        return [journal.executor, list(journal.entries()), journal.judgements(0), journal.judgements(1)]


def small(folder: Path) -> bytes:
    """A journal with small pages: two plans, three executions and two judgements."""
    Journal.create(folder, MANUAL)
    with closing(sqlite3.connect(folder / JOURNAL, isolation_level=None)) as connection:
        connection.execute("PRAGMA page_size = 512")
        connection.execute("VACUUM")
    with closing(Journal.open(folder)) as journal:
        for k in range(2):
            journal.add_plan(BELIEFS[k], 1.5)
            journal.add_executions(1.0, [execution(k, success=not k, moments=Moments(2, (0.1,), (0.2,)))])
        journal.add_judgements(0, [execution(5), execution(6, success=False)])
    return (folder / JOURNAL).read_bytes()


@pytest.mark.parametrize("every", [29, pytest.param(1, marks=pytest.mark.slow)])
def test_no_flipped_bit_changes_what_is_read(tmp_path, every):
    whole = small(tmp_path)
    before, refused = content(tmp_path), 0
    for bit in range(0, 8 * len(whole), every):
        changed = bytearray(whole)
        changed[bit // 8] ^= 1 << bit % 8
        (tmp_path / JOURNAL).write_bytes(changed)
        try:
            assert content(tmp_path) == before, f"bit {bit}"
        except RunFolderError:
            refused += 1
    assert refused > 0.1 * 8 * len(whole) / every


@pytest.mark.skipif(sys.platform == "win32", reason="links need rights")
@pytest.mark.parametrize("name", [JOURNAL, f"{JOURNAL}-journal"])
def test_a_link_in_place_of_a_journal_is_refused(tmp_path, name):
    Journal.create(tmp_path)
    (tmp_path / name).unlink(missing_ok=True)
    (tmp_path / "victim").write_bytes(b"keep")
    (tmp_path / name).symlink_to(tmp_path / "victim")
    with pytest.raises(RunFolderError, match=f"{name}: is a link; expected the files of the run"):
        Journal.open(tmp_path)
    assert (tmp_path / "victim").read_bytes() == b"keep"


def test_a_full_disk_is_said_and_what_was_written_is_kept(tmp_path):
    journal = begun(tmp_path)
    journal.add_plan(Belief(0.5), 1.0)
    journal.add_executions(1.0, [execution(0)])
    pages = journal._connection.execute("PRAGMA page_count").fetchone()[0]
    journal._connection.execute(f"PRAGMA max_page_count = {pages + 1}")
    many = [execution(k) for k in range(1, 1000)]
    journal.add_executions(1.0, many[:1])
    with pytest.raises(RunFolderError, match="cannot be written: database or disk is full"):
        journal.add_executions(1.0, many[1:])
    kept = [item.number for _, item in next(journal.entries()).executions]
    journal.close()
    assert kept == [0, 1]
    assert [item.number for _, item in next(Journal.open(tmp_path).entries()).executions] == kept


def test_a_folder_that_cannot_be_written_is_said(tmp_path):
    (tmp_path / JOURNAL).mkdir()
    with pytest.raises(RunFolderError, match="cannot be written: unable to open database file"):
        Journal.create(tmp_path)


TORN = """
import os, sqlite3, sys
connection = sqlite3.connect(sys.argv[1], isolation_level=None)
connection.execute("PRAGMA cache_size = 1")
connection.execute("BEGIN")
for k in range(2000):
    connection.execute("INSERT INTO judgements VALUES (0, ?, 1, ?, '')", (k, "x" * 100))
print(os.path.exists(sys.argv[1] + "-journal"), flush=True)
os.kill(os.getpid(), 9)
"""


@pytest.mark.skipif(sys.platform == "win32", reason="Windows does not move what is open")
@pytest.mark.parametrize("moved", [True, False])
def test_a_folder_that_is_moved_or_removed_is_said_and_what_was_written_is_kept(tmp_path, moved):
    (tmp_path / "a").mkdir()
    Journal.create(tmp_path / "a")
    with closing(Journal.open(tmp_path / "a")) as journal:
        journal.add_plan(Belief(), 1.0)
        (tmp_path / "a").rename(tmp_path / "b")
        if not moved:
            shutil.rmtree(tmp_path / "b")
        with pytest.raises(RunFolderError, match="was moved or removed while its run was at work"):
            journal.add_plan(Belief(), 2.0)
    if moved:
        with closing(Journal.open(tmp_path / "b")) as journal:
            assert [entry.duration for entry in journal.entries()] == [1.0, 2.0]


def test_a_transaction_that_a_kill_left_half_written_is_undone(tmp_path):
    path = filled(tmp_path)
    before = path.read_bytes()
    done = subprocess.run([sys.executable, "-c", TORN, str(path)], capture_output=True, text=True)
    assert (done.stdout, done.returncode) == ("True\n", -9)
    assert path.read_bytes() != before
    journal = Journal.open(tmp_path)
    assert journal.judgements(0) == {}
    assert len(next(journal.entries()).executions) == 200
