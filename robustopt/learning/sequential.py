"""A sequential test of a success rate: it may look after every execution and stops as soon as it is sure."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from math import log

from robustopt.confidence import log_evidence


class Verdict(Enum):
    """What a test says of a plan so far."""

    ACCEPTED = "accepted"
    REJECTED = "rejected"
    UNDECIDED = "undecided"
    OPEN = "open"


@dataclass(frozen=True)
class SequentialTest:
    """Test of "the success rate is at least `rate`", wrong with probability at most `level` when it accepts.

    It accepts when the evidence for a rate above `rate` reaches 1 / level, rejects when that for a rate below reaches
    1 / futility, and gives up as soon as it cannot accept within `limit` executions any more. A plan whose rate is at
    most `rate` is ever accepted with probability at most `level` (see `log_evidence`); giving up early only lowers
    that. A plan whose rate is at least `rate` is rejected with probability at most `futility`, which costs speed, not
    safety.
    """

    rate: float
    level: float
    futility: float
    limit: int

    def verdict(self, successes: int, failures: int) -> Verdict:
        if log_evidence(successes, failures, self.rate, above=True) >= -log(self.level):
            return Verdict.ACCEPTED
        if log_evidence(successes, failures, self.rate, above=False) >= -log(self.futility):
            return Verdict.REJECTED
        return Verdict.OPEN if self._in_reach(successes, failures) else Verdict.UNDECIDED

    def _in_reach(self, successes: int, failures: int) -> bool:
        """Whether it would accept if all executions up to the limit succeeded."""
        return log_evidence(self.limit - failures, failures, self.rate, above=True) >= -log(self.level)


def shortest_acceptance(rate: float, level: float) -> int:
    """Successes in a row after which a `SequentialTest` accepts: the least that any plan takes."""
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
