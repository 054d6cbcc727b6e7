"""Programs of a jerk-limited problem, one for each piece of the path between two rests.

An end of the path at which the robot moves is an end of a piece too.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from robustopt.arrays import Array, Indices
from robustopt.limits import TimeScalingProblem
from robustopt.solvers.binding import JERK_INSIDE
from robustopt.solvers.jerk_newton import Program

PLACES = np.linspace(0.0, 1.0, 9)
"""Places within an interval at which jerk may be limited; x and u are interpolated there."""

USUAL = np.isin(np.arange(9), (0, 4, 8))
"""Whether jerk is limited at each place of every interval."""

BENT = 5e-3
"""Part of its limit by which the jerk at the velocity limit may differ from the parabola through the usual places,
before it is limited at all places: half of what a certificate accepts."""

State = tuple[float, float]
"""x = sd^2 [1/s^2] and u = sdd [1/s^2]."""


@dataclass(frozen=True)
class Piece:
    """Part of a path between two rests, or ends at which the robot moves.

    Attributes:
        first: grid point at its start.
        last: grid point at its end.
        start: state at its start if the robot moves there, None at rest.
        end: state at its end if the robot moves there, None at rest.
    """

    first: int
    last: int
    start: State | None = None
    end: State | None = None

    @property
    def at_rest(self) -> bool:
        """Return whether the robot rests at both ends."""
        return self.start is None and self.end is None

    @property
    def single(self) -> bool:
        """Return whether it is a single interval, on which nothing can be chosen if a state is given."""
        return self.last == self.first + 1

    @property
    def points(self) -> slice:
        """Return the grid points of the program: all at which the robot moves."""
        return slice(self.first + (self.start is None), self.last + (self.end is not None))


def pieces(problem: TimeScalingProblem) -> list[Piece]:
    """Return the pieces of a path.

    Args:
        problem: the problem.
    """
    stops, path = np.flatnonzero(problem.ds == 0.0), problem.path
    firsts, lasts = [0, *(stops + 1).tolist()], [*stops.tolist(), len(problem.s) - 1]
    start, end = (
        (speed**2, sdd) if speed > 0.0 else None
        for speed, sdd in zip(path.end_speeds, path.end_accelerations, strict=True)
    )
    inner = [None] * len(stops)
    return [Piece(*piece) for piece in zip(firsts, lasts, [start, *inner], [*inner, end], strict=True)]


def program_of(problem: TimeScalingProblem, piece: Piece) -> Program:
    """Return the program of a piece.

    On the first interval from rest the rate k is constant, so u = 2 x / (3 ds) and k = 2 sd^3 / (9 ds^2) at its end.
    The jerk is at most sd^3 (|q'''| + 2 |q''| / ds + 2 |q'| / (9 ds^2)), which bounds x. The last interval to rest is
    its mirror image.

    Args:
        problem: the problem.
        piece: the piece.
    """
    first, last, points = piece.first, piece.last, piece.points
    path, s, jerk = problem.path, problem.s[first : last + 1], problem.jerk
    chosen = np.isfinite(jerk)
    ds = np.diff(s)
    places = s[:-1, None] + np.clip(PLACES, JERK_INSIDE, 1.0 - JERK_INSIDE) * ds[:, None]
    q1, q2, q3 = (
        path.evaluate(places.ravel(), np.full(places.size, problem.piece[first]), order)[:, chosen].reshape(
            *places.shape, -1
        )
        / jerk[chosen]
        for order in (1, 2, 3)
    )
    x_max = problem.x_max[points].copy()
    between = slice(points.start - first, points.stop - 1 - first)
    limited = _limited_places(q1[between], q3[between], np.maximum(x_max[:-1], x_max[1:]))
    ends, beyond = np.zeros(2), np.zeros(2)
    for end, state in ((0, piece.start), (-1, piece.end)):
        largest1, largest2, largest3 = (np.abs(values[end]).max(axis=0) for values in (q1, q2, q3))
        if state is not None:
            beyond[end] = max(state[0] ** 0.75 * np.sqrt(2.0 * largest1.max()), ds[end])
            continue
        ends[end] = ds[end]
        gain = largest3 + 2.0 * largest2 / ds[end] + 2.0 * largest1 / (9.0 * ds[end] ** 2)
        with np.errstate(divide="ignore"):  # joints that do not move have no jerk
            x_max[end] = min(x_max[end], gain.max() ** (-2.0 / 3.0))
    a, b, c = (rows[points] for rows in (problem.a, problem.b, problem.c))
    at = problem.s[points]
    return Program(
        ends,
        ds[between].copy(),
        np.minimum(at - s[0] + beyond[0], s[-1] - at + beyond[1]),
        *_lines(a / -c, b / -c, x_max),
        limited[0],
        PLACES[limited[1]],
        *(q[between][limited] for q in (q1, q2, q3)),
    )


def _limited_places(q1: Array, q3: Array, fastest: Array) -> tuple[Indices, ...]:
    """Return the intervals between points, places and joints at which jerk is limited, (k,) each.

    Args:
        q1: q' / J at all places of these intervals (n - 1, 9, joints).
        q3: q''' / J there.
        fastest: largest x on each interval (n - 1,).
    """
    from_start, middle = 1.0 - PLACES[:, None], 4.0 * (PLACES * (1.0 - PLACES))[:, None]
    parabola = (
        q3[:, :1] * from_start * (1.0 - 2.0 * PLACES[:, None])
        + q3[:, 4:5] * middle
        + q3[:, 8:] * PLACES[:, None] * (2.0 * PLACES[:, None] - 1.0)
    )
    bent = np.abs(q3 - parabola).max(axis=1) * fastest[:, None] ** 1.5 > BENT
    moving = np.abs(q1).max(axis=(0, 1), initial=0.0) > 0.0
    return np.nonzero((USUAL[:, None] | bent[:, None]) & moving)


def _lines(a: Array, b: Array, x_max: Array) -> tuple[Indices, Array]:
    """Return the linear limits: rows a u + b x <= 1 of the points, with u and with the means, and x <= x_max.

    Args:
        a: coefficients of u (n, m).
        b: coefficients of x (n, m).
        x_max: largest x (n,).

    Returns:
        First of the two points that each limit depends on (l,), and its coefficients of x, u, x', u' (l, 4).
    """
    n, point, line = len(x_max), [np.arange(len(x_max))], [np.zeros((len(x_max), 4))]
    line[0][:, 0] = -1.0 / x_max
    at, k = np.nonzero((a != 0.0) | (b != 0.0))
    own = np.zeros((len(at), 4))
    own[:, 0], own[:, 1] = -b[at, k], -a[at, k]
    point.append(at)
    line.append(own)
    at, k = np.nonzero(a)
    for end in (0, 1):
        here = (at >= end) & (at - end < n - 1)
        mean = np.zeros((np.count_nonzero(here), 4))
        mean[:, 2 * end] = -b[at, k][here]
        mean[:, 1] = mean[:, 3] = -0.5 * a[at, k][here]
        point.append(at[here] - end)
        line.append(mean)
    return np.concatenate(point), np.concatenate(line)
