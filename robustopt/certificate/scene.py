"""What the tray carries, who rests on whom, and what is uncertain about it.

Everything is in the tray frame. A contact system is a set of objects whose contact forces must be found together: an
object whose load reaches the tray through its one support alone is a system by itself, with all that it carries as
one rigid load; a bridge, its supports, and what shares them are one system.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from robustopt.certificate.contact_points import Array, Contacts, Face, Indices
from robustopt.config import Config, ObjectConfig, TrayConfig
from robustopt.geometry import clip, rectangle
from robustopt.scene.placement import CARRIER, TRAY, Placement, footprint, placements, standing_order, supports

RIM_POINTS = 16
"""A round face is the inscribed regular polygon of the smallest multiple of `contact.patch_points` with at least this
many corners: it contains the planner's polygon and lies inside the true disc (its radius is 2 % short at most)."""

V = TypeVar("V")


@dataclass(frozen=True, eq=False)
class Body:
    """The tray or an object as a rigid load.

    mass [kg]; center: (3,) centre of mass [m]; turn: (3, 3) from the body's axes to the tray's; inertia: (3, 3) about
    the centre of mass per unit of mass, tray axes [m^2]
    """

    name: str
    mass: float
    center: Array
    turn: Array
    inertia: Array


@dataclass(frozen=True, eq=False)
class Interface:
    """An object on a support: its patch is the contact points `first` to `last` (excluded) of the scene."""

    object: str
    support: str
    first: int
    last: int


@dataclass(frozen=True, eq=False)
class System:
    """Objects whose contact forces must be found together.

    name: of the limit; objects: the K blocks; loads: per block the bodies it carries rigidly, itself included; faces:
    of its contact points; interfaces: indices of its interfaces; points, friction: indices of its contact points and
    of their interfaces, (n,); reference: (3,) origin of its moments [m]; length, force: its units [m], [N]
    """

    name: str
    objects: tuple[str, ...]
    loads: tuple[tuple[int, ...], ...]
    faces: tuple[Face, ...]
    interfaces: tuple[int, ...]
    points: Indices
    friction: Indices
    reference: Array
    length: float
    force: float


@dataclass(frozen=True, eq=False)
class Parameters:
    """Values of all that may be uncertain; any axes may follow those named here.

    mass: (B,) [kg]; com: (B, 3) displacement of the centre of mass, body axes [m]; friction: (I,); shift: (2, Q)
    displacement of each contact point, axes of its support [m]; error: (n,) joint acceleration error [rad/s^2]
    """

    mass: Array
    com: Array
    friction: Array
    shift: Array
    error: Array

    def at(self, index: int | Indices | slice) -> Parameters:
        """Some of many sets of values along the last axis."""
        return Parameters(*(values[..., index] for values in self.arrays()))

    def arrays(self) -> tuple[Array, ...]:
        """The arrays in the order of the fields."""
        return self.mass, self.com, self.friction, self.shift, self.error

    def repeated(self, count: int) -> Parameters:
        """One set of values, `count` times along a new last axis."""
        return Parameters(*(np.repeat(values[..., None], count, axis=-1) for values in self.arrays()))


@dataclass(frozen=True, eq=False)
class Scene:
    """Bodies (the tray first), interfaces, contact points and systems, and the intervals on their parameters.

    points: (3, Q) contact points; point_turn: (2, 2, Q) from the axes of the support under each to the tray's;
    nominal, lower, upper: the configured values and the intervals
    """

    bodies: tuple[Body, ...]
    interfaces: tuple[Interface, ...]
    systems: tuple[System, ...]
    points: Array
    point_turn: Array
    joints: tuple[str, ...]
    nominal: Parameters
    lower: Parameters
    upper: Parameters

    @property
    def uncertain(self) -> bool:
        """Whether any interval has a width."""
        ends = zip(self.lower.arrays(), self.upper.arrays(), strict=True)
        return any(bool(np.any(low < high)) for low, high in ends)

    def draw(self, rng: np.random.Generator, count: int, corners: bool) -> Parameters:
        """`count` values of everything at once, uniform in the intervals, or each at either end of its interval."""

        def values(low: Array, high: Array) -> Array:
            share = rng.random((*low.shape, count))
            low, high = low[..., None], high[..., None]
            return np.asarray(np.where(share < 0.5, low, high) if corners else low + (high - low) * share)

        return Parameters(*map(values, self.lower.arrays(), self.upper.arrays()))

    def contacts(self, system: System, parameters: Parameters) -> Contacts:
        """Contact points and friction of a system in its units, for parameters with one further axis T."""
        shift = np.einsum("ijq,jq...->iq...", self.point_turn[..., system.points], parameters.shift[:, system.points])
        nominal = self.points[:, system.points] - system.reference[:, None]
        point = np.repeat(nominal[..., None], shift.shape[-1], axis=-1)
        point[:2] += shift
        return Contacts(system.faces, point / system.length, parameters.friction[system.friction])

    def describe(self, parameters: Parameters, system: System | None) -> dict[str, dict[str, object]]:
        """The uncertain values among `parameters`, and all friction of a system, in the configuration's words."""
        low, high = self.lower, self.upper
        own = system.interfaces if system is not None else range(len(self.interfaces))
        words: dict[str, dict[str, object]] = {
            "friction": {
                self.interface_name(i): float(parameters.friction[i])
                for i in own
                if system is not None or low.friction[i] < high.friction[i]
            },
            "mass": {
                body.name: float(parameters.mass[b]) for b, body in enumerate(self.bodies) if low.mass[b] < high.mass[b]
            },
            "center_of_mass": {
                body.name: tuple(parameters.com[b].tolist())
                for b, body in enumerate(self.bodies)
                if np.any(low.com[b] < high.com[b])
            },
            "contact_points": {
                self.interface_name(i): tuple(map(tuple, parameters.shift[:, face.first : face.last].T.tolist()))
                for i in own
                if np.any(low.shift[:, (face := self.interfaces[i]).first] < high.shift[:, face.first])
            },
            "joint_acceleration": {
                joint: float(parameters.error[j])
                for j, joint in enumerate(self.joints)
                if low.error[j] or high.error[j]
            },
        }
        return {key: value for key, value in words.items() if value}

    def interface_name(self, index: int) -> str:
        return f"{self.interfaces[index].object} on {self.interfaces[index].support}"


def build_scene(config: Config, joints: tuple[str, ...]) -> Scene:
    """The scene of a configuration for a robot with the named joints."""
    placed = placements(config)
    bodies = [
        _body("tray", config.carried_tray, Placement(np.zeros(3), np.eye(3), 0.0, TRAY, CARRIER, np.zeros(3), 0.0))
    ]
    bodies += [_body(name, config.objects[name], placed[name]) for name in placed]
    interfaces, points, turns = _interfaces(config, placed)
    nominal, lower, upper = _intervals(config, bodies, interfaces, points.shape[1], len(joints))
    groups = _groups(config)
    systems = tuple(_system(config, group, bodies, interfaces, points) for group in groups)
    return Scene(tuple(bodies), interfaces, systems, points, turns, joints, nominal, lower, upper)


# Bodies ---------------------------------------------------------------------------------------------------


def _body(name: str, item: TrayConfig | ObjectConfig, placement: Placement) -> Body:
    turn = np.eye(3)
    turn[:2, :2] = _rotation(placement.yaw)
    center = placement.position + turn @ np.asarray(item.center_of_mass)
    return Body(name, item.mass, center, turn, turn @ _unit_inertia(item) @ turn.T)


def _unit_inertia(item: TrayConfig | ObjectConfig) -> Array:
    """Inertia about the centre of mass per unit of mass, body axes, (3, 3) [m^2]; of a uniform body if not given."""
    if item.inertia is not None:
        ixx, iyy, izz, ixy, ixz, iyz = (*item.inertia, 0.0, 0.0, 0.0)[:6]
        return np.array([[ixx, ixy, ixz], [ixy, iyy, iyz], [ixz, iyz, izz]]) / item.mass
    if item.size is not None:
        square = np.square(item.size)
        return np.diag(square.sum() - square) / 12.0
    assert isinstance(item, ObjectConfig), "a tray has a size"
    assert item.radius is not None, "checked when the configuration was read"
    assert item.height is not None, "checked when the configuration was read"
    across = item.radius**2 / 4.0 + item.height**2 / 12.0
    return np.diag([across, across, item.radius**2 / 2.0])


def _rotation(yaw: float) -> Array:
    return np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])


# Contact --------------------------------------------------------------------------------------------------


def _interfaces(config: Config, placed: Mapping[str, Placement]) -> tuple[tuple[Interface, ...], Array, Array]:
    """Interfaces, the corners of all their patches (3, Q), and the turn of the support under each (2, 2, Q)."""
    rim = config.contact.patch_points * -(-RIM_POINTS // config.contact.patch_points)
    outlines = {"tray": rectangle(np.zeros(2), np.array(config.carried_tray.size))}
    outlines |= {name: footprint(config.objects[name], placement, rim) for name, placement in placed.items()}
    interfaces: list[Interface] = []
    points: list[Array] = []
    turns: list[Array] = []
    count = 0
    for name, placement in placed.items():
        for support in supports(config.objects[name]):
            patch = clip(outlines[name], outlines[support])
            height = np.full(len(patch), placement.position[2] - placement.half_height)
            points.append(np.column_stack([patch, height]).T)
            yaw = 0.0 if support == "tray" else placed[support].yaw
            turns.append(np.repeat(_rotation(yaw)[:, :, None], len(patch), axis=2))
            interfaces.append(Interface(name, support, count, count + len(patch)))
            count += len(patch)
    empty = [np.zeros((3, 0))], [np.zeros((2, 2, 0))]
    return tuple(interfaces), np.concatenate(points or empty[0], axis=1), np.concatenate(turns or empty[1], axis=2)


def _groups(config: Config) -> list[tuple[str, ...]]:
    """The objects of each system, every one after what it stands on."""
    order = standing_order(config.objects)
    carried = {name: _carried(config, name) for name in order}
    alone = {name for name in order if _rests_alone(config, name, carried[name])}
    groups = [{name} for name in alone]
    for name in order:
        if name not in alone:
            linked = {name, *supports(config.objects[name])} - alone - {"tray"}
            touching = [group for group in groups if group & linked]
            groups = [group for group in groups if not group & linked] + [linked.union(*touching)]
    ordered = [tuple(name for name in order if name in group) for group in groups]
    return sorted(ordered, key=lambda group: order.index(group[0]))


def _carried(config: Config, name: str) -> set[str]:
    """An object and everything that stands on it, directly or not."""
    found = {name}
    for other in standing_order(config.objects):
        if found & set(supports(config.objects[other])):
            found.add(other)
    return found


def _rests_alone(config: Config, name: str, carried: set[str]) -> bool:
    """Whether an object has one support and nothing that it carries rests on anything else as well."""
    elsewhere = {support for other in carried - {name} for support in supports(config.objects[other])} - carried
    return len(supports(config.objects[name])) == 1 and not elsewhere


def _system(
    config: Config, group: tuple[str, ...], bodies: list[Body], interfaces: tuple[Interface, ...], points: Array
) -> System:
    """The system of a group of objects; what its objects carry outside the group counts as part of them."""
    names = [body.name for body in bodies]
    loads = []
    for name in group:
        riding = {name}
        for other in standing_order(config.objects):
            if other not in group and riding & set(supports(config.objects[other])):
                riding.add(other)
        loads.append(tuple(b for b, body in enumerate(names) if body in riding))
    own = [i for i, interface in enumerate(interfaces) if interface.object in group]
    faces: list[Face] = []
    points_of: list[int] = []
    friction: list[int] = []
    for i in own:
        face = interfaces[i]
        below = group.index(face.support) if face.support in group else -1
        faces.append(Face(len(points_of), len(points_of) + face.last - face.first, group.index(face.object), below))
        points_of += range(face.first, face.last)
        friction += [i] * (face.last - face.first)
    index = np.array(points_of, dtype=np.intp)
    mine = points[:, index]
    reference = 0.5 * (mine.min(axis=1) + mine.max(axis=1))
    mass = sum(bodies[b].mass for load in loads for b in load)
    gravity = float(np.linalg.norm(config.gravity)) or 1.0
    return System(
        name=_system_name(config, group),
        objects=group,
        loads=tuple(loads),
        faces=tuple(faces),
        interfaces=tuple(own),
        points=index,
        friction=np.array(friction, dtype=np.intp),
        reference=reference,
        length=float(np.abs(mine - reference[:, None]).max()),
        force=mass * gravity,
    )


def _system_name(config: Config, group: tuple[str, ...]) -> str:
    if len(group) == 1:
        return f"contact of {group[0]} on {supports(config.objects[group[0]])[0]}"
    bridges = [name for name in group if len(supports(config.objects[name])) > 1]
    return " and ".join(f"balance of {name} on {' and '.join(supports(config.objects[name]))}" for name in bridges)


# Intervals ------------------------------------------------------------------------------------------------


def _intervals(
    config: Config, bodies: list[Body], interfaces: tuple[Interface, ...], points: int, joints: int
) -> tuple[Parameters, Parameters, Parameters]:
    """The configured values (the mean of the acceleration error), and the ends of all intervals."""
    given = config.uncertainty
    mass = np.array([body.mass for body in bodies])
    mass_ends = np.array([given.mass.get(body.name, (body.mass, body.mass)) for body in bodies]).T
    reach = np.array([given.center_of_mass.get(body.name, (0.0, 0.0, 0.0)) for body in bodies])
    mu = np.array([_of(config.contact.friction, face.object, 0.5) for face in interfaces])
    mu_ends = np.array([_of(given.friction, face.object, (m, m)) for face, m in zip(interfaces, mu, strict=True)])
    mu_ends = mu_ends.reshape(-1, 2).T
    shift = np.zeros((2, points))
    for face in interfaces:
        shift[:, face.first : face.last] = _of(given.contact_points, face.object, 0.0)
    error = given.joint_acceleration
    middle, radius = np.zeros(joints), np.zeros(joints)
    if error is not None:
        middle, radius = middle + np.asarray(error.mean), radius + error.K * np.asarray(error.deviation)
    nominal = Parameters(mass, np.zeros_like(reach), mu, np.zeros_like(shift), middle)
    lower = Parameters(mass_ends[0], -reach, mu_ends[0], -shift, middle - radius)
    upper = Parameters(mass_ends[1], reach, mu_ends[1], shift, middle + radius)
    return nominal, lower, upper


def _of(given: V | Mapping[str, V] | None, name: str, otherwise: V) -> V:
    """The value for the interface under an object: its own, that of `default`, or the one value for all."""
    if given is None:
        return otherwise
    if isinstance(given, Mapping):
        return given.get(name, given.get("default", otherwise))
    return given
