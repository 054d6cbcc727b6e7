"""Problems of a configuration, each on its grid: of a given number of intervals, or adapted to the path."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from robustopt.config import Config
from robustopt.limits import ContactLaw, LimitFactory, TimeScalingProblem, rows_along
from robustopt.limits.grid import Grid, numbered_grid
from robustopt.limits.track import Track, build_track
from robustopt.path import Path, build_path
from robustopt.robot import Robot, load_robot
from robustopt.solvers.refine import adapted_track


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
        return build_track(robot, path, numbered_grid(path, points))

    def problem_on(grid: Grid) -> TimeScalingProblem:
        return rows_along(build_track(robot, path, grid), config, limits, laws)

    return adapted_track(path, problem_on)
