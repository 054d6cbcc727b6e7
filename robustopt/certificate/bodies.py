"""Bodies whose inertia counts: the tray, the objects, driven fingers, and links with uncertain masses.

Every body is rigidly attached to a frame of the `motion`: to the carrier frame, or to the frame of a link. The dynamics
of the robot include its links with their nominal masses. So a link that is listed here is listed twice, the second time
with its nominal mass of opposite sign.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from robustopt.arrays import Array, Indices
from robustopt.certificate.motion import CARRIER
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
        inertia: inertia about the centre of mass per unit of mass, axes of the frame (3, 3) [m^2].
        payload: False for a driven finger, which belongs to the robot and only reduces its own closing force.
    """

    name: str
    frame: str
    mass: float
    center: Array
    turn: Array
    inertia: Array
    payload: bool = True


def payload(config: Config) -> list[Body]:
    """Return the tray, if there is one, and the objects."""
    bodies = [] if config.tray is None else [_body(TRAY, config.tray, np.zeros(3), np.eye(3))]
    placed = placements(config)
    return bodies + [_body(name, config.objects[name], it.position, it.rotation) for name, it in placed.items()]


def _body(name: str, item: TrayConfig | ObjectConfig, position: Array, turn: Array) -> Body:
    center = position + turn @ np.asarray(item.center_of_mass)
    return Body(name, CARRIER, item.mass, center, turn, turn @ _unit_inertia(item) @ turn.T)


def _unit_inertia(item: TrayConfig | ObjectConfig) -> Array:
    """Return the inertia about the centre of mass per unit of mass, body axes, (3, 3) [m^2]."""
    if item.inertia is not None:
        ixx, iyy, izz, ixy, ixz, iyz = (*item.inertia, 0.0, 0.0, 0.0)[:6]
        return np.array([[ixx, ixy, ixz], [ixy, iyy, iyz], [ixz, iyz, izz]]) / item.mass
    if item.size is not None:
        square = np.square(item.size)
        return np.diag(square.sum() - square) / 12.0
    radius, height = getattr(item, "radius", 0.0), getattr(item, "height", 0.0)
    across = radius**2 / 4.0 + height**2 / 12.0
    return np.diag([across, across, radius**2 / 2.0])


def links(config: Config, robot: Robot) -> list[Body]:
    """Return the links with uncertain mass or centre of mass, each with its nominal link of opposite mass."""
    uncertain = {*config.uncertainty.mass, *config.uncertainty.center_of_mass} & {*robot.body_names}
    bodies = []
    for name in sorted(uncertain - {TRAY, *config.objects}):
        mass, center, inertia = robot.inertia_of(name)
        bodies.append(Body(name, name, mass, center, np.eye(3), inertia / mass))
        bodies.append(Body(f"nominal {name}", name, -mass, center, np.eye(3), inertia / mass))
    return bodies


def fingers(config: Config, patches: Sequence[Patch]) -> dict[int, Body]:
    """Return the driven fingers that have a mass, as point masses at their pads, by the index of their patch."""
    found = {}
    for index, patch in enumerate(patches):
        own = config.objects.get(patch.object) if patch.law is Law.DRIVEN_PAD else None
        if own is not None and own.held_by is not None and own.held_by.grip is not None:
            name, mass = f"finger of {patch.object}", own.held_by.grip.finger_mass
            if mass > 0.0:
                found[index] = Body(name, CARRIER, mass, patch.origin, np.eye(3), np.zeros((3, 3)), False)
    return found


@dataclass(frozen=True, eq=False)
class Parameters:
    """Values of everything that may be uncertain; each array may have further axes at its end.

    Attributes:
        mass: mass of each body (B,) [kg].
        com: displacement of each centre of mass, body axes (B, 3) [m].
        friction: coefficient of friction of each contact (I,).
        force: vacuum or closing force of each contact, 0 without one, then the internal force between hands (I + 1,)
            [N].
        shift: displacement of each contact point, axes of its support (2, Q) [m].
        error: acceleration error of each coordinate (n,) [rad/s^2 or m/s^2].
    """

    mass: Array
    com: Array
    friction: Array
    force: Array
    shift: Array
    error: Array

    def arrays(self) -> tuple[Array, ...]:
        """Return the arrays in the order of the fields."""
        return self.mass, self.com, self.friction, self.force, self.shift, self.error

    def at(self, index: int | Indices | slice) -> Parameters:
        """Return some of the sets of values, selected along the last axis."""
        return Parameters(*(values[..., index] for values in self.arrays()))

    def repeated(self, count: int) -> Parameters:
        """Return one set of values, repeated `count` times along a new last axis."""
        return Parameters(*(np.repeat(values[..., None], count, axis=-1) for values in self.arrays()))
