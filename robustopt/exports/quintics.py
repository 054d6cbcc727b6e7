"""Polynomials of fifth degree between samples, by which the controllers of ROS interpolate (q, qd, qdd).

With h the time between two samples and z = (t - t_i) / h, the polynomial is

    q + h qd z + h^2 qdd z^2 / 2 + c3 z^3 + c4 z^4 + c5 z^5,

and its jerk (6 c3 + 24 c4 z + 60 c5 z^2) / h^3 is the projection of the planned jerk onto quadratics. If the planned
jerk steps within h, this exceeds both of its values, however short h is.
"""

from __future__ import annotations

import numpy as np

from robustopt.arrays import Array
from robustopt.solvers.trajectory import Samples


def largest_jerk(samples: Samples) -> Array:
    """Return the largest jerk of each joint between samples that are interpolated by polynomials of fifth degree.

    Args:
        samples: the samples, at increasing times.

    Returns:
        Largest absolute jerk (n,) [rad/s^3 or m/s^3].
    """
    q, qd, qdd, h = samples.q, samples.qd, samples.qdd, np.diff(samples.t)[:, None]
    # differences from the parabola through the first of two samples
    position = q[1:] - q[:-1] - h * qd[:-1] - 0.5 * h**2 * qdd[:-1]
    speed = h * (qd[1:] - qd[:-1] - h * qdd[:-1])
    acceleration = h**2 * (qdd[1:] - qdd[:-1])
    c3 = 10.0 * position - 4.0 * speed + 0.5 * acceleration
    c4 = -15.0 * position + 7.0 * speed - acceleration
    c5 = 6.0 * position - 3.0 * speed + 0.5 * acceleration
    vertex = np.clip(np.divide(-c4, 5.0 * c5, out=np.zeros_like(c5), where=c5 != 0.0), 0.0, 1.0)
    jerk = np.stack([6.0 * c3 + 24.0 * c4 * z + 60.0 * c5 * z**2 for z in (0.0, 1.0, vertex)]) / h**3
    return np.asarray(np.abs(jerk).max(axis=(0, 1), initial=0.0))
