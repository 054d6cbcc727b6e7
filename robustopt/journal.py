"""The memory of a learner: every plan and every execution, committed to a SQLite file as it happens.

A journal holds what happened, not what was concluded: told to the learner again, in order, it gives the same state. So
a process that is killed at any moment loses at most the executions that were under way, and they come out the same
when they are run again. One process at a time may hold a journal.
"""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter, ValidationError

from robustopt.errors import RunFolderError
from robustopt.learning.learner import Belief, Executed
from robustopt.learning.moments import Moments
from robustopt.store import SUMMARY

JOURNAL = "journal.db"

_TABLES = """
CREATE TABLE plans (
    plan INTEGER PRIMARY KEY,       -- in the order in which the learner asked, from 0
    belief TEXT NOT NULL,           -- what it was planned with, JSON
    duration REAL                   -- [s]; NULL where there is no plan
);
CREATE TABLE executions (
    number INTEGER PRIMARY KEY,     -- of this learner, from 0; its random stream belongs to it
    plan INTEGER NOT NULL REFERENCES plans,
    speed REAL NOT NULL,            -- times the plan's
    success INTEGER NOT NULL,
    status TEXT NOT NULL, what TEXT NOT NULL, t REAL, s REAL,  -- the first failure: time [s] and place on the path
    count INTEGER NOT NULL, total TEXT NOT NULL, squares TEXT NOT NULL  -- acceleration error, as in `Moments`, JSON
);
CREATE TABLE judgements (           -- fresh executions that the success rate of a plan is estimated with
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

    number: its random stream belongs to it; success; status, what: how it ended, and which object, joint or foot failed
    first; t, s: time of that [s] and place on the path, None for a success; errors: of the joint acceleration
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
        """What a learner is told."""
        return Executed(self.success, self.errors)


@dataclass(frozen=True)
class Entry:
    """A plan with its executions at each speed, in the order of their numbers."""

    belief: Belief
    duration: float | None
    executions: tuple[tuple[float, Execution], ...]


def is_unfinished(folder: Path) -> bool:
    """Whether a folder holds a run of a learner that is not complete."""
    return (folder / JOURNAL).is_file() and not (folder / SUMMARY).is_file()


class Journal:
    """Plans and executions in a SQLite file that this process alone holds; without a file, in memory."""

    def __init__(self, connection: sqlite3.Connection, place: str) -> None:
        self._connection = connection
        self._place = place

    @staticmethod
    def in_memory() -> Journal:
        """A journal that ends with the process."""
        connection = sqlite3.connect(":memory:", isolation_level=None)
        connection.executescript(_TABLES)
        return Journal(connection, "memory")

    @staticmethod
    def create(folder: Path) -> None:
        """Write an empty journal into a folder."""
        connection = sqlite3.connect(folder / JOURNAL, isolation_level=None)
        try:
            connection.executescript(_TABLES)
        finally:
            connection.close()

    @staticmethod
    def open(folder: Path) -> Journal:
        """The journal in a folder, held until it is closed or the process ends.

        Raises RunFolderError where another process holds it, or the file is no journal.
        """
        path = folder / JOURNAL
        if not path.is_file():
            raise RunFolderError(f"{path}: no such file; expected the journal of a run of `robustopt learn`")
        connection = sqlite3.connect(path, timeout=0, isolation_level=None)
        try:
            connection.execute("PRAGMA locking_mode = EXCLUSIVE")
            connection.execute("BEGIN EXCLUSIVE")
            connection.execute("COMMIT")  # the lock stays
            connection.execute("SELECT plan, belief, duration FROM plans LIMIT 1")
        except sqlite3.OperationalError as error:
            connection.close()
            if "locked" in str(error):
                message = f"{folder}: another process is at work on this run; expected to be the only one"
                raise RunFolderError(message) from None
            raise RunFolderError(f"{path}: cannot be used: {error}") from None
        except sqlite3.DatabaseError as error:
            connection.close()
            raise RunFolderError(f"{path}: not a journal of robustopt: {error}") from None
        return Journal(connection, str(path))

    def close(self) -> None:
        """Let go of the file."""
        self._connection.close()

    # What is written -------------------------------------------------------------------------------------

    def add_plan(self, belief: Belief, duration: float | None) -> None:
        """Commit a plan."""
        text = _BELIEF.dump_json(belief).decode()
        self._write([("INSERT INTO plans VALUES ((SELECT count(*) FROM plans), ?, ?)", (text, duration))])

    def add_executions(self, speed: float, executions: Sequence[Execution]) -> None:
        """Commit executions of the latest plan together."""
        command = "INSERT INTO executions VALUES (?, (SELECT count(*) - 1 FROM plans), ?, ?, ?, ?, ?, ?, ?, ?, ?)"
        self._write([(command, _values(execution, speed)) for execution in executions])

    def add_judgements(self, plan: int, executions: Sequence[Execution]) -> None:
        """Commit fresh executions of a plan together."""
        command = "INSERT INTO judgements VALUES (?, ?, ?, ?)"
        self._write([(command, (plan, item.number, item.success, item.status)) for item in executions])

    def _write(self, commands: Sequence[tuple[str, tuple[Any, ...]]]) -> None:
        try:
            with self._transaction():
                for command, values in commands:
                    self._connection.execute(command, values)
        except sqlite3.DatabaseError as error:
            raise RunFolderError(f"{self._place}: cannot be written: {error}") from error

    def _transaction(self) -> sqlite3.Connection:
        self._connection.execute("BEGIN")
        return self._connection  # as a context: commits at the end, rolls back where something fails

    # What is read ----------------------------------------------------------------------------------------

    def entries(self) -> Iterator[Entry]:
        """Every plan with its executions, in order."""
        try:
            plans = self._connection.execute("SELECT plan, belief, duration FROM plans ORDER BY plan").fetchall()
            for plan, belief, duration in plans:
                found = self._connection.execute(
                    "SELECT speed, number, success, status, what, t, s, count, total, squares FROM executions "
                    "WHERE plan = ? ORDER BY number",
                    (plan,),
                )
                executions = tuple((speed, _execution(*values)) for speed, *values in found)
                yield Entry(_BELIEF.validate_json(belief), duration, executions)
        except (sqlite3.DatabaseError, ValidationError, ValueError, TypeError) as error:
            raise RunFolderError(f"{self._place}: damaged: {error}") from None

    def judgements(self, plan: int) -> dict[int, tuple[bool, str]]:
        """Fresh executions of a plan: success and status by number."""
        command = "SELECT number, success, status FROM judgements WHERE plan = ?"
        found = self._connection.execute(command, (plan,)).fetchall()
        return {number: (bool(success), status) for number, success, status in found}


def _values(execution: Execution, speed: float) -> tuple[Any, ...]:
    errors = execution.errors
    sums = (errors.count, json.dumps(errors.total), json.dumps(errors.squares))
    what = (execution.success, execution.status, execution.what, execution.t, execution.s)
    return (execution.number, speed, *what, *sums)


def _execution(
    number: int, success: int, status: str, what: str, t: float | None, s: float | None, count: int, total: str,
    squares: str,
) -> Execution:  # fmt: skip
    errors = Moments(count, tuple(json.loads(total)), tuple(json.loads(squares)))
    return Execution(number, bool(success), status, what, t, s, errors)
