"""Solvers of the same time-scaling rows: ours, toppra and copp-py, each as a call that returns x = sd^2.

    python experiments/contenders.py NAME ROWS.npz

prints the seconds of the import, the first and the second call as JSON. toppra and copp-py do not support stops on the
way, so they solve piece by piece. The calls exclude the construction of their problems. The rows have no padding: every
grid point has as many as the one with the most.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from robustopt.limits import TimeScalingProblem

Array = np.ndarray
Solve = Callable[[], Array]


@dataclass(frozen=True)
class Rows:
    """Rows a u + b x + c <= 0, (P, m), and bounds x <= x_max (P,) at the grid points s (P,) of the pieces of a path."""

    s: Array
    piece: Array
    a: Array
    b: Array
    c: Array
    x_max: Array

    def pieces(self) -> list[Rows]:
        parts = [np.flatnonzero(self.piece == k) for k in range(self.piece[-1] + 1)]
        return [Rows(*(getattr(self, entry.name)[part] for entry in fields(self))) for part in parts]

    def save(self, path: Path) -> None:
        np.savez(path, **asdict(self))


def rows_of(problem: TimeScalingProblem) -> Rows:
    """Return the rows of a problem without padding; x_max comes from the joint velocities, also at stops."""
    padding = (problem.a == 0.0) & (problem.b == 0.0) & (problem.c < 0.0)
    order = np.argsort(padding, axis=1, kind="stable")[:, : int((~padding).sum(axis=1).max())]
    a, b, c = (np.take_along_axis(array, order, axis=1) for array in (problem.a, problem.b, problem.c))
    return Rows(problem.s, problem.piece, a, b, c, problem.limits.x_max)


def ours(rows: Rows) -> Solve:
    """Return a call of the two passes of `reachability`."""
    from robustopt.solvers.reachability import passes

    ends = np.diff(rows.piece, prepend=-1, append=rows.piece[-1] + 1) != 0
    x_max = np.where(ends[:-1] | ends[1:], 0.0, rows.x_max)
    ds = np.diff(rows.s)
    return lambda: passes(rows.a, rows.b, rows.c, x_max, ds)[0]


def toppra(rows: Rows) -> Solve:
    """Return a call of toppra with its compiled Seidel solver and its interpolation scheme."""
    import logging

    from toppra import SplineInterpolator
    from toppra.algorithm import TOPPRA
    from toppra.constraint import DiscretizationType, LinearConstraint
    from toppra.constraint.linear_constraint import canlinear_colloc_to_interpolate

    class GivenRows(LinearConstraint):
        def __init__(self, part: Rows) -> None:
            super().__init__()
            self.discretization_type, self.part, self.dof = DiscretizationType.Interpolation, part, 1

        def compute_constraint_params(self, path, gridpoints):  # type: ignore[no-untyped-def]
            part, (points, m) = self.part, self.part.a.shape
            every = np.tile(np.eye(m), (points, 1, 1))
            bound = np.column_stack([np.zeros(points), part.x_max])
            none = np.zeros((points, m))
            both_ends = canlinear_colloc_to_interpolate(part.a, part.b, part.c, every, none, None, None, gridpoints)
            return (*both_ends[:5], None, bound)

    logging.getLogger("toppra").setLevel(logging.ERROR)
    parts = []
    for part in rows.pieces():
        line = SplineInterpolator(part.s[[0, -1]], np.array([[0.0], [1.0]]))  # required, and not used by the rows
        parts.append(TOPPRA([GivenRows(part)], line, gridpoints=part.s, solver_wrapper="seidel"))
    return lambda: np.concatenate([part.compute_parameterization(0.0, 0.0)[1] ** 2 for part in parts])


def copp(rows: Rows) -> Solve:
    """Return a call of copp-py's reachability analysis, which applies the rows at both ends of an interval itself."""
    import copp_py
    from copp_py.solver import topp2_ra

    problems = []
    for part in rows.pieces():
        limits = copp_py.Constraints(1)
        limits.append_s(part.s)
        limits.add_constraint_1st(part.x_max[:, None].copy(), 0)
        limits.add_constraint_2nd(part.b.copy(), part.a.copy(), -part.c, 0)
        problems.append(topp2_ra.Problem(limits, (0, len(part.s) - 1), (0.0, 0.0)))
    return lambda: np.concatenate([topp2_ra.solve(problem) for problem in problems])


OURS, STAGE, TOPPRA, COPP = "reachability, passes", "reachability, all", "toppra seidel", "copp-py topp2_ra"
PLAN, IPOPT = "reachability, rows and solve", "ipopt, inner programs"
CONTENDERS: dict[str, Callable[[Rows], Solve]] = {OURS: ours, TOPPRA: toppra, COPP: copp}


def first_calls(name: str, path: Path) -> dict[str, float]:
    """Return the seconds of import and construction, and of the first two calls; for a fresh process."""
    with np.load(path) as data:
        rows = Rows(**data)
    times = [time.perf_counter()]
    solve = CONTENDERS[name](rows)
    times.append(time.perf_counter())
    for _ in range(2):
        solve()
        times.append(time.perf_counter())
    return dict(zip(("import", "first", "second"), np.diff(times).tolist(), strict=True))


if __name__ == "__main__":
    print(json.dumps(first_calls(sys.argv[1], Path(sys.argv[2]))))
