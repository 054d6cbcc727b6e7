"""Checks of the relations between the keys of a configuration."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from robustopt.config.document import Finding, Key, split_key
from robustopt.config.held_check import check_held
from robustopt.config.model import Config
from robustopt.config.object_model import ObjectConfig, TrayConfig, contact_names
from robustopt.config.path_check import check_path
from robustopt.config.per_name import value_of
from robustopt.config.scene_check import check_scene, same_scene
from robustopt.config.step_check import check_steps
from robustopt.config.words import did_you_mean
from robustopt.scene.placement import TRAY, half_extents, supports

OUTSIDE = 1e-9
"""Distance from a shape below which a centre of mass counts as within it: a rounding error [m]."""


def check(config: Config, names: Collection[str] | None = None, like: Config | None = None) -> Iterator[Finding]:
    """Yield all mistakes in the relations between the keys of a configuration.

    Args:
        config: the configuration.
        names: names of all objects in the document; default: the objects of `config`. `config` lacks objects that have
            mistakes of their own; the scene as a whole is then not checked.
        like: a configuration without mistakes. Its path and scene are not checked again if `config` shares them.
    """
    names = tuple(config.objects) if names is None else names
    yield from _names(config, names)
    yield from check_steps(config)
    if like is None or config.path is not like.path:
        yield from check_path(config)
    yield from _solver(config)
    shapes = [finding for name, body in config.objects.items() for finding in _shape(("objects", name), body)]
    yield from shapes or _realizable(config)
    for name, body in config.objects.items():
        yield from _inertia(("objects", name, "inertia"), body)
    if config.tray is not None:
        yield from _inertia(("tray", "inertia"), config.tray)
    yield from _intervals(config)
    yield from _references(config, names)
    held = [] if shapes else [finding for item in config.objects.items() for finding in check_held(*item)]
    yield from held
    standing = [*_standing(config, names), *_without_tray(config)]
    yield from standing
    whole = set(names) == set(config.objects) and not held and not standing
    known = like is not None and same_scene(config, like)
    if whole and not known and not shapes:
        yield from check_scene(config)


def _without_tray(config: Config) -> Iterator[Finding]:
    """Yield a missing tray that an object or the path needs, and hands and tool poses that do not suit a tray."""
    needed = [name for name, body in config.objects.items() if TRAY in supports(body) and body.held_by is None]
    fields = ", ".join(TrayConfig.model_fields)
    if config.tray is None and (needed or config.path.tray_poses is not None):
        reason = f"{needed[0]} stands on it" if needed else "path.tray_poses is given"
        remedy = "held_by for an object that the tool holds" if needed else "path.tool_poses"
        yield ("tray",), f"missing, but {reason}; expected a section with the keys {fields}, or {remedy}"
    hands, tools = None if config.tray is None else config.tray.hands, config.robot.tools
    if hands is not None and len(tools) < 2:
        yield ("tray", "hands"), f"found hands, but one tool, {tools[0]}; expected robot.tool to list hands"
    if hands is None and len(tools) > 1:
        missing = "tray" if config.tray is None else "tray.hands"
        yield ("robot", "tool"), f"found {' and '.join(tools)}, but {missing} is missing; expected it, or one tool"
    if config.tray is not None and config.path.tool_poses is not None:
        yield ("path", "tool_poses"), "not allowed with a tray; expected tray_poses, the poses of the tray's centre"


# Names ----------------------------------------------------------------------------------------------------


def _names(config: Config, names: Collection[str]) -> Iterator[Finding]:
    if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9._-]{0,99}", config.name):
        message = f"found {config.name!r}; expected letters, digits, `.`, `_` and `-`, as it names the results folder"
        yield ("name",), message
    for name in names:
        if name in (TRAY, "default"):
            yield ("objects", name), f"an object cannot be called {name}, a reserved name; expected another name"
        elif not re.fullmatch(r"[A-Za-z_][A-Za-z0-9_-]*", name):
            yield ("objects", name), f"found {name!r}; expected a name of letters, digits, `_` and `-`"
        elif name in config.environment_contacts or any(
            name in contact_names(other, body) for other, body in config.objects.items() if other != name
        ):
            yield ("objects", name), f"a contact is already called {name}; expected another name"


def _unknown(name: str, valid: Collection[str]) -> str:
    known = ", ".join(valid) or "no name, as there are no objects"
    return f"nothing is called {name}; {did_you_mean(name, valid)}expected one of {known}"


_BY_CONTACT = (
    "contact.friction", "uncertainty.friction", "uncertainty.contact_points", "execution.truth.friction",
    "execution.truth.variation.friction",
)  # fmt: skip
_BY_HELD_BODY = ("execution.truth.force", "execution.truth.variation.force")
_BY_BODY = (
    "uncertainty.mass", "uncertainty.center_of_mass", "execution.truth.mass", "execution.truth.center_of_mass",
    "execution.truth.inertia", "execution.truth.variation.mass", "execution.truth.variation.center_of_mass",
)  # fmt: skip
"""Keys whose values can be given by the name of a contact, of a held object or tray, or of any body."""


def _references(config: Config, names: Collection[str]) -> Iterator[Finding]:
    """Yield unknown names."""
    contacts = tuple(dict.fromkeys([*config.contact_owners, *config.contact_owners.values(), *names]))
    held = [name for name, body in config.objects.items() if body.held_by is not None]
    held += [TRAY] if config.tray is not None and config.tray.hands is not None else []
    yield from _unknown_names(config, ("execution.truth.contact_inset",), contacts)
    yield from _unknown_names(config, _BY_HELD_BODY, held)
    yield from _unknown_names(config, _BY_CONTACT, (*contacts, "default"))
    yield from _contacts_without_friction(config, names)
    if config.path.steps is None:  # with steps a name may be a body of the robot, whose model is not read yet
        bodies = (TRAY, *names)
        on = config.execution.disturbance.on if config.execution is not None else None
        if on is not None and on not in bodies:
            yield ("execution", "disturbance", "on"), _unknown(on, bodies)
        yield from _unknown_names(config, _BY_BODY, bodies)
    yield from _unknown_names(config, ("uncertainty.inertia",), (TRAY, *names))


def _unknown_names(config: Config, keys: Sequence[str], valid: Collection[str]) -> Iterator[Finding]:
    """Yield the names in the values at some keys that are none of the valid ones."""
    for key in map(split_key, keys):
        values: Any = config
        for part in key:
            values = getattr(values, str(part), None)
        for name in values if isinstance(values, Mapping) else ():
            if name not in valid:
                yield (*key, name), _unknown(name, valid)


def _contacts_without_friction(config: Config, names: Collection[str]) -> Iterator[Finding]:
    friction = config.contact.friction
    if isinstance(friction, Mapping) and "default" not in friction:
        known = {**dict.fromkeys(names, ""), **config.contact_owners}
        objects = set(config.contact_owners.values()) - set(config.contact_owners)
        missing = [name for name, owner in known.items() if name not in friction and owner not in friction]
        if missing := [name for name in missing if name not in objects]:
            message = f"no value for {', '.join(missing)}; expected one for each object or contact, or `default`"
            yield ("contact", "friction"), message


# Path and solver ------------------------------------------------------------------------------------------


def _solver(config: Config) -> Iterator[Finding]:
    solver = config.solver
    if solver.method == "reachability" and solver.cost != "time":
        message = f"found {solver.cost} with method reachability, which minimises time; expected time, or method ipopt"
        yield ("solver", "cost"), message
    if solver.cost != "time" and solver.weight == 0:
        yield ("solver", "weight"), f"found 0; expected a number above 0 with cost {solver.cost}"


# Bodies ---------------------------------------------------------------------------------------------------


def _shape(key: Key, body: ObjectConfig) -> Iterator[Finding]:
    needed = ("size",) if body.shape == "box" else ("radius", "height")
    for name in ("size", "radius", "height"):
        if name in needed and getattr(body, name) is None:
            yield (*key, name), f"missing; expected {' and '.join(needed)} for a {body.shape}"
        elif name not in needed and getattr(body, name) is not None:
            yield (*key, name), f"found {name} for a {body.shape}; expected only {' and '.join(needed)}"


def _inertia(key: Key, body: TrayConfig | ObjectConfig) -> Iterator[Finding]:
    if body.inertia is None:
        return
    xx, yy, zz, xy, xz, yz = (*body.inertia, 0.0, 0.0, 0.0)[:6]
    low, middle, high = np.linalg.eigvalsh([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    principal = ", ".join(f"{value:.3g}" for value in (low, middle, high))
    if low <= 0:
        yield key, f"the principal moments are {principal}; expected all above 0"
    elif high > (low + middle) * (1 + 1e-9):
        message = "physically impossible, the largest exceeds the sum of the others; expected at most that sum"
        yield key, f"the principal moments are {principal}: {message}"


def _realizable(config: Config) -> Iterator[Finding]:
    """Yield centres of mass outside the shapes of bodies with any inertia that a mass within the shape can have."""
    tray = {} if config.tray is None else {TRAY: config.tray}
    bodies: Mapping[str, TrayConfig | ObjectConfig] = {**tray, **config.objects}
    for name, body in bodies.items():
        if config.inertia_of(name) != "realizable":
            continue
        reach = config.uncertainty.center_of_mass.get(name)
        farthest = np.abs(body.center_of_mass) + np.array(reach or (0.0, 0.0, 0.0))
        half = half_extents(body)
        excess = farthest - half
        if isinstance(body, ObjectConfig) and body.shape == "cylinder":
            excess[:2] = np.hypot(*farthest[:2]) - half[0]
        if excess.max() > OUTSIDE:
            message = (
                f"the centre of mass can be {excess.max():.3g} m outside of {name}, but no mass within the shape has "
                f"it there; expected it inside, or `uncertainty.inertia: {{{name}: [1, 1]}}` for the given inertia"
            )
            yield ("uncertainty", "inertia" if reach is None else "center_of_mass", name), message


def _standing(config: Config, names: Collection[str]) -> Iterator[Finding]:
    """Yield unknown supports, and objects that stand on each other in a circle."""
    on = {name: supports(body) for name, body in config.objects.items()}
    for name, below in on.items():
        for support in below:
            if support != TRAY and support not in names:
                yield ("objects", name, "on"), _unknown(support, (TRAY, *names))
        if len(set(below)) < len(below):
            yield ("objects", name, "on"), f"found {below[0]} twice; expected two different supports, or one"
    grounded = {TRAY, *(name for name in names if name not in on)}
    while more := {name for name, below in on.items() if name not in grounded and grounded.issuperset(below)}:
        grounded |= more
    circle = _circle({name: below for name, below in on.items() if name not in grounded})
    if circle:
        chain = ", which stands on ".join([*circle[1:], circle[0]])
        message = f"{circle[0]} stands on {chain}; expected a chain that ends on the tray or on a held object"
        yield ("objects", circle[0], "on"), message


def _circle(on: Mapping[str, tuple[str, ...]]) -> list[str]:
    """Return the names of objects that stand each on the next, and the last on the first; empty if there are none."""
    for start in on:
        chain = [start]
        while following := next((below for below in on[chain[-1]] if below in on), None):
            if following in chain:
                return chain[chain.index(following) :]
            chain.append(following)
    return []


# Intervals ------------------------------------------------------------------------------------------------


def _intervals(config: Config) -> Iterator[Finding]:
    uncertain = config.uncertainty
    for name, limits in config.robot.limits.joints.items():
        if limits.position is not None:
            key: Key = ("robot", "limits", name, "position")
            yield from _interval(key, limits.position)
            if limits.position[0] == limits.position[1]:
                message = f"found [{limits.position[0]:g}, {limits.position[1]:g}], which leaves the joint no room"
                yield key, f"{message}; expected the lowest value below the highest, or the joint in robot.locked"
    if config.learning is not None:
        yield from _interval(("learning", "friction"), config.learning.friction)
    for name, interval in uncertain.mass.items():
        key = ("uncertainty", "mass", name)
        yield from _interval(key, interval)
        body = config.tray if name == "tray" else config.objects.get(name)
        if body is not None:
            nominal = f"{name}.mass" if name == "tray" else f"objects.{name}.mass"
            yield from _inside(key, interval, body.mass, nominal)
    for name, factor in uncertain.inertia.items():
        if factor != "realizable":
            yield from _interval(("uncertainty", "inertia", name), factor)
    yield from _friction(config)


def _friction(config: Config) -> Iterator[Finding]:
    intervals, values = config.uncertainty.friction, config.contact.friction
    if intervals is None:
        return
    base: Key = ("uncertainty", "friction")
    by_name = intervals if isinstance(intervals, Mapping) else {"": intervals}
    for name, interval in by_name.items():
        yield from _interval((*base, name) if name else base, interval)
    for contact, owner in config.contact_owners.items():
        used = next((name for name in (contact, owner, "default", "") if name in by_name), None)
        value = value_of(values, (contact, owner), None)
        if used is not None and value is not None:
            yield from _inside((*base, used) if used else base, by_name[used], value, "contact.friction")


def _interval(key: Key, interval: tuple[float, float]) -> Iterator[Finding]:
    low, high = interval
    if low > high:
        yield key, f"found [{low:g}, {high:g}]; expected the lowest value first: [{high:g}, {low:g}]"


def _inside(key: Key, interval: tuple[float, float], value: float, nominal: str) -> Iterator[Finding]:
    low, high = interval
    if low <= high and not low <= value <= high:
        found = f"found [{low:g}, {high:g}], which does not contain {nominal} = {value:g}"
        yield key, f"{found}; expected an interval around it"
