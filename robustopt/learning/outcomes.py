"""Requests of a learner, the outcomes that answer them, and the results of its trials."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum

from robustopt.evidence import Failure, Peak
from robustopt.learning.moments import ErrorInterval, Moments, Values


@dataclass(frozen=True)
class Belief:
    """Nominal values to plan with, in place of those of the configuration; None keeps the configured value.

    Attributes:
        friction: coefficient of friction of all contacts.
        error: interval of the joint acceleration error.
        parameters: other values by their keys in the configuration, such as ("contact.friction.upper", 0.31).
    """

    friction: float | None = None
    error: ErrorInterval | None = None
    parameters: tuple[tuple[str, float], ...] = ()


@dataclass(frozen=True)
class Request:
    """A learner's request for a plan, or for executions of it.

    Attributes:
        belief: values to plan with; the plan of a belief is always the same, so it is made once.
        executions: 0 asks for the plan alone. Otherwise run the plan and tell each execution in turn until the request
            changes, which happens after this many executions at the latest.
        speed: factor by which the plan is sped up.
        first: number of the next execution of this learner, from 0; each number has its own random stream.
    """

    belief: Belief
    executions: int
    speed: float
    first: int


@dataclass(frozen=True)
class Planned:
    """Outcome of a request for a plan: its duration [s], or None if there is no plan."""

    duration: float | None


@dataclass(frozen=True)
class Executed:
    """Outcome of one execution, with all that it showed.

    Attributes:
        success: whether it succeeded.
        errors: acceleration errors of the samples taken during the motion; empty if none were measured.
        failure: the first failure, as far as it is known; None for a success.
        peaks: largest movement of each object; empty if it was not measured.
        error_series: mean acceleration error in each of the equal parts of the motion that were completed, (k, n)
            [rad/s^2 or m/s^2]; empty if it was not measured.
    """

    success: bool
    errors: Moments = field(default_factory=Moments)
    failure: Failure | None = None
    peaks: tuple[Peak, ...] = ()
    error_series: tuple[Values, ...] = ()

    @property
    def status(self) -> str:
        """How it ended, in a word or two."""
        return "success" if self.success else (self.failure or Failure()).kind


Outcome = Planned | Executed


class Result(Enum):
    """The result of a trial."""

    SUCCESS = "success"
    FAILURE = "failure"
    UNDECIDED = "undecided"
    INFEASIBLE = "infeasible"
    NOT_FASTER = "not faster"
    NOT_EXECUTED = "not executed"

    @property
    def sentence(self) -> str:
        """The result in words."""
        return {
            Result.SUCCESS: "The executions met the learner's criterion.",
            Result.FAILURE: "The executions did not meet the learner's criterion.",
            Result.UNDECIDED: "The executions allowed did not decide, which counts as a failure.",
            Result.INFEASIBLE: "There is no plan for this belief.",
            Result.NOT_FASTER: "The plan is hardly faster than the best one, so it was not executed.",
            Result.NOT_EXECUTED: "The algorithm returns this belief; it was planned, but not executed as such.",
        }[self]


class End(Enum):
    """The reason for which a learner is finished."""

    NEAR_OPTIMAL = "near-optimal"
    INTERVAL = "interval"
    STABLE = "stable"
    ITERATION_LIMIT = "iteration limit"
    GAP = "gap"
    BOXES = "boxes"
    UNLIKELY = "unlikely"
    BUDGET = "budget"
    FINISHED = "finished"
    NO_SUCCESS = "no success"
    NO_PLAN = "no plan"

    @property
    def sentence(self) -> str:
        """The reason in words."""
        return {
            End.NEAR_OPTIMAL: "The sped-up execution failed, so the plan is near-optimal.",
            End.INTERVAL: "The interval of the coefficient of friction is as small as was asked for.",
            End.STABLE: "The interval of the acceleration error is stable.",
            End.ITERATION_LIMIT: "The interval of the acceleration error did not settle in the iterations allowed.",
            End.GAP: "The best plan is as close to the lower bound as was asked for.",
            End.BOXES: "No undecided box of parameters is larger than was asked for.",
            End.UNLIKELY: "Given the observed failures, no faster plan is likely to succeed.",
            End.BUDGET: "The executions allowed are used up.",
            End.FINISHED: "The learner reached its own end.",
            End.NO_SUCCESS: "No plan that was tested succeeded.",
            End.NO_PLAN: "There is no plan, even for the most optimistic belief.",
        }[self]
