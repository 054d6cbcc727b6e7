"""What successes and failures say about a success rate: exact bounds, numbers of executions, bad luck.

All bounds treat executions of one plan as independent with one success rate. Nothing here assumes more, in particular
no model of why an execution fails.
"""

from __future__ import annotations

from enum import Enum
from math import ceil, exp, isinf, lgamma, log, log1p

from scipy.special import betainc, betaincc, betaincinv, ndtr

from robustopt.errors import RobustOptError


class Reading(Enum):
    """How Phi(K) is read: the paper calls it the cumulative distribution, and speaks of the 68-95-99.7 rule."""

    ONE_SIDED = "one-sided"
    TWO_SIDED = "two-sided"


def phi(K: float, reading: Reading = Reading.ONE_SIDED) -> float:
    """Success rate Phi(K) that K deviations stand for: P(Z <= K), or P(|Z| <= K), Z standard normal.

    It is a statement about one sample of one joint; that a whole trajectory succeeds this often is no theorem.
    """
    return 1.0 - _tail(K, reading)


def paper_executions(K: float, reading: Reading = Reading.ONE_SIDED) -> int:
    """N_e(K) = ceil(1 / (1 - Phi(K))), the successes in a row that the paper asks for (section 5.2)."""
    return ceil(1.0 / _tail(K, reading))


def _tail(K: float, reading: Reading) -> float:
    """1 - Phi(K), without cancellation."""
    if not 0 <= K <= 6:
        raise RobustOptError(f"found K = {K:g}; expected a number of deviations between 0 and 6")
    return float(ndtr(-K)) * (1 if reading is Reading.ONE_SIDED else 2)


# Bounds of a success rate ---------------------------------------------------------------------------------


def clopper_pearson(successes: int, trials: int, confidence: float) -> tuple[float, float]:
    """Two-sided interval of a success rate that holds it at least with probability `confidence`.

    Each end is the one-sided bound at (1 + confidence) / 2 (Clopper and Pearson, 1934). With no trials it is [0, 1].
    """
    level = (1 + confidence) / 2
    return lower_bound(successes, trials, level), upper_bound(successes, trials, level)


def lower_bound(successes: int, trials: int, confidence: float) -> float:
    """One-sided exact lower bound: the rate p with P(Bin(trials, p) >= successes) = 1 - confidence."""
    _require_counts(successes, trials)
    if successes == 0:
        return 0.0
    return float(betaincinv(successes, trials - successes + 1, 1 - confidence))


def upper_bound(successes: int, trials: int, confidence: float) -> float:
    """One-sided exact upper bound: the rate p with P(Bin(trials, p) <= successes) = 1 - confidence."""
    return 1.0 - lower_bound(trials - successes, trials, confidence)


def successes_needed(rate: float, confidence: float) -> int:
    """Smallest n such that n successes in a row show a success rate of at least `rate`: rate^n <= 1 - confidence."""
    if not (0 < rate < 1 and 0 < confidence < 1):
        raise RobustOptError(f"found rate {rate:g}, confidence {confidence:g}; expected both between 0 and 1")
    n = max(1, round(log1p(-confidence) / log(rate)))
    while rate**n > 1 - confidence:
        n += 1
    while n > 1 and rate ** (n - 1) <= 1 - confidence:
        n -= 1
    return n


def confidence_earned(successes: int, rate: float) -> float:
    """Confidence in a success rate of at least `rate` after `successes` in a row: 1 - rate^n."""
    return 1.0 - rate**successes


def _require_counts(successes: int, trials: int) -> None:
    if not 0 <= successes <= trials:
        raise RobustOptError(
            f"found {successes} successes in {trials} executions; expected 0 <= successes <= executions"
        )


# Evidence about a success rate ----------------------------------------------------------------------------


def log_evidence(successes: int, failures: int, rate: float, above: bool) -> float:
    """Logarithm of the mean likelihood of all success rates above (or below) `rate`, over the likelihood of `rate`.

    E = int L(r) dr / (|R| L(rate)), L(r) = r^s (1 - r)^f, R = [rate, 1] or [0, rate], in closed form by the incomplete
    beta function. If the true rate is on the other side of `rate`, or is `rate`, E is a nonnegative supermartingale
    that starts at 1 as executions come in: each rate in R multiplies it in the mean by
    t r / rate + (1 - t) (1 - r) / (1 - rate) <= 1 for a true rate t on the other side. So it ever reaches 1 / alpha
    with probability at most alpha (Ville's inequality), whenever one looks and whenever one stops.
    """
    s, f = successes, failures
    part = float((betaincc if above else betainc)(s + 1, f + 1, rate))
    if part == 0.0:
        return float("-inf")
    mean = lgamma(s + 1) + lgamma(f + 1) - lgamma(s + f + 2) + log(part) - log(1 - rate if above else rate)
    return mean - s * log(rate) - f * log1p(-rate)


def bad_luck(successes: int, failures: int, rate: float, prior: float = 0.5) -> float:
    """Posterior probability that a plan's success rate is at least `rate`, so that its failures were bad luck.

    The prior gives `prior` to rates in [rate, 1] and the rest to [0, rate), evenly within each. With prior = 1 - rate
    it is even on [0, 1], and the result is P(Beta(s + 1, f + 1) >= rate).
    """
    if not 0 < prior < 1:
        raise RobustOptError(f"found prior {prior:g}; expected a number between 0 and 1")
    good = log_evidence(successes, failures, rate, above=True)
    bad = log_evidence(successes, failures, rate, above=False)
    if isinf(good) or isinf(bad):
        return 0.0 if isinf(good) else 1.0
    odds = log(prior) - log1p(-prior) + good - bad
    return 1.0 / (1.0 + exp(-odds)) if odds > 0 else exp(odds) / (1.0 + exp(odds))
