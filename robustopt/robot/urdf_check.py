"""Check of a URDF file for content that MuJoCo drops or reads as something else."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections import Counter
from collections.abc import Callable, Collection, Iterator
from math import inf, isfinite, isnan

from robustopt.errors import ConfigProblem, RobotError

TYPES = ("revolute", "continuous", "prismatic", "fixed", "floating", "planar")
RANGED = ("revolute", "prismatic")
"""Types of joints whose range counts; it is 0 to 0 where it is not given."""

Check = tuple[str, Callable[[float], bool]]

ANY: Check = ("a number, or inf for none", lambda value: not isnan(value))
FINITE: Check = ("a finite number", isfinite)
AT_LEAST_ZERO: Check = ("a number of at least 0", lambda value: 0 <= value < inf)
NOT_NEGATIVE: Check = ("a number above 0, or inf for none", lambda value: value >= 0)

_OF_JOINT: tuple[tuple[str, str, str, Check], ...] = (
    ("limit", "lower", "lower limit", ANY),
    ("limit", "upper", "upper limit", ANY),
    ("limit", "effort", "effort", NOT_NEGATIVE),
    ("limit", "velocity", "velocity", NOT_NEGATIVE),
    ("dynamics", "damping", "damping", AT_LEAST_ZERO),
    ("dynamics", "friction", "friction", AT_LEAST_ZERO),
    ("axis", "xyz", "axis", FINITE),
    ("origin", "xyz", "position of the origin", FINITE),
    ("origin", "rpy", "orientation of the origin", FINITE),
    ("mimic", "multiplier", "multiplier of its mimic", FINITE),
    ("mimic", "offset", "offset of its mimic", FINITE),
)
_OF_LINK: tuple[tuple[str, str, str, Check], ...] = (
    ("inertial/mass", "value", "mass", AT_LEAST_ZERO),
    ("inertial/origin", "xyz", "centre of mass", FINITE),
    ("inertial/origin", "rpy", "orientation of the inertia", FINITE),
    *(("inertial/inertia", f"i{k}", f"inertia i{k}", FINITE) for k in ("xx", "yy", "zz", "xy", "xz", "yz")),
)
"""Numbers of a joint and of a link: the element, the attribute, its words, and the values that are allowed."""


def check_urdf(root: ET.Element, locked: Collection[str], file: str) -> None:
    """Check the joints and links of a URDF file.

    Args:
        root: root of the file.
        locked: names of joints that do not move, so that it does not matter which joint they mimic.
        file: the file, for messages.

    Raises:
        RobotError: names are missing, unknown or given twice, or numbers are impossible; the error lists all of them.
    """
    findings = [*_names(root, locked), *_numbers(root), *_ranges(root)]
    if findings:
        raise RobotError([ConfigProblem("robot.model", f"{file}: {finding}") for finding in findings])


def written_ranges(root: ET.Element) -> dict[str, tuple[float, float]]:
    """Return the range of each joint that has one, by joint name [rad or m]; an end that is not given is 0.

    Args:
        root: root of a URDF file.
    """
    found = {}
    for joint in root.findall("joint"):
        if joint.get("type") in RANGED:
            limit = joint.find("limit")
            ends = ("0", "0") if limit is None else (limit.get("lower", "0"), limit.get("upper", "0"))
            found[joint.get("name", "")] = (float(ends[0]), float(ends[1]))
    return found


def _names(root: ET.Element, locked: Collection[str]) -> Iterator[str]:
    links = [link.get("name", "") for link in root.findall("link")]
    joints = [joint.get("name", "") for joint in root.findall("joint")]
    for noun, names in (("joint", joints), ("link", links)):
        yield from (f"found {count} {noun}s called {name!r}; expected names of their own"
                    for name, count in Counter(names).items() if count > 1)  # fmt: skip
    for joint in root.findall("joint"):
        name = joint.get("name", "")
        if joint.get("type") not in TYPES:
            yield f"joint {name}: found the type {joint.get('type')!r}; expected one of {', '.join(TYPES)}"
        for role in ("parent", "child"):
            element = joint.find(role)
            link = None if element is None else element.get("link")
            if link not in links:
                found = f"there is no link {link!r}" if link else "no link is given"
                yield f"joint {name}: {found} for its {role}; expected one of {', '.join(links)}"
        mimic = joint.find("mimic")
        if mimic is not None and name not in locked and not mimics_another(joint, joints):
            others = ", ".join(other for other in joints if other != name) or "no mimic, as it is the only joint"
            yield (
                f"joint {name}: mimics {mimic.get('joint')!r}, but there is no such other joint; lock the joint "
                f"(robot.locked: {{{name}: ...}}), or expected {others}"
            )


def mimics_another(joint: ET.Element, joints: Collection[str]) -> bool:
    """Return whether a joint mimics another joint of the file.

    Args:
        joint: the joint.
        joints: names of all joints.
    """
    mimic = joint.find("mimic")
    return mimic is not None and mimic.get("joint") in joints and mimic.get("joint") != joint.get("name", "")


def _numbers(root: ET.Element) -> Iterator[str]:
    for noun, attributes in (("joint", _OF_JOINT), ("link", _OF_LINK)):
        for item in root.findall(noun):
            for path, attribute, words, check in attributes:
                element = item.find(path)
                text = None if element is None else element.get(attribute)
                if text is not None and not _allowed(text, check):
                    yield f"{noun} {item.get('name', '')}: {words} is {text.strip()!r}; expected {check[0]}"
    for joint in root.findall("joint"):
        axis = joint.find("axis")
        if axis is not None and joint.get("type") not in ("fixed", "floating") and _is_zero(axis.get("xyz", "1 0 0")):
            yield f"joint {joint.get('name', '')}: axis is zero; expected a direction, such as 0 0 1"


def _allowed(text: str, check: Check) -> bool:
    try:
        return all(check[1](float(part)) for part in text.split()) and bool(text.split())
    except ValueError:
        return False


def _is_zero(text: str) -> bool:
    return _allowed(text, FINITE) and not any(float(part) for part in text.split())


def _ranges(root: ET.Element) -> Iterator[str]:
    """Yield ranges whose lower end lies above the upper one."""
    try:
        ranges = written_ranges(root)
    except ValueError:
        return  # named by `_numbers`
    for name, (low, high) in ranges.items():
        if low > high or low == inf or high == -inf:
            yield f"joint {name}: range from {low:g} to {high:g}; expected the lower end first"
