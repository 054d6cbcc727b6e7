"""Limits of the speed and the acceleration of points of the robot in the world.

A point p(s) moves with the velocity p' sd and accelerates by p' u + p'' x, with u = sdd and x = sd^2. Its speed limit v
is exactly the bound x <= v^2 / |p'|^2. Between grid points x is linear in s and |p'| is not constant, so the bounds at
both ends of an interval are lowered together until the limit holds on all of it; this changes them by the square of the
spacing.

The norm |p' u + p'' x| <= a is an ellipse in (u, x), since the acceleration lies in the plane of p' and p''. Its rows
are the chords of an inscribed polygon with vertices along and across the path. So they are never beyond the limit, and
exact for purely tangential and for purely centripetal acceleration (our choice). An acceleration error e of the joints
adds J e. The chords count with its largest component across each of them; of its component out of the plane, the
largest value w takes its part of the limit, sqrt(a^2 - w^2).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from robustopt.arrays import Array, Flags, Indices
from robustopt.limits.grid import Grid
from robustopt.limits.names import LimitKind, LimitName
from robustopt.limits.polygons import Polygons, cut_affine
from robustopt.path import Path
from robustopt.robot import LimitedPoint, PointMotion, Robot

CHORDS = 128
"""Vertices of the polygon that stands for a circle: in between, it loses 1 - cos(pi / 128) = 0.03 % of the limit."""

PARTS = 8
"""Parts of an interval between which the speed limit holds too."""

SURPLUS = 1.05
"""Factor on the part of x beyond the limit: the largest one lies between the parts, 1/64 higher for a parabola."""


@dataclass(frozen=True, eq=False)
class PointAcceleration:
    """The limit of the acceleration of a point; see the head of the module.

    Attributes:
        point: the point.
        rows: rows a u + b x + c <= 0 as fractions of the limit (P, CHORDS, 3).
    """

    point: LimitedPoint
    rows: Array

    @property
    def names(self) -> tuple[LimitName, ...]:
        """Return the name of the limit."""
        return (LimitName(LimitKind.CARTESIAN_ACCELERATION, self.point.name),)

    def cut(self, polygons: Polygons, index: Indices, used: Flags) -> Polygons:
        """Return the feasible polygons, cut with the chords; see `Limit`.

        Args:
            polygons: feasible (u, x) so far.
            index: number of the name in the problem (1,).
            used: whether the limit counts (1,).
        """
        return cut_affine(polygons, self.rows, np.repeat(index, CHORDS)) if used[0] else polygons

    def excess(self, u: Array, x: Array, points: Indices) -> Array:
        """Return the largest value of the rows, (M, 1): at most 0.03 % above the excess over the limit; see `Limit`.

        Args:
            u: sdd (M,).
            x: sd^2 (M,).
            points: grid point of each (M,).
        """
        a, b, c = np.moveaxis(self.rows[points], 2, 0)
        return np.asarray((a * u[:, None] + b * x[:, None] + c).max(axis=1, keepdims=True))


def point_acceleration(motion: PointMotion, middle: Array, radius: Array) -> PointAcceleration:
    """Return the limit of the acceleration of a point.

    Args:
        motion: motion of the point.
        middle: middle of the acceleration error (n,) [rad/s^2 or m/s^2].
        radius: half of its width (n,).
    """
    limit, part = motion.point.acceleration, float(np.cos(np.pi / CHORDS))
    plane, within = np.linalg.qr(np.stack([motion.first, motion.second], axis=2))  # axes in the plane of p' and p''
    normal = np.cross(plane[:, :, 0], plane[:, :, 1])
    angle = (np.arange(CHORDS) + 0.5) * 2.0 * np.pi / CHORDS
    directions = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    erring = np.flatnonzero((middle != 0.0) | (radius != 0.0))
    jacobian, middle, radius = motion.jacobian[:, :, erring], middle[erring], radius[erring]
    across = directions @ (np.swapaxes(plane, 1, 2) @ jacobian)
    out = np.einsum("pi,pin->pn", normal, jacobian)
    lost = np.abs(out @ middle) + np.abs(out) @ radius
    left = np.sqrt(np.maximum(limit**2 - lost**2, 0.0)) - np.maximum(lost - limit, 0.0)
    rows = np.empty((len(normal), CHORDS, 3))
    rows[:, :, :2] = directions @ within
    rows[:, :, 2] = across @ middle + np.abs(across) @ radius - part * left[:, None]
    return PointAcceleration(motion.point, rows / (part * limit))


def speed_names(robot: Robot) -> tuple[LimitName, ...]:
    """Return the names of the speed limits of points.

    Args:
        robot: the robot.
    """
    return tuple(LimitName(LimitKind.CARTESIAN_SPEED, point.name) for point in limited_speeds(robot))


def limited_speeds(robot: Robot) -> tuple[LimitedPoint, ...]:
    """Return the points whose speed is limited.

    Args:
        robot: the robot.
    """
    return tuple(point for point in robot.points if np.isfinite(point.speed))


def bound_speeds(robot: Robot, path: Path, grid: Grid, x_max: Array) -> tuple[Array, Indices]:
    """Return the largest x that the speeds of the points allow too, at grid points and in between.

    Args:
        robot: the robot.
        path: the path.
        grid: the grid.
        x_max: largest x that the joint velocities allow (P,).

    Returns:
        The largest x (P,), and the index of the point that bounds it, -1 if a joint does (P,).
    """
    slowest = np.full(len(x_max), -1, dtype=np.intp)
    share, ds = np.arange(1, PARTS) / PARTS, np.diff(grid.s)
    inner = (grid.s[:-1, None] + ds[:, None] * share).ravel()
    for k, point in enumerate(limited_speeds(robot)):
        used = _used(robot, path, point, grid.s, grid.piece)
        between = _used(robot, path, point, inner, np.repeat(grid.piece[:-1], PARTS - 1)).reshape(-1, PARTS - 1)
        bound = np.minimum(x_max, np.divide(1.0, used, out=np.full_like(used, np.inf), where=used > 0.0))
        line = bound[:-1, None] + np.diff(bound)[:, None] * share
        beyond = SURPLUS * np.maximum((between * line).max(axis=1) - 1.0, 0.0) * (ds > 0.0)
        bound /= 1.0 + np.maximum(np.r_[beyond, 0.0], np.r_[0.0, beyond])
        slowest[bound < x_max] = k
        x_max = bound
    return x_max, slowest


def _used(robot: Robot, path: Path, point: LimitedPoint, s: Array, piece: Indices) -> Array:
    """Return |p'|^2 / v^2, by which x is multiplied in the square of the used part of the speed limit, (T,)."""
    motion = robot.point_motion(point, *(path.evaluate(s, piece, order) for order in range(3)))
    return np.asarray(np.sum(motion.first**2, axis=1) / point.speed**2)
