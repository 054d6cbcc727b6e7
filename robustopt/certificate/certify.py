"""Certificate of a plan: the worst utilisation of every limit over all values that are checked.

The certificate shares only the configuration, the kinematics and dynamics of the robot, the path, and the places of
objects and patches with the planner. It has its own reader of joint limits, rigid-body mechanics, force closure on
exact Coulomb cones, and search for the worst parameters.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from robustopt.certificate import names
from robustopt.certificate.cartesian import bodies_of, check_cartesian
from robustopt.certificate.joints import KnownTorques, check_jerk, check_kinematics, check_torque
from robustopt.certificate.motion import Instants, instants, interval_times, motion, stances
from robustopt.certificate.places import check_places
from robustopt.certificate.samples import check_samples
from robustopt.certificate.shared_torque import check_shared_torque
from robustopt.certificate.tally import Found, Tally
from robustopt.certificate.task import Task, task_of
from robustopt.certificate.world import World, build_world, contact_points
from robustopt.certificate.worst import Search, Thoroughness
from robustopt.config import Config
from robustopt.errors import ConfigError, SolverFailed
from robustopt.limits.names import LimitName
from robustopt.solvers import Plan

GRID_TOLERANCE = 1e-6
"""Violation at grid points that is accepted, as a share of the limit: solvers satisfy their rows, and the gauge is
computed, to about 1e-8.
"""

BETWEEN_TOLERANCE = 1e-2
"""Violation between grid points that is accepted, as a share of the limit: a discretisation error, which is
reported.
"""

TIMING_TOLERANCE = 1e-6
"""Share of the largest x by which x may differ from x_i + 2 ds_i u_i, fall below 0, or differ from 0 at a stop."""

FEW_POINTS = 8
"""Number of contact points below which the time per instant hardly decreases further."""


@dataclass(frozen=True)
class Level:
    """Thoroughness of a certificate.

    Attributes:
        between: instants between grid points, as shares of each interval.
        starts: number of random corners from which the search starts, besides the configured values.
        search: steps of the search.
        samples: number of sets of random values.
        per_program: instants per sample at which contacts that share a wrench are checked.
        shared_torques: instants, over all stances on several contacts, at which joint torques are checked.
        most_work: instants times contact points above which each interval is checked at its middle and ends alone.
        effort: largest number of instants times contact points times samples; samples are left out to keep to it.
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
"""On one core, `quick` takes 0.1 to 0.8 s for 200 intervals, and `full` from 20 s (a box) to 80 s (three objects)."""


@dataclass(frozen=True)
class Margin:
    """Smallest unused share of a limit, at grid points and between them; negative if the limit is violated.

    Attributes:
        on_grid: margin at grid points.
        between: margin between grid points.
    """

    on_grid: float
    between: float


@dataclass(frozen=True)
class Worst:
    """Place and parameters of the smallest margin.

    Attributes:
        limit: name of the limit.
        margin: margin as a share of the limit; negative if it is violated.
        s: position along the path.
        t: time [s].
        on_grid: True at a grid point, False between two.
        parameters: friction, force [N], mass [kg], displacements center_of_mass and contact_points [m], and
            joint_acceleration (error [rad/s^2 or m/s^2]), each by name; only values that are uncertain or affect the
            limit.
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
        if -BETWEEN_TOLERANCE <= self.margin < 0.0 and not self.on_grid:
            left = f"within the tolerance of {100 * BETWEEN_TOLERANCE:g} %, {-100 * self.margin:.2g} % beyond the limit"
        elif -GRID_TOLERANCE <= self.margin < 0.0:
            left = "0 % of the limit left"
        elif np.isfinite(self.margin):
            left = f"{100 * self.margin:.3g} % of the limit left"
        return f"{self.limit}: {left} at t = {self.t:.3f} s, s = {self.s:.4f}, {place}"


@dataclass(frozen=True)
class Certificate:
    """Result of the check of a plan for a finite set of parameter values.

    Attributes:
        passed: whether the plan keeps its limits.
        margin: smallest margin, as a share of its limit; negative if the limit is violated.
        worst: place and parameters of the smallest margin.
        margins: smallest margin of each limit.
        level: thoroughness, `quick` or `full`.
        seed: seed of the random samples.
        samples: number of random samples of all uncertain values.
        tests: number of utilisations that were computed or bounded.
        instants: number of instants that were checked.
        intervals: number of intervals of the plan, all of which were checked.
        seconds: computing time [s].
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
        """Return the result in a few sentences, with advice if a finer grid is needed."""
        verdict = "passes" if self.passed else "fails"
        effort = f"{self.level}: {self.samples} samples, {self.tests} tests"
        advice = ""
        if not self.passed and not self.worst.on_grid:
            advice = f" The grid is too coarse there: try more solver.collocation_points than {self.intervals}."
        return f"The plan {verdict} its certificate ({effort}). {self.worst}.{advice}"


def certify(plan: Plan, level: str = "quick", seed: int = 0, config: Config | None = None) -> Certificate:
    """Check a plan, independently of the solver that made it.

    Both ends of every interval of the grid and points in between are checked, for the configured values, for the worst
    ends of all intervals of the parameters, which a search finds, and for random values of all parameters at once. The
    same seed gives the same certificate.

    Args:
        plan: the plan.
        level: `quick`, within about a second, or `full`, with 10,000 random samples and a longer search for the worst
            case.
        seed: seed of the random samples.
        config: a configuration, along whose path the timing of the plan is checked for all of its values: robot,
            limits, gravity, tray, objects, frictions and intervals; by default the plan's own.

    Returns:
        The certificate, which says whether the plan keeps its limits.

    Raises:
        ConfigError: the configuration cannot be used, the timing does not stop where its path does, or the plan has a
            user-defined contact law.
        SolverFailed: the plan has no timing or not a finite one.
        ValueError: there is no such level.
    """
    if level not in LEVELS:
        raise ValueError(f"level must be one of {', '.join(LEVELS)}, not {level!r}")
    if len(plan.x) == 0:
        raise SolverFailed(f"there is no timing to check: {getattr(plan, 'message', 'the plan is empty')}")
    if not (np.isfinite(plan.x).all() and np.isfinite(plan.u).all()):
        raise SolverFailed("the timing has numbers that are not finite")
    for contact in plan.problem.limits.laws:
        raise ConfigError(f"{contact} has a contact law of its own, which a certificate does not know", "objects")
    began = time.perf_counter()
    task, how = task_of(plan, config), LEVELS[level]
    intervals = int(np.count_nonzero(np.diff(plan.s) > 0.0))
    points = max(contact_points(task.config), FEW_POINTS)
    few = intervals * (2 + len(how.between)) * points <= how.most_work
    at = instants(plan, how.between if few else (0.5,))
    world = build_world(task.config, task.robot, task.path, stances(task.path, at))
    tally = Tally(at.grid)
    _check_timing(plan, task, at, tally)
    samples = _check(plan, task, world, at, how, np.random.default_rng(seed), tally)
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


def _check(
    plan: Plan, task: Task, world: World, at: Instants, how: Level, rng: np.random.Generator, tally: Tally
) -> int:
    """Check all limits, and return the number of random samples."""
    moving, joints = motion(task, at, dict.fromkeys((*world.links, *bodies_of(task))))
    robot, count = task.robot, len(at.s)
    limits = task.limits.torque[robot.motors]
    check_kinematics(world, joints, at.free, task.limits, tally)
    check_jerk(plan, task, at, tally)
    check_cartesian(world, task, moving, at, tally)
    check_places(task, at, tally)
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


def _check_timing(plan: Plan, task: Task, at: Instants, tally: Tally) -> None:
    """Check that x and u are those of a motion, that x is not negative, 0 at every stop, and as wanted at both ends."""
    ds = np.diff(plan.s)
    moving = ds > 0.0
    if plan.steady:
        change = 2.0 * ds * plan.u
    else:
        root = np.sqrt(np.maximum(plan.x, 0.0))
        change = 0.5 * (plan.u + plan.u_end) * interval_times(plan) * (root[:-1] + root[1:])
    jump = np.where(moving, np.abs(np.diff(plan.x) - change), 0.0)
    still = np.ones(len(plan.s), dtype=bool)
    still[1:-1] = ~moving[:-1] | ~moving[1:]
    wanted = np.zeros(len(plan.s))
    wanted[[0, -1]] = np.square(task.path.end_speeds)
    off = np.maximum(np.where(still, np.abs(plan.x - wanted), 0.0), -plan.x)
    off[:-1] = np.maximum(off[:-1], jump)
    size = TIMING_TOLERANCE * max(float(np.abs(plan.x).max()), np.finfo(float).tiny)
    where = int(np.argmax(off))
    grid = np.flatnonzero(at.grid)
    instant = int(grid[np.argmin(np.abs(at.s[grid] - plan.s[where]))])
    tally.add(names.TIMING, Found(float(off[where]) / size, instant, names.TIMING, {}))


def _passes(found: Found, on_grid: bool) -> bool:
    return found.utilisation <= 1.0 + (GRID_TOLERANCE if on_grid else BETWEEN_TOLERANCE)


def _worst(tally: Tally, at: Instants) -> Worst:
    """Return the worst utilisation, of those that exceed their tolerance if there are any."""
    worst = tally.worst.items()
    _, found = max(worst, key=lambda item: (not _passes(item[1], item[0][1]), item[1].utilisation))
    t = found.instant
    place = float(at.s[t]), float(at.t[t]), bool(at.grid[t])
    limit = found.limit if found.cause is None else found.cause()
    return Worst(limit, 1.0 - found.utilisation, *place, dict(found.parameters))


def _margins(tally: Tally) -> dict[LimitName, Margin]:
    def margin(limit: LimitName, on_grid: bool) -> float:
        found = tally.worst.get((limit, on_grid))
        return np.inf if found is None else 1.0 - found.utilisation

    return {limit: Margin(margin(limit, True), margin(limit, False)) for limit, on_grid in tally.worst if on_grid}
