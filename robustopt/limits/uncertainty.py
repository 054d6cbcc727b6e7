"""Uncertain quantities: one value that holds every interval a plan must survive.

Friction, contact points, pressing forces, masses, centres of mass, and the error of the executed acceleration are each
given as an interval. Less friction is always worse, and so is less pressing force: the excess of a larger force can
squeeze the part evenly, which is a wrench of zero. The acceleration error e adds the columns of a Jacobian to the
acceleration, and its products with all other parameters are exact (see `coupling`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Literal

import numpy as np

from robustopt.arrays import Array
from robustopt.config import Config, ObjectConfig, TrayConfig
from robustopt.config.per_name import value_of
from robustopt.errors import ConfigError
from robustopt.limits.bodies import Body, inertia_matrix, realizable_body, uncertain_body
from robustopt.scene.placement import TRAY, half_extents, placements

Interval = tuple[float, float]


@dataclass(frozen=True)
class AccelerationError:
    """Interval [U - K D, U + K D] of the acceleration error of each coordinate (paper eq. 9), (n,) [rad/s^2 or m/s^2].

    The first coordinates of a legged robot are those of its base, which has an error of its own.
    """

    middle: tuple[float, ...]
    radius: tuple[float, ...]

    @cached_property
    def arrays(self) -> tuple[Array, Array]:
        """Return the middle and the half-width as arrays (n,)."""
        return np.array(self.middle), np.array(self.radius)


@dataclass(frozen=True)
class Uncertainty:
    """All uncertain quantities of a problem. Equal values mean equal problems, so an instance can be a cache key.

    Attributes:
        friction: lowest and highest coefficient of friction, by contact.
        contact_points: largest displacement of each contact point along x and along y, by contact [m].
        forces: lowest and highest force that presses an object against the tool, by object [N].
        bodies: the tray and the objects.
        robot_bodies: name, mass interval (None for the mass of the model) and largest displacement of the centre of
            mass of each uncertain body of the robot.
        error: acceleration error.
        squeeze: largest internal force between two hands that hold the tray [N].
    """

    friction: tuple[tuple[str, Interval], ...]
    contact_points: tuple[tuple[str, float], ...]
    forces: tuple[tuple[str, Interval], ...]
    bodies: tuple[Body, ...]
    robot_bodies: tuple[tuple[str, Interval | None, tuple[float, float, float]], ...]
    error: AccelerationError
    squeeze: float = 0.0

    @property
    def worst_friction(self) -> dict[str, float]:
        """Return the lowest coefficient of friction of each contact."""
        return {name: low for name, (low, _) in self.friction}


def uncertainty_of(config: Config, coordinates: int, base: int) -> Uncertainty:
    """Return the uncertain quantities of a configuration.

    Args:
        config: the configuration.
        coordinates: number of coordinates of the robot.
        base: number of these that belong to a floating base, 0 for an arm.

    Raises:
        ConfigError: the acceleration error has neither one value nor one for each joint.
    """
    given, objects = config.uncertainty, (TRAY, *config.objects)
    named = {*given.mass, *given.center_of_mass} - set(objects)
    return Uncertainty(
        friction=tuple(friction(config).items()),
        contact_points=tuple(
            (contact, value_of(given.contact_points, (contact, owner), 0.0))
            for contact, owner in config.contact_owners.items()
        ),
        forces=tuple(forces(config).items()),
        bodies=tuple(bodies(config).values()),
        robot_bodies=tuple(
            (name, given.mass.get(name), given.center_of_mass.get(name, (0.0, 0.0, 0.0))) for name in sorted(named)
        ),
        error=acceleration_error(config, coordinates, base),
        squeeze=config.tray.hands.squeeze if config.tray is not None and config.tray.hands is not None else 0.0,
    )


def friction(config: Config) -> dict[str, Interval]:
    """Return the interval of the coefficient of friction of each contact; the nominal value if it has none.

    Args:
        config: the configuration.
    """
    given, nominal = config.uncertainty.friction, config.contact.friction
    found = {}
    for contact, owner in config.contact_owners.items():
        value = value_of(nominal, (contact, owner), np.nan)
        found[contact] = value_of(given, (contact, owner), (value, value))
    return found


def forces(config: Config) -> dict[str, Interval]:
    """Return the interval of the force that presses each held object against the tool [N].

    Args:
        config: the configuration.
    """
    held = {name: body.held_by.tool.force for name, body in config.objects.items() if body.held_by is not None}
    return {name: force if isinstance(force, tuple) else (force, force) for name, force in held.items()}


def acceleration_error(config: Config, coordinates: int, base: int) -> AccelerationError:
    """Return the acceleration error of all coordinates.

    Args:
        config: the configuration.
        coordinates: number of coordinates of the robot.
        base: number of these that belong to a floating base, 0 for an arm.

    Raises:
        ConfigError: the acceleration error has neither one value nor one for each joint.
    """
    error = config.uncertainty.joint_acceleration
    middle, radius = np.zeros(coordinates), np.zeros(coordinates)
    radius[:base] = config.uncertainty.base_acceleration
    if error is not None:
        middle[base:] = _per_joint("mean", error.mean, coordinates - base)
        radius[base:] = error.K * _per_joint("deviation", error.deviation, coordinates - base)
    return AccelerationError(tuple(middle.tolist()), tuple(radius.tolist()))


def _per_joint(name: str, given: float | tuple[float, ...], joints: int) -> Array:
    values = np.atleast_1d(np.asarray(given, dtype=float))
    if len(values) not in (1, joints):
        found = f"found {len(values)} values; expected one, or one for each of the {joints} joints [rad/s^2 or m/s^2]"
        raise ConfigError(found, f"uncertainty.joint_acceleration.{name}")
    return np.broadcast_to(values, (joints,)).copy()


def bodies(config: Config) -> dict[str, Body]:
    """Return the tray, if there is one, and every object, by name, in the carrier frame.

    Args:
        config: the configuration.
    """
    placed, given = placements(config), config.uncertainty
    items: Mapping[str, TrayConfig | ObjectConfig] = {
        **({} if config.tray is None else {TRAY: config.tray}),
        **config.objects,
    }
    found = {}
    for name, item in items.items():
        position, rotation = np.zeros(3), np.eye(3)
        if name in placed:
            position, rotation = placed[name].position, placed[name].rotation
        mass = given.mass.get(name, (item.mass, item.mass))
        reach = given.center_of_mass.get(name, (0.0, 0.0, 0.0))
        factor = config.inertia_of(name)
        found[name] = _body(name, item, mass, reach, factor, tuple(position.tolist()), tuple(rotation.ravel().tolist()))
    return found


@lru_cache(maxsize=256)
def _body(
    name: str,
    item: TrayConfig | ObjectConfig,
    mass: Interval,
    reach: tuple[float, float, float],
    factor: Interval | Literal["realizable"],
    position: tuple[float, ...],
    rotation: tuple[float, ...],
) -> Body:
    """Return a body at a place; `reach` of its centre of mass along its own axes [m]."""
    turn = np.array(rotation).reshape(3, 3)
    inertia = turn @ (inertia_matrix(item) / item.mass) @ turn.T
    arm, reaches = np.array(position) + turn @ np.array(item.center_of_mass), turn * np.array(reach)
    if factor != "realizable":
        return uncertain_body(name, mass, arm, inertia, reaches, factor)
    extents, is_round = _extents(item, reach), isinstance(item, ObjectConfig) and item.shape == "cylinder"
    return realizable_body(name, mass, arm, inertia, reaches, turn * extents, is_round)


def _extents(item: TrayConfig | ObjectConfig, reach: tuple[float, float, float]) -> Array:
    """Return the roots of the largest second moments about the nominal centre of mass, (3,) [m]; see `bodies`."""
    center = np.abs(item.center_of_mass)
    free = -np.square(center) + 2.0 * center * np.array(reach)
    half = half_extents(item)
    if isinstance(item, ObjectConfig) and item.shape == "cylinder":
        free[:2] = free[:2].sum()
    return np.sqrt(np.maximum(half**2 + free, 0.0))
