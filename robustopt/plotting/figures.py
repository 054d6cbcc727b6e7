"""All figures of a plan, of trials and of a learning run, drawn and written."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from matplotlib.figure import Figure

from robustopt.config import Config
from robustopt.plotting.cartesian import cartesian_figure
from robustopt.plotting.contact_forces import footprints_figure, forces_figure
from robustopt.plotting.executions import accelerations_figure, contact_trials_figure, trials_figure
from robustopt.plotting.joints import joint_figures
from robustopt.plotting.learning import learning_figure
from robustopt.plotting.phase_plane import phase_plane
from robustopt.plotting.shares import shares_figure
from robustopt.plotting.style import house_style, save
from robustopt.plotting.utilisation import contacts_figure
from robustopt.robot import Robot
from robustopt.runs.records import Iteration
from robustopt.simulation.trace import Trace
from robustopt.solvers.contact_forces import planned_forces
from robustopt.solvers.plan import Plan
from robustopt.solvers.trajectory import binding_shares


def write_figures(plan: Plan, config: Config, folder: Path) -> list[Path]:
    """Write every figure of a plan as SVG and PNG.

    The files depend on the arguments alone: the same plan gives the same bytes.

    Args:
        plan: a plan; an empty one has only its phase plane.
        config: the configuration of the plan.
        folder: where to write; it is made if it is missing.

    Returns:
        The files.
    """
    with house_style():
        return _write(figures(plan, config), folder)


def write_execution_figures(config: Config, traces: Sequence[Trace], robot: Robot, folder: Path) -> list[Path]:
    """Write the figures of trials as SVG and PNG.

    Args:
        config: the configuration that was executed.
        traces: one trial, or several to be shown side by side; the accelerations of the first are drawn.
        robot: the robot that executed the plan.
        folder: where to write; it is made if it is missing.

    Returns:
        The files.
    """
    with house_style():
        drawn = {
            "trials": trials_figure(traces, robot, config.name),
            "accelerations": accelerations_figure(traces[0], robot, config.name),
        }
        if traces[0].contacts:
            drawn["foot_contacts"] = contact_trials_figure(traces, config.name)
        return _write(drawn, folder)


def write_learning_figure(records: Sequence[Iteration], target_rate: float, title: str, folder: Path) -> list[Path]:
    """Write the figure of a learning run as SVG and PNG.

    Args:
        records: the plans in order, as in the summary of a run.
        target_rate: the success rate in question, in [0, 1].
        title: the title of the figure.
        folder: where to write; it is made if it is missing.

    Returns:
        The files.
    """
    with house_style():
        return _write({"learning": learning_figure(records, target_rate, title)}, folder)


def figures(plan: Plan, config: Config) -> dict[str, Figure]:
    """Draw every figure of a plan; call this within `house_style`.

    Args:
        plan: a plan; an empty one has only its phase plane.
        config: the configuration of the plan.

    Returns:
        The figures by file name without suffix.
    """
    if plan.x.size == 0:
        return {"phase_plane": phase_plane(plan, f"{config.name}: no timing found")}
    title = f"{config.name}: {plan.duration:.3f} s"
    joints = joint_figures(plan, title)
    cartesian = {"cartesian": cartesian_figure(plan, title)} if plan.problem.robot.points else {}
    numbers = [""] if len(joints) == 1 else [f"_{k + 1}" for k in range(len(joints))]
    return {
        "phase_plane": phase_plane(plan, title),
        **{f"joints{number}": figure for number, figure in zip(numbers, joints, strict=True)},
        **cartesian,
        **_contact_figures(plan, title),
        "binding": shares_figure(binding_shares(plan), title),
    }


def _contact_figures(plan: Plan, title: str) -> dict[str, Figure]:
    """Draw the figures of the contacts that the plan has: with the environment, and of all held bodies."""
    drawn: dict[str, Figure] = {}
    if plan.problem.robot.contacts:
        forces = planned_forces(plan)
        drawn = {"feet": forces_figure(plan, forces, title), "footprints": footprints_figure(plan, forces, title)}
    if plan.problem.limits.contacts:
        drawn["contacts"] = contacts_figure(plan, title)
    return drawn


def _write(drawn: Mapping[str, Figure], folder: Path) -> list[Path]:
    folder.mkdir(parents=True, exist_ok=True)
    return [path for name, figure in drawn.items() for path in save(figure, folder, name)]
