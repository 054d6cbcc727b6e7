"""Certificate of a plan: its worst utilisation of every limit, for every value in the intervals that is looked at.

Nothing here is shared with the planner but the configuration, the robot's kinematics and dynamics, the path, and where
the objects stand: the rigid-body mechanics, the force closure on exact Coulomb cones and the search for the worst
parameters are its own.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from robustopt.certificate.contacts import Thoroughness, check_contacts
from robustopt.certificate.draws import check_draws
from robustopt.certificate.joints import check_kinematics, check_torque
from robustopt.certificate.motion import Instants, Motion, instants, motion
from robustopt.certificate.scene import Scene, build_scene
from robustopt.certificate.tally import Found, Tally
from robustopt.certificate.walking import check_walk
from robustopt.config import Config
from robustopt.errors import SolverFailed

if TYPE_CHECKING:
    from robustopt.solvers import Plan

GRID_TOLERANCE = 1e-6
"""Violation on the grid that is forgiven, as a share of the limit: solvers meet their rows to about 1e-8, and the gauge
is found to 1e-8."""

BETWEEN_TOLERANCE = 1e-2
"""Violation between grid points that is forgiven, as a share of the limit: the discretisation's, reported."""

TIMING_TOLERANCE = 1e-6
"""Share of the largest x by which x may differ from x_i + 2 ds_i u_i, be negative, or differ from 0 at a stop."""

FEW_POINTS = 8
"""With fewer contact points an instant hardly takes less time."""

TIMING = "timing"
"""Name of the limit that x and u belong together and the robot starts, stops and ends at rest."""


@dataclass(frozen=True)
class Level:
    """How thoroughly to look.

    between: shares of each interval; starts: random corners from which the search starts besides the configured values;
    search: how it goes on; draws: random draws; per_bridge: instants of each draw at which bridges are looked at;
    most_work: most instants times contact points, kept to by leaving intervals out; effort: most of these times draws,
    kept to by drawing less
    """

    between: tuple[float, ...]
    starts: int
    search: Thoroughness
    draws: int
    per_bridge: int
    most_work: int
    effort: int


LEVELS = {
    "quick": Level((0.25, 0.5, 0.75), 0, Thoroughness(8, 3, 1e-5), 100, 2, 25_000, 1_000_000),
    "full": Level((0.125, 0.25, 0.5, 0.75, 0.875), 4, Thoroughness(1, 4, 1e-7), 10_000, 10, 10**12, 10**12),
}
"""quick takes 0.2 to 0.6 s at 200 intervals, full 20 s for two boxes to 100 s for a bridge, on one core."""


@dataclass(frozen=True)
class Margin:
    """Smallest share of a limit that is left, on the grid and between grid points; negative if it is violated."""

    on_grid: float
    between: float


@dataclass(frozen=True)
class Worst:
    """Where the margin is smallest, and for which values of the uncertain parameters.

    limit: in the configuration's words; s, t: place on the path and time [s]; on_grid: at a grid point or between two;
    parameters: friction [1], mass [kg], center_of_mass and contact_points (displacements [m]), joint_acceleration
    (error [rad/s^2]), each by name, as far as they are uncertain or matter
    """

    limit: str
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
    """Whether a plan keeps its limits for the values that were looked at, and how narrowly.

    margin: worst over everything, as a share of the limit, negative if violated; margins: per named limit; draws:
    random draws of all uncertain values; tests: utilisations that were computed or bounded; intervals,
    intervals_checked: of the plan, and how many of them were looked at; seconds: time it took
    """

    passed: bool
    margin: float
    worst: Worst
    margins: Mapping[str, Margin]
    level: str
    seed: int
    draws: int
    tests: int
    instants: int
    intervals: int
    intervals_checked: int
    seconds: float = field(compare=False)

    @property
    def sentence(self) -> str:
        """The result in a few sentences, with advice where solvers cannot do better on their grid."""
        verdict = "passes" if self.passed else "fails"
        effort = f"{self.level}: {self.draws} draws, {self.tests} tests"
        if self.intervals_checked < self.intervals:
            effort += f", {self.intervals_checked} of {self.intervals} intervals"
        advice = ""
        if not self.passed and not self.worst.on_grid:
            advice = f" The grid is too coarse there: try more solver.collocation_points than {self.intervals}."
        return f"The plan {verdict} its certificate ({effort}). {self.worst}.{advice}"


def certify(config: Config, plan: Plan, level: str = "quick", seed: int = 0) -> Certificate:
    """Check a plan: `quick` within about a second, `full` with 10,000 random draws and more of the worst cases.

    Looks at both ends of every interval of the grid and in between, with the configured values, with the worst ends of
    all intervals (searched), and with random values of everything at once. The same seed gives the same certificate.
    Raises SolverFailed if the plan has no timing or not a finite one, and ValueError for an unknown level.
    """
    if level not in LEVELS:
        raise ValueError(f"level must be one of {', '.join(LEVELS)}, not {level!r}")
    if len(plan.x) == 0:
        raise SolverFailed(f"there is no timing to check: {getattr(plan, 'message', 'the plan is empty')}")
    if not (np.isfinite(plan.x).all() and np.isfinite(plan.u).all()):
        raise SolverFailed("the timing has numbers that are not finite")
    began = time.perf_counter()
    how = LEVELS[level]
    scene = None if config.walks else build_scene(config, plan.problem.robot.joint_names)
    intervals = int(np.count_nonzero(np.diff(plan.s) > 0.0))
    between, every = _thinned(how, intervals, FEW_POINTS if scene is None else scene.points.shape[1])
    at = instants(plan, between, every)
    tally = Tally(at.grid)
    _check_timing(plan, at, tally)
    if scene is None:
        draws = check_walk(config, plan, at, level, how.draws, seed, tally)
    else:
        draws = _check(scene, motion(plan, at), how, np.random.default_rng(seed), tally)
    worst = _worst(tally, at)
    return Certificate(
        passed=all(_passes(found, on_grid) for (_, on_grid), found in tally.worst.items()),
        margin=worst.margin,
        worst=worst,
        margins=_margins(tally),
        level=level,
        seed=seed,
        draws=draws,
        tests=tally.tests,
        instants=len(at.s),
        intervals=intervals,
        intervals_checked=-(-intervals // every),
        seconds=time.perf_counter() - began,
    )


def _thinned(how: Level, intervals: int, points: int) -> tuple[tuple[float, ...], int]:
    """Places in each interval and the step between intervals that keep to the level's work."""
    between, most = how.between, how.most_work // max(points, FEW_POINTS)
    if intervals * (2 + len(between)) > most:
        between = (0.5,)
    return between, max(1, -(-intervals * (2 + len(between)) // most))


def _check(scene: Scene, moving: Motion, how: Level, rng: np.random.Generator, tally: Tally) -> int:
    """Look at all limits; returns the number of random draws."""
    count = len(moving.free)
    check_kinematics(scene, moving, tally)
    check_torque(scene, moving, scene.nominal.repeated(count), tally)
    starts = [scene.nominal.repeated(count)]
    starts += [scene.draw(rng, count, corners=True) for _ in range(how.starts if scene.uncertain else 0)]
    for system in scene.systems:
        check_contacts(scene, moving, system, starts, how.search, tally)
    if not scene.uncertain:
        return 0
    work = count * max(scene.points.shape[1], FEW_POINTS)
    draws: int = max(2, min(how.draws, how.effort // work)) // 2
    for corners in (False, True):
        check_draws(scene, moving, scene.draw(rng, draws, corners), how.per_bridge, tally)
    return 2 * draws


def _check_timing(plan: Plan, at: Instants, tally: Tally) -> None:
    """x piecewise linear with slope 2 u, not negative, and 0 where the robot must stand still."""
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
    tally.add(TIMING, Found(float(off[where]) / size, instant, TIMING, {}))


def _passes(found: Found, on_grid: bool) -> bool:
    return found.utilisation <= 1.0 + (GRID_TOLERANCE if on_grid else BETWEEN_TOLERANCE)


def _worst(tally: Tally, at: Instants) -> Worst:
    found = max(tally.worst.values(), key=lambda found: found.utilisation)
    t = found.instant
    place = float(at.s[t]), float(at.t[t]), bool(at.grid[t])
    return Worst(found.limit, 1.0 - found.utilisation, *place, dict(found.parameters))


def _margins(tally: Tally) -> dict[str, Margin]:
    def margin(limit: str, on_grid: bool) -> float:
        found = tally.worst.get((limit, on_grid))
        return np.inf if found is None else 1.0 - found.utilisation

    return {limit: Margin(margin(limit, True), margin(limit, False)) for limit, on_grid in tally.worst if on_grid}
