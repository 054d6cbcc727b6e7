"""The longest chain of joints of a model file, read as text: robots are listed without MuJoCo."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterator
from pathlib import Path

from robustopt.files import read_text

NOT_COUNTED = ("free", "fixed", "floating")
"""Types of joints that connect nothing, or nothing to the world."""

INSIDE = ("body", "frame", "replicate", "worldbody", "mujocoinclude", "mujoco")
"""Elements of an MJCF file with bodies inside."""


def longest_chain(file: Path) -> int:
    """Return the number of joints of the longest chain of a model file.

    Args:
        file: an MJCF or URDF file that `parts_of` has checked.

    Raises:
        OSError: the file, or one that it includes, cannot be read.
        ET.ParseError: it is not well-formed.
    """
    root = ET.fromstring(read_text(file))
    return _of_urdf(root) if root.tag == "robot" else _of_mjcf(root, file.parent)


def included_in(file: Path) -> list[str]:
    """Return the names of the files that an MJCF file includes; [] if it cannot be read.

    Args:
        file: the file.
    """
    try:
        return [item.get("file", "") for item in ET.fromstring(read_text(file)).iter("include")]
    except (OSError, ET.ParseError):
        return []


def _of_urdf(root: ET.Element) -> int:
    above: dict[str, tuple[str, bool]] = {}
    for joint in root.findall("joint"):
        parent, child = joint.find("parent"), joint.find("child")
        if parent is not None and child is not None:
            counts = joint.get("type") not in NOT_COUNTED
            above[child.get("link", "")] = (parent.get("link", ""), counts)
    longest = 0
    for link in above:
        joints, passed = 0, set()
        while link in above and link not in passed:
            passed.add(link)
            link, counts = above[link]
            joints += counts
        longest = max(longest, joints)
    return longest


def _of_mjcf(element: ET.Element, folder: Path) -> int:
    """Return the length of the longest chain that begins in an element."""
    own, inner = 0, 0
    for child in _children(element, folder):
        if child.tag == "joint" and element.tag == "body":
            own += child.get("type") not in NOT_COUNTED
        elif child.tag in INSIDE:
            inner = max(inner, _of_mjcf(child, folder))
    return own + inner


def _children(element: ET.Element, folder: Path) -> Iterator[ET.Element]:
    """Yield the children of an element, with those of an included file in place of the `include`."""
    for child in element:
        if child.tag == "include":
            yield from _children(ET.fromstring(read_text(folder / child.get("file", ""))), folder)
        else:
            yield child
