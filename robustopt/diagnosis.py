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

from robustopt.config import Config, with_values
from robustopt.contact import carried
from robustopt.errors import ConfigError
from robustopt.problem import TimeScalingProblem, build_rows
from robustopt.robot import load_robot
from robustopt.timescaling import Plan, Status, solve, standstill
from robustopt.uncertainty import friction

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
    names = [name for name in problem.limits.names if not name.endswith(" velocity")]
    while names and not _solvable(problem.only(names)):
        conflict = _irreducible(problem, names)
        yield tuple(conflict)
        names = [name for name in names if name not in conflict]


def _told_apart(problem: TimeScalingProblem, conflicts: list[tuple[str, ...]]) -> Iterator[tuple[str, ...]]:
    """The conflicts without slip that is only tipping: what tips also pivots, and no friction would hold it."""
    together = {limit for conflict in conflicts for limit in conflict}
    for conflict in conflicts:
        tips = all(limit.startswith("slip of ") and _as_tipping(limit) in together for limit in conflict)
        frictions = _candidates(problem, conflict) if tips else ()
        held = [_trial(problem, candidate, conflict)(1.0) for candidate in frictions if ".friction" in candidate.key]
        if not tips or any(held):
            yield conflict


def _as_tipping(slip: str) -> str:
    return slip.replace("slip of ", "tipping of ", 1).replace(" on ", " over ", 1)


def _irreducible(problem: TimeScalingProblem, names: list[str]) -> list[str]:
    """A subset of limits in conflict from which none can be dropped."""
    needed = list(names)
    for name in names:
        rest = [other for other in needed if other != name]
        if not _solvable(problem.only(rest)):
            needed = rest
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
        arm = load_robot(config) if any(key.startswith("robot.") for key in changes) else problem.robot
        changed = build_rows(config, arm, problem.path)
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
    touched = [name for name in config.objects if any(name in limit.split() for limit in conflict)]
    yield from _friction_candidates(config, touched)
    uncertain = config.uncertainty
    error = uncertain.joint_acceleration
    if error is not None and error.K > 0 and np.any(np.asarray(error.deviation) > 0):
        yield _Candidate(
            "uncertainty.joint_acceleration.K", error.K, 0.0, lambda value: {"uncertainty.joint_acceleration.K": value}
        )
    if uncertain.contact_points is not None and touched:
        widths = uncertain.contact_points
        widest = max(widths.values(), default=0.0) if isinstance(widths, dict) else widths
        if widest > 0:
            yield _Candidate(
                "uncertainty.contact_points, widest", widest, 0.0, lambda value: _with_widths(config, value / widest)
            )
    loaded = {body for name in touched for body in carried(config, name)}
    for name, reach in uncertain.center_of_mass.items():
        if name in loaded and max(reach) > 0:
            yield _Candidate(
                f"uncertainty.center_of_mass.{name}, largest", max(reach), 0.0,
                lambda value, name=name, reach=reach: {  # type: ignore[misc]
                    f"uncertainty.center_of_mass.{name}": [value / max(reach) * part for part in reach]},
            )  # fmt: skip


def _friction_candidates(config: Config, touched: Collection[str]) -> Iterator[_Candidate]:
    """Friction: the one value of all interfaces, or that of each interface which has its own."""
    point, interval, lowest = config.contact.friction, config.uncertainty.friction, friction(config)
    own = sorted(
        {
            key if key in source else "default"
            for source in (point, interval)
            if isinstance(source, dict)
            for key in touched
        }
    )
    for name in own or [""]:
        key = ("uncertainty.friction" if interval is not None else "contact.friction") + (f".{name}" if name else "")
        now = min(lowest[other] for other in (touched if name in ("", "default") else [name])) if touched else 0.0
        if touched:
            yield _Candidate(key, now, MOST_FRICTION, lambda value, name=name: _with_friction(config, name, value))  # type: ignore[misc]


def _with_friction(config: Config, name: str, value: float) -> dict[str, Any]:
    """Changes that raise the friction under `name` (empty: all) to at least `value`, interval and point value alike."""
    point, interval = config.contact.friction, config.uncertainty.friction

    def lifted(source: Any, raise_it: Callable[[Any], Any]) -> Any:
        if isinstance(source, dict):
            return {key: raise_it(inner) if name in ("", key) else inner for key, inner in source.items()}
        return raise_it(source)

    changes = {"contact.friction": lifted(point, lambda mu: max(mu, value))}
    if interval is not None:
        changes["uncertainty.friction"] = lifted(interval, lambda pair: [max(pair[0], value), max(pair[1], value)])
    return changes


def _with_widths(config: Config, factor: float) -> dict[str, Any]:
    widths = config.uncertainty.contact_points
    if isinstance(widths, dict):
        return {"uncertainty.contact_points": {name: factor * width for name, width in widths.items()}}
    return {"uncertainty.contact_points": factor * (widths or 0.0)}
