"""The robot's model file: found, read and prepared as a MuJoCo specification.

What a user's MJCF or URDF file says is taken as it is, except that the base is placed in the world, locked joints
become fixed, and a site for the tray is attached to the tool. The same specification serves planning and execution.
"""

from __future__ import annotations

import hashlib
import os
import re
import site
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import count
from pathlib import Path

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from robustopt.config import Config, Pose
from robustopt.errors import RobotError
from robustopt.models import MODELS
from robustopt.robot.urdf import UrdfLimits, is_urdf, read_urdf

TRAY_SITE = "robustopt_tray"

USUAL = mujoco.MjSpec()
"""MuJoCo's own settings. What is added to a robot is made with `USUAL.default`, else it would take the defaults of the
robot's file: margins of its geoms, force ranges of its actuators, and so on."""

MASS_OPTIONS = ("inertiafromgeom", "settotalmass", "boundmass", "boundinertia", "balanceinertia")
"""Options of MuJoCo's compiler that change the masses of all bodies, also of those that are added to the model."""


@dataclass(frozen=True)
class RobotModel:
    """A robot read from its file.

    `spec`: prepared specification, to be compiled. `original`: the model as the file has it, all joints, with its
    actuators and limits. `urdf_limits`: what MuJoCo does not keep of a URDF. `notes`: what was left out, for people.
    """

    spec: mujoco.MjSpec
    original: mujoco.MjModel
    file: Path
    urdf_limits: UrdfLimits
    notes: tuple[str, ...]


def shipped_models() -> tuple[str, ...]:
    """Names of the robots that come with the package."""
    return tuple(sorted(file.stem for file in MODELS.glob("*.xml")))


def share_folders() -> tuple[Path, ...]:
    """Folders in which `package://NAME/...` is looked for as `NAME/...`.

    Those of the environment variables ROS_PACKAGE_PATH, AMENT_PREFIX_PATH and CMAKE_PREFIX_PATH, then those of this
    Python: where ROS and pip packages put robot descriptions.
    """
    folders = [Path(entry) for entry in os.environ.get("ROS_PACKAGE_PATH", "").split(os.pathsep) if entry]
    for variable in ("AMENT_PREFIX_PATH", "CMAKE_PREFIX_PATH"):
        folders += [Path(entry) / "share" for entry in os.environ.get(variable, "").split(os.pathsep) if entry]
    for packages in [*site.getsitepackages(), site.getusersitepackages()]:
        folders.append(Path(packages) / "cmeel.prefix" / "share")
    return (*folders, Path(sys.prefix) / "share")


def resolve_package(uri: str) -> Path | None:
    """The file that `package://NAME/...` means, or None if no share folder has it."""
    relative = uri.removeprefix("package://")
    return next((folder / relative for folder in share_folders() if (folder / relative).is_file()), None)


def model_file(config: Config) -> Path:
    """The file that `robot.model` names: a shipped robot, a package file, or a file relative to the configuration."""
    name = config.robot.model
    if name in shipped_models():
        return MODELS / f"{name}.xml"
    if name.startswith("package://"):
        file = resolve_package(name)
        if file is None:
            folders = ", ".join(str(folder) for folder in share_folders())
            raise RobotError(f"{name} was not found in the share folders {folders}", key="robot.model")
        return file
    file = config.folder / name
    if file.is_file():
        return file
    shipped = ", ".join(shipped_models())
    if Path(name).suffix.lower() in {".xml", ".mjcf", ".urdf"}:
        raise RobotError(f"there is no file {file}; the shipped robots are: {shipped}", key="robot.model")
    raise RobotError(
        f"unknown robot {name!r}; give a shipped robot ({shipped}) or an MJCF or URDF file", key="robot.model"
    )


NAMED = re.compile(r"""\b(?:file|filename|meshdir|texturedir|assetdir)\s*=\s*["']([^"']+)["']""")
"""Files and folders that a model file names."""


def model_hash(file: Path) -> str:
    """SHA-256 of a model file and of all files that it names: those that it includes, meshes, height fields."""
    digest = hashlib.sha256()
    for part in _parts(file, [file.parent], []):
        digest.update(part.read_bytes())
    return digest.hexdigest()


def _parts(file: Path, folders: Sequence[Path], found: list[Path]) -> list[Path]:
    """A file and those that it names, each once; MuJoCo looks for them from the folder of the model file on."""
    found.append(file)
    if file.suffix.lower() not in {".xml", ".mjcf", ".urdf"}:
        return found
    names = NAMED.findall(file.read_text(encoding="utf-8", errors="replace"))
    folders = list(dict.fromkeys([*folders, file.parent]))
    folders += [place / name for place in folders for name in names if (place / name).is_dir()]
    for name in names:
        places = (
            [resolve_package(name)]
            if name.startswith("package://")
            else [place / name.removeprefix("file://") for place in folders]
        )
        for place in places:
            if place is not None and place.is_file() and place not in found:
                _parts(place, folders, found)
    return found


def load_model(config: Config) -> RobotModel:
    """The robot of the configuration: base placed, locked joints fixed, tray site attached to the tool."""
    file = model_file(config)
    spec, limits, notes = read_model(file)
    for key in list(spec.keys):
        spec.delete(key)
    original = compile_spec(spec, file)
    _require_hinges_and_slides(original, file)
    _attach_tray(spec, original, config, file)
    _lock_joints(spec, original, config, file)
    require_open_chain(spec, file)
    _place_base(spec, config.robot.base)
    notes += tendon_notes(spec, original)
    return RobotModel(spec=spec, original=original, file=file, urdf_limits=limits, notes=notes)


def compile_spec(spec: mujoco.MjSpec, file: Path) -> mujoco.MjModel:
    """The compiled model; what MuJoCo objects to becomes a RobotError of one line."""
    try:
        return spec.compile()
    except ValueError as error:
        raise RobotError(f"{file}: MuJoCo cannot use the model: {_one_line(error)}", key="robot.model") from error


def tendon_notes(spec: mujoco.MjSpec, original: mujoco.MjModel) -> tuple[str, ...]:
    """A note about the tendons of a robot that do what no plan knows of, if there are any; springs are known."""
    unknown = original.tendon_limited | (original.tendon_armature != 0) | (original.tendon_damping != 0)
    unknown |= original.tendon_frictionloss != 0
    left = {tendon.name for tendon in spec.tendons}
    names = [name for i in np.flatnonzero(unknown) if (name := original.tendon(i).name) in left]
    if not names:
        return ()
    return (
        f"range, armature, damping and friction of tendons act in simulation, but not in plans: {', '.join(names)}",
    )


def joint_names(model: mujoco.MjModel) -> tuple[str, ...]:
    """Names of the joints of a model, in its order."""
    return tuple(model.joint(index).name for index in range(model.njnt))


def pose_quaternion(pose: Pose) -> np.ndarray:
    """Orientation w, x, y, z of a pose given by roll, pitch, yaw about fixed axes."""
    return np.asarray(Rotation.from_euler("xyz", pose.rpy).as_quat(scalar_first=True))


def read_model(file: Path) -> tuple[mujoco.MjSpec, UrdfLimits, tuple[str, ...]]:
    """The specification in a file, what MuJoCo does not keep of a URDF, and notes on what was left out.

    Joints, bodies and tendons without a name get one. Options, flags and settings of the compiler that the file sets
    for the whole model, of which the robot is a part only, are undone.
    """
    limits = UrdfLimits()
    notes: tuple[str, ...] = ()
    try:
        if is_urdf(file):
            text, limits, notes = read_urdf(file, resolve_package)
            spec = mujoco.MjSpec.from_string(text)
        else:
            spec = mujoco.MjSpec.from_file(str(file))
    except (ValueError, OSError) as error:
        raise RobotError(f"{file}: not a model that MuJoCo can read: {_one_line(error)}", key="robot.model") from error
    spec.compiler.fusestatic = spec.compiler.alignfree = False
    spec.option.disableflags = spec.option.enableflags = 0
    spec.option.density = spec.option.viscosity = 0.0
    _name_all(spec)
    _keep_masses(spec, file)
    return spec, limits, notes


def _name_all(spec: mujoco.MjSpec) -> None:
    """Names such as `joint_1` for what has none: a file need not name its joints, but limits and messages do."""
    for kind, items in (("joint", spec.joints), ("body", spec.bodies[1:]), ("tendon", spec.tendons)):
        taken = {item.name for item in items}
        free = (name for i in count(1) if (name := f"{kind}_{i}") not in taken)
        for item in items:
            item.name = item.name or next(free)


def _keep_masses(spec: mujoco.MjSpec, file: Path) -> None:
    """Give every body the mass that the compiler options of the file make of it, and undo these options."""
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


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())


def _place_base(spec: mujoco.MjSpec, base: Pose) -> None:
    if base == Pose():
        return
    world = spec.worldbody
    top = [item for item in (*world.bodies, *world.geoms, *world.sites, *world.frames) if item.frame is None]
    frame = world.add_frame(pos=base.position, quat=pose_quaternion(base))
    for item in top:
        item.set_frame(frame)


def _require_hinges_and_slides(model: mujoco.MjModel, file: Path) -> None:
    other = {int(mujoco.mjtJoint.mjJNT_FREE): "free", int(mujoco.mjtJoint.mjJNT_BALL): "ball"}
    kinds = [other.get(int(kind)) for kind in model.jnt_type]
    wrong = [f"{kind} joint {model.joint(i).name!r}" for i, kind in enumerate(kinds) if kind]
    if wrong or model.njnt == 0:
        found = ", ".join(wrong) or "no joint"
        raise RobotError(f"{file.name} has {found}; a robot has hinge and slide joints only", key="robot.model")


def _lock_joints(spec: mujoco.MjSpec, original: mujoco.MjModel, config: Config, file: Path) -> None:
    """Fix the joints of `robot.locked` at their values by folding their motion into the pose of their body."""
    locked = config.robot.locked
    names = joint_names(original)
    unknown = [name for name in locked if name not in names]
    if unknown:
        raise RobotError(
            f"{file.name} has no joint {', '.join(unknown)}; its joints are: {', '.join(names)}", key="robot.locked"
        )
    if locked and set(locked) == set(names):
        raise RobotError("every joint is locked; at least one must move", key="robot.locked")
    data = mujoco.MjData(original)
    for name, value in locked.items():
        data.qpos[original.joint(name).qposadr[0]] = value
    mujoco.mj_kinematics(original, data)
    for body in {spec.joint(name).parent.name: spec.joint(name).parent for name in locked}.values():
        moving = [joint.name for joint in body.joints if joint.name not in locked]
        if moving:
            raise RobotError(
                f"the body {body.name} of {file.name} moves in several joints; lock {', '.join(moving)} too, or none",
                key="robot.locked",
            )
        if body.frame is not None:
            body.set_frame(body.parent.add_frame())
        body.pos, body.quat = _pose_in_parent(original, data, original.body(body.name).id)
        body.alt.type = mujoco.mjtOrientation.mjORIENTATION_QUAT
    _delete_joints(spec, set(locked))


def _delete_joints(spec: mujoco.MjSpec, joints: set[str]) -> None:
    """Delete joints with the tendons, couplings, actuators and sensors that hang on them."""
    target, trn, eq, obj = mujoco.mjtWrap.mjWRAP_JOINT, mujoco.mjtTrn, mujoco.mjtEq, mujoco.mjtObj
    tendons = {
        tendon.name
        for tendon in spec.tendons
        if any(wrap.type == target and wrap.target.name in joints for wrap in tendon.path)
    }
    gone = {"joint": joints, "tendon": tendons}
    driven = {trn.mjTRN_JOINT: "joint", trn.mjTRN_JOINTINPARENT: "joint", trn.mjTRN_TENDON: "tendon"}
    coupled = {eq.mjEQ_JOINT: "joint", eq.mjEQ_TENDON: "tendon"}
    sensed = {obj.mjOBJ_JOINT: "joint", obj.mjOBJ_TENDON: "tendon", obj.mjOBJ_ACTUATOR: "actuator"}
    actuators = [item for item in spec.actuators if item.target in gone.get(driven.get(item.trntype, ""), ())]
    gone["actuator"] = {item.name for item in actuators}
    couplings = [
        item for item in spec.equalities if {item.name1, item.name2} & set(gone.get(coupled.get(item.type, ""), ()))
    ]
    sensors = [item for item in spec.sensors if item.objname in gone.get(sensed.get(item.objtype, ""), ())]
    for item in [*sensors, *couplings, *actuators]:
        spec.delete(item)
    for name in tendons:
        spec.delete(spec.tendon(name))
    for name in joints:
        spec.delete(spec.joint(name))


def require_open_chain(spec: mujoco.MjSpec, file: Path) -> None:
    """Raise RobotError where active equality constraints couple links or joints."""
    closing = [item.name or f"{item.name1} and {item.name2}" for item in spec.equalities if item.active]
    if closing:
        raise RobotError(
            f"{file.name} couples its links or joints by equality constraints ({', '.join(closing)}), which a plan "
            "would not keep; lock their joints, or take the constraints out of the file",
            key="robot.model",
        )


def _pose_in_parent(model: mujoco.MjModel, data: mujoco.MjData, body: int) -> tuple[np.ndarray, np.ndarray]:
    parent = model.body_parentid[body]
    position, inverse, quaternion = np.zeros(3), np.zeros(4), np.zeros(4)
    mujoco.mju_negQuat(inverse, data.xquat[parent])
    mujoco.mju_rotVecQuat(position, data.xpos[body] - data.xpos[parent], inverse)
    mujoco.mju_mulQuat(quaternion, inverse, data.xquat[body])
    return position, quaternion


def _attach_tray(spec: mujoco.MjSpec, original: mujoco.MjModel, config: Config, file: Path) -> None:
    """Add the site of the tray frame: `tray.pose` in the frame of the tool, a site or a body."""
    tool = config.robot.tool
    sites, bodies = [item.name for item in spec.sites], [item.name for item in spec.bodies[1:]]
    if tool not in sites and tool not in bodies:
        raise RobotError(
            f"{file.name} has no site or body {tool!r}; its sites are: {', '.join(filter(None, sites)) or '(none)'}; "
            f"its bodies are: {', '.join(filter(None, bodies))}",
            key="robot.tool",
        )
    body = spec.site(tool).parent if tool in sites else spec.body(tool)
    tool_position, tool_rotation = np.zeros(3), Rotation.identity()
    if tool in sites:
        tool_position = original.site(tool).pos
        tool_rotation = Rotation.from_quat(original.site(tool).quat, scalar_first=True)
    rotation = tool_rotation * Rotation.from_quat(pose_quaternion(config.carried_tray.pose), scalar_first=True)
    position = tool_position + tool_rotation.apply(config.carried_tray.pose.position)
    body.add_site(USUAL.default, name=TRAY_SITE, pos=position, quat=rotation.as_quat(scalar_first=True))
