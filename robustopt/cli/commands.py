"""What the commands of the command line do once their options are read: compute, write a run folder, say how it ended.

Heavy packages are imported by what needs them. Each returns the exit code.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from robustopt.cli.terminal import ask, console, fail, learning_table, print_json, say, show, status, trials_bar
from robustopt.errors import RunFolderError
from robustopt.interruption import INTERRUPTED, Kept, interruptions, stop_if_interrupted

if TYPE_CHECKING:
    from robustopt.config import Config
    from robustopt.runs.campaign import Learned


def check_task(config: Config, silent: bool) -> None:
    """Raise the error that planning a task would end with before it solves anything."""
    with status("looking at robot and path", silent):
        from robustopt.limits import build_problem

        build_problem(config)
        stop_if_interrupted()


def make_plan(config: Config, out: Path | None, certify: Any, figures: bool, json: bool, quiet: bool) -> int:
    """Plan a task into a new run folder."""
    from robustopt.runs.store import new_run

    with new_run(config.name, out) as run:
        with status("planning", json or quiet):
            from robustopt.runs.experiment import plan_task, write_run

            result = plan_task(config, certify)
            stop_if_interrupted()
        with status("writing", json or quiet):
            from robustopt.report import write_figures_and_page

            data = write_run(result, run.folder, sys.argv[1:])
            write_figures_and_page(result, data, run.folder, figures)
            stop_if_interrupted()
    show(data, run.place, json, quiet)
    return result.exit_code


def stored_summary(folder: Path) -> dict[str, Any]:
    """The summary of a stored run, of which a person can be told.

    Raises RunFolderError where there is none, or it has been changed.
    """
    from io import StringIO

    from rich.console import Console

    from robustopt.report import print_summary
    from robustopt.runs.store import SUMMARY, read_summary

    data = read_summary(folder)
    try:
        data["kind"], data["message"]
        print_summary(data, Console(file=StringIO()), folder)
    except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError) as error:
        found = f"{type(error).__name__}: {error}"
        raise RunFolderError(
            f"{folder / SUMMARY}: has been changed, or is of another version of robustopt ({found})"
        ) from None
    return data


class ExecutionOptions(NamedTuple):
    """Options of an execution."""

    speed: float
    workers: int
    scheduler: str | None
    figures: bool
    video: bool
    json: bool
    quiet: bool


def execute_new(config: Config, out: Path | None, options: ExecutionOptions) -> int:
    """Plan a task and execute the plan, into a new run folder."""
    from robustopt.runs.store import new_run

    silent = options.json or options.quiet
    with new_run(config.name, out) as run:
        with status("planning", silent):
            from robustopt.report import write_execution_figures, write_figures_and_page
            from robustopt.runs.execution_run import execute_plan, write_execution_run
            from robustopt.runs.experiment import plan_task, write_run
            from robustopt.simulation import Workers

            planned = plan_task(config)
            stop_if_interrupted()
        if planned.exit_code:
            data, code = write_run(planned, run.folder, sys.argv[1:]), planned.exit_code
        else:
            workers = Workers(options.workers, options.scheduler)
            with trials_bar(silent) as progress:
                result = execute_plan(config, planned, options.speed, workers, progress)
            interruptions.clear()
            data, code = write_execution_run(result, run.folder, sys.argv[1:]), result.exit_code
            write_execution_figures(result, run.folder, options.figures, options.video)
        write_figures_and_page(planned, data, run.folder, options.figures)
        stop_if_interrupted()
    return _end_execution(data, run.place, code, options)


def execute_stored(folder: Path, changes: Sequence[str], out: Path | None, options: ExecutionOptions) -> int:
    """Execute the plan of a stored run, into a new run folder; changes: other values for keys."""
    from robustopt.runs.store import new_run

    silent = options.json or options.quiet
    with new_run(str(stored_summary(folder)["name"]), out) as run:
        with trials_bar(silent) as progress:
            from robustopt.report import write_execution_figures, write_page
            from robustopt.runs.execution_run import execute_stored as run_stored
            from robustopt.runs.execution_run import write_execution_run
            from robustopt.simulation import Workers

            workers = Workers(options.workers, options.scheduler)
            result = run_stored(folder, changes, options.speed, workers, progress)
        interruptions.clear()
        data = write_execution_run(result, run.folder, sys.argv[1:])
        write_execution_figures(result, run.folder, options.figures, options.video)
        write_page(data, run.folder)
        stop_if_interrupted()
    return _end_execution(data, run.place, result.exit_code, options)


def _end_execution(data: dict[str, Any], place: Path, code: int, options: ExecutionOptions) -> int:
    show(data, place, options.json, options.quiet)
    return Kept(code) if code == INTERRUPTED else code


class LearningOptions(NamedTuple):
    """Options of a learner's run."""

    resume: bool
    executor: str | None
    workers: int
    figures: bool
    json: bool
    quiet: bool


def learn_task(config: Config | None, out: Path | None, options: LearningOptions) -> int:
    """Begin or continue a learner's run; config: None for the one that the run was begun with."""
    from robustopt.runs.journal import SIMULATION
    from robustopt.runs.learning_run import begin, discard_if_empty, latest_unfinished, resumed

    folder = latest_unfinished(config) if options.resume and config is not None and out is None else out
    if options.resume and folder is not None and folder.is_dir() and any(folder.iterdir()):
        return _continue(resumed(folder, config), folder, options)
    if config is None:
        raise RunFolderError(f"{out}: no run to resume; expected the folder of a run of `robustopt learn`")
    folder = begin(config, out, sys.argv[1:], options.executor or SIMULATION)
    try:
        return _continue(config, folder, options)
    except Exception:
        discard_if_empty(folder, parents=2 if out is None else 0)
        raise


def _continue(config: Config, folder: Path, options: LearningOptions) -> int:
    """Bring a run to its end, or say how it ended where it is complete."""
    from robustopt.runs.learning_run import exit_code_of
    from robustopt.runs.store import is_run

    if is_run(folder):
        data = stored_summary(folder)
    else:
        try:
            data = _run_learner(config, folder, options)
        except (Exception, KeyboardInterrupt) as error:
            if isinstance(error, KeyboardInterrupt) or interruptions:  # an extension module may raise something else
                message = f"interrupted; what was learned is kept: robustopt learn --resume --out {folder}"
                return Kept(fail("Interrupted", message, INTERRUPTED, options.json))
            raise
    show(data, folder, options.json, options.quiet)
    return exit_code_of(data["status"])


def _run_learner(config: Config, folder: Path, options: LearningOptions) -> dict[str, Any]:
    """Learn, and write what was learned; the summary."""
    from robustopt.runs.journal import MANUAL, Journal
    from robustopt.runs.learning_run import require_same_versions

    silent = options.json or options.quiet
    with closing(Journal.open(folder)) as journal:
        if options.executor not in (None, journal.executor):
            raise RunFolderError(f"{folder}: was begun with --executor {journal.executor}; expected the same")
        manual = journal.executor == MANUAL
        if not manual:
            require_same_versions(folder)
        with learning_table(silent or manual) as show_learned:
            from robustopt.runs.campaign import learn as run_learner
            from robustopt.runs.manual import Manual

            def progress(learned: Learned) -> None:
                stop_if_interrupted()
                if show_learned is not None:
                    show_learned(learned)

            executor = Manual(folder, ask, say) if manual else None
            learned = run_learner(config, executor, journal=journal, workers=options.workers, progress=progress)
            stop_if_interrupted()
        from robustopt.runs.learning_run import complete, result_of, write_learning_files, writing

        with status("writing", silent), writing(folder):
            from robustopt.report import write_learning_figures, write_page

            result = result_of(learned, journal)
            data = write_learning_files(result, folder)
            if options.figures:
                write_learning_figures(data, result.planned, folder)
            write_page(data, folder)
            stop_if_interrupted()
            complete(folder, data)
    return data


def print_dry_run(config: Config, json: bool, quiet: bool) -> int:
    """Print the resolved configuration and the size of its problem."""
    from robustopt.config.load import dump, resolved
    from robustopt.limits import build_problem
    from robustopt.runs.experiment import problem_size

    with status("building the problem", json or quiet):
        size = problem_size(build_problem(config))
    if json:
        print_json({"config": resolved(config), "size": size})
    elif not quiet:
        from robustopt.report import print_rows, rows

        print(dump(config), end="")
        print_rows("Problem", rows(size), console())
    return 0
