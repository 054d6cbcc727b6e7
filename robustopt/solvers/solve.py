"""Solvers: one contract, same optimum.

`solve` repeats an outer solver (`reachability` or `ipopt`) until three things hold that its rows may lack: contact
forces exist at both ends of every interval for every value of the parameters (inner programs, whose duals become rows);
where contacts share the load, some of these forces keep the joint torques within their limits (likewise); and the
viscous torque, which the rows have linearised, is within its limit and the linearisation has settled.
"""

from __future__ import annotations

import time
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from robustopt.limits import TimeScalingProblem
from robustopt.limits.names import LimitKind
from robustopt.solvers.plan import Plan, Status, binding_rows, failed_plan, interval_ends
from robustopt.solvers.reachability import solve_reachability

if TYPE_CHECKING:  # HiGHS is loaded only where a program is needed
    from robustopt.solvers.force_program import ForceProgram
    from robustopt.solvers.sharing import SharingSearch

__all__ = ["Plan", "Status", "solve", "standstill"]

MOST_ROUNDS = 60
"""Rounds of rows and relinearisations; the waiter tasks take about ten."""

TORQUE_TOLERANCE = 1e-7
"""Fraction of a torque limit by which the relinearised torque may exceed it."""

RETREAT, MOST_RETREATS = 0.2, 10
"""A tangent about too fast a plan may forbid every slower one: then the reference is scaled down until one is left."""

NEAR_TORQUE = 1e-3
"""A plan that comes this close to a torque limit, as a fraction of it, is linearised about: friction may help it."""

SAME_DURATION = 1e-6
"""Relinearising the viscous torque ends when it no longer changes the duration by this fraction."""


def solve(problem: TimeScalingProblem, method: str | None = None) -> Plan:
    """The plan of a problem by the configured method, or the named one (`ipopt` or `reachability`)."""
    began = time.perf_counter()
    method = method or problem.config.solver.method
    if method == "reachability" and problem.config.solver.cost != "time" and problem.config.solver.weight > 0:
        return failed_plan(
            problem, Status.FAILED, method, "reachability minimises time only; use solver.method: ipopt", -1, {}
        )
    at_rest = standstill(problem)
    if at_rest >= 0:
        return failed_plan(problem, Status.INFEASIBLE, method, Status.INFEASIBLE.sentence, at_rest, {})
    if method == "ipopt":
        problem = problem.with_facets(tuple(np.zeros_like(rows[:0]) for rows in problem.facets))
    programs: dict[int, ForceProgram] = {}
    shared: list[SharingSearch] = []
    figures = {"rounds": 0.0, "inner_programs": 0.0, "inner_seconds": 0.0, "relinearisations": 0.0}
    plan, before = _outer(problem, method, None), np.inf
    for _ in range(MOST_ROUNDS):
        figures["rounds"] += 1
        if plan.status is not Status.SOLVED:
            break
        tighter = _with_missing_rows(plan, method, programs, figures)
        if tighter is None:
            tighter = _with_shared_rows(plan, shared, figures)
        if tighter is None:
            tighter = _relinearised(plan, before)
            figures["relinearisations"] += tighter is not None
        if tighter is None:
            break
        before, plan = plan.duration, _outer(tighter, method, plan.x)
        for _ in range(MOST_RETREATS):
            if plan.status is not Status.INFEASIBLE or np.isnan(plan.problem.reference).all():
                break
            plan = _outer(plan.problem.with_reference(RETREAT * plan.problem.reference), method, None)
    else:
        plan = failed_plan(
            plan.problem, Status.ITERATION_LIMIT, method, Status.ITERATION_LIMIT.sentence, -1, plan.statistics
        )
    if plan.status is Status.INFEASIBLE and (at_rest := standstill(plan.problem)) >= 0:
        plan = replace(plan, stuck=at_rest)
    figures["solve_seconds"] = time.perf_counter() - began
    return replace(plan, statistics={**plan.statistics, **figures})


def standstill(problem: TimeScalingProblem) -> int:
    """First grid point where the robot must rest but cannot, for some value of the parameters; -1 if there is none."""
    slack = problem.c.max(axis=1, initial=-1.0)
    wrong = problem.rest & ((slack > 1e-9) | ~problem.feasible)
    return int(np.argmax(wrong)) if wrong.any() else -1


def _outer(problem: TimeScalingProblem, method: str, guess: np.ndarray | None) -> Plan:
    if method == "reachability":
        return solve_reachability(problem)
    from robustopt.solvers.ipopt import solve_ipopt

    return solve_ipopt(problem, guess)


def _with_missing_rows(
    plan: Plan, method: str, programs: dict[int, ForceProgram], figures: dict[str, float]
) -> TimeScalingProblem | None:
    """Return the problem with the contact rows that its plan violates, None if there are none."""
    limits = list(plan.problem.limits.contacts)
    incomplete = [k for k, limit in enumerate(limits) if method == "ipopt" or not limit.system.complete]
    if not incomplete:
        return None
    from robustopt.solvers.force_program import ForceProgram, missing_rows, overlooked_rows

    began = time.perf_counter()
    ends = interval_ends(plan.problem, plan.x, plan.u)
    found = 0
    for second_look in (False, True):
        for k in incomplete:
            limit = limits[k]
            if k not in programs:
                programs[k] = ForceProgram(limit)
            u, x, points = (values[limit.holds_at(ends[2])] for values in ends)
            if second_look:
                rows, solved = overlooked_rows(limit, programs[k], points, u, x)
            else:
                rows, _, solved = missing_rows(limit, programs[k], points, u, x)
            figures["inner_programs"] += solved
            limits[k] = limit.with_more(*rows)
            found += len(rows[0])
        if found:
            break
    figures["inner_seconds"] += time.perf_counter() - began
    return plan.problem.with_contacts(limits) if found else None


def _with_shared_rows(plan: Plan, search: list[SharingSearch], figures: dict[str, float]) -> TimeScalingProblem | None:
    """Return the problem with the torque rows that its plan violates for shared wrenches, None if there are none."""
    problem, torque = plan.problem, plan.problem.limits.torque
    if torque.sharing is None or not _contacts_count(problem):
        return None
    from robustopt.solvers.sharing import SharingSearch

    began = time.perf_counter()
    u, x, points = interval_ends(problem, plan.x, plan.u)
    if not search:
        search.append(SharingSearch(problem.counts(2 * problem.robot.n + np.arange(problem.robot.n))))
    rows, solved = search[0].missing_rows(torque.sharing, points, u, x)
    figures["inner_programs"] += solved
    figures["inner_seconds"] += time.perf_counter() - began
    return problem.with_torque(torque.with_rows(rows)) if rows else None


def _contacts_count(problem: TimeScalingProblem) -> bool:
    """Return whether all limits of all contacts count: without them no forces share a wrench."""
    return problem.kept is None or all(problem.kept.issuperset(limit.names) for limit in problem.limits.contacts)


def _relinearised(plan: Plan, before: float) -> TimeScalingProblem | None:
    """The problem with the viscous torque linearised about its plan, None if the plan holds the exact torque already.

    before: duration of the plan that the linearisation was about, which must have settled [s]
    """
    problem = plan.problem
    if not problem.limits.torque.viscous.any():
        return None
    excess = problem.torque_excess(*interval_ends(problem, plan.x, plan.u))
    if np.isnan(problem.reference).all():
        torque = [name.kind == LimitKind.TORQUE for name in problem.row_names]
        binds = binding_rows(problem, plan.x, plan.u)[:, torque].any()
        return problem.with_reference(plan.x) if binds or excess > -NEAR_TORQUE else None
    settled = abs(before - plan.duration) <= SAME_DURATION * plan.duration
    return None if settled and excess <= TORQUE_TOLERANCE else problem.with_reference(plan.x)
