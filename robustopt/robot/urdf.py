"""URDF files for MuJoCo, without visuals and missing meshes, and the limits in them that MuJoCo drops."""

from __future__ import annotations

import os
import xml.etree.ElementTree as ET
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from robustopt.files import read_bytes, read_text
from robustopt.robot.urdf_check import check_urdf, written_ranges

XACRO = "; expected the URDF that `xacro` makes of it"

MESH_FORMATS = frozenset({".stl", ".obj", ".msh"})


@dataclass(frozen=True)
class UrdfLimits:
    """The joint limits of a URDF file by joint name.

    Attributes:
        velocity: largest speed [rad/s or m/s].
        effort: largest torque or force [N m or N].
        position: lowest and highest position, as written [rad or m].
    """

    velocity: Mapping[str, float] = field(default_factory=dict)
    effort: Mapping[str, float] = field(default_factory=dict)
    position: Mapping[str, tuple[float, float]] = field(default_factory=dict)


def is_urdf(file: Path) -> bool:
    """Return whether a file is a URDF file, which has the suffix `.urdf` or the root element `robot`.

    Args:
        file: the file.
    """
    return file.suffix.lower() == ".urdf" or "<robot" in read_bytes(file).decode("utf-8", "replace")[:4000]


def read_urdf(file: Path, resolve_package: Callable[[str], Path | None]) -> tuple[str, UrdfLimits, tuple[str, ...]]:
    """Read a URDF file for MuJoCo.

    Args:
        file: the URDF file.
        resolve_package: function that finds the file of `package://NAME/...`.

    Returns:
        Text that MuJoCo can read, the joint limits, and notes on content that was left out.

    Raises:
        ValueError: the file is not well-formed XML, or it is a xacro file.
        RobotError: names or numbers of its joints and links are wrong.
    """
    text = read_text(file)
    try:
        root = ET.fromstring(text)
    except ET.ParseError as error:
        raise ValueError(f"not well-formed XML: {error}{XACRO if 'xacro:' in text else ''}") from error
    if any("${" in value or "$(" in value for item in root.iter() for value in item.attrib.values()):
        raise ValueError(f"found variables of xacro{XACRO}")
    check_urdf(root, str(file))
    without: list[tuple[str, str]] = []
    for link in root.iter("link"):
        for visual in link.findall("visual"):
            link.remove(visual)
        for collision in link.findall("collision"):
            mesh = collision.find("geometry/mesh")
            if mesh is None:
                continue
            found = _mesh_file(mesh.get("filename", ""), file.parent, resolve_package)
            if found is None:
                link.remove(collision)
                without.append((link.get("name", ""), mesh.get("filename", "")))
            else:
                mesh.set("filename", str(found))
    _set_compiler(root)
    return ET.tostring(root, encoding="unicode"), _limits(root), _notes(without)


def _notes(without: Sequence[tuple[str, str]]) -> tuple[str, ...]:
    """Note the collision meshes that were left out, pairs of link and file, if there are any."""
    if not without:
        return ()
    links, formats = ", ".join(dict.fromkeys(link for link, _ in without)), ", ".join(sorted(MESH_FORMATS))
    files = list(dict.fromkeys(file for _, file in without))
    such_as = f"{files[0]} and {len(files) - 1} more" if len(files) > 1 else files[0]
    return (f"left out: collision meshes of {links}; cannot be found, or not one of {formats}: {such_as}",)


def _mesh_file(name: str, folder: Path, resolve_package: Callable[[str], Path | None]) -> Path | None:
    file = resolve_package(name) if name.startswith("package://") else folder / name.removeprefix("file://")
    if file is None or not os.path.isfile(file) or file.suffix.lower() not in MESH_FORMATS:
        return None
    return file.resolve()


def _set_compiler(root: ET.Element) -> None:
    extension = root.find("mujoco")
    if extension is None:
        extension = ET.SubElement(root, "mujoco")
    compiler = extension.find("compiler")
    if compiler is None:
        compiler = ET.SubElement(extension, "compiler")
    for name, value in (("strippath", "false"), ("fusestatic", "false")):
        compiler.set(name, value)


def _limits(root: ET.Element) -> UrdfLimits:
    """Return the limits as written; a value of zero or less means that the limit was not filled in."""
    velocity: dict[str, float] = {}
    effort: dict[str, float] = {}
    for joint in root.iter("joint"):
        limit, name = joint.find("limit"), joint.get("name")
        if limit is None or name is None:
            continue
        for target, attribute in ((velocity, "velocity"), (effort, "effort")):
            value = float(limit.get(attribute, "0"))
            if value > 0:
                target[name] = value
    return UrdfLimits(velocity, effort, written_ranges(root))
