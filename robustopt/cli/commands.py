"""Work of the commands after their options are read: compute, write a run folder, report, return an exit code.

Heavy packages are imported on first use.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from robustopt.cli.terminal import (
    Output,
    ask,
    console,
    fail,
    learning_table,
    print_json,
    say,
    show,
    status,
    trials_bar,
)
from robustopt.errors import RunFolderError
from robustopt.interruption import INTERRUPTED, Kept, interruptions, stop_if_interrupted

if TYPE_CHECKING:
    from robustopt.config import Config
    from robustopt.exports.write import Format
    from robustopt.runs.campaign import Learned
    from robustopt.runs.execution_run import ExecutionResult
    from robustopt.runs.journal import Journal
    from robustopt.runs.plan_run import Effort, PlanResult
    from robustopt.runs.records import Summary
    from robustopt.runs.store import NewRun
    from robustopt.simulation import Workers


def check_task(config: Config, silent: bool) -> None:
    """Build the problem of a task, which raises any error in its robot or its path."""
    with status("building robot and path", silent):
        from robustopt.solvers import build_problem

        build_problem(config)
        stop_if_interrupted()


def print_dry_run(config: Config, output: Output) -> int:
    """Print the resolved configuration and the size of its problem."""
    from robustopt.config.load import dump, resolved
    from robustopt.runs.plan_run import problem_size
    from robustopt.solvers import build_problem

    with status("building the problem", output.silent):
        size = problem_size(build_problem(config)).model_dump()
    if output.json:
        print_json({"config": resolved(config), "size": size})
    elif not output.quiet:
        from robustopt.report import print_rows, rows

        print(dump(config), end="")
        print_rows("Problem", rows(size), console())
    return 0


def make_plan(config: Config, out: Path | None, certify: Effort, figures: bool, output: Output) -> int:
    """Plan a task into a new run folder."""
    from robustopt.runs.store import new_run

    with new_run(config.name, out) as run:
        with status("planning", output.silent):
            from robustopt.runs.plan_run import plan_task, write_run

            result = plan_task(config, certify)
            stop_if_interrupted()
        with status("writing", output.silent):
            data = write_run(result, run.folder, sys.argv[1:])
            data = _with_figures(result, data, run, figures)
            stop_if_interrupted()
    show(data, run.place, output)
    return data.status.exit_code


def _with_figures(result: PlanResult, data: Summary, run: NewRun, figures: bool) -> Summary:
    """Write the page of a run and its figures; return its summary, with the time of the figures if there are any."""
    from robustopt.report import write_figures_and_page
    from robustopt.runs.store import SUMMARY, write_record

    began = time.perf_counter()
    write_figures_and_page(result, data, run.folder, figures)
    if figures:
        data = data.model_copy(update={"seconds": {**data.seconds, "figures": time.perf_counter() - began}})
        write_record(run.folder / SUMMARY, data)
    return data


# Executing ------------------------------------------------------------------------------------------------


class ExecutionOptions(NamedTuple):
    """Options of an execution."""

    speed: float
    workers: int
    scheduler: str | None
    figures: bool
    video: bool
    output: Output

    def who(self) -> Workers:
        """Return the workers that run the trials."""
        from robustopt.simulation import Workers

        return Workers(self.workers, self.scheduler)


def execute_new(config: Config, out: Path | None, options: ExecutionOptions) -> int:
    """Plan a task and execute the plan, into a new run folder."""
    from robustopt.runs.store import new_run

    silent = options.output.silent
    with new_run(config.name, out) as run:
        with status("planning", silent):
            from robustopt.runs.execution_run import execute_plan
            from robustopt.runs.plan_run import plan_task, write_run

            planned = plan_task(config)
            stop_if_interrupted()
        if planned.status.good:
            with trials_bar(silent) as progress:
                result = execute_plan(config, planned, options.speed, options.who(), progress)
            data = _write_executions(result, run, options)
        else:
            data = write_run(planned, run.folder, sys.argv[1:])
        data = _with_figures(planned, data, run, options.figures)
        stop_if_interrupted()
    return _end_execution(data, run.place, options.output)


def execute_stored(folder: Path, changes: Sequence[str], out: Path | None, options: ExecutionOptions) -> int:
    """Execute the plan of a stored run, into a new run folder; `changes` are overrides `key=value`."""
    from robustopt.runs.store import new_run, read_summary

    with new_run(read_summary(folder).name, out) as run:
        with trials_bar(options.output.silent) as progress:
            from robustopt.report import write_page
            from robustopt.runs.execution_run import execute_stored as run_stored

            result = run_stored(folder, changes, options.speed, options.who(), progress)
        data = _write_executions(result, run, options)
        write_page(data, run.folder)
        stop_if_interrupted()
    return _end_execution(data, run.place, options.output)


def _write_executions(result: ExecutionResult, run: NewRun, options: ExecutionOptions) -> Summary:
    """Write executions and their figures; an interruption before this point has already ended the trials."""
    from robustopt.report import write_execution_figures
    from robustopt.runs.execution_run import write_execution_run

    interruptions.clear()
    data = write_execution_run(result, run.folder, sys.argv[1:])
    write_execution_figures(result, run.folder, options.figures, options.video)
    return data


def _end_execution(data: Summary, place: Path, output: Output) -> int:
    show(data, place, output)
    code = data.status.exit_code
    return Kept(code) if code == INTERRUPTED else code


# Exporting ------------------------------------------------------------------------------------------------


def export_stored(folder: Path, format: Format, period: float | None, out: Path | None, output: Output) -> int:
    """Write the motion of a stored plan into a file."""
    with status("reading the run", output.silent):
        from robustopt.runs.export_run import export

        result = export(folder, format=format, period=period, out=out)
        stop_if_interrupted()
    if output.json:
        print_json(vars(result) | {"file": str(result.file)})
    elif not output.quiet:
        when = "at the steps of the jerk" if result.at_jerk_steps else f"every {result.period:.6g} s"
        print(f"{result.file}: {result.samples:,} samples {when}, {result.duration:.6g} s")
        for note in result.notes:
            print(f"note: {note}")
    return 0


# Learning -------------------------------------------------------------------------------------------------


class LearningOptions(NamedTuple):
    """Options of a learner's run."""

    resume: bool
    executor: str | None
    workers: int
    figures: bool
    output: Output


def learn_task(config: Config | None, out: Path | None, options: LearningOptions) -> int:
    """Begin or continue a learner's run; `config` is None for the configuration with which the run was begun."""
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
    """Finish a run, or show it if it is complete."""
    from robustopt.runs.store import is_run, read_summary

    if is_run(folder):
        data = read_summary(folder)
    else:
        try:
            data = _run_learner(config, folder, options)
        except (Exception, KeyboardInterrupt) as error:
            if isinstance(error, KeyboardInterrupt) or interruptions:  # an extension module may raise something else
                message = f"interrupted; all executions so far are kept: robustopt learn --resume --out {folder}"
                return Kept(fail("Interrupted", message, INTERRUPTED, options.output.json))
            raise
    show(data, folder, options.output)
    return data.status.exit_code


def _run_learner(config: Config, folder: Path, options: LearningOptions) -> Summary:
    """Learn, and write the result; return the summary."""
    from robustopt.runs.journal import MANUAL, Journal
    from robustopt.runs.origin import require_same_versions

    with closing(Journal.open(folder)) as journal:
        if options.executor not in (None, journal.executor):
            raise RunFolderError(f"{folder}: was begun with --executor {journal.executor}; expected the same")
        manual = journal.executor == MANUAL
        if not manual:
            require_same_versions(folder)
        with learning_table(options.output.silent or manual) as show_learned:
            from robustopt.runs.campaign import configured_learner, verdict_note
            from robustopt.runs.campaign import learn as run_learner
            from robustopt.runs.manual import Manual

            def progress(learned: Learned) -> None:
                stop_if_interrupted()
                if show_learned is not None:
                    show_learned(learned)

            executor = Manual(folder, ask, say) if manual else None
            note = "" if next(journal.entries(), None) else verdict_note(config, manual)
            if note and not options.output.silent:
                configured_learner(config, hardware=manual)  # a task that it refuses is said without the note
                say(f"note: {note}")
            learned = run_learner(config, executor, journal=journal, workers=options.workers, progress=progress)
            stop_if_interrupted()
        return _complete(learned, journal, folder, options)


def _complete(learned: Learned, journal: Journal, folder: Path, options: LearningOptions) -> Summary:
    """Write the files of a learner that is finished; return the summary."""
    from robustopt.runs.learning_run import complete, result_of, write_learning_files, writing

    with status("writing", options.output.silent), writing(folder):
        from robustopt.report import write_learning_figures, write_page

        result = result_of(learned, journal)
        data = write_learning_files(result, folder)
        if options.figures:
            write_learning_figures(data, result.planned, folder)
        write_page(data, folder)
        stop_if_interrupted()
        complete(folder, data)
    return data
