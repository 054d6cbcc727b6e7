"""Statistics of a success rate: exact bounds, numbers of executions, and evidence from successes and failures.

All functions assume that the executions of one plan are independent and have the same success rate. They assume
nothing else, in particular no model of why an execution fails.
"""

from __future__ import annotations

from enum import Enum
from math import ceil, exp, isinf, lgamma, log, log1p

from scipy.special import betainc, betaincc, betaincinv, ndtr

from robustopt.errors import RobustOptError


class Reading(Enum):
    """A definition of Phi(K): the paper's text has the cumulative distribution, and the 68-95-99.7 rule."""

    ONE_SIDED = "one-sided"
    TWO_SIDED = "two-sided"


def phi(K: float, reading: Reading = Reading.ONE_SIDED) -> float:
    """Return the success rate Phi(K) that K standard deviations stand for.

    Phi(K) = P(Z <= K) (one-sided) or P(|Z| <= K) (two-sided), Z standard normal. It describes one sample of one joint;
    that a whole trajectory succeeds at this rate is not a theorem.

    Args:
        K: number of standard deviations, from 0 to 6.
        reading: the definition of Phi.

    Returns:
        A probability.

    Raises:
        RobustOptError: K is not between 0 and 6.
    """
    return 1.0 - _tail(K, reading)


def paper_executions(K: float, reading: Reading = Reading.ONE_SIDED) -> int:
    """Return N_e(K) = ceil(1 / (1 - Phi(K))), the successes in a row that a plan needs (paper, section 5.2).

    Args:
        K: number of standard deviations, from 0 to 6.
        reading: the definition of Phi.

    Returns:
        A number of executions.

    Raises:
        RobustOptError: K is not between 0 and 6.
    """
    return ceil(1.0 / _tail(K, reading))


def _tail(K: float, reading: Reading) -> float:
    """Return 1 - Phi(K), without cancellation."""
    if not 0 <= K <= 6:
        raise RobustOptError(f"found K = {K:g}; expected a number of standard deviations between 0 and 6")
    return float(ndtr(-K)) * (1 if reading is Reading.ONE_SIDED else 2)


# Bounds of a success rate ---------------------------------------------------------------------------------


def clopper_pearson(successes: int, trials: int, confidence: float) -> tuple[float, float]:
    """Return a two-sided interval that contains the success rate with at least a given probability.

    Each end is the one-sided bound at (1 + confidence) / 2 (Clopper and Pearson, 1934).

    Args:
        successes: number of executions that succeeded.
        trials: number of executions.
        confidence: probability, between 0 and 1.

    Returns:
        The lower and the upper end; [0, 1] for no trials.

    Raises:
        RobustOptError: there are more successes than trials, or fewer than none.
    """
    level = (1 + confidence) / 2
    return lower_bound(successes, trials, level), upper_bound(successes, trials, level)


def lower_bound(successes: int, trials: int, confidence: float) -> float:
    """Return the exact one-sided lower bound, the rate p with P(Bin(trials, p) >= successes) = 1 - confidence.

    Args:
        successes: number of executions that succeeded.
        trials: number of executions, fixed beforehand.
        confidence: probability, between 0 and 1.

    Returns:
        A success rate.

    Raises:
        RobustOptError: there are more successes than trials, or fewer than none.
    """
    _require_counts(successes, trials)
    if successes == 0:
        return 0.0
    return float(betaincinv(successes, trials - successes + 1, 1 - confidence))


def upper_bound(successes: int, trials: int, confidence: float) -> float:
    """Return the exact one-sided upper bound, the rate p with P(Bin(trials, p) <= successes) = 1 - confidence.

    Args:
        successes: number of executions that succeeded.
        trials: number of executions, fixed beforehand.
        confidence: probability, between 0 and 1.

    Returns:
        A success rate.

    Raises:
        RobustOptError: there are more successes than trials, or fewer than none.
    """
    return 1.0 - lower_bound(trials - successes, trials, confidence)


def successes_needed(rate: float, confidence: float) -> int:
    """Return the smallest number n of successes in a row that shows a success rate: rate^n <= 1 - confidence.

    Args:
        rate: success rate to be shown, between 0 and 1.
        confidence: probability, between 0 and 1.

    Returns:
        A number of executions.

    Raises:
        RobustOptError: the rate or the confidence is not between 0 and 1.
    """
    if not (0 < rate < 1 and 0 < confidence < 1):
        raise RobustOptError(f"found rate {rate:g}, confidence {confidence:g}; expected both between 0 and 1")
    n = max(1, round(log1p(-confidence) / log(rate)))
    while rate**n > 1 - confidence:
        n += 1
    while n > 1 and rate ** (n - 1) <= 1 - confidence:
        n -= 1
    return n


def confidence_earned(successes: int, rate: float) -> float:
    """Return the confidence in a success rate after successes in a row, 1 - rate^n.

    Args:
        successes: number n of executions, all of which succeeded.
        rate: success rate to be shown, between 0 and 1.

    Returns:
        A probability.
    """
    return 1.0 - rate**successes


def _require_counts(successes: int, trials: int) -> None:
    if not 0 <= successes <= trials:
        raise RobustOptError(
            f"found {successes} successes in {trials} executions; expected 0 <= successes <= executions"
        )


# Evidence about a success rate ----------------------------------------------------------------------------


def log_evidence(successes: int, failures: int, rate: float, above: bool) -> float:
    """Return the logarithm of the evidence that a success rate is above (or below) a given one.

    The evidence is the mean likelihood of all rates on that side over the likelihood of the given one,

        E = int_R L(r) dr / (|R| L(rate)),   L(r) = r^s (1 - r)^f,   R = [rate, 1] or [0, rate],

    in closed form by the incomplete beta function. If the actual rate t lies on the other side, or equals `rate`, then
    E is a nonnegative supermartingale that starts at 1: each r in R multiplies it in the mean by
    t r / rate + (1 - t) (1 - r) / (1 - rate) <= 1. So E ever reaches 1 / alpha with probability at most alpha (Ville's
    inequality), whenever one looks and whenever one stops.

    Args:
        successes: number s of executions that succeeded.
        failures: number f of executions that failed.
        rate: success rate, between 0 and 1.
        above: whether R is [rate, 1]; else [0, rate].

    Returns:
        log E; -inf if the likelihood on that side underflows.
    """
    s, f = successes, failures
    part = float((betaincc if above else betainc)(s + 1, f + 1, rate))
    if part == 0.0:
        return float("-inf")
    mean = lgamma(s + 1) + lgamma(f + 1) - lgamma(s + f + 2) + log(part) - log(1 - rate if above else rate)
    return mean - s * log(rate) - f * log1p(-rate)


def probability_of_rate(successes: int, failures: int, rate: float, prior: float = 0.5) -> float:
    """Return the posterior probability that a plan has at least a given success rate, despite its failures.

    The prior gives `prior` to rates in [rate, 1] and the rest to [0, rate), evenly within each. With prior = 1 - rate
    it is even on [0, 1], and the result is P(Beta(s + 1, f + 1) >= rate).

    Args:
        successes: number s of executions that succeeded.
        failures: number f of executions that failed.
        rate: success rate, between 0 and 1.
        prior: prior probability of a rate of at least `rate`, between 0 and 1.

    Returns:
        A probability.

    Raises:
        RobustOptError: the prior is not between 0 and 1.
    """
    if not 0 < prior < 1:
        raise RobustOptError(f"found prior {prior:g}; expected a number between 0 and 1")
    good = log_evidence(successes, failures, rate, above=True)
    bad = log_evidence(successes, failures, rate, above=False)
    if isinf(good) or isinf(bad):
        return 0.0 if isinf(good) else 1.0
    odds = log(prior) - log1p(-prior) + good - bad
    return 1.0 / (1.0 + exp(-odds)) if odds > 0 else exp(odds) / (1.0 + exp(odds))
