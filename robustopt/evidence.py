"""What an execution shows besides its success: its first failure, and how far each object moved."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from statistics import median

_BETWEEN = {"tipped": "over", "fell": "off", "lost contact": "with", "lost grip": "at", "slid in grip": "at"}
"""Words between what failed and what it was in contact with, by the kind of the failure; `on` for all others."""

UNKNOWN = "failure"
"""Kind of an unspecified failure."""

DIVERGED = "simulation diverged"
"""Kind of a failure of the simulation itself, which says nothing of the world."""


@dataclass(frozen=True)
class Failure:
    """First failure of an execution, as far as it is known.

    Attributes:
        kind: the way it failed, a value of `robustopt.simulation.Status`; `UNKNOWN` if it is not specified.
        what: object, contact or joint that failed; empty if unknown.
        against: support or holder that it was in contact with; empty without one, or if unknown.
        t: time since the start of the motion [s]; None if unknown.
        s: planned position along the path at that time; None if unknown.
    """

    kind: str = UNKNOWN
    what: str = ""
    against: str = ""
    t: float | None = None
    s: float | None = None

    @property
    def name(self) -> str:
        """Kind, object and interface in words, such as `tipped: upper over lower`."""
        place = f" {_BETWEEN.get(self.kind, 'on')} {self.against}" if self.what and self.against else ""
        return f"{self.kind}: {self.what}{place}" if self.what else self.kind


@dataclass(frozen=True)
class Peak:
    """Largest movement of an object, an environment contact or the floating base in an execution.

    Attributes:
        name: its name.
        slip: largest movement along its support, cup or pad [m]; None where it does not apply.
        tilt: largest angle from its planned orientation [rad]; None where it does not apply.
    """

    name: str
    slip: float | None = None
    tilt: float | None = None


@dataclass(frozen=True)
class Failures:
    """Failures of the same kind and object in several executions.

    Attributes:
        name: kind, object and interface in words.
        count: number of executions that failed so.
        s: median position along the path; None if no position is known.
        t: median time since the start of the motion [s]; None if no time is known.
    """

    name: str
    count: int
    s: float | None
    t: float | None

    @property
    def place(self) -> str:
        """Median position and time in words; empty if they are unknown."""
        known = (("s", self.s, ".2f", ""), ("t", self.t, ".2f", " s"))
        return ", ".join(f"{name} = {value:{form}}{unit}" for name, value, form, unit in known if value is not None)


def grouped(failures: Iterable[Failure]) -> tuple[Failures, ...]:
    """Return failures grouped by name, the most frequent one first.

    Args:
        failures: the first failure of each execution that failed.
    """
    groups: dict[str, list[Failure]] = {}
    for failure in failures:
        groups.setdefault(failure.name, []).append(failure)
    found = [
        Failures(name, len(some), _median(item.s for item in some), _median(item.t for item in some))
        for name, some in groups.items()
    ]
    return tuple(sorted(found, key=lambda group: (-group.count, group.name)))


def _median(values: Iterable[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return median(known) if known else None
