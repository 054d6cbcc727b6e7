"""Names of the limits that a certificate checks."""

from __future__ import annotations

from collections.abc import Sequence

from robustopt.config import Config
from robustopt.limits.names import LimitKind, LimitName
from robustopt.path import Stance
from robustopt.scene.patches import Law, Patch
from robustopt.scene.placement import TRAY, supports

TIMING = LimitName(LimitKind.TIMING, "timing")
"""Name of the limit that x and u are consistent and the robot is at rest at the start, at stops and at the end."""

IN_PLACE = LimitName(LimitKind.PLACE, "contacts")
"""Name of the limit that environment contacts stay in their places on the path."""


def object_system(config: Config, group: Sequence[str], patches: Sequence[Patch]) -> LimitName:
    """Return the name of the contact system of some objects, held by some patches."""
    below = {name: supports(config.objects[name]) for name in group}
    first, *others = [name for name in group if len(below[name]) > 1] or [""]
    if first:
        more = "".join(f" and balance of {name} on {' and '.join(below[name])}" for name in others)
        return LimitName(LimitKind.BALANCE, first, " and ".join(below[first]) + more)
    patch = patches[0]
    if patch.law in (Law.FRICTION, Law.SUCTION):
        return LimitName(LimitKind.CONTACT, patch.object, patch.support)
    return failure(LimitKind.GRIP, patch)


def stance_system(stance: Stance) -> LimitName:
    """Return the name of the contact system of the floating base in a stance."""
    alone = len(stance.contacts) == 1
    return LimitName(LimitKind.CONTACT, stance.contacts[0] if alone else stance.words)


def failure(kind: LimitKind, patch: Patch) -> LimitName:
    """Return the name of a limit of a single support, cup or gripper, in the words of its contact law.

    Args:
        kind: slip, tipping or twist.
        patch: the patch; of two pads, the driven one.
    """
    if patch.law is Law.FRICTION:
        return LimitName(kind, patch.object, patch.support)
    if patch.law is Law.SUCTION:
        return LimitName(LimitKind.PEEL if kind is LimitKind.TIPPING else kind, patch.object, patch.support)
    if kind is LimitKind.TWIST:
        return LimitName(kind, patch.object, patch.support)
    return LimitName(LimitKind.GRIP, patch.object, patch.support if patch.object == TRAY else "")
