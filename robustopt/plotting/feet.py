"""Contact forces and centre of pressure of a robot on its feet."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from numpy.typing import NDArray

from robustopt.contact_forces import ContactForces, planned_forces
from robustopt.path.walking_path import WalkingPath
from robustopt.plotting.style import BLUE, GREEN, GREY, INK, PALE, VERMILLION
from robustopt.problem.uncertainty import friction
from robustopt.robot.walker import Walker

if TYPE_CHECKING:
    from robustopt.config import Config
    from robustopt.timescaling.plan import Plan

Array = NDArray[np.float64]

COLOURS = {"left_foot": BLUE, "right_foot": VERMILLION}

LEAST_LOAD = 0.01
"""Share of the weight below which a foot counts as in the air: friction and pressure of next to nothing say nothing."""


def foot_utilisation(config: Config, plan: Plan) -> tuple[Array, dict[str, tuple[Array, Array]]]:
    """Times (M,) [s], and by foot the used part of the friction and of the sole with the planned forces, (M,).

    The first is |f_t| / (mu f_z), the second the larger share of its way from the middle of the sole to its edge that
    the centre of pressure has gone, along x or y; both are not a number while the foot is in the air.
    """
    forces, mu = planned_forces(plan), friction(config)
    used = {}
    for name, loaded in _loaded(plan, forces).items():
        total, pressure = forces.total(name), forces.center_of_pressure(name)
        points = forces.points[name][..., :2]
        middle, half = points.mean(axis=1), 0.5 * np.ptp(points, axis=1)
        with np.errstate(invalid="ignore", divide="ignore"):
            slip = np.hypot(total[:, 0], total[:, 1]) / (mu[name] * total[:, 2])
        tipping = np.abs((pressure - middle) / half).max(axis=1)
        used[name] = np.where(loaded, slip, np.nan), np.where(loaded, tipping, np.nan)
    return forces.t, used


def _loaded(plan: Plan, forces: ContactForces) -> dict[str, NDArray[np.bool_]]:
    """Whether a foot carries enough to speak of its friction, (M,) by name."""
    robot = plan.problem.robot
    assert isinstance(robot, Walker)
    least = LEAST_LOAD * robot.mass * 9.81
    return {name: forces.total(name)[:, 2] > least for name in forces.forces}


def feet_figure(plan: Plan, title: str) -> Figure:
    """Normal force of each foot over time, and the centre of pressure of all contacts beside the edges of the soles."""
    forces = planned_forces(plan)
    figure = Figure(figsize=(9, 7.2))
    load, along, across = figure.subplots(3, 1, sharex=True, height_ratios=[1.0, 1.0, 1.2])
    loaded = _loaded(plan, forces)
    for name, colour in COLOURS.items():
        load.plot(forces.t, forces.total(name)[:, 2], color=colour, label=name.replace("_", " "))
    pressure, com = forces.center_of_pressure(), _center_of_mass(plan, forces)
    for axis, axes in enumerate((along, across)):
        for name, colour in COLOURS.items():
            low, high = forces.points[name][..., axis].min(axis=1), forces.points[name][..., axis].max(axis=1)
            axes.fill_between(forces.t, low, high, where=loaded[name].tolist(), color=colour, alpha=0.16, linewidth=0)
        axes.plot(forces.t, com[:, axis], color=GREY, label="centre of mass")
        axes.plot(forces.t, pressure[:, axis], color=INK, label="centre of pressure")
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
    """The floor from above: soles, and the ways of the centre of mass and of the centre of pressure."""
    forces, path, robot = planned_forces(plan), plan.problem.path, plan.problem.robot
    assert isinstance(path, WalkingPath)
    assert isinstance(robot, Walker)
    figure = Figure(figsize=(7, 5.4))
    axes = figure.subplots()
    for standing in path.footsteps.places:
        for name, place in standing.items():
            _draw_sole(axes, robot.feet[name].points[:, :2] + place, COLOURS[name])
    pressure, com = forces.center_of_pressure(), _center_of_mass(plan, forces)
    axes.plot(pressure[:, 0], pressure[:, 1], color=INK, linewidth=0.9, label="centre of pressure")
    axes.plot(com[:, 0], com[:, 1], color=GREEN, linewidth=1.8, label="centre of mass")
    axes.set_aspect("equal")
    axes.set_xlabel("x [m]")
    axes.set_ylabel("y [m]")
    axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
    axes.set_title(f"{title}, from above")
    axes.margins(0.05)
    return figure


def _draw_sole(axes: Axes, points: Array, colour: str) -> None:
    corner, size = points.min(axis=0), np.ptp(points, axis=0)
    axes.add_patch(Rectangle((corner[0], corner[1]), size[0], size[1], facecolor=PALE, edgecolor=colour, linewidth=1.2))
    axes.update_datalim(points)


def _center_of_mass(plan: Plan, forces: ContactForces) -> Array:
    """Centre of mass in the plane, (M, 2) [m]."""
    path = plan.problem.path
    assert isinstance(path, WalkingPath)
    return np.asarray(path.footsteps.com(forces.s))
