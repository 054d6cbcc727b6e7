"""Geometric path of the joints q(s), s in [0, 1]: through tray poses or joint waypoints.

The path is C2 on each piece; between two pieces the robot stops. s is proportional to the length of the tray path
(translation and turn, see `tray_path`) or, for joint waypoints, to the chord length of the joints.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from scipy.interpolate import BSpline, CubicSpline

from robustopt.config import Config, PathTolerance
from robustopt.errors import PathError
from robustopt.path.branches import LIMIT_TOLERANCE, Branch, BranchLostError, fit_branch, follow_branches
from robustopt.path.collision import CollisionCheck
from robustopt.path.joint_waypoints import joint_waypoints
from robustopt.path.reach import WAYS_OUT, branch_problems, limit_sentence, start_position
from robustopt.path.tray_path import TrayPath, label, tray_path
from robustopt.robot import Robot

CHECK_STEP = 0.02
"""Largest joint step between the positions that are checked for collisions [rad or m]: 2 cm at 1 m."""
POINTS_PER_KNOT = 8
FEWEST_POINTS = 200
"""Density of the points at which the joint limits are checked: an extremum is missed by 1/16 of a knot interval."""

Spline = BSpline | CubicSpline


class Path:
    """Joint path q(s), s in [0, 1], of K pieces, C2 on each.

    `breaks` (K+1,): boundaries of the pieces, from 0 to 1; the robot stops at the inner ones, where the derivative of
    q may jump. `waypoints` (W,): s of the waypoints of the configuration. `switches`: s at which the limits change
    while the robot moves on, which a grid must hold.
    """

    switches = np.zeros(0)

    def __init__(self, pieces: Sequence[Spline], breaks: np.ndarray, waypoints: np.ndarray, noun: str) -> None:
        self.breaks = np.array(breaks, dtype=float)
        self.waypoints = np.array(waypoints, dtype=float)
        self.breaks.setflags(write=False)
        self.waypoints.setflags(write=False)
        self._noun = noun
        self._knots = np.unique(
            np.concatenate([piece.x if isinstance(piece, CubicSpline) else piece.t for piece in pieces])
        )
        self._derivatives = [[piece.derivative(order) if order else piece for order in range(4)] for piece in pieces]

    def evaluate(self, s: np.ndarray, piece: np.ndarray, order: int = 0) -> np.ndarray:
        """Derivative of `order` (0 to 3) of q at `s` (P,), each on the given `piece` (P,), shape (P, n)."""
        s, piece = np.asarray(s, dtype=float), np.asarray(piece)
        s = np.clip(s, self.breaks[piece], self.breaks[piece + 1])
        if len(self._derivatives) == 1:
            return np.asarray(self._derivatives[0][order](s))
        values = np.empty((len(s), self._derivatives[0][0](0.0).shape[-1]))
        for k, derivatives in enumerate(self._derivatives):
            chosen = piece == k
            values[chosen] = derivatives[order](s[chosen])
        return values

    def __call__(self, s: np.ndarray, order: int = 0) -> np.ndarray:
        """Derivative of `order` (0 to 3) of q at `s` (P,), shape (P, n); at a stop that of the piece behind it."""
        s = np.atleast_1d(np.asarray(s, dtype=float))
        return self.evaluate(s, self.piece_at(s), order)

    def piece_at(self, s: np.ndarray) -> np.ndarray:
        """Index of the piece at `s` (P,): the later one at a stop, the last one at s = 1."""
        return np.clip(np.searchsorted(self.breaks, s, side="right") - 1, 0, len(self.breaks) - 2)

    def fine_grid(self) -> np.ndarray:
        """Points of s in [0, 1] so dense that the path bends little between them, knots and waypoints included."""
        knots = np.union1d(np.clip(self._knots, 0.0, 1.0), self.waypoints)
        parts = max(POINTS_PER_KNOT, -(-FEWEST_POINTS // (len(knots) - 1)))
        inner = knots[:-1, None] + np.diff(knots)[:, None] * np.arange(parts) / parts
        return np.append(inner.ravel(), 1.0)

    def label(self, s: float) -> str:
        """Where `s` is, in the configuration's words, e.g. "between tray_poses[1] and tray_poses[2], at 40 %"."""
        return label(self.waypoints, s, self._noun)


def build_path(config: Config, robot: Robot) -> Path:
    """The joint path of the configuration.

    Raises PathError if a pose is out of reach, a joint limit is left, a branch ends or jumps, or bodies collide.
    """
    if config.path.joints is not None:
        return _first_sound([_joint_path(config, robot)], config, robot, "path.joints")
    tray = tray_path(config.path)
    start = start_position(config, robot)
    branches = follow_branches(robot, tray, start)
    usable = [branch for branch in branches if branch.usable]
    if not usable:
        raise PathError(branch_problems(robot, tray, branches, start))
    paths = (_tray_joint_path(robot, tray, branch, config.path.tolerance) for branch in usable)
    return _first_sound(paths, config, robot, "path.tray_poses")


def _joint_path(config: Config, robot: Robot) -> Path:
    waypoints = joint_waypoints(config, robot.joint_names)
    chord = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(waypoints, axis=0), axis=1))))
    s = chord / chord[-1]
    return Path([CubicSpline(s, waypoints)], np.array([0.0, 1.0]), s, "joints")


def _tray_joint_path(robot: Robot, tray: TrayPath, branch: Branch, tolerance: PathTolerance) -> Path | str:
    waypoints = tray.start / tray.length
    try:
        pieces = fit_branch(robot, tray, branch, tolerance)
    except BranchLostError as error:
        return f"{tray.label(error.sigma)}: {error.reason}; {WAYS_OUT}"
    return Path(pieces, tray.breaks / tray.length, waypoints, "tray_poses")


def _first_sound(paths: Iterable[Path | str], config: Config, robot: Robot, key: str) -> Path:
    """The first path that stays within the joint limits and does not collide.

    A path that could not be made is a sentence that says why. If none is sound, the error is about the first.
    """
    check = CollisionCheck(config, robot) if config.robot.collision.check else None
    objections = []
    for path in paths:
        objection = path if isinstance(path, str) else _objection(path, robot, check)
        if isinstance(path, Path) and objection is None:
            return path
        objections.append(objection)
    others = f" (the {len(objections) - 1} other ways to move the arm fail too)" if len(objections) > 1 else ""
    raise PathError(f"{objections[0]}{others}", key=key)


def _objection(path: Path, robot: Robot, check: CollisionCheck | None) -> str | None:
    """What is wrong with the path, in a sentence: the joint limit it leaves furthest, or the first collision."""
    s = path.fine_grid()
    q = path(s)
    beyond = np.maximum(robot.limits.lower - q, q - robot.limits.upper).max(axis=1)
    worst = int(np.argmax(beyond))
    if beyond[worst] > LIMIT_TOLERANCE:
        return f"{path.label(s[worst])}: {limit_sentence(robot, q[worst])}"
    if check is None:
        return None
    s = _thinned(s, q)
    collision = check.first(path(s))
    if collision is None:
        return None
    first, second = collision.bodies
    return (
        f"{path.label(s[collision.index])}: {first} and {second} collide, {1000 * collision.depth:.1f} mm deep; "
        f"change the path or the mounting, or, if they may touch, add [{first}, {second}] to robot.collision.exclude"
    )


def _thinned(s: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Points of the path so that no joint moves by more than `CHECK_STEP` from one to the next."""
    moved = np.concatenate(([0.0], np.cumsum(np.abs(np.diff(q, axis=0)).max(axis=1))))
    wanted = np.linspace(0.0, moved[-1], int(np.ceil(moved[-1] / CHECK_STEP)) + 1)
    return np.asarray(np.interp(wanted, moved, s))
