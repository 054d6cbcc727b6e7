"""The robot's model file: find it, hash it, and read it into a MuJoCo specification.

The reader keeps the content of a user's MJCF or URDF file but resets its settings for the whole simulation, because the
robot is only a part of the simulation.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import count
from pathlib import Path

import mujoco
import numpy as np

from robustopt.config import Config
from robustopt.config.document import shortened
from robustopt.errors import RobotError
from robustopt.files import read_bytes
from robustopt.models import MODELS
from robustopt.robot.inertia import Inertia
from robustopt.robot.meshes import convert_text, leave_out_unusable, take_any_volume
from robustopt.robot.model_check import check_model
from robustopt.robot.model_parts import parts_of
from robustopt.robot.sources import SOURCES, resolve_package, share_folders, source_file
from robustopt.robot.urdf import UrdfLimits, is_urdf, read_urdf

USUAL = mujoco.MjSpec()
"""MuJoCo's own defaults. Parts added to a robot are made with `USUAL.default`; otherwise they would take the defaults
of the robot's file: margins of its geoms, force ranges of its actuators, and so on."""

MASS_OPTIONS = ("inertiafromgeom", "settotalmass", "boundmass", "boundinertia", "balanceinertia")
"""Options of MuJoCo's compiler that change the masses of all bodies, also of bodies added to the model."""


def shipped_models() -> tuple[str, ...]:
    """Return the names of the robots that come with the package."""
    return tuple(sorted(file.stem for file in MODELS.glob("*.xml")))


def model_file(config: Config) -> Path:
    """Return the file that `robot.model` names.

    Args:
        config: the configuration; `robot.model` is a shipped robot, a robot of a source, a package file, or a path
            relative to the configuration.

    Raises:
        RobotError: there is no such robot or file.
    """
    name = config.robot.model
    if name in shipped_models():
        return MODELS / f"{name}.xml"
    source, _, robot = name.partition(":")
    if source in SOURCES:
        return source_file(source, robot)
    if name.startswith("package://"):
        file = resolve_package(name)
        if file is None:
            folders = ", ".join(str(folder) for folder in share_folders())
            raise RobotError(f"{name} was not found in the share folders {folders}", key="robot.model")
        return file
    file = config.folder / name
    if os.path.exists(file):
        return file
    shipped = ", ".join(shipped_models())
    if Path(name).suffix.lower() in {".xml", ".mjcf", ".urdf"}:
        raise RobotError(f"there is no file {file}; the shipped robots are: {shipped}", key="robot.model")
    raise RobotError(
        f"unknown robot {shortened(repr(name))}; give a shipped robot ({shipped}), an MJCF or URDF file, or a robot of "
        f"`robustopt robots`",
        key="robot.model",
    )


def model_hash(file: Path) -> str:
    """Return the SHA-256 hash of a model file and of all files that it names: includes, meshes, height fields.

    Args:
        file: the model file.

    Raises:
        RobotError: one of the files cannot be read.
    """
    digest = hashlib.sha256()
    for part in parts_of(file, resolve_package):
        try:
            digest.update(read_bytes(part))
        except OSError as error:
            raise RobotError(f"{part}: cannot be read: {error.strerror}", key="robot.model") from None
    return digest.hexdigest()


@dataclass(frozen=True, eq=False)
class Content:
    """The content of a model file.

    Attributes:
        spec: the specification.
        limits: limits of a URDF file that MuJoCo does not keep.
        inertias: inertias as written that MuJoCo does not take, by name of the body.
        notes: content that was left out or replaced, in words.
    """

    spec: mujoco.MjSpec
    limits: UrdfLimits
    inertias: Mapping[str, Inertia]
    notes: tuple[str, ...]


def read_model(file: Path, locked: Collection[str] = ()) -> Content:
    """Read a model file.

    Joints, bodies and tendons without a name get one. Options, flags and compiler settings of the file that apply to a
    whole simulation are reset.

    Args:
        file: the model file.
        locked: names of joints that do not move.

    Raises:
        RobotError: MuJoCo cannot read the file or one that it names, or its joints and links have impossible numbers.
    """
    urdf = None
    parts_of(file, resolve_package)
    with _refused(f"{file}: not a model that MuJoCo can read"):
        if is_urdf(file):
            urdf = read_urdf(file, resolve_package, locked)
            spec = mujoco.MjSpec.from_string(urdf.text)
            take_any_volume(spec)
        else:
            spec = mujoco.MjSpec.from_file(str(file))
        converted = convert_text(spec)
    spec.compiler.fusestatic = spec.compiler.alignfree = False
    spec.option.disableflags = spec.option.enableflags = 0
    spec.option.density = spec.option.viscosity = 0.0
    _name_all(spec)
    check_model(spec, str(file))
    _keep_masses(spec, file)
    if urdf is None:
        return Content(spec, UrdfLimits(), {}, converted)
    return Content(spec, urdf.limits, urdf.inertias, (*urdf.notes, *converted))


def compile_spec(spec: mujoco.MjSpec, file: Path) -> mujoco.MjModel:
    """Compile a specification.

    Args:
        spec: the specification.
        file: its model file, for messages.

    Raises:
        RobotError: MuJoCo rejects the model; its message is put on one line.
    """
    with _refused(f"{file}: MuJoCo cannot use the model"):
        return spec.compile()


def compile_usable(spec: mujoco.MjSpec, file: Path) -> tuple[mujoco.MjModel, tuple[str, ...]]:
    """Compile a specification, without the meshes that MuJoCo cannot use.

    Args:
        spec: the specification; the shapes of these meshes are taken out of it.
        file: its model file, for messages.

    Returns:
        The model, and a note on each link that lost a shape.

    Raises:
        RobotError: MuJoCo rejects the model for another reason, or a mass depends on these shapes.
    """
    try:
        return compile_spec(spec, file), ()
    except RobotError:
        notes = leave_out_unusable(spec)
        if not notes:
            raise
        return compile_spec(spec, file), notes


def joint_names(model: mujoco.MjModel) -> tuple[str, ...]:
    """Return the names of the joints of a model, in the order of the model.

    Args:
        model: the model.
    """
    return tuple(model.joint(index).name for index in range(model.njnt))


def _name_all(spec: mujoco.MjSpec) -> None:
    """Name unnamed parts, such as `joint_1`: a file may omit names, but limits and messages need them."""
    for kind, items in (("joint", spec.joints), ("body", spec.bodies[1:]), ("tendon", spec.tendons)):
        taken = {item.name for item in items}
        free = (name for i in count(1) if (name := f"{kind}_{i}") not in taken)
        for item in items:
            item.name = item.name or next(free)


def _keep_masses(spec: mujoco.MjSpec, file: Path) -> None:
    """Give every body the mass that results from the file's compiler options, and reset these options."""
    compiler, usual = spec.compiler, USUAL.compiler
    if all(getattr(compiler, name) == getattr(usual, name) for name in MASS_OPTIONS):
        return
    model = compile_spec(spec, file)
    for name in MASS_OPTIONS:
        setattr(compiler, name, getattr(usual, name))
    for body in spec.bodies[1:]:
        body.explicitinertial, body.mass = True, model.body_mass[body.id]
        body.ipos, body.iquat = model.body_ipos[body.id], model.body_iquat[body.id]
        body.inertia, body.fullinertia = model.body_inertia[body.id], np.full(6, np.nan)
        body.ialt.type = mujoco.mjtOrientation.mjORIENTATION_QUAT


@contextmanager
def _refused(message: str) -> Iterator[None]:
    """Turn the errors of MuJoCo and of the XML reader into a RobotError, with their words on one line."""
    try:
        yield
    except (ValueError, OSError, RuntimeError, MemoryError, mujoco.FatalError) as error:
        words = shortened(" ".join(str(error).split()), 300) or type(error).__name__
        raise RobotError(f"{message}: {words}", key="robot.model") from error
