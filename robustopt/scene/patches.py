"""Contact patches: the flat areas at which an object touches its support, its suction cups or its pads."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import lru_cache
from itertools import combinations

import numpy as np

from robustopt.arrays import Array
from robustopt.config.model import Config
from robustopt.config.object_model import GripConfig, ObjectConfig, SuctionConfig, TrayConfig, contact_names
from robustopt.geometry import (
    apart,
    clip,
    contact_axes,
    convex_hull,
    erode,
    prism,
    rectangle,
    regular_polygon,
)
from robustopt.scene.placement import (
    TRAY,
    Frame,
    Placement,
    Solids,
    footprint,
    half_extents,
    half_height,
    holding_frame,
    part_in_hold,
    placed,
    solids,
    supports,
    tool_frame,
)


class Law(StrEnum):
    """The contact law of a patch; see `limits.cones`."""

    FRICTION = "friction"
    SUCTION = "suction"
    DRIVEN_PAD = "driven pad"
    FIXED_PAD = "fixed pad"


@dataclass(frozen=True, eq=False)
class Patch:
    """A flat contact between an object and its support.

    The contact points are `origin + axes[:, :2] @ p` for the corners p of the polygon.

    Attributes:
        name: name of the contact, by which its friction and contact points are given.
        object: name of the object that the contact presses on, along the normal.
        support: name of the tray, of the object below, or of the part of the tool: `cup`, `cups` or `pads`.
        polygon: corners in the plane of the patch, counter-clockwise (k, 2) [m].
        origin: origin of that plane, carrier frame (3,) [m].
        axes: axes of the patch as columns, carrier frame (3, 3); the normal comes last and points into the object.
        turn: yaw of the support in these axes; uncertain contact points are displaced along the support's axes [rad].
        law: contact law.
        fixed: whether the pressure under a twisting load is prescribed, see `limits.twist`.
    """

    name: str
    object: str
    support: str
    polygon: Array
    origin: Array
    axes: Array
    turn: float = 0.0
    law: Law = Law.FRICTION
    fixed: bool = False

    @property
    def points(self) -> Array:
        """Return the contact points, carrier frame (k, 3) [m]."""
        return np.asarray(self.origin + self.polygon @ self.axes[:, :2].T)


UPRIGHT = np.eye(3)
"""Axes of the patches of all objects that stand on the tray."""


def patches(config: Config, twisted: frozenset[str] = frozenset()) -> tuple[Patch, ...]:
    """Return the patch of every contact of the objects, in the order of `placements`; a bridge has two.

    Args:
        config: the configuration, whose objects and supports must be valid.
        twisted: objects whose pressure is prescribed by default, see `limits.turning`.
    """
    return _patches(config.tray, solids(config), config.contact.patch_points, twisted)


@lru_cache(maxsize=64)
def _patches(tray: TrayConfig | None, solids: Solids, points: int, twisted: frozenset[str]) -> tuple[Patch, ...]:
    objects, faces, yaws = dict(solids), dict[str, Array](), {TRAY: 0.0}
    if tray is not None:
        faces[TRAY] = rectangle(np.zeros(2), np.array(tray.size))
    found: list[Patch] = []
    for name, placement in placed(tray, solids).items():
        body = objects[name]
        faces[name] = footprint(body, placement, points)
        yaws[name] = placement.yaw
        if body.held_by is not None:
            found += held_patches(name, body, tool_frame(tray), points)
        for support in supports(body):
            polygon = clip(faces[name], faces[support])
            polygon.setflags(write=False)
            fixed = body.pressure == "fixed" or name in twisted
            found.append(_standing_patch(name, support, polygon, placement, yaws[support], fixed))
    return tuple(found)


def _standing_patch(name: str, support: str, polygon: Array, placement: Placement, turn: float, fixed: bool) -> Patch:
    foot = np.array([0.0, 0.0, float(placement.planar[2]) - placement.half_height])
    if placement.root == TRAY:
        return Patch(name, name, support, polygon, foot, UPRIGHT, turn, fixed=fixed)
    frame = placement.frame
    origin = frame.position + frame.rotation @ foot
    return Patch(name, name, support, polygon, origin, frame.rotation, turn, fixed=fixed)


def held_patches(name: str, body: ObjectConfig, tool: Frame, points: int) -> list[Patch]:
    """Return the patches of the cups or pads that hold an object.

    Args:
        name: name of the object.
        body: the object; it must have `held_by`.
        tool: frame of the tool in the carrier frame.
        points: number of contact points on the lip of a cup.
    """
    assert body.held_by is not None
    hold = body.held_by.tool
    frame = holding_frame(hold, tool)
    if isinstance(hold, GripConfig):
        return list(_pads(name, body, hold, frame))
    return list(_cups(name, body, hold, frame, points))


def _cups(name: str, body: ObjectConfig, hold: SuctionConfig, frame: Frame, points: int) -> Iterator[Patch]:
    support = "cup" if len(hold.cups) == 1 else "cups"
    for contact, cup in zip(contact_names(name, body), hold.cups, strict=True):
        lip = regular_polygon(np.zeros(2), cup.radius, points)
        origin = frame.position + frame.rotation @ np.array([*cup.at, 0.0])
        fixed = hold.pressure == "fixed"
        yield Patch(contact, name, support, lip, origin, frame.rotation, law=Law.SUCTION, fixed=fixed)


def _pads(name: str, body: ObjectConfig, hold: GripConfig, frame: Frame) -> Iterator[Patch]:
    """Yield the pad of the driven finger, which is on the positive side of the closing axis, then the fixed one."""
    closing, part = np.eye(3)[0 if hold.axis == "x" else 1], part_in_hold(body)
    half = float(half_extents(body) @ np.abs(part.rotation.T @ closing))
    across, along = hold.pad
    corners = rectangle(np.zeros(2), np.array([along, across]))
    for contact, side, law in zip(contact_names(name, body), (1.0, -1.0), (Law.DRIVEN_PAD, Law.FIXED_PAD), strict=True):
        axes = frame.rotation @ contact_axes(-side * closing, np.array([0.0, 0.0, 1.0]))
        middle = closing * (part.position @ closing + side * half)
        origin = frame.position + frame.rotation @ middle
        yield Patch(contact, name, "pads", corners, origin, axes, law=law, fixed=hold.pressure == "fixed")


@lru_cache(maxsize=256)
def eroded(patch: Patch, distance: float) -> Patch:
    """Return the part of a patch that is certain if its corners may be displaced along x and y of the support.

    Every displaced patch contains the eroded one, so the bound is sound. It is exact for a rectangle aligned with its
    support, because the eroded rectangle is itself one of the displaced patches (our choice).

    Args:
        patch: the patch.
        distance: largest displacement of each corner along x and along y [m].

    Returns:
        The patch with a smaller polygon, which is empty if no part is certain.
    """
    if distance == 0.0:
        return patch
    polygon = erode(patch.polygon, distance, patch.turn)
    polygon.setflags(write=False)
    return replace(patch, polygon=polygon)


@lru_cache(maxsize=64)
def base_outline(patches: tuple[Patch, ...]) -> Array:
    """Return the convex hull of several contact patches, in the plane of their root, (k, 2) [m].

    Args:
        patches: patches of objects with the same root.
    """
    return convex_hull(np.vstack([patch.polygon for patch in patches]))


@lru_cache(maxsize=64)
def overlaps(tray: TrayConfig | None, solids: Solids, points: int) -> tuple[tuple[str, str], ...]:
    """Return the pairs of objects that overlap, and of the tray and held objects.

    Args:
        tray: the tray, if there is one.
        solids: names and shapes of the objects.
        points: number of corners that stand for the outline of a round object.
    """
    objects = dict(solids)
    corners = {name: _corners(objects[name], place, points) for name, place in placed(tray, solids).items()}
    if tray is not None:
        corners = {TRAY: prism(rectangle(np.zeros(2), np.array(tray.size)), half_height(tray))} | corners
    standing = {name for name, body in objects.items() if TRAY in supports(body)}
    return tuple(
        (first, second)
        for first, second in combinations(corners, 2)
        if not (first == TRAY and second in standing) and not apart(corners[first], corners[second])
    )


def _corners(body: ObjectConfig, place: Placement, points: int) -> Array:
    """Return the corners of an object in the carrier frame (2 k, 3) [m]."""
    if body.size is not None:
        outline = rectangle(np.zeros(2), np.array(body.size))
    else:
        outline = regular_polygon(np.zeros(2), half_extents(body)[0], points)
    return np.asarray(place.position + prism(outline, place.half_height) @ place.rotation.T)
