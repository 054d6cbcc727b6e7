"""CSV files of joint positions: any delimiter, comments, and columns in any order."""

from __future__ import annotations

import csv
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import numpy as np

from robustopt.arrays import Array
from robustopt.files import MOST_BYTES, read_text
from robustopt.recordings.recording import (
    MOST_ROWS,
    Layout,
    Recording,
    counted,
    refused,
    require_few,
    require_forward,
)

_COMMENTS = ("#", "%", "//")
_POSITION = r"(?:q|pos|positions?)"
_BETWEEN = r"[_./: -]"
_TIME = re.compile(r"(?:t|time|time_?stamp|time_from_start|elapsed|seconds|secs?)(?:[_ ](s|sec|ms|us|ns))?", re.I)
_UNIT = re.compile(r"\s*[\[(]\s*([^\[\]()]*?)\s*[\])]$")
_SECONDS = {"ms": 1e-3, "us": 1e-6, "ns": 1e-9}
_DEGREES = ("deg", "degree", "degrees", "°")
_RADIANS = ("rad", "radian", "radians")


@dataclass(frozen=True)
class _Table:
    """Cells of a file: the header, if there is one, and rows (W, m) with their lines (W,)."""

    heads: tuple[str, ...]
    rows: list[list[str]]
    lines: list[int]


def read_table(file: Path, layout: Layout) -> Recording:
    """Return the joint positions in a CSV file.

    Args:
        file: the file.
        layout: the positions that the path needs.

    Raises:
        OSError: the file cannot be read.
        PathError: a column is missing or in another unit, rows have different lengths, a cell is no number, or the
            time runs backwards.
    """
    table = _cells(file, read_text(file, MOST_BYTES), layout)
    require_few(file, len(table.rows))
    if not table.rows:
        return Recording(np.zeros((0, len(layout.joints))))
    _require_one_length(file, table, layout)
    if not table.heads:
        return Recording(_numbers(file, table, range(len(layout.joints)), layout.joints))
    columns = _joint_columns(file, table.heads, layout)
    q, used = _numbers(file, table, columns, table.heads), set(columns)
    clock = _clock(table, used)
    t = None
    if clock is not None:
        t = clock[1] * _numbers(file, table, [clock[0]], table.heads)[:, 0]
        require_forward(file, t, [f"line {line}" for line in table.lines])
        used.add(clock[0])
    unused = [head for i, head in enumerate(table.heads) if i not in used and head]
    notes = (f"{file.name}: columns not used: {', '.join(unused)}",) if unused else ()
    return Recording(q, t, notes)


# Cells ----------------------------------------------------------------------------------------------------


def _cells(file: Path, text: str, layout: Layout) -> _Table:
    """Return the cells of a text; a comment just before the first row is its header if it names all joints."""
    comment = ""
    first = ""
    for line in map(str.strip, text.splitlines()):
        if line.startswith(_COMMENTS):
            comment = line.lstrip("#%/ ")
        elif line:
            first = line
            break
    delimiter = next((mark for mark in (";", ",", "\t") if mark in first), " ")
    try:
        found = list(islice(_rows(text.splitlines(), delimiter), MOST_ROWS + 2))  # the first may be a header
        above = next(_rows([comment], delimiter), (0, []))[1]
    except csv.Error as error:
        raise refused(file, f"cannot be read: {error}") from error
    if found and all(row[-1] == "" for _, row in found):  # every line ends with a delimiter
        found = [(line, row[:-1]) for line, row in found if len(row) > 1]
    heads: list[str] = []
    if found and 2 * sum(map(_is_numeric, found[0][1])) < len(found[0][1]):
        heads = found.pop(0)[1]
    elif found and len(above) == len(found[0][1]) and all(_matches(above, joint) for joint in layout.joints):
        heads = above
    return _Table(tuple(heads), [row for _, row in found], [line for line, _ in found])


def _rows(lines: Sequence[str], delimiter: str) -> Iterator[tuple[int, list[str]]]:
    """Yield the rows that are not empty, with their lines, counted from 1."""
    kept = ("" if line.lstrip().startswith(_COMMENTS) else line.strip(" ") for line in lines)
    reader = csv.reader(kept, delimiter=delimiter, skipinitialspace=True)
    for row in reader:
        cells = [cell.strip() for cell in row]
        if any(cells):
            yield reader.line_num, cells


def _require_one_length(file: Path, table: _Table, layout: Layout) -> None:
    length = len(table.heads or table.rows[0])
    wrong = [i for i, row in enumerate(table.rows) if len(row) != length]
    if wrong:
        counts = sorted({len(table.rows[i]) for i in wrong})
        have = f"{counts[0]}" if len(counts) == 1 else f"{counts[0]} to {counts[-1]}"
        rows = counted(len(wrong), "row has", "rows have")
        values = "value" if counts == [1] else "values"
        raise refused(file, f"{rows} {have} {values}; expected {length}; first: line {table.lines[wrong[0]]}")
    if not table.heads and length != len(layout.joints):
        joints = f"the robot has {len(layout.joints)} joints: {', '.join(layout.joints)}"
        raise refused(file, f"without a header, but has {length} values; {joints}; expected as many, or a header")


def _numbers(file: Path, table: _Table, columns: Sequence[int], heads: Sequence[str]) -> Array:
    """Return the numbers in some columns (W, len(columns))."""
    values = np.array([[_number(row[column]) for column in columns] for row in table.rows], dtype=float)
    wrong = np.argwhere(~np.isfinite(values))
    if len(wrong):
        i, j = wrong[0]
        cell = table.rows[i][columns[j]]
        count = counted(len(wrong), "value is not a finite number", "values are not finite numbers")
        remedy = f"; expected a decimal point: {cell.replace(',', '.')}" if _is_numeric(cell.replace(",", ".")) else ""
        place = f"{cell!r} in line {table.lines[i]}, column {heads[columns[j]]}"
        raise refused(file, f"{count}; first: {place}{remedy if ',' in cell else ''}")
    return values


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return float("nan")


def _is_numeric(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


# Header ---------------------------------------------------------------------------------------------------


def _matches(heads: Sequence[str], joint: str) -> list[int]:
    """Return the columns of a joint: the one of its name, else those of its name with a word for positions."""
    bare = [_UNIT.sub("", head) for head in heads]
    exact = [i for i, head in enumerate(bare) if head == joint]
    units = f"(?:_(?:{'|'.join((*_DEGREES, *_RADIANS, 'm'))}))?"
    before, behind = f"(?:/?joint_states?[/.])?(?:{_POSITION}{_BETWEEN})?", f"(?:{_BETWEEN}{_POSITION})?"
    pattern = re.compile(f"{before}{re.escape(joint)}{behind}{units}", re.I)
    return exact or [i for i, head in enumerate(bare) if pattern.fullmatch(head)]


def _joint_columns(file: Path, heads: Sequence[str], layout: Layout) -> list[int]:
    """Return the column of each joint (n,)."""
    found = [_matches(heads, joint) for joint in layout.joints]
    missing = [joint for joint, columns in zip(layout.joints, found, strict=True) if not columns]
    if missing:
        columns = f"the columns are {', '.join(heads)}; they must be the joints {', '.join(layout.joints)}"
        raise refused(file, f"{columns}, in any order and among others; found none for {', '.join(missing)}")
    for joint, columns_of in zip(layout.joints, found, strict=True):
        if len(columns_of) > 1:
            several = " and ".join(heads[i] for i in columns_of)
            raise refused(file, f"the columns {several} are both for the joint {joint}; expected one")
    columns_in_order = [columns_of[0] for columns_of in found]
    _require_unit(file, [heads[i] for i in columns_in_order], layout)
    return columns_in_order


def _require_unit(file: Path, heads: Sequence[str], layout: Layout) -> None:
    for head in heads:
        unit = (_UNIT.search(head) or re.search(r"_([a-z°]+)$", head, re.I) or [head, ""])[1].lower()
        if unit in (_RADIANS if layout.degrees else _DEGREES):
            said, other = ("radians", "degrees") if layout.degrees else ("degrees", "radians")
            raise refused(file, f"the column {head} is in {said}; expected path.unit: {said} (found {other})")


def _clock(table: _Table, used: set[int]) -> tuple[int, float] | None:
    """Return the column of the time and its unit in seconds; None if there is none, or only texts."""
    for i, head in enumerate(table.heads):
        named, bracket = _TIME.fullmatch(_UNIT.sub("", head)), _UNIT.search(head)
        if i not in used and named and any(_is_numeric(row[i]) for row in table.rows):
            unit = (bracket[1] if bracket else named[1] or "s").lower()
            return i, _SECONDS.get(unit, 1.0)
    return None
