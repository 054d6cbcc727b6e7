"""Contacts of a robot on its feet: one contact system per stance.

A stance is a phase of the path in which the same contacts rest in the same places: one foot or both, and a hand that is
on a rail. The wrench that the robot needs, about the world's origin, must lie in the cone of all their forces. There is
a direction that all these forces point along, for level soles up; the facets of the cone are those of the hull of its
section by unit force in that direction.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache

import numpy as np
from scipy.spatial import ConvexHull

from robustopt.errors import ConfigError
from robustopt.geometry import RESOLUTION, area, common_direction, contact_axes, erode
from robustopt.limits.contact import ContactSystem, about_point, patch_facets, tips, wrench_generators
from robustopt.path.footsteps import Stance

Array = np.ndarray

FACET_MERGE = 1e-9
"""Facets whose normals agree to this are one that the hull code has triangulated."""

ROBOT = "robot"
"""Name of the one body that the contacts balance: the robot as a whole."""


def eroded_sole(points: Array, shift: float, name: str) -> Array:
    """Contact points of a foot or hand (k, 3) with each one `shift` inside its place along x and y: what is left (k, 2)
    [m].

    Raises ConfigError if nothing is left.
    """
    polygon = points[:, :2]
    left = erode(polygon, shift)
    if len(left) < 3 or area(left) < RESOLUTION**2:
        x, y = np.ptp(polygon, axis=0)
        size, most = f"{name}, {x:g} by {y:g} m", min(x, y) / 2
        message = f"found {shift:g} m, which leaves nothing of {size}; expected less than {most:g} m"
        raise ConfigError(message, "uncertainty.contact_points")
    return left


def stance_system(
    stance: Stance, soles: Mapping[str, Array], friction: Mapping[str, float], edges: int
) -> ContactSystem:
    """The contact system of a stance: wrenches about the world's origin.

    soles: contact points of each contact around its middle, (k, 2) [m]; friction: coefficient of each
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
        generators=generators,
        facets=facets,
        kinds=tips(facets, generators, edges).astype(np.int64),
        names=(f"slip of {stance.words}", f"tipping over {stance.words}"),
        edges=edges,
        interfaces=names,
    )


Rows = tuple[tuple[float, ...], ...]
Key = tuple[Rows, float, Rows]


def _key(points: Array, mu: float, axes: Array) -> Key:
    """A contact as something that can be looked up: its points (k, 3), friction and axes (3, 3)."""
    return _rows(points), mu, _rows(axes)


def _rows(array: Array) -> Rows:
    return tuple(map(tuple, np.round(array, 12).tolist()))


@lru_cache(maxsize=64)
def _joint_facets(contacts: tuple[Key, ...], edges: int) -> Array:
    """Facets of several contacts with a coefficient of friction each, moments about a point between them, (F, 6).

    Scaled to -1 for the mean of all edge forces, whose part along the common direction is 1: for level soles to a
    coefficient -1 of the normal force, as those of one patch. Raises ValueError where there is no common direction.
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
    """Matrix that takes wrenches into axes whose z is a direction, (6, 6)."""
    least = np.eye(3)[int(np.argmin(np.abs(direction)))]
    axes = np.eye(3) if direction[2] == 1.0 else contact_axes(direction, least)
    turn = np.zeros((6, 6))
    turn[:3, :3] = turn[3:, 3:] = axes.T
    return turn
