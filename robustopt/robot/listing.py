"""List of the robots that `robot.model` can name."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterator
from dataclasses import dataclass

from robustopt.errors import RobotError
from robustopt.models import MODELS
from robustopt.robot.joint_count import longest_chain
from robustopt.robot.model_file import shipped_models
from robustopt.robot.model_parts import parts_of
from robustopt.robot.sources import REMEDIES, SOURCES, resolve_package, robots_of

SHIPPED = "robustopt"
"""Source of the robots that come with the package."""


@dataclass(frozen=True)
class ListedRobot:
    """A robot in a list.

    Attributes:
        name: value of `robot.model`.
        source: package or folder that it comes from.
        joints: number of joints of its longest chain.
        file: its model file.
    """

    name: str
    source: str
    joints: int
    file: str


def robots() -> list[ListedRobot]:
    """Return the robots of all sources; files that cannot be read, and those without joints, are left out."""
    return [robot for source in (SHIPPED, *SOURCES) for robot in _listed(source)]


def missing() -> dict[str, str]:
    """Return the ways to get the robots of sources of which none was found, by source."""
    return {source: REMEDIES[source] for source in SOURCES if not robots_of(source)}


def _listed(source: str) -> Iterator[ListedRobot]:
    shipped = source == SHIPPED
    files = {name: MODELS / f"{name}.xml" for name in shipped_models()} if shipped else robots_of(source)
    for name, file in files.items():
        try:
            parts_of(file, resolve_package)
            joints = longest_chain(file)
        except (RobotError, OSError, ET.ParseError):
            continue
        if joints:
            yield ListedRobot(name if shipped else f"{source}:{name}", source, joints, str(file))
