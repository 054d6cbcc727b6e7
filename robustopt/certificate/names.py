"""Names of limits, systems and contacts, in the words of the configuration."""

from __future__ import annotations

from collections.abc import Sequence

from robustopt.config import Config
from robustopt.path import Stance
from robustopt.scene.patches import Law, Patch
from robustopt.scene.placement import supports

TIMING = "timing"
"""Name of the limit that x and u belong together and the robot starts, stops and ends at rest."""

IN_PLACE = "contacts in place"
"""Name of the limit that environment contacts rest where the path has them."""


def joint_limit(joint: str, kind: str) -> str:
    """Return the name of a limit of a joint: position, velocity, acceleration or torque."""
    return f"{joint} {kind}"


def contact_name(patch: Patch) -> str:
    """Return the name of a contact among parameters: of the two bodies, or its own if a tool holds the object."""
    return f"{patch.object} on {patch.support}" if patch.law is Law.FRICTION else patch.name


def object_system(config: Config, group: Sequence[str], patches: Sequence[Patch]) -> str:
    """Return the name of the contact system of some objects."""
    if len(group) == 1:
        return f"contact of {_where(patches)}"
    bridges = [name for name in group if len(supports(config.objects[name])) > 1]
    return " and ".join(f"balance of {name} on {' and '.join(supports(config.objects[name]))}" for name in bridges)


def stance_system(stance: Stance) -> str:
    """Return the name of the contact system of the floating base in a stance."""
    alone = len(stance.contacts) == 1
    return f"contact of {stance.contacts[0] if alone else stance.words}"


def failure(kind: str, patches: Sequence[Patch]) -> str:
    """Return the name of a limit of a single support or hold: slip, tipping or twist."""
    over = "over" if kind == "tipping" and patches[0].law is Law.FRICTION else "on"
    return f"{kind} of {_where(patches, over)}"


def _where(patches: Sequence[Patch], on: str = "on") -> str:
    patch = patches[0]
    if patch.law is Law.FRICTION:
        return f"{patch.object} {on} {patch.support}"
    if patch.law is Law.SUCTION:
        return f"{patch.object} on {'its cup' if len(patches) == 1 else 'its cups'}"
    return f"{patch.object} in its grip"
