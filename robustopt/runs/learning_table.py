"""The iterations of a learner as a table for people: the paper's columns, and those of its algorithm."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

from robustopt.runs.records import Iteration

RESULTS = {
    "success": "S",
    "failure": "F",
    "undecided": "?",
    "infeasible": "no plan",
    "not faster": "-",
    "not executed": "not run",
}
"""Results as the table shows them; the paper has S and F."""


class Shown(NamedTuple):
    """Column of the table.

    Attributes:
        head: its head.
        text: returns the text of a record in it, empty if the record has nothing for it.
        meaning: meaning of a head that is too short to say it.
    """

    head: str
    text: Callable[[Iteration], str]
    meaning: str = ""


def _number(value: float | None, form: str) -> str:
    return "" if value is None else format(value, form)


def _result(record: Iteration) -> str:
    return "..." if record.result is None else RESULTS.get(record.result, record.result)


def _sped_up(record: Iteration) -> str:
    return "" if record.sped_up is None else "S" if record.sped_up else "F"


def _executions(record: Iteration) -> str:
    planned_speed = record.executions - (record.sped_up is not None)
    return f"{record.successes}/{planned_speed}" if record.executions else ""


def _errors(record: Iteration) -> str:
    share = "" if record.share == 1.0 else f" x{record.share:g}"
    width = record.planned_half_width
    return f"{max(width):.2f}{share}" if any(width) else ""


def _luck(record: Iteration) -> str:
    return _number(record.bad_luck, ".2f")


def _fresh(record: Iteration) -> str:
    rate, low, high = record.success_rate, record.success_low, record.success_high
    if rate is None or low is None or high is None:
        return ""
    return f"{100 * rate:.0f} % ({100 * low:.0f}-{100 * high:.0f})"


def _parameters(records: Sequence[Iteration]) -> list[Shown]:
    """Return a column for each learned parameter, named by the end of its key; many are numbered."""
    keys = _keys(records)
    many = len(keys) > NAMED
    heads = _numbered(keys) if many else [_short(key, keys).replace("_", " ") for key in keys]
    form = ".3g" if many else ".4g"
    return [Shown(head, _parameter(key, form)) for head, key in zip(heads, keys, strict=True)]


def _keys(records: Sequence[Iteration]) -> list[str]:
    return list(dict.fromkeys(key for record in records for key in record.parameters))


def _numbered(keys: Sequence[str]) -> list[str]:
    return [f"p{i}" for i in range(1, len(keys) + 1)]


def _parameter(key: str, form: str) -> Callable[[Iteration], str]:
    return lambda record: _number(record.parameters.get(key), form)


def _short(key: str, keys: Sequence[str]) -> str:
    """Return the last parts of a key, as many as tell it from the others and say more than a number."""
    parts = key.split(".")
    for count in range(1, len(parts)):
        short = ".".join(parts[-count:])
        if not parts[-count].isdecimal() and sum(other.endswith(f".{short}") for other in keys) == 1:
            return short
    return key


COLUMNS = (
    Shown("Iter", lambda record: _number(record.iteration, "d")),
    Shown("mu", lambda record: _number(record.friction, ".4g")),
    Shown(
        "+-err", _errors, "half width of the widest interval of the acceleration error in the plan [rad/s^2 or m/s^2]"
    ),
    Shown("Time", lambda record: _number(record.duration, ".3f")),
    Shown("Rslt", _result, "S success, F failure, ? undecided, - hardly faster than the best and so not executed"),
    Shown("Spdup", _sped_up, "the same path faster"),
    Shown("upp", lambda record: _number(record.friction_high, ".4g"), "upper end of the interval of mu after it"),
    Shown("low", lambda record: _number(record.friction_low, ".4g"), "lower end"),
    Shown("best", lambda record: _number(record.incumbent, ".3f"), "shortest plan so far that counts as a success [s]"),
    Shown("bound", lambda record: _number(record.lower_bound, ".3f"), "shortest duration that is not ruled out [s]"),
    Shown("S/n", _executions, "successes of executions"),
    Shown("luck", _luck, "probability that a plan which failed meets the success rate in question all the same"),
    Shown("fresh", _fresh, "successes of fresh executions"),
)
NAMED = 3
"""Largest number of learned parameters whose columns are headed by their names: more would not fit into a terminal."""


def legend(records: Sequence[Iteration]) -> str:
    """Return a sentence with the meanings of the columns.

    Args:
        records: the iterations in the table.
    """
    keys, heads = _keys(records), table(records)[0]
    meanings = dict(zip(_numbered(keys), keys, strict=True)) if len(keys) > NAMED else {}
    meanings |= {column.head: column.meaning for column in COLUMNS if column.meaning and column.head in heads}
    return "; ".join(f"{head}: {meaning}" for head, meaning in meanings.items()) + "."


def table(records: Sequence[Iteration]) -> tuple[list[str], list[list[str]]]:
    """Return heads and lines of the table; columns that are empty in every line are left out.

    Args:
        records: the iterations in the table.
    """
    columns = (*COLUMNS[:2], *_parameters(records), *COLUMNS[2:])
    lines = [[column.text(record) for column in columns] for record in records]
    used = [i for i in range(len(columns)) if any(line[i] for line in lines)]
    return [columns[i].head for i in used], [[line[i] for i in used] for line in lines]
