"""The path of the carrier frame in the world: straight segments between poses, with rounded corners or stops.

A segment moves on a straight line at a constant rate while the orientation turns about one axis (slerp). The length
sigma along it counts translation and rotation alike, sqrt(|dp|^2 + (TURN_LENGTH * angle)^2), so that a turn on the
spot has a length too (our choice).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from robustopt.arrays import Array, Flags, Indices
from robustopt.config import FramePose, PathConfig
from robustopt.errors import ConfigProblem, PathError

TURN_LENGTH = 0.3
"""Length that a turn by one radian counts for [m]: about the distance of an object's top from the tray's centre."""
SAME_POSE = 1e-6
"""Poses nearer than this are repeated [m of sigma]: no sensible path has segments of a micrometre."""
STRAIGHT = 1e-6
"""Directions that differ by less than this continue straight through a waypoint."""
REVERSAL = np.cos(np.deg2rad(170))
"""Directions further apart than 170 degrees are a reversal: rounded, the path would nearly stand still inside."""
HALF_TURN = np.pi - 1e-6
"""A turn of pi has no shortest way [rad]."""


@dataclass(frozen=True)
class PosePath:
    """A path of the carrier frame along sigma in [0, length].

    Attributes:
        start: sigma of each waypoint (W,) [m].
        position: position of each waypoint in the world (W, 3) [m].
        rotation: rotation of each waypoint into the world (W, 3, 3).
        velocity: dp/dsigma of each segment (W-1, 3).
        turn: turning rate of each segment in the body frame (W-1, 3) [rad/m].
        blend: length rounded on each side of a waypoint (W,) [m]; 0 at the ends, at stops and on a straight line.
        stops: True for a waypoint at which the frame stops, both ends included (W,).
        noun: name of the waypoints in the configuration, `tray_poses` or `tool_poses`.
    """

    start: Array
    position: Array
    rotation: Array
    velocity: Array
    turn: Array
    blend: Array
    stops: Flags
    noun: str

    @property
    def length(self) -> float:
        """Return the length of the path [m]."""
        return float(self.start[-1])

    @property
    def breaks(self) -> Array:
        """Return sigma of the stops, both ends included, shape (K+1,) [m]."""
        return np.asarray(self.start[self.stops])

    def pose(self, sigma: Array) -> tuple[Array, Array]:
        """Return the carrier frame in the world.

        At the corner between directions d1 and d2 with body rates w1 and w2, sigma counted from the corner: p =
        p_corner + alpha d1 + beta d2 and R = R_corner exp(alpha w1) exp(beta w2), with alpha = min(sigma, 0) and beta =
        max(sigma, 0) outside of the blend. Inside it both bend smoothly (C2).

        Args:
            sigma: positions along the path (P,) [m].

        Returns:
            Position (P, 3) [m] and rotation (P, 3, 3).
        """
        corner = self._nearest_corner(sigma)
        before, after = np.maximum(corner - 1, 0), np.minimum(corner, len(self.velocity) - 1)
        alpha, beta = _corner_lengths(sigma - self.start[corner], self.blend[corner])
        position = self.position[corner] + alpha[:, None] * self.velocity[before] + beta[:, None] * self.velocity[after]
        turned = Rotation.from_rotvec(alpha[:, None] * self.turn[before]) * Rotation.from_rotvec(
            beta[:, None] * self.turn[after]
        )
        return position, self.rotation[corner] @ turned.as_matrix()

    def label(self, sigma: float) -> str:
        """Describe a position along the path by its waypoints, see `label`.

        Args:
            sigma: the position along the path [m].
        """
        return label(self.start, sigma, self.noun)

    def _nearest_corner(self, sigma: Array) -> Indices:
        middle = (self.start[1:] + self.start[:-1]) / 2
        return np.searchsorted(middle, sigma)


def label(waypoints: Array, s: float, noun: str) -> str:
    """Describe a position among waypoints, such as "between joints[1] and joints[2], at 40 %".

    Args:
        waypoints: positions of the waypoints, in the unit of s (W,).
        s: the position.
        noun: key under which the configuration lists the waypoints.
    """
    nearest = int(np.argmin(np.abs(waypoints - s)))
    if abs(waypoints[nearest] - s) < 1e-9:
        return f"at {noun}[{nearest}]"
    after = int(np.clip(np.searchsorted(waypoints, s), 1, len(waypoints) - 1))
    start, end = waypoints[after - 1 : after + 1]
    share = round(100 * float(np.clip((s - start) / (end - start), 0, 1)))
    return f"between {noun}[{after - 1}] and {noun}[{after}], at {share} %"


def pose_path(path: PathConfig) -> PosePath:
    """Return the path through `path.tray_poses` or `path.tool_poses`.

    Args:
        path: the section `path`.

    Raises:
        PathError: there are fewer than two poses, a pose is repeated, or a segment turns by half a turn.
    """
    poses, noun = path.poses or (), path.poses_key
    if len(poses) < 2:
        raise PathError(f"a path needs at least two poses; there is {len(poses) or 'none'}", key=f"path.{noun}")
    position = np.array([pose.position for pose in poses])
    rotation = np.array([orientation(pose) for pose in poses])
    angle = Rotation.from_matrix(rotation[:-1].transpose(0, 2, 1) @ rotation[1:]).as_rotvec()
    length = np.hypot(np.linalg.norm(np.diff(position, axis=0), axis=1), TURN_LENGTH * np.linalg.norm(angle, axis=1))
    _check_segments(length, angle, noun)
    velocity, turn = np.diff(position, axis=0) / length[:, None], angle / length[:, None]
    paused = np.isin(np.arange(1, len(poses) - 1), list(path.pause_times))
    blend, stops = _corners(velocity, turn, length, path.blend, paused)
    start = np.concatenate(([0.0], np.cumsum(length)))
    return PosePath(start, position, rotation, velocity, turn, blend, stops, noun)


def orientation(pose: FramePose) -> Array:
    """Return the rotation of a pose, (3, 3); the identity if the configuration gives none.

    Args:
        pose: the pose.
    """
    if pose.quaternion is not None:
        return np.asarray(Rotation.from_quat(pose.quaternion, scalar_first=True).as_matrix())
    return np.asarray(Rotation.from_euler("xyz", pose.rpy or (0.0, 0.0, pose.yaw or 0.0)).as_matrix())


def _check_segments(length: Array, angle: Array, noun: str) -> None:
    problems = [
        ConfigProblem(f"path.{noun}[{i + 1}]", f"repeats {noun}[{i}]; leave one of them out")
        for i in np.flatnonzero(length < SAME_POSE)
    ]
    problems += [
        ConfigProblem(
            f"path.{noun}[{i + 1}]",
            f"is half a turn from {noun}[{i}], which leaves open which way round; put a pose between them",
        )
        for i in np.flatnonzero(np.linalg.norm(angle, axis=1) > HALF_TURN)
    ]
    if problems:
        raise PathError(problems)


def _corners(velocity: Array, turn: Array, length: Array, blend: float, paused: Flags) -> tuple[Array, Flags]:
    """Return the blend length of every waypoint, and whether the frame stops there, as it does at the `paused` ones."""
    direction = np.hstack((velocity, TURN_LENGTH * turn))
    cosine = np.sum(direction[:-1] * direction[1:], axis=1)
    straight = ~paused & (np.linalg.norm(np.diff(direction, axis=0), axis=1) < STRAIGHT)
    rounded = ~straight & ~paused & (cosine > REVERSAL) & (blend > 0)
    inner = np.where(rounded, np.minimum(blend, np.minimum(length[:-1], length[1:]) / 2), 0.0)
    return np.concatenate(([0.0], inner, [0.0])), np.concatenate(([True], ~straight & ~rounded, [True]))


def _corner_lengths(sigma: Array, blend: Array) -> tuple[Array, Array]:
    """Return the lengths along the old and the new direction, (alpha, beta), at `sigma` from a corner.

    beta is the integral of the smoothstep 3 t^2 - 2 t^3, t = (sigma + r) / (2 r): from 0 at -r to r at r, with second
    derivatives 0 at both; alpha = sigma - beta.
    """
    r = np.where(blend > 0, blend, 1.0)
    t = np.clip((sigma + r) / (2 * r), 0.0, 1.0)
    smooth = 2 * r * (t**3 - t**4 / 2)
    beta = np.where(np.abs(sigma) < blend, smooth, np.maximum(sigma, 0.0))
    return sigma - beta, beta
