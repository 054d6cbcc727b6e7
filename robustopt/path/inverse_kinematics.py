"""Inverse kinematics of the carrier frame: damped Gauss-Newton steps, from many starts or along a path.

With the error e = (p* - p, log(R* R^T)) and the Jacobian J of the carrier in the world, a step is the shortest one
that solves J dq = e, damped in proportion to |e|^2, so that it converges quadratically unless the arm is singular.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy.spatial.transform import Rotation

from robustopt.arrays import Array
from robustopt.robot import Robot

ACCURACY = 1e-10
"""Pose error of a solution [m and rad]: far below any tolerance of a path, far above rounding."""
DAMPING = 0.1
"""Damping per squared error: keeps steps moderate far from the solution, vanishes at it."""
LONGEST_STEP = 0.5
"""Longest joint step of one iteration [rad or m]: the linearisation does not reach further."""
SEEDS = 64
"""Number of starts from which a pose is solved: an arm of 6 joints has up to 16 solutions, mostly 8, each found from
a few starts.
"""


@dataclass(frozen=True)
class Solution:
    """A joint position, and the remaining error of the pose.

    Attributes:
        q: joint position (n,) [rad or m].
        distance: error of the position [m].
        angle: error of the orientation [rad].
    """

    q: Array
    distance: float
    angle: float

    @property
    def converged(self) -> bool:
        """Return whether the pose is reached."""
        return self.distance < ACCURACY and self.angle < ACCURACY


def solve_pose(robot: Robot, position: Array, rotation: Array, q: Array, iterations: int = 40) -> Solution:
    """Find a joint position that puts the carrier frame at a pose.

    Args:
        robot: the arm.
        position: desired position in the world (3,) [m].
        rotation: desired rotation into the world (3, 3).
        q: joint position to start from (n,).
        iterations: largest number of steps.

    Returns:
        The position after the last step, whether or not it reaches the pose.
    """
    return solve_from(robot, position, rotation, np.asarray(q, dtype=float)[None], iterations)[0]


def solve_from(robot: Robot, position: Array, rotation: Array, starts: Array, iterations: int = 40) -> list[Solution]:
    """Find joint positions that put the carrier frame at a pose, from several starts that do not affect each other.

    Args:
        robot: the arm.
        position: desired position in the world (3,) [m].
        rotation: desired rotation into the world (3, 3).
        starts: joint positions to start from (S, n).
        iterations: largest number of steps.

    Returns:
        The positions after the last step, whether or not they reach the pose, one for each start.
    """
    q = np.array(starts, dtype=float)
    lengths = [(math.inf, math.inf)] * len(q)
    left = list(range(len(q)))
    for k in range(iterations):
        p, R, jacobians = robot.carrier_jacobians(q[left])
        turns = (rotation @ R.transpose(0, 2, 1)).reshape(-1, 9).tolist()
        errors = np.concatenate((position - p, [rotation_vector(turn) for turn in turns]), axis=1)
        far = []
        for row, (i, (x, y, z, rx, ry, rz)) in enumerate(zip(left, errors.tolist(), strict=True)):
            lengths[i] = math.hypot(x, y, z), math.hypot(rx, ry, rz)
            if max(lengths[i]) >= ACCURACY:
                far.append(row)
        left = [left[row] for row in far]
        if not left or k == iterations - 1:
            break
        steps = _damped_steps(jacobians[far], errors[far])
        longest = np.maximum(np.abs(steps).max(axis=1), LONGEST_STEP)
        q[left] += steps * (LONGEST_STEP / longest)[:, None]
    return [Solution(qi, *length) for qi, length in zip(q, lengths, strict=True)]


def solve_from_everywhere(robot: Robot, position: Array, rotation: Array) -> list[Solution]:
    """Solve for a pose from starts spread over the joint ranges.

    The starts are a Halton sequence without scrambling, the same in every run.

    Args:
        robot: the arm.
        position: desired position in the world (3,) [m].
        rotation: desired rotation into the world (3, 3).

    Returns:
        The solutions, nearest first; those that reach the pose differ from one another.
    """
    solutions: list[Solution] = []
    known = np.empty((0, robot.n))
    for solution in solve_from(robot, position, rotation, spread(robot, SEEDS)):
        if not solution.converged or not _near(robot, solution.q, known):
            solutions.append(solution)
            known = np.array([other.q for other in solutions if other.converged]).reshape(-1, robot.n)
    return sorted(solutions, key=lambda solution: solution.distance + solution.angle)


def rotation_vector(R: Sequence[float]) -> tuple[float, float, float]:
    """Return the rotation vector log(R) of a rotation [rad].

    Args:
        R: rotation matrix, row by row (9,).
    """
    xx, xy, xz, yx, yy, yz, zx, zy, zz = R
    x, y, z = zy - yz, xz - zx, yx - xy
    sine, cosine = math.sqrt(x * x + y * y + z * z) / 2, (xx + yy + zz - 1) / 2
    if sine < 1e-4 and cosine < 0:
        x, y, z = Rotation.from_matrix(np.reshape(R, (3, 3))).as_rotvec().tolist()
        return x, y, z
    scale = math.atan2(sine, cosine) / (2 * sine) if sine > 1e-9 else 0.5
    return x * scale, y * scale, z * scale


def _damped_steps(J: Array, error: Array) -> Array:
    """Return the steps (S, n) for Jacobians (S, 6, n) and errors (S, 6)."""
    transposed, columns = J.transpose(0, 2, 1), error[:, :, None]
    damping = (DAMPING * (error[:, None] @ columns) + 1e-14) * np.eye(min(J.shape[1:]))
    if J.shape[2] > J.shape[1]:
        return np.asarray((transposed @ np.linalg.solve(J @ transposed + damping, columns))[:, :, 0])
    return np.asarray(np.linalg.solve(transposed @ J + damping, transposed @ columns)[:, :, 0])


def spread(robot: Robot, count: int) -> Array:
    """Return joint positions spread over the joint ranges, or over [-pi, pi] if that is smaller, (count, n).

    Args:
        robot: the robot.
        count: number of positions.
    """
    narrow = robot.limits.upper - robot.limits.lower < 2 * np.pi
    lower, upper = np.where(narrow, robot.limits.lower, -np.pi), np.where(narrow, robot.limits.upper, np.pi)
    return np.asarray(lower + (upper - lower) * _halton(count, robot.n))


@cache
def _halton(count: int, dimensions: int) -> Array:
    """Return the first points of the Halton sequence in the unit cube after 0, (count, dimensions); read-only."""
    primes = [p for p in range(2, 1000) if all(p % divisor for divisor in range(2, math.isqrt(p) + 1))]
    points = np.zeros((count, dimensions))
    for column, base in enumerate(primes[:dimensions]):
        index, digit = np.arange(1, count + 1), 1.0
        while index.any():
            digit /= base
            points[:, column] += digit * (index % base)
            index = index // base
    points.setflags(write=False)
    return points


def _near(robot: Robot, q: Array, others: Array) -> bool:
    """Return whether a joint position (n,) is one of several (k, n), but for full turns."""
    difference = q - others
    difference = np.where(robot.hinges, (difference + np.pi) % (2 * np.pi) - np.pi, difference)
    return bool((np.abs(difference).max(axis=1) < 1e-3).any())
