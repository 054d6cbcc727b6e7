"""Parameters of the simulated world: friction, masses, holding forces and contact geometry.

The nominal parameters are those of the plan. The actual ones come from `execution.truth`; a value that it does not give
is nominal. Values that vary are sampled for each trial from the generator of that trial.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from robustopt.arrays import Array
from robustopt.config import Config, ObjectConfig, TrayConfig, TruthConfig, VariationConfig
from robustopt.config.per_name import value_of
from robustopt.errors import ConfigError
from robustopt.limits.bodies import INERTIA_TERMS, inertia_matrix
from robustopt.robot import Robot

Sampler = Callable[[float, float, bool], float]
"""Function that samples about a value with a deviation; the last argument says whether the result must be above 0."""


@dataclass(frozen=True)
class BodyParameters:
    """Inertial parameters of the tray, an object or a body of the robot.

    Attributes:
        mass: mass [kg].
        center_of_mass: centre of mass in the frame of the body (3,) [m].
        inertia: inertia about the centre of mass, axes of the body (3, 3) [kg m^2].
    """

    mass: float
    center_of_mass: Array
    inertia: Array


@dataclass(frozen=True)
class Parameters:
    """Parameters of one world.

    Attributes:
        friction: coefficient of friction by contact.
        bodies: inertial parameters of the tray (`tray`), of the objects, and of the bodies of the robot that
            `execution.truth` names.
        force: force of each cup or of the gripper, by held object [N].
        inset: distance by which a base, sole, palm, lip or pad is smaller than planned on every side, by name [m].
    """

    friction: Mapping[str, float]
    bodies: Mapping[str, BodyParameters]
    force: Mapping[str, float] = field(default_factory=dict)
    inset: Mapping[str, float] = field(default_factory=dict)


def _truth_of(config: Config) -> TruthConfig:
    """Return `execution.truth` of a configuration."""
    return config.execution.truth if config.execution is not None else TruthConfig()


def varies(truth: TruthConfig) -> bool:
    """Check whether the parameters of the world differ from trial to trial.

    Args:
        truth: the section `execution.truth`.
    """
    varied = truth.variation
    spreads = [*_numbers(varied.friction), *varied.mass.values(), *varied.force.values()]
    spreads += [value for vector in varied.center_of_mass.values() for value in vector]
    return any(value > 0 for value in spreads)


def nominal_parameters(config: Config, robot: Robot) -> Parameters:
    """Return the nominal values of the planner; for an interval of force its middle.

    Args:
        config: the configuration.
        robot: the robot.

    Raises:
        ConfigError: `execution.truth` names a body that the robot does not have.
    """
    friction = {
        name: value_of(config.contact.friction, (name, body), np.nan) for name, body in config.contact_owners.items()
    }
    tray = {} if config.tray is None else {"tray": config.tray}
    carried: dict[str, TrayConfig | ObjectConfig] = {**tray, **config.objects}
    bodies = {
        name: BodyParameters(item.mass, np.array(item.center_of_mass), inertia_matrix(item))
        for name, item in carried.items()
    }
    bodies |= {name: BodyParameters(*robot.inertia_of(name)) for name in _named_bodies(config, robot)}
    held = {name: body.held_by.tool.force for name, body in config.objects.items() if body.held_by is not None}
    if config.tray is not None and config.tray.hands is not None:
        held = {"tray": config.tray.hands.force} | held
    return Parameters(friction, bodies, {name: float(np.mean(force)) for name, force in held.items()})


def _named_bodies(config: Config, robot: Robot) -> list[str]:
    """List the bodies of the robot that `execution.truth` names."""
    truth = _truth_of(config)
    given: dict[str, Mapping[str, object]] = {
        "mass": truth.mass, "center_of_mass": truth.center_of_mass, "inertia": truth.inertia,
        "variation.mass": truth.variation.mass, "variation.center_of_mass": truth.variation.center_of_mass,
    }  # fmt: skip
    carried = {"tray", *config.objects}
    for key, values in given.items():
        for name in values:
            if name not in carried and name not in robot.body_names:
                known = ", ".join(robot.body_names)
                message = f"the robot has no body {name} with a mass; expected one of {known}"
                raise ConfigError(message, key=f"execution.truth.{key}.{name}")
    named = {name for values in given.values() for name in values}
    return [name for name in robot.body_names if name in named - carried]


def actual_parameters(nominal: Parameters, config: Config, random: np.random.Generator) -> Parameters:
    """Sample the parameters of one trial.

    Args:
        nominal: nominal parameters.
        config: the configuration.
        random: generator of the trial.
    """
    truth = _truth_of(config)
    sample, varied = _sampler(truth.variation, random), truth.variation
    friction = {}
    for name, value in nominal.friction.items():
        names = (name, config.contact_owners[name])
        middle = value_of(truth.friction, names, value)
        friction[name] = sample(middle, value_of(varied.friction, names, 0.0), True)
    bodies = {name: _actual_body(name, body, truth, sample) for name, body in nominal.bodies.items()}
    force = {
        name: sample(truth.force.get(name, value), varied.force.get(name, 0.0), True)
        for name, value in nominal.force.items()
    }
    return Parameters(friction, bodies, force, truth.contact_inset)


def require_some_left(contact: str, inset: float, reach: Array) -> None:
    """Check that an inset leaves something of a contact.

    Args:
        contact: name of the contact.
        inset: the inset [m].
        reach: distances of the contact points from the middle of the contact [m].

    Raises:
        ConfigError: the inset exceeds one of these distances.
    """
    if np.any(reach < inset):
        message = f"found {inset:g} m, which leaves nothing of {contact}; expected less than {reach.min():g} m"
        raise ConfigError(message, key=f"execution.truth.contact_inset.{contact}")


def _actual_body(name: str, nominal: BodyParameters, truth: TruthConfig, sample: Sampler) -> BodyParameters:
    mass = sample(truth.mass.get(name, nominal.mass), truth.variation.mass.get(name, 0.0), True)
    centre = truth.center_of_mass.get(name, tuple(nominal.center_of_mass))
    spread = truth.variation.center_of_mass.get(name, (0.0, 0.0, 0.0))
    sampled = np.array([sample(value, reach, False) for value, reach in zip(centre, spread, strict=True)])
    inertia = nominal.inertia * (mass / nominal.mass)
    if name in truth.inertia:
        inertia = np.zeros((3, 3))
        for value, (i, j) in zip(truth.inertia[name], INERTIA_TERMS, strict=False):
            inertia[i, j] = inertia[j, i] = value
    return BodyParameters(mass, sampled, inertia)


def _sampler(variation: VariationConfig, random: np.random.Generator) -> Sampler:
    def sample(value: float, deviation: float, positive: bool) -> float:
        if deviation == 0:
            return value
        while True:
            unit = random.standard_normal() if variation.distribution == "normal" else random.uniform(-1.0, 1.0)
            sampled = value + deviation * unit
            if sampled > 0 or not positive:
                return float(sampled)

    return sample


def _numbers(values: float | Mapping[str, float]) -> list[float]:
    return list(values.values()) if isinstance(values, Mapping) else [values]
