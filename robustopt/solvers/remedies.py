"""Candidates for remedies: keys of a configuration that affect limits in conflict, with their most generous values."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from robustopt.config import Config
from robustopt.config.per_name import value_of
from robustopt.limits import LimitKind, LimitName, TimeScalingProblem
from robustopt.limits.systems import carried
from robustopt.limits.uncertainty import friction
from robustopt.robot import Robot
from robustopt.scene.placement import TRAY

MOST_FRICTION = 10.0
"""Largest coefficient of friction that is tried: more than any dry contact has (our choice)."""

MOST_JOINT_LIMIT = 100.0
"""Largest factor by which the limit of a joint or a point is raised (our choice)."""

MOST_FORCE = 100.0
"""Largest factor by which the force of a tool is raised (our choice)."""


@dataclass(frozen=True)
class Candidate:
    """A key of the configuration that may be changed.

    Attributes:
        key: the key, as in the user's configuration.
        found: present value.
        generous: most generous value to try.
        write: function that returns the changes of a configuration for a value.
        nominal: key and present value of the nominal value, which is raised with the lower end of its interval.
    """

    key: str
    found: float
    generous: float
    write: Callable[[Config, float], dict[str, Any]]
    nominal: tuple[str, float] | None = None

    def value(self, share: float) -> float:
        """Return a value between the present and the most generous one.

        Args:
            share: 0 for the present value, 1 for the most generous one.
        """
        if self.generous > self.found > 0:
            return float(self.found * (self.generous / self.found) ** share)
        return self.found + share * (self.generous - self.found)

    def share(self, value: float) -> float:
        """Return how far a value is on the way from the present to the most generous one, from 0 to 1.

        Args:
            value: the value.
        """
        if self.generous > self.found > 0:
            return float(np.log(value / self.found) / np.log(self.generous / self.found))
        return (value - self.found) / (self.generous - self.found)


def candidates(problem: TimeScalingProblem, conflict: Collection[str]) -> Iterator[Candidate]:
    """Yield the keys that affect limits in conflict.

    Args:
        problem: the problem.
        conflict: names of the limits.
    """
    config, robot = problem.config, problem.robot
    yield from _joint_candidates(robot, conflict)
    if problem.s[0] == 0.0:  # else the path is the rest of another one
        yield from _shrinking("path.start_speed", "", config.path.start_speed, config.path.start_speed)
    yield from _shrinking("path.end_speed", "", config.path.end_speed, config.path.end_speed)
    systems = [limit.system for limit in problem.limits.contacts if set(limit.names) & set(conflict)]
    touched = [name for system in systems for name in system.contacts]
    if touched:
        yield from _friction_candidates(config, touched)
        yield from _force_candidates(config, [name for system in systems for name in system.pressed])
    yield from _error_candidates(config)
    if touched and config.uncertainty.contact_points is not None:
        widths = config.uncertainty.contact_points
        widest = max(widths.values(), default=0.0) if isinstance(widths, dict) else widths
        yield from _shrinking("uncertainty.contact_points", "widest", widest, widths)
    torque = any(f"{joint} torque" in conflict for joint in robot.joint_names)
    yield from _body_candidates(problem, _loaded(problem, touched, torque))


def _joint_candidates(robot: Robot, conflict: Collection[str]) -> Iterator[Candidate]:
    for j, joint in enumerate(robot.joint_names):
        own = robot.limits
        for quantity, limits in (("acceleration", own.acceleration), ("torque", own.torque), ("jerk", own.jerk)):
            if f"{joint} {quantity}" in conflict:
                key, limit = f"robot.limits.{joint}.{quantity}", float(limits[j])
                yield Candidate(key, limit, MOST_JOINT_LIMIT * limit, _written_at(key))
    for point in robot.points:
        if LimitName(LimitKind.CARTESIAN_ACCELERATION, point.name) in conflict:
            key = f"robot.limits.cartesian.{point.name}.acceleration"
            yield Candidate(key, point.acceleration, MOST_JOINT_LIMIT * point.acceleration, _written_at(key))


def _written_at(key: str) -> Callable[[Config, float], dict[str, Any]]:
    """Return a function that writes a value at a key."""
    return lambda _, value: {key: value}


def _force_candidates(config: Config, pressed: Collection[str]) -> Iterator[Candidate]:
    """Yield the forces of the tools that hold objects."""
    for name in dict.fromkeys(pressed):
        held = config.objects[name].held_by
        assert held is not None
        key = f"objects.{name}.held_by.{'suction' if held.suction else 'grip'}.force"
        force = held.tool.force
        low, high = force if isinstance(force, tuple) else (force, force)

        def raised(_: Config, value: float, key: str = key, high: float = high, given: Any = force) -> dict[str, Any]:
            return {key: [value, max(value, high)] if isinstance(given, tuple) else value}

        yield Candidate(key, low, MOST_FORCE * low, raised)


def _body_candidates(problem: TimeScalingProblem, loaded: set[str]) -> Iterator[Candidate]:
    uncertain = problem.config.uncertainty
    for name in loaded & set(uncertain.center_of_mass):
        reach = uncertain.center_of_mass[name]
        yield from _shrinking(f"uncertainty.center_of_mass.{name}", "largest", max(reach), list(reach))
    for name in loaded & set(uncertain.mass):
        low, high = uncertain.mass[name]
        mass = _mass(problem, name)

        def narrowed(
            _: Config, width: float, key: str = name, m: float = mass, a: float = low, b: float = high
        ) -> dict[str, Any]:
            share = width / (b - a)
            return {f"uncertainty.mass.{key}": [m - share * (m - a), m + share * (b - m)]}

        if high > low:
            yield Candidate(f"uncertainty.mass.{name}, width", high - low, 0.0, narrowed)


def _loaded(problem: TimeScalingProblem, touched: Collection[str], torque: bool) -> set[str]:
    """Return the bodies whose mass and centre of mass affect the `touched` contacts, or joint torques."""
    config = problem.config
    if torque or set(touched) & set(config.environment_contacts):
        return {*config.uncertainty.center_of_mass, *config.uncertainty.mass}
    owners = {config.contact_owners[name] for name in touched}
    return {body for name in owners for body in carried(config, name)}


def _mass(problem: TimeScalingProblem, name: str) -> float:
    """Return the nominal mass of a body [kg]."""
    config = problem.config
    if name in config.objects:
        return config.objects[name].mass
    return config.tray.mass if config.tray is not None and name == TRAY else problem.robot.inertia_of(name)[0]


def _error_candidates(config: Config) -> Iterator[Candidate]:
    """Yield the acceleration error of a floating base, and the joints' error: its deviations K and its mean."""
    base = config.uncertainty.base_acceleration
    given = list(base) if isinstance(base, tuple) else base
    yield from _shrinking("uncertainty.base_acceleration", "largest", float(np.max(base)), given)
    error = config.uncertainty.joint_acceleration
    key = "uncertainty.joint_acceleration"
    if error is not None and error.K > 0 and np.any(np.asarray(error.deviation) > 0):
        yield Candidate(f"{key}.K", error.K, 0.0, _written_at(f"{key}.K"))
    if error is not None:
        mean = list(error.mean) if isinstance(error.mean, tuple) else error.mean
        yield from _shrinking(f"{key}.mean", "largest", float(np.max(np.abs(mean))), mean)


def _shrinking(key: str, note: str, largest: float, values: Any) -> Iterator[Candidate]:
    """Yield a candidate that scales all values at a key (a number, a list or a mapping of numbers) by one factor."""

    def scaled(given: Any, factor: float) -> Any:
        if isinstance(given, dict):
            return {name: factor * value for name, value in given.items()}
        return [factor * value for value in given] if isinstance(given, list) else factor * given

    if largest > 0:
        label = key if isinstance(values, float) else f"{key}, {note}"
        yield Candidate(label, largest, 0.0, lambda _, value: {key: scaled(values, value / largest)})


def _friction_candidates(config: Config, touched: Collection[str]) -> Iterator[Candidate]:
    """Yield the coefficient of friction that all contacts share, or the coefficients that single contacts have."""
    interval, known = config.uncertainty.friction, friction(config)
    base = "contact.friction" if interval is None else "uncertainty.friction"
    source = config.contact.friction if interval is None else interval
    if not isinstance(source, dict):
        groups: dict[str, list[str]] = {base: list(config.contact_owners)}
    else:
        own = {name: _key_of(name, owner, source) for name, owner in config.contact_owners.items()}
        rest = [name for name, key in own.items() if key is None]
        groups = {}
        for name in touched:
            if own[name] is not None:
                groups.setdefault(f"{base}.{own[name]}", []).append(name)
        if set(rest) & set(touched) and "default" in source:
            groups[f"{base}.default"] = rest
    for key, names in groups.items():

        def lifted(config: Config, value: float, names: Sequence[str] = tuple(names)) -> dict[str, Any]:
            return _with_friction(config, names, value)

        nominal = min(value_of(config.contact.friction, (name, config.contact_owners[name]), 0.0) for name in names)
        raised = None if interval is None else (key.replace("uncertainty", "contact"), nominal)
        yield Candidate(key, min(known[name][0] for name in names), MOST_FRICTION, lifted, raised)


def _with_friction(config: Config, names: Collection[str], value: float) -> dict[str, Any]:
    """Return the changes that raise the friction of some contacts to at least `value`, nominal value and interval."""
    points: dict[str, float] = {}
    intervals: dict[str, list[float]] = {}
    for name, owner in config.contact_owners.items():
        point = value_of(config.contact.friction, (name, owner), 0.0)
        interval = value_of(config.uncertainty.friction, (name, owner), None)
        least = value if name in names else 0.0
        if interval is not None:
            intervals[name] = [max(interval[0], least), max(interval[1], least)]
            point = min(max(point, intervals[name][0]), intervals[name][1])
        points[name] = max(point, least)
    changes: dict[str, Any] = {"contact.friction": points}
    return changes | ({"uncertainty.friction": intervals} if intervals else {})


def _key_of(name: str, owner: str, given: Mapping[str, Any]) -> str | None:
    """Return the key under which a contact has a value of its own, None if it has none."""
    return next((key for key in (name, owner) if key in given), None)
