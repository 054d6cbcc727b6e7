"""Errors that robustopt raises.

RobustOptError
├── ConfigError            the configuration cannot be used (exit code 2)
│   ├── RobotError         the robot's model file, its tool or its limits
│   └── PathError          the path is unreachable, leaves a limit, jumps or collides
├── Infeasible             no timing of the path satisfies the limits (exit code 3)
├── SolverFailed           a solver stopped without an answer, or its plan failed the certificate (exit code 4)
├── SimulationFailed       a plan cannot be simulated, or its simulation fails in every trial (exit code 5)
└── RunFolderError         a run folder cannot be written or read (exit code 2)
    └── RunInUse           another process is at work on the run

Expected outcomes, such as an infeasible problem or an iteration limit, are statuses of a `Plan`. `Infeasible` and
`SolverFailed` are raised by functions that need a timing and have none.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass


class RobustOptError(Exception):
    """Base of all errors of this package."""

    exit_code = 1


@dataclass(frozen=True)
class ConfigProblem:
    """One mistake in a configuration: its key, a message with the remedy, and its place in the file."""

    key: str
    message: str
    location: str = ""

    def __str__(self) -> str:
        return ": ".join(filter(None, (self.location, self.key, self.message)))


class ConfigError(RobustOptError):
    """The configuration cannot be used; `problems` lists every mistake that was found."""

    exit_code = 2

    def __init__(self, problems: Sequence[ConfigProblem] | str, key: str = "") -> None:
        """Make an error of several mistakes, or of one message about one key."""
        if isinstance(problems, str):
            problems = [ConfigProblem(key=key, message=problems)]
        self.problems = tuple(problems)
        super().__init__("\n".join(str(problem) for problem in self.problems))

    def __reduce__(self) -> tuple[type[ConfigError], tuple[tuple[ConfigProblem, ...]]]:
        """Return the parts from which another process makes the same error."""
        return type(self), (self.problems,)


class RobotError(ConfigError):
    """The robot's model file, its tool or its limits cannot be used."""


class PathError(ConfigError):
    """The path is unreachable, leaves a joint limit, jumps to another branch or collides."""


class Infeasible(RobustOptError):
    """No timing of the path satisfies the limits for every value in the intervals."""

    exit_code = 3


class SolverFailed(RobustOptError):
    """A solver stopped without an answer, or its plan failed the certificate."""

    exit_code = 4


class SimulationFailed(RobustOptError):
    """A plan cannot be simulated, or its simulation fails in every trial."""

    exit_code = 5


class RunFolderError(RobustOptError):
    """A run folder cannot be written or read."""

    exit_code = 2


class RunInUse(RunFolderError):
    """Another process is at work on the run."""
