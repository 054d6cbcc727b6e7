"""Limits of a timing as rows a u + b x + c <= 0, robust against every uncertain quantity."""

from robustopt.limits.laws import ContactLaw
from robustopt.limits.limit import Limit, LimitFactory
from robustopt.limits.names import LimitKind, LimitName
from robustopt.limits.problem import TimeScalingProblem, rows_along

__all__ = [
    "ContactLaw",
    "Limit",
    "LimitFactory",
    "LimitKind",
    "LimitName",
    "TimeScalingProblem",
    "rows_along",
]
