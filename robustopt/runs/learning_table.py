"""The iterations of a learner as a table for people: the paper's columns, and those that its algorithm needs."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

RESULTS = {
    "success": "S",
    "failure": "F",
    "undecided": "?",
    "infeasible": "no plan",
    "not faster": "-",
    "not executed": "not run",
}
"""How results are shown; the paper has S and F."""

Record = Mapping[str, Any]


class Shown(NamedTuple):
    """A column: its head, and the text of a record in it, empty where the record has nothing for it."""

    head: str
    text: Callable[[Record], str]


def number(key: str, form: str) -> Callable[[Record], str]:
    """A column that shows a number."""

    def text(record: Record) -> str:
        value = record.get(key)
        return "" if value is None else format(value, form)

    return text


def _result(record: Record) -> str:
    result = record.get("result")
    return RESULTS.get(str(result), str(result)) if result is not None else "..."


def _sped_up(record: Record) -> str:
    faster = record.get("sped_up")
    return "" if faster is None else "S" if faster else "F"


def _executions(record: Record) -> str:
    executions = record.get("executions", 0)
    return f"{record.get('successes', 0)}/{executions - (record.get('sped_up') is not None)}" if executions else ""


def _errors(record: Record) -> str:
    width = record.get("planned_half_width") or ()
    share = "" if record.get("share") in (None, 1.0) else f" x{record['share']:g}"
    return f"{max(width):.2f}{share}" if any(width) else ""


def _fresh(record: Record) -> str:
    if record.get("success_rate") is None:
        return ""
    low, high = 100 * record["success_low"], 100 * record["success_high"]
    return f"{100 * record['success_rate']:.0f} % ({low:.0f}-{high:.0f})"


def _parameters(records: Sequence[Record]) -> list[Shown]:
    """A column for each learned parameter, named by the end of its key in the configuration; many are numbered."""
    keys = _keys(records)
    many = len(keys) > NAMED
    heads = _numbered(keys) if many else [_short(key, keys) for key in keys]
    form = ".3g" if many else ".4g"
    return [Shown(head, _parameter(key, form)) for head, key in zip(heads, keys, strict=True)]


def _keys(records: Sequence[Record]) -> list[str]:
    return list(dict.fromkeys(key for record in records for key in record.get("parameters") or {}))


def _numbered(keys: Sequence[str]) -> list[str]:
    return [f"p{i}" for i in range(1, len(keys) + 1)]


def _parameter(key: str, form: str) -> Callable[[Record], str]:
    def text(record: Record) -> str:
        value = (record.get("parameters") or {}).get(key)
        return "" if value is None else format(value, form)

    return text


def _short(key: str, keys: Sequence[str]) -> str:
    """The last parts of a key, as many as tell it from the others and say more than a number."""
    parts = key.split(".")
    for count in range(1, len(parts)):
        short = ".".join(parts[-count:])
        if not parts[-count].isdigit() and sum(other.endswith(f".{short}") for other in keys) == 1:
            return short
    return key


COLUMNS = (
    Shown("Iter", number("iteration", "d")),
    Shown("mu", number("friction", ".4g")),
    Shown("+-err", _errors),
    Shown("Time", number("duration", ".3f")),
    Shown("Rslt", _result),
    Shown("Spdup", _sped_up),
    Shown("upp", number("friction_high", ".4g")),
    Shown("low", number("friction_low", ".4g")),
    Shown("best", number("incumbent", ".3f")),
    Shown("bound", number("lower_bound", ".3f")),
    Shown("S/n", _executions),
    Shown("luck", number("bad_luck", ".2f")),
    Shown("fresh", _fresh),
)
NAMED = 3
"""Most learned parameters whose columns have their names as heads: more would not fit into a terminal."""

_MEANINGS = {
    "+-err": "widest interval of the acceleration error that was planned for [rad/s^2 or m/s^2]",
    "Rslt": "S success, F failure, ? undecided, - hardly faster than the best and so not executed",
    "Spdup": "the same path faster",
    "upp": "upper end of the interval of mu after it",
    "low": "lower end",
    "best": "shortest plan so far that counts as a success [s]",
    "bound": "least duration of what is not ruled out [s]",
    "S/n": "successes of executions",
    "luck": "probability that a plan which failed meets the success rate in question all the same",
    "fresh": "successes of fresh executions",
}
"""What heads mean that do not say it."""


def legend(records: Sequence[Record]) -> str:
    """What the columns of these records mean."""
    keys, heads = _keys(records), table(records)[0]
    meanings = dict(zip(_numbered(keys), keys, strict=True)) if len(keys) > NAMED else {}
    meanings |= {head: _MEANINGS[head] for head in heads if head in _MEANINGS}
    return "; ".join(f"{head}: {meaning}" for head, meaning in meanings.items()) + "."


def table(records: Sequence[Record]) -> tuple[list[str], list[list[str]]]:
    """Heads and lines; columns that are empty in every line are left out."""
    columns = (*COLUMNS[:2], *_parameters(records), *COLUMNS[2:])
    lines = [[column.text(record) for column in columns] for record in records]
    used = [i for i in range(len(columns)) if any(line[i] for line in lines)]
    return [columns[i].head for i in used], [[line[i] for i in used] for line in lines]
