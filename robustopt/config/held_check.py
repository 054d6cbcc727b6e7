"""Checks of objects that suction cups or a gripper hold."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations

import numpy as np

from robustopt.arrays import Array
from robustopt.config.document import Finding, Key
from robustopt.config.object_model import GripConfig, HoldConfig, ObjectConfig, SuctionConfig
from robustopt.geometry import RESOLUTION
from robustopt.scene.placement import FACES, half_extents, part_in_hold


def check_held(name: str, body: ObjectConfig) -> Iterator[Finding]:
    """Yield the mistakes in the cups or the gripper that hold an object.

    Args:
        name: name of the object.
        body: the object.
    """
    key: Key = ("objects", name)
    if body.held_by is None:
        return
    if body.on is not None:
        yield (*key, "on"), "not allowed with held_by: an object either stands on a support or is held"
        return
    given = [kind for kind in ("suction", "grip") if getattr(body.held_by, kind) is not None]
    if len(given) != 1:
        found = "both suction and grip" if given else "neither suction nor grip"
        yield (*key, "held_by"), f"found {found}; expected one of them"
        return
    hold = body.held_by.tool
    inner: Key = (*key, "held_by", given[0])
    if isinstance(hold.force, tuple) and hold.force[0] > hold.force[1]:
        low, high = hold.force
        yield (*inner, "force"), f"found [{low:g}, {high:g}]; expected the lowest value first: [{high:g}, {low:g}]"
    if any(body.at) or body.yaw:
        yield (*key, "at" if any(body.at) else "yaw"), f"not allowed with held_by; expected it in held_by.{given[0]}"
    if body.pressure is not None:
        yield (*key, "pressure"), f"not allowed with held_by; expected it in held_by.{given[0]}"
    if body.shape == "cylinder" and (hold.face not in ("top", "bottom") or isinstance(hold, GripConfig)):
        found = "a gripper" if isinstance(hold, GripConfig) else f"the face {hold.face}"
        yield inner, f"found {found} on a cylinder; expected cups on its top or bottom, which are flat"
        return
    yield from _cups(inner, body, hold) if isinstance(hold, SuctionConfig) else _pads(inner, body, hold)


def _cups(key: Key, body: ObjectConfig, hold: SuctionConfig) -> Iterator[Finding]:
    if not hold.cups:
        yield (*key, "cups"), "found no cups; expected at least one, such as {at: [0, 0], radius: 0.02}"
    part = part_in_hold(body)
    for j, k in combinations(range(len(hold.cups)), 2):
        first, second = hold.cups[j], hold.cups[k]
        overlap = first.radius + second.radius - float(np.hypot(*np.subtract(first.at, second.at)))
        if overlap > RESOLUTION:
            message = f"the lip overlaps that of cups[{j}] by {1000 * overlap:.3g} mm; expected lips apart"
            yield (*key, "cups", k), message
    for k, cup in enumerate(hold.cups):
        inside = part.rotation.T @ (np.array([*cup.at, 0.0]) - part.position)
        beyond = _beyond(body, hold, inside, cup.radius)
        if beyond > RESOLUTION:
            place = ", ".join(f"{value:.4g}" for value in cup.at)
            yield (
                (*key, "cups", k),
                f"the lip at [{place}] m reaches {1000 * beyond:.3g} mm beyond the {hold.face} face of the part; "
                f"expected all of it on the face, {_face(body, hold)}",
            )


def _face(body: ObjectConfig, hold: HoldConfig) -> str:
    """Return the size of the face that points to the tool, in words."""
    if body.radius is not None:
        return f"whose radius is {body.radius:g} m"
    extents = 2.0 * half_extents(body)
    sides = [f"{extents @ np.abs(axis):g} m along {'xyz'[int(np.argmax(axis))]}" for axis in FACES[hold.face][1:]]
    return f"which is {' and '.join(sides)} of the part"


def _beyond(body: ObjectConfig, hold: HoldConfig, centre: Array, radius: float) -> float:
    """Return the distance by which a lip reaches beyond its face [m]; its centre (3,) is given in the part frame."""
    if body.radius is not None:
        return float(np.hypot(*centre[:2])) + radius - body.radius
    _, u, v = FACES[hold.face]
    extents = half_extents(body)
    return max(float(abs(centre @ axis) + radius - extents @ np.abs(axis)) for axis in (u, v))


def _pads(key: Key, body: ObjectConfig, hold: GripConfig) -> Iterator[Finding]:
    part = part_in_hold(body)
    closing = part.rotation.T @ np.eye(3)[0 if hold.axis == "x" else 1]
    if np.abs(closing).max() < 1.0 - RESOLUTION:
        message = f"found {hold.yaw:g} rad, which leaves no flat face at the pads; expected a multiple of pi / 2"
        yield (*key, "yaw"), message
        return
    extents, centre = half_extents(body), part.rotation.T @ -part.position
    across = part.rotation.T @ np.eye(3)[1 if hold.axis == "x" else 0]
    along = part.rotation.T @ np.array([0.0, 0.0, 1.0])
    for axis, size in ((across, hold.pad[0]), (along, hold.pad[1])):
        room = float(extents @ np.abs(axis))
        beyond = abs(float(centre @ axis)) + 0.5 * size - room
        if beyond > RESOLUTION:
            yield (
                (*key, "pad"),
                f"a pad of {size:g} m reaches {1000 * beyond:.3g} mm beyond the part, which is {2 * room:g} m wide "
                "there; expected pads that lie on the part",
            )
