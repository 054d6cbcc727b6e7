"""Jerk-limited timing as a nonlinear program in speeds, accelerations and times of the intervals, solved by Ipopt.

    minimise   sum_i dt_i
    such that  v_{i+1} = v_i + (u_i + u_{i+1}) dt_i / 2,   ds_i = v_i dt_i + (2 u_i + u_{i+1}) dt_i^2 / 6,
               a u + b v^2 + c <= 0 and v^2 <= x_max at every grid point,   v = u = 0 at every rest,
               a (u_i + u_{i+1}) / 2 + b v^2 + c <= 0 at both ends of every interval,
               |q''' v^3 + 3 q'' v u + q' (u_{i+1} - u_i) / dt_i| <= J at the places of `jerk` within every interval

It has the same solutions as `jerk`, which eliminates the times and solves it by an interior-point method of its own.
If a state is given at an end of the path, v and u are fixed there, and `jerk` decides whether there is a timing.
"""

from __future__ import annotations

import time

import casadi as ca
import numpy as np
from scipy import sparse

from robustopt.arrays import Array
from robustopt.interruption import held
from robustopt.limits import TimeScalingProblem
from robustopt.solvers.ipopt import OPTIONS, Stop
from robustopt.solvers.jerk import minimise, not_found, unless_still
from robustopt.solvers.jerk_newton import Program
from robustopt.solvers.jerk_program import pieces, program_of
from robustopt.solvers.jerk_start import first_timing, timing_of
from robustopt.solvers.plan import Plan, Status, failed_plan, interval_times, jerk_plan

METHOD = "ipopt"
"""Name of the method that this solver belongs to."""

SMALLEST = 1e-4
"""Lower bound of speeds and times, as a fraction of the slow timing that the solver starts from; the plan is faster
than this timing, but not everywhere."""


def solve_ipopt_jerk(problem: TimeScalingProblem) -> Plan:
    """Return a minimum-time plan within the jerk limits on the rows of a problem, or a failed plan with the reason.

    Args:
        problem: the problem; the robot can stand still at its rests.
    """
    began = time.perf_counter()
    refused = unless_still(problem, METHOD)
    if refused is not None:
        return refused
    x, u, iterations = np.zeros(len(problem.s)), np.zeros(len(problem.s)), 0
    for piece in pieces(problem):
        if not piece.at_rest:
            found = minimise(problem, piece)
            if not found.allowed:
                return not_found(problem, piece, METHOD, {"solver_seconds": time.perf_counter() - began})
            if piece.single:
                x[piece.points], u[piece.points] = found.x, found.u
                continue
        program = program_of(problem, piece)
        if problem.running is None or piece.at_rest:
            start = first_timing(problem, piece, program)
        else:
            start = timing_of(problem.running, piece)
        v, sdd, ended, taken = _minimise(program, start)
        iterations += taken
        if ended not in ("Solve_Succeeded", "Solved_To_Acceptable_Level"):
            status = Status.ITERATION_LIMIT if ended == "Maximum_Iterations_Exceeded" else Status.FAILED
            figures = {"solver_seconds": time.perf_counter() - began}
            return failed_plan(problem, status, METHOD, f"{status.sentence} Ipopt says {ended}.", -1, figures)
        x[piece.points], u[piece.points] = v**2, sdd
    figures = {"solver_seconds": time.perf_counter() - began, "ipopt_iterations": float(iterations)}
    return jerk_plan(problem, x, u, METHOD, figures)


def _minimise(program: Program, timing: Array) -> tuple[Array, Array, str, int]:
    """Return speeds and accelerations at the inner points of a piece (n,), Ipopt's status and its number of iterations.

    The variables are fractions of a first timing (2 n + 2,). The cost is a fraction of its duration.
    """
    x, u = timing[:-2:2], timing[1:-2:2]
    n, rests = len(x), program.ends > 0.0
    ds = np.concatenate([program.ends[:1][rests[:1]], program.ds, program.ends[1:][rests[1:]]])
    before, after = np.zeros(int(rests[0])), np.zeros(int(rests[1]))
    speed, sdd = np.concatenate([before, np.sqrt(x), after]), np.concatenate([before, u, after])
    dt = interval_times(ds, 0.5 * (speed[:-1] + speed[1:]), np.diff(sdd))
    typical = np.abs(u) + x / program.away
    sizes = np.concatenate([np.sqrt(x), typical, dt])
    part = ca.MX.sym("z", len(sizes))
    z = part * ca.DM(sizes)
    inner, acceleration, step = z[:n], z[n : 2 * n], z[2 * n :]
    v, w = (ca.vertcat(*before, values, *after) for values in (inner, acceleration))
    equations = [
        (v[1:] - v[:-1] - 0.5 * (w[1:] + w[:-1]) * step) / ca.DM(np.maximum(speed[1:], speed[:-1])),
        (v[:-1] * step + (2 * w[:-1] + w[1:]) * step**2 / 6 - ca.DM(ds)) / ca.DM(ds),
    ]
    jerk = _jerks(program, inner, acceleration, step[len(before) :])
    limits = [_lines(program, inner, acceleration), jerk - 1, -jerk - 1]
    equal, below = ca.vertcat(*equations), ca.vertcat(*limits)
    count = equal.numel() + below.numel()
    cost = {"x": part, "f": ca.sum1(step) / dt.sum(), "g": ca.vertcat(equal, below)}
    low = np.concatenate([np.full(n, SMALLEST), np.full(n, -np.inf), np.full(len(dt), SMALLEST)])
    start, high = np.concatenate([np.ones(n), u / typical, np.ones(len(dt))]), np.full(len(sizes), np.inf)
    for point in np.array([0, n - 1])[~rests]:  # the state is given
        for k in (point, n + point):
            low[k] = high[k] = start[k]
    options = {name: value for name, value in OPTIONS.items() if name != "ipopt.jac_d_constant"}
    with held() as interruptions:
        stop = Stop(len(sizes), count, interruptions)
        solver = ca.nlpsol("outer", "ipopt", cost, {**options, "expand": True, "iteration_callback": stop})
        lowest = np.concatenate([np.zeros(equal.numel()), np.full(below.numel(), -np.inf)])
        answer = solver(x0=start, lbx=low, ubx=high, lbg=lowest, ubg=0.0)
    if interruptions:  # the user's handler let the work go on
        return _minimise(program, timing)
    found = sizes * np.array(answer["x"]).ravel()
    stats = solver.stats()
    return found[:n], found[n : 2 * n], str(stats["return_status"]), int(stats["iter_count"])


def _lines(program: Program, v: ca.MX, u: ca.MX) -> ca.MX:
    """Return -g of the linear limits g >= 0, (l,)."""
    row, column = np.nonzero(program.line)
    point = program.line_point[row] + column // 2
    values, shape = program.line[row, column], (len(program.line), v.numel())
    of_x, of_u = (
        sparse.csc_matrix((values[kind], (row[kind], point[kind])), shape)
        for kind in (column % 2 == 0, column % 2 == 1)
    )
    return -1 - ca.DM(of_x) @ v**2 - ca.DM(of_u) @ u


def _jerks(program: Program, v: ca.MX, u: ca.MX, step: ca.MX) -> ca.MX:
    """Return the jerk of each joint at each of its places, relative to its limit (k,)."""
    i, after = program.jerk_point.tolist(), ca.DM(program.place)
    j = (program.jerk_point + 1).tolist()
    v_here, u_here = ca.sqrt((1 - after) * v[i] ** 2 + after * v[j] ** 2), (1 - after) * u[i] + after * u[j]
    q1, q2, q3 = (ca.DM(q) for q in (program.q1, program.q2, program.q3))
    return q3 * v_here**3 + 3 * q2 * v_here * u_here + q1 * (u[j] - u[i]) / step[i]
