"""The contact limits of a configuration, and the torque limits that depend on them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from robustopt.arrays import Array, Indices
from robustopt.config import Config
from robustopt.config.object_model import GripConfig
from robustopt.errors import ConfigError, RobotError
from robustopt.limits.bodies import Body
from robustopt.limits.contact_limit import ContactLimit
from robustopt.limits.hands import hand_force, hand_systems
from robustopt.limits.laws import ContactLaw
from robustopt.limits.names import LimitKind
from robustopt.limits.polygons import ALONG_PATH, RequiredWrench
from robustopt.limits.stances import eroded_sole, stance_system
from robustopt.limits.systems import ContactSystem, coarse_edges, object_systems
from robustopt.limits.torque import TorqueLimit, legged_torque
from robustopt.limits.track import Track
from robustopt.limits.turning import twisted
from robustopt.limits.uncertainty import Uncertainty
from robustopt.limits.wrenches import Finger, with_forces
from robustopt.scene.patches import Law, patches

STANDARD_GRAVITY = 9.81
"""Gravity for the weights that scale contact rows, independent of the configured gravity [m/s^2]."""


def contact_limits(
    config: Config, track: Track, uncertainty: Uncertainty, laws: Mapping[str, ContactLaw] | None = None
) -> tuple[ContactLimit, ...]:
    """Return the limits of all contacts: each stance of a walking robot, the objects, and several hands on a tray.

    Args:
        config: the configuration.
        track: the track.
        uncertainty: the uncertain quantities.
        laws: contact laws from a user, by the name of the contact of an object.

    Raises:
        ConfigError: a law is given for a contact that no object has, no part of an environment contact is certain, or
            the pressure of an object is fixed that shares its load with others.
        RobotError: a hand reaches beyond the tray, or its force is too small.
    """
    _require_contacts(config, laws or {})
    friction, shift = uncertainty.worst_friction, dict(uncertainty.contact_points)
    systems = (
        *object_systems(config, friction, shift, laws, twisted(config, track.rates)),
        *hand_systems(config, track.robot.hands, friction, shift),
    )
    return *_stance_limits(config, track, uncertainty), *carried_limits(config, track, uncertainty, systems)


def _require_contacts(config: Config, laws: Mapping[str, ContactLaw]) -> None:
    found = {patch.name: patch.law for patch in patches(config)}
    standing = ", ".join(name for name, law in found.items() if law is Law.FRICTION)
    expected = f"one of {standing}" if standing else "no law, as the tool holds all objects"
    for name in laws:
        reason = "where the tool holds the object" if name in found else "which is no contact of an object"
        if found.get(name) is not Law.FRICTION:
            raise ConfigError(f"found a law for {name}, {reason}; expected {expected}", "objects")


def carried_limits(
    config: Config, track: Track, uncertainty: Uncertainty, systems: Sequence[ContactSystem]
) -> list[ContactLimit]:
    """Return the limits of the contact systems of everything that a robot carries.

    The moments of each object are taken about the nominal centre of mass of everything that it carries, because
    interval terms are small there (our choice).

    Args:
        config: the configuration.
        track: the track.
        uncertainty: the uncertain quantities.
        systems: the contact systems.

    Raises:
        RobotError: the internal force between two hands uses up the force of a hand.
    """
    everything = {body.name: body for body in uncertainty.bodies}
    found = []
    for system in systems:
        loaded = tuple(tuple(everything[name] for name in row) for row in system.loads)
        parameters = [np.sum([body.nominal for body in row], axis=0) for row in loaded]
        centred = system.about([phi[1:4] / phi[0] for phi in parameters])
        weight = STANDARD_GRAVITY * sum(phi[0] for phi in parameters)
        loads = _required(config, track, uncertainty, centred, loaded)
        found.append(ContactLimit.of(centred, loads, weight))
    return found


def _required(
    config: Config, track: Track, uncertainty: Uncertainty, system: ContactSystem, loaded: Sequence[Sequence[Body]]
) -> RequiredWrench:
    """Return what a system requires; more of a single force is never worse, but one of several cups can pull askew."""
    loads = track.loads(loaded, system.points, uncertainty.error)
    if not system.pressed:
        return loads
    ends = dict(uncertainty.forces)
    for hand in track.robot.hands:
        ends[hand.name] = (hand_force(config, hand, uncertainty.worst_friction),) * 2
    forces = [ends[name] if system.pressed.count(name) > 1 else ends[name][:1] * 2 for name in system.pressed]
    fingers = [_finger(config, name) for name in system.pressed]
    return with_forces(loads, forces, fingers, track.motion, uncertainty.error.arrays)


def _finger(config: Config, name: str) -> Finger | None:
    """Return the driven finger that holds an object, if it has a mass."""
    held = config.objects[name].held_by if name in config.objects else None
    if held is None or not isinstance(held.tool, GripConfig) or held.tool.finger_mass == 0.0:
        return None
    pad = next(patch for patch in patches(config) if patch.object == name and patch.law is Law.DRIVEN_PAD)
    return Finger(held.tool.finger_mass, pad.origin, pad.axes[:, 2])


def _stance_limits(config: Config, track: Track, uncertainty: Uncertainty) -> list[ContactLimit]:
    """Return the limit of the environment contacts of each stance."""
    robot, found = track.robot, []
    soles = _certain_soles(track, uncertainty)
    weight = STANDARD_GRAVITY * (robot.mass + sum(body.nominal[0] for body in uncertainty.bodies))
    borders = np.searchsorted(track.s, np.concatenate([[0.0], track.path.switches, [1.0]])).tolist()
    for k, stance in enumerate(track.path.stances):
        system = stance_system(stance, soles, uncertainty.worst_friction, coarse_edges(config))
        on_base = _first_rows(track.generalised_force(uncertainty), robot.base)
        found.append(ContactLimit.of(system, on_base, weight, borders[k], borders[k + 1]))
    return found


def _first_rows(loads: RequiredWrench, count: int) -> RequiredWrench:
    """Return the first coordinates of required wrenches."""
    return loads._replace(**{name: np.ascontiguousarray(getattr(loads, name)[:, :count]) for name in ALONG_PATH})


def _certain_soles(track: Track, uncertainty: Uncertainty) -> dict[str, Array]:
    """Return the part of each environment contact that is certain, about its centre (k, 2) [m].

    Raises:
        ConfigError: nothing of a contact is certain.
    """
    shift = dict(uncertainty.contact_points)
    return {name: eroded_sole(sole.points, shift[name], name) for name, sole in track.robot.contacts.items()}


def torque_limit(track: Track, uncertainty: Uncertainty, contacts: Sequence[ContactLimit]) -> TorqueLimit:
    """Return the torque limits of the joints, of a legged robot or of an arm.

    Args:
        track: the track.
        uncertainty: the uncertain quantities.
        contacts: the limits of all contacts, stances first.

    Raises:
        RobotError: the joints of a legged robot have friction.
    """
    robot = track.robot
    if not robot.base:
        payload = track.loads((uncertainty.bodies,), (np.zeros(3),), uncertainty.error)
        return track.payload_torque(payload, uncertainty.error)
    if np.any(robot.limits.dry_friction) or np.any(robot.limits.viscous_friction):
        raise RobotError(
            "found friction in the joints, which a walking robot must not have; expected robot.joint_friction: false",
            key="robot.joint_friction",
        )
    stances = tuple(contacts[: len(track.path.stances)])
    return legged_torque(
        track.motion, track.names(LimitKind.TORQUE), robot.limits.torque, robot.chains, robot.base,
        track.generalised_force(uncertainty), stances, _standing(track, stances), _certain_soles(track, uncertainty),
        track.x_max,
    )  # fmt: skip


def _standing(track: Track, contacts: Sequence[ContactLimit]) -> Indices:
    """Return the index of the stance of each grid point (P,); at a switch, of the stance with fewer contacts."""
    standing = np.zeros(len(track.s), dtype=np.intp)
    for k in sorted(range(len(contacts)), key=lambda k: -len(track.path.stances[k].contacts)):
        standing[contacts[k].first : contacts[k].last + 1] = k
    return standing
