"""YAML with the location of every value, and `key=value` overrides of its values.

A configuration needs only mappings with plain keys, lists, text, numbers, true, false and null. Unlike YAML 1.1, `on`
and `yes` are text and `1e-3` is a number.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import yaml
from yaml.composer import ComposerError
from yaml.reader import ReaderError

from robustopt.errors import ConfigError, ConfigProblem
from robustopt.files import read_text as read_utf8

Key = tuple[str | int, ...]
"""Path to a value: names of keys and positions in lists."""

Finding = tuple[Key, str]
"""Key of a mistake, and a message: the value that was found, and the values that are expected."""

MOST_VALUES = 200_000
"""Largest number of values in a document: aliases of aliases can make a small file grow without bound."""

MOST_BYTES = 1_000_000
"""Largest size of a configuration [bytes]: it takes some 20 s to read. Long lists of waypoints go into a CSV file."""

_TAG = "tag:yaml.org,2002:"


class _Loader(yaml.BaseLoader):
    """YAML loader that composes nodes and knows only the plain scalars below."""


_SIGN_OR_DIGIT = list("-+.0123456789")
for _name, _pattern, _first in (
    ("null", r"~|null|Null|NULL|", ["~", "n", "N", ""]),
    ("bool", r"true|True|TRUE|false|False|FALSE", list("tTfF")),
    ("int", r"[-+]?[0-9]+", _SIGN_OR_DIGIT),
    ("float", r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?", _SIGN_OR_DIGIT),
    ("float", r"[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)", _SIGN_OR_DIGIT),
):
    _Loader.add_implicit_resolver(_TAG + _name, re.compile(rf"^(?:{_pattern})$"), _first)


_SCALARS: dict[str, Callable[[str], Any]] = {
    "str": str,
    "null": lambda text: None,
    "bool": lambda text: text.lower() == "true",
    "int": int,
    "float": lambda text: float(re.sub(r"\.(?=[a-z])", "", text.lower())),
}
"""Functions that read the text of a scalar, by its tag."""


class _Dumper(yaml.SafeDumper):
    """YAML writer for `_Loader`: quotes only text that would be read as something else."""

    yaml_implicit_resolvers = _Loader.yaml_implicit_resolvers


def write_yaml(data: Any) -> str:
    """Return plain values as YAML text; every float is written so that it reads back exactly.

    Args:
        data: nested dicts, lists, text, numbers, booleans and None.
    """
    return yaml.dump(data, Dumper=_Dumper, sort_keys=False, default_flow_style=None, width=110, allow_unicode=True)


def show_key(key: Key) -> str:
    """Return a key path as it is written in messages and overrides, such as path.tray_poses[0].yaw.

    Args:
        key: names of keys and positions in lists.
    """
    parts = [f"[{part}]" if isinstance(part, int) else f".{part}" for part in key]
    return "".join(parts).removeprefix(".")


def _join_keys(outer: str, inner: str) -> str:
    """Return a key path that continues another one."""
    return f"{outer}{'' if not inner or inner.startswith('[') else '.'}{inner}"


def shortened(text: str, most: int = 60) -> str:
    """Return a text, or its beginning and three dots if it is too long for a message.

    Args:
        text: the text.
        most: largest number of characters.
    """
    return text if len(text) <= most else f"{text[: most - 3]}..."


@lru_cache(maxsize=4096)
def split_key(text: str) -> Key:
    """Return the key path that a text denotes.

    Args:
        text: the text, such as path.tray_poses.0.yaw or path.tray_poses[0].yaw.
    """
    parts = re.sub(r"\[(\d+)\]", r".\1", text.strip()).split(".")
    return tuple(int(part) if part.isdecimal() else part for part in parts)


@dataclass
class Document:
    """Plain values of a configuration, the location of each in its source, and the mistakes in the text."""

    data: Any = None
    locations: dict[Key, str] = field(default_factory=dict)
    problems: list[ConfigProblem] = field(default_factory=list)

    def locate(self, key: Key) -> str:
        """Return the location of a value, or of the nearest section around it that has a location.

        Args:
            key: key path of the value; it need not exist.
        """
        return self.locations.get(self._written(key), "")

    def position(self, key: Key) -> int:
        """Return the position of a value, or of the nearest section around it, in the order of the document.

        Args:
            key: key path of the value.

        Returns:
            The position, or -1 if nothing around the value has a location.
        """
        order = {written: i for i, written in enumerate(self.locations)}
        return order.get(self._written(key), -1)

    def problem(self, key: Key, message: str) -> ConfigProblem:
        """Return a mistake at a key, with the location of the key.

        Args:
            key: key path of the value that is wrong.
            message: the value that was found and the values that are expected.
        """
        return ConfigProblem(key=show_key(key), message=message, location=self.locate(key))

    def _written(self, key: Key) -> Key:
        while key and key not in self.locations:
            key = key[:-1]
        return key

    def override(self, text: str) -> None:
        """Apply one override, or add a mistake to `problems`.

        Args:
            text: `key=value`, the value in YAML.
        """
        location = f"override '{shortened(text, 100)}'"
        key_text, equals, value_text = text.partition("=")
        if not equals or not key_text.strip():
            message = "found no key=value; expected for example solver.collocation_points=500"
            self.problems.append(ConfigProblem(key="", message=message, location=location))
            return
        key, part = split_key(key_text), read_text(value_text, location, lines=False)
        if part.problems:
            self.problems += [replace(p, key=_join_keys(show_key(key), p.key)) for p in part.problems]
        else:
            self.assign(key, part, location)

    def assign(self, key: Key, part: Document, location: str) -> None:
        """Put a value from another document at a key, and add the sections on the way that are missing.

        A key that does not fit the document is added to `problems`.

        Args:
            key: key path at which the value is put.
            part: document that holds the value.
            location: location of the value, for messages.
        """
        if self.data is None:
            self.data = {}
        try:
            key = _assign(self.data, key, part.data)
        except ConfigError as error:
            self.problems += [ConfigProblem(p.key, p.message, location) for p in error.problems]
            return
        for old in [old for old in self.locations if old[: len(key)] == key]:
            del self.locations[old]
        self.locations.update({key + inner: location for inner in part.locations})
        self.locations[key] = location


def _assign(container: Any, key: Key, value: Any) -> Key:
    """Put a value at a key of nested dicts and lists, and return the key as it is stored: names in a dict are text."""
    found: Key = ()
    for i, part in enumerate(key):
        _require_place(container, key[: i + 1], part)
        part = part if isinstance(container, list) else str(part)
        found = (*found, part)
        if i == len(key) - 1:
            container[part] = value
        elif isinstance(container, dict) and container.get(part) is None:
            container[part] = {}
        container = container[part]
    return found


def _require_place(container: Any, key: Key, part: str | int) -> None:
    above = show_key(key[:-1]) or "the configuration"
    if isinstance(container, dict):
        if part == "":
            raise ConfigError("found an empty part of a key; expected names joined by dots", key=show_key(key))
    elif isinstance(container, list):
        if not isinstance(part, int):
            message = f"found the name {part!r}; expected a position, because {above} is a list"
            raise ConfigError(message, key=show_key(key))
        if part >= len(container):
            message = f"found position {part}; expected 0 to {len(container) - 1}, the entries of {above}"
            raise ConfigError(message, key=show_key(key))
    else:
        found = shortened(repr(container))
        message = f"{above} is {found}, which has no keys; replace it as a whole: {above}={{{part}: ...}}"
        raise ConfigError(message, key=show_key(key))


def read_file(path: Path) -> Document:
    """Read a configuration file.

    Mistakes in its YAML are listed in `problems` of the document.

    Args:
        path: path of the file.

    Raises:
        ConfigError: the file does not exist, cannot be read, or is not UTF-8 text.
    """
    try:
        return read_text(read_utf8(path, MOST_BYTES), str(path))
    except FileNotFoundError:
        message = "no such file; expected the path of a YAML file"
    except IsADirectoryError:
        message = "this is a folder; expected a YAML file"
    except OSError as error:
        message = f"cannot be read as a YAML file: {error.strerror}"
    raise ConfigError([ConfigProblem("", message, str(path))])


def read_text(text: str, source: str, lines: bool = True) -> Document:
    """Read YAML text.

    Mistakes in the YAML are listed in `problems` of the document.

    Args:
        text: the YAML.
        source: name of the text in messages.
        lines: whether messages give line numbers.
    """
    return _Reader(source, lines).read(text)


class _Reader:
    """Reader of YAML text into a `Document`."""

    def __init__(self, source: str, lines: bool) -> None:
        self.source, self.lines = source, lines
        self.document = Document()
        self.values = 0

    def read(self, text: str) -> Document:
        try:
            node = self._root(_Loader(text))
            self.document.locations[()] = self._at(node.start_mark) if node is not None else self.source
            if node is not None:
                self.document.data = self._value(node, (), ())
        except ReaderError as error:
            line = text[: error.position].count("\n") + 1
            source = f"{self.source}:{line}" if self.lines else self.source
            found = "a byte that is not UTF-8" if _is_raw_byte(error.character) else "a control character"
            self._add((), f"not YAML: found {found}; expected printable text", source)
        except yaml.MarkedYAMLError as error:
            self._add((), f"not YAML: {error.problem}; {_remedy(error)}", self._at(error.problem_mark))
        except RecursionError:
            self._add((), "nested too deeply to be a configuration", self.source)
        return self.document

    def _root(self, loader: _Loader) -> yaml.Node | None:
        """Return the only document of a text."""
        node = loader.get_node() if loader.check_node() else None
        if loader.check_node():
            mark = loader.peek_event().start_mark  # type: ignore[no-untyped-call]
            raise _refused("found another document", mark, "expected one document, without `---` in the middle")
        return node

    def _value(self, node: yaml.Node, key: Key, above: tuple[int, ...]) -> Any:
        self.document.locations.setdefault(key, self._at(node.start_mark))
        self.values += 1
        if id(node) in above or self.values > MOST_VALUES:
            found = "an alias contains itself" if id(node) in above else f"more than {MOST_VALUES:,} values"
            raise _refused(found, node.start_mark, "write the values out")
        if isinstance(node, yaml.MappingNode) and node.tag == _TAG + "map":
            entries = self._entries(node, key)
            return {name: self._value(child, (*key, name), (*above, id(node))) for name, child in entries}
        if isinstance(node, yaml.SequenceNode) and node.tag == _TAG + "seq":
            return [self._value(child, (*key, i), (*above, id(node))) for i, child in enumerate(node.value)]
        if isinstance(node, yaml.ScalarNode):
            return self._scalar(node, key)
        return self._unknown_tag(node, key)

    def _entries(self, node: yaml.MappingNode, key: Key) -> Iterator[tuple[str, yaml.Node]]:
        first: dict[str, yaml.Node] = {}
        for key_node, child in node.value:
            location = self._at(key_node.start_mark)
            if not isinstance(key_node, yaml.ScalarNode):
                self._add(key, "found a list or a section as a key; expected a name", location)
            elif (name := str(key_node.value)) in first:
                place = f", the first time in line {first[name].start_mark.line + 1}" if self.lines else ""
                self._add((*key, name), f"found twice{place}; expected once", location)
            else:
                first[name] = key_node
                self.document.locations[*key, name] = location
                yield name, child

    def _scalar(self, node: yaml.ScalarNode, key: Key) -> Any:
        read = _SCALARS.get(node.tag.removeprefix(_TAG))
        if read is None:
            return self._unknown_tag(node, key)
        try:
            return read(str(node.value))
        except ValueError:
            return self._add(key, f"found {node.value[:40]!r}; expected a number", self._at(node.start_mark))

    def _unknown_tag(self, node: yaml.Node, key: Key) -> None:
        message = f"found the tag {node.tag.replace(_TAG, '!!')}; expected a plain value without a tag"
        self._add(key, message, self._at(node.start_mark))

    def _add(self, key: Key, message: str, location: str) -> None:
        self.document.problems.append(ConfigProblem(show_key(key), message, location))

    def _at(self, mark: Any) -> str:
        return f"{self.source}:{mark.line + 1}" if self.lines and mark is not None else self.source


def _is_raw_byte(character: int | bytes) -> bool:
    """Return whether a character stands for a byte of the command line that is no text, as Python passes them on."""
    return isinstance(character, int) and 0xDC80 <= character <= 0xDCFF


def _refused(problem: str, mark: Any, remedy: str) -> yaml.MarkedYAMLError:
    """Return an error about YAML that a configuration must not contain."""
    return yaml.MarkedYAMLError(problem=problem, problem_mark=mark, note=remedy)


def _remedy(error: yaml.MarkedYAMLError) -> str:
    if error.note is not None:
        return error.note
    mark = error.problem_mark
    if mark is not None and mark.buffer is not None and mark.buffer[mark.pointer] == "\t":
        return "indent with spaces, not tabs"
    if isinstance(error, ComposerError):  # unknown or repeated anchors
        return "write the values out"
    return "expected lines `key: value`, indented by spaces"
