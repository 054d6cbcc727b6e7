"""Places of the objects, each on its support or held by the tool.

All poses are in the carrier frame, which is rigid to the tool: the frame of the tray if there is one, else the frame of
the tool. An object that the tool holds is the *root* of all objects that stand on it, as the tray is for the others.
They stand upright on their root: their z axes are parallel to that of the root, and they may have a yaw about it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from robustopt.arrays import Array
from robustopt.config.model import Config
from robustopt.config.object_model import GripConfig, HoldConfig, ObjectConfig, TrayConfig
from robustopt.config.section import Pose
from robustopt.errors import ConfigError
from robustopt.geometry import rectangle, regular_polygon, rotation, rotation_rpy, yaw_matrix

TRAY = "tray"
"""Name of the tray as a support."""

X, Y, Z = np.eye(3)
FACES: dict[str, tuple[Array, Array, Array]] = {
    "top": (Z, X, Y),
    "bottom": (-Z, X, Y),
    "front": (X, Z, Y),
    "back": (-X, Z, Y),
    "left": (Y, Z, X),
    "right": (-Y, Z, X),
}
"""Outward normal of each face of a part, and the two axes along which `at` is measured, part frame."""


@dataclass(frozen=True, eq=False)
class Frame:
    """A frame, given in the carrier frame.

    Attributes:
        position: its origin (3,) [m].
        rotation: its axes as columns (3, 3).
    """

    position: Array
    rotation: Array

    def __matmul__(self, other: Frame) -> Frame:
        """Return the other frame, which is given in this one, in the carrier frame."""
        return Frame(self.position + self.rotation @ other.position, self.rotation @ other.rotation)


CARRIER = Frame(np.zeros(3), np.eye(3))


@dataclass(frozen=True, eq=False)
class Placement:
    """The place of an object.

    Attributes:
        position: centre of the object, carrier frame (3,) [m].
        rotation: axes of the object as columns, carrier frame (3, 3).
        half_height: half the extent of the object along its z axis [m].
        root: name of the tray or held object at the bottom of the stack; for a held object its own name.
        frame: frame of the root.
        planar: centre of the object in the frame of the root (3,) [m].
        yaw: rotation of the object about the z axis of the root [rad].
    """

    position: Array
    rotation: Array
    half_height: float
    root: str
    frame: Frame
    planar: Array
    yaw: float


def supports(body: ObjectConfig) -> tuple[str, ...]:
    """Return the names of the supports of an object: none for a held object, two for a bridge.

    Args:
        body: the object.
    """
    if body.on is None:
        return ()
    return (body.on,) if isinstance(body.on, str) else body.on


def half_height(body: ObjectConfig | TrayConfig) -> float:
    """Return half the extent of an object or the tray along its z axis [m].

    Args:
        body: the object or the tray.
    """
    height = body.size[2] if body.size is not None else getattr(body, "height", None)
    assert height is not None, "checked when the configuration was read"
    return 0.5 * float(height)


def half_extents(body: TrayConfig | ObjectConfig) -> Array:
    """Return half the extents of the tray or an object along its own axes, (3,) [m].

    Args:
        body: the tray or the object.
    """
    if body.size is not None:
        return 0.5 * np.array(body.size)
    radius = getattr(body, "radius", None)
    assert radius is not None, "checked when the configuration was read"
    return np.array([radius, radius, half_height(body)])


def standing_order(objects: Mapping[str, ObjectConfig]) -> tuple[str, ...]:
    """Return the names of the objects in an order in which each comes after its supports.

    Args:
        objects: the objects by name.

    Raises:
        ConfigError: the supports of an object lead neither to the tray nor to a held object.
    """
    order: list[str] = []
    while len(order) < len(objects):
        placed = {TRAY, *order}
        ready = [name for name, body in objects.items() if name not in placed and placed.issuperset(supports(body))]
        if not ready:
            left = ", ".join(name for name in objects if name not in placed)
            raise ConfigError(f"{left}: their supports lead neither to the tray nor to a held object", key="objects")
        order += ready
    return tuple(order)


Solids = tuple[tuple[str, ObjectConfig], ...]


def solids(config: Config) -> Solids:
    """Return the names and shapes of the objects, with standard masses and forces, which do not affect their places.

    Args:
        config: the configuration.
    """
    return tuple((name, _without_mass(body)) for name, body in config.objects.items())


@lru_cache(maxsize=64)
def _without_mass(body: ObjectConfig) -> ObjectConfig:
    plain: dict[str, object] = {"mass": 1.0, "center_of_mass": (0.0, 0.0, 0.0), "inertia": None}
    if body.held_by is not None:
        kind = "suction" if body.held_by.suction else "grip"
        tool = body.held_by.tool.model_copy(update={"force": 1.0})
        plain["held_by"] = body.held_by.model_copy(update={kind: tool})
    return body.model_copy(update=plain)


def placements(config: Config) -> dict[str, Placement]:
    """Return the place of each object by name; supports come before the objects that stand on them.

    Args:
        config: the configuration.

    Raises:
        ConfigError: the supports of an object lead neither to the tray nor to a held object.
    """
    return dict(placed(config.tray, solids(config)))


@lru_cache(maxsize=64)
def placed(tray: TrayConfig | None, solids: Solids) -> dict[str, Placement]:
    """Return the places of objects by name, cached; see `placements`.

    Args:
        tray: the tray, if there is one.
        solids: names and shapes of the objects.

    Raises:
        ConfigError: the supports of an object lead neither to the tray nor to a held object.
    """
    found, objects = {}, dict(solids)
    if tray is not None:
        found[TRAY] = Placement(np.zeros(3), np.eye(3), half_height(tray), TRAY, CARRIER, np.zeros(3), 0.0)
    for name in standing_order(objects):
        body = objects[name]
        if body.held_by is not None:
            found[name] = _held(name, body, tool_frame(tray))
        else:
            found[name] = _standing(body, [found[support] for support in supports(body)], found)
    found.pop(TRAY, None)
    return found


def _held(name: str, body: ObjectConfig, tool: Frame) -> Placement:
    frame = _held_frame(body, tool)
    return Placement(frame.position, frame.rotation, half_height(body), name, frame, np.zeros(3), 0.0)


def _standing(body: ObjectConfig, below: list[Placement], found: Mapping[str, Placement]) -> Placement:
    root, frame = below[0].root, below[0].frame
    planar, yaw = (below[0].planar, below[0].yaw) if len(below) == 1 else (np.zeros(3), 0.0)
    h = half_height(body)
    base = planar[:2] + rotation(yaw) @ np.array(body.at)
    centre = np.array([*base, below[0].planar[2] + below[0].half_height + h])
    turned = yaw_matrix(yaw + body.yaw)
    if root == TRAY:
        position = centre
    else:
        position, turned = frame.position + frame.rotation @ centre, frame.rotation @ turned
    for array in (position, turned):
        array.setflags(write=False)
    return Placement(position, turned, h, root, frame, centre, yaw + body.yaw)


def footprint(body: ObjectConfig, placement: Placement, points: int) -> Array:
    """Return the outline of an object, projected along the z axis of its root, root frame (k, 2) [m].

    Args:
        body: the object.
        placement: the place of the object.
        points: number of corners that stand for a round outline.
    """
    if body.size is not None:
        return rectangle(placement.planar, np.array(body.size), placement.yaw)
    assert body.radius is not None, "checked when the configuration was read"
    return regular_polygon(placement.planar, body.radius, points, placement.yaw)


# Held parts -----------------------------------------------------------------------------------------------


def tool_frame(tray: TrayConfig | None) -> Frame:
    """Return the frame of the tool in the carrier frame.

    Args:
        tray: the tray; without one the carrier frame is the tool frame.
    """
    if tray is None:
        return CARRIER
    pose = _pose(tray.pose)
    return Frame(-pose.rotation.T @ pose.position, pose.rotation.T)


def holding_frame(hold: HoldConfig, tool: Frame) -> Frame:
    """Return the frame of the plane of the cups, or of the centre between the pads, in the carrier frame.

    Its z axis points out of the tool, towards the part.

    Args:
        hold: the cups or the gripper.
        tool: frame of the tool in the carrier frame.
    """
    return tool @ _pose(hold.pose)


def _held_frame(body: ObjectConfig, tool: Frame) -> Frame:
    """Return the frame of a held object in the carrier frame, given the frame of the tool."""
    hold = _hold(body)
    return holding_frame(hold, tool) @ part_in_hold(body)


def part_in_hold(body: ObjectConfig) -> Frame:
    """Return the frame of a held object in the frame of its cups or of the centre between its pads.

    Args:
        body: the object; it must have `held_by`.
    """
    hold, extents = _hold(body), half_extents(body)
    normal, u, v = FACES[hold.face]
    towards = yaw_matrix(hold.yaw) @ np.stack([u, np.cross(-normal, u), -normal])
    point = normal * (extents @ np.abs(normal)) + hold.at[0] * u + hold.at[1] * v
    return Frame(np.array([0.0, 0.0, -_depth(body)]) - towards @ point, towards)


def _depth(body: ObjectConfig) -> float:
    """Return the depth of the origin of the holding frame inside the part [m]; 0 for cups."""
    hold = _hold(body)
    if not isinstance(hold, GripConfig):
        return 0.0
    return float(half_extents(body) @ np.abs(FACES[hold.face][0])) if hold.depth is None else hold.depth


def _hold(body: ObjectConfig) -> HoldConfig:
    assert body.held_by is not None
    return body.held_by.tool


def _pose(pose: Pose) -> Frame:
    return Frame(np.array(pose.position), rotation_rpy(pose.rpy))
