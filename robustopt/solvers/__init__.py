"""Solvers of time-scaling problems, which share one contract and find the same optimum."""

from robustopt.solvers.build import build_problem, build_rows, track_of
from robustopt.solvers.plan import Plan, Status
from robustopt.solvers.solve import solve, standstill

__all__ = ["Plan", "Status", "build_problem", "build_rows", "solve", "standstill", "track_of"]
