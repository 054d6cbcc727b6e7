"""Solvers of time-scaling problems, which share one contract and find the same optimum."""

from robustopt.solvers.plan import Plan, Status
from robustopt.solvers.solve import solve, standstill

__all__ = ["Plan", "Status", "solve", "standstill"]
