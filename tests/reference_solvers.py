"""Other solvers of the rows of a problem: toppra, copp-py, and a bound of the optimum by linear programming."""

from __future__ import annotations

import logging
from typing import Any

import copp_py
import numpy as np
import toppra
from copp_py.solver import topp2_ra
from scipy import sparse
from scipy.optimize import linprog
from toppra.algorithm import TOPPRA
from toppra.constraint import DiscretizationType, LinearConstraint
from toppra.constraint.linear_constraint import canlinear_colloc_to_interpolate

from robustopt.limits import TimeScalingProblem

logging.getLogger("toppra").setLevel(logging.ERROR)


class Rows(LinearConstraint):
    """Rows a u + b x + c <= 0 and x <= x_max at grid points, for toppra, at both ends of every interval."""

    def __init__(self, a: np.ndarray, b: np.ndarray, c: np.ndarray, x_max: np.ndarray) -> None:
        super().__init__()
        self.discretization_type = DiscretizationType.Interpolation
        self.a, self.b, self.c, self.x_max, self.dof = a, b, c, x_max, 1

    def compute_constraint_params(self, path: Any, gridpoints: np.ndarray) -> Any:
        points, m = self.a.shape
        every, bound = np.tile(np.eye(m), (points, 1, 1)), np.column_stack([np.zeros(points), self.x_max])
        return canlinear_colloc_to_interpolate(
            self.a, self.b, self.c, every, np.zeros((points, m)), None, bound, gridpoints, identical=False
        )


def toppra_duration(problem: TimeScalingProblem) -> float:
    """Duration of toppra's timing with its interpolation scheme, piece by piece [s]."""
    total = 0.0
    for k in range(problem.piece[-1] + 1):
        at = np.flatnonzero(problem.piece == k)
        s = problem.s[at]
        rows = Rows(problem.a[at], problem.b[at], problem.c[at], problem.limits.x_max[at])
        line = toppra.SplineInterpolator(s[[0, -1]], np.array([[0.0], [1.0]]))  # required; the rows do not use it
        answer = TOPPRA([rows], line, gridpoints=s, solver_wrapper="seidel").compute_parameterization(0.0, 0.0)
        total += float(np.sum(2 * np.diff(s) / (answer[1][:-1] + answer[1][1:])))
    return total


def copp_duration(problem: TimeScalingProblem) -> float:
    """Duration of copp-py's timing by reachability analysis, which takes the rows at both ends, piece by piece [s]."""
    total = 0.0
    for k in range(problem.piece[-1] + 1):
        at = np.flatnonzero(problem.piece == k)
        s = problem.s[at]
        limits = copp_py.Constraints(1)
        limits.append_s(s)
        limits.add_constraint_1st(problem.limits.x_max[at][:, None].copy(), 0)
        limits.add_constraint_2nd(problem.b[at].copy(), problem.a[at].copy(), -problem.c[at], 0)
        x = np.array(topp2_ra.solve(topp2_ra.Problem(limits, (0, len(at) - 1), (0.0, 0.0))))
        root = np.sqrt(np.maximum(x, 0.0))
        total += float(np.sum(2 * np.diff(s) / (root[:-1] + root[1:])))
    return total


def shortest_possible(problem: TimeScalingProblem, x: np.ndarray) -> float:
    """A lower bound of the duration of every timing of the rows, from the tangent of the convex duration at x [s].

    T(y) >= T(x) + T'(x) (y - x); the right-hand side is minimised over all y that satisfy the rows.
    """
    ds, moving = problem.ds, np.flatnonzero(problem.ds > 0)
    root = np.sqrt(x)
    sums = root[moving] + root[moving + 1]
    gradient = np.zeros(len(x))
    for end in (0, 1):
        inner = root[moving + end] > 0
        at = moving[inner] + end
        np.add.at(gradient, at, -ds[moving[inner]] / (sums[inner] ** 2 * root[at]))
    rows, columns, entries, right = [], [], [], []
    count = 0
    for i in moving:
        for end in (0, 1):
            a, b, c = problem.a[i + end], problem.b[i + end], problem.c[i + end]
            for k in np.flatnonzero((a != 0) | (b != 0)):
                slope = a[k] / (2 * ds[i])
                rows += [count, count]
                columns += [i, i + 1]
                entries += [-slope + (b[k] if end == 0 else 0.0), slope + (b[k] if end == 1 else 0.0)]
                right.append(-c[k])
                count += 1
    matrix = sparse.csc_matrix((entries, (rows, columns)), shape=(count, len(x)))
    scale = np.where(x > 0, x, 1.0)
    answer = linprog(
        gradient * scale,
        A_ub=matrix @ sparse.diags(scale),
        b_ub=right,
        bounds=np.column_stack([np.zeros(len(x)), problem.x_max / scale]),
        method="highs",
    )
    assert answer.status == 0, answer.message
    return float(np.sum(2 * ds[moving] / sums) + answer.fun - gradient @ x)
