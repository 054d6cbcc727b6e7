"""Checks of the places of objects, on the tray or on an object that the tool holds."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from robustopt.arrays import Array
from robustopt.config.document import Finding, Key
from robustopt.config.model import Config
from robustopt.config.per_name import value_of
from robustopt.geometry import area, contains, rotation
from robustopt.scene.patches import Law, Patch, base_outline, eroded, overlaps, patches
from robustopt.scene.placement import TRAY, Placement, half_height, placements, solids, supports

LEVEL = 1e-6
"""Largest difference in height between the two supports of a bridge [m]; real ones differ by more (our choice)."""

OUTLINE_POINTS = 64
"""Corners of the outline of a round object in the search for overlaps: within 0.1 % of the radius."""


def check_scene(config: Config) -> Iterator[Finding]:
    """Yield the mistakes in the places of the objects.

    Args:
        config: the configuration; its shapes and supports must be valid.
    """
    uneven = list(_uneven_bridges(config))
    yield from uneven
    if uneven:
        return
    placed, contacts = placements(config), patches(config)
    standing = tuple(patch for patch in contacts if patch.law is Law.FRICTION)
    off = list(_off_support(config, placed, standing))
    yield from off
    if not off:
        yield from _tipping(config, placed, standing)
        yield from _contact_points(config, contacts)
    yield from _penetration(config)


def same_scene(config: Config, other: Config) -> bool:
    """Return whether two configurations share the sections that `check_scene` reads.

    Args:
        config: the one configuration.
        other: the other configuration.
    """
    return (
        all(config.__dict__[name] is other.__dict__[name] for name in ("tray", "objects", "path", "gravity"))
        and config.contact.patch_points == other.contact.patch_points
        and config.uncertainty.contact_points == other.uncertainty.contact_points
    )


def _uneven_bridges(config: Config) -> Iterator[Finding]:
    placed = placements(config)
    tops = {name: float(place.planar[2] + place.half_height) for name, place in placed.items()}
    roots = {name: place.root for name, place in placed.items()} | {TRAY: TRAY}
    if config.tray is not None:
        tops[TRAY] = half_height(config.tray)
    for name, body in config.objects.items():
        if len({roots[support] for support in supports(body)}) > 1:
            message = "one support stands on the tray, the other on a held object; expected both on the same"
            yield ("objects", name, "on"), message
            continue
        heights = [tops[support] for support in supports(body)]
        if heights and max(heights) - min(heights) > LEVEL:
            found = " and ".join(f"{h:g} m for {s}" for s, h in zip(supports(body), heights, strict=True))
            message = f"the tops of its supports are at {found}; expected two supports of the same height"
            yield ("objects", name, "on"), message


def _off_support(config: Config, placed: dict[str, Placement], contacts: tuple[Patch, ...]) -> Iterator[Finding]:
    for patch in contacts:
        if area(patch.polygon) > 0:
            continue
        if config.tray is not None and patch.support == TRAY:
            x, y = 0.5 * config.tray.size[0], 0.5 * config.tray.size[1]
            face = f"the tray, which reaches from {-x:g} to {x:g} m in x and from {-y:g} to {y:g} m in y"
        else:
            x, y = placed[patch.support].planar[:2]
            face = f"the upper face of {patch.support}, whose centre is at [{x:.4g}, {y:.4g}] m"
        x, y = placed[patch.object].planar[:2]
        root = placed[patch.object].root
        frame = "on the tray" if root == TRAY else f"in the frame of {root}"
        message = f"its base, with its centre at [{x:.4g}, {y:.4g}] m {frame}, is off {face}; expected an overlap"
        yield ("objects", patch.object, "at"), message


def _tipping(config: Config, placed: dict[str, Placement], contacts: tuple[Patch, ...]) -> Iterator[Finding]:
    """Yield the objects that would fall over on a level tray at rest, each together with everything that it carries."""
    if not _level(config):
        return
    for name in config.objects:
        carried = _carried(config, name)
        if carried is None or placed[name].root != TRAY:
            continue
        mass = np.array([config.objects[other].mass for other in carried])
        center = mass @ np.array([_center_of_mass(config, placed, other) for other in carried]) / mass.sum()
        polygon = base_outline(tuple(patch for patch in contacts if patch.object == name))
        if not contains(polygon, center):
            others = "" if len(carried) == 1 else f" with {', '.join(carried[1:])}"
            below = " and ".join(supports(config.objects[name]))
            message = (
                f"the centre of mass of {name}{others}, at [{center[0]:.4g}, {center[1]:.4g}] m on the tray, is not "
                f"above its contact with {below}, so it tips over at rest; expected it above the contact"
            )
            yield ("objects", name), message


def _level(config: Config) -> bool:
    """Return whether every pose of the tray is known to be level: a tray pose with no rotation but a yaw."""
    poses = config.path.tray_poses
    upright = config.gravity[:2] == (0.0, 0.0) and config.gravity[2] < 0
    return upright and poses is not None and all(p.quaternion is None and not any((p.rpy or (0, 0))[:2]) for p in poses)


def _carried(config: Config, name: str) -> list[str] | None:
    """Return an object and everything that it carries, or None if a bridge rests on it and on another object."""
    found = [name]
    for other in found:
        for above, body in config.objects.items():
            if other in supports(body) and above not in found:
                if len(supports(body)) > 1:
                    return None
                found.append(above)
    return found


def _center_of_mass(config: Config, placed: dict[str, Placement], name: str) -> Array:
    offset = np.array(config.objects[name].center_of_mass[:2])
    return np.asarray(placed[name].planar[:2] + rotation(placed[name].yaw) @ offset)


def _contact_points(config: Config, contacts: tuple[Patch, ...]) -> Iterator[Finding]:
    distance = config.uncertainty.contact_points
    for patch in contacts:
        names = (patch.name, patch.object)
        d = value_of(distance, names, 0.0)
        if d > 0 and len(eroded(patch, d).polygon) == 0:
            key: Key = ("uncertainty", "contact_points")
            message = (
                f"found {d:g} m, which leaves no certain part of the contact of {patch.object} on {patch.support}; "
                "expected less than half the size of the contact"
            )
            used = next((name for name in names if isinstance(distance, dict) and name in distance), "default")
            yield (*key, used) if isinstance(distance, dict) else key, message


def _penetration(config: Config) -> Iterator[Finding]:
    for first, second in overlaps(config.tray, solids(config), OUTLINE_POINTS):
        body = config.objects[second]
        held = None if body.held_by is None else "suction" if body.held_by.suction else "grip"
        place = "at" if held is None else f"held_by.{held}.pose"
        yield ("objects", second), f"it overlaps with {first}; expected another `{place}`, or another size"
