"""What a run says to people: its summary in the terminal, and as a page with its figures."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from robustopt.runs.learning_table import legend, table

if TYPE_CHECKING:
    from robustopt.runs.execution_run import ExecutionResult
    from robustopt.runs.experiment import PlanResult

MOST_LIMITS = 8
"""Limits that are shown by name; the rest are summed up."""

PAGE = "report.html"

MANY_COLUMNS = 10
"""More columns stand closer together in the terminal."""

LONGEST_HEAD = 13
"""Width of a column in the terminal; a longer head is folded."""

UNBOUNDED = 10_000
"""Width of a table that nothing bounds, in characters."""

FIGURES = (
    "learning.svg", "trials.svg", "foot_contacts.svg", "phase_plane.svg", "feet.svg", "footprints.svg", "contacts.svg",
    "joints*.svg", "accelerations.svg",
)  # fmt: skip
"""Figures of the page in their order; what binds is a table of it already."""

_COLOURS = {"solved": "green", "learned": "green", "infeasible": "yellow"}

_STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; max-width: 60rem; margin: 2rem auto; padding: 0 1rem; color: #222; }
table { border-collapse: collapse; } td { padding: 0.1rem 1.5rem 0.1rem 0; vertical-align: top; }
td:first-child { white-space: nowrap; } td.share { min-width: 16rem; }
td.share div { background: #2a6f97; height: 0.8rem; margin-top: 0.35rem; }
table.iterations td, th { padding: 0.1rem 0.8rem 0.1rem 0; text-align: right; white-space: nowrap; }
img { max-width: 100%; } h2 { font-size: 1.1rem; margin: 1.5rem 0 0.3rem; }
"""


class Row(NamedTuple):
    """A line of a summary: a name, a value, and for shares the part of the whole, drawn as a bar."""

    name: str
    value: str
    share: float | None = None


def headline(data: Mapping[str, Any]) -> str:
    """How a run ended, in one line."""
    if data.get("duration") is None:
        return f"{data['name']}: {data['status']}"
    if data.get("kind") == "learning":
        return f"{data['name']}: {data['status']} a plan of {data['duration']:.4f} s"
    return f"{data['name']}: {data['status']}; the motion takes {data['duration']:.4f} s, planned by {data['method']}"


def sections(data: Mapping[str, Any]) -> list[tuple[str, list[Row]]]:
    """The summary of a run under headings: what binds, certificate, why there is no plan, size, times."""
    parts = [
        ("Learning", _learning(data["learning"]) if data.get("learning") else []),
        ("Executions", _executions(data["executions"]) if data.get("executions") else []),
        ("What binds, share of the duration", _binding(data.get("binding") or {})),
        ("Certificate", _certificate(data["certificate"]) if data.get("certificate") else []),
        ("Why there is no plan", _diagnosis(data["diagnosis"]) if data.get("diagnosis") else []),
        ("Robot", [Row("note", note) for note in data.get("notes") or []]),
        ("Problem", rows(data.get("size") or {})),
        ("Solution", rows(data.get("statistics") or {})),
        ("Time [s]", rows(data.get("seconds") or {})),
    ]
    return [(title, lines) for title, lines in parts if lines]


def rows(values: Mapping[str, Any]) -> list[Row]:
    """Names and values as lines."""
    return [Row(name.replace("_", " "), _cell(value)) for name, value in values.items() if value is not None]


def _learning(learning: Mapping[str, Any]) -> list[Row]:
    names = ("algorithm", "end", "iterations", "plans", "executions")
    lines = rows({name: learning[name] for name in names})
    return [
        *lines,
        *rows({"success rate in question": learning["target_rate"], "confidence": learning["confidence"] or None}),
    ]


def _executions(executions: Mapping[str, Any]) -> list[Row]:
    total = executions["trials"]
    lines = [Row(name, f"{count:,}", count / total) for name, count in executions["statuses"].items()]
    first = executions["first_failure"]
    if first is not None:
        where = f"{first['status']}, {first['what']}, at t = {first['t']:.3f} s, s = {first['s']:.4f}"
        lines.append(Row("earliest failure", f"{where} in trial {first['trial']}"))
    lines.append(Row("duration", f"{executions['duration']:.4f} s, {executions['speed']:g} times the plan's speed"))
    feedback = executions["feedback"]
    if feedback is not None:
        for kind in ("mean", "deviation"):
            lines.append(Row(f"acceleration error {kind}", _errors(feedback[kind])))
    return lines


def _errors(values: Sequence[float]) -> str:
    """Errors of all coordinates, or their range where there are many."""
    if len(values) > MOST_LIMITS:
        return f"{min(values):.3f} to {max(values):.3f} over {len(values)} coordinates"
    return ", ".join(f"{value:.3f}" for value in values)


def _certificate(certificate: Mapping[str, Any]) -> list[Row]:
    worst, margins = certificate["worst"], certificate["margins"]
    effort = f"{certificate['level']}: {certificate['draws']:,} draws, {certificate['tests']:,} tests"
    name, margin = min(margins.items(), key=lambda item: _lowest(item[1]["on_grid"]))
    lines = [
        Row("result", f"{'passed' if certificate['passed'] else 'failed'} ({effort})"),
        Row("margin at grid points", f"{_left(margin['on_grid'])}: {name}"),
        Row("worst margin", f"{_left(worst['margin'])}: {worst['limit']}"),
        Row("  where", f"{worst['place']}, {'at a' if worst['on_grid'] else 'next to a'} grid point"),
        Row("  when", f"t = {worst['t']:.3f} s, s = {worst['s']:.4f}"),
    ]
    parameters = [Row("  with " + row.name, row.value) for row in rows(worst["parameters"]) if row.value]
    return [*lines, *parameters]


def _diagnosis(diagnosis: Mapping[str, Any]) -> list[Row]:
    conflicts = [Row("cannot hold", " and ".join(names)) for names in diagnosis["conflicts"]]
    remedies = [Row("would help", sentence) for sentence in diagnosis["sentences"]]
    return [Row("where", f"{diagnosis['place']}, s = {diagnosis['s']:.4g}"), *conflicts, *remedies]


def _lowest(margin: float | None) -> float:
    """A margin on the grid from a summary, which has none where nothing holds the limit."""
    return float("-inf") if margin is None else margin


def _left(margin: float | None) -> str:
    return "not held by any forces" if margin is None else f"{100 * margin + 0.0:.2g} % of the limit"


def _binding(shares: Mapping[str, float]) -> list[Row]:
    shown = dict(list(shares.items())[:MOST_LIMITS])
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
        return ", ".join(_cell(inner) for inner in value)
    return f"{value:,}" if isinstance(value, int) else str(value)


# In the terminal ------------------------------------------------------------------------------------------


def print_summary(data: Mapping[str, Any], console: Console, place: Path) -> None:
    """Print the summary of a run and where its files are."""
    console.print(Text(headline(data), style=f"bold {_COLOURS.get(data['status'], 'red')}"))
    console.print(Text(str(data["message"])))
    if data.get("learning") and data["learning"]["rows"]:
        print_whole(iterations_table(data["learning"]["rows"]), console)
        console.print(Text(legend(data["learning"]["rows"]), style="dim"))
    for title, lines in sections(data):
        print_rows(title, lines, console)
    console.print(Text.assemble("Files in ", (str(place), "bold")), soft_wrap=True)


def print_whole(shown: Table, console: Console) -> None:
    """Print a table with no cell cut, wider than the terminal if need be."""
    width, whole = console.width, console.measure(shown, options=console.options.update(width=UNBOUNDED)).maximum
    console.width = max(width, whole)
    try:
        console.print(shown)
    finally:
        console.width = width


def print_rows(title: str, lines: Sequence[Row], console: Console) -> None:
    """Print lines under a heading."""
    table = Table.grid(padding=(0, 2))
    for name, value, share in lines:
        bar = Text("█" * round(24 * share), style="cyan") if share is not None else Text()
        table.add_row(f"  {name}", Text(value, justify="right" if share is not None else "left"), bar)
    console.print(Text(f"\n{title}", style="bold"))
    console.print(table)


def iterations_table(records: Sequence[Mapping[str, Any]]) -> Table:
    """The iterations of a learner, a line per plan."""
    heads, lines = table(records)
    gap = 1 if len(heads) <= MANY_COLUMNS else 0  # on top of the space that any two columns have between them
    shown = Table(box=box.SIMPLE_HEAD, pad_edge=False, padding=(0, gap, 0, 0))
    for head in heads:
        long = len(head) > LONGEST_HEAD
        justify: Any = "left" if head in ("Rslt", "Spdup") else "right"
        shown.add_column(
            head, justify=justify, no_wrap=not long, overflow="fold", max_width=LONGEST_HEAD if long else None
        )

    for line in lines:
        shown.add_row(*map(Text, line))
    return shown


# As a page ------------------------------------------------------------------------------------------------


def write_figures_and_page(result: PlanResult, data: Mapping[str, Any], folder: Path, figures: bool = True) -> None:
    """Draw the figures of a run into its folder and write its page."""
    if figures:
        from robustopt.plotting import write_figures

        write_figures(result.plan, result.config, folder / "figures", result.certificate)
    write_page(data, folder)


def write_execution_figures(result: ExecutionResult, folder: Path, figures: bool, video: bool) -> None:
    """Draw and film the first trial that succeeded beside the first that failed, or what there is of them."""
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


def write_learning_figures(data: Mapping[str, Any], planned: PlanResult | None, folder: Path) -> None:
    """Draw what was learned, and the best plan as `plan` draws it."""
    from robustopt.plotting import write_figures, write_learning_figure

    learning = data["learning"]
    if learning["rows"]:
        title = f"{data['name']}: {learning['algorithm']}"
        write_learning_figure(learning["rows"], learning["target_rate"], title, folder / "figures")
    if planned is not None:
        write_figures(planned.plan, planned.config, folder / "figures", planned.certificate)


def write_page(data: Mapping[str, Any], folder: Path) -> None:
    """Write the summary of a run and the figures in its folder as one page that needs no other file."""
    title = escape(headline(data))
    iterations = _iterations(data["learning"]["rows"] if data.get("learning") else [])
    tables = iterations + "".join(f"<h2>{escape(name)}</h2>\n{_table(lines)}" for name, lines in sections(data))
    paths = [path for pattern in FIGURES for path in sorted((folder / "figures").glob(pattern))]
    figures = "".join(_figure(path) for path in paths)
    page = (
        f'<!doctype html>\n<html lang="en"><head><meta charset="utf-8"><title>{title}</title><style>{_STYLE}</style>'
        f"</head>\n<body><h1>{title}</h1>\n<p>{escape(str(data['message']))}</p>\n{tables}{figures}</body></html>\n"
    )
    (folder / PAGE).write_text(page, encoding="utf-8")


def _iterations(records: Sequence[Mapping[str, Any]]) -> str:
    if not records:
        return ""
    heads, lines = table(records)
    head = "".join(f"<th>{escape(name)}</th>" for name in heads)
    body = "".join(f"<tr>{''.join(f'<td>{escape(cell)}</td>' for cell in line)}</tr>\n" for line in lines)
    meanings = f"<p>{escape(legend(records))}</p>\n"
    return f'<h2>Iterations</h2>\n<table class="iterations"><tr>{head}</tr>\n{body}</table>\n{meanings}'


def _table(lines: Sequence[Row]) -> str:
    return f"<table>{''.join(map(_table_row, lines))}</table>\n"


def _table_row(row: Row) -> str:
    bar = "" if row.share is None else f'<td class="share"><div style="width: {100 * row.share:.1f}%"></div></td>'
    return f"<tr><td>{escape(row.name)}</td><td>{escape(row.value)}</td>{bar}</tr>\n"


def _figure(path: Path) -> str:
    data = base64.b64encode(path.read_bytes()).decode()
    title = escape(path.stem.replace("_", " "))
    return f'<h2>{title}</h2>\n<img alt="{title}" src="data:image/svg+xml;base64,{data}">\n'
