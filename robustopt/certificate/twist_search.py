"""Search for the rate of motion at which a hold resists a twist the least, compiled.

A rate y (3,) is a direction, so the search is on a sphere. It evaluates directions all over the sphere, climbs from the
best one, and tries the rotations about the contact points, where the ratio has kinks.
"""

from __future__ import annotations

import numpy as np

from robustopt.compiled import compiled, compiled_inner

STEPS = (0.2, 0.2, 0.1, 0.1, 0.05, 0.05, 0.02, 0.02, 0.008, 0.003, 0.001)
"""Lengths of the steps to all sides; the first ones cover the distance between two directions. The ratio is then right
to 1e-6 in 99.7 % of random twists, and to 1e-5 in all of them.
"""

FARTHEST = 3.0
"""Largest distance, in steps, at which the top of a parabola is used."""

SIDES = 8


@compiled_inner(error_model="numpy")
def _ratio(plane, normals, twists, y0, y1, y2):
    """Return -slack(move) / slack(rest) for a rate; infinite unless the slack of rest is positive."""
    rest = -twists[0, 0] * y0 - twists[1, 0] * y1 - twists[2, 0] * y2
    move = -twists[0, 1] * y0 - twists[1, 1] * y1 - twists[2, 1] * y2
    for i in range(plane.shape[0]):
        vx, vy = y0 - y2 * plane[i, 1], y1 + y2 * plane[i, 0]
        speed = np.sqrt(vx * vx + vy * vy)
        rest += speed * normals[i, 0]
        move += speed * normals[i, 1]
    return -move / rest if rest > 0.0 else np.inf


@compiled_inner(error_model="numpy")
def _place(frame, along, across, out):
    """Compute the direction at a distance from the first row of a frame (3, 3), along the two others."""
    size = 0.0
    for k in range(3):
        out[k] = frame[0, k] + along * frame[1, k] + across * frame[2, k]
        size += out[k] ** 2
    for k in range(3):
        out[k] /= np.sqrt(size)


@compiled_inner(error_model="numpy")
def _span(y, frame):
    """Compute a frame whose first row is y (3,) and whose second and third row span the plane across y."""
    axis = 0
    for k in range(1, 3):
        if abs(y[k]) < abs(y[axis]):
            axis = k
    b, c = (axis + 1) % 3, (axis + 2) % 3
    size = np.sqrt(y[b] ** 2 + y[c] ** 2)
    frame[1, axis], frame[1, b], frame[1, c] = 0.0, y[c] / size, -y[b] / size
    for k in range(3):
        i, j = (k + 1) % 3, (k + 2) % 3
        frame[0, k] = y[k]
        frame[2, k] = y[i] * frame[1, j] - y[j] * frame[1, i]


@compiled_inner(error_model="numpy")
def _top(rise):
    """Return the top of a parabola, in steps, from the rise to the neighbours (SIDES,); 0 if it has none nearby."""
    total, along, across, even, odd = 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(SIDES):
        angle = 2.0 * np.pi * k / SIDES
        own = rise[k] if np.isfinite(rise[k]) else 0.0
        total += own
        along += own * np.cos(angle)
        across += own * np.sin(angle)
        even += own * np.cos(2.0 * angle)
        odd += own * np.sin(2.0 * angle)
    a, b, c = 0.25 * total + 0.5 * even, 0.5 * odd, 0.25 * total - 0.5 * even
    bend = a * c - b * b
    if a < 0.0 < bend:
        x, y = 0.25 * (b * across - c * along) / bend, 0.25 * (b * along - a * across) / bend
        if max(abs(x), abs(y)) < FARTHEST:
            return x, y
    return 0.0, 0.0


@compiled_inner(error_model="numpy")
def _climb(plane, normals, twists, worst, y, frame, tried, best, rise):
    """Move y to the largest ratio near it, from its neighbours and the top of a parabola; return the ratio."""
    for step in STEPS:
        _span(y, frame)
        value = -np.inf
        for k in range(SIDES + 1):
            if k < SIDES:
                angle = 2.0 * np.pi * k / SIDES
                _place(frame, step * np.cos(angle), step * np.sin(angle), tried)
            else:
                x, z = _top(rise)
                _place(frame, step * x, step * z, tried)
            own = _ratio(plane, normals, twists, tried[0], tried[1], tried[2])
            if k < SIDES:
                rise[k] = own - worst
            if own > value:
                value, best[0], best[1], best[2] = own, tried[0], tried[1], tried[2]
        if value >= worst:
            worst, y[0], y[1], y[2] = value, best[0], best[1], best[2]
    return worst


@compiled(error_model="numpy")
def largest_ratio(plane, normals, twists, directions, interest):
    """Find the largest ratio -slack(move) / slack(rest) of T holds.

    Args:
        plane: contact points in the plane of the hold (T or 1, k, 2).
        normals: friction that each point resists, of rest and move (T, k, 2).
        twists: twist of rest and move (T, 3, 2).
        directions: rates that are evaluated first (D, 3).
        interest: ratio below which a hold is not searched further (T,).

    Returns:
        The ratio (T,), infinite unless the slack of rest is positive for all rates that are tried, and its rate (T, 3).
    """
    T = len(twists)
    value, rates = np.empty(T), np.empty((T, 3))
    frame, tried, best, rise = np.empty((3, 3)), np.empty(3), np.empty(3), np.empty(SIDES)
    for t in range(T):
        points, own, twist, y = plane[t if len(plane) > 1 else 0], normals[t], twists[t], rates[t]
        worst = -np.inf
        for d in range(len(directions)):
            ratio = _ratio(points, own, twist, directions[d, 0], directions[d, 1], directions[d, 2])
            if ratio > worst:
                worst, y[0], y[1], y[2] = ratio, directions[d, 0], directions[d, 1], directions[d, 2]
        if interest[t] < worst < np.inf:
            worst = _climb(points, own, twist, worst, y, frame, tried, best, rise)
        for i in range(len(points)):
            for sign in (1.0, -1.0):
                y0, y1 = sign * points[i, 1], -sign * points[i, 0]
                ratio = _ratio(points, own, twist, y0, y1, sign)
                if ratio > worst:
                    worst, y[0], y[1], y[2] = ratio, y0, y1, sign
        value[t] = max(worst, 0.0)
    return value, rates
