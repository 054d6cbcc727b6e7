"""Descriptions of the types and values of the configuration, for error messages and the reference page."""

from __future__ import annotations

import difflib
import re
import types
from collections.abc import Collection, Iterator, Sequence
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

from annotated_types import Ge, Gt, Le
from pydantic.fields import FieldInfo

from robustopt.config.document import shortened
from robustopt.config.section import Section

_UNITS = {"m": "metres", "rad": "radians", "kg": "kilograms", "s": "seconds", "N": "newtons"}
_COUNTS = {2: "two", 3: "three", 4: "four", 6: "six"}


def fields(model: type[Section]) -> dict[str, Any]:
    """Return the annotated types of the keys of a section that a configuration may set, by key.

    Args:
        model: the section.
    """
    hints = get_type_hints(model, include_extras=True)
    return {name: hints[name] for name, info in model.model_fields.items() if not info.exclude}


def named_sections(model: type[Section]) -> type[Section] | None:
    """Return the section that a key stands for if it is a name, as in `robot.limits`; None if all keys are given.

    Args:
        model: the section.
    """
    if model.model_config.get("extra") != "allow":
        return None
    named: type[Section] = get_args(get_type_hints(model)["__pydantic_extra__"])[1]
    return named


def unwrap(annotation: Any) -> tuple[Any, tuple[Any, ...]]:
    """Return the type inside `Annotated`, and the constraints on it.

    Args:
        annotation: a type, with or without `Annotated`.
    """
    if get_origin(annotation) is Annotated:
        inner, *notes = get_args(annotation)
        base, more = unwrap(inner)
        return base, (*more, *_constraints(notes))
    return annotation, ()


def _constraints(notes: Sequence[Any]) -> Iterator[Any]:
    for note in notes:
        yield from note.metadata if isinstance(note, FieldInfo) else (note,)


def choices(annotation: Any) -> tuple[Any, ...]:
    """Return the alternatives of a union other than None, or the type itself if it is no union.

    Args:
        annotation: a type.
    """
    base, notes = unwrap(annotation)
    if get_origin(base) in (Union, types.UnionType):
        return tuple(choice for choice in get_args(base) if choice is not type(None))
    return (Annotated[base, *notes],) if notes else (base,)


def expected(annotation: Any, constraints: Sequence[Any] = ()) -> str:
    """Describe a type: `a number above 0, or a mapping of names to numbers above 0`.

    Args:
        annotation: the type.
        constraints: bounds that the field itself adds to its type.
    """
    options = choices(annotation)
    return ", or ".join(_one(option, constraints if len(options) == 1 else ()) for option in options)


def _one(annotation: Any, constraints: Sequence[Any]) -> str:
    head, tail = _noun(annotation, constraints)
    plain = head in ("text", "true or false") or get_origin(unwrap(annotation)[0]) is Literal
    article = "" if plain else "a "
    return f"{article}{head}{tail}"


def _several(annotation: Any) -> str:
    return " or ".join(_plural(choice) for choice in choices(annotation))


def _plural(annotation: Any) -> str:
    head, tail = _noun(annotation, ())
    return head if get_origin(unwrap(annotation)[0]) is Literal else f"{head}s{tail}"


def _noun(annotation: Any, constraints: Sequence[Any]) -> tuple[str, str]:
    """Return the noun of a type and the words after it, so that the noun can be put into the plural."""
    base, notes = unwrap(annotation)
    origin, arguments = get_origin(base), get_args(base)
    if origin is Literal:
        return arguments[0] if len(arguments) == 1 else "one of " + ", ".join(arguments), ""
    if origin is tuple:
        if arguments[-1] is Ellipsis:
            return "list", f" of {_several(arguments[0])}"
        return "list", f" of {_COUNTS[len(arguments)]} {_several(arguments[0])}"
    if origin is dict:
        return "mapping", f" of names to {_several(arguments[1])}"
    if base is bool:
        return "true or false", ""
    if base in (int, float):
        endless = any(getattr(note, "allow_inf_nan", False) for note in notes)
        noun = "whole number" if base is int else "number"
        return noun, _bounds((*notes, *constraints)) + (" or .inf" if endless else "")
    if isinstance(base, type) and issubclass(base, Section):
        named = " and names" if named_sections(base) is not None else ""
        return "section", f" with the keys {', '.join(fields(base))}{named}"
    return "text", ""


def _bounds(notes: Sequence[Any]) -> str:
    low = next((note.ge for note in notes if isinstance(note, Ge)), None)
    high = next((note.le for note in notes if isinstance(note, Le)), None)
    if low is not None and high is not None:
        return f" from {_number(low)} to {_number(high)}"
    above = next((note.gt for note in notes if isinstance(note, Gt)), None)
    if low is not None:
        return f" of at least {_number(low)}"
    return f" above {_number(above)}" if above is not None else ""


def _number(value: Any) -> str:
    return str(int(value)) if value == int(value) else f"{value:g}"


def meaning(info: FieldInfo) -> str:
    """Return the description of a field without its unit.

    Args:
        info: the field.
    """
    return re.sub(r"\s*\[[^\[\]]*\]$", "", info.description or "")


def purpose(info: FieldInfo) -> str:
    """Return the first clause of the description of a field.

    Args:
        info: the field.
    """
    return meaning(info).split(";")[0]


def unit(info: FieldInfo) -> str:
    """Return the unit of a field, which stands in brackets at the end of its description; empty without one.

    Args:
        info: the field.
    """
    found = re.search(r"\[([^\[\]]*)\]$", info.description or "")
    return found[1] if found and "," not in found[1] else ""


def in_unit(info: FieldInfo) -> str:
    """Return ` in metres` for a field in metres, and likewise for other units; empty for a field without a unit.

    Args:
        info: the field.
    """
    symbol = unit(info)
    return f" in {_UNITS.get(symbol, symbol)}" if symbol else ""


def found(value: Any) -> str:
    """Describe a value, short enough for one line of a message.

    Args:
        value: the value that was found.
    """
    if value is None:
        return "nothing"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, dict):
        return f"a section with the keys {shortened(', '.join(map(str, value)))}" if value else "an empty section"
    if isinstance(value, (list, tuple)):
        return f"the list {shortened(str(list(value)))}" if value else "an empty list"
    if isinstance(value, int) and abs(value) >= 10**20:
        return "a whole number of more than 20 digits"
    return f"the text {shortened(repr(value))}" if isinstance(value, str) else shortened(str(value))


def did_you_mean(name: str, valid: Collection[str]) -> str:
    """Return a question about the valid name that is most similar to an unknown one; empty if none is.

    Args:
        name: the unknown name.
        valid: the valid names.
    """
    near = difflib.get_close_matches(name, valid, n=1)
    return f"did you mean {near[0]}? " if near else ""
