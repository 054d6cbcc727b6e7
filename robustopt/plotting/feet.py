"""Contact forces and centre of pressure of a robot on its feet, and of its hand on a rail."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Polygon
from numpy.typing import NDArray

from robustopt.config import FEET
from robustopt.path.footsteps import footsteps
from robustopt.plotting.style import CONTACT_COLOURS, GREY, INK, PALE
from robustopt.solvers.contact_forces import ContactForces, planned_forces

if TYPE_CHECKING:
    from robustopt.config import Config
    from robustopt.solvers.plan import Plan

Array = NDArray[np.float64]

LEAST_LOAD = 0.01
"""Share of the largest force on a contact below which it counts as in the air: friction and pressure of next to nothing
say nothing."""


def foot_utilisation(config: Config, plan: Plan) -> tuple[Array, dict[str, tuple[Array, Array]]]:
    """Times (M,) [s], and by contact the used part of the friction and of the sole with the planned forces, (M,).

    The first is |f_t| / (mu f_n), the second the larger share of its way from the middle of the sole to its edge that
    the centre of pressure has gone, along x or y; both are not a number while a foot is in the air.
    """
    forces, mu = planned_forces(plan), plan.problem.limits.uncertainty.worst_friction
    used = {}
    for name, loaded in _loaded(forces).items():
        pressed, axes = forces.pressed(name), forces.axes[name]
        points, normal = forces.points[name], forces.forces[name] @ axes[:, 2]
        with np.errstate(invalid="ignore", divide="ignore"):
            slip = np.hypot(pressed[:, 0], pressed[:, 1]) / (mu[name] * pressed[:, 2])
            pressure = (normal[:, :, None] * points).sum(axis=1) / pressed[:, 2:]
            flat = points @ axes[:, :2]
            middle, half = flat.mean(axis=1), 0.5 * np.ptp(flat, axis=1)
            tipping = np.abs((pressure @ axes[:, :2] - middle) / half).max(axis=1)
        used[name] = np.where(loaded, slip, np.nan), np.where(loaded, tipping, np.nan)
    return forces.t, used


def _loaded(forces: ContactForces) -> dict[str, NDArray[np.bool_]]:
    """Whether a contact carries enough to speak of its friction, (M,) by name."""
    normal = {name: forces.pressed(name)[:, 2] for name in forces.forces}
    return {name: force > LEAST_LOAD * force.max() for name, force in normal.items()}


def feet_figure(plan: Plan, title: str) -> Figure:
    """Normal force of each contact over time, and the centre of pressure of both feet beside the edges of the soles."""
    forces = planned_forces(plan)
    figure = Figure(figsize=(9, 7.2))
    load, along, across = figure.subplots(3, 1, sharex=True, height_ratios=[1.0, 1.0, 1.2])
    loaded = _loaded(forces)
    for name in forces.forces:
        load.plot(forces.t, forces.pressed(name)[:, 2], color=CONTACT_COLOURS[name], label=name.replace("_", " "))
    pressure, com = forces.center_of_pressure(), _center_of_mass(plan, forces)
    for axis, axes in enumerate((along, across)):
        for name in FEET:
            low, high = forces.points[name][..., axis].min(axis=1), forces.points[name][..., axis].max(axis=1)
            colour, shown = CONTACT_COLOURS[name], loaded[name].tolist()
            axes.fill_between(forces.t, low, high, where=shown, color=colour, alpha=0.16, linewidth=0)
        axes.plot(forces.t, com[:, axis], color=GREY, label="centre of mass")
        axes.plot(forces.t, pressure[:, axis], color=INK, label="centre of pressure\nof the feet")
    load.set_ylabel("normal force [N]")
    along.set_ylabel("x [m]")
    across.set_ylabel("y [m]")
    across.set_xlabel("time [s]")
    across.set_xlim(forces.t[0], forces.t[-1])
    for axes in (load, along):
        axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
    along.set_title("shaded: sole of each foot that is loaded, less what its contact points may be off")
    figure.suptitle(f"{title}, planned contact forces", x=0.01, ha="left")
    return figure


def footprints_figure(plan: Plan, title: str) -> Figure:
    """From above: soles and palm, and the ways of the centre of mass and of the centre of pressure of the feet."""
    forces, robot = planned_forces(plan), plan.problem.robot
    figure = Figure(figsize=(7, 5.4))
    axes = figure.subplots()
    for k, standing in enumerate(footsteps(plan.problem.config).places):
        for name, place in standing.items():
            label = name.replace("_", " ") if k == 0 else None
            _draw_sole(axes, place.world(robot.contacts[name].points)[:, :2], CONTACT_COLOURS[name], label)
    pressure, com = forces.center_of_pressure(), _center_of_mass(plan, forces)
    axes.plot(pressure[:, 0], pressure[:, 1], color=INK, linewidth=0.9, label="centre of pressure\nof the feet")
    axes.plot(com[:, 0], com[:, 1], color=GREY, linewidth=1.8, label="centre of mass")
    axes.set_aspect("equal")
    axes.set_xlabel("x [m]")
    axes.set_ylabel("y [m]")
    axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
    axes.set_title(f"{title}, from above")
    axes.margins(0.05)
    return figure


def _draw_sole(axes: Axes, points: Array, colour: str, label: str | None) -> None:
    axes.add_patch(Polygon(points, facecolor=PALE, edgecolor=colour, linewidth=1.2, label=label))
    axes.update_datalim(points)


def _center_of_mass(plan: Plan, forces: ContactForces) -> Array:
    """Centre of mass in the plane, (M, 2) [m]."""
    return np.asarray(footsteps(plan.problem.config).com(forces.s))
