"""Track: the grid along a path, and what robot and path alone decide of a problem.

Whatever is believed of the load (friction, contact points, masses, centres of mass, joint acceleration errors), the
track is the same, so problems that differ in their beliefs share it, and what of it they have in common is kept.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from threading import Lock
from typing import Any, TypeVar

import numpy as np

from robustopt.config import Config
from robustopt.limits.polygons import Loads, Polygons, cut_affine, start
from robustopt.limits.rows import (
    BodyWrenches,
    PathMotion,
    TorqueFamily,
    acceleration_rows,
    body_loads,
    body_wrenches,
    own_inertia_terms,
    path_motion,
    torque_family,
)
from robustopt.limits.uncertainty import Body
from robustopt.limits.walking import WalkMotion, walk_motion, walking_loads
from robustopt.path import Path
from robustopt.robot import Robot

Array = np.ndarray
Error = tuple[Array, Array]
"""Middle and half-width of the interval of joint acceleration error, (n,) each [rad/s^2]."""
Value = TypeVar("Value")

REST_REFINEMENT = 0.45
"""Share of cosine spacing in the grid of a piece, the rest is uniform: finer towards rest, where sd is like sqrt(s).
With 0.45, 200 intervals are within 0.3 % of a fine grid on all waiter tasks; below 0.4 and above 0.55 not on all."""

LEAST_RATE = 1e-3
"""Where q' vanishes, sd and sdd are bounded as if it were this part of its largest value, far beyond what other grid
points and the bend q'' leave of them."""

MOST_KEPT = 16
"""Results that a track keeps of each kind: enough for problems that differ in their friction alone."""


@dataclass(frozen=True, eq=False)
class Track:
    """A grid along a path and the motion of robot and tray, or of a robot on its feet, there.

    s: (P,) grid points in [0, 1]; piece: (P,) piece of the path; rest: (P,) where the robot must stand still;
    x_max: (P,) largest x that the joint velocities allow; fastest: (P,) which joint bounds it
    """

    robot: Robot
    path: Path
    s: Array
    piece: Array
    rest: Array
    motion: PathMotion | WalkMotion
    x_max: Array
    fastest: Array
    _kept: dict[str, dict[Hashable, Any]] = field(default_factory=dict, repr=False)
    _lock: Lock = field(default_factory=Lock, repr=False)

    @cached_property
    def velocity_names(self) -> tuple[str, ...]:
        """Names of the velocity limits that bound x, (P,)."""
        return tuple(f"{self.robot.joint_names[k]} velocity" for k in self.fastest)

    def loads(self, carried: Sequence[Sequence[Body]], about: Sequence[Array], error: Error) -> Loads:
        """Loads of stacked objects, each of which carries the bodies listed for it: see `body_loads`."""
        motion = self.motion
        assert isinstance(motion, PathMotion)
        key = (tuple(map(tuple, carried)), np.concatenate(about).tobytes(), _bytes(error))
        erring = any(map(np.any, error))

        def wrenches_of(body: Body) -> BodyWrenches:
            return self._once("wrenches", (body, erring), lambda: body_wrenches(motion, body, erring))

        return self._once("loads", key, lambda: body_loads(carried, about, *error, wrenches_of))

    def walking_loads(self, config: Config, error: Error) -> Loads:
        """Load of a robot on its feet with the configured beliefs: see `walking`."""
        robot, motion = self.robot, self.motion
        assert isinstance(motion, WalkMotion)
        key = (repr((config.uncertainty.center_of_mass, config.uncertainty.mass)), _bytes(error))
        return self._once("loads", key, lambda: walking_loads(config, robot, motion, error))

    def torque(self, payload: Loads, error: Error) -> TorqueFamily:
        """Joint torque limits with a payload."""
        motion, limits = self.motion, self.robot.limits
        assert isinstance(motion, PathMotion)
        family = self._once("torque", error[0].tobytes(), lambda: torque_family(motion, limits, payload, *error))
        key = (len(payload.constant_group), _bytes(error))
        terms = self._once("torque terms", key, lambda: own_inertia_terms(motion, limits, payload, error[1]))
        return family.carrying(payload, terms)

    def acceleration(self, error: Error) -> Array:
        """Rows of the joint acceleration limits, (P, 2n, 3)."""
        return self._once(
            "acceleration", _bytes(error), lambda: acceleration_rows(self.motion, self.robot.limits, *error)
        )

    def outline(self, error: Error) -> Polygons:
        """Rectangles that hold every (u, x) of the acceleration limits, twice as wide as they need to be."""
        return self._once("outline", error[0].tobytes(), lambda: _outline(self, error[0]))

    def joint_polygons(self, error: Error) -> Polygons:
        """The outline, cut with the rows of the joint acceleration limits, which are named n + joint."""
        names = self.robot.n + np.tile(np.arange(self.robot.n), 2)
        rows = self.acceleration(error)
        return self._once("joint polygons", _bytes(error), lambda: cut_affine(self.outline(error), rows, names))

    def _once(self, kind: str, key: Hashable, make: Callable[[], Value]) -> Value:
        """A result that may be at hand; two threads may make it at the same time, alike."""
        kept = self._kept.setdefault(kind, {})
        found: Value | None = kept.get(key)
        if found is None:
            found = make()
            with self._lock:
                while len(kept) >= MOST_KEPT:
                    kept.pop(next(iter(kept)))
                kept[key] = found
        return found


def _bytes(error: Error) -> bytes:
    return np.concatenate(error).tobytes()


def build_track(config: Config, robot: Robot, path: Path) -> Track:
    """The track of a path, with the configured number of intervals."""
    s, piece = gridpoints(path, config.solver.collocation_points)
    for switch in path.switches:  # the limits on both sides of it hold there
        s[1 + np.argmin(np.abs(s[1:-1] - switch))] = switch
    rest = np.zeros(len(s), dtype=bool)
    rest[[0, -1]] = True
    doubled = np.flatnonzero(np.diff(s) == 0)
    rest[doubled] = rest[doubled + 1] = True
    q, q1, q2 = (path.evaluate(s, piece, order) for order in (0, 1, 2))
    motion: PathMotion | WalkMotion
    motion = walk_motion(robot, q, q1, q2) if robot.base else path_motion(q1, q2, robot.dynamics(q, q1, q2))
    return Track(robot, path, s, piece, rest, motion, *_velocity_bound(q1, robot.limits.velocity))


def gridpoints(path: Path, intervals: int) -> tuple[Array, Array]:
    """Grid of a path: s (P,) and the piece of each grid point (P,); stops are doubled, P = intervals + pieces."""
    lengths = np.diff(path.breaks)
    counts = _apportion(lengths, intervals)
    s, piece = [], []
    for k, count in enumerate(counts):
        xi = np.linspace(0.0, 1.0, count + 1)
        spaced = (1 - REST_REFINEMENT) * xi + REST_REFINEMENT * (1 - np.cos(np.pi * xi)) / 2
        points = path.breaks[k] + lengths[k] * spaced
        points[0], points[-1] = path.breaks[k], path.breaks[k + 1]
        s.append(points)
        piece.append(np.full(count + 1, k))
    return np.concatenate(s), np.concatenate(piece)


def _apportion(lengths: Array, total: int) -> list[int]:
    """Split `total` intervals in proportion to the lengths, at least two each, by largest remainders.

    Short pieces get two, the others share the rest; only where `total` is below two each is it exceeded.
    """
    short = np.zeros(len(lengths), dtype=bool)
    while True:
        left = total - 2 * short.sum()
        shares = np.where(short, 2.0, lengths / max(lengths[~short].sum(), 1e-300) * left)
        if not (shares < 2.0).any():
            break
        short |= shares < 2.0
    counts = np.floor(shares).astype(int)
    for k in np.argsort(counts - shares, kind="stable")[: max(total - counts.sum(), 0)]:
        counts[k] += 1
    return [int(count) for count in counts]


def _velocity_bound(q1: Array, velocity: Array) -> tuple[Array, Array]:
    """Largest x that the joint velocities allow, (P,), and which joint bounds it, (P,)."""
    ratio = np.abs(q1) / velocity
    fastest = np.argmax(ratio, axis=1)
    return 1.0 / _without_zeros(ratio.max(axis=1)) ** 2, fastest


def _outline(track: Track, middle: Array) -> Polygons:
    motion, x_max = track.motion, track.x_max
    limit = track.robot.limits.acceleration
    rate = np.abs(motion.q1) / limit
    lead = np.argmax(rate, axis=1)
    row = np.arange(len(x_max))
    bend = np.abs(motion.q2[row, lead]) / limit[lead] * x_max
    reach = (1.0 + (np.abs(middle) / limit)[lead] + bend) / _without_zeros(rate[row, lead])
    return start(2.0 * reach, x_max, track.fastest)


def _without_zeros(rates: Array) -> Array:
    """Rates of the fastest joint along the path (P,), bounded from below where joints turn around together."""
    return np.maximum(rates, LEAST_RATE * rates.max())
