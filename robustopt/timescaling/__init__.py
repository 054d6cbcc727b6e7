"""Solvers: one contract, same optimum.

`solve` repeats an outer solver (`reachability` or `ipopt`) until two things hold that its rows may lack: contact forces
exist at both ends of every interval for every value of the parameters (inner programs, whose duals become rows), and
the viscous torque, of which the rows have a linear bound, is within its limit and no longer than it must be.
"""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np

from robustopt.problem import TimeScalingProblem
from robustopt.timescaling.plan import Plan, Status, failed_plan, interval_ends
from robustopt.timescaling.reachability import solve_reachability

__all__ = ["Plan", "Status", "solve"]

MOST_ROUNDS = 60
"""Rounds of rows and relinearisations; the waiter tasks take about ten."""

TORQUE_TOLERANCE = 1e-7
"""Fraction of a torque limit by which the relinearised torque may exceed it."""

SAME_DURATION = 1e-6
"""Relinearising the viscous torque ends when it no longer shortens the plan by this fraction."""


def solve(problem: TimeScalingProblem, method: str | None = None) -> Plan:
    """The plan of a problem by the configured method, or the named one (`ipopt` or `reachability`)."""
    began = time.perf_counter()
    method = method or problem.config.solver.method
    if method == "reachability" and problem.config.solver.cost != "time" and problem.config.solver.weight > 0:
        return failed_plan(problem, Status.FAILED, method, "reachability minimises time only; use solver.method: ipopt", -1, {})
    at_rest = standstill(problem)
    if at_rest >= 0:
        return failed_plan(problem, Status.INFEASIBLE, method, Status.INFEASIBLE.sentence, at_rest, {})
    if method == "ipopt":
        problem = problem.with_facets(tuple(np.zeros_like(rows[:0]) for rows in problem.facets))
    programs: dict[int, object] = {}
    figures = {"rounds": 0.0, "inner_programs": 0.0, "inner_seconds": 0.0, "relinearisations": 0.0}
    plan = _outer(problem, method, None)
    for _ in range(MOST_ROUNDS):
        figures["rounds"] += 1
        if plan.status is not Status.SOLVED:
            break
        tighter = _with_missing_rows(plan, method, programs, figures)
        if tighter is None:
            tighter = _relinearised(plan)
            figures["relinearisations"] += tighter is not None
        if tighter is None:
            break
        previous, plan = plan, _outer(tighter, method, plan.x)
        if plan.status is Status.SOLVED and tighter.facets is previous.problem.facets and _settled(previous, plan):
            break
    else:
        plan = failed_plan(plan.problem, Status.ITERATION_LIMIT, method, Status.ITERATION_LIMIT.sentence, -1, plan.statistics)
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
    from robustopt.timescaling.ipopt import solve_ipopt

    return solve_ipopt(problem, guess)


def _with_missing_rows(
    plan: Plan, method: str, programs: dict[int, object], figures: dict[str, float]
) -> TimeScalingProblem | None:
    """The problem with the contact rows that its plan violates, None if there are none."""
    problem = plan.problem
    open_systems = [
        k for k, family in enumerate(problem.limits.contacts) if method == "ipopt" or family.system.facets is None
    ]
    if not open_systems:
        return None
    from robustopt.timescaling.inner_lp import ForceProgram, missing_rows

    began = time.perf_counter()
    points, u, x = interval_ends(problem, plan.x, plan.u)
    facets, found = list(problem.facets), 0
    for k in open_systems:
        family = problem.limits.contacts[k]
        program = programs.setdefault(k, ForceProgram(family))
        assert isinstance(program, ForceProgram)
        rows, _, solved = missing_rows(family, program, facets[k], points, u, x)
        figures["inner_programs"] += solved
        facets[k] = np.concatenate([facets[k], rows])
        found += len(rows)
    figures["inner_seconds"] += time.perf_counter() - began
    return problem.with_facets(tuple(facets)) if found else None


def _relinearised(plan: Plan) -> TimeScalingProblem | None:
    """The problem with the viscous torque linearised about its plan, None if the rows hold the exact torque already.

    Where a plan without a reference exceeds the torque, the reference is set there; once set it follows the plan.
    """
    problem = plan.problem
    points, u, x = interval_ends(problem, plan.x, plan.u)
    excess = problem.limits.torque.excess(u, x, points).max(axis=1)
    worst = np.full(len(problem.s), -np.inf)
    np.maximum.at(worst, points, excess)
    known = np.isfinite(problem.reference)
    if not known.any() and worst.max() <= TORQUE_TOLERANCE:
        return None
    reference = np.where(known | (worst > TORQUE_TOLERANCE), plan.x, problem.reference)
    return problem.with_reference(reference)


def _settled(previous: Plan, plan: Plan) -> bool:
    """Whether relinearising ended: the earlier plan held the exact torque, and the later one is hardly shorter."""
    before, after = previous.problem.reference, plan.problem.reference
    if not np.array_equal(np.isfinite(before), np.isfinite(after)):
        return False
    return abs(previous.duration - plan.duration) <= SAME_DURATION * plan.duration
