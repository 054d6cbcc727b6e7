"""Tables: records of runs as CSV for programs, Markdown for readers and LaTeX for papers.

A table is built from records alone, so the same records give the same files, byte for byte.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import isfinite
from pathlib import Path

Value = float | int | bool | str | None

CSV_DIGITS = 6
"""Significant digits of a number in the CSV: further ones are beyond what the solvers agree to."""

_LATEX = {
    "\\": r"\textbackslash{}", "&": r"\&", "%": r"\%", "$": r"\$", "#": r"\#", "_": r"\_",
    "{": r"\{", "}": r"\}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}",
}  # fmt: skip


@dataclass(frozen=True)
class Column:
    """One column of a table.

    key: entry of the records, and the head of the column in CSV; head: for readers, with the unit; form: format of its
    numbers for readers, e.g. ".3f"; latex: its head in LaTeX where that is not the plain one
    """

    key: str
    head: str
    form: str = ""
    latex: str = ""


@dataclass(frozen=True)
class Table:
    """Records with the columns that are shown of them; an entry that a record lacks, or a nan, is an empty cell."""

    columns: tuple[Column, ...]
    records: tuple[Mapping[str, Value], ...]
    caption: str = ""


def csv_text(table: Table) -> str:
    """The table as CSV, numbers to `CSV_DIGITS` significant digits."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow([column.key for column in table.columns])
    writer.writerows(_cells(table, [f".{CSV_DIGITS}g"] * len(table.columns)))
    return stream.getvalue()


def markdown_text(table: Table) -> str:
    """The table in Markdown, its caption above it."""
    heads = [column.head for column in table.columns]
    rows = [[cell.replace("|", r"\|") for cell in row] for row in _cells(table, [c.form for c in table.columns])]
    rules = ["---:" if right else "---" for right in _right_aligned(table)]
    lines = ["| " + " | ".join(row) + " |" for row in [heads, rules, *rows]]
    caption = [table.caption, ""] if table.caption else []
    return "\n".join([*caption, *lines]) + "\n"


def latex_text(table: Table) -> str:
    r"""The table as a LaTeX `table` with rules of the package booktabs."""
    heads = [column.latex or _latex(column.head) for column in table.columns]
    rows = [[_latex(cell) for cell in row] for row in _cells(table, [c.form for c in table.columns])]
    alignment = "".join("r" if right else "l" for right in _right_aligned(table))
    caption = [rf"\caption{{{_latex(table.caption)}}}"] if table.caption else []
    body = [_line(heads), r"  \midrule", *map(_line, rows)]
    return "\n".join([
        r"\begin{table}", r"\centering", *caption, rf"\begin{{tabular}}{{{alignment}}}", r"  \toprule", *body,
        r"  \bottomrule", r"\end{tabular}", r"\end{table}",
    ]) + "\n"  # fmt: skip


def _line(cells: Sequence[str]) -> str:
    return "  " + " & ".join(cells) + r" \\"


def write_table(table: Table, folder: Path, name: str, above: str = "", below: str = "") -> list[Path]:
    """Write `name`.csv, .md and .tex into a folder, made if it is missing, and return the files.

    above, below: Markdown paragraphs around the table
    """
    folder.mkdir(parents=True, exist_ok=True)
    prose = "\n".join(part.strip("\n") + "\n" for part in (above, markdown_text(table), below) if part)
    texts = {"csv": csv_text(table), "md": prose, "tex": latex_text(table)}
    paths = [folder / f"{name}.{suffix}" for suffix in texts]
    for path, text in zip(paths, texts.values(), strict=True):
        path.write_text(text, encoding="utf-8")
    return paths


def _cells(table: Table, forms: Sequence[str]) -> list[list[str]]:
    return [
        [_cell(record.get(column.key), form) for column, form in zip(table.columns, forms, strict=True)]
        for record in table.records
    ]


def _cell(value: Value, form: str) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, int):
        return str(value)
    if isinstance(value, float):
        return format(value, form) if isfinite(value) else ""
    return value or ""


def _right_aligned(table: Table) -> list[bool]:
    """Whether a column holds numbers only."""
    kinds = [[record.get(column.key) for record in table.records] for column in table.columns]
    return [not any(isinstance(value, (str, bool)) for value in values) for values in kinds]


def _latex(text: str) -> str:
    return "".join(_LATEX.get(character, character) for character in text)
