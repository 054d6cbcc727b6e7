"""Meshes that MuJoCo does not take: STL files in text are converted, and the shapes of all others are left out."""

from __future__ import annotations

import os
import re
from pathlib import Path

import mujoco
import numpy as np

from robustopt.arrays import Array
from robustopt.config.document import shortened
from robustopt.errors import RobotError
from robustopt.files import read_bytes, reason

STL_HEADER, STL_FACET = 84, 50
"""Sizes of a binary STL file [bytes]: of the header with the number of facets, and of each facet."""

MOST_WORDS = 150
"""Largest number of characters of a reason of MuJoCo, which may name a file."""

_VERTEX = re.compile(rb"\bvertex\s+(\S+)\s+(\S+)\s+(\S+)", re.IGNORECASE)


def take_any_volume(spec: mujoco.MjSpec) -> None:
    """Let the meshes of a specification have any volume: the masses of its bodies do not depend on them.

    Args:
        spec: the specification, which is changed.
    """
    for mesh in spec.meshes:
        mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL


def convert_text(spec: mujoco.MjSpec) -> tuple[str, ...]:
    """Put the vertices of STL files in text, which MuJoCo cannot read, into a specification.

    Args:
        spec: the specification, which is changed.

    Returns:
        A note on each file, with the links that it belongs to.

    Raises:
        RobotError: such a file cannot be read, or has numbers that are not finite.
    """
    notes = []
    for mesh in spec.meshes:
        file = _file(spec, mesh)
        if file is None or file.suffix.lower() != ".stl" or not os.path.isfile(file):
            continue
        try:
            corners = _corners(read_bytes(file))
        except (OSError, ValueError) as error:
            found = reason(error) if isinstance(error, OSError) else error
            raise RobotError(f"{file}: cannot be read: {found}", key="robot.model") from None
        if corners is not None:
            vertices, faces = np.unique(corners, axis=0, return_inverse=True)
            mesh.name, mesh.file = _name(mesh), ""
            mesh.uservert, mesh.userface = vertices.ravel(), faces.ravel()
            notes.append(f"link {_links(spec, mesh)}: {file.name} is an STL file in text; converted")
    return tuple(notes)


def leave_out_unusable(spec: mujoco.MjSpec) -> tuple[str, ...]:
    """Take out the shapes of meshes that MuJoCo cannot use, unless a mass depends on them.

    Args:
        spec: the specification, which is changed.

    Returns:
        A note on each mesh, with the links that it belongs to.
    """
    notes = []
    for mesh in list(spec.meshes):
        refusal = _refusal(spec, mesh)
        shapes = _shapes(spec, mesh)
        if refusal is None or not shapes or not all(geom.parent.explicitinertial for geom in shapes):
            continue
        collides = any(geom.contype or geom.conaffinity for geom in shapes)
        checked = "; collisions with it are not checked" if collides else ""
        notes.append(f"link {_links(spec, mesh)}: left out the mesh {shortened(_name(mesh))}, {refusal}{checked}")
        for item in [*shapes, mesh]:
            spec.delete(item)
    return tuple(notes)


def _refusal(spec: mujoco.MjSpec, mesh: mujoco.MjsMesh) -> str | None:
    """Return the reason for which MuJoCo refuses a mesh; None if it does not."""
    alone = mujoco.MjSpec()
    alone.modelfiledir, alone.meshdir, alone.strippath = spec.modelfiledir, spec.meshdir, spec.strippath
    copy = alone.add_mesh(name="mesh", file=mesh.file, scale=mesh.scale, inertia=mesh.inertia)
    copy.uservert, copy.userface = np.array(mesh.uservert), np.array(mesh.userface)
    alone.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname="mesh")
    try:
        alone.compile()
    except (ValueError, RuntimeError, mujoco.FatalError) as error:
        return shortened(str(error).splitlines()[0].removeprefix("Error: "), MOST_WORDS)
    return None


def _corners(content: bytes) -> Array | None:
    """Return the corners of the facets of an STL file in text (3 F, 3) [m]; None for a binary one."""
    if content.lstrip()[:5].lower() != b"solid":
        return None
    facets = int.from_bytes(content[STL_HEADER - 4 : STL_HEADER], "little")
    found = _VERTEX.findall(content)
    if len(content) == STL_HEADER + STL_FACET * facets or not found or len(found) % 3:
        return None
    corners = np.array(found, dtype=float)
    if not np.isfinite(corners).all():
        raise ValueError("found a vertex that is not finite")
    return corners


def _file(spec: mujoco.MjSpec, mesh: mujoco.MjsMesh) -> Path | None:
    """Return the file of a mesh; None if it has none."""
    if not mesh.file:
        return None
    name = os.path.basename(mesh.file) if spec.strippath else mesh.file
    return Path(spec.modelfiledir, spec.meshdir, name)


def _name(mesh: mujoco.MjsMesh) -> str:
    return mesh.name or Path(mesh.file).stem


def _shapes(spec: mujoco.MjSpec, mesh: mujoco.MjsMesh) -> list[mujoco.MjsGeom]:
    return [geom for geom in spec.geoms if geom.meshname == _name(mesh)]


def _links(spec: mujoco.MjSpec, mesh: mujoco.MjsMesh) -> str:
    return ", ".join(dict.fromkeys(geom.parent.name for geom in _shapes(spec, mesh))) or "(none)"
