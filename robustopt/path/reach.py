"""Reasons why an arm cannot follow a path of poses: reach, joint limits or singularities, each in a sentence."""

from __future__ import annotations

import numpy as np

from robustopt.arrays import Array
from robustopt.config import Config
from robustopt.errors import ConfigProblem, PathError
from robustopt.path.branches import Branch
from robustopt.path.inverse_kinematics import Solution, solve_from_everywhere
from robustopt.path.pose_path import PosePath
from robustopt.robot import Robot

WAYS_OUT = "move the poses, put one between them, mount the tray or tool otherwise, or give another path.start"


def start_position(config: Config, robot: Robot) -> Array | None:
    """Return `path.start` as an array (n,) [rad or m], or None.

    Args:
        config: the configuration.
        robot: the arm.

    Raises:
        PathError: it does not have one value for each joint.
    """
    start = config.path.start
    if start is None or not isinstance(start, tuple):
        return None
    if len(start) != robot.n:
        raise PathError(
            f"has {len(start)} values; the robot has {robot.n} joints: {', '.join(robot.joint_names)}", key="path.start"
        )
    return np.array(start)


def limit_sentence(robot: Robot, q: Array) -> str:
    """Describe the joint that is furthest beyond its limit, and its position.

    Args:
        robot: the arm.
        q: joint positions (n,) [rad or m].
    """
    beyond = np.maximum(robot.limits.lower - q, q - robot.limits.upper)
    joint = int(np.argmax(beyond))
    limit = robot.limits.upper[joint] if q[joint] > robot.limits.upper[joint] else robot.limits.lower[joint]
    unit = "rad" if robot.hinges[joint] else "m"
    return f"{robot.joint_names[joint]} would be at {q[joint]:.3f} {unit}, beyond its limit of {limit:.3f} {unit}"


def branch_problems(robot: Robot, path: PosePath, branches: list[Branch], start: Array | None) -> list[ConfigProblem]:
    """Return the reasons why no branch along the path is usable.

    Args:
        robot: the arm.
        path: path of the carrier.
        branches: the branches, none of which is usable.
        start: start position in the configuration (n,) [rad or m], or None.
    """
    unreachable = _unreachable_poses(robot, path)
    if unreachable:
        return unreachable
    if not branches:
        return [ConfigProblem("path.start", "the first pose cannot be reached from there; leave it out, or move it")]
    complete = [branch for branch in branches if branch.ended_at is None]
    if complete:
        return [_limit_problem(robot, path, min(complete, key=lambda branch: branch.violation))]
    return [_end_problem(robot, path, max(branches, key=lambda branch: branch.ended_at or 0.0))]


def _unreachable_poses(robot: Robot, path: PosePath) -> list[ConfigProblem]:
    problems = []
    for i, (position, rotation) in enumerate(zip(path.position, path.rotation, strict=True)):
        nearest = solve_from_everywhere(robot, position, rotation)[0]
        if not nearest.converged:
            problems.append(
                ConfigProblem(
                    f"path.{path.noun}[{i}]",
                    f"is out of reach: {_miss(nearest)}; move it, the base or the mounting of the tray or tool",
                )
            )
    return problems


def _limit_problem(robot: Robot, path: PosePath, branch: Branch) -> ConfigProblem:
    beyond = np.maximum(robot.limits.lower - branch.q, branch.q - robot.limits.upper).max(axis=1)
    worst = int(np.argmax(beyond))
    return ConfigProblem(
        f"path.{path.noun}", f"{path.label(branch.sigma[worst])}: {limit_sentence(robot, branch.q[worst])}; {WAYS_OUT}"
    )


def _end_problem(robot: Robot, path: PosePath, branch: Branch) -> ConfigProblem:
    assert branch.ended_at is not None
    index = int(np.searchsorted(branch.sigma, branch.ended_at, side="right"))
    following = branch.sigma[min(index, len(branch.sigma) - 1)]
    position, rotation = (value[0] for value in path.pose(np.array([following])))
    nearest = solve_from_everywhere(robot, position, rotation)[0]
    if nearest.converged:
        reason = "the arm meets a singularity and could go on only with a jump"
    else:
        reason = f"the arm gets out of reach: {_miss(nearest)}"
    return ConfigProblem(f"path.{path.noun}", f"{path.label(branch.ended_at)}: {reason}; {WAYS_OUT}")


def _miss(nearest: Solution) -> str:
    distance, angle = round(1000 * nearest.distance, 4), round(nearest.angle, 6)
    return f"the nearest pose is {distance:.4g} mm and {angle:.3g} rad away"
