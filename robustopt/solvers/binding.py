"""Limits that bind a plan: the names of the rows, of the velocity limits and of the jerk limits that it reaches."""

from __future__ import annotations

import numpy as np

from robustopt.arrays import Array, Flags
from robustopt.limits.names import LimitKind, LimitName
from robustopt.solvers.plan import Plan

ACTIVE_TOLERANCE = 1e-4
"""Fraction of its limit within which a row binds; solver tolerances are a hundredth of it."""

ACTIVE_WITH_JERK = 1e-3
"""The same for plans with jerk limits, whose solver ends at a gap of 1e-5 of the duration and leaves some slack."""

JERK_INSIDE = 1e-6
"""Part of an interval by which q''' is evaluated inside of its ends: it may jump at a grid point."""


def binding_rows(plan: Plan) -> Flags:
    """Return whether each row binds at either end of each interval, (P - 1, m).

    Args:
        plan: a plan with a timing.
    """
    return np.asarray(_binding_ends(plan).any(axis=0))


def active_tolerance(plan: Plan) -> float:
    """Return the fraction of its limit within which a row of a plan binds.

    Args:
        plan: a plan with a timing.
    """
    return ACTIVE_TOLERANCE if plan.steady else ACTIVE_WITH_JERK


def active(plan: Plan) -> tuple[tuple[str, ...], ...]:
    """Return the names of the limits that bind at either end of each interval, in the order of the columns.

    Args:
        plan: a plan with a timing.
    """
    problem, x = plan.problem, plan.x
    ends = _binding_ends(plan)
    tipping = _tipping(plan, ends)
    names: list[dict[str, None]] = [{} for _ in plan.u]
    for i, k in np.argwhere(ends.any(axis=0)):
        name = problem.row_names[k]
        names[i][tipping.get((i, name), name)] = None
    fast = (x >= problem.x_max * (1 - active_tolerance(plan))) & (problem.x_max > 0)
    for i in np.flatnonzero(problem.ds > 0):
        for k in (i, i + 1):
            if fast[k]:
                names[i][problem.x_max_names[k]] = None
    limits = problem.robot.limits.jerk
    if np.isfinite(limits).any():
        used = np.abs(joint_jerk(plan)) / limits
        for i, j in np.argwhere((used >= 1.0 - active_tolerance(plan)).any(axis=0)):
            names[i][LimitName(LimitKind.JERK, problem.robot.joint_names[j])] = None
    return tuple(tuple(row) for row in names)


def joint_jerk(plan: Plan) -> Array:
    """Return the jerk of the joints at the start and at the end of each interval, (2, P - 1, n) [rad/s^3 or m/s^3].

    It is q''' sd^3 + 3 q'' sd sdd + q' sddd, with the constant sddd of the interval; without jerk limits sddd is 0, but
    sdd jumps at the grid points.

    Args:
        plan: a plan with a timing.
    """
    problem, s = plan.problem, plan.s
    motion, ds, steps = problem.limits.motion, problem.ds, plan.steps
    speed = np.sqrt(plan.x)
    change = np.divide(plan.change, steps, out=np.zeros_like(steps), where=steps > 0.0)
    jerk = np.zeros((2, len(ds), problem.robot.n))
    for end, u in ((0, plan.u), (1, plan.u_end)):
        at = slice(end, len(s) - 1 + end)
        inside = s[at] + (1 - 2 * end) * JERK_INSIDE * ds
        q3 = problem.path.evaluate(inside, problem.piece[:-1], 3)
        v = speed[at, None]
        jerk[end] = q3 * v**3 + 3.0 * motion.q2[at] * v * u[:, None] + motion.q1[at] * change[:, None]
    return jerk * (ds > 0.0)[:, None]


def _binding_ends(plan: Plan) -> Flags:
    """Return whether each row binds at the start and at the end of each interval, (2, P - 1, m)."""
    problem, x = plan.problem, plan.x
    mean = plan.u + 0.5 * plan.change
    found = []
    for end, u in ((0, plan.u), (1, plan.u_end)):
        at = slice(end, len(x) - 1 + end)
        a, b, c = problem.a[at], problem.b[at], problem.c[at]
        used = a * u[:, None] + b * x[at, None] + c
        if not plan.steady:  # the rows of the mean
            used = np.maximum(used, a * mean[:, None] + b * x[at, None] + c)
        found.append(used > -active_tolerance(plan))
    return np.asarray(np.stack(found) & (problem.ds > 0)[:, None])


def _tipping(plan: Plan, ends: Flags) -> dict[tuple[int, str], LimitName]:
    """Return the intervals and names of slip limits that are tipping or peeling, with the name of the latter.

    A body that tips over a corner of its patch may also turn about this corner, so rows that bound slip bind together
    with those of tipping, and any of them may have bounded (u, x). Friction does not matter then.

    Args:
        plan: the plan.
        ends: whether each row binds at the start and at the end of each interval (2, P - 1, m).
    """
    found: dict[tuple[int, str], LimitName] = {}
    for limit in plan.problem.limits.contacts:
        slip, *others = limit.names
        if not others or others[0] == slip:
            continue
        slips = np.asarray(ends[:, :, [name == slip for name in plan.problem.row_names]].any(axis=2))
        free = slips.copy()
        for end, u in ((0, plan.u), (1, plan.u_end)):
            at = np.flatnonzero(slips[end])
            free[end, at] = ~limit.tips(u[at], plan.x[at + end], at + end, ACTIVE_TOLERANCE)
        for i in np.flatnonzero(slips.any(axis=0) & ~free.any(axis=0)):
            found[int(i), slip] = others[0]
    return found
