"""Certificate of a plan: its worst utilisation of every limit, for all values in the intervals that are looked at.

Nothing here is shared with the planner but the configuration, the robot's kinematics and dynamics, the path, and the
places of objects and patches: the rigid-body mechanics, the force closure on exact Coulomb cones and the search for the
worst parameters are its own.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from robustopt.certificate import names
from robustopt.certificate.joints import KnownTorques, check_kinematics, check_torque
from robustopt.certificate.motion import Instants, instants, motion, stances
from robustopt.certificate.places import check_places
from robustopt.certificate.samples import check_samples
from robustopt.certificate.shared_torque import check_shared_torque
from robustopt.certificate.tally import Found, Tally
from robustopt.certificate.world import World, build_world, contact_points
from robustopt.certificate.worst import Search, Thoroughness
from robustopt.config import Config
from robustopt.errors import ConfigError, SolverFailed
from robustopt.limits.names import LimitName
from robustopt.solvers import Plan
from robustopt.solvers.same_task import require_same_task

GRID_TOLERANCE = 1e-6
"""Violation on the grid that is forgiven, as a share of the limit: solvers meet their rows to about 1e-8, and the gauge
is found to 1e-8."""

BETWEEN_TOLERANCE = 1e-2
"""Violation between grid points that is forgiven, as a share of the limit: the discretisation's, reported."""

TIMING_TOLERANCE = 1e-6
"""Share of the largest x by which x may differ from x_i + 2 ds_i u_i, be negative, or differ from 0 at a stop."""

FEW_POINTS = 8
"""With fewer contact points an instant hardly takes less time."""


@dataclass(frozen=True)
class Level:
    """How thoroughly to look.

    between: shares of each interval
    starts: random corners from which the search starts besides the configured values
    search: how it goes on
    samples: random values of everything
    per_program: instants of each sample at which contacts that share are looked at
    shared_torques: instants of all stances on several contacts at which the torques are looked at
    most_work: instants times contact points above which each interval is looked at in its middle alone
    effort: most of these times samples, kept to by taking fewer
    """

    between: tuple[float, ...]
    starts: int
    search: Thoroughness
    samples: int
    per_program: int
    shared_torques: int
    most_work: int
    effort: int


LEVELS = {
    "quick": Level((0.25, 0.5, 0.75), 0, Thoroughness(8, 3, 1e-5), 100, 2, 40, 25_000, 1_000_000),
    "full": Level((0.125, 0.25, 0.5, 0.75, 0.875), 4, Thoroughness(1, 4, 1e-7), 10_000, 10, 400, 10**12, 10**12),
}
"""quick takes 0.2 to 0.6 s at 200 intervals, full 20 s for two boxes to 100 s for a bridge, on one core."""


@dataclass(frozen=True)
class Margin:
    """Smallest share of a limit that is left, on the grid and between grid points; negative if it is violated."""

    on_grid: float
    between: float


@dataclass(frozen=True)
class Worst:
    """Place and parameters of the smallest margin.

    limit: in the configuration's words
    s, t: place on the path, and time [s]
    on_grid: True at a grid point, False between two
    parameters: friction [1], force [N], mass [kg], center_of_mass and contact_points (displacements [m]) and
        joint_acceleration (error [rad/s^2 or m/s^2]), each by name, as far as they are uncertain or matter
    """

    limit: LimitName
    margin: float
    s: float
    t: float
    on_grid: bool
    parameters: Mapping[str, object]

    def __str__(self) -> str:
        place = "at a grid point" if self.on_grid else "between grid points"
        left = "not held by any forces"
        if np.isfinite(self.margin):
            left = f"{100 * self.margin:.3g} % of the limit left"
        return f"{self.limit}: {left} at t = {self.t:.3f} s, s = {self.s:.4f}, {place}"


@dataclass(frozen=True)
class Certificate:
    """Result of the check of a plan for the values that were looked at.

    passed: whether the plan keeps its limits
    margin: the smallest of all, as a share of the limit, negative if it is violated; margins: per named limit
    worst: where and for which values it is found
    samples: random samples of all uncertain values
    tests: utilisations that were computed or bounded
    intervals: number of intervals of the plan, all of which were looked at
    seconds: time it took
    """

    passed: bool
    margin: float
    worst: Worst
    margins: Mapping[LimitName, Margin]
    level: str
    seed: int
    samples: int
    tests: int
    instants: int
    intervals: int
    seconds: float = field(compare=False)

    @property
    def sentence(self) -> str:
        """Return the result in a few sentences, with advice if solvers cannot do better on their grid."""
        verdict = "passes" if self.passed else "fails"
        effort = f"{self.level}: {self.samples} samples, {self.tests} tests"
        advice = ""
        if not self.passed and not self.worst.on_grid:
            advice = f" The grid is too coarse there: try more solver.collocation_points than {self.intervals}."
        return f"The plan {verdict} its certificate ({effort}). {self.worst}.{advice}"


def certify(plan: Plan, level: str = "quick", seed: int = 0, config: Config | None = None) -> Certificate:
    """Check a plan, independently of the solver that made it.

    Looks at both ends of every interval of the grid and in between, with the configured values, with the worst ends of
    all intervals, which it searches, and with random values of everything at once. The same seed gives the same
    certificate.

    Args:
        plan: the plan.
        level: `quick`, within about a second, or `full`, with 10,000 random samples and more of the worst cases.
        seed: of the random samples.
        config: a configuration of the same task whose frictions, masses and intervals count; by default that of the
            plan.

    Returns:
        The certificate, which says whether the plan keeps its limits.

    Raises:
        ConfigError: the configuration is of another task than the plan, or the plan has a contact law of a user.
        SolverFailed: the plan has no timing or not a finite one.
        ValueError: there is no such level.
    """
    if level not in LEVELS:
        raise ValueError(f"level must be one of {', '.join(LEVELS)}, not {level!r}")
    if config is not None:
        require_same_task(config, plan)
    if len(plan.x) == 0:
        raise SolverFailed(f"there is no timing to check: {getattr(plan, 'message', 'the plan is empty')}")
    if not (np.isfinite(plan.x).all() and np.isfinite(plan.u).all()):
        raise SolverFailed("the timing has numbers that are not finite")
    for contact in plan.problem.limits.laws:
        raise ConfigError(f"{contact} has a contact law of its own, which a certificate does not know", "objects")
    began = time.perf_counter()
    config, how = config or plan.problem.config, LEVELS[level]
    intervals = int(np.count_nonzero(np.diff(plan.s) > 0.0))
    points = max(contact_points(config), FEW_POINTS)
    few = intervals * (2 + len(how.between)) * points <= how.most_work
    at = instants(plan, how.between if few else (0.5,))
    world, tally = build_world(config, plan.problem.robot, plan.problem.path, stances(plan, at)), Tally(at.grid)
    _check_timing(plan, at, tally)
    samples = _check(plan, world, at, how, np.random.default_rng(seed), tally)
    worst = _worst(tally, at)
    return Certificate(
        passed=all(_passes(found, on_grid) for (_, on_grid), found in tally.worst.items()),
        margin=worst.margin,
        worst=worst,
        margins=_margins(tally),
        level=level,
        seed=seed,
        samples=samples,
        tests=tally.tests,
        instants=len(at.s),
        intervals=intervals,
        seconds=time.perf_counter() - began,
    )


def _check(plan: Plan, world: World, at: Instants, how: Level, rng: np.random.Generator, tally: Tally) -> int:
    """Look at all limits, and return the number of random samples."""
    moving, joints = motion(plan, at, world.links)
    robot, count = plan.problem.robot, len(at.s)
    limits = robot.limits.torque[robot.motors]
    check_kinematics(world, joints, at.free, robot.limits, tally)
    check_places(plan, at, tally)
    starts = [world.nominal.repeated(count)]
    starts += [world.sample(rng, count, corners=True) for _ in range(how.starts if world.uncertain else 0)]
    known = [] if robot.base else [KnownTorques(joints, limits, np.arange(count))]
    for part in known:
        check_torque(world, moving, part, tally)
    searches = [Search(world, system, moving, how.search.gap, tally) for system in world.systems]
    shared = sum(system.at is not None and not system.simple for system in world.systems)
    for search, system in zip(searches, world.systems, strict=True):
        searched = search.run(starts, how.search)
        if system.at is not None:
            own = joints.at(system.at)
            if system.simple:
                own = own.standing_on(world.contacts[system.contacts[0]].patch.name, search.motion)
                known.append(KnownTorques(own, limits, system.at))
                check_torque(world, search.motion, known[-1], tally)
            else:
                check_shared_torque(search, searched, own, limits, how.shared_torques // shared, tally)
    work = count * max(sum(len(contact.patch.polygon) for contact in world.contacts), FEW_POINTS)
    half = max(2, min(how.samples, how.effort // work)) // 2 if world.uncertain else 0
    for corners in (False, True) if half else ():
        check_samples(world, moving, known, searches, world.sample(rng, half, corners), how.per_program, tally)
    for search in searches:
        search.report()
    return 2 * half


def _check_timing(plan: Plan, at: Instants, tally: Tally) -> None:
    """Check that x is piecewise linear with slope 2 u, not negative, and 0 where the robot must stand still."""
    ds = np.diff(plan.s)
    moving = ds > 0.0
    jump = np.where(moving, np.abs(np.diff(plan.x) - 2.0 * ds * plan.u), 0.0)
    still = np.ones(len(plan.s), dtype=bool)
    still[1:-1] = ~moving[:-1] | ~moving[1:]
    off = np.maximum(np.where(still, np.abs(plan.x), 0.0), -plan.x)
    off[:-1] = np.maximum(off[:-1], jump)
    size = TIMING_TOLERANCE * max(float(np.abs(plan.x).max()), np.finfo(float).tiny)
    where = int(np.argmax(off))
    grid = np.flatnonzero(at.grid)
    instant = int(grid[np.argmin(np.abs(at.s[grid] - plan.s[where]))])
    tally.add(names.TIMING, Found(float(off[where]) / size, instant, names.TIMING, {}))


def _passes(found: Found, on_grid: bool) -> bool:
    return found.utilisation <= 1.0 + (GRID_TOLERANCE if on_grid else BETWEEN_TOLERANCE)


def _worst(tally: Tally, at: Instants) -> Worst:
    found = max(tally.worst.values(), key=lambda found: found.utilisation)
    t = found.instant
    place = float(at.s[t]), float(at.t[t]), bool(at.grid[t])
    return Worst(found.limit, 1.0 - found.utilisation, *place, dict(found.parameters))


def _margins(tally: Tally) -> dict[LimitName, Margin]:
    def margin(limit: LimitName, on_grid: bool) -> float:
        found = tally.worst.get((limit, on_grid))
        return np.inf if found is None else 1.0 - found.utilisation

    return {limit: Margin(margin(limit, True), margin(limit, False)) for limit, on_grid in tally.worst if on_grid}
