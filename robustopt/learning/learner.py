"""The contract of all learners: ask for the next plan or execution, tell its outcome, read the result.

A learner is an immutable value with its settings; all that it has seen is an immutable `State`. `ask` and `tell` are
pure functions of that state, so a state that was stored and read again has the same future. Learners know neither the
planner nor the robot: a request names the values to plan with, and an outcome is a duration, or a success or failure
with the acceleration errors that were observed.

    state = learner.initial()
    while (request := learner.ask(state)) is not None:
        state = learner.tell(state, outcome_of(request))
    learner.best(state)
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, Generic, TypeVar

from pydantic import TypeAdapter

from robustopt.errors import RobustOptError
from robustopt.evidence import Failure, Failures, grouped
from robustopt.learning.moments import ErrorInterval, Moments, Values
from robustopt.learning.outcomes import Belief, End, Executed, Outcome, Planned, Request, Result

__all__ = [
    "Belief",
    "End",
    "Executed",
    "Learner",
    "Outcome",
    "Planned",
    "Request",
    "Result",
    "Row",
    "State",
    "Trial",
    "tell_all",
]


@dataclass(frozen=True)
class Trial:
    """A plan under test and the outcomes of its executions.

    Attributes:
        belief: values to plan with.
        duration: duration of the plan [s]; None before it is planned, and if there is none.
        successes: number of executions at planned speed that succeeded.
        failures: number of executions at planned speed that failed.
        sped_up: success of the execution that is sped up; None without one.
        errors: acceleration errors of the executions at planned speed.
        failed: the first failures of these executions, as far as they are known.
    """

    belief: Belief
    duration: float | None = None
    successes: int = 0
    failures: int = 0
    sped_up: bool | None = None
    errors: Moments = field(default_factory=Moments)
    failed: tuple[Failure, ...] = ()

    @property
    def executions(self) -> int:
        """Number of all executions."""
        return self.successes + self.failures + (self.sped_up is not None)

    @property
    def friction(self) -> float:
        """Coefficient of friction of the belief, for learners that move it."""
        assert self.belief.friction is not None
        return self.belief.friction


@dataclass(frozen=True)
class Row:
    """A finished trial and the knowledge of the learner after it; figures that the learner does not have are None.

    Attributes:
        iteration: number of the iteration, from 1. Attempts with smaller error intervals belong to the same iteration,
            and so does the answer that is planned at the end.
        trial: the trial.
        result: its result.
        low: lower end of the interval of the coefficient of friction.
        high: upper end of the interval of the coefficient of friction.
        lower_bound: lower bound of the duration of any plan that succeeds [s].
        gap: relative difference between the duration of the best plan and the lower bound.
        contradictions: number of pairs so far in which a less conservative plan succeeded and a more conservative one
            failed.
    """

    iteration: int
    trial: Trial
    result: Result
    low: float | None = None
    high: float | None = None
    lower_bound: float | None = None
    gap: float | None = None
    contradictions: int | None = None

    def record(self) -> dict[str, float | int | str | bool | Values | dict[str, float] | tuple[Failures, ...] | None]:
        """Return the columns of the paper's Table 1, and the figures behind them, as plain values."""
        trial = self.trial
        error = trial.belief.error or ErrorInterval()
        return {
            "iteration": self.iteration,
            "friction": trial.belief.friction,
            "duration": trial.duration,
            "result": self.result.value,
            "sped_up": trial.sped_up,
            "friction_high": self.high,
            "friction_low": self.low,
            "successes": trial.successes,
            "executions": trial.executions,
            "K": error.K,
            "share": error.share,
            "planned_middle": error.middle,
            "planned_half_width": error.half_width,
            "error_mean": trial.errors.mean,
            "error_deviation": trial.errors.deviation,
            "lower_bound": self.lower_bound,
            "gap": self.gap,
            "contradictions": self.contradictions,
            "parameters": dict(trial.belief.parameters),
            "failures": grouped(trial.failed),
        }


@dataclass(frozen=True)
class State:
    """All that a learner has seen; learners with further state derive their own class from it.

    Attributes:
        rows: finished trials, in order.
        trial: the trial under way; None once the learner is finished.
        executed: number of executions so far.
        end: reason for which the learner is finished; None before.
    """

    rows: tuple[Row, ...] = ()
    trial: Trial | None = None
    executed: int = 0
    end: End | None = None


S = TypeVar("S", bound=State)


class Learner(ABC, Generic[S]):
    """A learner; its fields are its settings, and a state holds all that it has seen.

    A learner defines `initial`, `wanted`, `infeasible` and `executed`, and `planned` if it does not execute every plan.

    Attributes:
        name: name of the algorithm.
        state_type: class of the state.
    """

    name: ClassVar[str]
    state_type: ClassVar[type[State]] = State

    # Methods that a learner defines ----------------------------------------------------------------------

    @abstractmethod
    def initial(self) -> S:
        """Return the state before anything is planned, with the first trial."""

    @abstractmethod
    def wanted(self, state: S, trial: Trial) -> tuple[int, float]:
        """Return the number of executions that the plan under test needs next, and their speed.

        Args:
            state: the state.
            trial: the plan under test.

        Returns:
            The largest number of further executions, at least 1, and the factor by which the plan is sped up.
        """

    @abstractmethod
    def infeasible(self, state: S, trial: Trial) -> S:
        """Return the state after the news that there is no plan for the belief under test.

        Args:
            state: the state before.
            trial: the trial, without a duration.

        Returns:
            The state with the next trial, or with an end.
        """

    @abstractmethod
    def executed(self, state: S, trial: Trial) -> S:
        """Return the state after an execution.

        Args:
            state: the state before.
            trial: the trial, which already includes the execution.

        Returns:
            The state with this trial if it needs further executions, with the next one, or with an end.
        """

    def planned(self, state: S, trial: Trial) -> S:
        """Return the state after the belief under test was planned; by default the plan is executed next.

        Args:
            state: the state before.
            trial: the trial, with the duration of its plan.

        Returns:
            The state with this trial, with the next one, or with an end.
        """
        return replace(state, trial=trial)

    # Methods that all learners share ---------------------------------------------------------------------

    def ask(self, state: S) -> Request | None:
        """Return the next request.

        Args:
            state: the state.

        Returns:
            A request for a plan or for executions; None if the learner is finished.
        """
        trial = state.trial
        if trial is None:
            return None
        if trial.duration is None:
            return Request(trial.belief, 0, 1.0, state.executed)
        executions, speed = self.wanted(state, trial)
        return Request(trial.belief, executions, speed, state.executed)

    def tell(self, state: S, outcome: Outcome) -> S:
        """Return the state after the outcome of a request.

        Args:
            state: the state that the request is from; it stays as it is.
            outcome: the outcome.

        Returns:
            The next state.

        Raises:
            RobustOptError: the outcome does not answer the request.
        """
        trial = state.trial
        if trial is None:
            raise RobustOptError(f"{self.name}: told an outcome after its end; expected nothing more")
        if isinstance(outcome, Planned):
            if trial.duration is not None:
                raise RobustOptError(f"{self.name}: told a plan; expected an execution, as requested")
            if outcome.duration is None:
                return self.infeasible(state, trial)
            return self.planned(state, replace(trial, duration=float(outcome.duration)))
        if trial.duration is None:
            raise RobustOptError(f"{self.name}: told an execution; expected a plan, as requested")
        counted = replace(state, executed=state.executed + 1)
        return self.executed(counted, _count(trial, outcome, self.wanted(state, trial)[1]))

    def finished(self, state: S) -> bool:
        """Return whether there is no further request; `state.end` is the reason.

        Args:
            state: the state.

        Returns:
            Whether the learner is finished.
        """
        return state.trial is None

    def best(self, state: S) -> Row | None:
        """Return the best plan so far, by default the latest one that succeeded.

        Args:
            state: the state.

        Returns:
            Its row; None if no plan succeeded.
        """
        return next((row for row in reversed(state.rows) if row.result is Result.SUCCESS), None)

    def returned(self, state: S) -> Row | None:
        """Return the answer of the algorithm: the best plan, or a separate plan that was not executed as such.

        Args:
            state: the state.

        Returns:
            Its row; None if no plan succeeded.
        """
        last = state.rows[-1] if state.rows else None
        return last if last is not None and last.result is Result.NOT_EXECUTED else self.best(state)

    def history(self, state: S) -> tuple[Row, ...]:
        """Return every finished trial, in order.

        Args:
            state: the state.

        Returns:
            The rows.
        """
        return state.rows

    def dump(self, state: S) -> str:
        """Return the state as JSON, from which `load` restores exactly the same state.

        Args:
            state: the state.

        Returns:
            A JSON object.
        """
        return _adapter(self.state_type).dump_json(state).decode()

    def load(self, text: str) -> S:
        """Restore a state that `dump` wrote.

        Args:
            text: the JSON object.

        Returns:
            The state.
        """
        return _adapter(self.state_type).validate_json(text)


def _count(trial: Trial, outcome: Executed, speed: float) -> Trial:
    """Return the trial with one more execution; a sped-up one is kept apart."""
    if speed != 1.0:
        return replace(trial, sped_up=outcome.success)
    return replace(
        trial,
        successes=trial.successes + outcome.success,
        failures=trial.failures + (not outcome.success),
        errors=trial.errors + outcome.errors,
        failed=trial.failed if outcome.failure is None else (*trial.failed, outcome.failure),
    )


def tell_all(learner: Learner[S], state: S, outcomes: Iterable[Executed]) -> tuple[S, int]:
    """Tell a learner the executions of one request that were run together.

    They are told in the order of their numbers until the request changes; the rest is ignored. So the result does not
    depend on the number of executions that are run together.

    Args:
        learner: the learner.
        state: the state that the request is from.
        outcomes: the executions, in the order of their numbers.

    Returns:
        The next state, and the number of executions that were told.
    """
    asked = learner.ask(state)
    used = 0
    for outcome in outcomes:
        state = learner.tell(state, outcome)
        used += 1
        now = learner.ask(state)
        if asked is None or now is None or (now.belief, now.speed) != (asked.belief, asked.speed):
            break
    return state, used


_ADAPTERS: dict[type[State], TypeAdapter[Any]] = {}
"""Adapters that write and read the states of each learner; made once, because making one is slow."""


def _adapter(state_type: type[State]) -> TypeAdapter[Any]:
    if state_type not in _ADAPTERS:
        _ADAPTERS[state_type] = TypeAdapter(state_type)
    return _ADAPTERS[state_type]
