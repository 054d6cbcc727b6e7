"""Diagnosis of an infeasible problem: the limits in conflict, and for each key the smallest change that resolves them.

Limits are in conflict if the problem has no solution with them alone, but has one as soon as any of them is dropped.
This is an irreducible infeasible subset, found by dropping one limit after the other. A remedy is a key of the
configuration with its nearest value for which the whole problem has a solution. It is found by bisection between the
present value and the most generous one (our choice).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from robustopt.config.load import with_values
from robustopt.errors import ConfigError
from robustopt.limits import LimitKind, LimitName, TimeScalingProblem, rows_along
from robustopt.limits.track import build_track
from robustopt.robot import load_robot
from robustopt.solvers import Plan, Status, solve, standstill
from robustopt.solvers.refine import for_time
from robustopt.solvers.remedies import Candidate, candidates

BISECTIONS = 12
"""Halvings of a remedy's interval: the value is accurate to 1/4096 of the way to the most generous one."""


@dataclass(frozen=True)
class Remedy:
    """A change of one key that resolves a conflict.

    Attributes:
        key: the key, as in the user's configuration.
        found: its present value.
        needed: the nearest value that resolves the conflict.
        limits: names of the limits in conflict.
        enough: whether the change alone makes the whole problem feasible.
    """

    key: str
    found: float
    needed: float
    limits: tuple[str, ...]
    enough: bool

    @property
    def sentence(self) -> str:
        """Return the remedy in words."""
        bound = "at least" if self.needed > self.found else "at most"
        purpose = "enough by itself" if self.enough else f"resolves {' together with '.join(self.limits)} only"
        return f"{self.key}: {bound} {self.needed:.4g} instead of {self.found:.4g} ({purpose})"


@dataclass(frozen=True)
class Diagnosis:
    """The reason why a problem has no solution.

    Attributes:
        point: grid point at which no choice is left.
        s: position of this point along the path.
        place: this position in words.
        conflicts: names of the limits in conflict, one tuple per conflict.
        remedies: changes that help, each by itself.
        standstill: whether the robot must rest at the point but cannot.
        from_rest: whether the robot must start from rest at the point but cannot reach the end.
    """

    point: int
    s: float
    place: str
    conflicts: tuple[tuple[str, ...], ...]
    remedies: tuple[Remedy, ...]
    standstill: bool
    from_rest: bool

    @property
    def sentence(self) -> str:
        """Return the place and the conflicts in words."""
        reason = "no combination of speed and acceleration is possible"
        if self.standstill:
            reason = "the robot cannot stand still"
        elif self.from_rest:
            reason = "no timing that starts from rest reaches the end"
        limits = "; ".join(" together with ".join(conflict) for conflict in self.conflicts)
        return f"At s = {self.s:.4g} ({self.place}) {reason}. Limits in conflict: {limits}."


def diagnose(plan: Plan) -> Diagnosis:
    """Return the diagnosis of an infeasible plan.

    Args:
        plan: the plan.

    Raises:
        ValueError: the plan is not infeasible.
    """
    if plan.status is not Status.INFEASIBLE:
        raise ValueError(f"the plan is {plan.status.value}; only an infeasible plan has limits in conflict")
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
    try:
        plan = solve(replace(problem, config=for_time(problem.config)), "reachability")
    except ConfigError:  # nothing bounds the speed
        return True
    return plan.status is not Status.INFEASIBLE


def _conflicts(problem: TimeScalingProblem) -> Iterator[tuple[str, ...]]:
    """Yield sets of limits without a common solution; no two of them share a limit."""
    limits = problem.robot.limits
    idle = {
        LimitName(kind, joint)
        for kind, largest in ((LimitKind.ACCELERATION, limits.acceleration), (LimitKind.TORQUE, limits.torque))
        for joint, limit in zip(problem.robot.joint_names, largest, strict=True)
        if np.isinf(limit)
    }
    names = [name for name in problem.limits.names if name.kind != LimitKind.VELOCITY and name not in idle]
    while names and not _solvable(problem.only(names)):
        conflict = _irreducible(problem, names)
        yield tuple(conflict)
        names = [name for name in names if name not in conflict]


def _told_apart(problem: TimeScalingProblem, conflicts: list[tuple[str, ...]]) -> Iterator[tuple[str, ...]]:
    """Yield the conflicts without slip and twist that only accompany other limits.

    An object that tips or peels also pivots, and no friction would prevent this. An object that slips exceeds the rows
    of the twist too.
    """
    together = {limit for conflict in conflicts for limit in conflict}
    names = [limit.names for limit in problem.limits.contacts]
    tipping: dict[str, str] = {
        own[0]: own[1] for own in names if len(own) > 1 and own[1].kind in (LimitKind.TIPPING, LimitKind.PEEL)
    }
    twists = {own[2] for own in names if len(own) > 2 and together.intersection(own[:2])}
    for conflict in conflicts:
        if twists.issuperset(conflict):
            continue
        tips = all(tipping.get(limit) in together for limit in conflict)
        frictions = candidates(problem, conflict) if tips else ()
        held = [_trial(problem, candidate, conflict)(1.0) for candidate in frictions if ".friction" in candidate.key]
        if not tips or any(held):
            yield conflict


def _irreducible(problem: TimeScalingProblem, names: Sequence[str]) -> list[str]:
    """Return a subset of limits in conflict from which none can be dropped.

    Blocks of limits are dropped first and halved only if needed. The subset is the same as with one limit after the
    other.
    """
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
    """Yield changes that suffice by themselves, then changes that resolve the remaining single conflicts."""
    every = tuple(limit for conflict in conflicts for limit in conflict)
    resolved: set[str] = set()
    for limits in (every, *conflicts):
        if resolved.issuperset(limits):
            continue
        whole = limits is every
        for candidate in candidates(problem, limits):
            share = _least_share(_trial(problem, candidate, None if whole else limits))
            if share is not None:
                yield Remedy(candidate.key, candidate.found, candidate.value(share), limits, whole)
                resolved |= set(limits)


def _trial(
    problem: TimeScalingProblem, candidate: Candidate, limits: tuple[str, ...] | None
) -> Callable[[float], bool]:
    """Return a function that tells whether a share of a change makes the problem, or some of its limits, feasible."""

    def works(share: float) -> bool:
        changes = candidate.changes(share)
        try:
            config = with_values(problem.config, changes)
        except ConfigError:
            return False
        track = problem.limits.track
        if any(key.startswith("robot.") for key in changes):
            track = build_track(load_robot(config), problem.path, track.grid)
        changed = rows_along(track, config)
        return _solvable(changed if limits is None else changed.only(limits))

    return works


def _least_share(works: Callable[[float], bool]) -> float | None:
    """Return the smallest share of the way to the most generous value that works, None if that value does not."""
    if not works(1.0):
        return None
    low, high = 0.0, 1.0
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if works(middle) else (middle, high)
    return high
