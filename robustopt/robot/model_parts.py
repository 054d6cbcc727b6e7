"""Files that a model file names, and the sizes that it asks for, checked before MuJoCo reads any of them.

MuJoCo opens every file that is named and makes as many copies as are wanted: a pipe would hang it, a model that
attaches itself would overflow its stack, and a number with some zeros too many would fill the memory.
"""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Callable, Sequence
from html import unescape
from math import prod
from pathlib import Path

from robustopt.errors import RobotError
from robustopt.files import MOST_BYTES, MOST_TEXT, read_bytes, require_regular

XML_SUFFIXES = frozenset({".xml", ".mjcf", ".urdf"})

MOST_DEPTH = 400
"""Largest depth of nested elements; MuJoCo stops at 500, Python's XML writer at 1000."""

MOST_FILES = 8
"""Largest length of a chain of files that name one another (our choice)."""

MOST_COPIES = 1_000
"""Largest number of copies that an element makes, nested elements `replicate` together (our choice)."""

MOST_CELLS = 10_000_000
"""Largest number of cells of a height field, pixels of a texture, or numbers of another array (our choice)."""

_COMMENT = re.compile(r"<!--.*?(?:-->|\Z)", re.DOTALL)
_TAG = re.compile(r"""<(/?)([\w:.-]+)((?:[^<>"']|"[^"]*"|'[^']*')*)>""")
_ATTRIBUTE = re.compile(r"""([\w:.-]+)\s*=\s*(?:"([^"]*)"|'([^']*)')""")

_NAMES = re.compile(r"file\w*|meshdir|texturedir|assetdir")
"""Attributes whose values are files or folders."""

_COUNTS = {
    "replicate": ("count",),
    "composite": ("count",),
    "flexcomp": ("count",),
    "hfield": ("nrow", "ncol"),
    "texture": ("width", "height"),
    "numeric": ("size",),
    "size": ("nuserdata", "nkey", "njmax", "nconmax", "nstack", "nuser_body", "nuser_jnt", "nuser_geom", "nuser_site"),
}
"""Attributes whose product is a number of things to be made, by element."""

_COPIES = ("replicate", "composite", "flexcomp")
"""Elements that make bodies."""

_PARTS = ("include", "model")
"""Elements whose file is XML, whatever its suffix."""

Finder = Callable[[str], Path | None]


def parts_of(file: Path, resolve_package: Finder) -> list[Path]:
    """Return a model file and all files that it names: includes, attached models, meshes, images; each once.

    MuJoCo resolves names from the folder of the model file and from the folders that its compiler settings name.

    Args:
        file: the model file.
        resolve_package: function that finds the file of `package://NAME/...`.

    Raises:
        RobotError: a file is not regular, too large or nested too deeply, wants too many copies or cells, or names
            itself.
    """
    found: list[Path] = []
    _collect(file, True, [file.parent], found, (), resolve_package)
    return found


def _collect(
    file: Path, is_part: bool, folders: Sequence[Path], found: list[Path], above: tuple[Path, ...],
    resolve_package: Finder,
) -> None:  # fmt: skip
    """Add a file and the files that it names to those that were found.

    Args:
        file: the file.
        is_part: whether it is read as a part of the model, whatever its suffix.
        folders: folders in which names are looked up.
        found: files that were found so far, to which this adds.
        above: the files that led to this one.
        resolve_package: as in `parts_of`.
    """
    about = f"{above[-1]}: names {file}, which" if above else f"{file}:"
    if file.resolve() in [place.resolve() for place in above]:
        raise _error(f"{about} names it in turn; expected no circle")
    if len(above) > MOST_FILES:
        raise _error(f"{about} is named by a file that is named by a file, {MOST_FILES} times; expected fewer")
    if file in found:
        return
    found.append(file)
    is_xml = is_part or file.suffix.lower() in XML_SUFFIXES
    try:
        require_regular(file, MOST_TEXT if is_xml else MOST_BYTES)
        text = read_bytes(file, MOST_TEXT).decode("utf-8", "replace") if is_xml else ""
    except OSError as error:
        raise _error(f"{about} cannot be read: {error.strerror}") from None
    names = _names_in(text, file)
    folders = list(dict.fromkeys([*folders, file.parent]))
    folders += [place / name for place in folders for name, _ in names if os.path.isdir(place / name)]
    for name, is_part in names:
        for place in _places(name, folders, resolve_package):
            if os.path.exists(place) and not os.path.isdir(place):
                _collect(place, is_part, folders, found, (*above, file), resolve_package)


def _places(name: str, folders: Sequence[Path], resolve_package: Finder) -> list[Path]:
    if name.startswith("package://"):
        package = resolve_package(name)
        return [] if package is None else [package]
    return [place / name.removeprefix("file://") for place in folders]


def _names_in(text: str, file: Path) -> list[tuple[str, bool]]:
    """Return the names of files and folders in an XML text, and whether each is a part of the model.

    Depth and counts of the elements are checked on the way, without a tree, which could be too deep.

    Args:
        text: content of the file.
        file: the file, for messages.
    """
    names: list[tuple[str, bool]] = []
    copies = [1]
    for end, element, inside in _TAG.findall(_COMMENT.sub("", text)):
        if end:
            copies = copies[:-1] or [1]
            continue
        given = {key: unescape(double or single) for key, double, single in _ATTRIBUTE.findall(inside)}
        if element == "model" and not given.get("file"):  # MuJoCo would hang later on
            raise _error(f"{file}: an element model names no file; expected one")
        names += [(value, element in _PARTS) for key, value in given.items() if _NAMES.fullmatch(key)]
        counts = [count for key in _COUNTS.get(element, ()) for count in _numbers(given.get(key, ""))]
        made = max(counts, default=1) if element == "size" else prod(counts)
        copies.append(copies[-1] * made if element == "replicate" else copies[-1])
        if len(copies) > MOST_DEPTH:
            raise _error(f"{file}: is nested more than {MOST_DEPTH} elements deep; expected fewer")
        most = MOST_COPIES if element in _COPIES else MOST_CELLS
        if max(made, copies[-1] if element == "replicate" else 0) > most:
            raise _error(f"{file}: the element {element} makes more than {most:,} parts; expected fewer")
        if inside.endswith("/"):
            copies.pop()
    return names


def _numbers(text: str) -> list[int]:
    """Return the whole numbers above 1 in a text, at most `sys.maxsize`: longer ones are as much too large."""
    return [int(part) if len(part) < 19 else sys.maxsize for part in re.findall(r"\d+", text) if part.strip("0")]


def _error(message: str) -> RobotError:
    return RobotError(message, key="robot.model")
