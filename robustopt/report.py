"""Summary of a run for people: text for the terminal, and a page with figures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from robustopt.evidence import Failures
from robustopt.files import write_text
from robustopt.page import Row, page
from robustopt.runs.learning_table import legend, table
from robustopt.runs.records import (
    CertificateRecord,
    DiagnosisRecord,
    ExecutionsRecord,
    GridRecord,
    Iteration,
    LearningRecord,
    RunStatus,
    Summary,
)

if TYPE_CHECKING:
    from robustopt.runs.execution_run import ExecutionResult
    from robustopt.runs.plan_run import PlanResult

MOST_LIMITS = 8
"""Number of limits that are shown by name; the others are summed up if there are several."""

ROUNDING = 1e-6
"""Part of a limit below which a margin is shown as 0: solvers satisfy their rows only to this accuracy."""

PAGE = "report.html"

MANY_COLUMNS = 10
"""A table with more columns has narrower gaps in the terminal."""

LONGEST_HEAD = 13
"""Largest width of a column heading in the terminal; longer ones are folded."""

UNBOUNDED = 10_000
"""Width, in characters, of a table without a limit on its width."""

FIGURES = (
    "learning.svg", "trials.svg", "foot_contacts.svg", "phase_plane.svg", "feet.svg", "footprints.svg", "contacts.svg",
    "cartesian.svg", "joints*.svg", "accelerations.svg",
)  # fmt: skip
"""Figures of the page in their order; the binding limits are in a table already."""

_COLOURS = {RunStatus.SOLVED: "green", RunStatus.LEARNED: "green", RunStatus.INFEASIBLE: "yellow"}


def _headline(data: Summary) -> str:
    """Return a line that says how a run ended."""
    if data.duration is None:
        return f"{data.name}: {data.status}"
    if data.rejected:
        return f"{data.name}: {data.status}; the plan of {data.duration:.4f} s is rejected"
    if data.kind == "learning":
        return f"{data.name}: {data.status} a plan of {data.duration:.4f} s"
    return f"{data.name}: {data.status}; the motion takes {data.duration:.4f} s, planned by {data.method}"


def sections(data: Summary) -> list[tuple[str, list[Row]]]:
    """Return the lines of a summary under their headings; sections without a line are left out.

    Args:
        data: the summary.
    """
    parts = [
        ("Learning", _learning(data.learning) if data.learning else []),
        ("Executions", _executions(data.executions) if data.executions else []),
        ("Failures, at their median place and time", _failures(data)),
        ("Binding limits, share of the duration", _binding(data.binding)),
        ("Certificate", certificate_rows(data.certificate) if data.certificate else []),
        ("Why there is no plan", _diagnosis(data.diagnosis) if data.diagnosis else []),
        ("Robot and path", [Row("note", note) for note in data.notes]),
        ("Grid", _grid(data.grid) if data.grid else []),
        ("Problem", rows(data.size.model_dump()) if data.size else []),
        ("Solution", rows(data.statistics)),
        ("Time [s]", rows(data.seconds)),
    ]
    return [(title, lines) for title, lines in parts if lines]


def rows(values: Mapping[str, Any]) -> list[Row]:
    """Return names and values as lines.

    Args:
        values: values by name.
    """
    return [Row(name.replace("_", " "), _cell(value)) for name, value in values.items() if value is not None]


def _learning(learning: LearningRecord) -> list[Row]:
    shown = learning.model_dump(include={"algorithm", "end", "iterations", "plans", "executions"})
    rate = {"success rate in question": learning.target_rate, "confidence": learning.confidence or None}
    return rows(shown | rate)


def _executions(executions: ExecutionsRecord) -> list[Row]:
    lines = [Row(name, f"{count:,}", count / executions.trials) for name, count in executions.statuses.items()]
    speed = "" if executions.speed == 1.0 else f", {executions.speed:g} times the plan's speed"
    lines.append(Row("duration", f"{executions.duration:.4f} s{speed}"))
    if executions.feedback is not None:
        lines.append(Row("acceleration error mean", _errors(executions.feedback.mean)))
        lines.append(Row("acceleration error deviation", _errors(executions.feedback.deviation)))
    return lines


def _failures(data: Summary) -> list[Row]:
    """Return a line for each kind and object that failed."""
    if data.learning is not None:
        total = sum(row.executions - (row.sped_up is not None) for row in data.learning.rows)
        groups = data.learning.failures
    elif data.executions is not None:
        total, groups = data.executions.trials, data.executions.failures
    else:
        return []
    found = [Failures(group.name, group.count, group.s, group.t) for group in groups]
    shares = {group.name: f"{group.count:,} of {total:,}" for group in found}
    return [Row(group.name, ", ".join(filter(None, (shares[group.name], group.place)))) for group in found]


def _errors(values: Sequence[float]) -> str:
    """Return the errors of all coordinates, or their range if there are many."""
    if len(values) > MOST_LIMITS:
        return f"{min(values):.3f} to {max(values):.3f} over {len(values)} coordinates"
    return ", ".join(f"{round(value, 3) + 0.0:.3f}" for value in values)


def certificate_rows(certificate: CertificateRecord) -> list[Row]:
    """Return the lines of a certificate.

    Args:
        certificate: the record of the certificate.
    """
    worst, margins = certificate.worst, certificate.margins
    effort = f"{certificate.level}: {certificate.samples:,} samples, {certificate.tests:,} tests"
    name, margin = min(margins.items(), key=lambda item: _lowest(item[1].on_grid))
    grid = "at a grid point" if worst.on_grid else "between grid points"
    if worst.on_grid and worst.margin == margin.on_grid:
        name = worst.limit
    lines = [
        Row("result", f"{'passed' if certificate.passed else 'failed'} ({effort})"),
        Row("margin at grid points", f"{_left(margin.on_grid, certificate.passed)}: {name}"),
        Row("worst margin", f"{_left(worst.margin, certificate.passed)}: {worst.limit}"),
        Row("  where", worst.place),
        Row("  when", f"t = {worst.t:.3f} s, s = {worst.s:.4f}, {grid}"),
    ]
    return [*lines, *(Row("  with " + row.name, row.value) for row in rows(worst.parameters) if row.value)]


def _grid(grid: GridRecord) -> list[Row]:
    if grid.error is None or grid.violation is None:
        return [Row("accuracy", grid.sentence)]
    loss, beyond = (f"{100 * value if value > ROUNDING else 0.0:.2g} %" for value in (grid.error, grid.violation))
    lines = [
        Row("duration", f"{loss} above that of ever finer grids (estimate)"),
        Row("between grid points", f"limits exceeded by at most {beyond} (estimate)"),
    ]
    return lines if grid.enough else [*lines, Row("note", "the search for a finer grid ended at its bound")]


def _diagnosis(diagnosis: DiagnosisRecord) -> list[Row]:
    conflicts = [Row("cannot hold", " and ".join(names)) for names in diagnosis.conflicts]
    remedies = [Row("would help", remedy.sentence) for remedy in diagnosis.remedies]
    return [Row("where", f"{diagnosis.place}, s = {diagnosis.s:.4g}"), *conflicts, *remedies]


def _lowest(margin: float | None) -> float:
    """Return a margin as a number; the summary has none for a limit that no contact forces can hold."""
    return float("-inf") if margin is None else margin


def _left(margin: float | None, passed: bool) -> str:
    if margin is None:
        return "not held by any forces"
    if passed and margin < -ROUNDING:
        return f"within tolerance ({-100 * margin:.2g} % over)"
    return f"{100 * margin if abs(margin) > ROUNDING else 0.0:.2g} % of the limit"


def _binding(shares: Mapping[str, float]) -> list[Row]:
    shown = dict(list(shares.items())[: MOST_LIMITS if len(shares) > MOST_LIMITS + 1 else None])
    if len(shares) > len(shown):
        shown[f"{len(shares) - len(shown)} more"] = 1.0 - sum(shown.values())
    return [Row(name, f"{100 * share:.1f} %", share) for name, share in shown.items()]


def _cell(value: Any) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:,.0f}" if value.is_integer() and abs(value) < 1e9 else f"{value:.4g}"
    if isinstance(value, Mapping):
        return ", ".join(f"{name} {_cell(inner)}" for name, inner in value.items())
    if isinstance(value, Sequence) and not isinstance(value, str):
        if len(value) > MOST_LIMITS and isinstance(value[0], Sequence):
            numbers = [number for point in value for number in point]
            return f"{len(value)} points, from {_cell(min(numbers))} to {_cell(max(numbers))} along each axis"
        return ", ".join(_cell(inner) for inner in value)
    return f"{value:,}" if isinstance(value, int) else str(value)


# In the terminal ------------------------------------------------------------------------------------------


def print_summary(data: Summary, console: Console, place: Path) -> None:
    """Print the summary of a run and the folder of its files.

    Args:
        data: the summary.
        console: console to print on.
        place: folder of the run.
    """
    console.print(Text(_headline(data), style=f"bold {_COLOURS.get(data.status, 'red')}"))
    console.print(Text(data.message))
    if data.without_margin:
        console.print(Text(data.without_margin, style="yellow"))
    if data.learning and data.learning.rows:
        print_whole(iterations_table(data.learning.rows), console)
        console.print(Text(legend(data.learning.rows), style="dim"))
    for title, lines in sections(data):
        print_rows(title, lines, console)
    console.print(Text.assemble("Files in ", (str(place), "bold")), soft_wrap=True)


def print_whole(shown: Table, console: Console) -> None:
    """Print a table without cutting cells, wider than the terminal if necessary.

    Args:
        shown: the table.
        console: console to print on.
    """
    width, whole = console.width, console.measure(shown, options=console.options.update(width=UNBOUNDED)).maximum
    console.width = max(width, whole)
    try:
        console.print(shown)
    finally:
        console.width = width


def print_rows(title: str, lines: Sequence[Row], console: Console) -> None:
    """Print lines under a heading.

    Args:
        title: the heading.
        lines: the lines.
        console: console to print on.
    """
    table = Table.grid(padding=(0, 2))
    table.add_column(no_wrap=True)
    width = max((len(value) for _, value, share in lines if share is not None), default=0)
    for name, value, share in lines:
        bar = "" if share is None else "█" * round(24 * share)
        shown = value if share is None else f"{value:>{width}}  "
        table.add_row(f"  {name}", Text.assemble(shown, (bar, "cyan")))
    console.print(Text(f"\n{title}", style="bold"))
    console.print(table)


def iterations_table(records: Sequence[Iteration]) -> Table:
    """Return the iterations of a learner as a table, one line per plan.

    Args:
        records: the iterations.
    """
    heads, lines = table(records)
    gap = 1 if len(heads) <= MANY_COLUMNS else 0  # on top of the space that any two columns have between them
    shown = Table(box=box.SIMPLE_HEAD, pad_edge=False, padding=(0, gap, 0, 0))
    for head in heads:
        long = len(head) > LONGEST_HEAD
        justify: Literal["left", "right"] = "left" if head in ("Rslt", "Spdup") else "right"
        shown.add_column(
            head, justify=justify, no_wrap=not long, overflow="fold", max_width=LONGEST_HEAD if long else None
        )

    for line in lines:
        shown.add_row(*map(Text, line))
    return shown


# As a page ------------------------------------------------------------------------------------------------


def write_figures_and_page(result: PlanResult, data: Summary, folder: Path, figures: bool = True) -> None:
    """Draw the figures of a run into its folder and write its page.

    Args:
        result: the plan and its certificate.
        data: the summary of the run.
        folder: folder of the run.
        figures: whether to draw figures.
    """
    if figures:
        from robustopt.plotting import write_figures

        write_figures(result.plan, result.config, folder / "figures")
    write_page(data, folder)


def write_execution_figures(result: ExecutionResult, folder: Path, figures: bool, video: bool) -> None:
    """Draw and film the first trial that succeeded and the first one that failed, or the only one of these that exists.

    Args:
        result: the plan and its executions.
        folder: folder of the run.
        figures: whether to draw figures.
        video: whether to write a film.
    """
    if not (figures or video):
        return
    from robustopt.plotting import write_execution_figures as write
    from robustopt.simulation.trace import trace

    executions = result.executions
    ended = [outcome for outcome in executions.outcomes if outcome.error_steps]
    chosen = [next((o for o in ended if o.success is success), None) for success in (True, False)]
    traces = [
        trace(result.plan, outcome.trial, result.config, executions.seed, executions.speed)
        for outcome in chosen
        if outcome is not None
    ]
    if traces and video:
        from robustopt.simulation.video import film, write_film

        write_film(film(result.plan, traces, result.config, executions.seed), folder / "figures")
    if traces and figures:
        write(result.config, traces, result.plan.problem.robot, folder / "figures")


def write_learning_figures(data: Summary, planned: PlanResult | None, folder: Path) -> None:
    """Draw the iterations of a learner, and its best plan with the figures of `plan`.

    Args:
        data: summary of the run.
        planned: the best plan; None without one.
        folder: folder of the run.
    """
    from robustopt.plotting import write_figures, write_learning_figure

    learning = data.learning
    if learning is not None and learning.rows:
        title = f"{data.name}: {learning.algorithm}"
        write_learning_figure(learning.rows, learning.target_rate, title, folder / "figures")
    if planned is not None:
        write_figures(planned.plan, planned.config, folder / "figures")


def write_page(data: Summary, folder: Path) -> None:
    """Write the summary of a run and the figures in its folder as one self-contained page.

    Args:
        data: the summary of the run.
        folder: folder of the run.
    """
    sentences = [text for text in (data.message, data.without_margin) if text]
    figures = [path for pattern in FIGURES for path in sorted((folder / "figures").glob(pattern))]
    records = data.learning.rows if data.learning else []
    write_text(folder / PAGE, page(_headline(data), sentences, records, sections(data), figures))
