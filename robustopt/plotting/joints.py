"""Joint position, velocity, acceleration and torque over time against their limits."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from robustopt.arrays import Array, Flags, Indices
from robustopt.limits.torque import torque_scale
from robustopt.plotting.style import BLUE, INK, VERMILLION, joint_unit
from robustopt.solvers.binding import joint_jerk
from robustopt.solvers.contact_forces import planned_forces
from robustopt.solvers.plan import Plan
from robustopt.solvers.trajectory import Trajectory, joint_motion

JOINTS_PER_FIGURE = 7
VALUE: dict[str, Any] = {"color": BLUE, "linewidth": 1.4}
BINDING: dict[str, Any] = {"color": VERMILLION, "linewidth": 2.4}
LIMIT: dict[str, Any] = {"color": INK, "linewidth": 0.8}
ROBUST_LIMIT: dict[str, Any] = {"color": INK, "linewidth": 0.9, "linestyle": ":"}
UNITS = {"position": "rad", "velocity": "rad/s", "acceleration": "rad/s²", "jerk": "rad/s³", "torque": "N m"}


@dataclass(frozen=True)
class Quantity:
    """One quantity of n joints at M instants, the two ends of every interval.

    Attributes:
        name: "position", "velocity", "acceleration", "jerk" or "torque", as in the names of the limits.
        value: nominal values, shape (M, n).
        lower: lower limits, shape (n,).
        upper: upper limits, shape (n,).
        robust_lower: lower limits tightened by the uncertain parameters, shape (M, n), or None.
        robust_upper: upper limits tightened by the uncertain parameters, shape (M, n), or None.
    """

    name: str
    value: Array
    lower: Array
    upper: Array
    robust_lower: Array | None = None
    robust_upper: Array | None = None

    def shrunk_limits(self, joint: int) -> list[Array]:
        """Return the tightened limits of a joint, (M,) each, that differ from its limits most of the time.

        When a joint reverses, dry friction takes both signs, which tightens the torque limits for a moment only.
        """
        pairs = ((self.robust_lower, self.lower[joint]), (self.robust_upper, self.upper[joint]))
        shown = [(robust[:, joint], limit) for robust, limit in pairs if robust is not None]
        return [robust for robust, limit in shown if not np.isclose(np.median(robust), limit)]


def joint_figures(plan: Plan, title: str) -> list[Figure]:
    """Draw position, velocity, acceleration and torque of the joints over time against their limits.

    Solid lines are the limits, dotted ones the limits tightened by the uncertain parameters.

    Args:
        plan: the plan.
        title: the title of each figure.

    Returns:
        Figures with one row per quantity and one column per joint, `JOINTS_PER_FIGURE` joints each.
    """
    times, quantities = joint_quantities(plan)
    robot = plan.problem.robot
    driven = list(range(robot.n)[robot.motors])
    groups = [driven[k : k + JOINTS_PER_FIGURE] for k in range(0, len(driven), JOINTS_PER_FIGURE)]
    return [_figure(plan, times, quantities, group, title) for group in groups]


def joint_quantities(plan: Plan) -> tuple[Array, list[Quantity]]:
    """Return the quantities at both ends of every interval that takes time, pauses included.

    Without jerk limits, accelerations and torques jump at the grid points; each point has the value before and the
    value after it.

    Args:
        plan: the plan.

    Returns:
        Times, shape (M,), [s], and position, velocity, acceleration, jerk if it is limited, and torque.
    """
    trajectory = Trajectory.from_plan(plan)
    moving = np.flatnonzero(np.diff(trajectory.times) > 0)
    points = np.stack([moving, moving + 1], axis=1).ravel()
    t, s, sd = trajectory.times[points], trajectory.s[points], trajectory.sd[points]
    sdd = np.repeat(trajectory.sdd[moving], 2)
    sdd[1::2] += trajectory.sddd[moving] * np.diff(trajectory.times)[moving]
    motion = joint_motion(trajectory.path, trajectory.piece[points], t, s, sd, sdd)
    limits = plan.problem.robot.limits
    quantities = [
        Quantity("position", motion.q, limits.lower, limits.upper),
        Quantity("velocity", motion.qd, -limits.velocity, limits.velocity),
        _acceleration(plan, motion.qdd),
    ]
    if np.isfinite(limits.jerk).any():
        jerk = joint_jerk(plan)[:, moving].swapaxes(0, 1).reshape(len(points), -1)
        quantities.append(Quantity("jerk", jerk, -limits.jerk, limits.jerk))
    if plan.problem.robot.contacts:
        planned = planned_forces(plan).torque[1:-1]
        quantities.append(Quantity("torque", planned, -limits.torque, limits.torque))
    else:
        quantities.append(_torque(plan, points, sdd, sd**2))
    return t, quantities


def _acceleration(plan: Plan, value: Array) -> Quantity:
    """Return the joint acceleration, its limits tightened by the acceleration error."""
    limit = plan.problem.robot.limits.acceleration
    middle, radius = plan.problem.limits.uncertainty.error.arrays
    lower, upper = (
        np.broadcast_to(-limit - middle + radius, value.shape),
        np.broadcast_to(limit - middle - radius, value.shape),
    )
    return Quantity("acceleration", value, -limit, limit, lower, upper)


def _torque(plan: Plan, points: Indices, u: Array, x: Array) -> Quantity:
    """Return the nominal joint torque with load and joint friction, and its limits tightened by all parameters.

    `points` (M,) holds the grid point of each value, starts and ends of intervals in turn; `u` and `x` (M,) are its sdd
    and sd^2.
    """
    limit = plan.problem.robot.limits.torque
    value = np.empty((len(points), len(limit)))
    for end in (0, 1):
        u_there, x_there = np.zeros(len(plan.s)), np.zeros(len(plan.s))
        u_there[points[end::2]], x_there[points[end::2]] = u[end::2], x[end::2]
        value[end::2] = plan.problem.torques(u_there, x_there)[points[end::2]]
    scale = np.tile(torque_scale(limit), 2)
    most, least = np.split((plan.problem.limits.torque.sides(u, x, points) + 1.0) * scale, 2, axis=1)
    return Quantity("torque", value, -limit, limit, -limit + (value + least), limit - (most - value))


def _figure(plan: Plan, times: Array, quantities: list[Quantity], joints: Sequence[int], title: str) -> Figure:
    figure = Figure(figsize=(max(1.2 + 1.9 * len(joints), 6.5), 1.95 * len(quantities)))
    axes = figure.subplots(len(quantities), len(joints), sharex=True, squeeze=False)
    names, hinges = plan.problem.robot.joint_names, plan.problem.robot.hinges[list(joints)]
    for row, quantity in enumerate(quantities):
        for column, joint in enumerate(joints):
            _draw(axes[row, column], times, quantity, joint, binding(plan, f"{names[joint]} {quantity.name}"))
        axes[row, 0].set_ylabel(f"{quantity.name} [{joint_unit(UNITS[quantity.name], hinges)}]")
    for column, joint in enumerate(joints):
        axes[0, column].set_title(names[joint], loc="center")
        axes[-1, column].set_xlabel("time [s]")
    figure.suptitle(title, x=0.01, ha="left")
    draw_legend(figure, shrunk=any(quantity.shrunk_limits(joint) for quantity in quantities for joint in joints))
    return figure


def draw_legend(figure: Figure, shrunk: bool) -> None:
    """Draw the legend as one line below the axes.

    Args:
        figure: the figure.
        shrunk: whether there are tightened limits.
    """
    styles = {"plan": VALUE, "plan, limit binds": BINDING, "limit": LIMIT}
    if shrunk:
        styles["limit, tightened by the uncertainty"] = ROBUST_LIMIT
    handles = [Line2D([], [], **style) for style in styles.values()]
    figure.legend(handles, list(styles), loc="outside lower left", ncols=len(styles))


def binding(plan: Plan, limit: str) -> Flags:
    """Return whether a limit binds on each interval that takes time, pauses included, (M/2,).

    Args:
        plan: the plan.
        limit: name of the limit.
    """
    moves = np.diff(Trajectory.from_plan(plan).times) > 0
    return np.array([limit in active for active in plan.active], dtype=bool)[moves]


def _draw(axes: Axes, times: Array, quantity: Quantity, joint: int, binds: Flags) -> None:
    value = quantity.value[:, joint]
    for limit in (quantity.lower[joint], quantity.upper[joint]):
        if np.isfinite(limit):
            axes.axhline(limit, **LIMIT)
    for shrunk in quantity.shrunk_limits(joint):
        axes.plot(times, shrunk, **ROBUST_LIMIT)
    draw_value(axes, times, value, binds)
    _scale_to_limits(axes, float(quantity.lower[joint]), float(quantity.upper[joint]), value)


def draw_value(axes: Axes, times: Array, value: Array, binds: Flags) -> None:
    """Draw a quantity over time, stronger on the intervals on which its limit binds.

    Args:
        axes: the axes.
        times: times of both ends of every interval (M,) [s].
        value: values of the quantity (M,).
        binds: whether the limit binds on each interval (M/2,).
    """
    axes.plot(times, value, **VALUE)
    intervals = np.stack([times, value], axis=1).reshape(-1, 2, 2)
    axes.add_collection(LineCollection(list(intervals[binds]), capstyle="butt", zorder=3, **BINDING))
    axes.set_xlim(times[0], times[-1])
    axes.locator_params(axis="x", nbins=4)


def _scale_to_limits(axes: Axes, lower: float, upper: float, value: Array) -> None:
    """Show the limits and all values beyond them, with ticks at the limits, and at zero unless it is close to one."""
    span = upper - lower
    if not np.isfinite(span):
        axes.locator_params(axis="y", nbins=3)
        return
    ticks = [lower, upper] + [0.0] * (lower + 0.15 * span < 0.0 < upper - 0.15 * span)
    axes.set_ylim(min(lower, float(value.min())) - 0.08 * span, max(upper, float(value.max())) + 0.08 * span)
    axes.set_yticks(ticks, [f"{tick:.3g}".replace("-", "\N{MINUS SIGN}") for tick in ticks])
