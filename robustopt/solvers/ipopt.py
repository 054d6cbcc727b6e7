"""Outer program: the timing as a convex nonlinear program in x, solved by Ipopt through CasADi.

    minimise   sum_i dt_i (1 + weight * penalty_i),   dt_i = 2 ds_i / (sqrt(x_i) + sqrt(x_{i+1}))
    such that  a u + b x + c <= 0 at both ends of every interval,   0 <= x <= x_max

The penalty is the sum over the joints of (tau / tau_max)^2 (effort) or (qdd / qdd_max)^2 (smoothness), the mean of both
ends of the interval.
"""

from __future__ import annotations

import time

import casadi as ca
import numpy as np
from scipy import sparse

from robustopt.arrays import Array, Indices
from robustopt.interruption import held
from robustopt.limits import TimeScalingProblem
from robustopt.solvers.plan import Plan, Status, duration_of, failed_plan, outcome, solved_plan
from robustopt.solvers.reachability import passes

SMALLEST_X = 1e-7
"""Lower bound of x away from rest, as a fraction of a feasible timing, so that the square root stays differentiable. A
fraction of x_max would not do: the rows may keep it far out of reach."""

OPTIONS = {
    "print_time": False,
    "ipopt.print_level": 0,
    "ipopt.sb": "yes",
    "ipopt.tol": 1e-9,
    "ipopt.constr_viol_tol": 1e-9,
    "ipopt.bound_relax_factor": 1e-10,
    "ipopt.jac_d_constant": "yes",
    "ipopt.max_iter": 500,
    "iteration_callback_step": 5,
}


def solve_ipopt(problem: TimeScalingProblem, guess: Array | None = None) -> Plan:
    """Return the plan of least cost on the rows of a problem, or a failed plan with the reason.

    Args:
        problem: the problem.
        guess: timing x to start from (P,); by default that of `reachability`.
    """
    began = time.perf_counter()
    feasible_x, _, stuck = passes(problem.a, problem.b, problem.c, problem.x_max, problem.ds, problem.fixed[[0, -1]])
    if not problem.feasible.all():
        stuck = int(np.argmin(problem.feasible))
    if stuck >= 0:
        figures = {"solver_seconds": time.perf_counter() - began}
        return failed_plan(problem, Status.INFEASIBLE, "ipopt", outcome(Status.INFEASIBLE, problem), stuck, figures)
    if not np.isnan(problem.fixed).any():  # a single interval is left of a running plan
        return solved_plan(problem, feasible_x, "ipopt", {"solver_seconds": time.perf_counter() - began})
    scale = np.where(feasible_x > 0, feasible_x, problem.x_max)
    x, ended, iterations = _minimise(problem, feasible_x if guess is None else guess, scale, OPTIONS)
    figures = {"solver_seconds": time.perf_counter() - began, "ipopt_iterations": float(iterations)}
    if ended not in ("Solve_Succeeded", "Solved_To_Acceptable_Level"):
        status = Status.ITERATION_LIMIT if ended == "Maximum_Iterations_Exceeded" else Status.FAILED
        return failed_plan(problem, status, "ipopt", f"{status.sentence} Ipopt says {ended}.", -1, figures)
    return solved_plan(problem, x, "ipopt", figures)


def _minimise(
    problem: TimeScalingProblem, guess: Array, scale: Array, options: dict[str, object]
) -> tuple[Array, str, int]:
    """Return the x of least cost (P,), Ipopt's status and its number of iterations.

    The variables are fractions of the timing `scale` (P,), and the cost is a fraction of its duration, so that
    tolerances mean the same for slow and fast robots. `guess` is the timing to start from (P,).
    """
    free = np.flatnonzero(np.isnan(problem.fixed))
    rows, right = _rows(problem, free)
    part = ca.MX.sym("x", len(free))
    size = scale[free]
    variable, matrix = part * ca.DM(size), ca.DM(sparse.csc_matrix(rows.multiply(size)))
    given = np.nan_to_num(problem.fixed)
    full, root = _spread(variable, free, given), _spread(ca.sqrt(variable), free, np.sqrt(given))
    objective = _objective(problem, full, root, problem.config.solver.cost) / duration_of(problem.ds, scale)
    upper = problem.x_max[free] / size
    start = np.clip(guess[free] / size, 10 * SMALLEST_X, 0.999 * upper)
    with held() as interruptions:
        stop = Stop(len(free), len(right), interruptions)
        program = {"x": part, "f": objective, "g": matrix @ part}
        solver = ca.nlpsol("outer", "ipopt", program, {**options, "iteration_callback": stop})
        answer = solver(x0=start, lbx=SMALLEST_X, ubx=upper, lbg=-np.inf, ubg=right)
    if interruptions:  # the user's handler let the work go on
        return _minimise(problem, guess, scale, options)
    result = given
    result[free] = size * np.clip(np.array(answer["x"]).ravel(), 0.0, upper)
    stats = solver.stats()
    return result, str(stats["return_status"]), int(stats["iter_count"])


class Stop(ca.Callback):  # type: ignore[misc]
    """Callback that ends Ipopt within a few iterations of an interruption; an exception would be caught by Ipopt."""

    def __init__(self, variables: int, rows: int, interruptions: list[int]) -> None:
        """Make the callback of a program; `interruptions` is filled by the handler of signals."""
        super().__init__()
        self._sizes = {"x": variables, "lam_x": variables, "g": rows, "lam_g": rows, "f": 1}
        self._interruptions = interruptions
        self.construct("stop", {})

    def get_n_in(self) -> int:
        """Return the number of inputs."""
        return int(ca.nlpsol_n_out())

    def get_sparsity_in(self, i: int) -> ca.Sparsity:
        """Return the sparsity of an input."""
        return ca.Sparsity.dense(self._sizes.get(ca.nlpsol_out(i), 0))

    def get_name_in(self, i: int) -> str:
        """Return the name of an input."""
        return str(ca.nlpsol_out(i))

    def eval(self, _outputs: list[ca.DM]) -> list[int]:
        """Return 1 to end Ipopt, 0 to go on."""
        return [bool(self._interruptions)]


def _rows(problem: TimeScalingProblem, free: Indices) -> tuple[sparse.csc_matrix, Array]:
    """Return the rows A x <= right at both ends of the intervals over the free x, without rows that always hold."""
    given = np.nan_to_num(problem.fixed)
    moving = np.flatnonzero(problem.ds > 0)
    gain = 1.0 / (2 * problem.ds[moving])
    before, after, right = [], [], []
    for end in (0, 1):
        a, b, c = (array[moving + end] for array in (problem.a, problem.b, problem.c))
        slope = a * gain[:, None]
        before.append(-slope + (b if end == 0 else 0.0))
        after.append(slope + (b if end == 1 else 0.0))
        right.append(-c)
    first, second, limit = (np.concatenate(parts, axis=1) for parts in (before, after, right))
    keep = (first != 0) | (second != 0)
    interval = np.repeat(np.arange(len(moving)), first.shape[1]).reshape(first.shape)[keep]
    count = len(interval)
    entries = np.r_[first[keep], second[keep]]
    columns = np.r_[moving[interval], moving[interval] + 1]
    matrix = sparse.csc_matrix(
        (entries, (np.r_[np.arange(count), np.arange(count)], columns)), shape=(count, len(problem.s))
    )
    return matrix[:, free].tocsc(), limit[keep] - matrix @ given


def _spread(values: ca.MX, free: Indices, given: Array) -> ca.MX:
    """Return the values at the free grid points and those given (P,) at the others, (P,)."""
    full = ca.MX(ca.DM(given))
    full[free.tolist()] = values
    return full


def _objective(problem: TimeScalingProblem, x: ca.MX, root: ca.MX, cost: str) -> ca.MX:
    """Return the cost of a timing, given x and its square root (P,)."""
    moving = np.flatnonzero(problem.ds > 0)
    ds, first, second = problem.ds[moving], moving.tolist(), (moving + 1).tolist()
    dt = 2 * ds / (root[first] + root[second])
    weight = problem.config.solver.weight
    if cost == "time" or weight == 0.0:
        return ca.sum1(dt)
    u = (x[second] - x[first]) / (2 * ds)
    penalty, torque = ca.MX(0), problem.limits.torque
    for points in (moving, moving + 1):
        for j in range(problem.robot.n):
            if cost == "smoothness" or torque.limited[j]:
                penalty += 0.5 * _relative(problem, cost, points, j, u, x[points.tolist()], root[points.tolist()]) ** 2
    return ca.sum1(dt * (1 + weight * penalty))


def _relative(
    problem: TimeScalingProblem, cost: str, points: Indices, joint: int, u: ca.MX, x: ca.MX, root: ca.MX
) -> ca.MX:
    """Return the torque or acceleration of a joint at grid points, as a fraction of its limit."""
    if cost == "smoothness":
        motion, limit = problem.limits.motion, problem.robot.limits.acceleration[joint]
        return (motion.q1[points, joint] * u + motion.q2[points, joint] * x) / limit
    coefficients, viscous = problem.limits.torque.nominal(joint)
    c = coefficients[points]
    return c[:, 0] * u + c[:, 1] * x + c[:, 2] + viscous[points] * root
