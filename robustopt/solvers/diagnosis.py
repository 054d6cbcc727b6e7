"""Diagnosis of an infeasible problem: the limits in conflict, and for each key the smallest change that resolves them.

Limits are in conflict if the problem has no solution with them alone, but has one as soon as any of them is dropped.
This is an irreducible infeasible subset, found by dropping one limit after the other. A remedy is a key of the
configuration with its nearest value for which the whole problem has a solution. It is found by bisection between the
present value and the most generous one, and rounded towards the latter until the problem has a solution at the value
that is printed (our choice). If no change resolves all conflicts, changes of two keys are tried together.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from decimal import ROUND_CEILING, ROUND_FLOOR, Decimal
from itertools import combinations

import numpy as np

from robustopt.config.load import with_values
from robustopt.errors import ConfigError
from robustopt.limits import LimitKind, LimitName, TimeScalingProblem, rows_along
from robustopt.limits.track import build_track
from robustopt.robot import load_robot
from robustopt.solvers import Plan, Status, solve, standstill
from robustopt.solvers.refine import for_time
from robustopt.solvers.remedies import Candidate, candidates

BISECTIONS = 16
"""Halvings of a remedy's interval: the value is accurate to 1/65536 of the way to the most generous one."""

DIGITS, MOST_DIGITS = 4, 17
"""Number of significant digits of a remedy; more if the present value has the same ones."""

MOST_STEPS = 5
"""Largest number of steps of the last digit by which a remedy is made more generous until it works."""


@dataclass(frozen=True)
class Remedy:
    """A change of one key that resolves a conflict.

    Attributes:
        key: the key, as in the user's configuration.
        found: its present value.
        needed: the nearest value that resolves the conflict.
        limits: names of the limits in conflict.
        enough: whether the change, with those in `together`, makes the whole problem feasible.
        together: changes of other keys that are needed too.
    """

    key: str
    found: float
    needed: float
    limits: tuple[str, ...]
    enough: bool
    together: tuple[Remedy, ...] = ()

    @property
    def change(self) -> str:
        """Return the change in words; the value that is needed is printed with all its digits."""
        bound = "at least" if self.needed > self.found else "at most"
        digits = next(
            (d for d in range(DIGITS, MOST_DIGITS) if float(f"{self.needed:.{d}g}") == self.needed), MOST_DIGITS
        )
        return f"{self.key}: {bound} {self.needed:.{digits}g} instead of {self.found:.{digits}g}"

    @property
    def sentence(self) -> str:
        """Return the remedy in words."""
        changes = " and ".join([self.change, *(other.change for other in self.together)])
        purpose = f"resolves {' together with '.join(self.limits)} only"
        if self.enough:
            purpose = "enough together" if self.together else "enough by itself"
        return f"{changes} ({purpose})"


@dataclass(frozen=True)
class Diagnosis:
    """The reason why a problem has no solution.

    Attributes:
        point: grid point at which no choice is left.
        s: position of this point along the path.
        place: this position in words.
        conflicts: names of the limits in conflict, one tuple per conflict, those at `point` first.
        places: positions of the conflicts along the path in words.
        remedies: changes that help.
        standstill: whether the robot must rest at the point but cannot.
        from_start: whether the speed at the start is given but allows no timing that reaches the end.
        from_rest: whether this speed is 0.
        at_speed: whether the robot must reach the end at a speed other than 0.
    """

    point: int
    s: float
    place: str
    conflicts: tuple[tuple[str, ...], ...]
    places: tuple[str, ...]
    remedies: tuple[Remedy, ...]
    standstill: bool
    from_start: bool
    from_rest: bool
    at_speed: bool

    @property
    def sentence(self) -> str:
        """Return the place and the conflicts in words."""
        reason = "no combination of speed and acceleration is possible"
        if self.standstill:
            reason = "the robot cannot stand still"
        elif self.from_start:
            start = "from rest" if self.from_rest else "at the given speed"
            reason = f"no timing that starts {start} reaches the end{' at path.end_speed' if self.at_speed else ''}"
        here = f"s = {self.s:.4g} ({self.place})"
        limits = "; ".join(
            " together with ".join(conflict) + ("" if place == here else f" at {place}")
            for conflict, place in zip(self.conflicts, self.places, strict=True)
        )
        return f"At {here} {reason}. Limits in conflict: {limits}."


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
    found = list(_conflicts(problem))
    conflicts = list(_told_apart(problem, found))
    points = {conflict: _point(problem.only(conflict), point) for conflict in conflicts}
    conflicts.sort(key=lambda conflict: points[conflict] != point)
    return Diagnosis(
        point=point,
        s=float(problem.s[point]),
        place=_place(problem, point),
        conflicts=tuple(conflicts),
        places=tuple(f"s = {problem.s[points[one]]:.4g} ({_place(problem, points[one])})" for one in conflicts),
        remedies=tuple(_remedies(problem, conflicts, found)),
        standstill=standstill(problem) == point,
        from_start=bool(np.isfinite(problem.fixed[point])) and standstill(problem) != point,
        from_rest=bool(problem.rest[point]),
        at_speed="end" in problem.path.moving_ends,
    )


def _place(problem: TimeScalingProblem, point: int) -> str:
    return problem.path.label(float(problem.s[point]))


def _point(problem: TimeScalingProblem, point: int) -> int:
    """Return the grid point at which the robot cannot stand still, else the given one."""
    at_rest = standstill(_solved(problem).problem)
    return point if at_rest < 0 else at_rest


def _solved(problem: TimeScalingProblem) -> Plan:
    moving = bool(problem.path.moving_ends)
    return solve(replace(problem, config=for_time(problem.config)), "reachability", jerk=moving)


def _solvable(problem: TimeScalingProblem) -> bool:
    try:
        return _solved(problem).status is not Status.INFEASIBLE
    except ConfigError:  # nothing bounds the speed
        return True


def _conflicts(problem: TimeScalingProblem) -> Iterator[tuple[str, ...]]:
    """Yield sets of limits without a common solution; no two of them share a limit."""
    limits = problem.robot.limits
    idle = {
        LimitName(kind, joint)
        for kind, largest in (
            (LimitKind.ACCELERATION, limits.acceleration),
            (LimitKind.TORQUE, limits.torque),
        )
        for joint, limit in zip(problem.robot.joint_names, largest, strict=True)
        if np.isinf(limit)
    }
    speeds = (LimitKind.VELOCITY, LimitKind.CARTESIAN_SPEED)
    names = [name for name in problem.limits.names if name.kind not in speeds and name not in idle]
    if problem.path.moving_ends:
        jerk = problem.limits.track.names(LimitKind.JERK)
        names += [name for name, limit in zip(jerk, limits.jerk, strict=True) if np.isfinite(limit)]
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
        rough = [candidate for candidate in frictions if ".friction" in candidate.key]
        held = [_Trial(problem, conflict).works({candidate: candidate.generous}) for candidate in rough]
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


def _remedies(
    problem: TimeScalingProblem, conflicts: Sequence[tuple[str, ...]], found: Sequence[tuple[str, ...]]
) -> Iterator[Remedy]:
    """Yield changes that suffice by themselves, or pairs that suffice, or changes that resolve one conflict only.

    `found` has the conflicts that only accompany others too: a pair may have to resolve them.
    """
    every = tuple(limit for conflict in conflicts for limit in conflict)
    whole = _Trial(problem, None)
    enough = list(_single(whole, every))
    if not enough and len(found) > 1:
        enough = list(_pairs(whole, [limit for conflict in found for limit in conflict], every))
    if not enough and len(conflicts) > 1:
        enough = [one for conflict in conflicts for one in _single(_Trial(problem, conflict), conflict)]
    yield from enough


def _single(trial: _Trial, limits: tuple[str, ...]) -> Iterator[Remedy]:
    """Yield the changes of one key each after which the trial works."""
    for candidate in candidates(trial.problem, limits):
        value = trial.nearest(candidate, {})
        if value is not None:
            yield _remedy({candidate: value}, limits, trial.limits is None)


def _pairs(trial: _Trial, affected: Sequence[str], limits: tuple[str, ...]) -> Iterator[Remedy]:
    """Yield the changes of two keys that affect some limits after which the trial works.

    One change is made as small as the most generous other one allows, then the other. Of both orders the one with the
    smaller sum of shares of the ways to the most generous values counts.
    """
    for first, second in combinations(candidates(trial.problem, affected), 2):
        orders = [trial.nearest_two(first, second), trial.nearest_two(second, first)]
        found = [values for values in orders if values is not None]
        if found:
            best = min(found, key=lambda values: sum(one.share(value) for one, value in values.items()))
            yield _remedy({first: best[first], second: best[second]}, limits, True)


def _remedy(values: Mapping[Candidate, float], limits: tuple[str, ...], enough: bool) -> Remedy:
    """Return the remedy that changes some keys, and the nominal values that would lie outside their new intervals."""
    changes = [(one.key, one.found, value) for one, value in values.items()]
    changes += [(*one.nominal, value) for one, value in values.items() if one.nominal and one.nominal[1] < value]
    first, *others = [Remedy(*change, limits, enough) for change in changes]
    return replace(first, together=tuple(others))


@dataclass(frozen=True)
class _Trial:
    """A problem whose keys are changed to see whether it becomes feasible.

    Attributes:
        problem: the problem.
        limits: the limits that count, None for all.
    """

    problem: TimeScalingProblem
    limits: tuple[str, ...] | None

    def works(self, values: Mapping[Candidate, float], method: str = "reachability") -> bool:
        """Return whether the problem has a solution after changes of some keys."""
        config, track = self.problem.config, self.problem.limits.track
        try:
            for candidate, value in values.items():
                config = with_values(config, candidate.write(config, value))
            if any(candidate.key.startswith(("robot.", "path.")) for candidate in values):
                path = self.problem.path
                if config.path != self.problem.config.path:
                    start = config.path.start_speed if path.breaks[0] == 0.0 else None
                    path = path.with_speeds(start, config.path.end_speed)
                robot = track.robot if config.robot == self.problem.config.robot else load_robot(config)
                track = build_track(robot, path, track.grid)
            changed = replace(rows_along(track, config), running=self.problem.running)
            if method == "ipopt" and self.limits is None:
                return solve(changed, jerk=False).status is Status.SOLVED
        except ConfigError:
            return False
        return _solvable(changed if self.limits is None else changed.only(self.limits))

    def nearest(self, candidate: Candidate, others: Mapping[Candidate, float]) -> float | None:
        """Return the rounded value nearest to the present one that works beside other changes, None if none does."""
        if not self.works({**others, candidate: candidate.generous}):
            return None
        low, high = 0.0, 1.0
        for _ in range(BISECTIONS):
            middle = 0.5 * (low + high)
            low, high = (low, middle) if self.works({**others, candidate: candidate.value(middle)}) else (middle, high)
        method = self.problem.config.solver.method
        rounded = _rounded(candidate, candidate.value(low), candidate.value(high))
        return next((value for value in rounded if self.works({**others, candidate: value}, method)), None)

    def nearest_two(self, leading: Candidate, other: Candidate) -> dict[Candidate, float] | None:
        """Return the values of two changes that work together, the leading one as small as possible, or None."""
        value = self.nearest(leading, {other: other.generous})
        after = None if value is None else self.nearest(other, {leading: value})
        return None if value is None or after is None else {leading: value, other: after}


def _rounded(candidate: Candidate, fails: float, works: float) -> Iterator[float]:
    """Yield rounded values from one that fails to one that works and beyond, each one step of its last digit on."""
    digits = DIGITS
    while digits < MOST_DIGITS and f"{works:.{digits}g}" == f"{candidate.found:.{digits}g}":
        digits += 1
    up, exact = candidate.generous > candidate.found, Decimal(fails)
    step = Decimal(1).scaleb(exact.adjusted() - digits + 1)
    first = exact.quantize(step, ROUND_CEILING if up else ROUND_FLOOR)
    for k in range(MOST_STEPS):
        yield float(first + k * step) if up else max(float(first - k * step), candidate.generous)
