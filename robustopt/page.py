"""A self-contained page in HTML with the summary and the figures of a run."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from html import escape
from pathlib import Path
from typing import NamedTuple

from robustopt.runs.learning_table import legend, table
from robustopt.runs.records import Iteration

_STYLE = """
:root { color-scheme: light dark; }
body { font: 15px/1.5 system-ui, sans-serif; max-width: 60rem; margin: 2rem auto; padding: 0 1rem; }
h1 { font-size: 1.5rem; } h2 { font-size: 1.1rem; margin: 1.5rem 0 0.3rem; }
table { border-collapse: collapse; } td { padding: 0.1rem 1.5rem 0.1rem 0; vertical-align: top; }
td:has(i) { white-space: nowrap; }
span { display: inline-block; min-width: 4rem; text-align: right; margin-right: 1rem; }
i { display: inline-block; background: #3b82ab; height: 0.8rem; width: calc(var(--share) * min(16rem, 25vw)); }
.wide { overflow-x: auto; } img { background: white; max-width: max(100%, 40rem); }
.iterations td, th { padding: 0.1rem 0.8rem 0.1rem 0; text-align: right; white-space: nowrap; }
"""


class Row(NamedTuple):
    """Line of a summary: a name, a value, and for shares the part of the whole, drawn as a bar."""

    name: str
    value: str
    share: float | None = None


def page(
    headline: str,
    sentences: Sequence[str],
    records: Sequence[Iteration],
    sections: Sequence[tuple[str, Sequence[Row]]],
    figures: Sequence[Path],
) -> str:
    """Return a page as text.

    Args:
        headline: title of the page.
        sentences: paragraphs below it.
        records: iterations of a learner, for a table.
        sections: headings and lines of the other tables.
        figures: vector graphics that the page contains.
    """
    title = escape(headline)
    paragraphs = "".join(f"<p>{escape(text)}</p>\n" for text in sentences)
    tables = "".join(f"<h2>{escape(name)}</h2>\n{_table(lines)}" for name, lines in sections)
    return (
        f'<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        f'<meta name="viewport" content="width=device-width, initial-scale=1"><title>{title}</title>'
        f"<style>{_STYLE}</style></head>\n<body><h1>{title}</h1>\n{paragraphs}{_iterations(records)}{tables}"
        f"{''.join(map(_figure, figures))}</body></html>\n"
    )


def _iterations(records: Sequence[Iteration]) -> str:
    if not records:
        return ""
    heads, lines = table(records)
    head = "".join(f"<th>{escape(name)}</th>" for name in heads)
    body = "".join(f"<tr>{''.join(f'<td>{escape(cell)}</td>' for cell in line)}</tr>\n" for line in lines)
    meanings = f"<p>{escape(legend(records))}</p>\n"
    lines_of_plans = f"<table><tr>{head}</tr>\n{body}</table>"
    return f'<h2>Iterations</h2>\n<div class="wide iterations">{lines_of_plans}</div>\n{meanings}'


def _table(lines: Sequence[Row]) -> str:
    return f"<table>{''.join(map(_table_row, lines))}</table>\n"


def _table_row(row: Row) -> str:
    value = escape(row.value)
    if row.share is not None:
        value = f'<span>{value}</span><i style="--share: {row.share:.3f}"></i>'
    return f"<tr><td>{escape(row.name)}</td><td>{value}</td></tr>\n"


def _figure(path: Path) -> str:
    data = base64.b64encode(path.read_bytes()).decode()
    title = escape(path.stem.replace("_", " "))
    return f'<h2>{title}</h2>\n<div class="wide"><img alt="{title}" src="data:image/svg+xml;base64,{data}"></div>\n'
