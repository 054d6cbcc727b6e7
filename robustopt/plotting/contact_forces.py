"""Planned forces of the contacts with the environment: feet on the floor, and a hand on a rail."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Polygon

from robustopt.arrays import Array
from robustopt.config import FEET
from robustopt.path.footsteps import footsteps
from robustopt.plotting.style import CONTACT_COLOURS, GREY, INK, PALE
from robustopt.solvers.contact_forces import ContactForces
from robustopt.solvers.plan import Plan

LEAST_LOAD = 0.01
"""A foot that carries less than this share of its largest force counts as unloaded (our choice)."""

COP_LABEL = "centre of pressure\nof the feet"


def forces_figure(plan: Plan, forces: ContactForces, title: str) -> Figure:
    """Draw the normal force of each contact and the centre of pressure of the feet over time.

    The centre of pressure is drawn together with the centre of mass and the edges of the loaded soles, along x and y.

    Args:
        plan: the plan.
        forces: its contact forces.
        title: title of the figure.

    Returns:
        The figure.
    """
    figure = Figure(figsize=(9, 7.2))
    load, along, across = figure.subplots(3, 1, sharex=True, height_ratios=[1.0, 1.0, 1.2])
    for name in forces.forces:
        load.plot(forces.t, forces.pressed(name)[:, 2], color=CONTACT_COLOURS[name], label=name.replace("_", " "))
    pressure, com = forces.center_of_pressure(), _center_of_mass(plan, forces)
    for axis, axes in enumerate((along, across)):
        _draw_soles(axes, forces, axis)
        axes.plot(forces.t, com[:, axis], color=GREY, label="centre of mass")
        axes.plot(forces.t, pressure[:, axis], color=INK, label=COP_LABEL)
    load.set_ylabel("normal force [N]")
    along.set_ylabel("x [m]")
    across.set_ylabel("y [m]")
    across.set_xlabel("time [s]")
    across.set_xlim(forces.t[0], forces.t[-1])
    for axes in (load, along):
        axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
    along.set_title("shaded: sole of each loaded foot, less the uncertainty of its contact points")
    figure.suptitle(f"{title}, planned contact forces", x=0.01, ha="left")
    return figure


def footprints_figure(plan: Plan, forces: ContactForces, title: str) -> Figure:
    """Draw the contact patches from above, with the paths of the centre of mass and of the centre of pressure.

    Args:
        plan: the plan.
        forces: its contact forces.
        title: title of the figure.

    Returns:
        The figure.
    """
    contacts = plan.problem.robot.contacts
    figure = Figure(figsize=(7, 5.4))
    axes = figure.subplots()
    for k, standing in enumerate(footsteps(plan.problem.config).places):
        for name, place in standing.items():
            label = name.replace("_", " ") if k == 0 else None
            _draw_patch(axes, place.world(contacts[name].points)[:, :2], CONTACT_COLOURS[name], label)
    pressure, com = forces.center_of_pressure(), _center_of_mass(plan, forces)
    axes.plot(pressure[:, 0], pressure[:, 1], color=INK, linewidth=0.9, label=COP_LABEL)
    axes.plot(com[:, 0], com[:, 1], color=GREY, linewidth=1.8, label="centre of mass")
    axes.set_aspect("equal")
    axes.set_xlabel("x [m]")
    axes.set_ylabel("y [m]")
    axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
    axes.set_title(f"{title}, from above")
    axes.margins(0.05)
    return figure


def _draw_soles(axes: Axes, forces: ContactForces, axis: int) -> None:
    """Shade the extent of each foot along a world axis while it carries a load."""
    for name in FEET:
        force = forces.pressed(name)[:, 2]
        loaded = force > LEAST_LOAD * force.max()
        extent = forces.points[name][..., axis]
        low, high, colour = extent.min(axis=1), extent.max(axis=1), CONTACT_COLOURS[name]
        axes.fill_between(forces.t, low, high, where=loaded.tolist(), color=colour, alpha=0.16, linewidth=0)


def _draw_patch(axes: Axes, points: Array, colour: str, label: str | None) -> None:
    axes.add_patch(Polygon(points, facecolor=PALE, edgecolor=colour, linewidth=1.2, label=label))
    axes.update_datalim(points)


def _center_of_mass(plan: Plan, forces: ContactForces) -> Array:
    """Return the centre of mass in the horizontal plane, (M, 2) [m]."""
    return np.asarray(footsteps(plan.problem.config).com(forces.s))
