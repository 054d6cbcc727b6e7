"""Results as pandas tables, and as the pages that notebooks show."""

from __future__ import annotations

from collections.abc import Iterator
from html import escape

import pandas as pd

from robustopt.exports.tables import columns
from robustopt.runs.campaign import Learned
from robustopt.runs.execution_run import sentence
from robustopt.runs.learning_summary import row_columns
from robustopt.runs.learning_summary import sentence as learned_sentence
from robustopt.simulation import Executions, TrialOutcome
from robustopt.solvers import Plan, Status
from robustopt.solvers.trajectory import Trajectory

MOST_ROWS, MOST_COLUMNS = 10, 22
"""Rows and columns of a table that a notebook shows; the plan of six joints has 22 columns."""


def plan_frame(plan: Plan) -> pd.DataFrame:
    """Return a plan at its grid points, see `Plan.to_frame`.

    Args:
        plan: the plan.
    """
    heads, rows = columns(Trajectory.from_plan(plan).at_gridpoints(), plan.problem.robot.joint_names)
    return pd.DataFrame(rows, columns=heads)


def executions_frame(executions: Executions) -> pd.DataFrame:
    """Return one row per trial: its outcome, the outcome of every object, and the actual frictions and masses.

    Args:
        executions: the trials.
    """
    return pd.DataFrame([dict(_outcome(outcome)) for outcome in executions.outcomes], columns=_heads(executions))


def _heads(executions: Executions) -> list[str]:
    head = ["trial", "status", "what", "against", "t", "s", "tracking_error", "torque"]
    return list(dict(_outcome(executions.outcomes[0]))) if executions.outcomes else head


def _outcome(outcome: TrialOutcome) -> Iterator[tuple[str, object]]:
    yield from (("trial", outcome.trial), ("status", outcome.status.value), ("what", outcome.what))
    yield ("against", outcome.against)
    yield from (("t", outcome.time), ("s", outcome.s))
    yield from (("tracking_error", outcome.tracking_error), ("torque", outcome.torque))
    for name, item in outcome.objects.items():
        yield from ((f"status_{name}", item.status.value), (f"t_{name}", item.time))
        yield from ((f"{kind}_{name}", getattr(item, kind)) for kind in ("slip", "tilt", "drop", "lift"))
    rubbing = [name for name in outcome.objects if name in outcome.friction]
    yield from ((f"friction_{name}", outcome.friction[name]) for name in dict.fromkeys([*rubbing, *outcome.friction]))
    yield from ((f"mass_{name}", mass) for name, mass in outcome.mass.items())
    yield from ((f"force_{name}", force) for name, force in outcome.force.items())


def learned_frame(learned: Learned) -> pd.DataFrame:
    """Return one row per plan that a learner tried, see `Learned.to_frame`.

    Args:
        learned: the result of the learner.
    """
    return pd.DataFrame([row_columns(learned, row) for row in learned.rows])


# Pages ----------------------------------------------------------------------------------------------------


def plan_html(plan: Plan) -> str:
    """Return a plan as HTML for a notebook.

    Args:
        plan: the plan.
    """
    if plan.status is not Status.SOLVED:
        return _page(plan.message)
    return _page(f"{plan.problem.config.name}: {plan.duration:.4f} s, planned by {plan.method}", plan_frame(plan))


def executions_html(executions: Executions) -> str:
    """Return executions as HTML for a notebook.

    Args:
        executions: the trials.
    """
    return _page(sentence(executions), executions_frame(executions))


def learned_html(learned: Learned) -> str:
    """Return the result of a learner as HTML for a notebook.

    Args:
        learned: the result of the learner.
    """
    text = learned_sentence(learned) if learned.finished else f"{learned.state.executed:,} executions so far."
    return _page(text, learned_frame(learned))


def _page(text: str, frame: pd.DataFrame | None = None) -> str:
    if frame is None:
        return f"<p>{escape(text)}</p>\n"
    table = frame.to_html(max_rows=MOST_ROWS, max_cols=MOST_COLUMNS, index=False, float_format="{:.4g}".format)
    return f'<p>{escape(text)}</p>\n<div style="overflow-x: auto">{table}</div>'
