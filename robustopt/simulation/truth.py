"""What the simulated world really is: true friction, masses, centres of mass and contact geometry of a trial.

Where `execution.truth` says nothing, the world is as the planner believes. Values that vary are drawn anew for each
trial, from the generator of that trial.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from robustopt.config import Config, ObjectConfig, TrayConfig, TruthConfig, VariationConfig
from robustopt.limits.bodies import INERTIA_TERMS, inertia_matrix

Array = np.ndarray

Draw = Callable[[float, float, bool], float]
"""Draws about a value with a deviation; the last argument says whether the result must be above 0."""


@dataclass(frozen=True)
class TrueBody:
    """The tray, an object or a body of the robot.

    mass [kg]; center_of_mass: in its own frame (3,) [m]; inertia: about that (3, 3) [kg m^2]; inset: how much smaller
    than the shape its base is on every side [m]
    """

    mass: float
    center_of_mass: Array
    inertia: Array
    inset: float = 0.0


@dataclass(frozen=True)
class World:
    """friction: coefficient of the interface under each object, foot or hand; bodies: the tray (`tray`) and the objects
    by name, or those of the robot that the truth says something about."""

    friction: Mapping[str, float]
    bodies: Mapping[str, TrueBody]


def varies(truth: TruthConfig) -> bool:
    """Whether the world differs from trial to trial."""
    varied = truth.variation
    spreads = [*_numbers(varied.friction), *varied.mass.values()]
    spreads += [value for vector in varied.center_of_mass.values() for value in vector]
    return any(value > 0 for value in spreads)


def believed_world(config: Config) -> World:
    """The world of the planner's point values, of a robot with a tray."""
    friction = believed_friction(config)
    bodies = {"tray": _believed_body(config.carried_tray)}
    return World(friction, bodies | {name: _believed_body(item) for name, item in config.objects.items()})


def believed_friction(config: Config) -> dict[str, float]:
    """What the planner takes for the coefficient of friction of each interface."""
    return {name: _of(config.contact.friction, name) for name in config.interfaces}


def _believed_body(item: TrayConfig | ObjectConfig) -> TrueBody:
    return TrueBody(item.mass, np.array(item.center_of_mass), inertia_matrix(item))


def true_world(believed: World, truth: TruthConfig, random: np.random.Generator) -> World:
    """The world of one trial, whose objects are those of what is believed."""
    draw = _sampler(truth.variation, random)
    friction = {}
    for name, belief in believed.friction.items():
        value = _of(truth.friction, name, belief)
        friction[name] = draw(value, _of(truth.variation.friction, name, 0.0), True)
    return World(friction, {name: _true_body(name, body, truth, draw) for name, body in believed.bodies.items()})


def _true_body(name: str, belief: TrueBody, truth: TruthConfig, draw: Draw) -> TrueBody:
    mass = draw(truth.mass.get(name, belief.mass), truth.variation.mass.get(name, 0.0), True)
    centre = truth.center_of_mass.get(name, tuple(belief.center_of_mass))
    spread = truth.variation.center_of_mass.get(name, (0.0, 0.0, 0.0))
    centre_drawn = np.array([draw(value, reach, False) for value, reach in zip(centre, spread, strict=True)])
    inertia = belief.inertia * (mass / belief.mass)
    if name in truth.inertia:
        inertia = np.zeros((3, 3))
        for value, (i, j) in zip(truth.inertia[name], INERTIA_TERMS, strict=False):
            inertia[i, j] = inertia[j, i] = value
    return TrueBody(mass, centre_drawn, inertia, truth.contact_inset.get(name, 0.0))


def _sampler(variation: VariationConfig, random: np.random.Generator) -> Draw:
    def draw(value: float, deviation: float, positive: bool) -> float:
        if deviation == 0:
            return value
        while True:
            unit = random.standard_normal() if variation.distribution == "normal" else random.uniform(-1.0, 1.0)
            drawn = value + deviation * unit
            if drawn > 0 or not positive:
                return float(drawn)

    return draw


def _of(values: float | Mapping[str, float] | None, name: str, otherwise: float = np.nan) -> float:
    if values is None:
        return otherwise
    return values.get(name, values.get("default", otherwise)) if isinstance(values, Mapping) else values


def _numbers(values: float | Mapping[str, float]) -> list[float]:
    return list(values.values()) if isinstance(values, Mapping) else [values]
