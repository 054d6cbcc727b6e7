"""Parts that suction cups or a gripper hold, on a carriage of three slides whose tool points down."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from scenes import FIXTURES
from scipy.optimize import linprog

from robustopt.config import Config
from robustopt.config.load import with_values
from robustopt.limits.systems import ContactSystem, object_systems

PLATE = [0.3, 0.3, 0.01]
"""Edges of a part whose centre of mass is right below the lips [m]."""

FAR = 1e6
"""Steps as long as this count as endless."""


def cup(radius: float = 0.03, force: Any = 30.0, at: Sequence[float] = (0.0, 0.0), **keys: Any) -> dict[str, Any]:
    return cups((*at, radius), force=force, **keys)


def cups(*places: Sequence[float], force: Any = 30.0, **keys: Any) -> dict[str, Any]:
    """Suction cups at (x, y, radius) each."""
    given = [{"at": [x, y], "radius": radius} for x, y, radius in places]
    return {"suction": {"cups": given, "force": force, **keys}}


def grip(pad: Sequence[float] = (0.02, 0.02), force: Any = 40.0, **keys: Any) -> dict[str, Any]:
    return {"grip": {"pad": list(pad), "force": force, **keys}}


def holding(
    held_by: Mapping[str, Any],
    joints: Sequence[Sequence[float]] = ((0.0, 0.0, 0.0), (1.0, 0.0, 0.0)),
    *,
    mu: Any = 0.5,
    edges: int = 16,
    points: int = 8,
    objects: Mapping[str, Any] | None = None,
    sections: Mapping[str, Any] | None = None,
    **part: Any,
) -> Config:
    """A checked configuration: the carriage moves one part of 1 kg along straight lines of its joints.

    mu: friction; edges, points: of friction cones and lips; objects: more objects; sections: more sections; other
    keywords are keys of the part
    """
    body = {"shape": "box", "size": PLATE, "mass": 1.0, "held_by": held_by, **part}
    data: dict[str, Any] = {
        "name": "held",
        "robot": {"model": "three_slides.xml", "tool": "tool", "collision": {"check": False}},
        "objects": {"part": body, **(objects or {})},
        "contact": {"friction": mu, "cone_edges": edges, "patch_points": points},
        "path": {"joints": [list(row) for row in joints]},
        "solver": {"method": "reachability", "collocation_points": 20},
        **(sections or {}),
    }
    return with_values(Config.model_validate({**data, "folder": FIXTURES}), {})


def system_of(config: Config) -> ContactSystem:
    """The only contact system of a configuration, moments about the tool."""
    (system,) = object_systems(config, dict.fromkeys(config.contact_owners, config.contact.friction), {})
    return system


def friction_edges(mu: float, edges: int) -> np.ndarray:
    """Tangential forces (edges, 2) of the friction polygon for a unit normal force."""
    angle = 2 * np.pi * np.arange(edges) / edges
    return mu * np.column_stack([np.cos(angle), np.sin(angle)])


def edge_wrenches(points: np.ndarray, axes: np.ndarray, mu: float, edges: int) -> np.ndarray:
    """Wrenches (6, n * edges) of unit normal force along all friction edges at points (n, 3), about the origin."""
    columns = []
    for point in points:
        for tangential in friction_edges(mu, edges):
            force = axes @ np.array([*tangential, 1.0])
            columns.append(np.r_[force, np.cross(point, force)])
    return np.array(columns).T


def largest_step(columns: np.ndarray, start: np.ndarray, step: np.ndarray) -> float:
    """Largest t for which start + t step = columns @ z for some z >= 0, by linear programming; rows of any size."""
    scale = 1.0 / np.abs(np.column_stack([columns, step])).max(axis=1)
    k = columns.shape[1]
    answer = linprog(
        np.r_[np.zeros(k), -1.0],
        A_eq=np.column_stack([columns, -step]) * scale[:, None],
        b_eq=start * scale,
        bounds=[(0, None)] * k + [(0, FAR)],
        method="highs",
        options={"primal_feasibility_tolerance": 1e-10, "dual_feasibility_tolerance": 1e-10},
    )
    assert answer.status == 0, answer.message
    return float(answer.x[-1]) if answer.x[-1] < FAR else np.inf


def step_by_rows(rows: np.ndarray, start: np.ndarray, step: np.ndarray) -> float:
    """Largest t for which rows @ (start + t step) <= 0."""
    rate = rows @ step
    leaving = rate > 1e-14 * np.abs(rows).max()
    longest = np.min(-(rows @ start)[leaving] / rate[leaving], initial=np.inf)
    return float(longest) if longest < FAR else np.inf
