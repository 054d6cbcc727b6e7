"""Runs of learners for the tables: each is begun, continued or read again in a folder of its own.

The folders lie below results/runs/VERSION, VERSION a hash of the package's source. The same source continues after an
interruption and does nothing twice; other source begins again.
"""

from __future__ import annotations

import hashlib
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import robustopt
from robustopt.config import Config
from robustopt.config.load import load_config
from robustopt.runs.campaign import Learned, learn
from robustopt.runs.journal import SIMULATION, Journal
from robustopt.runs.learning_run import begin, complete, result_of, resumed, write_learning_files
from robustopt.runs.learning_summary import row_record
from robustopt.runs.records import Iteration, LearningRecord
from robustopt.runs.store import JOURNAL, SUMMARY, read_summary
from robustopt.tasks import PAPER_TASK

ROOT = Path(__file__).resolve().parents[1]
TABLES = ROOT / "results" / "tables"
TWO_BLOCKS = ROOT / "configs" / "waiter_two_blocks.yaml"

QUIET: tuple[str, ...] = ()
"""The paper's world: a random force of 2 N standard deviation on the tray."""

STOCHASTIC = ("execution.disturbance.force_deviation=[20, 20, 0]", "execution.truth.variation.friction=0.05")
"""A stochastic world: a force of 20 N standard deviation, and friction that varies from trial to trial."""


@dataclass(frozen=True)
class Bench:
    """The workplace of an experiment.

    Attributes:
        work: folder for its runs.
        workers: number of worker processes.
        say: called with a line of text about the progress.
    """

    work: Path
    workers: int = 1
    say: Callable[[str], None] = lambda _: None


def bench(part: str, out: Path = TABLES, workers: int = 1, say: Callable[[str], None] = lambda _: None) -> Bench:
    """Return the workplace of an experiment that writes its tables to `out`."""
    return Bench(out.parent / "runs" / source_hash() / part, workers, say)


def source_hash() -> str:
    """Return a hash of all files of the package and of the shipped configurations."""
    package = Path(robustopt.__file__).parent
    places = [*package.rglob("*.py"), *package.rglob("*.xml"), *package.rglob("*.yaml"), *(ROOT / "configs").glob("*")]
    digest = hashlib.sha256(sys.version.encode())
    for path in sorted(places):
        digest.update(path.relative_to(ROOT).as_posix().encode() + path.read_bytes())
    return digest.hexdigest()[:12]


def task(overrides: Sequence[str], path: Path = PAPER_TASK) -> Config:
    """Return a configuration with overrides."""
    return load_config(path, overrides)


def learned(config: Config, name: str, place: Bench) -> Learned:
    """Return the run of a learner with this name: begin it, continue it, or, if it is complete, read it again."""
    folder = place.work / name
    if not (folder / JOURNAL).is_file():
        begin(config, folder, ["learn"], SIMULATION)
    resumed(folder, config)
    journal = Journal.open(folder)
    try:
        found = learn(config, journal=journal, workers=place.workers, progress=lambda now: place.say(_line(name, now)))
        if not (folder / SUMMARY).is_file():
            complete(folder, write_learning_files(result_of(found, journal), folder))
    finally:
        journal.close()
    return found


def recorded(config: Config, name: str, place: Bench) -> LearningRecord:
    """Return the part of a run's summary about its learning; a complete run is read, without any planning."""
    folder = place.work / name
    if not (folder / SUMMARY).is_file():
        learned(config, name, place)
    resumed(folder, config)
    learning = read_summary(folder).learning
    assert learning is not None
    return learning


def _line(name: str, now: Learned) -> str:
    return f"{name}: plan {len(now.rows) + (not now.finished)}, {now.state.executed:,} executions"


def records(found: Learned) -> list[Iteration]:
    """Return the records of all plans of a run."""
    return [row_record(found, row) for row in found.rows]


def success(record: Iteration) -> str:
    """Return the success rate of a record with its interval, in percent."""
    rate, low, high = record.success_rate, record.success_low, record.success_high
    if rate is None or low is None or high is None:
        return ""
    return f"{100 * rate:.1f} [{100 * low:.1f}, {100 * high:.1f}]"
