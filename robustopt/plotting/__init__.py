"""Figures of a plan and its executions: phase plane, joints and contacts against their limits, what binds, trials.

Every figure is a `matplotlib.figure.Figure`; nothing here touches pyplot or the user's matplotlib settings.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from matplotlib.figure import Figure

from robustopt.certificate import interface_utilisation
from robustopt.plotting.bars import contacts_figure, shares_figure
from robustopt.plotting.executions import accelerations_figure, foot_contacts_figure, trials_figure
from robustopt.plotting.feet import feet_figure, foot_utilisation, footprints_figure
from robustopt.plotting.joints import joint_figures
from robustopt.plotting.learning import learning_figure
from robustopt.plotting.phase_plane import phase_plane
from robustopt.plotting.style import house_style, save
from robustopt.plotting.velocity_limit import velocity_limits
from robustopt.solvers.trajectory import binding_shares

if TYPE_CHECKING:
    from robustopt.certificate import Certificate
    from robustopt.config import Config
    from robustopt.robot import Robot
    from robustopt.simulation.trace import Trace
    from robustopt.solvers.plan import Plan

__all__ = [
    "contacts_figure",
    "figures",
    "house_style",
    "joint_figures",
    "learning_figure",
    "phase_plane",
    "shares_figure",
    "velocity_limits",
    "write_execution_figures",
    "write_figures",
    "write_learning_figure",
]


def write_figures(plan: Plan, config: Config, folder: Path, certificate: Certificate | None = None) -> list[Path]:
    """Write every figure of `plan` into `folder` as SVG and PNG, and return the files.

    The files depend on the arguments alone: the same plan gives the same bytes.

    Args:
        plan: the plan; one that was not found has its phase plane only.
        config: what it was planned from.
        folder: made if it is missing.
        certificate: of the plan; the figure of the contacts names its worst utilisations.
    """
    folder.mkdir(parents=True, exist_ok=True)
    with house_style():
        drawn = figures(plan, config, certificate)
        return [path for name, figure in drawn.items() for path in save(figure, folder, name)]


def write_execution_figures(config: Config, traces: Sequence[Trace], robot: Robot, folder: Path) -> list[Path]:
    """Write the figures of trials: the first trace is the one whose accelerations are drawn.

    Args:
        config: what was executed.
        traces: of one trial, or of several to stand side by side.
        robot: what the plan moved.
        folder: made if it is missing.
    """
    folder.mkdir(parents=True, exist_ok=True)
    with house_style():
        drawn = {
            "trials": trials_figure(traces, robot, config.name),
            "accelerations": accelerations_figure(traces[0], robot, config.name),
        }
        if config.walks:
            drawn["foot_contacts"] = foot_contacts_figure(traces, config.name)
        return [path for name, figure in drawn.items() for path in save(figure, folder, name)]


def write_learning_figure(
    records: Sequence[Mapping[str, Any]], target_rate: float, title: str, folder: Path
) -> list[Path]:
    """Write the figure of a learner's plans, see `learning_figure`, into a folder that is made if it is missing."""
    folder.mkdir(parents=True, exist_ok=True)
    with house_style():
        return save(learning_figure(records, target_rate, title), folder, "learning")


def figures(plan: Plan, config: Config, certificate: Certificate | None = None) -> dict[str, Figure]:
    """Figures of `write_figures` by file name without suffix; call it within `house_style`."""
    if plan.x.size == 0:
        return {"phase_plane": phase_plane(plan, f"{config.name}: no timing found")}
    title = f"{config.name}: {plan.duration:.3f} s"
    joints = joint_figures(plan, title)
    numbers = [""] if len(joints) == 1 else [f"_{k + 1}" for k in range(len(joints))]
    return {
        "phase_plane": phase_plane(plan, title),
        **{f"joints{number}": figure for number, figure in zip(numbers, joints, strict=True)},
        **_contacts(plan, config, title, certificate),
        "binding": shares_figure(binding_shares(plan), title),
    }


def _contacts(plan: Plan, config: Config, title: str, certificate: Certificate | None) -> dict[str, Figure]:
    """The figure of the contacts, if there are any."""
    worst = {} if certificate is None else _worst_utilisation(certificate)
    if config.walks:
        times, utilisation = foot_utilisation(config, plan)
        return {
            "feet": feet_figure(plan, title),
            "footprints": footprints_figure(plan, title),
            "contacts": contacts_figure(times, utilisation, title, worst, "planned forces at the least friction"),
        }
    if not config.objects:
        return {}
    times, utilisation = interface_utilisation(config, plan)
    return {"contacts": contacts_figure(times, utilisation, title, worst)}


def _worst_utilisation(certificate: Certificate) -> dict[str, float]:
    """Largest utilisation of every limit, by the name of the contact where it is one."""
    worst = {limit: 1.0 - min(margin.on_grid, margin.between) for limit, margin in certificate.margins.items()}
    return {limit.removeprefix("contact of "): value for limit, value in worst.items()}
