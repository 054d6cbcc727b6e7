"""Inertias of the links of a URDF file, and their replacement where MuJoCo does not take them."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Mapping

import numpy as np
from scipy.spatial.transform import Rotation

from robustopt.arrays import Array
from robustopt.robot.inertia import NONE, Inertia, in_words, is_usable, nearest_possible

MOMENTS = {"ixx": (0, 0), "iyy": (1, 1), "izz": (2, 2), "ixy": (0, 1), "ixz": (0, 2), "iyz": (1, 2)}


def replace_unusable(root: ET.Element) -> tuple[dict[str, Inertia], tuple[str, ...]]:
    """Replace the inertias that MuJoCo does not take by the nearest ones that it does, for simulations.

    A link without an inertia has no mass; MuJoCo would give it that of its shapes, filled with water.

    Args:
        root: root of the file, whose numbers are checked; it is changed.

    Returns:
        The inertias as written, by name of the link, and a note on each of these links.
    """
    links = {link.get("name", ""): link for link in root.findall("link")}
    inertias = {name: _inertia(link) for name, link in links.items()}
    fixed: dict[str, list[str]] = {}
    moving: set[str] = set()
    for joint in root.findall("joint"):
        parent, child = (_link(joint, role) for role in ("parent", "child"))
        if joint.get("type") == "fixed":
            fixed.setdefault(parent, []).append(child)
        else:
            moving.add(child)
    written, notes = {}, []
    for name, link in links.items():
        inertia, moves = inertias[name], name in moving
        without = link.find("inertial") is None
        if is_usable(inertia, moves) or (_is_none(inertia) and _carries_mass(name, fixed, inertias)):
            if without and link.find("collision") is not None:
                _write(link, inertia)
            continue
        used = nearest_possible(inertia)
        _write(link, used)
        written[name] = inertia
        has = "no inertia" if without else in_words(inertia)
        notes.append(f"link {name}: has {has}, which MuJoCo refuses; plans use it, simulations use {in_words(used)}")
    return written, tuple(notes)


def _carries_mass(name: str, fixed: Mapping[str, list[str]], inertias: Mapping[str, Inertia]) -> bool:
    """Return whether something that MuJoCo takes for the mass of a moving link is fixed to a link."""
    return any(
        is_usable(inertias[child], moves=True) or _carries_mass(child, fixed, inertias) for child in fixed.get(name, ())
    )


def _is_none(inertia: Inertia) -> bool:
    return inertia.mass == 0 and not inertia.about_com.any()


def _link(joint: ET.Element, role: str) -> str:
    element = joint.find(role)
    return "" if element is None else element.get("link", "")


def _inertia(link: ET.Element) -> Inertia:
    inertial = link.find("inertial")
    if inertial is None:
        return NONE
    origin, mass, inertia = (inertial.find(name) for name in ("origin", "mass", "inertia"))
    com, axes = np.zeros(3), np.eye(3)
    if origin is not None:
        com = _vector(origin.get("xyz"))
        axes = Rotation.from_euler("xyz", _vector(origin.get("rpy"))).as_matrix()
    about = np.zeros((3, 3))
    if inertia is not None:
        for name, (i, j) in MOMENTS.items():
            about[i, j] = about[j, i] = float(inertia.get(name, "0"))
    return Inertia(0.0 if mass is None else float(mass.get("value", "0")), com, axes @ about @ axes.T)


def _vector(text: str | None) -> Array:
    numbers = np.array([float(part) for part in text.split()]) if text else np.zeros(3)
    if len(numbers) != 3:
        raise ValueError(f"found {text!r} in the origin of an inertial; expected three numbers")
    return numbers


def _write(link: ET.Element, inertia: Inertia) -> None:
    for old in link.findall("inertial"):
        link.remove(old)
    inertial = ET.SubElement(link, "inertial")
    ET.SubElement(inertial, "origin", xyz=" ".join(repr(float(x)) for x in inertia.com))
    ET.SubElement(inertial, "mass", value=repr(inertia.mass))
    moments = {name: repr(float(inertia.about_com[place])) for name, place in MOMENTS.items()}
    ET.SubElement(inertial, "inertia", moments)
