"""Tables of records: CSV for programs, Markdown for readers and LaTeX for papers.

A table is built from records alone, so the same records give the same files, byte for byte.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from math import isfinite
from pathlib import Path

from pandas import DataFrame

Value = float | int | bool | str | None

CSV_DIGITS = 6
"""Significant digits of a number in the CSV: further ones are beyond the agreement of the solvers."""

_LATEX = str.maketrans({
    "\\": r"\textbackslash{}", "&": r"\&", "%": r"\%", "$": r"\$", "#": r"\#", "_": r"\_",
    "{": r"\{", "}": r"\}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}",
})  # fmt: skip


@dataclass(frozen=True)
class Column:
    """One column of a table.

    Attributes:
        key: entry of the records, and the head of the column in CSV.
        head: for readers, with the unit.
        form: format of its numbers for readers, e.g. ".3f".
        latex: its head in LaTeX if that is not the plain one.
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

    def cells(self, forms: Sequence[str]) -> DataFrame:
        """Return the cells as text.

        Args:
            forms: format of the numbers of each column.
        """
        cells = {
            column.key: [_cell(record.get(column.key), form) for record in self.records]
            for column, form in zip(self.columns, forms, strict=True)
        }
        return DataFrame(cells)

    def shown(self) -> DataFrame:
        """Return the cells as readers see them."""
        return self.cells([column.form for column in self.columns])

    def numeric(self) -> list[bool]:
        """Return whether each column holds numbers only."""
        values = [[record.get(column.key) for record in self.records] for column in self.columns]
        return [not any(isinstance(value, (str, bool)) for value in column) for column in values]


def _cell(value: Value, form: str) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return format(value, form) if isfinite(value) else ""
    return "" if value is None else str(value)


def csv_text(table: Table) -> str:
    """Return a table as CSV, with numbers to `CSV_DIGITS` significant digits.

    Args:
        table: the table.
    """
    return table.cells([f".{CSV_DIGITS}g"] * len(table.columns)).to_csv(index=False, lineterminator="\n")


def markdown_text(table: Table) -> str:
    """Return a table in Markdown with its caption above; cells are not padded, so one change affects one line.

    Args:
        table: the table.
    """
    heads = [column.head for column in table.columns]
    rules = ["---:" if numeric else "---" for numeric in table.numeric()]
    cells = table.shown().replace(r"\|", r"\\|", regex=True)
    lines = [f"| {' | '.join(line)} |" for line in (heads, rules, *cells.to_numpy())]
    caption = [table.caption, ""] if table.caption else []
    return "\n".join([*caption, *lines]) + "\n"


def latex_text(table: Table) -> str:
    r"""Return a table as a LaTeX `table` with rules of the package booktabs.

    Args:
        table: the table.
    """
    heads = [column.latex or column.head.translate(_LATEX) for column in table.columns]
    cells = table.shown().map(lambda cell: cell.translate(_LATEX))
    alignment = "".join("r" if numeric else "l" for numeric in table.numeric())
    caption = [rf"\caption{{{table.caption.translate(_LATEX)}}}"] if table.caption else []
    return "\n".join([
        r"\begin{table}", r"\centering", *caption, rf"\begin{{tabular}}{{{alignment}}}", r"  \toprule", _line(heads),
        r"  \midrule", *map(_line, cells.to_numpy()), r"  \bottomrule", r"\end{tabular}", r"\end{table}",
    ]) + "\n"  # fmt: skip


def _line(cells: Iterable[str]) -> str:
    return f"  {' & '.join(cells)} \\\\"


def write_table(table: Table, folder: Path, name: str, above: str = "", below: str = "") -> list[Path]:
    """Write `name`.csv, .md and .tex into a folder.

    Args:
        table: the table.
        folder: made if it is missing.
        name: of the files.
        above: Markdown paragraphs above the table.
        below: Markdown paragraphs below it.

    Returns:
        The files.
    """
    folder.mkdir(parents=True, exist_ok=True)
    prose = "\n".join(part.strip("\n") + "\n" for part in (above, markdown_text(table), below) if part)
    texts = {"csv": csv_text(table), "md": prose, "tex": latex_text(table)}
    paths = [folder / f"{name}.{suffix}" for suffix in texts]
    for path, text in zip(paths, texts.values(), strict=True):
        path.write_text(text, encoding="utf-8")
    return paths
