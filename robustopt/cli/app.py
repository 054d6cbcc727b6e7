"""The command line: a thin layer over the library. Heavy packages are imported on first use."""

from __future__ import annotations

import atexit
import os
import signal
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from robustopt import __version__
from robustopt.cli import NOTHING_KEPT
from robustopt.cli.commands import (
    ExecutionOptions,
    LearningOptions,
    check_task,
    execute_new,
    execute_stored,
    export_stored,
    learn_task,
    make_plan,
    print_dry_run,
)
from robustopt.cli.options import (
    Backend,
    ConfigFile,
    Effort,
    ExecutorName,
    FormatName,
    Json,
    Method,
    Out,
    Overrides,
    Quiet,
    RunFolder,
    Seed,
    Workers,
)
from robustopt.cli.terminal import Output, fail, own_stdout, prepare_streams, print_json, show, show_robots, show_runs
from robustopt.errors import ConfigError, RobustOptError
from robustopt.interruption import INTERRUPTED, STOPS, Kept, interruptions, listen, on_interrupt
from robustopt.processes import end_processes

if TYPE_CHECKING:
    from robustopt.config import Config

app = typer.Typer(
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    add_completion=False,
    no_args_is_help=True,
    context_settings={"help_option_names": ["-h", "--help"]},
    help="Time-optimal, robust path timing for robots under frictional contact.",
    epilog="Exit codes: 0 done, 2 configuration or usage, 3 infeasible, 4 solver or certificate failed, "
    "5 simulation failed, 130 interrupted.",
)


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
    """Read the options that precede the command."""


@app.command()
def plan(
    config: ConfigFile,
    overrides: Overrides = None,
    out: Out = None,
    method: Annotated[Method | None, typer.Option(help="set solver.method", show_default=False)] = None,
    seed: Seed = None,
    certify: Annotated[
        Effort,
        typer.Option(help="check the plan quickly, or fully (more samples and instants)"),
    ] = Effort.quick,
    figures: Annotated[bool, typer.Option(help="draw the figures")] = True,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="print the resolved configuration and the size of the problem, and stop")
    ] = False,
    json: Json = False,
    quiet: Quiet = False,
) -> int:
    """Plan the fastest robust timing of a path.

    The plan is feasible for every value in the intervals. It is written into a run folder.
    """
    changes = _changes(overrides, method, seed)
    with _task_of(config, changes) as task:
        if dry_run:
            return print_dry_run(task, Output(json, quiet))
        return make_plan(task, out, certify.value, figures, Output(json, quiet))


@app.command()
def execute(
    task: Annotated[
        Path, typer.Argument(metavar="CONFIG|RUN", help="YAML file of a task to plan, or run folder with a plan")
    ],
    overrides: Annotated[
        list[str] | None,
        typer.Argument(metavar="KEY=VALUE", help="set keys to other values; for a RUN only execution and seed"),
    ] = None,
    out: Out = None,
    trials: Annotated[int | None, typer.Option(min=1, help="set execution.trials", show_default=False)] = None,
    seed: Seed = None,
    speed: Annotated[float, typer.Option(min=0.01, max=100, help="multiply the speed of the plan")] = 1.0,
    workers: Workers = 1,
    backend: Annotated[
        Backend, typer.Option(help="run the trials in processes of this machine, or on a Dask cluster")
    ] = Backend.processes,
    scheduler: Annotated[
        str | None, typer.Option(help="connect to this Dask scheduler, tcp://HOST:PORT", show_default=False)
    ] = None,
    figures: Annotated[bool, typer.Option(help="draw the figures")] = True,
    video: Annotated[bool, typer.Option(help="film a trial that fails beside one that succeeds")] = False,
    json: Json = False,
    quiet: Quiet = False,
) -> int:
    """Execute a plan many times in simulation.

    The simulated world may differ from the planner's, and from trial to trial.
    """
    changes = _changes(overrides, None, seed)
    if trials is not None:
        changes.append(f"execution.trials={trials}")
    if (backend is Backend.dask) != (scheduler is not None):
        raise ConfigError("--backend dask and --scheduler tcp://HOST:PORT go together; found one of them")
    options = ExecutionOptions(speed, workers, scheduler, figures, video, Output(json, quiet))
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
            help="YAML file of the task, by default the paper's one-block waiter task; keys to set to other values",
        ),
    ] = None,
    algorithm: Annotated[str | None, typer.Option(help="set learning.algorithm", show_default=False)] = None,
    K: Annotated[float | None, typer.Option("--K", min=0, max=6, help="set learning.K", show_default=False)] = None,
    out: Out = None,
    resume: Annotated[
        bool, typer.Option("--resume", help="continue the run in --out, or the latest unfinished one of the task")
    ] = False,
    executor: Annotated[
        ExecutorName | None,
        typer.Option(
            help="execute in simulation, or ask a person to run each trajectory and to report it (manual); "
            "default: simulation, or that of the run which is resumed",
            show_default=False,
        ),
    ] = None,
    seed: Seed = None,
    workers: Workers = 1,
    figures: Annotated[bool, typer.Option(help="draw the figures")] = True,
    json: Json = False,
    quiet: Quiet = False,
) -> int:
    """Learn parameters from executions.

    The learner searches for the fastest plan that succeeds. It can be interrupted and resumed.
    """
    path, changes = _task(arguments or [])
    changes += _changes(None, None, seed)
    changes += [] if algorithm is None else [f"learning.algorithm={algorithm}"]
    changes += [] if K is None else [f"learning.K={K}"]
    options = LearningOptions(resume, executor, workers, figures, Output(json, quiet))
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
    folder: Annotated[Path, typer.Argument(metavar="[FOLDER]", help="list the runs in this folder")] = Path("results"),
    json: Json = False,
) -> int:
    """List runs and their state: complete, rejected, running, resumable or damaged."""
    from robustopt.runs.listing import runs as found

    records = found(folder)
    if json:
        print_json({"runs": [record.model_dump() for record in records]})
    else:
        show_runs(records, folder)
    return 0


@app.command()
def robots(json: Json = False) -> int:
    """List the robots that robot.model can name, and the joints of their longest chain."""
    from robustopt.robot.listing import missing, robots

    found = robots()
    if json:
        print_json({"robots": [vars(robot) for robot in found], "missing": missing()})
    else:
        show_robots(found, missing())
    return 0


@app.command()
def validate(config: ConfigFile, overrides: Overrides = None, json: Json = False, quiet: Quiet = False) -> int:
    """Check a configuration, its robot and its path.

    Every mistake is printed with its place and its remedy.
    """
    with _task_of(config, overrides or []) as task:
        check_task(task, json or quiet)
    if json:
        print_json({"valid": True, "name": task.name})
    elif not quiet:
        print(f"{config}: valid")
    return 0


@app.command()
def report(run: RunFolder, json: Json = False, quiet: Quiet = False) -> int:
    """Print the summary of a stored run."""
    from robustopt.runs.store import read_summary

    show(read_summary(run), run, Output(json, quiet))
    return 0


@app.command()
def export(
    run: RunFolder,
    format: Annotated[FormatName, typer.Option(help="format of the file")] = FormatName.ros,
    period: Annotated[
        float | None,
        typer.Option(help="time between samples [s]; default: output.period, or steps of the jerk", show_default=False),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(help="write this file; default: one in the run folder. A .yaml file is YAML", show_default=False),
    ] = None,
    json: Json = False,
    quiet: Quiet = False,
) -> int:
    """Write the motion of a stored plan for a controller.

    The motion is slowed down uniformly, so that it ends on a whole period. With jerk limits and without a period,
    messages have samples at the steps of the jerk instead.
    """
    return export_stored(run, format.value, period, out, Output(json, quiet))


def _changes(overrides: Sequence[str] | None, method: Method | None, seed: int | None) -> list[str]:
    """Return the overrides, followed by the options that are short for one, so that the options win."""
    changes = list(overrides or [])
    if method is not None:
        changes.append(f"solver.method={method.value}")
    if seed is not None:
        changes.append(f"seed={seed}")
    return changes


def _task(arguments: Sequence[str]) -> tuple[Path | None, list[str]]:
    """Return the configuration file, if one is named, and the overrides."""
    if arguments and ("=" not in arguments[0] or Path(arguments[0]).is_file()):
        return Path(arguments[0]), list(arguments[1:])
    return None, list(arguments)


@contextmanager
def _task_of(path: Path, overrides: Sequence[str]) -> Iterator[Config]:
    """Yield the configuration in a file; errors within the block are given the positions of their keys in the file."""
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
    """Run a command and return its exit code; a mistake of the user becomes a message, never a traceback."""
    json = "--json" in arguments
    try:
        code = app(list(arguments), prog_name="robustopt", standalone_mode=False) or 0
        _flush_output()
        return fail("Interrupted", NOTHING_KEPT, code, json) if _nothing_kept(code) else int(code)
    except (KeyboardInterrupt, typer.Abort):
        return fail("Interrupted", NOTHING_KEPT, INTERRUPTED, json)
    except Exception as error:
        if interruptions:  # an extension module whose import or call is interrupted raises something else
            return fail("Interrupted", NOTHING_KEPT, INTERRUPTED, json)
        return _told(error, json)


def _told(error: Exception, json: bool) -> int:
    """Print an error of the user or of the system and return its exit code; raise any other error again."""
    if isinstance(error, RobustOptError):
        problems = [vars(problem) for problem in error.problems] if isinstance(error, ConfigError) else []
        return fail(type(error).__name__, str(error), error.exit_code, json, problems)
    if isinstance(error, BrokenPipeError):  # the reader has read enough
        return 1
    if isinstance(error, OSError):
        found = error.filename or "the output of the command cannot be written"
        in_words = f"{found}: {error.strerror or error}"
        return fail("OSError", in_words, 2, json=False)  # standard output may have failed itself
    if isinstance(error, MemoryError):
        found = f"the memory is not enough: {error}".rstrip(": ")
        return fail("MemoryError", f"{found}; expected a smaller task, or fewer workers", 2, json)
    message = getattr(error, "format_message", None)
    if message is None:
        raise error
    return fail("UsageError", f"{message().rstrip('.')}; see robustopt --help", 2, json)


def _flush_output() -> None:
    if sys.stdout is not None:  # None if it was closed before
        sys.stdout.flush()


def main() -> None:
    """Run the command `robustopt` and end this process with its exit code.

    Linear algebra uses one thread: the matrices are small, and sums then do not depend on the load of the machine.
    """
    prepare_streams(quiet=not {"-q", "--quiet"}.isdisjoint(sys.argv))
    ending = _Ending()
    atexit.register(ending.end_at_once)  # before all others, so that it is called after them
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    listen()
    own_stdout()
    try:
        ending.code = run(sys.argv[1:])
    except KeyboardInterrupt:  # once more, while the first one was being reported
        ending.code = INTERRUPTED
    _stop_listening()
    with suppress(Exception):
        end_processes()
    sys.exit(ending.code)


def _stop_listening() -> None:
    """Let a further signal end this process silently."""
    for number in STOPS:
        if signal.getsignal(number) is on_interrupt:
            signal.signal(number, signal.SIG_DFL)


class _Ending:
    """Fast end of this process, after the exit functions of all libraries.

    Python would otherwise unload every module, which takes as long as a plan, and a library that was interrupted might
    print an error.
    """

    code: int | None = None
    """Exit code of the command; None while there is none."""

    def end_at_once(self) -> None:
        """Flush the output and end this process, if the command has an exit code."""
        if self.code is None:
            return
        for stream in (sys.stdout, sys.stderr):
            if stream is not None:  # None if it was closed before
                with suppress(OSError):
                    stream.flush()
        os._exit(self.code)
