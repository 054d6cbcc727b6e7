"""One joint path for a tray path: branches of the inverse kinematics are followed, and the best one is chosen.

A branch starts at one solution of the first pose and follows it by continuation. Among the branches that stay within
the joint limits the best has the arm high ("elbow up") and far from its limits (our choice).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from robustopt.inverse_kinematics import solve_from_everywhere, solve_pose
from robustopt.robot import Robot
from robustopt.tray_path import TrayPath

SPACING = 0.04
"""Distance of the poses along which branches are followed [m of sigma]."""
FEWEST_SAMPLES = 12
"""Fewest intervals of a piece, however short."""
LONGEST_JUMP = 0.35
"""Longest joint step between poses that counts as following a branch [rad or m]; longer ones are halved."""
HALVINGS = 6
"""How often a step is halved before the branch counts as ended: at a singularity or the end of the reach."""
CLEARANCE_WEIGHT = 0.2
"""Height of the arm's centre of mass that outweighs being at a joint limit instead of mid-range [m]."""
RETURN = 0.02
"""Share by which a redundant arm drifts back to its first posture at every sample, so that it does not wander."""


@dataclass(frozen=True)
class Branch:
    """A joint path at the samples `sigma` (S,) [m]: `q` (S, n), as far as it could be followed.

    `ended_at`: sigma at which it could not be followed further, None if it is complete. `violation`: how far it leaves
    the joint limits at worst [rad or m], negative inside. `score`: larger is better.
    """

    sigma: np.ndarray
    q: np.ndarray
    ended_at: float | None
    violation: float
    score: float

    @property
    def usable(self) -> bool:
        """Whether it is complete and within the joint limits."""
        return self.ended_at is None and self.violation <= 0


def samples(path: TrayPath) -> np.ndarray:
    """Sigma of the poses along which branches are followed, equally spaced within each piece."""
    pieces = [
        np.linspace(start, end, max(FEWEST_SAMPLES, int(np.ceil((end - start) / SPACING))) + 1)
        for start, end in zip(path.breaks[:-1], path.breaks[1:], strict=True)
    ]
    return np.unique(np.concatenate(pieces))


def follow_branches(robot: Robot, path: TrayPath, start: np.ndarray | None) -> list[Branch]:
    """Branches of the inverse kinematics along the path, best first; the one near `start` (n,) only, if that is given.

    The list is empty if no solution of the first pose was found.
    """
    position, rotation = (value[0] for value in path.pose(np.zeros(1)))
    if start is not None:
        solutions = [solve_pose(robot, position, rotation, start)]
    else:
        solutions = solve_from_everywhere(robot, position, rotation)
    sigma = samples(path)
    branches = [follow_branch(robot, path, sigma, solution.q) for solution in solutions if solution.converged]
    return sorted(branches, key=lambda branch: (branch.usable, len(branch.q), branch.score), reverse=True)


def follow_branch(robot: Robot, path: TrayPath, sigma: np.ndarray, start: np.ndarray) -> Branch:
    """The branch through `start` (n,) at the first sample, followed over `sigma` (S,)."""
    positions, rotations = path.pose(sigma)
    q = [np.asarray(start, dtype=float)]
    ended_at = None
    for i in range(1, len(sigma)):
        guess = q[-1] if i == 1 else 2 * q[-1] - q[-2]
        if robot.n > 6:
            guess = guess + RETURN * (q[0] - guess)
        solution = solve_pose(robot, positions[i], rotations[i], guess, iterations=8)
        if solution.converged and np.abs(solution.q - q[-1]).max() < LONGEST_JUMP:
            q.append(solution.q)
            continue
        reached, ended_at = _follow_in_small_steps(robot, path, q[-1], float(sigma[i - 1]), float(sigma[i]))
        if ended_at is not None:
            break
        q.append(reached)
    followed = _turned_into_limits(robot, np.array(q))
    clearance = _clearance(robot, followed)
    height = float(np.mean(robot.center_of_mass(followed) @ robot.up))
    return Branch(sigma, followed, ended_at, -clearance.worst, height + CLEARANCE_WEIGHT * clearance.share)


def _follow_in_small_steps(
    robot: Robot, path: TrayPath, q: np.ndarray, sigma: float, target: float
) -> tuple[np.ndarray, float | None]:
    """Follow the branch from `sigma` to `target`, halving steps as needed; where it ended, or None."""
    smallest = (target - sigma) / 2**HALVINGS
    step = (target - sigma) / 2
    while sigma < target:
        following = min(sigma + step, target)
        position, rotation = (value[0] for value in path.pose(np.array([following])))
        solution = solve_pose(robot, position, rotation, q, iterations=8)
        if solution.converged and np.abs(solution.q - q).max() < LONGEST_JUMP * step / (target - sigma + step):
            q, sigma = solution.q, following
        elif step > smallest:
            step /= 2
        else:
            return q, sigma
    return q, None


def _turned_into_limits(robot: Robot, q: np.ndarray) -> np.ndarray:
    """The same motion with every hinge turned by full turns to where its range fits its limits best."""
    limited = robot.hinges & np.isfinite(robot.limits.lower) & np.isfinite(robot.limits.upper)
    middle = np.where(limited, (robot.limits.lower + robot.limits.upper) / 2, 0.0)
    turns = np.round((middle - (q.min(axis=0) + q.max(axis=0)) / 2) / (2 * np.pi))
    return q + np.where(robot.hinges, 2 * np.pi * turns, 0.0)


@dataclass(frozen=True)
class _Clearance:
    """Smallest distance from a joint limit: `worst` [rad or m] and as a share of half the joint's range."""

    worst: float
    share: float


def _clearance(robot: Robot, q: np.ndarray) -> _Clearance:
    distance = np.minimum(q - robot.limits.lower, robot.limits.upper - q).min(axis=0)
    half_range = (robot.limits.upper - robot.limits.lower) / 2
    share = np.where(np.isfinite(half_range), distance / np.where(np.isfinite(half_range), half_range, 1.0), 1.0)
    return _Clearance(float(distance.min()), float(share.min()))
