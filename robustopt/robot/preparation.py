"""The robot of a configuration as MuJoCo specifications, prepared for planning and for simulation.

The base is placed in the world, locked joints become fixed, the carrier frame becomes a site of the tool, and a
floating base gets plain coordinates. Everything else of the model file stays.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from robustopt.arrays import Array
from robustopt.config import BASE_COORDINATES, Config, Pose
from robustopt.errors import RobotError
from robustopt.robot.floating_base import (
    base_coordinates,
    free_joint_positions,
    posture_of,
    replace_free_joints,
    require_walker,
)
from robustopt.robot.hands import Hand, shares, tool_frames
from robustopt.robot.inertia import Inertia
from robustopt.robot.locking import followers, lock_joints
from robustopt.robot.model_check import require_room
from robustopt.robot.model_file import USUAL, compile_usable, model_file, read_model
from robustopt.robot.soles import Sole, environment_contacts
from robustopt.robot.urdf import UrdfLimits

CARRIER_SITE = "robustopt_carrier"
"""Name of the site at the carrier frame: the tray's centre, or the tool without a tray."""


@dataclass(frozen=True)
class RobotModel:
    """A robot read from its file and prepared.

    Attributes:
        spec: specification for planning, to be compiled.
        world_spec: the same for simulation, with a free joint in place of six coordinates for a floating base.
        original: the model as in its file, with all joints, actuators and limits.
        file: the model file.
        urdf_limits: limits of a URDF file that MuJoCo does not keep.
        inertias: inertias as written that MuJoCo does not take, by name of the body.
        notes: content of the file that was left out or replaced, in words.
        base: number of coordinates of a floating base, 0 or 6.
        posture: position of every coordinate that the path does not prescribe, by name [rad or m].
        contacts: environment contacts by name.
    """

    spec: mujoco.MjSpec
    world_spec: mujoco.MjSpec
    original: mujoco.MjModel
    file: Path
    urdf_limits: UrdfLimits
    inertias: Mapping[str, Inertia]
    notes: tuple[str, ...]
    base: int
    posture: Mapping[str, float]
    contacts: Mapping[str, Sole]
    hands: tuple[Hand, ...]


def load_model(config: Config) -> RobotModel:
    """Read and prepare the robot of a configuration.

    Args:
        config: the configuration.

    Raises:
        RobotError: the model cannot be found or read, does not fit the path, or lacks its tool or a joint to lock; or a
            walking robot has springs, or lacks a foot or a keyframe.
    """
    file = model_file(config)
    content = read_model(file, config.robot.locked)
    spec, limits = content.spec, content.limits
    placed = [name for name, given in config.robot.limits.joints.items() if given.position is not None]
    if "all" not in placed:
        require_room(spec, limits.position, {*config.robot.locked, *placed}, str(file))
    original, without = compile_usable(spec, file)
    base = base_coordinates(original, file.name)
    _require_matching_path(config, original, base, file.name)
    posture = posture_of(original, base)
    _override_posture(posture, base, config, file.name)
    contacts = environment_contacts(original, config, file.name)
    hands: tuple[Hand, ...] = ()
    for key in list(spec.keys):
        spec.delete(key)
    if not base or config.tray is not None or config.objects:
        _require_tools(spec, config, file.name)
        if len(config.robot.tools) > 1:
            hands = _attach_to_hands(spec, original, config, np.array(list(posture.values())))
        else:
            _attach_carrier(spec, original, config)
    mimics = followers(original, config.robot.locked)
    lock_joints(spec, original, mimics | config.robot.locked, file.name)
    _require_open_chain(spec, file.name)
    _place_base(spec, config.robot.base)
    notes = (*content.notes, *without, *_tendon_notes(spec, original), *_mimic_notes(mimics))
    world_spec = spec.copy()
    replace_free_joints(spec)
    return RobotModel(
        spec, world_spec, original, file, limits, content.inertias, notes, base, posture, contacts, hands
    )  # fmt: skip


def _mimic_notes(mimics: Mapping[str, float]) -> tuple[str, ...]:
    """Return a note on joints that are held because they mimic locked ones; () without any."""
    if not mimics:
        return ()
    held = ", ".join(f"{name} at {position:.6g}" for name, position in mimics.items())
    return (f"joints that mimic locked joints are held: {held}",)


def _require_matching_path(config: Config, model: mujoco.MjModel, base: int, file: str) -> None:
    """Check that a walking robot has steps and can do them, and an arm has none."""
    if base:
        require_walker(config, model, file)
    elif config.path.steps is not None:
        raise RobotError(
            f"{file} has no free joint, so it cannot walk along path.steps; give a model whose first joint is free, or "
            "another path, such as path.joints",
            key="robot.model",
        )


def _require_open_chain(spec: mujoco.MjSpec, file: str) -> None:
    """Check that no active equality constraint couples links or joints."""
    closing = [item.name or f"{item.name1} and {item.name2}" for item in spec.equalities if item.active]
    if closing:
        raise RobotError(
            f"{file} couples its links or joints by equality constraints ({', '.join(closing)}), which a plan "
            "would not keep; lock their joints, or take the constraints out of the file",
            key="robot.model",
        )


def _override_posture(posture: dict[str, float], base: int, config: Config, file: str) -> None:
    """Put the joint positions of `robot.posture` and the height of the pelvis into a posture."""
    joints = list(posture)[base:]
    for joint, value in config.robot.posture.items():
        if joint not in joints:
            known = ", ".join(joints)
            raise RobotError(f"{file} has no joint {joint}; its joints are: {known}", key="robot.posture")
        posture[joint] = value
    if config.path.pelvis_height is not None:
        posture["base_z"] = config.path.pelvis_height


def _require_tools(spec: mujoco.MjSpec, config: Config, file: str) -> None:
    """Check that the tools exist."""
    sites, bodies = [item.name for item in spec.sites], [item.name for item in spec.bodies[1:]]
    tools = config.robot.tools
    for tool in tools:
        if tool not in sites and tool not in bodies:
            raise RobotError(
                f"{file} has no site or body {tool!r}; its sites are: {', '.join(filter(None, sites)) or '(none)'}; "
                f"its bodies are: {', '.join(filter(None, bodies))}",
                key="robot.tool",
            )


def _attach_carrier(spec: mujoco.MjSpec, original: mujoco.MjModel, config: Config) -> None:
    """Add the site of the carrier frame: the tray's pose in the frame of the tool, or the tool itself."""
    (tool,) = config.robot.tools
    is_site = tool in [item.name for item in spec.sites]
    body = spec.site(tool).parent if is_site else spec.body(tool)
    pose = Pose() if config.tray is None else config.tray.pose
    tool_position, tool_rotation = np.zeros(3), Rotation.identity()
    if is_site:
        tool_position = original.site(tool).pos
        tool_rotation = Rotation.from_quat(original.site(tool).quat, scalar_first=True)
    rotation = tool_rotation * Rotation.from_quat(_quaternion(pose), scalar_first=True)
    position = tool_position + tool_rotation.apply(pose.position)
    body.add_site(USUAL.default, name=CARRIER_SITE, pos=position, quat=rotation.as_quat(scalar_first=True))


def _attach_to_hands(spec: mujoco.MjSpec, original: mujoco.MjModel, config: Config, posture: Array) -> tuple[Hand, ...]:
    """Add the site of the carrier frame of several hands: the tray's pose in a frame in the middle between them.

    Returns:
        The hands, at their places in the posture of the robot (n,).
    """
    tools, qpos = config.robot.tools, free_joint_positions(posture[None], BASE_COORDINATES)[0]
    position, axes, bodies = tool_frames(original, qpos, tools)
    pose = Pose() if config.tray is None else config.tray.pose
    first = Rotation.from_matrix(axes[0])
    origin = position.mean(axis=0) + first.apply(pose.position)
    turn = first * Rotation.from_quat(_quaternion(pose), scalar_first=True)
    data, body = mujoco.MjData(original), original.body(bodies[0]).id
    data.qpos[:] = qpos
    mujoco.mj_kinematics(original, data)
    into = Rotation.from_matrix(data.xmat[body].reshape(3, 3)).inv()
    spec.body(bodies[0]).add_site(
        USUAL.default, name=CARRIER_SITE, pos=into.apply(origin - data.xpos[body]),
        quat=(into * turn).as_quat(scalar_first=True),
    )  # fmt: skip
    points = turn.inv().apply(position - origin)
    return tuple(Hand(*item) for item in zip(tools, bodies, points, shares(points), strict=True))


def _place_base(spec: mujoco.MjSpec, base: Pose) -> None:
    if base == Pose():
        return
    world = spec.worldbody
    top = [item for item in (*world.bodies, *world.geoms, *world.sites, *world.frames) if item.frame is None]
    frame = world.add_frame(pos=base.position, quat=_quaternion(base))
    for item in top:
        item.set_frame(frame)


def _quaternion(pose: Pose) -> Array:
    """Return the orientation w, x, y, z of a pose given by roll, pitch, yaw about fixed axes."""
    return np.asarray(Rotation.from_euler("xyz", pose.rpy).as_quat(scalar_first=True))


def _tendon_notes(spec: mujoco.MjSpec, original: mujoco.MjModel) -> tuple[str, ...]:
    """Note the tendons with effects that plans do not include; their springs are included."""
    unknown = original.tendon_limited | (original.tendon_armature != 0) | (original.tendon_damping != 0)
    unknown |= original.tendon_frictionloss != 0
    left = {tendon.name for tendon in spec.tendons}
    names = [name for i in np.flatnonzero(unknown) if (name := original.tendon(i).name) in left]
    if not names:
        return ()
    return (
        f"range, armature, damping and friction of tendons act in simulation, but not in plans: {', '.join(names)}",
    )
