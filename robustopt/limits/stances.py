"""Contacts of a walking robot with its environment: one contact system per stance.

A stance is a phase of the path in which the same contacts rest in the same places: one foot or both, and a hand on a
rail. The held body is the floating base; its required wrench, about the world's origin, must lie in the cone of all
contact forces. There is a direction along which all these forces have a positive component: up for level soles. The
facets of the cone follow from the hull of its section by unit force in this direction.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache

import numpy as np
from scipy.spatial import ConvexHull

from robustopt.arrays import Array
from robustopt.errors import ConfigError
from robustopt.geometry import RESOLUTION, area, common_direction, contact_axes, erode
from robustopt.limits.cones import FACET_MERGE, about_point, into_axes, patch_facets, tipping_rows, wrench_generators
from robustopt.limits.names import LimitKind, LimitName
from robustopt.limits.systems import ContactSystem
from robustopt.path.footsteps import Stance

ROBOT = "robot"
"""Name of the held body that the environment contacts support: the robot as a whole."""


def eroded_sole(points: Array, shift: float, name: str) -> Array:
    """Return the part of a foot's or hand's contact that is certain.

    Args:
        points: contact points in the frame of the contact (k, 3) [m].
        shift: largest displacement of each point from its nominal position along x and along y [m].
        name: name of the contact.

    Returns:
        Corners (k, 2) [m].

    Raises:
        ConfigError: no part is certain.
    """
    polygon = points[:, :2]
    left = erode(polygon, shift)
    if len(left) < 3 or area(left) < RESOLUTION**2:
        x, y = np.ptp(polygon, axis=0)
        size, most = f"{name}, {x:g} by {y:g} m", min(x, y) / 2
        message = f"found {shift:g} m, which leaves no certain part of {size}; expected less than {most:g} m"
        raise ConfigError(message, "uncertainty.contact_points")
    return left


def stance_system(
    stance: Stance, soles: Mapping[str, Array], friction: Mapping[str, float], edges: int
) -> ContactSystem:
    """Return the contact system of a stance, wrenches about the world's origin, world axes.

    Args:
        stance: the stance.
        soles: contact points of each contact about its centre (k, 2) [m].
        friction: coefficient of friction of each contact.
        edges: number of edges of each friction cone.
    """
    names = stance.contacts
    points = [place.world(soles[name]) for name, place in stance.places.items()]
    parts = [
        wrench_generators(p, friction[name], edges, place.axes)
        for p, (name, place) in zip(points, stance.places.items(), strict=True)
    ]
    if len(names) == 1:
        center = stance.places[names[0]].position
        facets = patch_facets(soles[names[0]], friction[names[0]], edges)
    else:
        center = np.concatenate(points).mean(axis=0)
        keys = [
            _key(p - center, friction[name], place.axes)
            for p, (name, place) in zip(points, stance.places.items(), strict=True)
        ]
        facets = _joint_facets(tuple(keys), edges)
    facets, generators = facets @ about_point(center), np.hstack(parts)
    return ContactSystem(
        objects=(ROBOT,),
        loads=((ROBOT,),),
        points=(np.zeros(3),),
        pressed=(),
        generators=generators,
        edges_of_friction=np.ones(generators.shape[1], dtype=bool),
        facets=facets,
        complete=True,
        kinds=tipping_rows(facets, generators, edges).astype(np.intp),
        names=(LimitName(LimitKind.SLIP, stance.words), LimitName(LimitKind.TIPPING, stance.words)),
        edges=edges,
        contacts=names,
    )


Rows = tuple[tuple[float, ...], ...]
Key = tuple[Rows, float, Rows]


def _key(points: Array, mu: float, axes: Array) -> Key:
    """Return a contact as a key: its points (k, 3), friction and axes (3, 3)."""
    return _rows(points), mu, _rows(axes)


def _rows(array: Array) -> Rows:
    return tuple(map(tuple, np.round(array, 12).tolist()))


@lru_cache(maxsize=64)
def _joint_facets(contacts: tuple[Key, ...], edges: int) -> Array:
    """Return the facets of several contacts, moments about a point between them, (F, 6).

    They are scaled to -1 for the mean of all edge forces, each with a component of 1 along the common direction. For
    level soles this is a coefficient -1 of the normal force, as for the facets of one patch.

    Raises:
        ValueError: there is no common direction.
    """
    frames = [np.array(axes) for _, _, axes in contacts]
    direction = common_direction([axes[:, 2] for axes in frames], [mu for _, mu, _ in contacts])
    if direction is None:
        raise ValueError("contacts that can press against each other have no common direction")
    turn = _turn_to(direction)
    parts = [
        wrench_generators(np.array(points), mu, edges, axes)
        for (points, mu, _), axes in zip(contacts, frames, strict=True)
    ]
    turned = turn @ np.hstack(parts)
    section = (turned / turned[2])[[0, 1, 3, 4, 5]].T
    middle = np.round(section.mean(axis=0), 12)
    section = section - middle
    size = np.abs(section).max(axis=0)
    equations = ConvexHull(section / size).equations
    normals, distance = equations[:, :5], -equations[:, 5]
    rows = normals / distance[:, None]
    _, first = np.unique(np.round(rows / FACET_MERGE), axis=0, return_index=True)
    rows = rows[np.sort(first)] / size
    facets = np.insert(rows, 2, -1.0 - rows @ middle, axis=1)
    return np.asarray(facets @ turn)


def _turn_to(direction: Array) -> Array:
    """Return the matrix that takes wrenches into axes whose z is a direction, (6, 6)."""
    least = np.eye(3)[int(np.argmin(np.abs(direction)))]
    return into_axes(np.eye(3) if direction[2] == 1.0 else contact_axes(direction, least))
