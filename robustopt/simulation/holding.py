"""Suction cups and gripper pads in the simulated world.

A lip or pad is a ring of small spheres on the tool at the planned contact points; they alone touch the part. The vacuum
is a spring of 100 m from far inside the tool to the part: a force along the axis of the cup that is constant within
1e-5 per millimetre and acts from the start. An actuator would be wrong on an arm, because MuJoCo adds its reaction on
the tool to the motor torques, which are limited. The closing force is a spring of the same length on
the slide of the driven finger.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from robustopt.arrays import Array
from robustopt.config import Config
from robustopt.config.object_model import pad_names
from robustopt.limits.hands import hand_patches
from robustopt.robot import Robot
from robustopt.robot.hands import Hand
from robustopt.robot.model_file import USUAL
from robustopt.robot.preparation import CARRIER_SITE
from robustopt.scene.patches import Law, Patch, patches
from robustopt.scene.placement import CARRIER as CARRIER_FRAME
from robustopt.scene.placement import TRAY, Frame, placements
from robustopt.simulation.interfaces import Held
from robustopt.simulation.objects import CARRIER, HIDDEN, add_pose_sensor, body_name, pose_sensor
from robustopt.simulation.parameters import Parameters, require_some_left
from robustopt.simulation.physics import PREFIX, add_contact, quaternion

RADIUS = 0.002
"""Radius of the spheres of a lip or pad [m]."""

DEPTH = 1e-5
"""Initial depth of these spheres in the part [m]: without initial contact, the part would drop first."""

SPRING = 100.0
"""Length of the springs that press the part [m]; all movements are small in comparison."""

ARMATURE = 0.5
"""Inertia of the finger's drive [kg]: without it a light finger creeps and loses its part early. It resists only
the movement of the finger in the hand; unlike the mass of the finger it does not reduce the closing force."""

LEAST_MASS = 1e-4
"""Smallest mass of a finger that MuJoCo accepts [kg]; it reduces the closing force."""

STROKE = 0.1
"""Distance that the finger can move to either side [m], so that it stays in the picture if it loses its part."""


@dataclass(frozen=True, eq=False)
class Hold:
    """Cups or pads of one tool or hand that hold a part.

    Attributes:
        name: name of the part, or of one of several hands that hold the tray.
        part: name of the held object, or `tray`.
        holder: name of the body that the cups and pads belong to, whose frame is the carrier frame.
        place: planned frame of the part, carrier frame.
        patches: contacts of the part with its cups or pads.
        finger_mass: mass of the driven finger [kg].
    """

    name: str
    part: str
    holder: str
    place: Frame
    patches: tuple[Patch, ...]
    finger_mass: float = 0.0


def holds_of(config: Config, hands: Sequence[Hand] = ()) -> tuple[Hold, ...]:
    """Return the holds of a task: one for each held object, and one for each of several hands that hold the tray.

    Args:
        config: the configuration.
        hands: hands of the robot that hold its tray.
    """
    found, contacts, places = [], patches(config), placements(config)
    for name, shape in config.objects.items():
        if shape.held_by is not None:
            own = tuple(patch for patch in contacts if patch.object == name and patch.law is not Law.FRICTION)
            mass = 0.0 if shape.held_by.grip is None else shape.held_by.grip.finger_mass
            place = Frame(places[name].position, places[name].rotation)
            found.append(Hold(name, name, CARRIER, place, own, mass))
    pads = hand_patches(config, hands)
    for hand in hands:
        own = tuple(patch for patch in pads if patch.name in pad_names(hand.name))
        found.append(Hold(hand.name, TRAY, PREFIX + hand.name, CARRIER_FRAME, own))
    return tuple(found)


def add_hands(spec: mujoco.MjSpec, robot: Robot) -> None:
    """Add to each of several hands a massless body at the carrier frame, placed as in the posture of the robot.

    Args:
        spec: specification of the world, which is changed.
        robot: the robot.
    """
    if not robot.hands:
        return
    model = robot.world_spec.compile()
    data = mujoco.MjData(model)
    data.qpos[:] = robot.qpos(robot.posture[None])[0]
    mujoco.mj_kinematics(model, data)
    site = data.site(CARRIER_SITE)
    for hand in robot.hands:
        body = data.body(hand.body)
        into = body.xmat.reshape(3, 3).T
        turn = quaternion(into @ site.xmat.reshape(3, 3))
        spec.body(hand.body).add_body(name=PREFIX + hand.name, pos=into @ (site.xpos - body.xpos), quat=turn)


def add_hold(spec: mujoco.MjSpec, hold: Hold, parameters: Parameters) -> None:
    """Add cups or pads, and sensors for the pose of their part in the carrier frame.

    Args:
        spec: specification of the world, which is changed.
        hold: the hold.
        parameters: actual parameters.

    Raises:
        ConfigError: an inset leaves nothing of a lip or pad.
    """
    for patch in hold.patches:
        _add_patch(spec, hold, patch, parameters)
    add_pose_sensor(spec, hold.name, body_name(hold.part), hold.holder)


def _add_patch(spec: mujoco.MjSpec, hold: Hold, patch: Patch, parameters: Parameters) -> None:
    force, body, origin, axes = parameters.force[hold.part], spec.body(hold.holder), patch.origin, patch.axes
    if patch.law is Law.DRIVEN_PAD:
        body, origin, axes = add_finger(body, patch, hold.finger_mass), np.zeros(3), np.eye(3)
        _add_closing_force(body, force)
    elif patch.law is Law.SUCTION:
        _add_vacuum(spec, hold, patch, force)
    inset = parameters.inset.get(patch.name, parameters.inset.get(hold.part, 0.0))
    shape = PREFIX + hold.part
    for k, point in enumerate(_shrunk(patch, inset)):
        name = f"{PREFIX}{patch.name}_{k}"
        body.add_geom(
            USUAL.default, name=name, type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[RADIUS, 0.0, 0.0], mass=0.0,
            pos=origin + axes @ np.array([*point, DEPTH - RADIUS]), contype=0, conaffinity=0,
            rgba=(0.15, 0.15, 0.17, 1.0),
        )  # fmt: skip
        add_contact(spec, name, shape, parameters.friction[patch.name])


def add_finger(holder: mujoco.MjsBody, patch: Patch, mass: float) -> mujoco.MjsBody:
    """Add the driven finger of a gripper, fixed to its holder; z of its frame points into the part.

    Args:
        holder: body that the finger belongs to.
        patch: contact of its pad.
        mass: mass of the finger [kg].
    """
    finger = holder.add_body(name=PREFIX + patch.name, pos=patch.origin, quat=quaternion(patch.axes))
    finger.explicitinertial, finger.mass = True, max(mass, LEAST_MASS)
    finger.inertia = np.full(3, 1e-3 * finger.mass)
    return finger


def held(holds: Sequence[Hold], model: mujoco.MjModel) -> tuple[Held, ...]:
    """Return the interfaces of held parts with their tools.

    Args:
        holds: the holds.
        model: compiled model of the world.
    """
    found = []
    for hold in holds:
        counts = [len(patch.polygon) for patch in hold.patches]
        points = np.vstack([patch.points for patch in hold.patches])
        normals = np.repeat([patch.axes[:, 2] for patch in hold.patches], counts, axis=0)
        rigid = np.repeat([patch.law is not Law.DRIVEN_PAD for patch in hold.patches], counts)
        sensor = pose_sensor(model, hold.name, hold.holder)
        tool = "pads" if not rigid.all() else "cup" if len(counts) == 1 else "cups"
        holder = tool if hold.name == hold.part else hold.part
        found.append(Held(hold.name, holder, sensor, hold.place.position, hold.place.rotation, points, normals, rigid))
    return tuple(found)


def _add_closing_force(finger: mujoco.MjsBody, force: float) -> None:
    """Press a finger along z into its part."""
    finger.add_joint(
        USUAL.default, name=finger.name, type=mujoco.mjtJoint.mjJNT_SLIDE, axis=[0.0, 0.0, 1.0], armature=ARMATURE,
        stiffness=[force / SPRING, 0.0, 0.0], springref=SPRING, limited=mujoco.mjtLimited.mjLIMITED_TRUE,
        range=[-STROKE, STROKE],
    )  # fmt: skip


def _add_vacuum(spec: mujoco.MjSpec, hold: Hold, patch: Patch, force: float) -> None:
    """Pull a part along the axis of a cup, towards a point that is far inside the tool."""
    name, axis = PREFIX + patch.name, patch.axes[:, 2]
    local = hold.place.rotation.T @ (patch.origin - hold.place.position)
    far = spec.body(hold.holder).add_site(
        USUAL.default, name=f"{name}_far", pos=patch.origin - SPRING * axis, rgba=HIDDEN
    )
    near = spec.body(body_name(hold.part)).add_site(USUAL.default, name=f"{name}_near", pos=local, rgba=HIDDEN)
    pull = spec.add_tendon(
        USUAL.default, name=name, stiffness=[force / SPRING, 0.0, 0.0], springlength=[0.0, 0.0], rgba=HIDDEN
    )
    for site in (far, near):
        pull.wrap_site(site.name)


def _shrunk(patch: Patch, inset: float) -> Array:
    """Return the contact points in the plane of the patch, moved inwards by an inset [m], (k, 2)."""
    points = patch.polygon
    if inset == 0.0:
        return points
    reach = np.linalg.norm(points, axis=1, keepdims=True) if patch.law is Law.SUCTION else np.abs(points)
    require_some_left(patch.name, inset, reach)
    return np.asarray(points - inset * (points / reach))
