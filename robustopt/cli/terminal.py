"""What commands print: summaries, progress, JSON and errors. Heavy packages are imported by what needs them."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rich.console import Console

    from robustopt.runs.campaign import Learned

Progress = Callable[[int, int, int], None]
"""Called with the trials done, those asked for, and the successes so far."""


GOOD = ("solved", "learned")
"""Statuses of runs that came out well."""


def console(stderr: bool = False) -> Console:
    """The terminal, or what stands in its place."""
    from rich.console import Console

    return Console(stderr=stderr, highlight=False)


def status(text: str, silent: bool) -> AbstractContextManager[object]:
    """A line that says what is going on, where a person is watching."""
    return nullcontext() if silent or not sys.stderr.isatty() else console(stderr=True).status(text)


@contextmanager
def trials_bar(silent: bool) -> Iterator[Progress | None]:
    """A bar of the trials done with the success so far, where a person is watching."""
    if silent or not sys.stderr.isatty():
        yield None
        return
    from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn
    from rich.progress import Progress as Bar

    columns = (TextColumn("trials"), BarColumn(), MofNCompleteColumn(), TextColumn("{task.fields[success]}"))
    with Bar(*columns, TimeRemainingColumn(), console=console(stderr=True), transient=True) as bar:
        task = bar.add_task("trials", total=None, success="")

        def update(done: int, total: int, successes: int) -> None:
            bar.update(task, completed=done, total=total, success=f"{successes / done:.1%} succeeded")

        yield update


@contextmanager
def learning_table(silent: bool) -> Iterator[Callable[[Learned], None] | None]:
    """The iterations so far, where a person is watching, and what is under way."""
    if silent or not sys.stderr.isatty():
        yield None
        return
    from rich.console import Group
    from rich.live import Live
    from rich.spinner import Spinner
    from rich.text import Text

    from robustopt.report import iterations_table
    from robustopt.runs.learning_summary import row_record, trial_record

    beginning = Spinner("dots", "planning")  # several parameters begin with a grid of plans, which may take minutes
    with Live(beginning, console=console(stderr=True), transient=True, refresh_per_second=8) as live:

        def update(learned: Learned) -> None:
            records = [row_record(learned, row) for row in learned.rows]
            under_way = trial_record(learned)
            if under_way is not None:
                records.append(under_way)
            done = f"{learned.learner.name}: {learned.state.executed:,} executions"
            live.update(Group(Text(done), iterations_table(records)) if records else Text(done))

        yield update


def show(data: dict[str, Any], place: Path, json: bool, quiet: bool) -> None:
    """Print the summary of a run; where it is quiet, only what went wrong."""
    if json:
        failed = {} if data["status"] in GOOD else {"error": {"kind": data["status"], "message": data["message"]}}
        print_json({**data, "folder": str(place), **failed})
    elif not quiet:
        from robustopt.report import print_summary

        print_summary(data, console(), place)
    elif data["status"] not in GOOD:
        print(f"{data['name']}: {data['status']}: {data['message']}", file=sys.stderr)


def ask(question: str) -> str:
    """Ask a person; raises EOFError where nobody answers."""
    print(question, end="", file=sys.stderr, flush=True)
    answer = sys.stdin.readline()
    if not answer:
        raise EOFError
    return answer


def say(text: str) -> None:
    """Tell a person who is being asked."""
    print(text, file=sys.stderr, flush=True)


def show_runs(records: Sequence[dict[str, Any]], folder: Path) -> None:
    """Print a table of runs, as wide as its folders, which are to be copied."""
    if not records:
        print(f"no runs in {folder}")
        return
    from rich import box
    from rich.table import Table

    from robustopt.report import print_whole

    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for head in ("kind", "state", "result", "duration [s]", "created", "folder"):
        table.add_column(head, justify="right" if head.startswith("duration") else "left", no_wrap=True)
    for record in records:
        duration = "" if record["duration"] is None else f"{record['duration']:.4f}"
        cells = (record["kind"], record["state"], record["status"], duration, record["created"][:19], record["folder"])
        table.add_row(*(str(cell or "") for cell in cells))
    print_whole(table, console())


def print_json(data: dict[str, Any]) -> None:
    """Print one JSON object."""
    from robustopt.runs.store import json_text

    print(json_text(data))


def fail(kind: str, message: str, code: int, json: bool, problems: Sequence[dict[str, str]] = ()) -> int:
    """Print an error and return the exit code."""
    if json:
        error = {"kind": kind, "message": message, "exit_code": code, "problems": list(problems)}
        print_json({"error": error})
    else:
        with suppress(OSError):  # of a terminal that has been closed; the exit code says it too
            for line in message.splitlines():
                print(f"error: {line}", file=sys.stderr, flush=True)
    return code
