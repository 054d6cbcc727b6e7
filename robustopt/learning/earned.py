"""The confidence that successes in a row earn, in numbers and in a sentence."""

from __future__ import annotations

from dataclasses import dataclass

from robustopt.confidence import confidence_earned, lower_bound, successes_needed


@dataclass(frozen=True)
class Earned:
    """What `successes` executions in a row, and none failed, say of the success rate of a plan.

    rate, confidence: those that are asked about; lower: bound of the rate at that confidence for a plan that was tested
    alone; simultaneous: bound for the best of `tests` plans that were tested one after the other; earned: confidence
    in `rate`; needed: successes in a row that would show `rate` at `confidence`
    """

    successes: int
    rate: float
    confidence: float
    tests: int
    lower: float
    simultaneous: float
    earned: float
    needed: int

    @property
    def sentence(self) -> str:
        shown = "success shows" if self.successes == 1 else "successes in a row show"
        return (
            f"{self.successes} {shown} a success rate of at least {self.lower:.3g} at "
            f"{self.confidence:.3g} confidence, or {self.simultaneous:.3g} as the best of {self.tests} tested plans; "
            f"that it is at least {self.rate:.3g} has the confidence {self.earned:.3g}. "
            f"{self.rate:.3g} at {self.confidence:.3g} takes {self.needed} in a row."
        )


def earned(successes: int, rate: float, confidence: float = 0.95, tests: int = 1) -> Earned:
    """What successes in a row earn.

    A plan of rate r passes n executions with probability r^n, so r >= (1 - confidence)^(1/n), else something happened
    that has probability 1 - confidence. Of `tests` plans put to this, each with executions of its own, one that passes
    may owe it to luck more often; by the union bound, a level of (1 - confidence) / tests for each makes up for it.
    """
    return Earned(
        successes=successes,
        rate=rate,
        confidence=confidence,
        tests=tests,
        lower=lower_bound(successes, successes, confidence),
        simultaneous=lower_bound(successes, successes, 1 - (1 - confidence) / tests),
        earned=confidence_earned(successes, rate),
        needed=successes_needed(rate, confidence),
    )
