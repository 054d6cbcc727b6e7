"""Utilisation of the contacts over time: the used part of the friction and of the contact patch."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure

from robustopt.arrays import Array, Flags
from robustopt.plotting.style import BLUE, GREEN, INK, ORANGE
from robustopt.solvers.contact_forces import ContactForces

FAR = 2.0
"""Larger utilisations are drawn here; an object that lifts off has an infinite one."""

LEAST_LOAD = 0.01
"""A contact that carries less than this share of its largest force counts as unloaded: its friction and its centre of
pressure mean nothing."""


class Utilisation(NamedTuple):
    """Utilisation of one contact at M instants, 1 at the limit.

    Attributes:
        t: Times, shape (M,), [s].
        slip: Used part of the friction, shape (M,), [1]; for a bridge, of the balance of all its contacts.
        tipping: Used part of the contact patch, shape (M,), [1]; not a number for a bridge.
    """

    t: Array
    slip: Array
    tipping: Array

    @property
    def shared(self) -> bool:
        """Return whether the contact shares its load with others, so that only their balance is known."""
        return bool(np.isnan(self.tipping).all())


def environment_utilisation(friction: Mapping[str, float], forces: ContactForces) -> dict[str, Utilisation]:
    """Return the utilisation of each contact with the environment by the planned forces.

    The used part of the friction is |f_t| / (mu f_n). The used part of the patch is the share of the way from its
    middle to its edge that the centre of pressure has gone, the larger one of x and y. Both are not a number while the
    contact carries no load.

    Args:
        friction: Coefficient of friction by contact.
        forces: The planned contact forces.

    Returns:
        The utilisation by contact.
    """
    used = {}
    for name, loaded in loaded_instants(forces).items():
        force = forces.pressed(name)
        with np.errstate(invalid="ignore", divide="ignore"):
            slip = np.hypot(force[:, 0], force[:, 1]) / (friction[name] * force[:, 2])
            tipping = _way_to_edge(forces, name)
        used[name] = Utilisation(forces.t, np.where(loaded, slip, np.nan), np.where(loaded, tipping, np.nan))
    return used


def loaded_instants(forces: ContactForces) -> dict[str, Flags]:
    """Return the instants at which each contact carries a load that counts, (M,) by contact."""
    normal = {name: forces.pressed(name)[:, 2] for name in forces.forces}
    return {name: force > LEAST_LOAD * force.max() for name, force in normal.items()}


def _way_to_edge(forces: ContactForces, name: str) -> Array:
    """Return the way of the centre of pressure as a share of the way from the middle of the patch to its edge, (M,)."""
    axes, points = forces.axes[name], forces.points[name]
    normal = forces.forces[name] @ axes[:, 2]
    pressure = (normal[:, :, None] * points).sum(axis=1) / forces.pressed(name)[:, 2:]
    flat = points @ axes[:, :2]
    middle, half = flat.mean(axis=1), 0.5 * np.ptp(flat, axis=1)
    return np.asarray(np.abs((pressure @ axes[:, :2] - middle) / half).max(axis=1))


def contacts_figure(
    utilisation: Mapping[str, Utilisation], title: str, worst: Mapping[str, float] | None = None
) -> Figure:
    """Draw the utilisation of each contact over time, one row per contact.

    Args:
        utilisation: Utilisation by contact.
        title: The title of the figure.
        worst: Largest utilisation over all uncertain parameters, by contact; it is named in the heading of the row.

    Returns:
        The figure.
    """
    figure = Figure(figsize=(9, 1.1 + 1.5 * len(utilisation)))
    rows = figure.subplots(len(utilisation), 1, sharex=True, sharey=True, squeeze=False)[:, 0]
    for axes, (name, used) in zip(rows, utilisation.items(), strict=True):
        axes.axhline(1.0, color=INK, linewidth=0.8)
        colour, label = (GREEN, "balance") if used.shared else (BLUE, "slip")
        axes.plot(used.t, np.minimum(used.slip, FAR), color=colour, label=label)
        if not used.shared:
            axes.plot(used.t, np.minimum(used.tipping, FAR), color=ORANGE, label="tipping")
        case = f", worst case {100 * worst[name]:.1f} %" if worst and name in worst else ""
        axes.set_title(name.replace("_", " ") + case)
    curves = np.concatenate([curve for used in utilisation.values() for curve in (used.slip, used.tipping)])
    rows[0].set_ylim(0, 1.08 * max(1.0, float(np.nanmax(np.minimum(curves, FAR)))))
    times = next(iter(utilisation.values())).t
    rows[0].set_xlim(times[0], times[-1])
    handles = {label: line for axes in rows for line, label in zip(*axes.get_legend_handles_labels(), strict=True)}
    figure.legend(list(handles.values()), list(handles), loc="outside lower left", ncols=len(handles))
    rows[-1].set_xlabel("time [s]")
    figure.supylabel("used part of the limit [1]", fontsize=9)
    figure.suptitle(title, x=0.01, ha="left")
    return figure
