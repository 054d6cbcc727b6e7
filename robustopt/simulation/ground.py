"""The environment of a walking robot: a level floor, and a rail for a hand.

The contacts of the feet are those of the model file, a few spheres under each, with the actual friction of that foot. A
hand on a rail gets spheres at the corners of its contact patch, and the rail is a box that nothing else touches.
"""

from __future__ import annotations

import mujoco
import numpy as np

from robustopt.arrays import Array
from robustopt.config import FEET, Config, RailConfig
from robustopt.path.footsteps import footsteps
from robustopt.robot import Robot
from robustopt.robot.model_file import USUAL
from robustopt.scene.rail import rail_box
from robustopt.simulation.interfaces import Grounded, stands
from robustopt.simulation.parameters import Parameters, require_some_left
from robustopt.simulation.physics import PREFIX, quaternion

FLOOR, RAIL = PREFIX + "floor", PREFIX + "rail"

PALM_SPHERE = 0.01
"""Radius of the contact spheres of a hand [m]."""

SOLREF, SOLIMP = (0.005, 1.0), (0.95, 0.99, 0.001, 0.5, 2.0)
"""Stiffness of the contacts of a hand, equal to that of the feet of the shipped humanoid."""

FALLEN, ON_RAIL, ON_FLOOR = 1 << 20, 1 << 21, 1 << 22
"""Contact bits: of all geoms but the feet, which touch the floor only after a fall; of the hand on a rail; and of the
contact points of the feet, in place of the bits in the model file."""
OWN = FALLEN | ON_RAIL | ON_FLOOR
"""All of these bits; they are cleared on the geoms of the model file."""

CONTACT_FIELDS = (mujoco.mjtConDataField.mjCONDATA_FORCE, mujoco.mjtConDataField.mjCONDATA_TORQUE,
                  mujoco.mjtConDataField.mjCONDATA_POS)  # fmt: skip
NET_FORCE = 3
"""MuJoCo's number for the sum of all contact forces of a sensor."""


def add_ground(spec: mujoco.MjSpec, robot: Robot, rail: RailConfig | None) -> None:
    """Add floor and rail, which only the contacts of the robot touch, and other parts of it after a fall.

    Args:
        spec: specification of the world, which is changed.
        robot: the walking robot.
        rail: the rail, if there is one.
    """
    spec.worldbody.add_geom(
        USUAL.default, name=FLOOR, type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0.0, 0.0, 0.05], contype=0,
        conaffinity=ON_FLOOR | FALLEN,
    )  # fmt: skip
    _separate(spec)
    if rail is not None:
        _add_rail(spec, rail)
    for name, sole in robot.contacts.items():
        if name not in FEET:
            origin, axes = robot.site_frame(name)
            _add_palm(spec, name, origin + (sole.points + np.array([0.0, 0.0, PALM_SPHERE])) @ axes.T)
        for sphere in _spheres(spec, name):
            sphere.condim, sphere.priority = 3, 1
            if name in FEET:
                sphere.contype, sphere.conaffinity = ON_FLOOR, 0
        _add_sensors(spec, name, FLOOR if name in FEET else RAIL)


def set_contacts(spec: mujoco.MjSpec, robot: Robot, parameters: Parameters) -> None:
    """Give the contacts of a robot with its environment their actual friction and size.

    Args:
        spec: specification of the world, which is changed.
        robot: the robot.
        parameters: actual parameters.

    Raises:
        ConfigError: an inset leaves nothing of a contact.
    """
    for name in robot.contacts:
        if inset := parameters.inset.get(name, 0.0):
            _inset(spec, name, robot.site_frame(name)[1], inset)
        for sphere in _spheres(spec, name):
            sphere.friction = [parameters.friction[name], *sphere.friction[1:]]


def grounded(config: Config, robot: Robot, model: mujoco.MjModel) -> tuple[Grounded, ...]:
    """Return the interfaces of a robot with its environment.

    Args:
        config: the configuration.
        robot: the robot.
        model: compiled model of the world.
    """
    found = []
    for name, sole in robot.contacts.items():
        sensor, own = (
            int(model.sensor(f"{PREFIX}{name}_mjSENS_FRAMEPOS").adr[0]),
            stands(footsteps(config).stances, name),
        )
        found.append(Grounded(name, sensor, sole.points, own, leaves=name not in FEET))
    return tuple(found)


def _separate(spec: mujoco.MjSpec) -> None:
    """Clear the contact bits of this package on the robot, and let all but its feet touch the floor after a fall."""
    on_feet = {spec.site(foot).parent.name for foot in FEET}
    for geom in spec.geoms:
        on_foot = geom.parent.name in on_feet
        if geom.name != FLOOR and not (on_foot and geom.type == mujoco.mjtGeom.mjGEOM_SPHERE):
            geom.contype, geom.conaffinity = geom.contype & ~OWN, geom.conaffinity & ~OWN
            geom.contype |= 0 if on_foot else FALLEN


def _add_palm(spec: mujoco.MjSpec, hand: str, centers: Array) -> None:
    """Add the contact spheres of a hand, their centres (k, 3) in the frame of its body [m]."""
    for k, center in enumerate(centers):
        spec.site(hand).parent.add_geom(
            USUAL.default, name=f"{PREFIX}{hand}_{k}", type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[PALM_SPHERE, 0.0, 0.0],
            mass=0.0, pos=center, contype=ON_RAIL, conaffinity=0, solref=SOLREF, solimp=SOLIMP,
            rgba=(0.2, 0.2, 0.22, 1.0),
        )  # fmt: skip


def _add_rail(spec: mujoco.MjSpec, rail: RailConfig) -> None:
    middle, axes, half = rail_box(rail)
    spec.worldbody.add_geom(
        USUAL.default, name=RAIL, type=mujoco.mjtGeom.mjGEOM_BOX, size=half, pos=middle, quat=quaternion(axes),
        contype=0, conaffinity=ON_RAIL, rgba=(0.55, 0.5, 0.45, 1.0),
    )  # fmt: skip


def _spheres(spec: mujoco.MjSpec, contact: str) -> list[mujoco.MjsGeom]:
    """Find the spheres of a foot that can touch the floor, or of a hand that can touch its rail."""
    sphere = mujoco.mjtGeom.mjGEOM_SPHERE
    geoms = [geom for geom in spec.site(contact).parent.geoms if geom.type == sphere]
    return [geom for geom in geoms if (geom.contype | geom.conaffinity if contact in FEET else geom.contype & ON_RAIL)]


def _inset(spec: mujoco.MjSpec, contact: str, axes: Array, inset: float) -> None:
    """Move the contact points of a foot or hand inwards along x and y of its site, axes (3, 3) in its body."""
    spheres = _spheres(spec, contact)
    middle = np.mean([sphere.pos for sphere in spheres], axis=0)
    for sphere in spheres:
        away = (sphere.pos - middle) @ axes
        require_some_left(contact, inset, np.abs(away[:2]))
        sphere.pos = sphere.pos - axes @ (inset * np.append(np.sign(away[:2]), 0.0))


def _add_sensors(spec: mujoco.MjSpec, contact: str, ground: str) -> None:
    """Measure the pose of a foot or hand, and its force on the geom on which it rests."""
    kinds, objects = mujoco.mjtSensor, mujoco.mjtObj
    for kind in (kinds.mjSENS_FRAMEPOS, kinds.mjSENS_FRAMEQUAT):
        spec.add_sensor(name=f"{PREFIX}{contact}_{kind.name}", type=kind, objtype=objects.mjOBJ_SITE, objname=contact)
    fields = sum(1 << int(field) for field in CONTACT_FIELDS)
    spec.add_sensor(
        name=f"{PREFIX}{contact}_contact", type=kinds.mjSENS_CONTACT, objtype=objects.mjOBJ_BODY,
        objname=spec.site(contact).parent.name, reftype=objects.mjOBJ_GEOM, refname=ground,
        intprm=[fields, NET_FORCE, 1],
    )  # fmt: skip
