"""Geometric path of the coordinates q(s), s in [0, 1], as splines.

The path is C2 on each piece; between two pieces the robot stops.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import BSpline, CubicSpline

from robustopt.arrays import Array, Indices
from robustopt.path.footsteps import Footsteps
from robustopt.path.pose_path import label

POINTS_PER_KNOT = 8
FEWEST_POINTS = 200
"""Density of the points at which the joint limits are checked: an extremum is missed by 1/16 of a knot interval."""

STILL = 1e-9
"""Least |q'| at an end of the path where the robot moves: with less, its speed is beyond every limit (our choice)."""

Spline = BSpline | CubicSpline


class Path:
    """A path q(s), s in [0, 1] or from a later position to 1, of K pieces, C2 on each.

    Attributes:
        breaks: boundaries of the pieces, from the start to 1 (K+1,); the robot stops at the inner ones, and the
            derivative of q may jump there.
        waypoints: s of the configured waypoints (W,).
        switches: values of s at which the limits change without a stop.
        kinks: values of s that a grid should contain: the switches, and interior knots of cubic splines, at which q''
            has a kink.
        stances: phases of a path with steps in their order; () without steps.
        notes: content of the path's files that is not used or looks wrong, in words.
        recorded: duration of the recording that the path follows; None without one [s].
        pauses: time for which the robot stands still at each inner break (K-1,) [s].
        end_speeds: sd at the start and at the end [1/s].
        end_accelerations: sdd at the start and at the end if jerk is limited [1/s^2]. The length of q' sd does not
            change there, unless the path is the rest of a running plan.

    Args:
        pieces: splines q(s), one for each piece.
        breaks: boundaries of the pieces (K+1,).
        waypoints: s of the configured waypoints (W,).
        noun: name of the waypoints in the configuration.
        steps: footsteps, with one phase between neighbouring waypoints.
        notes: content of the path's files that is not used or looks wrong, in words.
        recorded: duration of the recording that the path follows; None without one [s].
        pauses: time for which the robot stands still at each inner break (K-1,), by default 0 [s].
        speeds: length of q' sd at the start and at the end, where q' does not vanish [rad/s or m/s].
    """

    def __init__(
        self,
        pieces: Sequence[Spline],
        breaks: Array,
        waypoints: Array,
        noun: str,
        steps: Footsteps | None = None,
        notes: Sequence[str] = (),
        recorded: float | None = None,
        pauses: Array | None = None,
        speeds: tuple[float, float] = (0.0, 0.0),
    ) -> None:
        self.breaks = np.array(breaks, dtype=float)
        self.waypoints = np.array(waypoints, dtype=float)
        self.breaks.setflags(write=False)
        self.waypoints.setflags(write=False)
        self._noun, self._steps = noun, steps
        self.notes, self.recorded = tuple(notes), recorded
        self.pauses = np.zeros(len(self.breaks) - 2) if pauses is None else np.array(pauses, dtype=float)
        self.pauses.setflags(write=False)
        self.stances = steps.stances if steps is not None else ()
        self.switches = self.waypoints[1:-1] if steps is not None else np.zeros(0)
        knots = [piece.x[1:-1] for piece in pieces if isinstance(piece, CubicSpline)]
        self.kinks = np.union1d(self.switches, np.concatenate([np.zeros(0), *knots]))
        self._knots = np.unique(
            np.concatenate([piece.x if isinstance(piece, CubicSpline) else piece.t for piece in pieces])
        )
        self._derivatives = [[piece.derivative(order) if order else piece for order in range(4)] for piece in pieces]
        self._set_speeds(speeds)

    @property
    def moving_ends(self) -> tuple[str, ...]:
        """Return which ends of the path, `start` and `end`, the robot passes at a speed other than 0."""
        return tuple(end for end, speed in zip(("start", "end"), self.end_speeds, strict=True) if speed > 0.0)

    def with_speeds(self, start: float | None, end: float) -> Path:
        """Return the same path with other speeds at its ends.

        Args:
            start: length of q' sd at the start [rad/s or m/s]; None to keep speed and acceleration there.
            end: length of q' sd at the end [rad/s or m/s].
        """
        other = copy(self)
        other._set_speeds((start or 0.0, end))
        if start is None:
            other.end_speeds = self.end_speeds[0], other.end_speeds[1]
            other.end_accelerations = self.end_accelerations[0], other.end_accelerations[1]
        return other

    def after(self, s: float, piece: int, speed: float, acceleration: float) -> Path:
        """Return the part of the path from a position on, with the same s.

        Args:
            s: the position along the path.
            piece: piece of the path on which the part begins.
            speed: sd there [1/s].
            acceleration: sdd there, from which it continues if jerk is limited [1/s^2].
        """
        other = copy(self)
        other.breaks = np.append(s, self.breaks[piece + 1 :])
        other.breaks.setflags(write=False)
        other.pauses, other.kinks = self.pauses[piece:], self.kinks[self.kinks > s]
        other.switches = self.switches[self.switches > s]
        other.stances = self.stances[len(self.switches) - len(other.switches) :]
        other.end_speeds = speed, self.end_speeds[1]
        other.end_accelerations = acceleration, self.end_accelerations[1]
        other._derivatives = self._derivatives[piece:]
        return other

    def _set_speeds(self, speeds: tuple[float, float]) -> None:
        q1, q2 = (self(self.breaks[[0, -1]], order) for order in (1, 2))
        rates = np.maximum(np.linalg.norm(q1, axis=1), STILL)
        start, end = (np.array(speeds) / rates).tolist()
        before, after = (-np.sum(q1 * q2, axis=1) * (np.array(speeds) / rates**2) ** 2).tolist()
        self.end_speeds: tuple[float, float] = (start, end)
        self.end_accelerations: tuple[float, float] = (before + 0.0, after + 0.0)

    def evaluate(self, s: Array, piece: Indices, order: int = 0) -> Array:
        """Return a derivative of q with respect to s.

        Args:
            s: positions along the path (P,).
            piece: piece on which q is evaluated at each s (P,).
            order: order of the derivative, 0 to 3.

        Returns:
            The derivatives (P, n).
        """
        s, piece = np.asarray(s, dtype=float), np.asarray(piece)
        s = np.clip(s, self.breaks[piece], self.breaks[piece + 1])
        if len(self._derivatives) == 1:
            return np.asarray(self._derivatives[0][order](s))
        values = np.empty((len(s), self._derivatives[0][0](0.0).shape[-1]))
        for k, derivatives in enumerate(self._derivatives):
            chosen = piece == k
            values[chosen] = derivatives[order](s[chosen])
        return values

    def __call__(self, s: ArrayLike, order: int = 0) -> Array:
        """Return the derivative of `order` (0 to 3) of q at `s` (P,), shape (P, n); at a stop, on the later piece."""
        s = np.atleast_1d(np.asarray(s, dtype=float))
        return self.evaluate(s, self.piece_at(s), order)

    def piece_at(self, s: Array) -> Indices:
        """Return the index of the piece at positions along the path, (P,): at a stop the later one, at s = 1 the last.

        Args:
            s: positions along the path (P,).
        """
        return np.clip(np.searchsorted(self.breaks, s, side="right") - 1, 0, len(self.breaks) - 2)

    def fine_grid(self) -> Array:
        """Return points of s in [0, 1] between which the path bends little, including all knots and waypoints."""
        knots = np.union1d(np.clip(self._knots, 0.0, 1.0), self.waypoints)
        parts = max(POINTS_PER_KNOT, -(-FEWEST_POINTS // (len(knots) - 1)))
        inner = knots[:-1, None] + np.diff(knots)[:, None] * np.arange(parts) / parts
        return np.append(inner.ravel(), 1.0)

    def label(self, s: float) -> str:
        """Describe a position along the path by its waypoints, such as "between joints[1] and joints[2], at 40 %".

        Args:
            s: the position along the path.
        """
        return label(self.waypoints, s, self._noun) if self._steps is None else self._steps.label(s)
