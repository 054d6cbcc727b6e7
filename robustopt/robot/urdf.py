"""URDF files for MuJoCo, without visuals and missing meshes, and the content that MuJoCo drops or does not take."""

from __future__ import annotations

import os
import xml.etree.ElementTree as ET
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from robustopt.files import read_bytes, read_text
from robustopt.robot.inertia import Inertia
from robustopt.robot.urdf_check import check_urdf, mimics_another, written_ranges
from robustopt.robot.urdf_inertia import replace_unusable

XACRO = "xacro; expected the URDF that `xacro` makes of it: run `xacro {file} -o {urdf}`, and give {urdf}"

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


@dataclass(frozen=True)
class Urdf:
    """A URDF file as MuJoCo can read it, with the content that MuJoCo drops or does not take.

    Attributes:
        text: the file for MuJoCo.
        limits: the joint limits.
        inertias: inertias as written that MuJoCo does not take, by name of the link.
        notes: the content that was left out or replaced, in words.
    """

    text: str
    limits: UrdfLimits
    inertias: Mapping[str, Inertia]
    notes: tuple[str, ...]


def is_urdf(file: Path) -> bool:
    """Return whether a file is a URDF or xacro file, by its suffix or by the root element `robot`.

    Args:
        file: the file.
    """
    return file.suffix.lower() in (".urdf", ".xacro") or "<robot" in read_bytes(file).decode("utf-8", "replace")[:4000]


def read_urdf(file: Path, resolve_package: Callable[[str], Path | None], locked: Collection[str]) -> Urdf:
    """Read a URDF file for MuJoCo.

    Args:
        file: the URDF file.
        resolve_package: function that finds the file of `package://NAME/...`.
        locked: names of joints that do not move.

    Raises:
        ValueError: the file is not well-formed XML, or it is a xacro file.
        RobotError: names or numbers of its joints and links are wrong.
    """
    text = read_text(file)
    name = file.name.removesuffix(".xacro").removesuffix(".urdf")
    xacro = XACRO.format(file=file.name, urdf=f"{name}_made.urdf" if file.suffix == ".urdf" else f"{name}.urdf")
    if file.suffix.lower() == ".xacro":
        raise ValueError(f"found {xacro}")
    try:
        root = ET.fromstring(text)
    except ET.ParseError as error:
        raise ValueError(f"not well-formed XML: {error}{f'; found {xacro}' if 'xacro:' in text else ''}") from error
    if any("${" in value or "$(" in value for item in root.iter() for value in item.attrib.values()):
        raise ValueError(f"found {xacro}")
    check_urdf(root, locked, str(file))
    _leave_out_unknown_mimics(root)
    without = _leave_out_shapes(root, file.parent, resolve_package)
    inertias, notes = replace_unusable(root)
    _set_compiler(root)
    return Urdf(ET.tostring(root, encoding="unicode"), _limits(root), inertias, (*_notes(without), *notes))


def _leave_out_unknown_mimics(root: ET.Element) -> None:
    """Take out the mimics of joints that do not exist; `check_urdf` accepts them on locked joints alone."""
    joints = [joint.get("name", "") for joint in root.findall("joint")]
    for joint in root.findall("joint"):
        for mimic in joint.findall("mimic") if not mimics_another(joint, joints) else ():
            joint.remove(mimic)


def _leave_out_shapes(
    root: ET.Element, folder: Path, resolve_package: Callable[[str], Path | None]
) -> list[tuple[str, str]]:
    """Take out visuals, and the collision meshes that MuJoCo cannot read; return these, pairs of link and file."""
    without: list[tuple[str, str]] = []
    for link in root.iter("link"):
        for visual in link.findall("visual"):
            link.remove(visual)
        for collision in link.findall("collision"):
            mesh = collision.find("geometry/mesh")
            if mesh is None:
                continue
            found = _mesh_file(mesh.get("filename", ""), folder, resolve_package)
            if found is None:
                link.remove(collision)
                without.append((link.get("name", ""), mesh.get("filename", "")))
            else:
                mesh.set("filename", str(found))
    return without


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
