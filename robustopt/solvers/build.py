"""Problems of a configuration, each on its grid: of a given number of intervals, or adapted to the path."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from robustopt.config import Config
from robustopt.limits import ContactLaw, LimitFactory, TimeScalingProblem, rows_along
from robustopt.limits.grid import Grid, numbered_grid, with_fine_rests
from robustopt.limits.track import Track, build_track
from robustopt.path import Path, build_path
from robustopt.robot import Robot, load_robot
from robustopt.solvers.refine import adapted_track

FIRST_PART = 0.5
"""Part of the distance in which the jerk limit matters near rest that the first interval has."""


def build_problem(
    config: Config, limits: Sequence[LimitFactory] = (), laws: Mapping[str, ContactLaw] | None = None
) -> TimeScalingProblem:
    """Return the time-scaling problem of a configuration.

    A problem without a solution is not an error here; the status of its plan shows it.

    Args:
        config: the configuration.
        limits: further limits, each made from the track.
        laws: contact laws in place of the configured ones, by the name of the contact of an object.

    Raises:
        ConfigError: the configuration cannot be used.
        RobotError: its robot cannot be used.
        PathError: its path cannot be followed.
    """
    robot = load_robot(config)
    return rows_along(_track(config, robot, build_path(config, robot), limits, laws), config, limits, laws)


def build_rows(config: Config, robot: Robot, path: Path) -> TimeScalingProblem:
    """Return the problem of a configuration with a given robot and path.

    Args:
        config: the configuration.
        robot: the robot.
        path: the path.

    Raises:
        ConfigError: the configuration does not fit the robot.
    """
    return rows_along(_track(config, robot, path), config)


def track_of(config: Config) -> Track:
    """Return the track of a configuration, for problems that differ from its own in uncertain quantities only.

    Args:
        config: the configuration.

    Raises:
        ConfigError: the configuration cannot be used.
        RobotError: its robot cannot be used.
        PathError: its path cannot be followed.
    """
    robot = load_robot(config)
    return _track(config, robot, build_path(config, robot))


def _track(
    config: Config,
    robot: Robot,
    path: Path,
    limits: Sequence[LimitFactory] = (),
    laws: Mapping[str, ContactLaw] | None = None,
) -> Track:
    points = config.solver.collocation_points
    if points != "auto":
        return build_track(robot, path, _for_jerk(numbered_grid(path, points), robot, path))

    def problem_on(grid: Grid) -> TimeScalingProblem:
        return rows_along(build_track(robot, path, grid), config, limits, laws)

    track = adapted_track(path, problem_on)
    grid = _for_jerk(track.grid, robot, path)
    return track if grid is track.grid else build_track(robot, path, grid)


def _for_jerk(grid: Grid, robot: Robot, path: Path) -> Grid:
    """Return a grid that is finer near rests if the jerk of a joint is limited.

    A joint with acceleration and jerk limits A and J moves by A^3 / (6 J^2) until it reaches A from rest. The first
    interval is a part FIRST_PART of this distance, with the limits of the path coordinate; without an acceleration
    limit it is as short as `with_fine_rests` allows. Other limits may make the distance shorter, which matters little.
    """
    jerk, acceleration = robot.limits.jerk, robot.limits.acceleration
    if not np.isfinite(jerk).any():
        return grid
    pieces = np.arange(len(path.breaks) - 1)
    first = np.zeros((len(pieces), 2))
    for end in (0, 1):
        rate = np.abs(path.evaluate(path.breaks[pieces + end], pieces, 1))
        with np.errstate(divide="ignore"):
            fastest, reached = (jerk / rate).min(axis=1), (acceleration / rate).min(axis=1)
        known = np.isfinite(reached) & np.isfinite(fastest)
        first[known, end] = FIRST_PART * reached[known] ** 3 / (6.0 * fastest[known] ** 2)
    return with_fine_rests(grid, first)
