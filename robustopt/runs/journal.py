"""The memory of a learner: every plan and every execution, committed to a SQLite file as it happens.

A journal holds events, not conclusions: told to the learner again, in order, they give the same state. So a process
that is killed at any moment loses at most the executions that were under way, and they come out the same when they are
run again. One process at a time may hold a journal.
"""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter

from robustopt.errors import RunFolderError, RunInUse
from robustopt.learning.learner import Belief, Executed
from robustopt.learning.moments import Moments
from robustopt.runs.store import JOURNAL

SIMULATION, MANUAL = "simulation", "manual"

PATIENCE = 1.0
"""Time to wait for another process that only looks whether a journal is in use [s]."""

_TABLES = """
CREATE TABLE origin (
    executor TEXT NOT NULL          -- simulation or manual: executions are never mixed
);
CREATE TABLE plans (
    plan INTEGER PRIMARY KEY,       -- in the order in which the learner asked, from 0
    belief TEXT NOT NULL,           -- the learner's values for the plan, JSON
    duration REAL                   -- [s]; NULL without a plan
);
CREATE TABLE executions (
    number INTEGER PRIMARY KEY,     -- of this learner, from 0; its random stream belongs to it
    plan INTEGER NOT NULL REFERENCES plans,
    speed REAL NOT NULL,            -- times the plan's
    success INTEGER NOT NULL,
    status TEXT NOT NULL, what TEXT NOT NULL, t REAL, s REAL,  -- the first failure: time [s] and place on the path
    count INTEGER NOT NULL, total TEXT NOT NULL, squares TEXT NOT NULL  -- acceleration error, as in `Moments`, JSON
);
CREATE TABLE judgements (           -- fresh executions, which estimate the success rate of a plan
    plan INTEGER NOT NULL REFERENCES plans,
    number INTEGER NOT NULL,
    success INTEGER NOT NULL,
    status TEXT NOT NULL,
    PRIMARY KEY (plan, number)
);
"""

_BELIEF: TypeAdapter[Belief] = TypeAdapter(Belief)


@dataclass(frozen=True)
class Execution:
    """One execution of a plan.

    Attributes:
        number: has a random stream of its own.
        status, what: how the execution ended, and the object, joint or contact that failed first.
        t, s: time of that failure [s] and place on the path, None for a success.
        errors: moments of the joint acceleration error.
    """

    number: int
    success: bool
    status: str
    what: str
    t: float | None
    s: float | None
    errors: Moments

    @property
    def outcome(self) -> Executed:
        """The part of the execution that a learner is told."""
        return Executed(self.success, self.errors)


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

    @staticmethod
    def in_memory() -> Journal:
        """Return a journal that ends with the process."""
        connection = sqlite3.connect(":memory:", isolation_level=None)
        connection.executescript(_TABLES)
        connection.execute("INSERT INTO origin VALUES (?)", (SIMULATION,))
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
                connection.execute("INSERT INTO origin VALUES (?)", (executor,))
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
        if not path.is_file():
            raise RunFolderError(f"{path}: no such file; expected the journal of a run of `robustopt learn`")
        connection = sqlite3.connect(path, timeout=PATIENCE, isolation_level=None)
        try:
            _hold(connection)
            _require_sound(connection)
        except sqlite3.DatabaseError as error:
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
        self._write("INSERT INTO plans VALUES ((SELECT count(*) FROM plans), ?, ?)", [(text, duration)])

    def add_executions(self, speed: float, executions: Sequence[Execution]) -> None:
        """Commit executions of the latest plan together.

        Args:
            speed: factor on the speed of the plan.
            executions: the executions.
        """
        command = "INSERT INTO executions VALUES (?, (SELECT count(*) - 1 FROM plans), ?, ?, ?, ?, ?, ?, ?, ?, ?)"
        self._write(command, [_values(execution, speed) for execution in executions])

    def add_judgements(self, plan: int, executions: Sequence[Execution]) -> None:
        """Commit fresh executions of a plan together.

        Args:
            plan: number of the plan.
            executions: the executions.
        """
        values = [(plan, item.number, item.success, item.status) for item in executions]
        self._write("INSERT INTO judgements VALUES (?, ?, ?, ?)", values)

    def _write(self, command: str, rows: Sequence[tuple[Any, ...]]) -> None:
        try:
            self._connection.execute("BEGIN")
            with self._connection:  # commits at the end, rolls back if something fails
                self._connection.executemany(command, rows)
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
        return str(self._read("SELECT executor FROM origin")[0][0])

    def entries(self) -> Iterator[Entry]:
        """Yield every plan with its executions, in order."""
        for plan, belief, duration in self._read("SELECT plan, belief, duration FROM plans ORDER BY plan"):
            found = self._read(
                "SELECT speed, number, success, status, what, t, s, count, total, squares FROM executions "
                "WHERE plan = ? ORDER BY number",
                plan,
            )
            try:
                executions = tuple((speed, _execution(*values)) for speed, *values in found)
                entry = Entry(_BELIEF.validate_json(belief), duration, executions)
            except (ValueError, TypeError) as error:
                raise RunFolderError(f"{self._place}: damaged: plan {plan}: {error}") from None
            yield entry

    def judgements(self, plan: int) -> dict[int, tuple[bool, str]]:
        """Return the fresh executions of a plan: success and status by number.

        Args:
            plan: number of the plan.
        """
        found = self._read("SELECT number, success, status FROM judgements WHERE plan = ? ORDER BY number", plan)
        return {number: (bool(success), status) for number, success, status in found}

    def _read(self, command: str, *values: Any) -> list[Any]:
        try:
            return self._connection.execute(command, values).fetchall()
        except sqlite3.DatabaseError as error:
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


def _values(execution: Execution, speed: float) -> tuple[Any, ...]:
    errors = execution.errors
    sums = (errors.count, json.dumps(errors.total), json.dumps(errors.squares))
    end = (execution.success, execution.status, execution.what, execution.t, execution.s)
    return (execution.number, speed, *end, *sums)


def _execution(
    number: int, success: int, status: str, what: str, t: float | None, s: float | None, count: int, total: str,
    squares: str,
) -> Execution:  # fmt: skip
    errors = Moments(count, tuple(json.loads(total)), tuple(json.loads(squares)))
    return Execution(number, bool(success), status, what, t, s, errors)
