"""Writes the paper's tables and figure, and with --all those beyond it: `make reproduce-tables`, `make reproduce-all`.

python experiments/reproduce.py [--all] [--only PART ...] [--jobs N] [--out results/tables]
"""

from __future__ import annotations

import argparse
import importlib
import time
from collections.abc import Callable, MutableMapping, Sequence
from concurrent.futures import FIRST_COMPLETED, ProcessPoolExecutor, wait
from multiprocessing import Manager, get_context
from pathlib import Path

from learned import TABLES, Bench, bench
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TaskID, TextColumn, TimeElapsedColumn

from robustopt.errors import RobustOptError
from robustopt.execution.monte_carlo import cores

PAPER = ("durations", "table_1", "table_2", "figure_3", "table_3", "table_4", "figure_8")
BEYOND = ("table_2_truths", "table_2_K", "table_2_calibrated")
"""Parts, each a module with `write(out, place)`; the first are the paper's own."""

LONGEST = ("table_2_K", "table_2_calibrated", "table_4", "table_3")
"""Parts that take minutes: begun first, so that no worker ends long after the others."""

LAST = ("figure_8", "figure_3")
"""Parts that come after all others, one by one: the first reads runs of tables 3 and 4, the second measures times."""

Write = Callable[[Path, Bench], list[Path]]


def write_of(part: str) -> Write:
    """The function that writes a part."""
    write: Write = importlib.import_module("table_durations" if part == "durations" else part).write
    return write


def run_part(part: str, out: Path, workers: int, said: MutableMapping[str, str]) -> str:
    """Write one part and tell which files; what is going on meanwhile goes to `said`."""
    began = time.perf_counter()
    try:
        paths = write_of(part)(out, bench(part, out, workers, lambda text: said.update({part: text})))
    except RobustOptError as error:
        raise SystemExit(f"{part}: {error}") from error
    return f"{part}: {', '.join(path.name for path in paths)} ({time.perf_counter() - began:.0f} s)"


def run_parts(parts: Sequence[str], out: Path, jobs: int, workers: int) -> None:
    """Write parts, `jobs` of them at a time, with a bar of those that are done and a line for each under way."""
    long = [part for part in LONGEST if part in parts]
    together = [*long, *(part for part in parts if part not in (*long, *LAST))]
    stages = [(together, jobs), *(([part], 1) for part in LAST if part in parts)]
    with Manager() as manager, _bar() as progress:
        said: MutableMapping[str, str] = manager.dict()
        whole = progress.add_task("parts", total=len(parts))
        lines: dict[str, TaskID] = {}
        for stage, count in stages:
            pool = ProcessPoolExecutor(count, mp_context=get_context("spawn"))
            try:
                futures = {pool.submit(run_part, part, out, workers, said): part for part in stage}
                while futures:
                    done, _ = wait(futures, timeout=0.5, return_when=FIRST_COMPLETED)
                    for part, text in dict(said).items():
                        if part not in lines:
                            lines[part] = progress.add_task(part, total=None)
                        progress.update(lines[part], description=f"{part}, {text}")
                    for future in done:
                        part = futures.pop(future)
                        if part in lines:
                            progress.update(lines[part], visible=False)
                        print(future.result(), flush=True)
                        progress.advance(whole)
            finally:
                pool.shutdown(cancel_futures=True)


def _bar() -> Progress:
    """Where a person is watching, a bar; else nothing but a line per part that is done."""
    console = Console(stderr=True, highlight=False)
    columns = (BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), TextColumn("{task.description}"))
    return Progress(*columns, console=console, disable=not console.is_terminal)


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
    parser.add_argument("--jobs", type=int, default=cores(), help="parts at a time")
    parser.add_argument("--workers", type=int, default=1, help="processes of a simulation")
    arguments = parser.parse_args()
    if min(arguments.jobs, arguments.workers) < 1:
        parser.error("expected at least 1 for --jobs and --workers")
    parts = tuple(dict.fromkeys(arguments.only or (PAPER + BEYOND if arguments.all else PAPER)))
    run_parts(parts, arguments.out, arguments.jobs, arguments.workers)


if __name__ == "__main__":
    main()
