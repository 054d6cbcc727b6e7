"""Strength that an interface needs to survive a motion up to a given time: sliding and tipping, integrated (ours).

An object at rest on its support begins to slide when the friction that it needs exceeds the available one, and begins
to tip when its centre of pressure leaves the base. Whether it fails depends on what follows: it has failed only once it
has moved by the threshold of the failure. Both movements are integrated for a series of strengths at once, and the
smallest strength with which the threshold is not reached is interpolated. All arrays are over P motions of equally many
time steps.
"""

from __future__ import annotations

import numpy as np

from robustopt.arrays import Array

FRICTIONS = np.geomspace(0.01, 3.0, 96)
"""Coefficients of friction for which sliding is integrated."""

BASES = np.geomspace(0.05, 1.6, 96)
"""Parts of the base, about its middle, for which tipping is integrated."""

FAR = 1e9
"""Cap on the integrated tilt, which prevents overflow [rad]."""

STILL = 1e-9
"""Speed below which an object does not slide [m/s]."""


def friction_needed(tangential: Array, normal: Array, step: Array, threshold: float) -> Array:
    """Return the logarithm of the friction with which an object slides by less than a threshold up to each time.

    Sliding friction acts against the velocity, and the object follows its support otherwise.

    Args:
        tangential: tangential force that the object needs per mass (P, T, 2) [m/s^2].
        normal: normal force per mass (P, T) [m/s^2].
        step: time step of each motion (P,) [s].
        threshold: distance at which the object has slid [m].

    Returns:
        Logarithms of coefficients of friction, between those of `FRICTIONS`, (P, T).
    """
    P, T = normal.shape
    velocity, moved = np.zeros((P, len(FRICTIONS), 2)), np.zeros((P, len(FRICTIONS), 2))
    peak, needed = np.zeros((P, len(FRICTIONS))), np.zeros((P, T))
    dt = step[:, None, None]
    for i in range(T):
        force = tangential[:, None, i]
        size = np.hypot(force[..., 0], force[..., 1])
        grip = FRICTIONS * np.maximum(normal[:, i, None], 0.0)
        speed = np.hypot(velocity[..., 0], velocity[..., 1])
        slides, gives = speed > STILL, size > grip
        length = np.where(slides, speed, np.maximum(size, STILL))
        along = np.where(slides[..., None], velocity, -force) / length[..., None]
        faster = velocity + dt * (-force - grip[..., None] * along)
        stops = slides & ((faster * velocity).sum(axis=2) < 0.0) & ~gives
        velocity = np.where((slides | gives)[..., None] & ~stops[..., None], faster, 0.0)
        moved = moved + dt * velocity
        peak = np.maximum(peak, np.hypot(moved[..., 0], moved[..., 1]))
        needed[:, i] = _least(FRICTIONS, peak, threshold)
    return np.maximum.accumulate(needed, axis=1)


def base_needed(
    moments: Array, normal: Array, apothems: Array, height: float, inertia: Array, step: Array, threshold: float
) -> Array:
    """Return the logarithm of the part of a base on which an object tips by less than a threshold up to each time.

    Args:
        moments: moment that the object needs about an axis through the middle of its base along each edge (P, T, E)
            [N m]; the centre of pressure leaves the base over the edge if it exceeds the normal force times the
            distance of the edge.
        normal: normal force (P, T) [N].
        apothems: distance of each edge from the middle of the base (E,) [m].
        height: height of the centre of mass above the base [m].
        inertia: moment of inertia about each edge (E,) [kg m^2].
        step: time step of each motion (P,) [s].
        threshold: angle at which the object has tipped [rad].

    Returns:
        Logarithms of parts of the base, between those of `BASES`, (P, T).
    """
    P, T = normal.shape
    angle, rate = np.zeros((P, len(BASES))), np.zeros((P, len(BASES)))
    peak, needed = np.zeros((P, len(BASES))), np.zeros((P, T))
    reach, dt = BASES[None, :, None] * apothems, step[:, None]
    for i in range(T):
        force = normal[:, i, None]
        excess = (moments[:, i, None] - reach * force[..., None]) / inertia
        turning = excess.max(axis=2) + force * height * angle / inertia.mean()
        rate = np.where((angle > 0.0) | (turning > 0.0), rate + dt * turning, 0.0)
        angle = angle + dt * rate
        rate, angle = np.where(angle > 0.0, rate, 0.0), np.clip(angle, 0.0, FAR)
        peak = np.maximum(peak, angle)
        needed[:, i] = _least(BASES, peak, threshold)
    return np.maximum.accumulate(needed, axis=1)


def _least(strengths: Array, peak: Array, threshold: float) -> Array:
    """Return the logarithm of the smallest strength whose largest movement (P, G) is at most a threshold, (P,).

    It is interpolated between two strengths. If the object does not move at all with the larger one, the movement is
    extrapolated from the two smaller ones.
    """
    last = len(strengths) - 1
    over = peak > threshold
    low = np.where(over.any(axis=1), last - np.argmax(over[:, ::-1], axis=1), -1)
    k = np.clip(low, 1, last - 1)
    rows, width = np.arange(len(peak)), np.diff(strengths)
    before, here, after = (peak[rows, k + j] for j in (-1, 0, 1))
    rest = after == 0.0
    fall = np.where(rest, before - here, here - after) / np.where(rest, width[k - 1], width[k])
    found = strengths[k] + (here - threshold) / np.maximum(fall, threshold)
    found = np.clip(found, strengths[k], strengths[k + 1])
    return np.asarray(np.log(np.where(low < 1, strengths[0], np.where(low == last, strengths[-1], found))))
