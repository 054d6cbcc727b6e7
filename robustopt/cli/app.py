"""The command line: a thin layer over the library. Heavy packages are imported by the commands that need them."""

from __future__ import annotations

import atexit
import io
import os
import signal
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from robustopt import __version__
from robustopt.cli.commands import (
    ExecutionOptions,
    LearningOptions,
    check_task,
    execute_new,
    execute_stored,
    learn_task,
    make_plan,
    print_dry_run,
    stored_summary,
)
from robustopt.cli.terminal import fail, print_json, show, show_runs
from robustopt.errors import ConfigError, RobustOptError
from robustopt.interruption import INTERRUPTED, STOPS, Kept, interruptions, listen, on_interrupt
from robustopt.processes import end_processes

if TYPE_CHECKING:
    from robustopt.config import Config

_INTERRUPTED = "interrupted; nothing half-written is left"

app = typer.Typer(
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    add_completion=False,
    no_args_is_help=True,
    context_settings={"help_option_names": ["-h", "--help"]},
    help="Fastest robot motions under frictional contact that hold for every value of what is uncertain.",
    epilog="Exit codes: 0 done, 2 configuration or usage, 3 infeasible, 4 solver or certificate failed, "
    "5 simulation failed, 130 interrupted.",
)


class Method(StrEnum):
    ipopt = "ipopt"
    reachability = "reachability"


class Backend(StrEnum):
    loky = "loky"
    dask = "dask"


class ExecutorName(StrEnum):
    simulation = "simulation"
    manual = "manual"


class Effort(StrEnum):
    quick = "quick"
    full = "full"


ConfigFile = Annotated[Path, typer.Argument(metavar="CONFIG", help="YAML file; see docs/configuration.md")]
Overrides = Annotated[
    list[str] | None,
    typer.Argument(metavar="KEY=VALUE", help="other values for keys, e.g. contact.friction=0.3 'uncertainty={}'"),
]
Out = Annotated[
    Path | None, typer.Option(help="run folder, new or empty; default: results/NAME/TIME", show_default=False)
]
Seed = Annotated[int | None, typer.Option(help="seed of all random numbers", show_default=False)]
Json = Annotated[bool, typer.Option("--json", help="print one JSON object instead of text, also for errors")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="print nothing but errors")]


def _print_version(wanted: bool) -> None:
    if wanted:
        print(f"robustopt {__version__}")
        raise typer.Exit


@app.callback()
def common(
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="print the version")
    ] = False,
) -> None:
    """Options before the command."""


@app.command()
def plan(
    config: ConfigFile,
    overrides: Overrides = None,
    out: Out = None,
    method: Annotated[Method | None, typer.Option(help="solver.method", show_default=False)] = None,
    seed: Seed = None,
    certify: Annotated[
        Effort, typer.Option(help="quick: at most a second; full: many more draws and all worst corners")
    ] = Effort.quick,
    figures: Annotated[bool, typer.Option(help="draw the figures")] = True,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="print the resolved configuration and the size of the problem, and stop")
    ] = False,
    json: Json = False,
    quiet: Quiet = False,
) -> int:
    """Find the fastest timing of a path that holds for every value in the intervals, and write a run folder."""
    changes = _changes(overrides, method, seed)
    with _task_of(config, changes) as task:
        if dry_run:
            return print_dry_run(task, json, quiet)
        return make_plan(task, out, certify.value, figures, json, quiet)


@app.command()
def execute(
    task: Annotated[
        Path, typer.Argument(metavar="CONFIG|RUN", help="YAML file to plan and run, or run folder whose plan is run")
    ],
    overrides: Annotated[
        list[str] | None,
        typer.Argument(metavar="KEY=VALUE", help="other values for keys; of a RUN only those of execution and seed"),
    ] = None,
    out: Out = None,
    trials: Annotated[int | None, typer.Option(min=1, help="execution.trials", show_default=False)] = None,
    seed: Seed = None,
    speed: Annotated[float, typer.Option(min=0.01, max=100, help="run the plan this many times as fast")] = 1.0,
    workers: Annotated[int, typer.Option(min=1, help="processes; threads share the cores that they leave")] = 1,
    backend: Annotated[
        Backend, typer.Option(help="where chunks of trials run: processes of this machine, or a Dask cluster")
    ] = Backend.loky,
    scheduler: Annotated[
        str | None, typer.Option(help="address of the Dask scheduler, tcp://HOST:PORT", show_default=False)
    ] = None,
    figures: Annotated[bool, typer.Option(help="draw the figures")] = True,
    video: Annotated[bool, typer.Option(help="film a failing trial beside a succeeding one")] = False,
    json: Json = False,
    quiet: Quiet = False,
) -> int:
    """Run a plan in simulation, again and again, in a world that the planner does not know."""
    changes = _changes(overrides, None, seed)
    if trials is not None:
        changes.append(f"execution.trials={trials}")
    if (backend is Backend.dask) != (scheduler is not None):
        raise ConfigError("--backend dask and --scheduler tcp://HOST:PORT go together; found one of them")
    options = ExecutionOptions(speed, workers, scheduler, figures, video, json, quiet)
    if video and sys.platform == "linux" and not os.environ.get("DISPLAY"):
        os.environ.setdefault("MUJOCO_GL", "egl")
    if task.is_dir():
        return execute_stored(task, changes, out, options)
    with _task_of(task, changes) as config:
        return execute_new(config, out, options)


@app.command()
def learn(
    arguments: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[CONFIG] KEY=VALUE",
            help="YAML file, without one the paper's one-block waiter task; values for keys",
        ),
    ] = None,
    algorithm: Annotated[str | None, typer.Option(help="learning.algorithm", show_default=False)] = None,
    K: Annotated[float | None, typer.Option("--K", min=0, max=6, help="learning.K", show_default=False)] = None,
    out: Out = None,
    resume: Annotated[
        bool, typer.Option("--resume", help="continue the run in --out, or the latest unfinished one of the task")
    ] = False,
    executor: Annotated[
        ExecutorName | None,
        typer.Option(
            help="simulation, or manual: a person runs each trajectory and says what came of it; default: simulation, "
            "or that of the run which is resumed",
            show_default=False,
        ),
    ] = None,
    seed: Seed = None,
    workers: Annotated[int, typer.Option(min=1, help="processes; threads share the cores that they leave")] = 1,
    figures: Annotated[bool, typer.Option(help="draw the figures")] = True,
    json: Json = False,
    quiet: Quiet = False,
) -> int:
    """Learn intervals from executions, until the plan is safe and near-optimal; can be interrupted and continued."""
    path, changes = _task(arguments or [])
    changes += _changes(None, None, seed)
    changes += [] if algorithm is None else [f"learning.algorithm={algorithm}"]
    changes += [] if K is None else [f"learning.K={K}"]
    options = LearningOptions(resume, executor, workers, figures, json, quiet)
    if resume and out is not None and path is None and not changes:
        return learn_task(None, out, options)
    from robustopt.runs.store import CONFIG
    from robustopt.tasks import PAPER_TASK

    stored = out / CONFIG if resume and out is not None else None
    task = path or (stored if stored is not None and stored.is_file() else PAPER_TASK)
    with _task_of(task, changes) as config:
        return learn_task(config, out, options)


@app.command()
def runs(
    folder: Annotated[Path, typer.Argument(metavar="[FOLDER]", help="folder that holds runs")] = Path("results"),
    json: Json = False,
) -> int:
    """List runs and their state: complete, running, or to be resumed."""
    from robustopt.runs.listing import runs as found

    records = found(folder)
    if json:
        print_json({"runs": records})
    else:
        show_runs(records, folder)
    return 0


@app.command()
def validate(config: ConfigFile, overrides: Overrides = None, json: Json = False, quiet: Quiet = False) -> int:
    """Check a configuration, its robot and its path: every mistake, where it is, and what would be right."""
    with _task_of(config, overrides or []) as task:
        check_task(task, json or quiet)
    if json:
        print_json({"valid": True, "name": task.name})
    elif not quiet:
        print(f"{config}: valid")
    return 0


@app.command()
def report(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="run folder that robustopt wrote")],
    json: Json = False,
    quiet: Quiet = False,
) -> int:
    """Print the summary of a stored run."""
    data = stored_summary(run)
    show(data, run, json, quiet)
    return 0


def _changes(overrides: Sequence[str] | None, method: Method | None, seed: int | None) -> list[str]:
    """Overrides with the options that are short for one; the options come last and win."""
    changes = list(overrides or [])
    if method is not None:
        changes.append(f"solver.method={method.value}")
    if seed is not None:
        changes.append(f"seed={seed}")
    return changes


def _task(arguments: Sequence[str]) -> tuple[Path | None, list[str]]:
    """The configuration file, if one is named, and values for keys."""
    if arguments and ("=" not in arguments[0] or Path(arguments[0]).is_file()):
        return Path(arguments[0]), list(arguments[1:])
    return None, list(arguments)


@contextmanager
def _task_of(path: Path, overrides: Sequence[str]) -> Iterator[Config]:
    """The configuration in a file; mistakes that only show in this block get the places of their keys in the file."""
    from robustopt.config.load import load_config, located

    config = load_config(path, overrides)
    try:
        yield config
    except ConfigError as error:
        raise located(error, path, overrides) from None


# Running --------------------------------------------------------------------------------------------------


def _nothing_kept(code: int) -> bool:
    return code == INTERRUPTED and not isinstance(code, Kept)


def run(arguments: Sequence[str]) -> int:
    """Run a command and return its exit code; what a person did wrong becomes a message, never a traceback."""
    json = "--json" in arguments
    try:
        code = app(list(arguments), prog_name="robustopt", standalone_mode=False) or 0
        _flush_output()
        return fail("Interrupted", _INTERRUPTED, code, json) if _nothing_kept(code) else int(code)
    except (KeyboardInterrupt, typer.Abort):
        return fail("Interrupted", _INTERRUPTED, INTERRUPTED, json)
    except Exception as error:
        if interruptions:  # an extension module whose import or call is interrupted raises something else
            return fail("Interrupted", _INTERRUPTED, INTERRUPTED, json)
        return _told(error, json)


def _told(error: Exception, json: bool) -> int:
    """Exit code of what a person, or the system, did wrong, once it is told; raises what is neither."""
    if isinstance(error, RobustOptError):
        problems = [vars(problem) for problem in error.problems] if isinstance(error, ConfigError) else []
        return fail(type(error).__name__, str(error), error.exit_code, json, problems)
    if isinstance(error, BrokenPipeError):  # who reads has read enough
        return 1
    if isinstance(error, OSError):
        what = error.filename or "what the command prints cannot be written"
        in_words = f"{what}: {error.strerror or error}"
        return fail("OSError", in_words, 2, json=False)  # not to standard output, which may be what failed
    message = getattr(error, "format_message", None)
    if message is None:
        raise error
    return fail("UsageError", f"{message().rstrip('.')}; see robustopt --help", 2, json)


def _flush_output() -> None:
    if sys.stdout is not None:  # as it is where it was closed before
        sys.stdout.flush()


def main() -> None:
    """Run the command `robustopt` and end this process with its exit code.

    One thread for linear algebra: the matrices are small, and sums are then the same on every machine load.
    """
    ending = _Ending()
    atexit.register(ending.end_at_once)  # before all others, so that it is called after them
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    listen()
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")
    try:
        ending.code = run(sys.argv[1:])
    except KeyboardInterrupt:  # once more, while the first one was being reported
        ending.code = INTERRUPTED
    _stop_listening()
    with suppress(Exception):
        end_processes()
    sys.exit(ending.code)


def _stop_listening() -> None:
    """Let a further signal end this process, without a word."""
    for number in STOPS:
        if signal.getsignal(number) is on_interrupt:
            signal.signal(number, signal.SIG_DFL)


class _Ending:
    """The end of this process after the exit functions of all libraries.

    Python would take down every module after them, which takes as long as a plan; and a library in which something was
    interrupted may complain of it.
    """

    code: int | None = None
    """Exit code of the command; None while there is none."""

    def end_at_once(self) -> None:
        """Flush the output and end this process, if the command has an exit code."""
        if self.code is None:
            return
        for stream in (sys.stdout, sys.stderr):
            if stream is not None:  # as it is where it was closed before
                with suppress(OSError):
                    stream.flush()
        os._exit(self.code)
