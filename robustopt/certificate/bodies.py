"""Bodies whose inertia counts: the tray, the objects, driven fingers, and links with uncertain masses.

Every body is rigidly attached to a frame of the `motion`: to the carrier frame, or to the frame of a link. The dynamics
of the robot include its links with their nominal masses. So a link that is listed here is listed twice, the second time
with its nominal mass of opposite sign.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from robustopt.arrays import Array, Indices
from robustopt.certificate.motion import CARRIER, picked
from robustopt.certificate.realizable import FIRST, SECOND, extreme_inertias, random_inertias
from robustopt.config import Config
from robustopt.config.object_model import ObjectConfig, TrayConfig
from robustopt.robot import Robot
from robustopt.scene.patches import Law, Patch
from robustopt.scene.placement import TRAY, placements


@dataclass(frozen=True, eq=False)
class Body:
    """A rigid body.

    Attributes:
        name: name of the body.
        frame: name of the frame that the body is attached to.
        mass: mass [kg].
        center: centre of mass, axes of the frame (3,) [m].
        turn: rotation from the axes of the body to those of the frame (3, 3).
        inertia: nominal inertia about the centre of mass per unit of mass, axes of the body, in the order of
            `realizable.ENTRIES` (6,) [m^2].
        factor: lowest and highest factor on this inertia, or None for any realizable inertia.
        half: half extents of the shape, needed for a realizable inertia (3,) [m].
        offset: nominal centre of mass from the centre of the shape (3,) [m].
        is_round: whether the shape is a cylinder.
        payload: False for a driven finger, which belongs to the robot and only reduces its own closing force.
    """

    name: str
    frame: str
    mass: float
    center: Array
    turn: Array
    inertia: Array
    factor: tuple[float, float] | None = (1.0, 1.0)
    half: Array = field(default_factory=lambda: np.zeros(3))
    offset: Array = field(default_factory=lambda: np.zeros(3))
    is_round: bool = False
    payload: bool = True

    def inertias(self, com: Array) -> Array:
        """Return the extreme inertias per unit mass for a displacement of the centre of mass, (k, 6) [m^2].

        Args:
            com: the displacement, body axes (3,) [m].
        """
        if self.factor is not None:
            return np.outer(np.unique(self.factor), self.inertia)
        return extreme_inertias(self.half, self.is_round, self.offset + com)

    def random_inertias(self, com: Array, rng: np.random.Generator, corners: bool) -> Array:
        """Return a random inertia per unit mass for each displacement of the centre of mass, (6, D) [m^2].

        Args:
            com: the displacements, body axes (3, D) [m].
            rng: generator of random numbers.
            corners: whether extreme inertias are wanted.
        """
        if self.factor is None:
            return random_inertias(self.half, self.is_round, self.offset[:, None] + com, rng, corners)
        low, high = self.factor
        share = rng.integers(2, size=com.shape[1]) if corners else rng.random(com.shape[1])
        return np.asarray(self.inertia[:, None] * (low + (high - low) * share))


def payload(config: Config) -> list[Body]:
    """Return the tray, if there is one, and the objects."""
    bodies = [] if config.tray is None else [_body(config, TRAY, config.tray, np.zeros(3), np.eye(3))]
    placed = placements(config)
    return bodies + [_body(config, name, config.objects[name], it.position, it.rotation) for name, it in placed.items()]


def _body(config: Config, name: str, item: TrayConfig | ObjectConfig, position: Array, turn: Array) -> Body:
    offset = np.asarray(item.center_of_mass)
    given = config.inertia_of(name)
    if item.size is not None:
        half, is_round = 0.5 * np.asarray(item.size), False
    else:
        radius, height = getattr(item, "radius", 0.0), getattr(item, "height", 0.0)
        half, is_round = np.array([radius, radius, 0.5 * height]), True
    inertia, factor = _unit_inertia(item, half, is_round), None if given == "realizable" else given
    return Body(name, CARRIER, item.mass, position + turn @ offset, turn, inertia, factor, half, offset, is_round)


def _unit_inertia(item: TrayConfig | ObjectConfig, half: Array, is_round: bool) -> Array:
    """Return the nominal inertia about the centre of mass per unit of mass, body axes, (6,) [m^2]."""
    if item.inertia is not None:
        return np.array((*item.inertia, 0.0, 0.0, 0.0)[:6]) / item.mass
    spread = np.square(half) / (np.array([4.0, 4.0, 3.0]) if is_round else 3.0)
    return np.r_[spread.sum() - spread, np.zeros(3)]


def links(config: Config, robot: Robot) -> list[Body]:
    """Return the links with uncertain mass or centre of mass, each with its nominal link of opposite mass."""
    uncertain = {*config.uncertainty.mass, *config.uncertainty.center_of_mass} & {*robot.body_names}
    bodies = []
    for name in sorted(uncertain - {TRAY, *config.objects}):
        mass, center, inertia = robot.inertia_of(name)
        own = inertia[FIRST, SECOND] / mass
        bodies.append(Body(name, name, mass, center, np.eye(3), own))
        bodies.append(Body(f"nominal {name}", name, -mass, center, np.eye(3), own))
    return bodies


def fingers(config: Config, patches: Sequence[Patch]) -> dict[int, Body]:
    """Return the driven fingers that have a mass, as point masses at their pads, by the index of their patch."""
    found = {}
    for index, patch in enumerate(patches):
        own = config.objects.get(patch.object) if patch.law is Law.DRIVEN_PAD else None
        if own is not None and own.held_by is not None and own.held_by.grip is not None:
            name, mass = f"finger of {patch.object}", own.held_by.grip.finger_mass
            if mass > 0.0:
                found[index] = Body(name, CARRIER, mass, patch.origin, np.eye(3), np.zeros(6), payload=False)
    return found


@dataclass(frozen=True, eq=False)
class Parameters:
    """Values of everything that may be uncertain; each array may have further axes at its end.

    Attributes:
        mass: mass of each body (B,) [kg].
        com: displacement of each centre of mass, body axes (B, 3) [m].
        inertia: inertia of each body about its centre of mass per unit of mass, body axes (B, 6) [m^2].
        friction: coefficient of friction of each contact (I,).
        force: vacuum or closing force of each contact, 0 without one, then the internal force between hands (I + 1,)
            [N].
        shift: displacement of each contact point, axes of its support (2, Q) [m].
        error: acceleration error of each coordinate (n,) [rad/s^2 or m/s^2].
    """

    mass: Array
    com: Array
    inertia: Array
    friction: Array
    force: Array
    shift: Array
    error: Array

    def arrays(self) -> tuple[Array, ...]:
        """Return the arrays in the order of the fields."""
        return self.mass, self.com, self.inertia, self.friction, self.force, self.shift, self.error

    def at(self, index: int | Indices | slice) -> Parameters:
        """Return some of the sets of values, selected along the last axis."""
        return Parameters(*(picked(values, index) for values in self.arrays()))

    def repeated(self, count: int) -> Parameters:
        """Return one set of values, repeated `count` times along a new last axis."""
        return Parameters(*(np.repeat(values[..., None], count, axis=-1) for values in self.arrays()))
