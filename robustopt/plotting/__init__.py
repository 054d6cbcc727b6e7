"""Figures of a plan: phase plane, joints against their limits, contacts against theirs, and what binds.

Every figure is a `matplotlib.figure.Figure`; nothing here touches pyplot or the user's matplotlib settings.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from matplotlib.figure import Figure

from robustopt.plotting.bars import Utilisation, contacts_figure, shares_figure
from robustopt.plotting.joints import joint_figures
from robustopt.plotting.phase_plane import phase_plane
from robustopt.plotting.style import house_style, save
from robustopt.plotting.velocity_limit import velocity_limits
from robustopt.trajectory import binding_shares

if TYPE_CHECKING:
    from robustopt.config import Config
    from robustopt.timescaling.plan import Plan

__all__ = [
    "Utilisation",
    "contacts_figure",
    "figures",
    "house_style",
    "joint_figures",
    "phase_plane",
    "shares_figure",
    "velocity_limits",
    "write_figures",
]


def write_figures(
    plan: Plan,
    config: Config,
    folder: Path,
    utilisation: Mapping[str, Utilisation] | None = None,
) -> list[Path]:
    """Write every figure of `plan` into `folder` as SVG and PNG, and return the files.

    The files depend on the arguments alone: the same plan gives the same bytes.

    Args:
        plan: the plan; one that was not found has its phase plane only.
        config: what it was planned from.
        folder: made if it is missing.
        utilisation: used part of what each contact interface can bear, by interface; without it no such figure.
    """
    folder.mkdir(parents=True, exist_ok=True)
    with house_style():
        drawn = figures(plan, config, utilisation or {})
        return [path for name, figure in drawn.items() for path in save(figure, folder, name)]


def figures(plan: Plan, config: Config, utilisation: Mapping[str, Utilisation]) -> dict[str, Figure]:
    """Figures of `write_figures` by file name without suffix; call it within `house_style`."""
    if plan.x.size == 0:
        return {"phase_plane": phase_plane(plan, f"{config.name}: no timing found")}
    title = f"{config.name}: {plan.duration:.3f} s"
    joints = joint_figures(plan, title)
    numbers = [""] if len(joints) == 1 else [f"_{k + 1}" for k in range(len(joints))]
    contacts = {"contacts": contacts_figure(utilisation, title)} if utilisation else {}
    return {
        "phase_plane": phase_plane(plan, title),
        **{f"joints{number}": figure for number, figure in zip(numbers, joints, strict=True)},
        **contacts,
        "binding": shares_figure(binding_shares(plan), title),
    }
