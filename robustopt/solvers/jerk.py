"""Jerk-limited timing: the minimum-time program in which sdd is continuous and changes at a constant rate per interval.

sdd is 0 at every rest, and is given where the robot moves at an end of the path. The rows a u + b x + c <= 0 hold at
every grid point with its own u, and at both ends of every interval with the mean of its u, as without jerk limits: they
keep u from alternating about a point at which a limit does not depend on u. Each piece of the path, from one rest to
the next, is a program of its own in (x, u) = (sd^2, sdd) at its inner grid points, see `jerk_newton`. The jerk of a
joint is q''' sd^3 + 3 q'' sd sdd + q' sddd. It is limited at both ends and in the middle of every interval, and at more
places where q''' bends in between.

A primal-dual interior-point method finds a local minimum, from a slow timing of the piece (our choice). If a state is
given at an end of the piece, it minimises the excess over the limits too.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from robustopt.arrays import Array
from robustopt.limits import TimeScalingProblem
from robustopt.solvers.jerk_newton import Program, Work, correct, optimise, workspace
from robustopt.solvers.jerk_program import Piece, pieces, program_of
from robustopt.solvers.jerk_start import CONSISTENT, MOST_CORRECTIONS, first_timing, overuse, timing_of
from robustopt.solvers.plan import Plan, Status, failed_plan, jerk_plan, outcome

STEPS = 150
"""Largest number of Newton steps on a piece, before it is tried once more with all curvature; 15 to 50 are usual."""

FIRST_GAP, ACCURACY = 10.0, 2e-6
"""First and last gap, as fractions of the duration."""

FIRST_GAPS_GIVEN, ACCURACY_GIVEN = (1e5, 1e7), 4e-7
"""First gaps, in turn, and last gap if a state is given. They are large, so that the search first balances the excesses
over the limits. From a timing of ours the largest comes first: all of 200 random problems of one axis were solved. From
the rest of a running plan the smaller one comes first: it solved all of 17 where the larger one failed on 5, because
the limits leave a single timing."""

PENALTY = 1e4
"""Cost of an excess over a limit by all of it, in durations, if a state is given."""

MOST_EXCESS = 5e-7
"""Largest excess over a limit, relative to it, that is left if a state is given: half of what a certificate accepts."""

SAME = 1e-9
"""Largest residual of the equations of the intervals, as a fraction of x, if a state is given: on a single interval
that leads from it to rest, nothing can be chosen."""

METHOD = "reachability"
"""Name of the method that this solver belongs to."""

LEAST_SLACK = 1e-9
"""Part of each limit that standing still must leave free."""


@dataclass(frozen=True, eq=False)
class Timing:
    """Timing of a piece.

    Attributes:
        x: sd^2 at the points of its program (n,) [1/s^2].
        u: sdd there (n,) [1/s^2].
        steps: number of Newton steps.
        gap: gap as a fraction of the duration; infinite if the steps did not suffice.
        excess: largest excess over a limit, relative to it; 0 between rests.
    """

    x: Array
    u: Array
    steps: int
    gap: float
    excess: float

    @property
    def allowed(self) -> bool:
        """Return whether the timing is the fastest one, and within the limits."""
        return np.isfinite(self.gap) and self.excess <= MOST_EXCESS


def solve_jerk(problem: TimeScalingProblem) -> Plan:
    """Return a minimum-time plan within the jerk limits on the rows of a problem, or a failed plan with the reason.

    Args:
        problem: the problem; the robot can stand still at its rests.
    """
    began = time.perf_counter()
    x, u, steps, gap = np.zeros(len(problem.s)), np.zeros(len(problem.s)), 0, 0.0

    def figures() -> dict[str, float]:
        return {"solver_seconds": time.perf_counter() - began, "newton_steps": float(steps), "optimality_gap": gap}

    refused = unless_still(problem, METHOD)
    if refused is not None:
        return refused
    for piece in pieces(problem):
        found = minimise(problem, piece)
        x[piece.points], u[piece.points] = found.x, found.u
        steps, gap = steps + found.steps, max(gap, found.gap)
        if not piece.at_rest and not found.allowed:
            return not_found(problem, piece, METHOD, figures())
        if found.gap > ACCURACY:
            status = Status.ITERATION_LIMIT
            return failed_plan(problem, status, METHOD, status.sentence, -1, figures())
    return jerk_plan(problem, x, u, METHOD, figures())


def unless_still(problem: TimeScalingProblem, method: str) -> Plan | None:
    """Return a failed plan if there is a grid point at which the robot cannot stand still with some slack, else None.

    Args:
        problem: the problem.
        method: name of the method.
    """
    wrong = problem.c.max(axis=1, initial=-1.0) > -LEAST_SLACK
    if not wrong.any():
        return None
    stuck = int(np.argmax(wrong))
    name = problem.row_names[int(np.argmax(problem.c[stuck]))]
    message = (
        "With jerk limits, the robot must be able to stand still everywhere on the path; at s = "
        f"{problem.s[stuck]:.4g} it cannot, because of {name}."
    )
    return failed_plan(problem, Status.FAILED, method, message, stuck, {})


def not_found(problem: TimeScalingProblem, piece: Piece, method: str, statistics: Mapping[str, float]) -> Plan:
    """Return the plan of a problem for which no timing from or to a given state was found.

    Args:
        problem: the problem.
        piece: piece of the path to which the state belongs.
        method: name of the method.
        statistics: figures of the solution process by name.
    """
    sentence = outcome(Status.INFEASIBLE, problem, local=True)
    return failed_plan(problem, Status.INFEASIBLE, method, sentence, piece.first, statistics)


def minimise(problem: TimeScalingProblem, piece: Piece) -> Timing:
    """Return the timing of a piece of least duration, or of least excess over its limits.

    Args:
        problem: the problem; standing still satisfies its limits with some slack.
        piece: the piece.
    """
    program = program_of(problem, piece)
    work = workspace(program)
    if piece.at_rest:
        return _between_rests(program, first_timing(problem, piece, program), work)
    running = problem.running
    starts = [] if running is None else [(timing_of(running, piece), gap) for gap in FIRST_GAPS_GIVEN]
    own = first_timing(problem, piece, program)
    if piece.single:
        return _with_excess(program, own, work, 0, 0.0)
    steps = 0
    for start, first_gap in [*starts, *((own, gap) for gap in reversed(FIRST_GAPS_GIVEN))]:
        z = start.copy()
        taken, gap = optimise(program, z, work, first_gap, ACCURACY_GIVEN, STEPS, 1.0, PENALTY)
        steps += taken
        found = _with_excess(program, z, work, steps, gap if taken < STEPS else np.inf)
        if found.allowed:
            break
    return found


def _between_rests(program: Program, start: Array, work: Work) -> Timing:
    """Return the fastest timing between two rests."""
    steps = 0
    for least in (0.0, 1.0):
        z = start.copy()
        taken, gap = optimise(program, z, work, FIRST_GAP, ACCURACY, STEPS, least, np.inf)
        steps += taken
        if taken < STEPS:
            break
    else:
        gap = np.inf
    correct(program, z, work, MOST_CORRECTIONS, CONSISTENT)
    z /= max(1.0, overuse(program, work, 1.0))
    return Timing(z[:-2:2], z[1:-2:2], steps, gap, 0.0)


def _with_excess(program: Program, z: Array, work: Work, steps: int, gap: float) -> Timing:
    """Return a timing with its excess, which is infinite if it does not satisfy the equations of the intervals."""
    off = correct(program, z, work, MOST_CORRECTIONS if steps else 0, CONSISTENT)
    excess = max(overuse(program, work, 1.0) - 1.0, 0.0) if off <= SAME else np.inf
    return Timing(z[:-2:2], z[1:-2:2], steps, gap, excess)
