"""Joint paths along a path of the carrier: branches of the inverse kinematics, followed, ranked and fitted by splines.

A branch starts at one solution of the first pose and follows it by continuation. Among the branches that stay within
the joint limits, the best one holds the arm high ("elbow up") and far from its limits (our choice).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BSpline, make_interp_spline
from scipy.spatial.transform import Rotation

from robustopt.arrays import Array
from robustopt.config import PathTolerance
from robustopt.path.inverse_kinematics import solve_from, solve_from_everywhere, solve_pose
from robustopt.path.pose_path import PosePath
from robustopt.robot import Robot

SPACING = 0.04
"""Distance between the poses along which branches are followed [m of sigma]."""
FEWEST_SAMPLES = 12
"""Fewest intervals of a piece, however short."""
LONGEST_STEP = 0.35
"""Longest joint step between poses that counts as following a branch [rad or m]; longer ones are halved."""
FASTEST = 70.0
"""Largest derivative of a joint with respect to sigma on a branch [rad/m]. Larger ones occur at a singularity or in
a jump to another branch: a joint at 7 rad/s would move the carrier at only 0.1 m/s.
"""
MOST_SAMPLES = 4096
"""Most samples of one piece: a path that needs more passes next to a singularity."""
SPLINE_DEGREE = 5
"""Degree of the splines through the samples, so that their second derivatives are smooth."""
NEAR = 0.05
"""Largest distance of a solution from the spline that predicts it [rad or m]; closer ones are on the same branch."""
SHORTEST_STEP = 0.0005
"""Steps are halved down to this length before the branch counts as ended [m of sigma]."""
LIMIT_TOLERANCE = 1e-6
"""Largest distance of a joint beyond its limit that is allowed [rad or m], so that a pose may lie on the limit."""
MOST_BRANCHES = 16
"""Most branches that are followed: all of an arm of six joints."""
CLEARANCE_WEIGHT = 0.2
"""Height of the arm's centre of mass that counts as much as a joint in mid-range instead of at its limit [m]."""
FOLLOWING_ITERATIONS = 8
"""Iterations from one pose to the next: from so close, convergence is either quadratic or fails."""
RETURN = 0.02
"""Share by which a redundant arm returns to its first posture at every sample, so that it does not drift."""


class BranchLostError(Exception):
    """No joint path follows the carrier's path at `sigma` [m], for a `reason` in words."""

    def __init__(self, sigma: float, reason: str) -> None:
        super().__init__(reason)
        self.sigma = sigma
        self.reason = reason


@dataclass(frozen=True)
class Branch:
    """A joint path, as far as it could be followed.

    Attributes:
        sigma: samples of the carrier's path (S,) [m].
        q: joint positions at the followed samples (S, n) or fewer [rad or m].
        ended_at: sigma at which the branch could not be followed further [m]; None if it is complete.
        violation: largest distance beyond a joint limit [rad or m]; negative inside.
        score: rank among the branches; larger is better.
    """

    sigma: Array
    q: Array
    ended_at: float | None
    violation: float
    score: float

    @property
    def usable(self) -> bool:
        """Return whether the branch is complete and within the joint limits."""
        return self.ended_at is None and self.violation <= LIMIT_TOLERANCE


def samples(path: PosePath) -> Array:
    """Return sigma of the poses at which branches are followed, equally spaced within each piece, (S,) [m].

    Args:
        path: path of the carrier.
    """
    pieces = [
        np.linspace(start, end, int(np.clip(np.ceil((end - start) / SPACING), FEWEST_SAMPLES, MOST_SAMPLES)) + 1)
        for start, end in zip(path.breaks[:-1], path.breaks[1:], strict=True)
    ]
    return np.unique(np.concatenate(pieces))


def follow_branches(robot: Robot, path: PosePath, start: Array | None) -> list[Branch]:
    """Follow the branches of the inverse kinematics along a path.

    Branches that violate a joint limit at the first pose are followed only if all of them do. A redundant arm has
    infinitely many branches; the `MOST_BRANCHES` that are furthest inside the limits are followed.

    Args:
        robot: the arm.
        path: path of its carrier.
        start: joint position near which the only branch starts (n,); None for all branches.

    Returns:
        The branches, best first; none if the first pose was not solved.
    """
    position, rotation = (value[0] for value in path.pose(np.zeros(1)))
    if start is not None:
        solutions = [solve_pose(robot, position, rotation, start)]
    else:
        solutions = solve_from_everywhere(robot, position, rotation)
    starts = [_turned_into_limits(robot, solution.q[None])[0] for solution in solutions if solution.converged]
    starts.sort(key=lambda q: _limit_distances(robot, q[None])[0])
    inside = [q for q in starts if _limit_distances(robot, q[None])[0] <= LIMIT_TOLERANCE]
    sigma = samples(path)
    branches = _followed(robot, path, sigma, (inside or starts)[:MOST_BRANCHES])
    return sorted(branches, key=lambda branch: (branch.usable, len(branch.q), branch.score), reverse=True)


def _followed(robot: Robot, path: PosePath, sigma: Array, starts: list[Array]) -> list[Branch]:
    """Follow the branches through the starts (n,) at the first sample over `sigma` (S,), all in step."""
    positions, rotations = path.pose(sigma)
    ways = [[start] for start in starts]
    ends: list[float | None] = [None] * len(ways)
    for i in range(1, len(sigma)):
        left = [k for k, end in enumerate(ends) if end is None]
        if not left:
            break
        guesses = np.array([_guess(robot, ways[k]) for k in left])
        solutions = solve_from(robot, positions[i], rotations[i], guesses, FOLLOWING_ITERATIONS)
        for k, solution in zip(left, solutions, strict=True):
            q = ways[k]
            if solution.converged and np.abs(solution.q - q[-1]).max() < LONGEST_STEP:
                q.append(solution.q)
                continue
            reached, ends[k] = _follow_in_small_steps(robot, path, q[-1], float(sigma[i - 1]), float(sigma[i]))
            if ends[k] is None:
                q.append(reached)
    return [_branch(robot, sigma, np.array(q), end) for q, end in zip(ways, ends, strict=True)]


def _guess(robot: Robot, q: list[Array]) -> Array:
    """Return the joint position that is expected after those of a branch so far."""
    guess = q[-1] if len(q) == 1 else 2 * q[-1] - q[-2]
    return guess + RETURN * (q[0] - guess) if robot.n > 6 else guess


def _branch(robot: Robot, sigma: Array, q: Array, ended_at: float | None) -> Branch:
    followed = _turned_into_limits(robot, q)
    violation, clearance = _limit_distances(robot, followed)
    height = float(np.mean(robot.center_of_mass(followed) @ robot.up))
    return Branch(sigma, followed, ended_at, violation, height + CLEARANCE_WEIGHT * clearance)


def fit_branch(robot: Robot, path: PosePath, branch: Branch, tolerance: PathTolerance) -> list[BSpline]:
    """Fit splines q(s), s = sigma / length, one for each piece, to a branch.

    Args:
        robot: the arm.
        path: path of the carrier.
        branch: the branch, complete.
        tolerance: largest distance and angle between the carrier and its path.

    Raises:
        BranchLostError: a piece needs more than `MOST_SAMPLES`, or the inverse kinematics leaves the branch.
    """
    pieces = []
    for start, end in zip(path.breaks[:-1], path.breaks[1:], strict=True):
        inside = (branch.sigma >= start) & (branch.sigma <= end)
        sigma, q = branch.sigma[inside], branch.q[inside]
        while True:
            spline = make_interp_spline(sigma / path.length, q, k=SPLINE_DEGREE)
            between = (sigma[1:] + sigma[:-1]) / 2
            guess = spline(between / path.length)
            distance, angle = _deviation(robot, path, between, guess)
            if max(distance.max() / tolerance.position, angle.max() / tolerance.angle) < 1:
                break
            if len(sigma) > MOST_SAMPLES:
                worst = float(between[np.argmax(distance / tolerance.position + angle / tolerance.angle)])
                raise BranchLostError(worst, f"{MOST_SAMPLES} samples do not reach path.tolerance, near a singularity")
            q = _interleave(q, _between(robot, path, sigma, q, guess))
            sigma = _interleave(sigma, between)
        pieces.append(spline)
    return pieces


def _deviation(robot: Robot, path: PosePath, sigma: Array, q: Array) -> tuple[Array, Array]:
    """Return distance [m] and angle [rad] (P,) of the carrier at `q` (P, n) from its path."""
    position, rotation = robot.carrier_pose(q)
    wanted_position, wanted_rotation = path.pose(sigma)
    difference = Rotation.from_matrix(wanted_rotation.transpose(0, 2, 1) @ rotation)
    return np.linalg.norm(position - wanted_position, axis=1), np.asarray(difference.magnitude())


def _between(robot: Robot, path: PosePath, sigma: Array, q: Array, guess: Array) -> Array:
    """Solve halfway between the samples `sigma` (S,), near the `guess` (S-1, n) or else starting from `q` (S, n)."""
    middle = (sigma[1:] + sigma[:-1]) / 2
    solutions = np.empty_like(guess)
    for i, (position, rotation) in enumerate(zip(*path.pose(middle), strict=True)):
        solution = solve_pose(robot, position, rotation, guess[i], iterations=FOLLOWING_ITERATIONS)
        solutions[i] = solution.q
        if not solution.converged or np.abs(solution.q - guess[i]).max() > NEAR:
            solutions[i], lost_at = _follow_in_small_steps(robot, path, q[i], float(sigma[i]), float(middle[i]))
            if lost_at is not None:
                raise BranchLostError(lost_at, "the arm would have to jump, near a singularity")
    return solutions


def _interleave(outer: Array, inner: Array) -> Array:
    both = np.empty((len(outer) + len(inner), *outer.shape[1:]))
    both[0::2], both[1::2] = outer, inner
    return both


def _follow_in_small_steps(
    robot: Robot, path: PosePath, q: Array, sigma: float, target: float
) -> tuple[Array, float | None]:
    """Follow the branch from `sigma` to `target`, halving steps as needed; return also its end, None if complete."""
    step = (target - sigma) / 2
    while target - sigma > 1e-12:
        step = min(step, target - sigma)
        position, rotation = (value[0] for value in path.pose(np.array([sigma + step])))
        solution = solve_pose(robot, position, rotation, q, iterations=FOLLOWING_ITERATIONS)
        if solution.converged and np.abs(solution.q - q).max() < min(LONGEST_STEP, FASTEST * step):
            q, sigma = solution.q, sigma + step
        elif step > SHORTEST_STEP:
            step /= 2
        else:
            return q, sigma
    return q, None


def _turned_into_limits(robot: Robot, q: Array) -> Array:
    """Return the same motion with every hinge shifted by full turns, so that its range fits its limits best."""
    limited = robot.hinges & np.isfinite(robot.limits.lower) & np.isfinite(robot.limits.upper)
    middle = (np.where(limited, robot.limits.lower, 0.0) + np.where(limited, robot.limits.upper, 0.0)) / 2
    turns = np.round((middle - (q.min(axis=0) + q.max(axis=0)) / 2) / (2 * np.pi))
    return q + np.where(robot.hinges, 2 * np.pi * turns, 0.0)


def _limit_distances(robot: Robot, q: Array) -> tuple[float, float]:
    """Return the largest violation of a joint limit by `q` (S, n), and the least clearance in half joint ranges."""
    distance = np.minimum(q - robot.limits.lower, robot.limits.upper - q).min(axis=0)
    half_range = (robot.limits.upper - robot.limits.lower) / 2
    limited = np.isfinite(half_range)
    share = np.where(limited, distance / np.where(limited, half_range, 1.0), 1.0)
    return float(-distance.min()), float(share.min())
