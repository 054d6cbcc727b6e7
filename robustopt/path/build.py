"""The path of a configuration: through poses or joint waypoints, or along footsteps.

Without steps, s is proportional to the length of the path of the carrier (translation and turn, see `pose_path`) or,
for joint waypoints, to the chord length of the joints.
"""

from __future__ import annotations

from collections.abc import Iterable
from itertools import pairwise

import numpy as np
from scipy.interpolate import CubicSpline

from robustopt.arrays import Array
from robustopt.config import Config, PathConfig
from robustopt.errors import PathError
from robustopt.path.branches import LIMIT_TOLERANCE, Branch, BranchLostError, fit_branch, follow_branches
from robustopt.path.collision import Collision, CollisionCheck
from robustopt.path.joint_waypoints import KEY, Waypoints, joint_waypoints
from robustopt.path.path import Path
from robustopt.path.pose_path import PosePath, pose_path
from robustopt.path.reach import WAYS_OUT, branch_problems, limit_sentence, start_position
from robustopt.path.upright import require_upright
from robustopt.path.walking_path import walking_path
from robustopt.robot import Robot

CHECK_STEP = 0.02
"""Largest joint step between the positions that are checked for collisions [rad or m]: 2 cm at 1 m."""

LONGEST = 4000.0
"""Longest path whose collisions are checked [rad or m], in 200,000 positions (our choice)."""


def build_path(config: Config, robot: Robot, collisions: bool = True) -> Path:
    """Build the path of a configuration.

    Args:
        config: the configuration.
        robot: the robot.
        collisions: False to leave out the collision check, which the configuration may leave out too.

    Raises:
        PathError: a pose or foothold is out of reach, a joint leaves its range, the solution of the inverse kinematics
            jumps, bodies collide, or an object stands on a face that does not point up.
    """
    path = _path(config, robot, collisions and config.robot.collision.check)
    require_upright(config, robot, path)
    return path


def first_collision(path: Path, check: CollisionCheck) -> tuple[float, Collision] | None:
    """Return where bodies collide first along a path, s, and their collision; None if none do.

    Args:
        path: the path.
        check: the collision check.

    Raises:
        PathError: the path is too long to be checked.
    """
    s = path.fine_grid()
    s = _thinned(s, path(s))
    collision = check.first(path(s))
    return None if collision is None else (float(s[collision.index]), collision)


def _path(config: Config, robot: Robot, collisions: bool) -> Path:
    if config.path.steps is not None:
        return walking_path(config, robot)
    if config.path.joints is not None:
        return _joint_path(config, robot, collisions)
    poses = pose_path(config.path)
    start = start_position(config, robot)
    branches = follow_branches(robot, poses, start)
    usable = [branch for branch in branches if branch.usable]
    if not usable:
        raise PathError(branch_problems(robot, poses, branches, start))
    paths = (_branch_path(robot, poses, branch, config.path) for branch in usable)
    return _first_sound(paths, robot, CollisionCheck(config, robot) if collisions else None, f"path.{poses.noun}")


def _joint_path(config: Config, robot: Robot, collisions: bool) -> Path:
    waypoints = joint_waypoints(config, robot.joint_names, robot.hinges)
    q, speeds = waypoints.q, _end_speeds(config, waypoints)
    pauses = config.path.pause_times
    late = next((i for i in pauses if i >= len(q) - 1), None)
    if late is not None:
        raise PathError(f"found waypoint {late}; expected a number from 1 to {len(q) - 2}", key="path.pauses")
    stops = np.union1d(waypoints.stops, np.array(sorted(pauses), dtype=np.intp))
    chord = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(q, axis=0), axis=1))))
    s = chord / chord[-1]
    ends = [0, *stops, len(q) - 1]
    pieces = [CubicSpline(s[start : end + 1], q[start : end + 1]) for start, end in pairwise(ends)]
    path = Path(
        pieces, s[ends], s, "joints", notes=waypoints.notes, recorded=waypoints.recorded,
        pauses=np.array([pauses.get(int(stop), 0.0) for stop in stops]),
        speeds=speeds,
    )  # fmt: skip
    try:
        return _first_sound([path], robot, CollisionCheck(config, robot) if collisions else None, KEY)
    except PathError as error:
        if waypoints.doubt is None:
            raise
        raise PathError(f"{error.problems[0].message}; {waypoints.doubt}", key=KEY) from None


def _end_speeds(config: Config, waypoints: Waypoints) -> tuple[float, float]:
    """Return the lengths of the joint velocities at the start and at the end.

    Raises:
        PathError: the robot is to move where a repeated waypoint is a stop.
    """
    speeds = config.path.start_speed, config.path.end_speed
    for key, speed, stands in zip(("start_speed", "end_speed"), speeds, waypoints.ends_at_rest, strict=True):
        if stands and speed > 0.0:
            raise PathError(
                f"found {speed:g}, but the waypoint there is repeated, and path.repeated is stop; expected 0, or "
                "path.repeated: drop",
                key=f"path.{key}",
            )
    return speeds


def _branch_path(robot: Robot, poses: PosePath, branch: Branch, config: PathConfig) -> Path | str:
    """Fit splines to a branch; if that fails, return the reason as a sentence."""
    waypoints = poses.start / poses.length
    inner = np.flatnonzero(poses.stops)[1:-1]
    try:
        pieces = fit_branch(robot, poses, branch, config.tolerance)
    except BranchLostError as error:
        return f"{poses.label(error.sigma)}: {error.reason}; {WAYS_OUT}"
    times = np.array([config.pause_times.get(int(stop), 0.0) for stop in inner])
    return Path(pieces, poses.breaks / poses.length, waypoints, poses.noun, pauses=times)


def _first_sound(paths: Iterable[Path | str], robot: Robot, check: CollisionCheck | None, key: str) -> Path:
    """Return the first path that stays within the joint limits and does not collide.

    Args:
        paths: candidates; a candidate that failed is a sentence.
        robot: the robot.
        check: the collision check, None to leave it out.
        key: key of the configuration that the error names.

    Raises:
        PathError: no path is sound; the error describes the first candidate.
    """
    objections = []
    for path in paths:
        objection = path if isinstance(path, str) else _objection(path, robot, check)
        if isinstance(path, Path) and objection is None:
            return path
        objections.append(objection)
    others = f" (the {len(objections) - 1} other ways to move the arm fail too)" if len(objections) > 1 else ""
    raise PathError(f"{objections[0]}{others}", key=key)


def _objection(path: Path, robot: Robot, check: CollisionCheck | None) -> str | None:
    """Describe the joint that exceeds its limit most, or the first two bodies that collide; None without either."""
    s = path.fine_grid()
    q = path(s)
    beyond = np.maximum(robot.limits.lower - q, q - robot.limits.upper).max(axis=1)
    worst = int(np.argmax(beyond))
    if beyond[worst] > LIMIT_TOLERANCE:
        return f"{path.label(s[worst])}: {limit_sentence(robot, q[worst])}"
    found = None if check is None else first_collision(path, check)
    if found is None:
        return None
    place, collision = found
    first, second = collision.bodies
    return (
        f"{path.label(place)}: {first} and {second} collide, {1000 * collision.depth:.1f} mm deep; "
        f"change the path or the mounting, or, if they may touch, add [{first}, {second}] to robot.collision.exclude"
    )


def _thinned(s: Array, q: Array) -> Array:
    """Return points of the path between which no joint moves by more than `CHECK_STEP`.

    Raises:
        PathError: the path is too long to be checked.
    """
    moved = np.concatenate(([0.0], np.cumsum(np.abs(np.diff(q, axis=0)).max(axis=1))))
    if moved[-1] > LONGEST:
        raise PathError(
            f"the joints move by {moved[-1]:,.0f} rad or m in all; expected at most {LONGEST:,.0f}, or several tasks",
            key="path",
        )
    wanted = np.linspace(0.0, moved[-1], int(np.ceil(moved[-1] / CHECK_STEP)) + 1)
    return np.asarray(np.interp(wanted, moved, s))
