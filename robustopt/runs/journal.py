"""The memory of a learner: every plan and every execution, committed to a SQLite file as it happens.

A journal holds events, not conclusions: told to the learner again, in order, they give the same state. So a process
that is killed at any moment loses at most the executions that were under way, and they come out the same when they are
run again. One process at a time may hold a journal. Every row has a checksum, because SQLite notices damage to its own
structure alone; the journals of earlier versions have none.
"""

from __future__ import annotations

import hashlib
import json
import os
import sqlite3
from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass
from math import isnan
from pathlib import Path
from typing import Any, Literal

from pydantic import TypeAdapter, ValidationError

from robustopt.errors import RunFolderError, RunInUse
from robustopt.evidence import Failure, Peak
from robustopt.learning.learner import Belief, Executed
from robustopt.learning.moments import Moments
from robustopt.runs.store import JOURNAL

SIMULATION, MANUAL = "simulation", "manual"

PATIENCE = 1.0
"""Time to wait for another process that only looks whether a journal is in use [s]."""

_TABLES = """
CREATE TABLE origin (
    executor TEXT NOT NULL,         -- simulation or manual: executions are never mixed
    checksum TEXT NOT NULL          -- of the other values of the row, as all that follow
);
CREATE TABLE plans (
    plan INTEGER PRIMARY KEY,       -- in the order in which the learner asked, from 0
    belief TEXT NOT NULL,           -- the learner's values for the plan, JSON
    duration REAL,                  -- [s]; NULL without a plan
    checksum TEXT NOT NULL
);
CREATE TABLE executions (
    number INTEGER PRIMARY KEY,     -- of this learner, from 0; its random stream belongs to it
    plan INTEGER NOT NULL REFERENCES plans,
    speed REAL NOT NULL,            -- times the plan's
    success INTEGER NOT NULL,
    status TEXT NOT NULL, what TEXT NOT NULL, t REAL, s REAL,  -- the first failure: time [s] and place on the path
    count INTEGER NOT NULL, total TEXT NOT NULL, squares TEXT NOT NULL,  -- acceleration error, as in `Moments`, JSON
    evidence TEXT NOT NULL,         -- the rest of what it showed, JSON; earlier versions have none
    checksum TEXT NOT NULL
);
CREATE TABLE judgements (           -- fresh executions, which estimate the success rate of a plan
    plan INTEGER NOT NULL REFERENCES plans,
    number INTEGER NOT NULL,
    success INTEGER NOT NULL,
    status TEXT NOT NULL,
    checksum TEXT NOT NULL,
    PRIMARY KEY (plan, number)
);
"""


@dataclass(frozen=True)
class _Evidence:
    """What the column `evidence` of an execution holds; see `Failure` and `Executed`."""

    against: str = ""
    peaks: tuple[Peak, ...] = ()
    error_series: tuple[tuple[float, ...], ...] = ()


_BELIEF: TypeAdapter[Belief] = TypeAdapter(Belief)
_EVIDENCE: TypeAdapter[_Evidence] = TypeAdapter(_Evidence)

_ROWS: dict[str, TypeAdapter[Any]] = {
    "origin": TypeAdapter(tuple[Literal["simulation", "manual"]]),
    "plans": TypeAdapter(tuple[int, str, float | None]),
    "executions": TypeAdapter(
        tuple[int, int, float, Literal[0, 1], str, str, float | None, float | None, int, str, str, str]
    ),
    "judgements": TypeAdapter(tuple[int, int, Literal[0, 1], str]),
}
"""Types of the rows of each table without their checksum."""


@dataclass(frozen=True)
class Execution:
    """One execution of a plan: its number, which has a random stream of its own, and all that it showed."""

    number: int
    outcome: Executed


@dataclass(frozen=True)
class Entry:
    """Plan with its executions and their speeds, in the order of their numbers."""

    belief: Belief
    duration: float | None
    executions: tuple[tuple[float, Execution], ...]


class Journal:
    """Plans and executions in a SQLite file that this process alone holds, or in memory."""

    def __init__(self, connection: sqlite3.Connection, path: Path | None = None) -> None:
        self._connection, self._path = connection, path
        self._place = "memory" if path is None else str(path)
        columns = connection.execute("SELECT name FROM pragma_table_info('executions')").fetchall()
        self._summed, self._evident = (("checksum",) in columns), (("evidence",) in columns)

    @staticmethod
    def in_memory() -> Journal:
        """Return a journal that ends with the process."""
        connection = sqlite3.connect(":memory:", isolation_level=None)
        connection.executescript(_TABLES)
        connection.execute("INSERT INTO origin VALUES (?, ?)", _with_checksum((SIMULATION,)))
        return Journal(connection)

    @staticmethod
    def create(folder: Path, executor: str = SIMULATION) -> None:
        """Write an empty journal into a folder.

        Args:
            folder: folder of the run.
            executor: SIMULATION or MANUAL.

        Raises:
            RunFolderError: the journal cannot be written.
        """
        path = folder / JOURNAL
        try:
            with closing(sqlite3.connect(path, isolation_level=None)) as connection:
                connection.executescript(f"BEGIN; {_TABLES} COMMIT;")
                connection.execute("INSERT INTO origin VALUES (?, ?)", _with_checksum((executor,)))
        except sqlite3.DatabaseError as error:
            raise RunFolderError(f"{path}: cannot be written: {error}") from None

    @staticmethod
    def open(folder: Path) -> Journal:
        """Return the journal in a folder, locked until it is closed or the process ends.

        Args:
            folder: folder of the run.

        Raises:
            RunInUse: another process holds the journal.
            RunFolderError: the file is no journal, or is damaged.
        """
        path = folder / JOURNAL
        if not os.path.isfile(path):
            raise RunFolderError(f"{path}: no such file; expected the journal of a run of `robustopt learn`")
        for name in (JOURNAL, f"{JOURNAL}-journal", f"{JOURNAL}-wal", f"{JOURNAL}-shm"):  # SQLite would write to them
            if (folder / name).is_symlink():
                raise RunFolderError(f"{folder / name}: is a link; expected the files of the run themselves")
        connection = sqlite3.connect(path, timeout=PATIENCE, isolation_level=None)
        try:
            _hold(connection)
            _require_sound(connection)
        except (sqlite3.DatabaseError, UnicodeDecodeError) as error:
            connection.close()
            if getattr(error, "sqlite_errorcode", 0) & 0xFF == sqlite3.SQLITE_BUSY:  # the rest says which kind of it
                raise RunInUse(
                    f"{folder}: another process is at work on this run; expected to be the only one"
                ) from None
            raise RunFolderError(f"{path}: not a journal of robustopt, or damaged: {error}") from None
        return Journal(connection, path)

    def close(self) -> None:
        """Release the file."""
        self._connection.close()

    # Writing ---------------------------------------------------------------------------------------------

    def add_plan(self, belief: Belief, duration: float | None) -> None:
        """Commit a plan.

        Args:
            belief: belief of the plan.
            duration: duration of the plan [s]; None if the problem is infeasible.
        """
        text = _BELIEF.dump_json(belief).decode()
        self._write("plans", [(self._plans(), text, duration)])

    def add_executions(self, speed: float, executions: Sequence[Execution]) -> None:
        """Commit executions of the latest plan together.

        Args:
            speed: factor on the speed of the plan.
            executions: the executions.
        """
        plan = self._plans() - 1
        self._write("executions", [_values(execution, plan, speed) for execution in executions])

    def add_judgements(self, plan: int, executions: Sequence[Execution]) -> None:
        """Commit fresh executions of a plan together.

        Args:
            plan: number of the plan.
            executions: the executions.
        """
        found = [(item.number, item.outcome) for item in executions]
        self._write("judgements", [(plan, number, int(shown.success), shown.status) for number, shown in found])

    def _plans(self) -> int:
        return int(self._fetch("SELECT count(*) FROM plans")[0][0])

    def _write(self, table: str, rows: Sequence[tuple[Any, ...]]) -> None:
        if table == "executions" and not self._evident:
            rows = [row[:-1] for row in rows]
        if self._summed:
            rows = [_with_checksum(row) for row in rows]
        places = ", ".join("?" * len(rows[0])) if rows else ""
        try:
            self._connection.execute("BEGIN")
            with self._connection:  # commits at the end, rolls back if something fails
                self._connection.executemany(f"INSERT INTO {table} VALUES ({places})", rows)
        except sqlite3.DatabaseError as error:
            raise RunFolderError(f"{self._place}: cannot be written: {error}") from error
        if self._path is not None and not self._path.exists():  # SQLite goes on writing to the file that it holds
            raise RunFolderError(
                f"{self._path}: was moved or removed while its run was at work; "
                "robustopt learn --resume --out FOLDER continues the run in its present folder"
            )

    # Reading ---------------------------------------------------------------------------------------------

    @property
    def executor(self) -> str:
        """Executor of the plans, SIMULATION or MANUAL."""
        return str(self._rows("origin")[0][0])

    def entries(self) -> Iterator[Entry]:
        """Yield every plan with its executions, in order."""
        for plan, belief, duration in self._rows("plans", "ORDER BY plan"):
            found = self._rows("executions", "WHERE plan = ? ORDER BY number", plan)
            try:
                executions = tuple((speed, _execution(number, *values)) for number, _, speed, *values in found)
                entry = Entry(_BELIEF.validate_json(belief), duration, executions)
            except (ValueError, TypeError) as error:
                raise RunFolderError(f"{self._place}: damaged: plan {plan}: {error}") from None
            yield entry

    def judgements(self, plan: int) -> dict[int, tuple[bool, str]]:
        """Return the fresh executions of a plan: success and status by number.

        Args:
            plan: number of the plan.
        """
        found = self._rows("judgements", "WHERE plan = ? ORDER BY number", plan)
        return {number: (bool(success), status) for _, number, success, status in found}

    def _rows(self, table: str, which: str = "", *values: Any) -> list[Any]:
        """Return rows of a table without their checksums, once types and checksums are found right."""
        found = self._fetch(f"SELECT * FROM {table} {which}", *values)
        if self._summed:
            for row in found:
                if _checksum(row[:-1]) != row[-1]:
                    raise RunFolderError(f"{self._place}: damaged: {_named(table, row)}: its checksum is wrong")
            found = [row[:-1] for row in found]
        if table == "executions" and not self._evident:
            found = [(*row, "{}") for row in found]
        for row in found:
            try:
                _ROWS[table].validate_python(row, strict=True)
            except ValidationError as error:
                wrong = error.errors(include_url=False)[0]["msg"]
                raise RunFolderError(f"{self._place}: damaged: {_named(table, row)}: {wrong}") from None
        return found

    def _fetch(self, command: str, *values: Any) -> list[Any]:
        try:
            return self._connection.execute(command, values).fetchall()
        except (sqlite3.DatabaseError, UnicodeDecodeError) as error:
            raise RunFolderError(f"{self._place}: damaged: {error}") from None


def _hold(connection: sqlite3.Connection) -> None:
    """Lock the file until the connection is closed; SQLite rolls back a transaction that was killed."""
    connection.execute("PRAGMA locking_mode = EXCLUSIVE")
    connection.execute("BEGIN EXCLUSIVE")
    connection.execute("COMMIT")  # the lock stays


def _require_sound(connection: sqlite3.Connection) -> None:
    """Raise sqlite3.DatabaseError if the file is no journal, or parts of it are damaged."""
    for table in ("origin", "plans", "executions", "judgements"):
        connection.execute(f"SELECT * FROM {table} LIMIT 1").fetchall()
    found = connection.execute("PRAGMA integrity_check(1)").fetchone()[0]
    if found != "ok":
        raise sqlite3.DatabaseError(found)
    if connection.execute("SELECT count(*) FROM origin").fetchone() != (1,):
        raise sqlite3.DatabaseError("its origin is lost")
    for table in ("executions", "judgements"):
        lost = connection.execute(f"SELECT plan FROM {table} WHERE plan NOT IN (SELECT plan FROM plans)").fetchone()
        if lost is not None:
            raise sqlite3.DatabaseError(f"{table} of plan {lost[0]}, which there is not")


def _with_checksum(row: tuple[Any, ...]) -> tuple[Any, ...]:
    return (*row, _checksum(row))


def _checksum(row: tuple[Any, ...]) -> str:
    """Return a checksum of the values of a row as SQLite gives them back."""
    plain = [_as_stored(value) for value in row]
    return hashlib.sha256(repr(plain).encode("utf-8", "surrogatepass")).hexdigest()[:16]


def _as_stored(value: Any) -> Any:
    """Return a value as SQLite stores it: a zero without its sign, NULL for not-a-number, text without its own type."""
    if isinstance(value, float):
        return None if isnan(value) else float(value) + 0.0
    return str(value) if isinstance(value, str) else value


def _named(table: str, row: tuple[Any, ...]) -> str:
    return f"plan {row[0]}" if table == "plans" else f"{table.removesuffix('s')} {row[0]!r}"


def _values(execution: Execution, plan: int, speed: float) -> tuple[Any, ...]:
    shown = execution.outcome
    failure, errors = shown.failure or Failure(""), shown.errors
    end = (int(shown.success), shown.status, failure.what, failure.t, failure.s)
    sums = (errors.count, json.dumps(errors.total), json.dumps(errors.squares))
    evidence = _Evidence(failure.against, shown.peaks, shown.error_series)
    return (execution.number, plan, float(speed), *end, *sums, _EVIDENCE.dump_json(evidence).decode())


def _execution(
    number: int, success: int, status: str, what: str, t: float | None, s: float | None, count: int, total: str,
    squares: str, evidence: str,
) -> Execution:  # fmt: skip
    errors = Moments(count, tuple(json.loads(total)), tuple(json.loads(squares)))
    more = _EVIDENCE.validate_json(evidence)
    failure = None if success else Failure(status, what, more.against, t, s)
    return Execution(number, Executed(bool(success), errors, failure, more.peaks, more.error_series))
