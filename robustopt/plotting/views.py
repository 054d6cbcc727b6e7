"""Figures that results draw of themselves: `Plan.plot`, `Executions.plot`, `Learned.plot`."""

from __future__ import annotations

from matplotlib.figure import Figure

from robustopt.plotting.learning import learning_figure
from robustopt.plotting.phase_plane import phase_plane
from robustopt.plotting.shares import shares_figure
from robustopt.plotting.style import house_style
from robustopt.runs.campaign import Learned
from robustopt.runs.learning_summary import row_record, target_rate
from robustopt.simulation import Executions
from robustopt.solvers import Plan, Status


def plan_figure(plan: Plan) -> Figure:
    """Return the phase plane of a plan."""
    name = plan.problem.config.name
    found = f"{plan.duration:.3f} s" if plan.status is Status.SOLVED else "no timing found"
    with house_style():
        return phase_plane(plan, f"{name}: {found}")


def executions_figure(executions: Executions) -> Figure:
    """Return bars of the share of trials that ended in each status."""
    total = max(len(executions.outcomes), 1)
    shares = {status.value: count / total for status, count in executions.counts.items()}
    with house_style():
        title = f"{executions.successes:,} of {len(executions.outcomes):,} trials succeeded"
        return shares_figure(shares, title, of="trials")


def learned_figure(learned: Learned) -> Figure:
    """Return the figure of a learner's plans, see `learning_figure`."""
    rows = [row_record(learned, row) for row in learned.rows]
    title = f"{learned.config.name}: {learned.learner.name}"
    with house_style():
        return learning_figure(rows, target_rate(learned.settings), title)
