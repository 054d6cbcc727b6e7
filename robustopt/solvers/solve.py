"""Solution of a time-scaling problem: an outer solver, repeated with the rows that its plan violates.

`solve` repeats an outer solver (`reachability` or `ipopt`) until its plan fulfils four conditions, for every value of
the parameters: contact forces supply the required wrench at both ends of every interval (inner programs, whose duals
become rows); no row of a fine cone is violated, imposed or not; contacts that share a wrench can do so within the
joint torque limits (inner programs likewise); and the viscous torque, which the rows linearise, is within its limit and
the linearisation has settled.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from robustopt.arrays import Array
from robustopt.errors import ConfigError
from robustopt.limits import TimeScalingProblem
from robustopt.limits.names import LimitKind
from robustopt.limits.systems import SLIPS
from robustopt.limits.track import MOST_SPEED
from robustopt.solvers.binding import ACTIVE_TOLERANCE, binding_rows
from robustopt.solvers.jerk import solve_jerk
from robustopt.solvers.plan import Plan, Status, failed_plan, grid_points, interval_ends, outcome
from robustopt.solvers.reachability import solve_reachability

if TYPE_CHECKING:  # HiGHS is loaded only when a program is needed
    from robustopt.solvers.force_program import ForceProgram
    from robustopt.solvers.sharing import SharingSearch

__all__ = ["Plan", "Status", "solve", "standstill"]

MOST_MISSING = 1e-8
"""Fraction of the weight by which a plan may violate a row of a fine cone that is not imposed."""

MOST_ROUNDS = 60
"""Largest number of rounds of rows and relinearisations; the waiter tasks take about ten."""

TORQUE_TOLERANCE = 1e-7
"""Fraction of a torque limit by which the relinearised torque may exceed it."""

RETREAT, MOST_RETREATS = 0.2, 10
"""Factor on the reference of the linearisation if no plan is left, and how often it is applied at most: a tangent about
too fast a plan may forbid every slower one."""

NEAR_TORQUE = 1e-3
"""Fraction of a torque limit: the viscous torque of a plan that comes closer to its limit is linearised, because joint
friction may allow more."""

Outer = Callable[[TimeScalingProblem, str, Array | None], Plan]
"""Outer solver: the plan on the rows of a problem by a method, from a first timing x (P,) or None."""

SAME_DURATION = 1e-6
"""Relinearising ends if it changes the duration by less than this fraction."""


def solve(problem: TimeScalingProblem, method: str | None = None, jerk: bool = True) -> Plan:
    """Return the optimal plan of a problem that holds for every value in the intervals.

    With jerk limits, it is a local optimum.

    Args:
        problem: the problem.
        method: `ipopt` or `reachability`; by default the configured one.
        jerk: False to ignore jerk limits, on which feasibility does not depend if the path begins and ends at rest.

    Returns:
        The plan. If there is none, its status and message say why, and its arrays are empty.

    Raises:
        ConfigError: nothing bounds the speed, or the speed at an end of the path is beyond its limits.
    """
    began = time.perf_counter()
    method = method or problem.config.solver.method
    refused = _refused(problem, method)
    if refused is not None:
        return refused
    if method == "ipopt":
        contacts = problem.limits.contacts
        problem = problem.with_contacts([c if c.system.fine else c.with_facets(c.facets[:0]) for c in contacts])
    figures = {"rounds": 0.0, "inner_programs": 0.0, "inner_seconds": 0.0, "relinearisations": 0.0}
    jerk = jerk and bool(np.isfinite(problem.jerk).any())
    plan = None if problem.running is None or not jerk else _repeated(problem, method, figures, _outer_with_jerk)
    if plan is None or plan.status is not Status.SOLVED:
        plan = _repeated(problem, method, figures, _outer)
        if plan.status is Status.SOLVED and jerk:
            _require_bounded(plan)
            plan = _repeated(plan.problem, method, figures, _outer_with_jerk)
    if plan.status is Status.INFEASIBLE and (at_rest := standstill(plan.problem)) >= 0:
        plan = replace(plan, stuck=at_rest)
    if plan.status is Status.SOLVED:
        _require_bounded(plan)
    figures["solve_seconds"] = time.perf_counter() - began
    return replace(plan, statistics={**plan.statistics, **figures})


def _refused(problem: TimeScalingProblem, method: str) -> Plan | None:
    """Return a failed plan if the method cannot minimise the cost or the robot cannot stand still, else None."""
    if method == "reachability" and problem.config.solver.cost != "time" and problem.config.solver.weight > 0:
        message = "reachability minimises time only; use solver.method: ipopt"
        return failed_plan(problem, Status.FAILED, method, message, -1, {})
    _require_speeds(problem)
    at_rest = standstill(problem)
    if at_rest >= 0:
        return failed_plan(problem, Status.INFEASIBLE, method, outcome(Status.INFEASIBLE, problem), at_rest, {})
    return None


def _require_speeds(problem: TimeScalingProblem) -> None:
    """Check that the speeds at both ends are within the limits of speed."""
    for end, key in ((0, "path.start_speed"), (-1, "path.end_speed")):
        most, speed = problem.x_max[end], problem.path.end_speeds[end]
        if speed**2 > most * (1.0 + ACTIVE_TOLERANCE):
            rate = float(np.linalg.norm(problem.limits.motion.q1[end]))
            found = f"{rate * speed:.6g}"
            if problem.s[end] not in (0.0, 1.0):  # the start of the rest of a running plan
                key, found = "from_time", f"a speed of {found} there"
            raise ConfigError(
                f"found {found}; expected at most {rate * np.sqrt(most):.6g}, because of {problem.x_max_names[end]}",
                key=key,
            )


def _require_bounded(plan: Plan) -> None:
    """Check that limits keep the joints without a velocity limit below `MOST_SPEED`."""
    track, x_max = plan.problem.limits.track, plan.problem.x_max
    unlimited = (track.robot.limits.velocity[track.fastest] >= MOST_SPEED) & (track.slowest < 0)
    reached = np.flatnonzero(unlimited & (x_max > 0) & (plan.x >= (1 - ACTIVE_TOLERANCE) * x_max))
    if not len(reached):
        return
    k = int(reached[np.argmin(np.abs(reached - len(x_max) // 2))])
    joint, s = track.robot.joint_names[track.fastest[k]], float(plan.s[k])
    raise ConfigError(
        f"nothing bounds the speed of {joint} at s = {s:.4g} ({track.path.label(s)}): it would reach {MOST_SPEED:g} "
        f"rad/s or m/s; give robot.limits.{joint} a velocity, acceleration or torque",
        key="robot.limits",
    )


def _repeated(problem: TimeScalingProblem, method: str, figures: dict[str, float], outer: Outer) -> Plan:
    """Return the plan after rounds of missing rows and relinearisations, until neither is needed."""
    plan = outer(problem, method, None)
    programs: dict[int, ForceProgram] = {}
    shared: list[SharingSearch] = []
    before = np.inf
    for _ in range(MOST_ROUNDS):
        figures["rounds"] += 1
        if plan.status is not Status.SOLVED:
            return plan
        tighter = _with_missing_rows(plan, method, programs, figures)
        if tighter is None:
            tighter = _with_cuts(plan)
        if tighter is None:
            tighter = _with_shared_rows(plan, shared, figures)
        if tighter is None:
            tighter = _relinearised(plan, before)
            figures["relinearisations"] += tighter is not None
        if tighter is None:
            return plan
        before, plan = plan.duration, _retreated(outer(tighter, method, plan.x), method, outer)
    status = Status.ITERATION_LIMIT
    return failed_plan(plan.problem, status, method, status.sentence, -1, plan.statistics)


def _retreated(plan: Plan, method: str, outer: Outer) -> Plan:
    """Return the plan; if it is infeasible, return one of the same problem linearised about slower timings."""
    for _ in range(MOST_RETREATS):
        if plan.status is not Status.INFEASIBLE or np.isnan(plan.problem.reference).all():
            break
        plan = outer(plan.problem.with_reference(RETREAT * plan.problem.reference), method, None)
    return plan


def standstill(problem: TimeScalingProblem) -> int:
    """Return the first grid point at which the robot must rest but cannot for some parameters, -1 if there is none.

    Args:
        problem: the problem.
    """
    slack = problem.c.max(axis=1, initial=-1.0)
    wrong = problem.rest & ((slack > 1e-9) | ~problem.feasible)
    return int(np.argmax(wrong)) if wrong.any() else -1


def _outer(problem: TimeScalingProblem, method: str, guess: Array | None) -> Plan:
    if method == "reachability":
        return solve_reachability(problem)
    from robustopt.solvers.ipopt import solve_ipopt

    return solve_ipopt(problem, guess)


def _outer_with_jerk(problem: TimeScalingProblem, method: str, guess: Array | None) -> Plan:
    if method == "reachability":
        return solve_jerk(problem)
    from robustopt.solvers.ipopt_jerk import solve_ipopt_jerk

    return solve_ipopt_jerk(problem)


def _with_missing_rows(
    plan: Plan, method: str, programs: dict[int, ForceProgram], figures: dict[str, float]
) -> TimeScalingProblem | None:
    """Return the problem with the contact rows that its plan violates, None if there are none.

    Only rows of limits that count are added: in a diagnosis, the plan may violate the others in every round.
    """
    limits, kept = list(plan.problem.limits.contacts), plan.problem.kept
    counted = [np.array([kept is None or name in kept for name in limit.names]) for limit in limits]
    incomplete = [
        k
        for k, limit in enumerate(limits)
        if counted[k].any() and not limit.system.fine and (method == "ipopt" or not limit.system.complete)
    ]
    if not incomplete:
        return None
    from robustopt.solvers.force_program import ForceProgram, missing_rows, overlooked_rows

    began = time.perf_counter()
    u, x, points = interval_ends(plan)
    found = 0
    for second_look in (False, True):
        for k in incomplete:
            limit = limits[k]
            if k not in programs:
                programs[k] = ForceProgram(limit)
            here = limit.holds_at(points)
            if second_look:
                rows, solved = overlooked_rows(limit, programs[k], points[here], u[here], x[here])
            else:
                rows, _, solved = missing_rows(limit, programs[k], points[here], u[here], x[here])
            figures["inner_programs"] += solved
            count = counted[k][rows[1]]
            limits[k] = limit.with_more(rows[0][count], rows[1][count])
            found += int(count.sum())
        if found:
            break
    figures["inner_seconds"] += time.perf_counter() - began
    return plan.problem.with_contacts(limits) if found else None


def _with_cuts(plan: Plan) -> TimeScalingProblem | None:
    """Return the problem with cuts where its plan violates rows of fine cones that are not imposed, None if none is."""
    problem = plan.problem
    limits = list(problem.limits.contacts)
    if not any(limit.system.fine for limit in limits):
        return None
    u, x, points = interval_ends(plan)
    found = False
    for k, limit in enumerate(limits):
        if limit.system.fine and (problem.kept is None or limit.names[SLIPS] in problem.kept):
            tighter = limit.with_cuts(points, u, x, MOST_MISSING)
            limits[k], found = tighter or limit, found or tighter is not None
    return problem.with_cuts(limits) if found else None


def _with_shared_rows(plan: Plan, search: list[SharingSearch], figures: dict[str, float]) -> TimeScalingProblem | None:
    """Return the problem with the torque rows that its plan violates for shared wrenches, None if there are none."""
    problem, torque = plan.problem, plan.problem.limits.torque
    if torque.sharing.known.all() or not _contacts_count(problem):
        return None
    from robustopt.solvers.sharing import SharingSearch

    began = time.perf_counter()
    u, x, points = interval_ends(plan)
    if not search:
        search.append(SharingSearch(problem.counts(2 * problem.robot.n + np.arange(problem.robot.n))))
    rows, solved = search[0].missing_rows(torque.sharing, points, u, x)
    figures["inner_programs"] += solved
    figures["inner_seconds"] += time.perf_counter() - began
    return problem.with_torque(torque.with_rows(rows)) if rows else None


def _contacts_count(problem: TimeScalingProblem) -> bool:
    """Return whether all limits of all contacts are part of the problem; otherwise no forces share a wrench."""
    return problem.kept is None or all(problem.kept.issuperset(limit.names) for limit in problem.limits.contacts)


def _relinearised(plan: Plan, before: float) -> TimeScalingProblem | None:
    """Return the problem with the viscous torque linearised about its plan, None if this is not needed.

    It is not needed once the plan keeps the limits on the exact torque and has settled: `before` is the duration of the
    plan that the linearisation is about [s].
    """
    problem = plan.problem
    torque = problem.limits.torque
    if not torque.limited.any() or not torque.viscous.any():
        return None
    if np.isnan(problem.reference).all():
        own = [name.kind == LimitKind.TORQUE for name in problem.row_names]
        clear, most = not (any(own) and binding_rows(plan)[:, own].any()), -NEAR_TORQUE
    else:
        clear, most = abs(before - plan.duration) <= SAME_DURATION * plan.duration, TORQUE_TOLERANCE
    clear = clear and not problem.torque_exceeds(most, *grid_points(plan))
    return None if clear else problem.with_reference(plan.x)
