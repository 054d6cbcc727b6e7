"""The contract of all learners: ask what to plan or run next, tell what came of it, read what is known so far.

A learner is an immutable value with its settings; what it has seen is an immutable `State`. `ask` and `tell` are pure
functions of that state, so a state that was stored and read again has the same future. Learners know neither planner
nor robot: a request names beliefs to plan with, an outcome is a duration or a success with the errors that were seen.

    state = learner.initial()
    while (request := learner.ask(state)) is not None:
        state = learner.tell(state, outcome_of(request))
    learner.best(state)
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from enum import Enum
from typing import Any, ClassVar, Generic, TypeVar

from pydantic import TypeAdapter

from robustopt.errors import RobustOptError
from robustopt.learning.moments import ErrorInterval, Moments, Values


@dataclass(frozen=True)
class Belief:
    """What a plan is made with in place of what the configuration says; None leaves that as it is.

    friction: coefficient of friction of all learned interfaces; error: interval of joint acceleration error;
    parameters: other values by their keys in the configuration, such as ("contact.friction.upper", 0.31)
    """

    friction: float | None = None
    error: ErrorInterval | None = None
    parameters: tuple[tuple[str, float], ...] = ()


@dataclass(frozen=True)
class Request:
    """What a learner wants next.

    belief: what to plan with; the plan of a belief is always the same, so it is made once
    executions: 0 asks for the plan alone; else run the plan, and tell each execution in turn, until the learner asks
        for something else, which it does after this many at the latest
    speed: the plan is run this many times as fast
    first: number of the next execution of this learner, from 0; random streams belong to these numbers
    """

    belief: Belief
    executions: int
    speed: float
    first: int


@dataclass(frozen=True)
class Planned:
    """Outcome of a request for a plan: its duration [s], or None where there is no plan."""

    duration: float | None


@dataclass(frozen=True)
class Executed:
    """Outcome of one execution; errors: of its motion samples alone, empty where it gave none."""

    success: bool
    errors: Moments = field(default_factory=Moments)


Outcome = Planned | Executed


class Result(Enum):
    """What became of a plan that a learner asked for."""

    SUCCESS = "success"
    FAILURE = "failure"
    UNDECIDED = "undecided"
    INFEASIBLE = "infeasible"
    NOT_FASTER = "not faster"
    NOT_EXECUTED = "not executed"

    @property
    def sentence(self) -> str:
        return {
            Result.SUCCESS: "The executions met what the learner asks of them.",
            Result.FAILURE: "The executions did not meet what the learner asks of them.",
            Result.UNDECIDED: "The executions allowed did not decide, which counts as a failure.",
            Result.INFEASIBLE: "There is no plan for this belief.",
            Result.NOT_FASTER: "The plan is hardly faster than the best one, so it was not executed.",
            Result.NOT_EXECUTED: "What the algorithm returns; it was planned, but not executed as such.",
        }[self]


class End(Enum):
    """Why a learner is finished."""

    NEAR_OPTIMAL = "near-optimal"
    INTERVAL = "interval"
    STABLE = "stable"
    ITERATION_LIMIT = "iteration limit"
    GAP = "gap"
    BOXES = "boxes"
    BUDGET = "budget"
    NO_SUCCESS = "no success"
    NO_PLAN = "no plan"

    @property
    def sentence(self) -> str:
        return {
            End.NEAR_OPTIMAL: "The sped-up execution failed, so the plan is near-optimal.",
            End.INTERVAL: "The interval of the coefficient of friction is as small as was asked for.",
            End.STABLE: "The interval of the acceleration error is stable.",
            End.ITERATION_LIMIT: "The interval of the acceleration error did not settle in the iterations allowed.",
            End.GAP: "The best plan is as close to the lower bound as was asked for.",
            End.BOXES: "No undecided box of parameters is larger than was asked for.",
            End.BUDGET: "The executions allowed are used up.",
            End.NO_SUCCESS: "No plan that was tested succeeded.",
            End.NO_PLAN: "There is no plan, even for the most optimistic belief.",
        }[self]


@dataclass(frozen=True)
class Trial:
    """A plan under test: its belief, its duration once it is planned [s], and what its executions showed.

    successes, failures: of executions at planned speed; sped_up: success of the one that is faster, None without it;
    errors: of the executions at planned speed
    """

    belief: Belief
    duration: float | None = None
    successes: int = 0
    failures: int = 0
    sped_up: bool | None = None
    errors: Moments = field(default_factory=Moments)

    @property
    def executions(self) -> int:
        return self.successes + self.failures + (self.sped_up is not None)

    @property
    def friction(self) -> float:
        """The coefficient of friction of a learner that moves it."""
        assert self.belief.friction is not None
        return self.belief.friction


@dataclass(frozen=True)
class Row:
    """A trial that is over, with what the learner knows after it.

    iteration: from 1; attempts with shrunk error intervals, and what is returned at the end, share it with the others
        of their iteration
    low, high: interval of the coefficient of friction after it, None where the learner has none
    lower_bound: of the duration of any plan that succeeds, after it [s]; gap: of the best plan to it, relative;
    contradictions: successes below failures so far, in pairs; None where the learner has none of these
    """

    iteration: int
    trial: Trial
    result: Result
    low: float | None = None
    high: float | None = None
    lower_bound: float | None = None
    gap: float | None = None
    contradictions: int | None = None

    def record(self) -> dict[str, float | int | str | bool | Values | dict[str, float] | None]:
        """The paper's columns (Table 1) and what stands behind them, as plain values."""
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
        }


@dataclass(frozen=True)
class State:
    """What every learner has seen: trials that are over, the one under way (None: finished), executions so far."""

    rows: tuple[Row, ...] = ()
    trial: Trial | None = None
    executed: int = 0
    end: End | None = None


S = TypeVar("S", bound=State)


class Learner(ABC, Generic[S]):
    """A learner: settings in its own fields, what it has seen in a state of `state_type`."""

    name: ClassVar[str]
    state_type: ClassVar[type[State]]

    # What a learner defines ------------------------------------------------------------------------------

    @abstractmethod
    def initial(self) -> S:
        """The state before anything is planned."""

    @abstractmethod
    def _wanted(self, state: S, trial: Trial) -> tuple[int, float]:
        """Largest number of further executions of the plan under test, at least 1, and their speed."""

    @abstractmethod
    def _infeasible(self, state: S, trial: Trial) -> S:
        """The state after the belief under test turned out to have no plan."""

    @abstractmethod
    def _executed(self, state: S, trial: Trial) -> S:
        """The state after an execution, which is counted in `trial` already."""

    def _planned(self, state: S, trial: Trial) -> S:
        """The state after the belief under test was planned; by default the plan is executed next."""
        return replace(state, trial=trial)

    # What all learners share -----------------------------------------------------------------------------

    def ask(self, state: S) -> Request | None:
        """What to plan or to run next; None when finished."""
        trial = state.trial
        if trial is None:
            return None
        if trial.duration is None:
            return Request(trial.belief, 0, 1.0, state.executed)
        executions, speed = self._wanted(state, trial)
        return Request(trial.belief, executions, speed, state.executed)

    def tell(self, state: S, outcome: Outcome) -> S:
        """The state after the outcome of what was asked; the given state stays as it is.

        Raises RobustOptError where the outcome does not answer what was asked.
        """
        trial = state.trial
        if trial is None:
            raise RobustOptError(f"{self.name}: told an outcome after its end; expected nothing more")
        if isinstance(outcome, Planned):
            if trial.duration is not None:
                raise RobustOptError(f"{self.name}: told a plan; expected an execution, which is what was asked for")
            if outcome.duration is None:
                return self._infeasible(state, trial)
            return self._planned(state, replace(trial, duration=float(outcome.duration)))
        if trial.duration is None:
            raise RobustOptError(f"{self.name}: told an execution; expected a plan, which is what was asked for")
        counted = replace(state, executed=state.executed + 1)
        return self._executed(counted, _count(trial, outcome, self._wanted(state, trial)[1]))

    def finished(self, state: S) -> bool:
        """Whether nothing is left to ask; `state.end` says why."""
        return state.trial is None

    def best(self, state: S) -> Row | None:
        """The latest plan that succeeded, which is the best so far; None without one."""
        return next((row for row in reversed(state.rows) if row.result is Result.SUCCESS), None)

    def returned(self, state: S) -> Row | None:
        """What the algorithm returns: the best plan, but where it returns one that was not executed as such, that."""
        last = state.rows[-1] if state.rows else None
        return last if last is not None and last.result is Result.NOT_EXECUTED else self.best(state)

    def history(self, state: S) -> tuple[Row, ...]:
        """Every trial that is over, in order."""
        return state.rows

    def dump(self, state: S) -> str:
        """The state as JSON; `load` gives exactly the same state."""
        return _adapter(self.state_type).dump_json(state).decode()

    def load(self, text: str) -> S:
        """The state that `dump` wrote."""
        return _adapter(self.state_type).validate_json(text)


def _count(trial: Trial, outcome: Executed, speed: float) -> Trial:
    """The trial with one more execution; one at another speed than the planned one is kept apart."""
    if speed != 1.0:
        return replace(trial, sped_up=outcome.success)
    return replace(
        trial,
        successes=trial.successes + outcome.success,
        failures=trial.failures + (not outcome.success),
        errors=trial.errors + outcome.errors,
    )


def tell_all(learner: Learner[S], state: S, outcomes: Iterable[Executed]) -> tuple[S, int]:
    """Tell executions of one request that were run together, and how many of them counted.

    They are told in the order of their numbers until the learner asks for something else; what was run beyond that is
    not looked at, so that any number of workers gives what one gives.
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
"""How the states of each learner are written and read; made once, because making one is slow."""


def _adapter(state_type: type[State]) -> TypeAdapter[Any]:
    if state_type not in _ADAPTERS:
        _ADAPTERS[state_type] = TypeAdapter(state_type)
    return _ADAPTERS[state_type]
