"""Plan one task for many settings of friction, masses, centres of mass, forces and errors.

All settings share the robot, the path, the grid that suits the configuration's own values, and their dynamics. All else
is computed by the functions that plan a single task. So a plan of a batch equals the plan of its setting alone on the
same grid, bit for bit. If only durations are wanted and the work takes long enough, several processes share it; the
result does not depend on their number.
"""

from __future__ import annotations

import difflib
import pickle
import time
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property, lru_cache
from math import ceil
from typing import Any, TypeVar

import numpy as np

from robustopt.arrays import Array
from robustopt.config import Config
from robustopt.config.document import Key, split_key
from robustopt.config.load import with_values
from robustopt.config.per_name import value_of
from robustopt.errors import ConfigError, SolverFailed
from robustopt.limits import TimeScalingProblem, rows_along
from robustopt.limits.track import Track
from robustopt.processes import begun, cores, in_processes
from robustopt.solvers import Plan, Status, solve, track_of

Item = TypeVar("Item")

Setting = Mapping[str, float | Sequence[float]]
"""Values by configuration key, such as {"contact.friction.upper": 0.3, "uncertainty.center_of_mass.upper.2": 0.01}."""

VARYING = (
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
    "objects.*.held_by.suction.force",
    "objects.*.held_by.grip.force",
)
"""Keys, or sections of keys, that may vary within a batch: neither the robot nor the path depends on them."""

ALONE, STARTED = (0.3, 2.0), (0.05, 0.3)
"""Time that one process plans before it decides, and least remaining work that it then shares [s], in two cases: the
workers must be started first, which takes about as long, or they are running.
"""

PARTS = 8
"""Number of parts of the work per process, so that no process waits long for the others."""

PER_NAME = ("contact.friction", "uncertainty.friction", "uncertainty.contact_points")
"""Keys that have one value for all contacts, or one value per name."""


class BatchPlanner:
    """Planner of a configuration for any number of settings, by `reachability`.

    Raises ConfigError, RobotError or PathError on first use if the configuration is not valid.

    Attributes:
        config: the configuration.
        workers: largest number of processes that share the computation of durations.
    """

    def __init__(self, config: Config, workers: int | None = None) -> None:
        """Make the planner of a configuration; by default with one worker per processor core."""
        self.config = config
        self.workers = min(workers or cores(), cores())
        self._durations: dict[tuple[Any, ...], float] = {}

    @cached_property
    def track(self) -> Track:
        """Return the robot and the path with their dynamics, which all plans share."""
        return track_of(self.config)

    def durations(self, settings: Sequence[Setting]) -> Array:
        """Return the duration of the plan of each setting; each is computed once.

        Args:
            settings: k settings.

        Returns:
            Durations (k,) [s], infinite if there is no plan.

        Raises:
            ConfigError: a key cannot vary, or a value is not allowed.
            SolverFailed: the solver stops without an answer.
        """
        keys = [_identity(setting) for setting in settings]
        new = {key: setting for key, setting in zip(keys, settings, strict=True) if key not in self._durations}
        self._durations.update(zip(new, self.plan_durations(list(new.values())), strict=True))
        return np.array([self._durations[key] for key in keys])

    def plan_durations(self, settings: Sequence[Setting]) -> Array:
        """Return the duration of the plan of each setting, computed anew, (k,) [s].

        Args:
            settings: k settings.

        Raises:
            ConfigError: a key cannot vary, or a value is not allowed.
            SolverFailed: the solver stops without an answer.
        """
        return shared_durations(settings, self._duration, _durations, self.config, self.workers)

    def plans(self, settings: Sequence[Setting]) -> list[Plan]:
        """Return the plan of each setting, the same as `solve` returns by `reachability` on the grid of the batch.

        Args:
            settings: the settings.

        Raises:
            ConfigError: a key cannot vary, or a value is not allowed.
        """
        return [self._plan(setting) for setting in settings]

    def problem(self, setting: Setting) -> TimeScalingProblem:
        """Return the problem of a setting.

        Args:
            setting: values by key.

        Raises:
            ConfigError: a key cannot vary, or a value is not allowed.
        """
        return rows_along(self.track, with_setting(self.config, setting))

    def _plan(self, setting: Setting) -> Plan:
        return solve(self.problem(setting), "reachability")

    def _duration(self, setting: Setting) -> float:
        return known_duration(self._plan(setting), ", ".join(f"{key} = {value}" for key, value in setting.items()))


def known_duration(plan: Plan, described: str) -> float:
    """Return the duration of a plan, infinite if there is none [s].

    Args:
        plan: the plan.
        described: the setting or path of the plan, in words.

    Raises:
        SolverFailed: the solver stopped without an answer.
    """
    if plan.status not in (Status.SOLVED, Status.INFEASIBLE):
        raise SolverFailed(f"no plan for {described}: {plan.message}")
    return plan.duration


def shared_durations(
    items: Sequence[Item],
    duration: Callable[[Item], float],
    of_part: Callable[[bytes, Sequence[Item]], list[float]],
    config: Config,
    workers: int,
) -> Array:
    """Return the durations of many plans, (k,) [s]; several processes share the work if it takes long enough.

    Args:
        items: settings or paths (k,).
        duration: function that plans one item in this process and returns its duration.
        of_part: function of a module that plans a part of the items in a worker, given the pickled configuration.
        config: the configuration.
        workers: largest number of processes.
    """
    found = [duration(item) for item in items[:1]]  # makes what all plans share, which is not part of the pace
    began = time.perf_counter()
    for count, item in enumerate(items[1:], 1):
        found.append(duration(item))
        spent, left = time.perf_counter() - began, len(items) - len(found)
        alone, worthwhile = STARTED if begun(workers) else ALONE
        if workers > 1 and spent > alone and left * spent / count > worthwhile:
            size = ceil(left / (PARTS * workers))
            task = pickle.dumps(config)
            parts = [(task, list(items[i : i + size])) for i in range(len(found), len(items), size)]
            shared = in_processes(of_part, parts, workers, SolverFailed)
            return np.array(found + [value for part in shared for value in part])
    return np.array(found)


def _durations(task: bytes, settings: Sequence[Setting]) -> list[float]:
    """Return the durations of settings, in a worker process; `task` is the pickled configuration."""
    planner = _planner_of(task)
    return [planner._duration(setting) for setting in settings]


@lru_cache(maxsize=1)
def _planner_of(task: bytes) -> BatchPlanner:
    """Return the planner of a worker process, which is kept while the task stays the same."""
    return BatchPlanner(pickle.loads(task), workers=1)


def solve_batch(config: Config, settings: Sequence[Setting]) -> list[Plan]:
    """Return the minimum-time plan of a configuration for each setting, by `reachability`.

    Args:
        config: the configuration.
        settings: values by key, for each plan.

    Raises:
        ConfigError: the configuration is not valid, a key cannot vary, or a value is not allowed.
        RobotError: the robot is not valid.
        PathError: the path cannot be followed.
    """
    return BatchPlanner(config).plans(settings)


def with_setting(config: Config, setting: Setting) -> Config:
    """Return a copy of a configuration with the values of a setting.

    A key may name a part of a value that the configuration abbreviates or omits: the friction of one object if all have
    the same, one axis of a centre of mass, one end of an interval.

    Args:
        config: the configuration.
        setting: values by key.

    Raises:
        ConfigError: a key cannot vary, or a value is not allowed.
    """
    written: dict[str, Any] = {}
    for key in setting:
        _require_varying(config, key)
        written.update(_written_out(config, split_key(key)))
    return with_values(config, {**written, **setting})


def _require_varying(config: Config, key: str) -> None:
    parts = split_key(key)
    if parts[0] == "objects" and len(parts) > 2:
        if parts[1] not in config.objects:
            raise ConfigError(f"nothing is called {parts[1]}; expected one of {', '.join(config.objects)}", key)
        parts = ("objects", "*", *parts[2:])
    if not any(parts[: len(allowed)] == allowed for allowed in map(split_key, VARYING)):
        near = difflib.get_close_matches(".".join(map(str, parts)), VARYING, n=1)
        hint = f"did you mean {near[0]}? " if near else ""
        raise ConfigError(f"cannot vary within a batch; {hint}keys that can: {', '.join(VARYING)}", key)


def _written_out(config: Config, key: Key) -> dict[str, Any]:
    """Return the values around a key in full if the configuration abbreviates them, so that the key exists."""
    section, kind, *inner = key
    if section == "objects" or not inner:
        return {}
    part, name = f"{section}.{kind}", inner[0]
    whole = getattr(getattr(config, str(section)), str(kind))
    result: dict[str, Any] = {}
    if part in PER_NAME and isinstance(name, str) and not isinstance(whole, dict) and whole is not None:
        result[part] = {"default": whole}
    if part == "uncertainty.friction" and isinstance(inner[-1], int):
        result |= _friction_interval(config, name if isinstance(name, str) else "")
    elif part in ("uncertainty.center_of_mass", "uncertainty.mass") and len(inner) > 1 and name not in whole:
        result |= _body_interval(config, str(kind), str(name))
    return result


def _friction_interval(config: Config, name: str) -> dict[str, Any]:
    """Return the interval of friction of a contact, or of all contacts if the name is empty, unless it is given."""
    whole, key = config.uncertainty.friction, "uncertainty.friction"
    given = whole if isinstance(whole, dict) else {} if whole is None else {"": whole, "default": whole}
    nominal = value_of(config.contact.friction, (name,), None)
    interval = given.get("default", None if nominal is None else (nominal, nominal))
    return {} if name in given or interval is None else {f"{key}.{name}" if name else key: interval}


def _body_interval(config: Config, kind: str, name: str) -> dict[str, Any]:
    """Return the interval of zero width of the mass or centre of mass of a body."""
    body, key = config.tray if name == "tray" else config.objects.get(name), f"uncertainty.{kind}.{name}"
    if kind == "center_of_mass":
        return {key: (0.0, 0.0, 0.0)}
    return {} if body is None else {key: (body.mass, body.mass)}


def _identity(setting: Setting) -> tuple[Any, ...]:
    return tuple(sorted((key, tuple(np.ravel(value).tolist())) for key, value in setting.items()))
