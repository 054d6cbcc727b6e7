"""Timings of a piece of a path from which the search for the fastest jerk-limited one starts."""

from __future__ import annotations

import numpy as np

from robustopt.arrays import Array
from robustopt.limits import TimeScalingProblem
from robustopt.solvers.jerk_newton import Program, Work, correct, workspace
from robustopt.solvers.jerk_program import Piece, State, program_of

USED = 0.5
"""Part of each limit that the timing at the start uses."""

MOST_CORRECTIONS = 20
"""Largest number of Newton steps to a timing that satisfies the equations of the intervals; three are usual."""

CONSISTENT = 1e-12
"""Residual of the equations of the intervals, as a fraction of x, that rounding errors leave."""

FARTHEST = 0.25
"""Largest part of a piece within which the acceleration at a moving end fades away (our choice)."""


def first_timing(problem: TimeScalingProblem, piece: Piece, program: Program) -> Array:
    """Return a timing of a piece to start from, (2 n + 2,), see `Program`.

    From rest to rest it uses a part of the limits, see `slow_timing`. Otherwise x is the sum of such a timing and of
    one that leads from the one state to the other, and may violate limits.

    Args:
        problem: the problem.
        piece: the piece.
        program: its program.
    """
    if piece.at_rest:
        return slow_timing(program)
    z = np.zeros(2 * len(program.away) + 2)
    z[:-2:2], z[1:-2:2] = _between(problem.s, piece)
    if not piece.single:
        resting = Piece(piece.first, piece.last)
        slow = slow_timing(program_of(problem, resting))[:-2]
        x, u = _smoothed(slow[::2], slow[1::2], problem.s, piece, program)
        inner = 2 * (resting.points.start - piece.points.start)
        z[inner : inner + len(slow) : 2] += x
        z[inner + 1 : inner + len(slow) : 2] += u
        correct(program, z, workspace(program), MOST_CORRECTIONS, CONSISTENT)
    return z


def timing_of(running: Array, piece: Piece) -> Array:
    """Return the timing of a piece in a running plan, (2 n + 2,), see `Program`.

    Args:
        running: x and sdd at all grid points (2, P).
        piece: the piece.
    """
    first, stop = piece.points.start, piece.points.stop
    z = np.zeros(2 * (stop - first) + 2)
    z[:-2:2], z[1:-2:2] = running[:, first:stop]
    for state, k in ((piece.start, 0), (piece.end, 2 * (stop - first) - 2)):
        if state is not None:
            z[k : k + 2] = state
    return z


def _between(s: Array, piece: Piece) -> tuple[Array, Array]:
    """Return x and u that lead from the state at the start of a piece to the one at its end, at its points (n,) each.

    Args:
        s: all grid points (P,).
        piece: the piece; the robot moves at one of its ends at least.
    """
    begin, end, at = s[piece.first], s[piece.last], s[piece.points]
    length = end - begin
    ahead, left = (at - begin) / length, (end - at) / length
    if piece.start is not None and piece.end is not None:
        rise = piece.end[0] - piece.start[0]
        x = piece.start[0] + rise * ahead**2 * (3.0 - 2.0 * ahead)
        u = 3.0 * rise * ahead * left / length
    else:  # half of a timing from rest to rest
        state, to_rest, sign = (piece.start, left, 1.0) if piece.end is None else (piece.end, ahead, -1.0)
        assert state is not None
        t = _time_of(0.5 * to_rest)
        x = state[0] * (16.0 * t**2 * (1.0 - t) ** 2) ** 2
        u = -sign * state[0] / length * 128.0 / 15.0 * t * (1.0 - 3.0 * t + 2.0 * t**2)
    x, u = _bent(x, u, piece.start, ahead, 1.0, length)
    return _bent(x, u, piece.end, left, -1.0, length)


def _smoothed(x: Array, u: Array, s: Array, piece: Piece, program: Program) -> tuple[Array, Array]:
    """Return a timing from rest to rest whose x has the order of s^2, not s^(4/3), at the ends where the robot moves.

    Added to the x of a robot that moves, s^(4/3) would be an endless jerk.

    Args:
        x: x at the points between the ends (m,).
        u: u there (m,).
        s: all grid points (P,).
        piece: the piece.
        program: its program.
    """
    at, begin, end = s[piece.first + 1 : piece.last], s[piece.first], s[piece.last]
    for state, away, sign, reach in (
        (piece.start, at - begin, 1.0, program.away[0]),
        (piece.end, end - at, -1.0, program.away[-1]),
    ):
        if state is not None:
            part = (away / (away + reach)) ** (2.0 / 3.0)
            x, u = x * part, part * (u + sign * x * reach / (3.0 * away * (away + reach)))
    return x, u


def _bent(x: Array, u: Array, state: State | None, away: Array, sign: float, length: float) -> tuple[Array, Array]:
    """Return x and u (P,) that have the u of a state at an end of a piece, at which u is 0 before.

    x is multiplied by a positive factor that differs from 1 near this end.

    Args:
        x: x (P,).
        u: u (P,).
        state: the state; None at rest, where nothing changes.
        away: distances from this end as parts of the length (P,).
        sign: 1 at the start, -1 at the end.
        length: length of the piece.
    """
    if state is None or state[1] == 0.0:
        return x, u
    steep = 2.0 * sign * state[1] * length / state[0]
    reach = min(FARTHEST, 1.0 / abs(steep))
    near, left = np.exp(-away / reach), 1.0 - away
    factor = 1.0 + steep * away * near * left**2
    slope = sign * steep * near * left * ((1.0 - away / reach) * left - 2.0 * away) / length
    return x * factor, u * factor + 0.5 * x * slope


def overuse(program: Program, work: Work, part: float) -> float:
    """Return the number by which x and u of a timing must be divided so that it uses at most a part of all limits.

    Args:
        program: the program.
        work: its values at the timing.
        part: the part.
    """
    lines, step = len(program.line), work.dt[program.jerk_point + 1]
    used = 1.0 - float(work.g[:lines].min())
    jerk = 1.0 - float((work.g[lines:].reshape(-1, 2).min(axis=1) / step).min(initial=1.0))
    return max(used / part, (jerk / part) ** (2.0 / 3.0))


def slow_timing(program: Program) -> Array:
    """Return a timing of a piece that uses at most the part USED of its limits, (2 n + 2,), see `Program`.

    It has the shape s = 10 t^3 - 15 t^4 + 6 t^5, from rest to rest with sdd = 0 at both ends.

    Args:
        program: the program; x = u = 0 satisfies its limits with some slack.
    """
    ds = np.concatenate([program.ends[:1], program.ds, program.ends[1:]])
    length = ds.sum()
    ahead, left = np.cumsum(ds)[:-1] / length, np.cumsum(ds[::-1])[-2::-1] / length
    near = np.where(ahead < 0.5, _time_of(ahead), _time_of(left))
    z = np.zeros(2 * len(near) + 2)
    z[:-2:2] = (length * 30.0 * near**2 * (1.0 - near) ** 2) ** 2
    z[1:-2:2] = np.where(ahead < 0.5, 1.0, -1.0) * length * (60.0 * near - 180.0 * near**2 + 120.0 * near**3)
    work = workspace(program)
    correct(program, z, work, MOST_CORRECTIONS, CONSISTENT)
    return z / overuse(program, work, USED)


def _time_of(s: Array) -> Array:
    """Return t in [0, 1/2] with s = 10 t^3 - 15 t^4 + 6 t^5, by Newton's method from t = (s / 10)^(1/3)."""
    t = np.cbrt(s / 10.0)
    for _ in range(MOST_CORRECTIONS):
        t = np.minimum(t - (10.0 * t**3 - 15.0 * t**4 + 6.0 * t**5 - s) / (30.0 * t**2 * (1.0 - t) ** 2), 0.5)
    return t
