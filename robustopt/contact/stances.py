"""Contacts of a robot on its feet: one contact system per stance.

A stance is a phase of the path in which the same feet stand in the same places. The wrench that the robot needs, about
the world's origin, must lie in the cone of all contact forces of the standing feet. The soles are level, so every edge
of a friction cone has a unit normal force, and the facets of the cone are those of the hull of its section.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache

import numpy as np
from scipy.spatial import ConvexHull

from robustopt.config.geometry import RESOLUTION, area, erode
from robustopt.contact import ContactSystem, about_point, patch_facets, tips, wrench_generators
from robustopt.errors import ConfigError
from robustopt.path.footsteps import Stance

Array = np.ndarray

FACET_MERGE = 1e-9
"""Facets whose normals agree to this are one that the hull code has triangulated."""

ROBOT = "robot"
"""Name of the one body that the feet balance: the robot as a whole."""


def sole(points: Array, shift: float, name: str) -> Array:
    """Contact points of a foot (k, 3) with each one `shift` inside its place along x and y: what is left (k, 2) [m].

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

    soles: contact points of each foot around its middle, (k, 2) [m]; friction: coefficient under each foot
    """
    feet = stance.feet
    points = [np.column_stack([soles[name] + stance.places[name], np.zeros(len(soles[name]))]) for name in feet]
    parts = [wrench_generators(p, friction[name], edges) for p, name in zip(points, feet, strict=True)]
    if len(feet) == 1:
        center = np.append(stance.places[feet[0]], 0.0)
        facets = patch_facets(soles[feet[0]], friction[feet[0]], edges)
    else:
        center = np.concatenate(points).mean(axis=0)
        facets = _joint_facets(
            tuple(_key(p - center, friction[name]) for p, name in zip(points, feet, strict=True)), edges
        )
    where = f"{feet[0].replace('_', ' ')}" if len(feet) == 1 else "both feet"
    facets, generators = facets @ about_point(center), np.hstack(parts)
    return ContactSystem(
        objects=(ROBOT,),
        loads=((ROBOT,),),
        points=(np.zeros(3),),
        generators=generators,
        facets=facets,
        kinds=tips(facets, generators, edges).astype(np.int64),
        names=(f"slip of {where}", f"tipping over {where}"),
        edges=edges,
        interfaces=feet,
    )


Key = tuple[tuple[tuple[float, ...], ...], float]


def _key(points: Array, mu: float) -> Key:
    return tuple(map(tuple, np.round(points[:, :2], 12).tolist())), mu


@lru_cache(maxsize=64)
def _joint_facets(feet: tuple[Key, ...], edges: int) -> Array:
    """Facets of several level feet with a coefficient of friction each, moments about a point between them, (F, 6).

    Scaled to a coefficient -1 of the normal force, as those of one patch.
    """
    parts = [wrench_generators(np.column_stack([p, np.zeros(len(p))]), mu, edges) for p, mu in feet]
    section = np.hstack(parts)[[0, 1, 3, 4, 5]].T
    size = np.abs(section).max(axis=0)
    equations = ConvexHull(section / size).equations
    facets = np.column_stack([equations[:, :2], equations[:, 5], equations[:, 2:5]])
    facets /= np.array([size[0], size[1], 1.0, size[2], size[3], size[4]])
    facets /= -facets[:, 2:3]
    _, first = np.unique(np.round(facets * np.r_[size[:2], 1.0, size[2:]] / FACET_MERGE), axis=0, return_index=True)
    return np.asarray(facets[np.sort(first)])
