"""Environment contacts of a walking robot: the soles of its feet, and the palm of a hand that rests on a rail."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from robustopt.arrays import Array
from robustopt.config import FEET, Config
from robustopt.errors import RobotError
from robustopt.geometry import rectangle

FLAT = 1e-6
"""Largest distance of a contact point from the plane of its site [m]: rounding of the numbers in a file."""


@dataclass(frozen=True)
class Sole:
    """The contact points of a foot or hand.

    Attributes:
        points: contact points, counter-clockwise in the plane z = 0 of the frame of its site (k, 3) [m].
    """

    points: Array


def environment_contacts(model: mujoco.MjModel, config: Config, file: str) -> dict[str, Sole]:
    """Return the contacts of a robot with its environment by name: its feet, and the hand on a rail if there is one.

    Args:
        model: the model as in its file.
        config: the configuration.
        file: name of the model file, for messages.

    Raises:
        RobotError: a site is missing, or a foot has too few contact points or points outside the plane of its site.
    """
    rail = config.path.rail
    contacts = {name: _sole(model, name, file) for name in config.environment_contacts if name in FEET}
    if rail is not None:
        _require_site(model, rail.contact, "palm", file)
        contacts[rail.contact] = Sole(_palm(rail.size))
    return contacts


def _require_site(model: mujoco.MjModel, name: str, place: str, file: str) -> None:
    if name not in [model.site(k).name for k in range(model.nsite)]:
        raise RobotError(f"{file} has no site {name!r} in the middle of a {place}", key="robot.model")


def _palm(size: tuple[float, float]) -> Array:
    """Return the corners of the part of a palm that touches a rail, (4, 3) in the frame of its site [m]."""
    return np.column_stack([rectangle(np.zeros(2), np.array(size)), np.zeros(4)])


def _sole(model: mujoco.MjModel, name: str, file: str) -> Sole:
    """Find the contact points of a foot: the lowest points of the spheres on its body that can touch."""
    _require_site(model, name, "sole", file)
    site = model.site(name)
    spheres = _spheres(model, int(site.bodyid[0]))
    if len(spheres) < 3:
        raise RobotError(
            f"{file} has {len(spheres)} spheres that can touch on the body of {name}; expected at least 3, its contact "
            "points",
            key="robot.model",
        )
    into_site = np.zeros(9)
    mujoco.mju_quat2Mat(into_site, site.quat)
    centers = (model.geom_pos[spheres] - site.pos) @ into_site.reshape(3, 3)
    points = centers - model.geom_size[spheres, :1] * np.array([0.0, 0.0, 1.0])
    if np.abs(points[:, 2]).max() > FLAT:
        raise RobotError(f"{file}: the contact points of {name} are not in the plane of its site", key="robot.model")
    middle = points.mean(axis=0)
    order = np.argsort(np.arctan2(points[:, 1] - middle[1], points[:, 0] - middle[0]))
    return Sole(points[order])


def _spheres(model: mujoco.MjModel, body: int) -> list[int]:
    """List the spheres of a body that can touch something."""
    touching = model.geom_contype | model.geom_conaffinity
    sphere = mujoco.mjtGeom.mjGEOM_SPHERE
    return [
        k for k in range(model.ngeom) if model.geom_bodyid[k] == body and model.geom_type[k] == sphere and touching[k]
    ]
