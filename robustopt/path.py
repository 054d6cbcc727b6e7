"""Geometric path of the joints q(s), s in [0, 1]: through tray poses or joint waypoints.

The path is C2 on each piece; between two pieces the robot stops. s is proportional to the length of the tray path
(translation and turn, see `tray_path`) or, for joint waypoints, to the chord length of the joints.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.interpolate import BSpline, CubicSpline, PPoly, make_interp_spline

from robustopt.branches import Branch, follow_branches
from robustopt.config import Config, PathTolerance
from robustopt.errors import ConfigProblem, PathError
from robustopt.inverse_kinematics import rotation_vector, solve_from_everywhere, solve_pose
from robustopt.joint_waypoints import joint_waypoints
from robustopt.robot import Robot
from robustopt.tray_path import TrayPath, tray_path

MOST_SAMPLES = 8192
"""Most samples of one piece: a path that needs more passes a singularity."""
SPLINE_DEGREE = 5
"""Degree of the splines through the inverse kinematics: their second derivatives are smooth."""

Spline = BSpline | CubicSpline | PPoly


class Path:
    """Joint path q(s), s in [0, 1], of K pieces, C2 on each.

    `breaks` (K+1,): boundaries of the pieces, from 0 to 1; the robot stops at the inner ones, where the derivative of
    q may jump. `waypoints` (W,): s of the waypoints of the configuration.
    """

    def __init__(self, pieces: Sequence[Spline], breaks: np.ndarray, waypoints: np.ndarray, noun: str) -> None:
        self.breaks = np.array(breaks, dtype=float)
        self.waypoints = np.array(waypoints, dtype=float)
        self.breaks.setflags(write=False)
        self.waypoints.setflags(write=False)
        self._noun = noun
        self._derivatives = [[piece.derivative(order) if order else piece for order in range(4)] for piece in pieces]

    def evaluate(self, s: np.ndarray, piece: np.ndarray, order: int = 0) -> np.ndarray:
        """Derivative of `order` (0 to 3) of q at `s` (P,), each on the given `piece` (P,), shape (P, n)."""
        s, piece = np.asarray(s, dtype=float), np.asarray(piece)
        s = np.clip(s, self.breaks[piece], self.breaks[piece + 1])
        first = self._derivatives[int(piece[0])][order](s)
        for k in range(len(self._derivatives)):
            chosen = piece == k
            if k != piece[0] and chosen.any():
                first[chosen] = self._derivatives[k][order](s[chosen])
        return np.asarray(first)

    def __call__(self, s: np.ndarray, order: int = 0) -> np.ndarray:
        """Derivative of `order` (0 to 3) of q at `s` (P,), shape (P, n); at a stop that of the piece behind it."""
        s = np.asarray(s, dtype=float)
        return self.evaluate(s, self.piece_at(s), order)

    def piece_at(self, s: np.ndarray) -> np.ndarray:
        """Index of the piece at `s` (P,): the later one at a stop, the last one at s = 1."""
        return np.clip(np.searchsorted(self.breaks, s, side="right") - 1, 0, len(self.breaks) - 2)

    def label(self, s: float) -> str:
        """Where `s` is, in the configuration's words, e.g. "between tray_poses[1] and tray_poses[2], at 40 %"."""
        nearest = int(np.argmin(np.abs(self.waypoints - s)))
        if abs(self.waypoints[nearest] - s) < 1e-9:
            return f"at {self._noun}[{nearest}]"
        after = int(np.clip(np.searchsorted(self.waypoints, s), 1, len(self.waypoints) - 1))
        start, end = self.waypoints[after - 1 : after + 1]
        share = round(100 * float(np.clip((s - start) / (end - start), 0, 1)))
        return f"between {self._noun}[{after - 1}] and {self._noun}[{after}], at {share} %"


def build_path(config: Config, robot: Robot) -> Path:
    """The joint path of the configuration.

    Raises PathError if a pose is out of reach, a joint limit is left, a branch ends or jumps, or bodies collide.
    """
    if config.path.joints is not None:
        return _joint_path(config, robot)
    return _tray_path(config, robot)


def _joint_path(config: Config, robot: Robot) -> Path:
    waypoints = joint_waypoints(config, robot.joint_names)
    chord = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(waypoints, axis=0), axis=1))))
    s = chord / chord[-1]
    return Path([CubicSpline(s, waypoints)], np.array([0.0, 1.0]), s, "joints")


def _tray_path(config: Config, robot: Robot) -> Path:
    tray = tray_path(config.path)
    start = None if config.path.start is None else np.array(config.path.start)
    branches = follow_branches(robot, tray, start)
    if not branches or not branches[0].usable:
        raise PathError("unreachable", key="path.tray_poses")
    return _fit(robot, tray, branches[0], config.path.tolerance)


def _fit(robot: Robot, tray: TrayPath, branch: Branch, tolerance: PathTolerance) -> Path:
    pieces = []
    for start, end in zip(tray.breaks[:-1], tray.breaks[1:], strict=True):
        inside = (branch.sigma >= start) & (branch.sigma <= end)
        pieces.append(_fit_piece(robot, tray, branch.sigma[inside], branch.q[inside], tolerance))
    return Path(pieces, tray.breaks / tray.length, tray.start / tray.length, "tray_poses")


def _fit_piece(
    robot: Robot, tray: TrayPath, sigma: np.ndarray, q: np.ndarray, tolerance: PathTolerance
) -> BSpline:
    """Spline through solutions of the inverse kinematics, as many as it takes to stay within the tolerance."""
    while True:
        spline = make_interp_spline(sigma / tray.length, q, k=SPLINE_DEGREE)
        middle = (sigma[1:] + sigma[:-1]) / 2
        guess = spline(middle / tray.length)
        position, rotation = robot.tray_pose(guess)
        wanted_position, wanted_rotation = tray.pose(middle)
        distance = np.linalg.norm(position - wanted_position, axis=1).max()
        angle = max(np.linalg.norm(rotation_vector(R @ S.T)) for R, S in zip(rotation, wanted_rotation, strict=True))
        if distance < tolerance.position and angle < tolerance.angle:
            return spline
        if len(sigma) > MOST_SAMPLES:
            raise PathError("singular", key="path.tray_poses")
        solutions = [solve_pose(robot, p, R, g) for p, R, g in zip(wanted_position, wanted_rotation, guess, strict=True)]
        q = _interleave(q, np.array([solution.q for solution in solutions]))
        sigma = _interleave(sigma, middle)


def _interleave(outer: np.ndarray, inner: np.ndarray) -> np.ndarray:
    both = np.empty((len(outer) + len(inner), *outer.shape[1:]))
    both[0::2], both[1::2] = outer, inner
    return both
