"""Sequential test of a success rate, evaluated after every execution until the evidence suffices."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from math import log

from robustopt.confidence import log_evidence


class Verdict(Enum):
    """The verdict of a test of a plan."""

    ACCEPTED = "accepted"
    REJECTED = "rejected"
    UNDECIDED = "undecided"
    OPEN = "open"


@dataclass(frozen=True)
class SequentialTest:
    """A test of "the success rate is at least `rate`" that accepts wrongly with probability at most `level`.

    The test accepts when the evidence for a rate above `rate` reaches 1 / level. It rejects when the evidence for a
    rate below `rate` reaches 1 / futility. It ends undecided as soon as it can no longer accept within `limit`
    executions.

    A plan with a rate of at most `rate` is ever accepted with probability at most `level` (see `log_evidence`); an
    early end only lowers this probability. A plan with a rate of at least `rate` is rejected with probability at most
    `futility`, which costs speed, not safety.

    Attributes:
        rate: success rate to be shown.
        level: largest probability of a wrong acceptance.
        futility: largest probability of a wrong rejection.
        limit: largest number of executions.
    """

    rate: float
    level: float
    futility: float
    limit: int

    def verdict(self, successes: int, failures: int) -> Verdict:
        """Return the state of the test after some executions.

        Args:
            successes: number of executions that succeeded.
            failures: number of executions that failed.

        Returns:
            The verdict; OPEN as long as the test needs further executions.
        """
        if log_evidence(successes, failures, self.rate, above=True) >= -log(self.level):
            return Verdict.ACCEPTED
        if log_evidence(successes, failures, self.rate, above=False) >= -log(self.futility):
            return Verdict.REJECTED
        return Verdict.OPEN if self._in_reach(successes, failures) else Verdict.UNDECIDED

    def _in_reach(self, successes: int, failures: int) -> bool:
        """Return whether the test would accept if all executions up to the limit succeeded."""
        return log_evidence(self.limit - failures, failures, self.rate, above=True) >= -log(self.level)


def shortest_acceptance(rate: float, level: float) -> int:
    """Return the number of successes in a row after which a `SequentialTest` accepts; no plan needs fewer executions.

    Args:
        rate: success rate to be shown.
        level: largest probability of a wrong acceptance.

    Returns:
        A number of executions.
    """
    high = 1
    while log_evidence(high, 0, rate, above=True) < -log(level):
        high *= 2
    low = high // 2
    while high - low > 1:
        middle = (low + high) // 2
        if log_evidence(middle, 0, rate, above=True) < -log(level):
            low = middle
        else:
            high = middle
    return high
