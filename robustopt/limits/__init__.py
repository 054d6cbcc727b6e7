"""Limits of a timing as rows a u + b x + c <= 0, robust against every uncertain quantity."""

from robustopt.limits.laws import ContactLaw
from robustopt.limits.limit import Limit, LimitFactory
from robustopt.limits.names import LimitKind, LimitName
from robustopt.limits.problem import TimeScalingProblem, build_problem, build_rows, rows_along, track_of

__all__ = [
    "ContactLaw",
    "Limit",
    "LimitFactory",
    "LimitKind",
    "LimitName",
    "TimeScalingProblem",
    "build_problem",
    "build_rows",
    "rows_along",
    "track_of",
]
