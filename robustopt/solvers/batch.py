"""Plans of one task for many settings of what is believed: friction, masses, centres of mass, errors.

Robot, path and their dynamics are shared; what a setting changes is computed anew, by the functions that plan a single
task. So a plan of a batch is the plan of its setting bit for bit. Where only durations are asked for, and the work is
worth it, several processes share it: the result does not depend on their number.
"""

from __future__ import annotations

import difflib
import pickle
import time
from collections.abc import Mapping, Sequence
from functools import cached_property, lru_cache
from math import ceil
from typing import Any

import numpy as np

from robustopt.config import Config
from robustopt.config.document import Key, split_key
from robustopt.config.load import with_values
from robustopt.errors import ConfigError, SolverFailed
from robustopt.limits import TimeScalingProblem, rows_along, track_of
from robustopt.limits.track import Track
from robustopt.processes import begun, cores, in_processes
from robustopt.solvers import Plan, Status, solve

Array = np.ndarray
Setting = Mapping[str, float | Sequence[float]]
"""Values by configuration key, such as {"contact.friction.upper": 0.3, "uncertainty.center_of_mass.upper.2": 0.01}."""

BELIEFS = (
    "contact.friction",
    "uncertainty.friction",
    "uncertainty.contact_points",
    "uncertainty.center_of_mass",
    "uncertainty.mass",
    "uncertainty.joint_acceleration",
    "uncertainty.base_acceleration",
    "tray.mass",
    "tray.center_of_mass",
    "tray.inertia",
    "objects.*.mass",
    "objects.*.center_of_mass",
    "objects.*.inertia",
)
"""Keys, or sections of keys, that may differ between the settings of a batch: they concern neither robot nor path."""

ALONE, STARTED = (0.3, 2.0), (0.05, 0.3)
"""How long one process plans before it asks what is left, and the work that it then shares with others [s]: where these
must be started, which takes about as long, and where they are there already."""

PARTS = 8
"""Parts of the work for each process, so that none waits long for the others."""

PER_NAME = ("contact.friction", "uncertainty.friction", "uncertainty.contact_points")
"""Keys with one value for all objects or feet, or one per name."""


class BatchPlanner:
    """Fastest plans of a configuration for any number of settings of its beliefs, by `reachability`.

    Raises ConfigError, RobotError or PathError where the configuration cannot be used. workers: processes that
    durations may be shared among, by default one for each core.
    """

    def __init__(self, config: Config, workers: int | None = None) -> None:
        self.config = config
        self.workers = min(workers or cores(), cores())
        self._durations: dict[tuple[Any, ...], float] = {}

    @cached_property
    def track(self) -> Track:
        """What all plans share."""
        return track_of(self.config)

    def durations(self, settings: Sequence[Setting]) -> Array:
        """Duration of the plan of each setting, (k,) [s]; infinite where there is none. Each is computed once.

        Raises ConfigError where a key is no belief, or a value is not allowed, and SolverFailed where the solver stops
        without an answer.
        """
        keys = [_identity(setting) for setting in settings]
        new = {key: setting for key, setting in zip(keys, settings, strict=True) if key not in self._durations}
        self._durations.update(zip(new, self.plan_durations(list(new.values())), strict=True))
        return np.array([self._durations[key] for key in keys])

    def plan_durations(self, settings: Sequence[Setting]) -> Array:
        """The same, computed anew."""
        found = [self._duration(setting) for setting in settings[:1]]  # this makes what all plans share
        began = time.perf_counter()
        for count, setting in enumerate(settings[1:], 1):
            found.append(self._duration(setting))
            spent, left = time.perf_counter() - began, len(settings) - len(found)
            alone, worthwhile = STARTED if begun(self.workers) else ALONE
            if self.workers > 1 and spent > alone and left * spent / count > worthwhile:
                return np.array(found + self._durations_by_processes(settings[-left:]))
        return np.array(found)

    def _durations_by_processes(self, settings: Sequence[Setting]) -> list[float]:
        size = ceil(len(settings) / (PARTS * self.workers))
        task = pickle.dumps(self.config)
        parts = [(task, list(settings[i : i + size])) for i in range(0, len(settings), size)]
        return [duration for part in in_processes(_durations, parts, self.workers, SolverFailed) for duration in part]

    def plans(self, settings: Sequence[Setting]) -> list[Plan]:
        """The plan of each setting: what `solve(build_problem(config), "reachability")` gives for it."""
        return [self._plan(setting) for setting in settings]

    def problem(self, setting: Setting) -> TimeScalingProblem:
        """The problem of a setting."""
        return rows_along(self.track, with_beliefs(self.config, setting))

    def _plan(self, setting: Setting) -> Plan:
        return solve(self.problem(setting), "reachability")

    def _duration(self, setting: Setting) -> float:
        plan = self._plan(setting)
        if plan.status not in (Status.SOLVED, Status.INFEASIBLE):
            described = ", ".join(f"{key} = {value}" for key, value in setting.items())
            raise SolverFailed(f"no plan for {described}: {plan.message}")
        return plan.duration


def _durations(task: bytes, settings: Sequence[Setting]) -> list[float]:
    """What a worker process does. task: a pickled configuration"""
    planner = _planner_of(task)
    return [planner._duration(setting) for setting in settings]


@lru_cache(maxsize=1)
def _planner_of(task: bytes) -> BatchPlanner:
    """The planner of a worker process, kept from part to part of the same task."""
    return BatchPlanner(pickle.loads(task), workers=1)


def solve_batch(config: Config, settings: Sequence[Setting]) -> list[Plan]:
    """The fastest plan of a configuration for each setting of its beliefs, by `reachability`."""
    return BatchPlanner(config).plans(settings)


def with_beliefs(config: Config, setting: Setting) -> Config:
    """A copy of a configuration with other beliefs.

    A key may name a part of what the configuration writes shorter or not at all: one object's friction where all have
    the same, one axis of a centre of mass, one end of an interval. Raises ConfigError where a key is no belief, or a
    value is not allowed.
    """
    written: dict[str, Any] = {}
    for key in setting:
        _require_belief(config, key)
        written.update(_written_out(config, split_key(key)))
    return with_values(config, {**written, **setting})


def _require_belief(config: Config, key: str) -> None:
    parts = split_key(key)
    section = ".".join(map(str, parts[:2]))
    if parts[0] == "objects" and len(parts) > 2:
        if parts[1] not in config.objects:
            raise ConfigError(f"nothing is called {parts[1]}; expected one of {', '.join(config.objects)}", key)
        section = f"objects.*.{parts[2]}"
    if section not in BELIEFS:
        hint = "".join(f"did you mean {near}? " for near in difflib.get_close_matches(section, BELIEFS, n=1))
        message = f"is no belief that settings may differ in; {hint}expected a value of {', '.join(BELIEFS)}"
        raise ConfigError(message, key)


def _written_out(config: Config, key: Key) -> dict[str, Any]:
    """Values of sections around a key as they would be written for the key to have its place in them."""
    section, kind, *inner = key
    if section == "objects" or not inner:
        return {}
    part, name = f"{section}.{kind}", inner[0]
    whole = getattr(getattr(config, str(section)), str(kind))
    result: dict[str, Any] = {}
    if part in PER_NAME and isinstance(name, str) and not isinstance(whole, dict) and whole is not None:
        result[part] = {"default": whole}
    if part == "uncertainty.friction" and isinstance(inner[-1], int):
        given = {} if whole is None else whole if isinstance(whole, dict) else {"": whole, "default": whole}
        believed = config.contact.friction
        place = name if isinstance(name, str) else ""
        interval = given.get(place, given.get("default"))
        if interval is None:
            value = believed.get(place, believed.get("default")) if isinstance(believed, dict) else believed
            interval = None if value is None else (value, value)
        if interval is not None and place not in given:
            result[f"{part}.{place}" if place else part] = interval
    elif part in ("uncertainty.center_of_mass", "uncertainty.mass") and len(inner) > 1 and name not in whole:
        item = config.tray if name == "tray" else config.objects.get(str(name))
        if kind == "center_of_mass" and (item is not None or config.walks):
            result[f"{part}.{name}"] = (0.0, 0.0, 0.0)
        elif item is not None:
            result[f"{part}.{name}"] = (item.mass, item.mass)
    return result


def _identity(setting: Setting) -> tuple[Any, ...]:
    return tuple(sorted((key, tuple(np.ravel(value).tolist())) for key, value in setting.items()))
