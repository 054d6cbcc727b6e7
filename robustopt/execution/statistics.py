"""How sure a success rate is."""

from __future__ import annotations

from scipy.stats import beta


def clopper_pearson(successes: int, trials: int, confidence: float) -> tuple[float, float]:
    """Interval of the success probability that holds it at least with probability `confidence`.

    Clopper and Pearson (1934): the ends are quantiles of Beta(k, n - k + 1) and Beta(k + 1, n - k). With no trials
    it is [0, 1].
    """
    tail = (1 - confidence) / 2
    low = 0.0 if successes == 0 else float(beta.ppf(tail, successes, trials - successes + 1))
    high = 1.0 if successes == trials else float(beta.isf(tail, successes + 1, trials - successes))
    return low, high
