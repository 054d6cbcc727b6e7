"""Conversion of plain values to a `Config`, which reports all mistakes of a document at once, in words."""

from __future__ import annotations

from collections.abc import Iterable
from copy import deepcopy
from pathlib import Path
from typing import Any

from pydantic import ValidationError
from pydantic.fields import FieldInfo
from pydantic_core import ErrorDetails

from robustopt.config.check import check
from robustopt.config.document import Document, Key
from robustopt.config.model import HANDS, Config
from robustopt.config.object_model import ContactConfig, ObjectConfig
from robustopt.config.section import Section
from robustopt.config.words import (
    choices,
    did_you_mean,
    expected,
    fields,
    found,
    in_unit,
    named_sections,
    purpose,
    unwrap,
)
from robustopt.errors import ConfigError

_PLACEHOLDERS: dict[str, Any] = {
    "name": "unnamed",
    "robot": {"model": "unnamed"},
    "tray": {"size": [1.0, 1.0, 1.0], "mass": 1.0},
    "path": {},
}
"""Substitutes for required sections that are wrong, so that the rest can be checked; never part of a result."""

_SIZE = "size: "
"""Beginning of the kind of a mistake about the size of a number."""

_A_STEP: dict[str, Any] = {"foot": "right", "to": [0.0, 0.0]}
"""Substitute for steps that are wrong: a path without steps has other keys."""


def validate(document: Document, folder: Path) -> Config:
    """Return the configuration in a document.

    Args:
        document: plain values and their locations.
        folder: folder that relative file names refer to.

    Raises:
        ConfigError: the document has mistakes; the error lists all of them, in the order of the document.
    """
    data = document.data
    if not isinstance(data, dict):
        content = "an empty file" if data is None else found(data)
        message = f"found {content}; expected keys and values, such as `name: my-task`"
        raise ConfigError([*document.problems, document.problem((), message)][:1])
    data = _with_nominal_friction(data)
    config, own = _attempt(data, folder)
    usable, doubtful = (config, set[Key]()) if config is not None else _usable(data, own, folder)
    related: dict[Key, str] = {}
    if usable is not None:
        names = tuple(data["objects"]) if isinstance(data.get("objects"), dict) else ()
        without_rail = usable.path.steps is not None and usable.path.rail is None
        if without_rail and any(key[:2] == ("path", "rail") for key in doubtful):
            names += HANDS
        for key, message in check(usable, names):
            if not any(_depends(key, bad) for bad in doubtful):
                related.setdefault(key, message)
    wrong = sorted({**related, **own}.items(), key=lambda item: document.position(item[0]))
    problems = document.problems + [document.problem(key, message) for key, message in wrong]
    if problems or config is None:
        raise ConfigError(problems)
    return config


def with_sections(config: Config, sections: dict[str, Any]) -> Config | None:
    """Return a copy of a valid configuration with some sections replaced from plain data.

    Args:
        config: the configuration.
        sections: plain data of top-level sections, by key.

    Returns:
        The copy, or None if `validate` must check the whole: the data have mistakes, or are not a section of their own.
    """
    read: dict[str, Any] = {}
    try:
        for name, data in sections.items():
            kind = Config.model_fields[name].annotation
            if name == "objects":
                read[name] = {
                    key: ObjectConfig.model_validate(_frozen(item), strict=True) for key, item in data.items()
                }
            elif isinstance(kind, type) and issubclass(kind, Section):
                read[name] = kind.model_validate(_frozen(data), strict=True)
            else:
                return None
    except (ValidationError, KeyError):
        return None
    changed = config.model_copy(update=read)
    return None if any(check(changed, like=config)) else changed


def _frozen(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _frozen(inner) for key, inner in value.items()}
    return tuple(_frozen(inner) for inner in value) if isinstance(value, list) else value


def _attempt(data: dict[str, Any], folder: Path) -> tuple[Config | None, dict[Key, str]]:
    """Return the configuration, or None and the mistakes of single keys, by key."""
    wrong: dict[Key, str] = {("folder",): _unknown(Config, "folder")} if "folder" in data else {}
    try:
        config = Config.model_validate({**_frozen(data), "folder": folder}, strict=True)
        return (None if wrong else config), wrong
    except ValidationError as error:
        kinds = [(_kind(item), _place(item["loc"], data), item["loc"]) for item in error.errors()]
        messages = [_message(kind, place, loc, data) for kind, place, loc in sorted(_deepest(kinds), key=_by_size)]
        return None, wrong | dict(messages)


def _with_nominal_friction(data: dict[str, Any]) -> dict[str, Any]:
    """Return the data with the middle of an interval of friction as its nominal value, unless one is given."""
    uncertainty, contact = data.get("uncertainty"), data.get("contact") or {}
    intervals = uncertainty.get("friction") if isinstance(uncertainty, dict) else None
    if intervals is None or not isinstance(contact, dict) or contact.get("friction") is not None:
        return data
    by_name = intervals if isinstance(intervals, dict) else {"default": intervals}
    try:
        middle = {name: 0.5 * (low + high) for name, (low, high) in by_name.items()}
    except (TypeError, ValueError):
        return data
    standard = ContactConfig().friction
    friction = {"default": standard, **middle} if isinstance(intervals, dict) else middle["default"]
    return {**data, "contact": {**contact, "friction": friction}}


def _place(loc: Iterable[str | int], data: Any) -> Key:
    """Return the part of a pydantic location that is in the data; the rest names alternatives of a union."""
    key: Key = ()
    for part in loc:
        inside = part in data if isinstance(data, dict) else isinstance(data, list) and part in range(len(data))
        if inside:
            key, data = (*key, part), data[part]
    return key


def _deepest(kinds: list[tuple[str, Key, Any]]) -> list[tuple[str, Key, Any]]:
    """Drop mistakes of a whole value if another alternative of its union names the part that is wrong."""
    places = [place for _, place, _ in kinds]
    return [
        (kind, place, loc)
        for kind, place, loc in kinds
        if _names_a_key(kind, loc)
        or kind.startswith(_SIZE)
        or not any(p != place and p[: len(place)] == place for p in places)
    ]


def _names_a_key(kind: str, loc: Any) -> bool:
    return kind == "extra_forbidden" or (kind == "missing" and isinstance(loc[-1], str))


def _by_size(mistake: tuple[str, Key, Any]) -> bool:
    """Sort mistakes about the size of a number last: they win over those of other alternatives of a union."""
    return mistake[0].startswith(_SIZE)


def _kind(error: ErrorDetails) -> str:
    """Return the kind of a mistake; for a number of a wrong size, the size that is expected."""
    return f"{_SIZE}{error['msg']}" if error["type"] == "size" else str(error["type"])


def _message(kind: str, place: Key, loc: Any, data: Any) -> tuple[Key, str]:
    if kind == "extra_forbidden":
        bases = [unwrap(option)[0] for option in choices(_type_at(place[:-1])[0])]
        return place, _unknown(next(filter(_is_section, bases)), str(place[-1]))
    if kind == "missing" and isinstance(loc[-1], str):
        place = (*place, loc[-1])
        return place, f"missing; {_right(place, None)}"
    value = data
    for part in place:
        value = value[part]
    if kind.startswith(_SIZE):
        return place, f"found {found(value)}; expected {kind.removeprefix(_SIZE)}"
    return place, f"found {found(value)}; {_right(place, value)}"


def _right(key: Key, value: Any) -> str:
    """Return the expectation at a key: `expected a number above 0 in metres (radius of a cylinder)`."""
    annotation, info = _type_at(key)
    if info is None:
        return f"expected {expected(annotation)}"
    inside = _type_at(key[:-1])[1] is info  # such as an entry of a list, to which bounds of the field do not apply
    words = expected(annotation, () if inside else info.metadata)
    if isinstance(value, str) and words.startswith("a number"):
        words = words.replace("a number", "a plain number", 1)
    unit = in_unit(info) if "number" in words else ""
    return f"expected {words}{unit} ({purpose(info)})"


def _type_at(key: Key) -> tuple[Any, FieldInfo | None]:
    """Return the type of the value at a key, and the field that it belongs to."""
    annotation: Any = Config
    info: FieldInfo | None = None
    for part in key:
        for option in choices(annotation):
            base, _ = unwrap(option)
            arguments = getattr(base, "__args__", ())
            if _is_section(base) and isinstance(part, str) and part not in base.model_fields:
                annotation = named_sections(base)  # as the joints of robot.limits; info stays that of the section
                break
            if _is_section(base) and isinstance(part, str):
                annotation, info = fields(base)[part], base.model_fields[part]
                break
            if arguments and isinstance(part, str) is (base.__origin__ is dict):
                annotation = arguments[1] if base.__origin__ is dict else arguments[0]
                break
    return annotation, info


def _is_section(base: Any) -> bool:
    return isinstance(base, type) and issubclass(base, Section)


class _UnknownKey(str):
    """Message about a key that a section does not have."""


def _unknown(model: type[Section], name: str) -> _UnknownKey:
    valid = fields(model)
    return _UnknownKey(f"unknown key; {did_you_mean(name, valid)}expected one of {', '.join(valid)}")


def _depends(key: Key, bad: Key) -> bool:
    return key[: len(bad)] == bad or bad[: len(key)] == key


def _usable(data: dict[str, Any], own: dict[Key, str], folder: Path) -> tuple[Config | None, set[Key]]:
    """Return a configuration without the wrong parts, to check the rest, and the keys that were left out."""
    left, doubtful, wrong = deepcopy(data), set[Key](), own
    for _ in range(20):
        places = {key: _written(left, key) for key in wrong}
        unknown = {key for key, message in wrong.items() if isinstance(message, _UnknownKey) and places[key] == key}
        doubtful |= {place for key, place in places.items() if key not in unknown}
        for key in sorted(set(places.values()), key=len, reverse=True):
            _remove(left, key)
        config, wrong = _attempt(left, folder)
        if config is not None:
            return config, doubtful
    return None, doubtful


def _written(data: dict[str, Any], key: Key) -> Key:
    """Return the key itself if its value can be removed, else the key of the list or section around it.

    An object without its `held_by` would stand on the tray, so it is the object that is removed.
    """
    written: Key = key[:1]
    container: Any = data
    for i, part in enumerate(key):
        if isinstance(part, int) or not isinstance(container, dict) or part not in container:
            break
        written, container = key[: i + 1], container[part]
    return written[:2] if written[::2] == ("objects", "held_by") else written


def _remove(data: dict[str, Any], key: Key) -> None:
    """Remove the value at a key; a placeholder replaces a section that a configuration cannot do without."""
    container: Any = data
    for part in key[:-1]:
        container = container[part]
    container.pop(key[-1], None)
    if len(key) == 1 and key[0] in _PLACEHOLDERS:
        data[str(key[0])] = deepcopy(_PLACEHOLDERS[str(key[0])])
    if key == ("path", "steps"):
        container["steps"] = [dict(_A_STEP)]
