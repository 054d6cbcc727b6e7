"""Write the paper's tables and figures (`make reproduce-tables`), and with --all the others (`make reproduce-all`).

python experiments/reproduce.py [--all] [--only PART ...] [--jobs N] [--out results/tables]
"""

from __future__ import annotations

import argparse
import importlib
import time
from collections.abc import Callable, MutableMapping, Sequence
from concurrent.futures import FIRST_COMPLETED, ProcessPoolExecutor, wait
from dataclasses import dataclass
from multiprocessing import Manager, get_context
from pathlib import Path

from learned import TABLES, Bench, bench
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TaskID, TextColumn, TimeElapsedColumn

from robustopt.errors import RobustOptError
from robustopt.processes import cores

PAPER = ("durations", "table_1", "table_2", "figure_3", "table_3", "table_4", "figure_8")
BEYOND = ("table_2_truths", "table_2_K", "table_2_calibrated")
"""Parts, each a module with `write(out, place)`: the paper's own, and the ones beyond it."""

LONGEST = ("table_2_calibrated", "table_2_K", "table_4", "table_3")
"""Parts that take minutes; they begin first, so that no process ends long after the others."""

AHEAD = {"table_4": ("frictions, error", "frictions")}
"""Parts whose runs are made in advance, one process per group; their modules also have `run(group, place)`."""

LAST = ("table_4", "figure_8", "figure_3")
"""Parts that come last, one by one: the first two read runs, the third measures times."""

Write = Callable[[Path, Bench], list[Path]]


def write_of(part: str) -> Write:
    """Return the function that writes a part."""
    write: Write = importlib.import_module("table_durations" if part == "durations" else part).write
    return write


@dataclass(frozen=True)
class Work:
    """A unit of work for one process: to write a part, or to make the runs of one of its groups."""

    part: str
    group: str | None = None

    @property
    def name(self) -> str:
        return self.part if self.group is None else f"{self.part} ({self.group})"

    def do(self, out: Path, workers: int, said: MutableMapping[str, str]) -> str:
        """Do the work, report progress to `said`, and return a line with the result."""
        began = time.perf_counter()
        place = bench(self.part, out, workers, lambda text: said.update({self.name: text}))
        try:
            if self.group is None:
                done = ", ".join(path.name for path in write_of(self.part)(out, place))
            else:
                importlib.import_module(self.part).run(self.group, place)
                done = "runs"
        except RobustOptError as error:
            raise SystemExit(f"{self.name}: {error}") from error
        return f"{self.name}: {done} ({time.perf_counter() - began:.0f} s)"


def stages_of(parts: Sequence[str], jobs: int) -> list[tuple[list[Work], int]]:
    """Return the stages of work in order, each with the number of processes that share it."""
    together = [part for part in LONGEST if part in parts]
    together += [part for part in parts if part not in together]
    first = [Work(part, group) for part in together for group in AHEAD.get(part, (None,)) if part not in LAST or group]
    return [(first, jobs), *(([Work(part)], 1) for part in LAST if part in parts)]


def run_parts(parts: Sequence[str], out: Path, jobs: int, workers: int) -> None:
    """Write parts, `jobs` of them at a time, with a progress bar and a line for each part under way."""
    stages = stages_of(parts, jobs)
    with Manager() as manager, _bar() as progress:
        said: MutableMapping[str, str] = manager.dict()
        whole = progress.add_task("parts", total=sum(len(stage) for stage, _ in stages))
        lines: dict[str, TaskID] = {}
        for stage, count in stages:
            pool = ProcessPoolExecutor(count, mp_context=get_context("spawn"))
            try:
                futures = {pool.submit(work.do, out, workers, said): work.name for work in stage}
                while futures:
                    done, _ = wait(futures, timeout=0.5, return_when=FIRST_COMPLETED)
                    for name, text in dict(said).items():
                        if name not in lines:
                            lines[name] = progress.add_task(name, total=None)
                        progress.update(lines[name], description=f"{name}, {text}")
                    for future in done:
                        name = futures.pop(future)
                        if name in lines:
                            progress.update(lines[name], visible=False)
                        print(future.result(), flush=True)
                        progress.advance(whole)
            finally:
                pool.shutdown(cancel_futures=True)


def _bar() -> Progress:
    """Return a progress bar, which is shown on a terminal only."""
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
