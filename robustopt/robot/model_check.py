"""Check of a model file for numbers that no robot has, and for ranges that MuJoCo would drop.

MuJoCo's compiler finds some of these, and lets others pass: a range that is empty or not a number becomes no range, and
negative or infinite friction, armature or mass becomes a plan. Each is an error here that names joint, link and file.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from typing import Any

import mujoco
import numpy as np

from robustopt.errors import ConfigProblem, RobotError

Span = tuple[float, float]

AT_LEAST_ZERO = "a number of at least 0"
_JOINT = {"armature": "armature", "damping": "damping", "frictionloss": "dry friction", "stiffness": "stiffness"}
_BODY = {"mass": "mass", "inertia": "inertia"}
"""Attributes that must be finite and not negative, with their words."""

_PLACES: tuple[tuple[str, str, tuple[str, ...]], ...] = (
    ("joint", "joints", ("axis", "pos", "ref", "springref")),
    ("link", "bodies", ("pos", "quat", "gravcomp")),
    ("geom", "geoms", ("pos", "quat", "size", "density")),
    ("site", "sites", ("pos", "quat")),
    ("actuator", "actuators", ("gear", "gainprm", "biasprm")),
    ("tendon", "tendons", ("stiffness", "damping", "armature", "frictionloss")),
    ("equality constraint", "equalities", ("data",)),
)
"""Attributes that must be finite: the noun, the list of the specification, and the attributes."""

_NAMED = {
    "joint": "joints", "link": "bodies", "geom": "geoms", "site": "sites", "actuator": "actuators", "sensor": "sensors",
    "camera": "cameras", "frame": "frames", "mesh": "meshes", "material": "materials", "texture": "textures",
    "constraint": "equalities", "tendon": "tendons", "exclusion": "excludes", "pair": "pairs",
}  # fmt: skip
"""Parts with a name: the noun, and the list of the specification."""

RESERVED = "robustopt_"
"""Beginning of the names of all parts that this package adds to a model."""

_RANGED = {mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE}


def check_model(spec: mujoco.MjSpec, file: str) -> None:
    """Check the numbers of a specification before it is compiled.

    Args:
        spec: the specification, whose joints and bodies have names.
        file: the model file, for messages.

    Raises:
        RobotError: the specification has numbers that are not finite, negative where this is impossible, or ranges
            whose ends are out of order; the error lists all of them.
    """
    findings = [*_reserved(spec), *_negative(spec), *_not_finite(spec), *_ranges(spec)]
    if findings:
        raise RobotError([ConfigProblem("robot.model", f"{file}: {finding}") for finding in findings])


def require_room(spec: mujoco.MjSpec, written: Mapping[str, Span], replaced: Collection[str], file: str) -> None:
    """Check that every joint that the path may move can move.

    MuJoCo takes a range from a value to itself for no range. Here it is the limit that it says: it leaves the joint no
    room, and no path through it can be planned.

    Args:
        spec: the specification.
        written: ranges as in a URDF file by joint name, in place of those of the specification.
        replaced: joints that are locked, or whose range the configuration gives.
        file: the model file, for messages.

    Raises:
        RobotError: the range of a joint leaves it no room.
    """
    still = {
        joint.name: span
        for joint in spec.joints
        if joint.name not in replaced and (span := written.get(joint.name, _span(joint))) and span[0] == span[1]
    }
    if still:
        raise RobotError(
            [
                ConfigProblem(
                    "robot.model",
                    f"{file}: joint {name}: range from {low:g} to {high:g}, which leaves it no room; expected lower "
                    f"below upper; or lock the joint (robot.locked: {{{name}: ...}}), or give its range "
                    f"(robot.limits.{name}: {{position: [-.inf, .inf]}} for none)",
                )
                for name, (low, high) in still.items()
            ]
        )


def _span(joint: Any) -> Span | None:
    """Return the range of a hinge or slide; None without one: MJCF writes 0 0 for none."""
    low, high = map(float, joint.range)
    without = joint.limited == mujoco.mjtLimited.mjLIMITED_FALSE or low == high == 0.0
    return None if without or joint.type not in _RANGED else (low, high)


def _reserved(spec: mujoco.MjSpec) -> Iterator[str]:
    """Yield names of parts that begin as those of the parts that this package adds."""
    for noun, items in _NAMED.items():
        for item in getattr(spec, items):
            if item.name.startswith(RESERVED):
                yield f"{noun} {item.name}: names that begin with {RESERVED} are reserved; expected another name"


def _negative(spec: mujoco.MjSpec) -> Iterator[str]:
    for noun, items, attributes in (("joint", spec.joints, _JOINT), ("link", spec.bodies[1:], _BODY)):
        for item in items:
            for attribute, words in attributes.items():
                yield from _unless(noun, item.name, words, getattr(item, attribute), AT_LEAST_ZERO)


def _unless(noun: str, name: str, words: str, value: Any, expected: str) -> Iterator[str]:
    numbers = np.atleast_1d(np.asarray(value, dtype=float))
    wrong = ~np.isfinite(numbers)
    if expected == AT_LEAST_ZERO:
        wrong |= numbers < 0
    if wrong.any():
        yield f"{noun} {name}: {words} is {numbers[wrong][0]:g}; expected {expected}"


def _not_finite(spec: mujoco.MjSpec) -> Iterator[str]:
    for noun, items, attributes in _PLACES:
        for item in getattr(spec, items):
            for attribute in attributes:
                yield from _unless(noun, _called(item), attribute, getattr(item, attribute), "finite numbers")
    for body in spec.bodies[1:]:
        if body.explicitinertial:
            yield from _unless("link", body.name, "centre of mass", body.ipos, "finite numbers")


def _called(item: Any) -> str:
    """Return the name of a part, or of what it belongs to: geoms, sites and actuators need no name."""
    owner = getattr(getattr(item, "parent", None), "name", "") or getattr(item, "target", "")
    return item.name or (f"of {owner}" if owner else "without a name")


def _ranges(spec: mujoco.MjSpec) -> Iterator[str]:
    """Yield ranges whose lower end lies above the upper one, and force ranges that do not contain 0 in between."""
    for joint in spec.joints:
        span = _span(joint)
        if span and not (span[0] <= span[1] and span[0] < np.inf and span[1] > -np.inf):
            yield f"joint {joint.name}: range from {span[0]:g} to {span[1]:g}; expected the lower end first"
        yield from _around_zero("joint", joint.name, "force range", joint.actfrclimited, joint.actfrcrange)
    for actuator in spec.actuators:
        name = _called(actuator)
        yield from _around_zero("actuator", name, "force range", actuator.forcelimited, actuator.forcerange)
        yield from _around_zero(
            "actuator", name, "control range", actuator.ctrllimited, actuator.ctrlrange, any_sign=True
        )


def _around_zero(noun: str, name: str, words: str, limited: Any, span: Any, any_sign: bool = False) -> Iterator[str]:
    low, high = map(float, span)
    if limited == mujoco.mjtLimited.mjLIMITED_FALSE or low == high == 0.0:
        return
    if not (low < high if any_sign else low <= 0 <= high and low < high):
        expected = "the lower end first" if any_sign else "a range with 0 inside"
        yield f"{noun} {name}: {words} from {low:g} to {high:g}; expected {expected}"
