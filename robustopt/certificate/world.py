"""The model that a certificate checks: bodies, contacts, contact systems, and the intervals of all uncertain values."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from robustopt.arrays import Array, Indices
from robustopt.certificate import names
from robustopt.certificate.bodies import Body, Parameters, fingers, links, payload
from robustopt.certificate.motion import CARRIER, between_hands
from robustopt.certificate.systems import Load, Placed, System, make_system, scale_of
from robustopt.config import Config
from robustopt.config.per_name import value_of
from robustopt.limits.hands import hand_patches
from robustopt.limits.names import LimitKind, LimitName
from robustopt.limits.turning import carrier_rates, twisted
from robustopt.path import Path
from robustopt.robot import Robot
from robustopt.scene.patches import Law, Patch, patches
from robustopt.scene.placement import TRAY, standing_order, supports

RIM_POINTS = 16
"""Least number of corners of the inscribed regular polygon that represents a round face, a multiple of
`contact.patch_points`. The polygon contains the planner's and lies inside the true disc; its radius is at most 2
% short.
"""

SOLE = 0.1
"""Unit of length of the force programs of the base [m]: about half a foot."""

TWIST_EDGES = 16
"""Number of edges of the coarsest friction polygon with which the planner bounds a twist, if none has fewer."""

WEIGHT = 9.81
"""Unit of force of these programs, per mass [m/s^2]."""


@dataclass(frozen=True, eq=False)
class Contact:
    """A contact with its own coefficient of friction.

    Attributes:
        patch: its patch; one of them if a foot has several.
        first: index of its first contact point.
        last: index after its last contact point.
    """

    patch: Patch
    first: int
    last: int

    @property
    def name(self) -> str:
        """Return the name in messages: the names of two bodies, or the contact's own."""
        stands = self.patch.law is Law.FRICTION and self.patch.object
        return f"{self.patch.object} on {self.patch.support}" if stands else self.patch.name


@dataclass(frozen=True, eq=False)
class World:
    """Bodies, contacts and systems, and the intervals of their parameters.

    Attributes:
        bodies: the bodies.
        contacts: the contacts.
        systems: the contact systems.
        joints: names of all coordinates.
        base: number of coordinates of the floating base, which come first and have no motors.
        nominal: the configured values.
        lower: lower ends of all intervals.
        upper: upper ends of all intervals.
    """

    bodies: tuple[Body, ...]
    contacts: tuple[Contact, ...]
    systems: tuple[System, ...]
    joints: tuple[str, ...]
    base: int
    nominal: Parameters
    lower: Parameters
    upper: Parameters

    @property
    def links(self) -> tuple[str, ...]:
        """Return the names of the links among the bodies."""
        return tuple(dict.fromkeys(body.frame for body in self.bodies if body.frame == body.name))

    def varies(self, b: int) -> bool:
        """Return whether an inertial parameter of body b can differ from its nominal value."""
        low, high = self.lower, self.upper
        moves = low.mass[b] < high.mass[b] or np.any(low.com[b] < high.com[b])
        return bool(moves) or self.bodies[b].factor != (1.0, 1.0)

    @property
    def uncertain(self) -> bool:
        """Return whether any interval has a width above zero."""
        ends = zip(self.lower.arrays(), self.upper.arrays(), strict=True)
        varies = any(body.factor is None or body.factor[0] < body.factor[1] for body in self.bodies)
        return varies or any(bool(np.any(low < high)) for low, high in ends)

    def sample(self, rng: np.random.Generator, count: int, corners: bool) -> Parameters:
        """Return `count` sets of random values, uniform in the intervals, or at their ends if `corners` is true."""

        def values(low: Array, high: Array) -> Array:
            share = rng.random((*low.shape, count))
            low, high = low[..., None], high[..., None]
            return np.asarray(np.where(share < 0.5, low, high) if corners else low + (high - low) * share)

        found = Parameters(*map(values, self.lower.arrays(), self.upper.arrays()))
        for b, body in enumerate(self.bodies):
            found.inertia[b] = body.random_inertias(found.com[b], rng, corners)
        return found

    def describe(self, values: Parameters, system: System | None) -> dict[str, dict[str, object]]:
        """Return the uncertain values, and the frictions of a system, by their names in the configuration."""
        low, high = self.lower, self.upper
        own = sorted(system.contacts) if system is not None else range(len(self.contacts))
        words: dict[str, dict[str, object]] = {
            "friction": {
                self.contacts[i].name: float(values.friction[i])
                for i in own
                if system is not None or low.friction[i] < high.friction[i]
            },
            "force": {self.contacts[i].name: float(values.force[i]) for i in own if low.force[i] < high.force[i]},
            "squeeze": {"hands": float(values.force[-1])} if low.force[-1] < high.force[-1] else {},
            "mass": {
                body.name: float(values.mass[b]) for b, body in enumerate(self.bodies) if low.mass[b] < high.mass[b]
            },
            "center_of_mass": {
                body.name: tuple(values.com[b].tolist())
                for b, body in enumerate(self.bodies)
                if np.any(low.com[b] < high.com[b])
            },
            "inertia": {
                body.name: tuple((values.mass[b] * values.inertia[b]).tolist())
                for b, body in enumerate(self.bodies)
                if body.factor is None or body.factor[0] < body.factor[1]
            },
            "contact_points": {
                it.name: tuple(map(tuple, values.shift[:, it.first : it.last].T.tolist()))
                for it in (self.contacts[i] for i in own)
                if np.any(low.shift[:, it.first] < high.shift[:, it.first])
            },
            "joint_acceleration": {
                joint: float(values.error[j]) for j, joint in enumerate(self.joints) if low.error[j] or high.error[j]
            },
        }
        return {key: value for key, value in words.items() if value}


def build_world(config: Config, robot: Robot, path: Path, stance: Indices) -> World:
    """Return the world of a configuration.

    Args:
        config: the configuration.
        robot: the robot.
        path: the path.
        stance: stance of each instant (T,), see `motion.stances`.
    """
    held = [*_patches(config, twisted(config, carrier_rates(robot, path))), *hand_patches(config, robot.hands)]
    resting = [_resting(robot, name) for name in robot.contacts]
    contacts, first = [], 0
    for patch in (*held, *resting):
        contacts.append(Contact(patch, first, first + len(patch.polygon)))
        first = contacts[-1].last
    own_fingers = fingers(config, held)
    bodies = (*payload(config), *links(config, robot), *own_fingers.values())
    nominal, lower, upper = _intervals(config, robot, bodies, contacts)
    scene = _Scene(config, bodies, contacts, upper.friction, {k: bodies.index(it) for k, it in own_fingers.items()})
    systems = [*(scene.objects(group) for group in _groups(config)), *scene.hands(robot)]
    systems += scene.stances(robot, path, stance)
    return World(bodies, tuple(contacts), tuple(systems), robot.joint_names, robot.base, nominal, lower, upper)


# Contacts -------------------------------------------------------------------------------------------------


def _patches(config: Config, twisted: frozenset[str] = frozenset()) -> list[Patch]:
    """Return the patches of the objects; round faces that carry something with free pressure have many corners."""
    points = config.contact.patch_points
    fine = {"patch_points": points * -(-RIM_POINTS // points)}
    finer = config.model_copy(update={"contact": config.contact.model_copy(update=fine)})
    pairs = zip(patches(config, twisted), patches(finer, twisted), strict=True)
    return [round_ if own.law is Law.FRICTION and not own.fixed else own for own, round_ in pairs]


def contact_points(config: Config) -> int:
    """Return the number of contact points of all objects."""
    return sum(len(patch.polygon) for patch in _patches(config))


def _resting(robot: Robot, name: str) -> Patch:
    """Return an environment contact as a patch in its own frame."""
    return Patch(name, "", "", robot.contacts[name].points[:, :2], np.zeros(3), np.eye(3))


def _groups(config: Config) -> list[tuple[str, ...]]:
    """Return the objects of each system, each object after its supports."""
    order = standing_order(config.objects)
    alone = {name for name in order if _rests_alone(config, name)}
    groups = [{name} for name in alone]
    for name in order:
        if name not in alone:
            linked = {name, *supports(config.objects[name])} - alone - {TRAY}
            touching = [group for group in groups if group & linked]
            groups = [group for group in groups if not group & linked] + [linked.union(*touching)]
    ordered = [tuple(name for name in order if name in group) for group in groups]
    return sorted(ordered, key=lambda group: order.index(group[0]))


def _rests_alone(config: Config, name: str) -> bool:
    """Return whether an object has one support, and everything that it carries rests on nothing else."""
    carried = _carried(config, {name})
    elsewhere = {below for other in carried - {name} for below in supports(config.objects[other])} - carried
    return len(supports(config.objects[name])) <= 1 and not elsewhere


def _carried(config: Config, names: set[str], without: Sequence[str] = ()) -> set[str]:
    """Return some objects and everything that stands on them, directly or not, except for the objects `without`."""
    found = set(names)
    for other in standing_order(config.objects):
        if other not in without and found & set(supports(config.objects[other])):
            found.add(other)
    return found


@dataclass(frozen=True, eq=False)
class _Scene:
    """Factory of the systems of a configuration.

    Attributes:
        config: the configuration.
        bodies: the bodies.
        contacts: the contacts.
        friction: largest coefficient of friction of each contact (I,).
        fingers: by contact, index of the body of the driven finger.
    """

    config: Config
    bodies: Sequence[Body]
    contacts: Sequence[Contact]
    friction: Array
    fingers: Mapping[int, int]

    def objects(self, group: tuple[str, ...]) -> System:
        """Return the system of a group of objects; objects outside the group that they carry are part of them."""
        own = [(i, it.patch) for i, it in enumerate(self.contacts) if it.patch.object in group]
        placed = [self._placed(i, patch, group) for i, patch in own]
        riding = [_carried(self.config, {name}, group) for name in group]
        blocks = [tuple(b for b, body in enumerate(self.bodies) if body.name in own) for own in riding]
        weight = sum(self.bodies[b].mass for block in blocks for b in block)
        weight *= float(np.linalg.norm(self.config.gravity)) or 1.0
        force = weight + sum(_force(self.config, item.patch)[1] for item in placed)
        name = names.object_system(self.config, group, [item.patch for item in placed])
        return self._system(name, placed, blocks, force)

    def hands(self, robot: Robot) -> Iterator[System]:
        """Yield the systems of the hands that hold a tray, each with its share of everything that the tray carries.

        An internal force acts between the first two hands.
        """
        payload = tuple(b for b, body in enumerate(self.bodies) if body.frame == CARRIER and body.payload)
        pads = [i for i, contact in enumerate(self.contacts) if contact.patch.object == TRAY]
        for k, hand in enumerate(robot.hands):
            placed = [self._placed(i, self.contacts[i].patch, (TRAY,)) for i in pads[2 * k : 2 * k + 2]]
            patch = placed[0].patch
            name, force = names.failure(LimitKind.GRIP, patch), _force(self.config, patch)[1]
            system = self._system(name, placed, [payload], force)
            own = system.loads[0].matrix
            if k < 2:
                system.pull[:, -1] = (1.0, -1.0)[k] * (own @ between_hands(robot))
            yield replace(system, loads=(Load(payload, own @ hand.share),))

    def stances(self, robot: Robot, path: Path, stance: Indices) -> Iterator[System]:
        """Yield the systems of the floating base."""
        everything = tuple(b for b, body in enumerate(self.bodies) if body.payload)
        force = WEIGHT * (robot.mass + sum(self.bodies[b].mass for b in everything))
        index = {contact.patch.name: i for i, contact in enumerate(self.contacts) if not contact.patch.object}
        for k, own in enumerate(path.stances):
            placed = []
            for name, place in own.places.items():
                patch = Patch(name, "", "", robot.contacts[name].points[:, :2], place.position, place.axes)
                placed.append(self._placed(index[name], patch, ("",)))
            at = np.flatnonzero(stance == k)
            if len(at):
                yield self._system(names.stance_system(own), placed, [everything], force, at)

    def _placed(self, index: int, patch: Patch, blocks: Sequence[str]) -> Placed:
        stands = patch.law is Law.FRICTION and patch.support != patch.object and patch.support in blocks
        below = blocks.index(patch.support) if stands else -1
        friction = float(self.friction[index])
        return Placed(patch, index, self.contacts[index].first, blocks.index(patch.object), below, friction)

    def _system(
        self,
        name: LimitName,
        placed: list[Placed],
        blocks: list[tuple[int, ...]],
        force: float,
        at: Indices | None = None,
    ) -> System:
        scale = scale_of(placed, force, None if at is None else SOLE)
        edges = self.config.contact.cone_edges
        polygon = float(np.cos(np.pi / (TWIST_EDGES if edges == "auto" else min(edges, TWIST_EDGES))))
        return make_system(name, placed, blocks, self.fingers, scale, len(self.contacts) + 1, polygon, at)


# Intervals ------------------------------------------------------------------------------------------------


def _intervals(
    config: Config, robot: Robot, bodies: Sequence[Body], contacts: Sequence[Contact]
) -> tuple[Parameters, Parameters, Parameters]:
    """Return the configured values, with the mean of the acceleration error, and both ends of all intervals."""
    given = config.uncertainty
    mass = np.array([body.mass for body in bodies])
    mass_ends = np.array([given.mass.get(body.name, (body.mass, body.mass)) for body in bodies]).reshape(-1, 2).T
    reach = np.array([given.center_of_mass.get(body.name, (0.0, 0.0, 0.0)) for body in bodies]).reshape(-1, 3)
    mu, mu_ends = np.zeros(len(contacts)), np.zeros((2, len(contacts)))
    force, shift = np.zeros((3, len(contacts) + 1)), np.zeros((2, contacts[-1].last if contacts else 0))
    for i, contact in enumerate(contacts):
        own = (contact.patch.name, contact.patch.object)
        mu[i] = value_of(config.contact.friction, own, 0.5)
        mu_ends[:, i] = value_of(given.friction, own, (mu[i], mu[i]))
        shift[:, contact.first : contact.last] = value_of(given.contact_points, own, 0.0)
        low, high = _force(config, contact.patch)
        force[:, i] = 0.5 * (low + high), low, high
    hands = config.tray.hands if config.tray is not None else None
    if hands is not None:
        force[1:, -1] = -hands.squeeze, hands.squeeze
    middle, radius = _error(config, robot)
    inertia = np.array([body.inertia for body in bodies]).reshape(-1, 6)
    nominal = Parameters(mass, np.zeros_like(reach), inertia, mu, force[0], np.zeros_like(shift), middle)
    lower = Parameters(mass_ends[0], -reach, inertia, mu_ends[0], force[1], -shift, middle - radius)
    upper = Parameters(mass_ends[1], reach, inertia, mu_ends[1], force[2], shift, middle + radius)
    return nominal, lower, upper


def _force(config: Config, patch: Patch) -> tuple[float, float]:
    """Return both ends of the vacuum or closing force at a contact [N]; 0 at a contact without one."""
    if patch.law not in (Law.SUCTION, Law.DRIVEN_PAD):
        return 0.0, 0.0
    if patch.object == TRAY:
        hands = config.tray.hands if config.tray is not None else None
        force = hands.force if hands is not None else 0.0
    else:
        held_by = config.objects[patch.object].held_by
        force = held_by.tool.force if held_by is not None else 0.0
    return force if isinstance(force, tuple) else (force, force)


def _error(config: Config, robot: Robot) -> tuple[Array, Array]:
    """Return the middle and half the width (n,) of the acceleration error of each coordinate."""
    error, middle, radius = config.uncertainty.joint_acceleration, np.zeros(robot.n), np.zeros(robot.n)
    radius[: robot.base] = config.uncertainty.base_acceleration
    if error is not None:
        middle[robot.motors] = error.mean
        radius[robot.motors] = error.K * np.asarray(error.deviation)
    return middle, radius
