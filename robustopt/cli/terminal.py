"""Output of the commands: summaries, progress, JSON and errors. Heavy packages are imported on first use."""

from __future__ import annotations

import io
import os
import sys
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext, redirect_stdout, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

if TYPE_CHECKING:
    from rich.console import Console

    from robustopt.robot.listing import ListedRobot
    from robustopt.runs.campaign import Learned
    from robustopt.runs.listing import Listed
    from robustopt.runs.records import Summary

Progress = Callable[[int, int, int], None]
"""Function that is called with the numbers of finished trials, of all trials, and of successes so far."""


class Output(NamedTuple):
    """Options of the output: one JSON object, or nothing but errors."""

    json: bool
    quiet: bool

    @property
    def silent(self) -> bool:
        """Whether nothing is printed while a command works."""
        return self.json or self.quiet


def console(stderr: bool = False) -> Console:
    """Return the console for standard output or standard error."""
    from rich.console import Console

    return Console(stderr=stderr, highlight=False)


def own_stdout() -> None:
    """Keep the standard output of this process for what robustopt prints.

    Libraries in C write to descriptor 1, which becomes the null device; `sys.stdout` is given a copy of the former one.
    """
    if not isinstance(sys.stdout, io.TextIOWrapper) or sys.stdout is not sys.__stdout__:
        return  # closed, or replaced by a program that calls the command
    sys.stdout.flush()
    kept, null = os.dup(1), os.open(os.devnull, os.O_WRONLY)
    os.dup2(null, 1)
    os.close(null)
    sys.stdout = os.fdopen(kept, "w", encoding=sys.stdout.encoding, errors=sys.stdout.errors)


@contextmanager
def quiet_libraries() -> Iterator[None]:
    """Drop what libraries in Python print within this block, in which robustopt prints nothing to standard output."""
    with open(os.devnull, "w") as null, redirect_stdout(null):
        yield


@contextmanager
def status(text: str, silent: bool) -> Iterator[None]:
    """Show a line about the current step, if the output is a terminal."""
    shown = nullcontext() if silent or not sys.stderr.isatty() else console(stderr=True).status(text)
    with quiet_libraries(), shown:
        yield


@contextmanager
def trials_bar(silent: bool) -> Iterator[Progress | None]:
    """Show a progress bar of the trials with the success rate so far, if the output is a terminal."""
    if silent or not sys.stderr.isatty():
        with quiet_libraries():
            yield None
        return
    from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn
    from rich.progress import Progress as Bar

    columns = (TextColumn("trials"), BarColumn(), MofNCompleteColumn(), TextColumn("{task.fields[success]}"))
    shown = Bar(*columns, TimeRemainingColumn(), console=console(stderr=True), transient=True)
    with quiet_libraries(), shown as bar:
        task = bar.add_task("trials", total=None, success="")

        def update(done: int, total: int, successes: int) -> None:
            bar.update(task, completed=done, total=total, success=f"{successes / done:.1%} succeeded")

        yield update


@contextmanager
def learning_table(silent: bool) -> Iterator[Callable[[Learned], None] | None]:
    """Show the iterations so far and the current one, if the output is a terminal."""
    if silent or not sys.stderr.isatty():
        with quiet_libraries():
            yield None
        return
    from rich.console import Group
    from rich.live import Live
    from rich.spinner import Spinner
    from rich.text import Text

    from robustopt.report import iterations_table
    from robustopt.runs.learning_summary import row_record, trial_record

    beginning = Spinner("dots", "planning")  # several parameters begin with a grid of plans, which may take minutes
    shown = Live(beginning, console=console(stderr=True), transient=True, refresh_per_second=8)
    with quiet_libraries(), shown as live:

        def update(learned: Learned) -> None:
            records = [row_record(learned, row) for row in learned.rows]
            under_way = trial_record(learned)
            if under_way is not None:
                records.append(under_way)
            done = f"{learned.learner.name}: {learned.state.executed:,} executions"
            live.update(Group(Text(done), iterations_table(records)) if records else Text(done))

        yield update


def show(data: Summary, place: Path, output: Output) -> None:
    """Print the summary of a run; if the output is quiet, only a failure."""
    if output.json:
        failed = {} if data.status.good else {"error": {"kind": data.status, "message": data.message}}
        print_json({**data.model_dump(mode="json", exclude_unset=True), "folder": str(place), **failed})
    elif not output.quiet:
        from robustopt.report import print_summary

        print_summary(data, console(), place)
    elif not data.status.good:
        print(f"{data.name}: {data.status}: {data.message}", file=sys.stderr)


def ask(question: str) -> str:
    """Ask a person a question; raise EOFError if nobody answers."""
    print(question, end="", file=sys.stderr, flush=True)
    answer = sys.stdin.readline()
    if not answer:
        raise EOFError
    return answer


def say(text: str) -> None:
    """Print a message to a person who answers questions."""
    print(text, file=sys.stderr, flush=True)


def prepare_streams(quiet: bool) -> None:
    """Prepare the standard streams of this process for people.

    Characters that a terminal lacks are replaced, and the warnings of libraries become notes. A stream that was closed
    leads nowhere; otherwise the next file that is opened would take its place.

    Args:
        quiet: whether warnings are left out.
    """
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, mode))  # noqa: SIM115
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")
    show_warnings_as_notes(quiet)


def show_warnings_as_notes(quiet: bool) -> None:
    """Print the warnings of libraries from now on as notes, a line each; if the output is quiet, not at all."""

    def show(message: Warning | str, *_: object, **__: object) -> None:
        if not quiet:
            with suppress(OSError):
                print(f"note: {' '.join(str(message).split())}", file=sys.stderr, flush=True)

    warnings.showwarning = show


def show_runs(records: Sequence[Listed], folder: Path) -> None:
    """Print a table of runs, as wide as its longest folder name, so that the names can be copied."""
    if not records:
        print(f"no runs in {folder}")
        return
    from rich import box
    from rich.table import Table
    from rich.text import Text

    from robustopt.report import print_whole

    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, padding=0)
    for head in ("kind", "state", "result", "duration [s]", "created", "folder"):
        table.add_column(Text(head), justify="right" if head.startswith("duration") else "left", no_wrap=True)
    for record in records:
        duration = "" if record.duration is None else f"{record.duration:.4f}"
        created = record.created[:16].replace("T", " ")
        cells = (record.kind, record.state, record.status, duration, created, record.folder)
        table.add_row(*(Text(str(cell or "")) for cell in cells))
    print_whole(table, console())


def show_robots(robots: Sequence[ListedRobot], missing: Mapping[str, str]) -> None:
    """Print a table of robots, and the ways to get those of the sources that are missing."""
    from rich import box
    from rich.table import Table
    from rich.text import Text

    from robustopt.report import print_whole

    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, padding=0)
    for head in ("robot.model", "source", "joints of the longest chain"):
        table.add_column(Text(head), justify="right" if head.startswith("joints") else "left", no_wrap=True)
    for robot in robots:
        table.add_row(*(Text(str(cell)) for cell in (robot.name, robot.source, robot.joints)))
    print_whole(table, console())
    for source, remedy in missing.items():
        print(f"not found: {source}; {remedy}")


def print_json(data: dict[str, Any]) -> None:
    """Print one JSON object."""
    from robustopt.runs.store import json_text

    print(json_text(data))


def fail(kind: str, message: str, code: int, json: bool, problems: Sequence[Mapping[str, str]] = ()) -> int:
    """Print an error and return the exit code."""
    if json:
        error = {"kind": kind, "message": message, "exit_code": code, "problems": list(problems)}
        print_json({"error": error})
    else:
        with suppress(OSError):  # the terminal may be closed; the exit code says it too
            for line in message.splitlines():
                print(f"error: {line}", file=sys.stderr, flush=True)
    return code
