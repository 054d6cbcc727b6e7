"""The carrier and the objects in the simulated world: shapes, contacts and measured poses."""

from __future__ import annotations

from itertools import combinations

import mujoco
import numpy as np

from robustopt.arrays import Array
from robustopt.config import Config, ObjectConfig
from robustopt.config.object_model import contact_names
from robustopt.geometry import RESOLUTION, rotation
from robustopt.robot.model_file import USUAL
from robustopt.robot.preparation import CARRIER_SITE
from robustopt.scene.placement import CARRIER as CARRIER_FRAME
from robustopt.scene.placement import TRAY, Placement, half_height, placements, supports
from robustopt.simulation.interfaces import Standing
from robustopt.simulation.parameters import Parameters
from robustopt.simulation.physics import PREFIX, add_contact, quaternion, set_inertia

CARRIER = PREFIX + "carrier"
"""Body of the tray, or of the cups and pads if there is no tray; its frame is the carrier frame."""

ROUND_CORNERS = 16
"""Number of corners of the regular polygon as which MuJoCo treats a round face; up to four of them touch at a time."""

ROUND_GROWTH = 1.009
"""Factor by which the two polygons that represent a round base, rotated relative to each other, are widened. It makes
up for half the distance between their 32 corners and the circle, and for the loss as the load spreads over several
corners (measured in tests/test_fidelity.py)."""

PASSIVE = {"default": USUAL.default, "contype": 0, "conaffinity": 0}
HIDDEN = (0.0, 0.0, 0.0, 0.0)
_COLOURS = ((0.85, 0.45, 0.25), (0.25, 0.5, 0.85), (0.35, 0.65, 0.35), (0.8, 0.7, 0.3))


def add_carrier(spec: mujoco.MjSpec, config: Config, parameters: Parameters, compensated: float) -> mujoco.MjsBody:
    """Add the tray at the carrier frame, or a massless body without one; a tray that several hands hold is free.

    Args:
        spec: specification of the world, which is changed.
        config: the configuration.
        parameters: actual parameters.
        compensated: fraction of the tray's weight that the controller compensates.
    """
    if config.tray is not None and config.tray.hands is not None:
        body = spec.worldbody.add_body(name=CARRIER)
        body.add_freejoint(name=PREFIX + TRAY)
    else:
        site = spec.site(CARRIER_SITE)
        body = site.parent.add_body(name=CARRIER, pos=site.pos, quat=site.quat)
    if config.tray is not None:
        set_inertia(body, parameters.bodies[TRAY])
        body.gravcomp = compensated
        size, box = np.array(config.tray.size) / 2, mujoco.mjtGeom.mjGEOM_BOX
        body.add_geom(name=PREFIX + TRAY, type=box, size=size, rgba=(0.3, 0.3, 0.35, 1.0), **PASSIVE)
    return body


def add_object(
    parent: mujoco.MjsBody, config: Config, name: str, parameters: Parameters, position: Array, orientation: Array
) -> mujoco.MjsBody:
    """Add an object with its visible shape and with hidden shapes for its contacts.

    Args:
        parent: body to which the object is added.
        config: the configuration.
        name: name of the object.
        parameters: actual parameters.
        position: position in the frame of the parent (3,) [m].
        orientation: orientation in the frame of the parent, a quaternion (4,).
    """
    shape = config.objects[name]
    body = parent.add_body(name=PREFIX + name, pos=position, quat=orientation)
    set_inertia(body, parameters.bodies[name])
    colour = _COLOURS[list(config.objects).index(name) % len(_COLOURS)]
    body.add_geom(name=PREFIX + name, rgba=(*colour, 1.0), **_shape(shape, 0.0), **PASSIVE)
    for base, turn in _bases(name, shape).items():
        size = _shape(shape, parameters.inset.get(name, 0.0), ROUND_GROWTH)
        body.add_geom(name=base, quat=_yaw_quaternion(turn), rgba=HIDDEN, **size, **PASSIVE)
    if shape.radius is not None:
        wide = _shape(shape, 0.0, ROUND_GROWTH / np.cos(np.pi / ROUND_CORNERS))
        body.add_geom(name=_top(name), rgba=HIDDEN, **wide, **PASSIVE)
    return body


def add_contacts(spec: mujoco.MjSpec, config: Config, parameters: Parameters) -> None:
    """Let the base of each object touch its supports, and the shapes of other pairs of objects touch each other.

    Args:
        spec: specification of the world, which is changed.
        config: the configuration.
        parameters: actual parameters.
    """
    placed = placements(config)
    names = (*placed,) if config.tray is None else (TRAY, *placed)
    for lower, upper in combinations(names, 2):
        resting = lower in supports(config.objects[upper])
        friction = _friction(config, parameters, upper)
        if not resting:
            friction = max(friction, _friction(config, parameters, lower))
        ones = _bases(upper, config.objects[upper]) if resting else [PREFIX + upper]
        within = resting and lower != TRAY and _stands_within(config, placed, upper, lower)
        for one in ones:
            add_contact(spec, one, _top(lower) if within else PREFIX + lower, friction)


def add_pose_sensors(spec: mujoco.MjSpec, config: Config) -> None:
    """Add sensors for the pose of each object in the frames of its supports.

    Args:
        spec: specification of the world, which is changed.
        config: the configuration.
    """
    for name in placements(config):
        for support in supports(config.objects[name]):
            add_pose_sensor(spec, name, PREFIX + name, body_name(support))


def add_pose_sensor(spec: mujoco.MjSpec, name: str, body: str, frame: str) -> None:
    """Add a sensor for the pose of a body in the frame of another one.

    Args:
        spec: specification of the world, which is changed.
        name: name of the interface between the bodies.
        body: name of the body.
        frame: name of the other body.
    """
    kinds, body_frame = mujoco.mjtSensor, mujoco.mjtObj.mjOBJ_XBODY
    for kind in (kinds.mjSENS_FRAMEPOS, kinds.mjSENS_FRAMEQUAT):
        spec.add_sensor(
            name=f"{PREFIX}{name}_{frame}_{kind.name}", type=kind, objtype=body_frame, objname=body,
            reftype=body_frame, refname=frame,
        )  # fmt: skip


def pose_sensor(model: mujoco.MjModel, name: str, frame: str) -> int:
    """Return the index in the sensor data of a pose that `add_pose_sensor` measures.

    Args:
        model: compiled model of the world.
        name: name of the interface between the bodies.
        frame: name of the other body.
    """
    return int(model.sensor(f"{PREFIX}{name}_{frame}_mjSENS_FRAMEPOS").adr[0])


def body_name(name: str) -> str:
    """Return the name of the body of an object, or of the tray.

    Args:
        name: name of the object, or `tray`.
    """
    return CARRIER if name == TRAY else PREFIX + name


def standing(config: Config, model: mujoco.MjModel) -> tuple[Standing, ...]:
    """Return the interfaces of the objects with their supports.

    Args:
        config: the configuration.
        model: compiled model of the world.
    """
    tray = 0.0 if config.tray is None else half_height(config.tray)
    level = Placement(np.zeros(3), np.eye(3), tray, TRAY, CARRIER_FRAME, np.zeros(3), 0.0)
    placed, found = {TRAY: level, **placements(config)}, []
    for name in placements(config):
        shape = config.objects[name]
        for support in supports(shape):
            upper, lower, sensor = placed[name], placed[support], pose_sensor(model, name, body_name(support))
            step, corners = upper.planar - lower.planar, _base_corners(shape)
            position, yaw = np.r_[rotation(-lower.yaw) @ step[:2], step[2]], upper.yaw - lower.yaw
            found.append(Standing(name, support, sensor, position, yaw, corners, shape.radius, lower.half_height))
    return tuple(found)


def orientation(placement: Placement) -> Array:
    """Return the orientation of an object in the carrier frame, a quaternion (4,).

    Args:
        placement: the place of the object.
    """
    found = np.zeros(4)
    mujoco.mju_mulQuat(found, quaternion(placement.frame.rotation), _yaw_quaternion(placement.yaw))
    return found


def _yaw_quaternion(yaw: float) -> Array:
    """Return the quaternion (4,) of a rotation about z [rad]."""
    return np.array([np.cos(yaw / 2), 0.0, 0.0, np.sin(yaw / 2)])


def _friction(config: Config, parameters: Parameters, name: str) -> float:
    """Return the friction of a body in contact with bodies other than its supports; 0 for the tray."""
    return 0.0 if name == TRAY else parameters.friction[contact_names(name, config.objects[name])[0]]


def _stands_within(config: Config, placed: dict[str, Placement], upper: str, lower: str) -> bool:
    """Check whether an object stands within the face of a round one, whose polygon then must not bound the contact."""
    radius, shape = config.objects[lower].radius, config.objects[upper]
    if radius is None:
        return False
    step = placed[upper].planar - placed[lower].planar
    reach = shape.radius if shape.radius is not None else 0.5 * np.hypot(*np.array(shape.size)[:2])
    return bool(np.hypot(*step[:2]) + reach <= radius + RESOLUTION)


def _bases(name: str, shape: ObjectConfig) -> dict[str, float]:
    """Return the names of the geoms on which an object stands, and the angle by which each is turned [rad]."""
    base = {f"{PREFIX}{name}_base": 0.0}
    return base if shape.radius is None else base | {f"{PREFIX}{name}_turned": np.pi / ROUND_CORNERS}


def _top(name: str) -> str:
    return f"{PREFIX}{name}_top"


def _shape(shape: ObjectConfig, inset: float, growth: float = 1.0) -> dict[str, object]:
    """Return type and size of a geom that is smaller by an inset on every side; a round one is wider by a factor."""
    h = half_height(shape)
    if shape.size is not None:
        return {"type": mujoco.mjtGeom.mjGEOM_BOX, "size": [shape.size[0] / 2 - inset, shape.size[1] / 2 - inset, h]}
    assert shape.radius is not None, "checked when the configuration was read"
    return {"type": mujoco.mjtGeom.mjGEOM_CYLINDER, "size": [growth * (shape.radius - inset), h, 0.0]}


def _base_corners(shape: ObjectConfig) -> Array:
    """Return the points of the base whose movement is slip, (k, 3): corners of a box, the centre of a round base."""
    h = half_height(shape)
    if shape.size is None:
        return np.array([[0.0, 0.0, -h]])
    x, y = shape.size[0] / 2, shape.size[1] / 2
    return np.array([[sx * x, sy * y, -h] for sx in (-1, 1) for sy in (-1, 1)])
