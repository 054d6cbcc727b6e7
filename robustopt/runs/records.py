"""Records of a run: its summary and its provenance, each one typed model.

A record is validated when it is made and when its file is read. The JSON file holds the fields that were given, so
that a plan has no empty section for executions.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from enum import StrEnum
from math import isfinite
from typing import Annotated, Any, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, JsonValue

from robustopt.interruption import INTERRUPTED


def plain_data(value: Any) -> Any:
    """Return dataclasses, mappings and arrays as dicts, lists and numbers, with None for a number that is not finite.

    JSON knows no infinity and no nan.

    Args:
        value: the value.
    """
    if is_dataclass(value):
        value = {entry.name: getattr(value, entry.name) for entry in fields(value)}
    if isinstance(value, Mapping):
        return {str(key): plain_data(inner) for key, inner in value.items()}
    if hasattr(value, "tolist"):
        value = value.tolist()
    if isinstance(value, (list, tuple)):
        return [plain_data(inner) for inner in value]
    return None if isinstance(value, float) and not isfinite(value) else value


Number = Annotated[float | None, BeforeValidator(plain_data)]
"""A number that is None if it is not finite."""

Plain = Annotated[JsonValue, BeforeValidator(plain_data)]
"""Any value that JSON can hold."""

Values = tuple[float, ...]


class Record(BaseModel):
    """Base of all records: immutable, without unknown fields, readable from the attributes of another object."""

    model_config = ConfigDict(frozen=True, extra="forbid", from_attributes=True)


class RunStatus(StrEnum):
    """How a run ended, with the exit code of its command; see the table in the documentation of the command line."""

    exit_code: int

    def __new__(cls, text: str, exit_code: int = 0) -> RunStatus:
        """Make a member that equals its text."""
        member = str.__new__(cls, text)
        member._value_, member.exit_code = text, exit_code
        return member

    SOLVED = "solved", 0
    LEARNED = "learned", 0
    INFEASIBLE = "infeasible", 3
    NO_PLAN = "no plan", 3
    NO_SUCCESS = "no success", 3
    ITERATION_LIMIT = "iteration limit", 4
    FAILED = "failed", 4
    CERTIFICATE_FAILED = "certificate failed", 4
    SIMULATION_FAILED = "simulation failed", 5
    INTERRUPTED = "interrupted", INTERRUPTED

    @property
    def good(self) -> bool:
        """Whether the run reached its purpose."""
        return self.exit_code == 0


# Plans ----------------------------------------------------------------------------------------------------


class ProblemSize(Record):
    """Size of a problem: grid, rows before and after redundant ones are removed, contacts."""

    collocation_points: int
    grid_points: int
    pieces: int
    rows: int
    rows_after_pruning: int
    joints: int
    objects: int
    contacts: int
    contact_systems: int
    friction_edges: int


class GridRecord(Record):
    """Estimated accuracy of a grid that the path has chosen, as in `robustopt.limits.grid.Accuracy`."""

    error: Number
    violation: Number
    enough: bool
    sentence: str


class WorstMargin(Record):
    """Smallest margin of a certificate; `margin` is None if no contact forces hold the limit."""

    limit: str
    margin: Number
    s: float
    t: float
    on_grid: bool
    parameters: dict[str, Plain]
    place: str = ""


class LimitMargin(Record):
    """Margins of one limit; None if no contact forces hold it."""

    on_grid: Number
    between: Number


class CertificateRecord(Record):
    """Result of a certificate, as in `robustopt.certificate.Certificate`."""

    passed: bool
    margin: Number
    worst: WorstMargin
    margins: dict[str, LimitMargin]
    level: str
    seed: int
    samples: int
    tests: int
    instants: int
    intervals: int
    seconds: float


class RemedyRecord(Record):
    """Change of one key that resolves a conflict."""

    key: str
    found: float
    needed: float
    limits: tuple[str, ...]
    enough: bool
    together: tuple[RemedyRecord, ...] = ()
    sentence: str


class DiagnosisRecord(Record):
    """Reason why a problem is infeasible, as in `robustopt.solvers.diagnosis.Diagnosis`."""

    point: int
    s: float
    place: str
    conflicts: tuple[tuple[str, ...], ...]
    places: tuple[str, ...] = ()
    remedies: tuple[RemedyRecord, ...]
    standstill: bool
    from_start: bool = False
    from_rest: bool
    at_speed: bool = False


# Executions -----------------------------------------------------------------------------------------------


class FirstFailure(Record):
    """Earliest failure of all trials: the trial, the kind, the object or joint, the time [s] and the place s."""

    trial: int
    status: str
    what: str
    t: float
    s: float


class FailuresRecord(Record):
    """Failures of the same kind and object, as in `robustopt.evidence.Failures`."""

    name: str
    count: int
    s: Number
    t: Number


class FeedbackRecord(Record):
    """Acceleration error of all trials, as in `robustopt.simulation.Feedback`."""

    mean: Values
    deviation: Values
    unfiltered_mean: Values
    unfiltered_deviation: Values
    trials: int
    samples: int


class ExecutionsRecord(Record):
    """Trials of a plan, as in `robustopt.simulation.Executions`."""

    trials: int
    requested: int
    successes: int
    confidence: float
    alike: bool
    statuses: dict[str, int]
    first_failure: FirstFailure | None
    failures: tuple[FailuresRecord, ...] = ()
    seed: int
    speed: float
    duration: float
    feedback: FeedbackRecord | None


# Learning -------------------------------------------------------------------------------------------------


class Iteration(Record):
    """One plan of a learner: its nominal values, the end of its executions, and the knowledge after it.

    Attributes:
        friction: nominal coefficient of friction, None if the learner leaves it alone.
        duration: of the plan [s], None without a plan.
        result: name of the result, None while the plan is under test.
        sped_up: success of the sped-up execution, None without it.
        friction_low, friction_high: interval of the coefficient of friction after the plan.
        K, share, planned_middle, planned_half_width: interval of the acceleration error that was planned for.
        error_mean, error_deviation: acceleration error of the executions.
        lower_bound, gap: of any plan that succeeds [s], and of the best plan to it, relative.
        parameters: learned values by their keys.
        failures: of its executions, by kind and object.
        bad_luck: probability that a plan which meets the success rate in question fails like this.
        incumbent: shortest plan so far that counts as a success [s].
        fresh_trials, fresh_successes, success_rate, success_low, success_high, fresh_statuses: fresh executions.
    """

    iteration: int
    friction: float | None = None
    duration: float | None = None
    result: str | None = None
    sped_up: bool | None = None
    friction_high: float | None = None
    friction_low: float | None = None
    successes: int = 0
    executions: int = 0
    K: float = 0.0
    share: float = 1.0
    planned_middle: Values = ()
    planned_half_width: Values = ()
    error_mean: Values = ()
    error_deviation: Values = ()
    lower_bound: float | None = None
    gap: float | None = None
    contradictions: int | None = None
    parameters: dict[str, float] = {}
    failures: tuple[FailuresRecord, ...] = ()
    bad_luck: float | None = None
    incumbent: float | None = None
    fresh_trials: int | None = None
    fresh_successes: int | None = None
    success_rate: float | None = None
    success_low: float | None = None
    success_high: float | None = None
    fresh_statuses: dict[str, int] = {}


class LearningRecord(Record):
    """Result of a learner, with all its plans and the failures of their executions at planned speed."""

    algorithm: str
    end: str
    iterations: int
    plans: int
    executions: int
    target_rate: float
    best: Iteration | None
    returned: Iteration | None
    confidence: str
    rows: tuple[Iteration, ...]
    failures: tuple[FailuresRecord, ...] = ()


# The files ------------------------------------------------------------------------------------------------


class Summary(Record):
    """Summary of a run: `summary.json`, and the text of `robustopt report`.

    Attributes:
        kind, name, status, message: the command, the task, how it ended, and the same in sentences.
        without_margin: sentence about the quantities for which the plan has no margin.
        method, duration: solver, and duration of the motion [s]; None without a plan.
        recorded: duration of the recording that the path follows; None without one [s].
        binding: share of the duration in which each limit binds.
        grid: accuracy of the grid; None if the number of its intervals was given.
        statistics: figures of the solution process.
        seconds: computing time of each step [s].
        success_rate, success_interval: of the executions, with their Clopper-Pearson interval.
        plan_of: run folder whose plan was executed.
    """

    kind: Literal["plan", "execution", "learning"]
    name: str
    status: RunStatus
    message: str
    without_margin: str | None = None
    method: str | None = None
    duration: float | None = None
    recorded: float | None = None
    binding: dict[str, float] = {}
    certificate: CertificateRecord | None = None
    diagnosis: DiagnosisRecord | None = None
    size: ProblemSize | None = None
    grid: GridRecord | None = None
    notes: tuple[str, ...] = ()
    statistics: dict[str, Number] = {}
    seconds: dict[str, float] = {}
    success_rate: Number = None
    success_interval: tuple[float, float] | None = None
    executions: ExecutionsRecord | None = None
    steps_per_second: Number = None
    plan_of: str | None = None
    learning: LearningRecord | None = None

    @property
    def rejected(self) -> bool:
        """Whether the plan failed its certificate."""
        return self.certificate is not None and not self.certificate.passed


class ModelFile(Record):
    """Robot model of a run; the hash covers the files that the model names."""

    name: str
    sha256: str


class Checkout(Record):
    """Commit of the checkout that the package was run from, and whether its files differ from it."""

    commit: str | None
    dirty: bool | None


class Machine(Record):
    """Machine that made a run."""

    system: str
    release: str
    architecture: str
    cpus: int | None


class Provenance(Record):
    """Origin of a run: `provenance.json`, with all that it takes to make the run again."""

    created: str
    arguments: tuple[str, ...]
    seed: int
    config_sha256: str
    robot_model: ModelFile
    waypoints_sha256: str | None
    versions: dict[str, str | None]
    git: Checkout | None
    machine: Machine
