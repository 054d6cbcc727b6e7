"""The confidence that successes in a row earn, in numbers and in a sentence."""

from __future__ import annotations

from dataclasses import dataclass

from robustopt.confidence import confidence_earned, lower_bound, successes_needed


@dataclass(frozen=True)
class Earned:
    """The statements about a plan's success rate that follow from successes in a row without a failure.

    Attributes:
        successes: number of executions, all of which succeeded.
        rate: success rate in question.
        confidence: confidence in question.
        tests: number of plans that were tested one after the other.
        lower: lower bound of the rate at this confidence, for a plan that was tested alone.
        simultaneous: lower bound of the rate at this confidence, for the best of all tested plans.
        earned: confidence that the rate is at least the rate in question.
        needed: successes in a row that would show the rate in question at the confidence in question.
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
        """The statements in words."""
        shown = "success shows" if self.successes == 1 else "successes in a row show"
        return (
            f"{self.successes} {shown} a success rate of at least {self.lower:.3g} at "
            f"{self.confidence:.3g} confidence, or {self.simultaneous:.3g} as the best of {self.tests} tested plans; "
            f"that it is at least {self.rate:.3g} has the confidence {self.earned:.3g}. "
            f"To show {self.rate:.3g} at {self.confidence:.3g} confidence takes {self.needed} in a row."
        )


def earned(successes: int, rate: float, confidence: float = 0.95, tests: int = 1) -> Earned:
    """Return the statements that follow from successes in a row.

    A plan of rate r passes n executions with probability r^n, so r >= (1 - confidence)^(1/n) unless an event of
    probability 1 - confidence has happened. If several plans are tested, each with executions of its own, it is more
    likely that one of a lower rate passes. By the union bound, a level of (1 - confidence) / tests for each compensates
    for this.

    Args:
        successes: number n of executions, all of which succeeded.
        rate: success rate in question.
        confidence: confidence in question.
        tests: number of plans that were tested one after the other.

    Returns:
        The statements.

    Raises:
        RobustOptError: the rate or the confidence is not between 0 and 1.
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
