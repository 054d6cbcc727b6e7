"""Writes the paper's tables and figure, and with --all those beyond it: `make reproduce-tables`, `make reproduce-all`.

python experiments/reproduce.py [--all] [--out results/tables] [--only PART ...]
"""

from __future__ import annotations

import argparse
import importlib
import time
from collections.abc import Callable
from contextlib import contextmanager
from pathlib import Path

from learned import TABLES, Bench, bench

PAPER = ("durations", "table_1", "table_2", "figure_3", "table_3", "table_4", "figure_8")
BEYOND = ("table_2_truths", "table_2_K", "table_2_calibrated")
"""Parts, each a module with `write(out, place)`; the first are the paper's own."""

Write = Callable[[Path, Bench], list[Path]]


def write_of(part: str) -> Write:
    """The function that writes a part."""
    write: Write = importlib.import_module("table_durations" if part == "durations" else part).write
    return write


@contextmanager
def bar(total: int):
    """A bar of the parts done, with what is going on, where a person is watching; else a line per part."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

    console = Console(stderr=True, highlight=False)
    columns = (BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), TextColumn("{task.description}"))
    with Progress(*columns, console=console, disable=not console.is_terminal) as progress:
        yield progress, progress.add_task("", total=total)


def run_parts(parts: tuple[str, ...], out: Path, workers: int = 1) -> None:
    """Write parts in their order."""
    with bar(len(parts)) as (progress, line):
        for part in parts:
            began = time.perf_counter()

            def say(text: str, part: str = part) -> None:
                progress.update(line, description=f"{part}, {text}")

            say("...")
            paths = write_of(part)(out, bench(part, out, workers, say))
            progress.advance(line)
            names = ", ".join(path.name for path in paths)
            print(f"{part}: {names} ({time.perf_counter() - began:.0f} s)", flush=True)


def run_alone(part: str, write: Write) -> None:
    """Write one part: the main program of its module."""
    parser = argparse.ArgumentParser(description=f"Writes {part}.")
    parser.add_argument("--out", type=Path, default=TABLES, help="folder for the tables")
    arguments = parser.parse_args()
    for path in write(arguments.out, bench(part, arguments.out, say=lambda text: print(f"  {text}", flush=True))):
        print(path)


def main() -> None:
    parser = argparse.ArgumentParser(description="Writes the paper's tables and figure.")
    parser.add_argument("--all", action="store_true", help="everything beyond the paper too")
    parser.add_argument("--only", nargs="+", choices=(*PAPER, *BEYOND), help="these parts alone")
    parser.add_argument("--out", type=Path, default=TABLES, help="folder for the tables")
    parser.add_argument("--workers", type=int, default=1, help="processes of a simulation")
    arguments = parser.parse_args()
    parts = arguments.only or (PAPER + BEYOND if arguments.all else PAPER)
    run_parts(tuple(parts), arguments.out, arguments.workers)


if __name__ == "__main__":
    main()
