"""Limits of a timing as rows a u + b x + c <= 0, robust against every uncertain parameter."""

from robustopt.limits.problem import TimeScalingProblem, build_problem, build_rows, rows_along, track_of

__all__ = ["TimeScalingProblem", "build_problem", "build_rows", "rows_along", "track_of"]
