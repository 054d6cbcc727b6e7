"""Why a problem has no solution: the limits in conflict, and the smallest change of each that would resolve it.

A set of limits is in conflict if the problem has no solution with these alone, and has one as soon as any of them is
dropped: an irreducible infeasible subset, found by dropping the limits one after the other. A remedy is a key of the
configuration and the value nearest to its present one with which the whole problem has a solution, found by bisection
between the present value and the most generous one (our choice).
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from robustopt.config import Config
from robustopt.config.load import with_values
from robustopt.errors import ConfigError
from robustopt.limits import TimeScalingProblem, build_rows
from robustopt.limits.contact import carried
from robustopt.limits.uncertainty import friction
from robustopt.robot import load_robot
from robustopt.solvers import Plan, Status, solve, standstill

BISECTIONS = 12
"""Halvings of a remedy's interval: a value is found to 1/4096 of the way to the most generous one."""

MOST_FRICTION = 10.0
"""Largest coefficient of friction that is tried; no dry contact has more."""

MOST_JOINT_LIMIT = 100.0
"""Largest factor by which a joint's limit is raised."""


@dataclass(frozen=True)
class Remedy:
    """A change of one key: `found` is its value now, `needed` the nearest one that resolves the conflict of `limits`.

    enough: whether it makes the whole problem solvable by itself
    """

    key: str
    found: float
    needed: float
    limits: tuple[str, ...]
    enough: bool

    @property
    def sentence(self) -> str:
        bound = "at least" if self.needed > self.found else "at most"
        purpose = "enough by itself" if self.enough else f"resolves {' together with '.join(self.limits)} only"
        return f"{self.key}: {bound} {self.needed:.4g} instead of {self.found:.4g} ({purpose})"


@dataclass(frozen=True)
class Diagnosis:
    """Where a problem has no solution, which limits are in conflict, and what would help, one change at a time."""

    point: int
    s: float
    place: str
    conflicts: tuple[tuple[str, ...], ...]
    remedies: tuple[Remedy, ...]
    standstill: bool
    from_rest: bool

    @property
    def sentence(self) -> str:
        what = "no speed and acceleration is left"
        if self.standstill:
            what = "the robot cannot stand still"
        elif self.from_rest:
            what = "no timing that starts from rest gets to the end"
        limits = "; ".join(" together with ".join(conflict) for conflict in self.conflicts)
        return f"At s = {self.s:.4g} ({self.place}) {what}. Cannot hold for every value in the intervals: {limits}."


def diagnose(plan: Plan) -> Diagnosis:
    """The conflict of an infeasible plan. Raises ValueError for a plan of any other status."""
    if plan.status is not Status.INFEASIBLE:
        raise ValueError(f"only an infeasible plan has a conflict; this one is: {plan.status.value}")
    problem, point = plan.problem, max(plan.stuck, 0)
    conflicts = tuple(_told_apart(problem, list(_conflicts(problem))))
    return Diagnosis(
        point=point,
        s=float(problem.s[point]),
        place=problem.path.label(float(problem.s[point])),
        conflicts=conflicts,
        remedies=tuple(_remedies(problem, conflicts)),
        standstill=standstill(problem) == point,
        from_rest=bool(problem.rest[point]) and standstill(problem) != point,
    )


def _solvable(problem: TimeScalingProblem) -> bool:
    return solve(replace(problem, config=_for_time(problem.config)), "reachability").status is not Status.INFEASIBLE


def _for_time(config: Config) -> Config:
    """Whether there is a solution does not depend on the cost."""
    return config.model_copy(update={"solver": config.solver.model_copy(update={"cost": "time", "weight": 0.0})})


def _conflicts(problem: TimeScalingProblem) -> Iterator[tuple[str, ...]]:
    """Sets of limits without a common solution, none of which shares a limit with another."""
    unlimited = np.array(problem.robot.joint_names)[np.isinf(problem.robot.limits.torque)]
    idle = {f"{joint} {kind}" for joint in unlimited for kind in ("acceleration", "torque")}
    names = [name for name in problem.limits.names if not name.endswith(" velocity") and name not in idle]
    while names and not _solvable(problem.only(names)):
        conflict = _irreducible(problem, names)
        yield tuple(conflict)
        names = [name for name in names if name not in conflict]


def _told_apart(problem: TimeScalingProblem, conflicts: list[tuple[str, ...]]) -> Iterator[tuple[str, ...]]:
    """The conflicts without slip that is only tipping: what tips also pivots, and no friction would hold it."""
    together = {limit for conflict in conflicts for limit in conflict}
    names = [family.system.names for family in problem.limits.contacts]
    tipping = {pair[0]: pair[1] for pair in names if len(pair) == 2}
    for conflict in conflicts:
        tips = all(tipping.get(limit) in together for limit in conflict)
        frictions = _candidates(problem, conflict) if tips else ()
        held = [_trial(problem, candidate, conflict)(1.0) for candidate in frictions if ".friction" in candidate.key]
        if not tips or any(held):
            yield conflict


def _irreducible(problem: TimeScalingProblem, names: list[str]) -> list[str]:
    """A subset of limits in conflict from which none can be dropped: one after the other, but many together where all
    of them can be dropped, which is the same."""
    needed, blocks = list(names), [list(names)]
    while blocks:
        block = blocks.pop()
        rest = [name for name in needed if name not in block]
        if not _solvable(problem.only(rest)):
            needed = rest
        elif len(block) > 1:
            half = len(block) // 2
            blocks += [block[half:], block[:half]]
    return needed


def _remedies(problem: TimeScalingProblem, conflicts: Sequence[tuple[str, ...]]) -> Iterator[Remedy]:
    """Changes that are enough by themselves, then for what is left the changes that resolve one conflict each."""
    every = tuple(limit for conflict in conflicts for limit in conflict)
    resolved: set[str] = set()
    for limits in (every, *conflicts):
        if resolved.issuperset(limits):
            continue
        whole = limits is every
        for candidate in _candidates(problem, limits):
            share = _least_share(_trial(problem, candidate, None if whole else limits))
            if share is not None:
                yield Remedy(candidate.key, candidate.found, candidate.value(share), limits, whole)
                resolved |= set(limits)


def _trial(
    problem: TimeScalingProblem, candidate: _Candidate, limits: tuple[str, ...] | None
) -> Callable[[float], bool]:
    """Whether the problem, or some limits of it alone, has a solution with a share of a candidate's change."""

    def works(share: float) -> bool:
        changes = candidate.changes(share)
        try:
            config = with_values(problem.config, changes)
        except ConfigError:
            return False
        robot = problem.robot
        if any(key.startswith("robot.") for key in changes):
            robot = load_robot(config)
        changed = build_rows(config, robot, problem.path)
        return _solvable(changed if limits is None else changed.only(limits))

    return works


def _least_share(works: Callable[[float], bool]) -> float | None:
    """Smallest share of the way to the most generous value that works, None if even that does not."""
    if not works(1.0):
        return None
    low, high = 0.0, 1.0
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if works(middle) else (middle, high)
    return high


@dataclass(frozen=True)
class _Candidate:
    """A key that may be changed from `found` to `generous`; `write` makes the changes for a value."""

    key: str
    found: float
    generous: float
    write: Callable[[float], dict[str, Any]]

    def value(self, share: float) -> float:
        if self.generous > self.found > 0:
            return float(self.found * (self.generous / self.found) ** share)
        return self.found + share * (self.generous - self.found)

    def changes(self, share: float) -> dict[str, Any]:
        return self.write(self.value(share))


def _candidates(problem: TimeScalingProblem, conflict: Collection[str]) -> Iterator[_Candidate]:
    """Keys that bear on the limits in conflict."""
    config, robot = problem.config, problem.robot
    for j, joint in enumerate(robot.joint_names):
        for quantity, limits in (("acceleration", robot.limits.acceleration), ("torque", robot.limits.torque)):
            if f"{joint} {quantity}" in conflict:
                key, limit = f"robot.limits.{joint}.{quantity}", float(limits[j])
                yield _Candidate(key, limit, MOST_JOINT_LIMIT * limit, lambda value, key=key: {key: value})  # type: ignore[misc]
    systems = [family.system for family in problem.limits.contacts if set(family.system.names) & set(conflict)]
    touched = [name for system in systems for name in system.interfaces]
    loaded = _loaded(config, touched, any(f"{joint} torque" in conflict for joint in robot.joint_names))
    if touched:
        yield from _friction_candidates(config, touched)
    yield from _error_candidates(config)
    if touched and config.uncertainty.contact_points is not None:
        widths = config.uncertainty.contact_points
        widest = max(widths.values(), default=0.0) if isinstance(widths, dict) else widths
        yield from _shrinking("uncertainty.contact_points", "widest", widest, widths)
    for name in loaded & set(config.uncertainty.center_of_mass):
        reach = config.uncertainty.center_of_mass[name]
        yield from _shrinking(f"uncertainty.center_of_mass.{name}", "largest", max(reach), list(reach))
    for name in loaded & set(config.uncertainty.mass):
        low, high = config.uncertainty.mass[name]
        mass = _mass(problem, name)

        def narrowed(width: float, key: str = name, m: float = mass, a: float = low, b: float = high) -> dict[str, Any]:
            share = width / (b - a)
            return {f"uncertainty.mass.{key}": [m - share * (m - a), m + share * (b - m)]}

        if high > low:
            yield _Candidate(f"uncertainty.mass.{name}, width", high - low, 0.0, narrowed)


def _loaded(config: Config, touched: Collection[str], torque: bool) -> set[str]:
    """Bodies whose mass and centre of mass bear on the interfaces that are touched, or on joint torques."""
    if config.walks:
        return {*config.uncertainty.center_of_mass, *config.uncertainty.mass}
    if torque:
        return {"tray", *config.objects}
    return {body for name in touched for body in carried(config, name)}


def _mass(problem: TimeScalingProblem, name: str) -> float:
    """Mass that the planner believes a body to have [kg]."""
    if problem.robot.base:
        return problem.robot.inertia_of(name)[0]
    return problem.config.carried_tray.mass if name == "tray" else problem.config.objects[name].mass


def _error_candidates(config: Config) -> Iterator[_Candidate]:
    """The joint acceleration error, its number of deviations and its mean, and that of a floating base."""
    base = config.uncertainty.base_acceleration
    given = list(base) if isinstance(base, tuple) else base
    yield from _shrinking("uncertainty.base_acceleration", "largest", float(np.max(base)), given)
    error = config.uncertainty.joint_acceleration
    key = "uncertainty.joint_acceleration"
    if error is not None and error.K > 0 and np.any(np.asarray(error.deviation) > 0):
        yield _Candidate(f"{key}.K", error.K, 0.0, lambda value: {f"{key}.K": value})
    if error is not None:
        mean = list(error.mean) if isinstance(error.mean, tuple) else error.mean
        yield from _shrinking(f"{key}.mean", "largest", float(np.max(np.abs(mean))), mean)


def _shrinking(key: str, what: str, largest: float, values: Any) -> Iterator[_Candidate]:
    """Values at a key, a number, a list or a mapping of numbers, all made smaller by one factor."""

    def scaled(given: Any, factor: float) -> Any:
        if isinstance(given, dict):
            return {name: factor * value for name, value in given.items()}
        return [factor * value for value in given] if isinstance(given, list) else factor * given

    if largest > 0:
        label = key if isinstance(values, float) else f"{key}, {what}"
        yield _Candidate(label, largest, 0.0, lambda value: {key: scaled(values, value / largest)})


def _friction_candidates(config: Config, touched: Collection[str]) -> Iterator[_Candidate]:
    """Friction: the one value of all interfaces, or that of each interface which has its own."""
    interval, lowest = config.uncertainty.friction, friction(config)
    base = "contact.friction" if interval is None else "uncertainty.friction"
    source = config.contact.friction if interval is None else interval
    if not isinstance(source, dict):
        groups = {base: list(config.interfaces)}
    else:
        rest = [name for name in config.interfaces if name not in source]
        groups = {f"{base}.{name}": [name] for name in touched if name in source}
        if set(rest) & set(touched) and "default" in source:
            groups[f"{base}.default"] = rest
    for key, names in groups.items():

        def lifted(value: float, names: Sequence[str] = tuple(names)) -> dict[str, Any]:
            return _with_friction(config, names, value)

        yield _Candidate(key, min(lowest[name] for name in names), MOST_FRICTION, lifted)


def _with_friction(config: Config, names: Collection[str], value: float) -> dict[str, Any]:
    """Changes that raise the friction under some objects to at least `value`, interval and point value alike."""
    points: dict[str, float] = {}
    intervals: dict[str, list[float]] = {}
    for name in config.interfaces:
        point, interval = _of(config.contact.friction, name), _of(config.uncertainty.friction, name)
        least = value if name in names else 0.0
        if interval is not None:
            intervals[name] = [max(interval[0], least), max(interval[1], least)]
            point = min(max(point, intervals[name][0]), intervals[name][1])
        points[name] = max(point, least)
    changes: dict[str, Any] = {"contact.friction": points}
    return changes | ({"uncertainty.friction": intervals} if intervals else {})


def _of(given: Any, name: str) -> Any:
    """The value for one object, of a value for all or a mapping by name."""
    return given.get(name, given.get("default")) if isinstance(given, dict) else given
