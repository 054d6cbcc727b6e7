"""Speed and acceleration of the points with Cartesian limits over time."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from robustopt.arrays import Array
from robustopt.limits.names import LimitKind
from robustopt.plotting.joints import LIMIT, binding, draw_legend, draw_value
from robustopt.robot import LimitedPoint
from robustopt.solvers.plan import Plan
from robustopt.solvers.trajectory import Trajectory


def cartesian_figure(plan: Plan, title: str) -> Figure:
    """Draw the speed and the acceleration of every point with a Cartesian limit, without acceleration error.

    Args:
        plan: a plan with a timing, whose robot has such points.
        title: the title of the figure.

    Returns:
        The figure, with one row per quantity and one column per point.
    """
    points = plan.problem.robot.points
    figure = Figure(figsize=(max(1.2 + 2.6 * len(points), 6.5), 4.2))
    axes = figure.subplots(2, len(points), sharex=True, squeeze=False)
    for column, point in enumerate(points):
        times, speed, acceleration = point_norms(plan, point)
        for row, (kind, values, limit) in enumerate(
            (
                (LimitKind.CARTESIAN_SPEED, speed, point.speed),
                (LimitKind.CARTESIAN_ACCELERATION, acceleration, point.acceleration),
            )
        ):
            plot = axes[row, column]
            if np.isfinite(limit):
                plot.axhline(limit, **LIMIT)
            draw_value(plot, times, values, binding(plan, f"{point.name} {kind}"))
            plot.set_ylim(0.0, 1.08 * max(float(values.max()), limit if np.isfinite(limit) else 0.0))
        axes[0, column].set_title(point.name, loc="center")
        axes[1, column].set_xlabel("time [s]")
    axes[0, 0].set_ylabel("speed [m/s]")
    axes[1, 0].set_ylabel("acceleration [m/s²]")
    figure.suptitle(title, x=0.01, ha="left")
    draw_legend(figure, shrunk=False)
    return figure


def point_norms(plan: Plan, point: LimitedPoint) -> tuple[Array, Array, Array]:
    """Return times, speed and acceleration of a point at both ends of every interval that takes time, pauses included.

    Args:
        plan: a plan with a timing.
        point: the point, one of those of the robot.

    Returns:
        Times [s], speed [m/s] and acceleration [m/s^2], (M,) each.
    """
    (motion,) = (own for own in plan.problem.limits.track.points if own.point is point)
    times = Trajectory.from_plan(plan).times
    ends = np.flatnonzero(np.diff(times) > 0.0)[:, None] + (0, 1)
    u = np.stack([plan.u, plan.u_end], axis=1)[ends[:, 0]].ravel()
    x, first, second = plan.x[ends.ravel()], motion.first[ends.ravel()], motion.second[ends.ravel()]
    speed = np.linalg.norm(first, axis=1) * np.sqrt(x)
    acceleration = np.linalg.norm(first * u[:, None] + second * x[:, None], axis=1)
    return times[ends].ravel(), speed, acceleration
