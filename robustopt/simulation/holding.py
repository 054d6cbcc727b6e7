"""Suction cups and gripper pads in the simulated world.

A lip or pad is a ring of small spheres on the tool at the planned contact points; they alone touch the part. The vacuum
is a spring of 100 m from far inside the tool to the part: a force along the axis of the cup that is constant within
1e-5 per millimetre and acts from the start. An actuator would be wrong on an arm, because MuJoCo adds its reaction on
the tool to the torques of the motors, to which their limits apply. The closing force is a spring of the same length on
the slide of the driven finger.
"""

from __future__ import annotations

import mujoco
import numpy as np

from robustopt.arrays import Array
from robustopt.config import Config
from robustopt.robot.model_file import USUAL
from robustopt.scene.patches import Law, Patch, patches
from robustopt.scene.placement import Placement, placements
from robustopt.simulation.interfaces import Held
from robustopt.simulation.objects import pose_sensor
from robustopt.simulation.parameters import Parameters
from robustopt.simulation.physics import PREFIX, add_contact, quaternion

RADIUS = 0.002
"""Radius of the spheres of a lip or pad [m]."""

DEPTH = 1e-5
"""Depth of these spheres in the part at the start [m]: without a contact at the start, the part would drop first."""

SPRING = 100.0
"""Length of the springs that press [m], against which all movements are small."""

ARMATURE = 0.5
"""Inertia of the finger's drive [kg]: without it a light finger creeps and loses its part early. It resists movement of
the finger in the hand alone, and does not count against the closing force as the mass of the finger does."""

LEAST_MASS = 1e-4
"""Least mass of a finger [kg], for MuJoCo; it counts against the closing force."""

STROKE = 0.1
"""Distance that the finger can move to either side [m], so that one that has lost its part stays in the picture."""

UNSEEN = (0.0, 0.0, 0.0, 0.0)


def add_hold(spec: mujoco.MjSpec, config: Config, tool: mujoco.MjsBody, patch: Patch, parameters: Parameters) -> None:
    """Hold a part by the cup or pad of a patch; tool: body of the cups and pads, its frame is the carrier frame."""
    part, force = spec.body(PREFIX + patch.object), parameters.force[patch.object]
    holder, origin, axes = tool, patch.origin, patch.axes
    if patch.law is Law.DRIVEN_PAD:
        holder, origin, axes = add_finger(tool, config, patch), np.zeros(3), np.eye(3)
        _add_closing_force(holder, force)
    elif patch.law is Law.SUCTION:
        _add_vacuum(spec, tool, part, placements(config)[patch.object], patch, force)
    inset = parameters.inset.get(patch.name, parameters.inset.get(patch.object, 0.0))
    for k, point in enumerate(_shrunk(patch, inset)):
        name = f"{PREFIX}{patch.name}_{k}"
        holder.add_geom(
            USUAL.default, name=name, type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[RADIUS, 0.0, 0.0], mass=0.0,
            pos=origin + axes @ np.array([*point, DEPTH - RADIUS]), contype=0, conaffinity=0,
            rgba=(0.15, 0.15, 0.17, 1.0),
        )  # fmt: skip
        add_contact(spec, name, part.name, parameters.friction[patch.name])


def add_finger(tool: mujoco.MjsBody, config: Config, patch: Patch) -> mujoco.MjsBody:
    """Add the driven finger of a gripper, fixed to the tool; z of its frame points into the part."""
    finger = tool.add_body(name=PREFIX + patch.name, pos=patch.origin, quat=quaternion(patch.axes))
    hold = config.objects[patch.object].held_by
    mass = hold.grip.finger_mass if hold is not None and hold.grip is not None else 0.0
    finger.explicitinertial, finger.mass = True, max(mass, LEAST_MASS)
    finger.inertia = np.full(3, 1e-3 * finger.mass)
    return finger


def held(config: Config, model: mujoco.MjModel) -> tuple[Held, ...]:
    """Return the interfaces of the held parts with the tool in a compiled model."""
    found = []
    for name, place in placements(config).items():
        contacts = [patch for patch in patches(config) if patch.object == name and patch.law is not Law.FRICTION]
        counts = [len(patch.polygon) for patch in contacts]
        if contacts:
            points = np.vstack([patch.points for patch in contacts])
            normals = np.repeat([patch.axes[:, 2] for patch in contacts], counts, axis=0)
            rigid = np.repeat([patch.law is not Law.DRIVEN_PAD for patch in contacts], counts)
            found.append(Held(name, pose_sensor(model, name), place.position, place.rotation, points, normals, rigid))
    return tuple(found)


def _add_closing_force(finger: mujoco.MjsBody, force: float) -> None:
    """Press a finger along z into its part."""
    finger.add_joint(
        USUAL.default, name=finger.name, type=mujoco.mjtJoint.mjJNT_SLIDE, axis=[0.0, 0.0, 1.0], armature=ARMATURE,
        stiffness=[force / SPRING, 0.0, 0.0], springref=SPRING, limited=mujoco.mjtLimited.mjLIMITED_TRUE,
        range=[-STROKE, STROKE],
    )  # fmt: skip


def _add_vacuum(
    spec: mujoco.MjSpec, tool: mujoco.MjsBody, part: mujoco.MjsBody, place: Placement, patch: Patch, force: float
) -> None:
    """Pull a part along the axis of a cup, towards a point that is far inside the tool."""
    name = PREFIX + patch.name
    far = tool.add_site(USUAL.default, name=f"{name}_far", pos=patch.origin - SPRING * patch.axes[:, 2], rgba=UNSEEN)
    local = place.rotation.T @ (patch.origin - place.position)
    near = part.add_site(USUAL.default, name=f"{name}_near", pos=local, rgba=UNSEEN)
    pull = spec.add_tendon(
        USUAL.default, name=name, stiffness=[force / SPRING, 0.0, 0.0], springlength=[0.0, 0.0], rgba=UNSEEN
    )
    for site in (far, near):
        pull.wrap_site(site.name)


def _shrunk(patch: Patch, inset: float) -> Array:
    """Return the contact points in the plane of the patch, moved inwards by an inset [m], (k, 2)."""
    points = patch.polygon
    if patch.law is Law.SUCTION:
        return np.asarray(points * (1.0 - inset / np.linalg.norm(points, axis=1, keepdims=True)))
    return np.asarray(points - inset * np.sign(points))
