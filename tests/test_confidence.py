"""Confidence: exact bounds against closed forms and scipy, evidence against integrals, the test against its own law."""

from math import exp, inf, log

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad
from scipy.stats import beta, binom, binomtest, norm
from synthetic_worlds import acceptance_probability

from robustopt.confidence import (
    Reading,
    clopper_pearson,
    confidence_earned,
    log_evidence,
    lower_bound,
    paper_executions,
    phi,
    probability_of_rate,
    successes_needed,
    upper_bound,
)
from robustopt.errors import RobustOptError
from robustopt.learning.earned import earned
from robustopt.learning.sequential import SequentialTest, Verdict, shortest_acceptance

RATES = st.floats(0.01, 0.99)
LEVELS = st.floats(0.01, 0.999)
COUNTS = st.tuples(st.integers(0, 300), st.integers(0, 300))


@pytest.mark.parametrize(
    ("K", "one_sided", "two_sided"), [(0.0, 2, 1), (0.5, 4, 2), (1.0, 7, 4), (2.0, 44, 22), (3.0, 741, 371)]
)
def test_executions_of_the_paper_by_both_readings(K, one_sided, two_sided):
    assert paper_executions(K) == one_sided
    assert paper_executions(K, Reading.TWO_SIDED) == two_sided


@given(st.floats(0, 6))
def test_phi_is_the_normal_distribution(K):
    assert phi(K) == pytest.approx(norm.cdf(K), rel=1e-12)
    assert phi(K, Reading.TWO_SIDED) == pytest.approx(norm.cdf(K) - norm.cdf(-K), rel=1e-12, abs=1e-12)


@pytest.mark.parametrize("K", [-0.1, 7.0, float("nan")])
def test_deviations_have_bounds(K):
    with pytest.raises(RobustOptError, match="deviations between 0 and 6"):
        paper_executions(K)


def test_what_the_successes_of_the_paper_are_worth():
    assert lower_bound(7, 7, 0.95) == pytest.approx(0.05 ** (1 / 7), rel=1e-12)
    assert lower_bound(7, 7, 0.95) == pytest.approx(0.652, abs=5e-4)
    earned = {K: confidence_earned(paper_executions(K), phi(K)) for K in (0.5, 1.0, 2.0, 3.0)}
    assert earned == pytest.approx({0.5: 0.771, 1.0: 0.702, 2.0: 0.637, 3.0: 0.632}, abs=1e-3)
    assert earned[3.0] == pytest.approx(1 - exp(-1), abs=1e-3)
    needed = {K: successes_needed(phi(K), 0.95) for K in (0.5, 1.0, 2.0, 3.0)}
    assert needed == {0.5: 9, 1.0: 18, 2.0: 131, 3.0: 2218}


@given(st.integers(1, 500), LEVELS)
def test_bounds_of_straight_runs_are_powers(n, confidence):
    assert lower_bound(n, n, confidence) == pytest.approx((1 - confidence) ** (1 / n), rel=1e-9)
    assert upper_bound(0, n, confidence) == pytest.approx(1 - (1 - confidence) ** (1 / n), rel=1e-9)
    assert lower_bound(0, n, confidence) == 0
    assert upper_bound(n, n, confidence) == 1


@given(COUNTS, LEVELS)
def test_clopper_pearson_is_that_of_scipy(counts, confidence):
    successes, failures = counts
    trials = successes + failures
    if trials == 0:
        assert clopper_pearson(0, 0, confidence) == (0, 1)
        return
    theirs = binomtest(successes, trials).proportion_ci(confidence, method="exact")
    assert clopper_pearson(successes, trials, confidence) == pytest.approx((theirs.low, theirs.high), abs=1e-9)


@given(COUNTS, LEVELS)
def test_a_bound_is_the_rate_that_makes_the_outcome_as_unlikely_as_was_allowed(counts, confidence):
    successes, failures = counts
    low = lower_bound(successes, successes + failures, confidence)
    if successes:
        assert binom.sf(successes - 1, successes + failures, low) == pytest.approx(1 - confidence, rel=1e-6)


def test_counts_that_cannot_be():
    with pytest.raises(RobustOptError, match="3 successes in 2 executions"):
        lower_bound(3, 2, 0.95)


@pytest.mark.parametrize(("rate", "n"), [(0.7, 9), (0.9, 29), (0.95, 59), (0.99, 299), (0.999, 2995)])
def test_successes_needed_at_95_percent(rate, n):
    assert successes_needed(rate, 0.95) == n


@given(RATES, st.floats(0.01, 0.9999))
def test_successes_needed_is_the_least(rate, confidence):
    n = successes_needed(rate, confidence)
    assert rate**n <= 1 - confidence
    assert n == 1 or rate ** (n - 1) > 1 - confidence


@pytest.mark.parametrize(("rate", "confidence"), [(0, 0.9), (1, 0.9), (0.9, 0), (0.9, 1)])
def test_certainty_cannot_be_bought(rate, confidence):
    with pytest.raises(RobustOptError, match="between 0 and 1"):
        successes_needed(rate, confidence)


# Evidence -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("above", [True, False])
@given(counts=st.tuples(st.integers(0, 40), st.integers(0, 40)), rate=st.floats(0.05, 0.95))
def test_evidence_is_the_mean_likelihood_ratio(above, counts, rate):
    s, f = counts
    ends = (rate, 1.0) if above else (0.0, rate)
    ratio, _ = quad(lambda r: (r / rate) ** s * ((1 - r) / (1 - rate)) ** f, *ends, epsabs=0, epsrel=1e-10, limit=500)
    assert exp(log_evidence(s, f, rate, above)) == pytest.approx(ratio / (ends[1] - ends[0]), rel=1e-6)


def test_evidence_of_straight_successes_in_closed_form():
    for n in (0, 1, 7, 100):
        expected = (1 - 0.9 ** (n + 1)) / ((n + 1) * 0.1 * 0.9**n)
        assert exp(log_evidence(n, 0, 0.9, above=True)) == pytest.approx(expected, rel=1e-10)


@given(counts=st.tuples(st.integers(0, 200), st.integers(0, 200)), rate=st.floats(0.05, 0.95), part=st.floats(0, 1))
def test_evidence_grows_in_the_mean_only_for_rates_on_its_side(counts, rate, part):
    """One step ahead: a martingale at `rate`, a supermartingale for true rates on the other side."""
    s, f = counts
    for above, truth in ((True, rate * part), (False, rate + (1 - rate) * part)):
        now = log_evidence(s, f, rate, above)
        if now == -inf:
            continue
        up, down = (exp(log_evidence(s + i, f + 1 - i, rate, above) - now) for i in (1, 0))
        assert rate * up + (1 - rate) * down == pytest.approx(1, rel=1e-8)
        assert truth * up + (1 - truth) * down <= 1 + 1e-8


@given(COUNTS, st.floats(0.05, 0.95))
def test_the_probability_of_a_rate_with_an_even_prior_is_the_beta_posterior(counts, rate):
    s, f = counts
    assert probability_of_rate(s, f, rate, prior=1 - rate) == pytest.approx(
        beta.sf(rate, s + 1, f + 1), rel=1e-6, abs=1e-12
    )


def test_the_probability_of_a_rate_without_executions_is_the_prior():
    assert probability_of_rate(0, 0, 0.8, prior=0.3) == pytest.approx(0.3)


@given(COUNTS, st.floats(0.05, 0.95), st.floats(0.01, 0.99))
def test_the_probability_of_a_rate_grows_with_successes_and_falls_with_failures(counts, rate, prior):
    s, f = counts
    here = probability_of_rate(s, f, rate, prior)
    assert 0 <= here <= 1
    assert probability_of_rate(s + 1, f, rate, prior) >= here - 1e-12
    assert probability_of_rate(s, f + 1, rate, prior) <= here + 1e-12


def test_the_probability_of_a_rate_needs_a_prior():
    with pytest.raises(RobustOptError, match="prior 1"):
        probability_of_rate(1, 1, 0.5, prior=1.0)


# The sequential test --------------------------------------------------------------------------------------


@pytest.mark.parametrize(("rate", "level"), [(0.5, 0.05), (0.7, 0.01), (0.9, 0.05), (0.9, 0.0018), (0.99, 0.05)])
def test_exact_error_of_the_sequential_test(rate, level):
    """By the law of the random walk of successes and failures, without simulation."""
    limit = 3 * shortest_acceptance(rate, level)
    test = SequentialTest(rate, level, 0.05, limit)
    at_rate = acceptance_probability(test, rate)
    assert 0.05 * level < at_rate <= level
    assert acceptance_probability(test, 0.98 * rate) < at_rate
    assert acceptance_probability(test, 1.0) == 1


@pytest.mark.parametrize("rate", [0.5, 0.9])
def test_exact_rejections_of_good_plans(rate):
    test = SequentialTest(rate, 1e-3, 0.05, 200)
    assert 0 < acceptance_probability(test, rate, Verdict.REJECTED) <= 0.05
    assert acceptance_probability(test, 0.5 * rate, Verdict.REJECTED) > 0.9


def test_shortest_acceptance_is_where_a_straight_run_is_accepted():
    for rate, level in ((0.5, 0.05), (0.9, 0.002), (0.99, 0.01)):
        n = shortest_acceptance(rate, level)
        test = SequentialTest(rate, level, 0.05, 3 * n)
        assert test.verdict(n, 0) is Verdict.ACCEPTED
        assert test.verdict(n - 1, 0) is Verdict.OPEN
        assert n >= log(level) / log(rate)


@given(st.integers(0, 60), st.integers(0, 60))
def test_the_test_gives_up_when_it_cannot_accept_any_more(s, f):
    test = SequentialTest(0.8, 0.01, 0.05, 60)
    if s + f <= 60 and test.verdict(s, f) is Verdict.UNDECIDED:
        ahead = [test.verdict(s + i, f) for i in range(60 - s - f + 1)]
        assert Verdict.ACCEPTED not in ahead
    if s + f == 60:
        assert test.verdict(s, f) is not Verdict.OPEN


def test_evidence_of_what_is_impossible_is_none():
    assert log_evidence(0, 5000, 0.99, above=True) == -inf
    assert probability_of_rate(0, 5000, 0.99) == 0
    assert probability_of_rate(5000, 0, 0.01) == 1
    assert np.isfinite(log_evidence(100_000, 10, 0.99, above=True))


def test_what_a_run_of_ilrobs_earned():
    result = earned(7, phi(1.0), 0.95, tests=6)
    assert result.lower == pytest.approx(0.05 ** (1 / 7))
    assert result.simultaneous == pytest.approx((0.05 / 6) ** (1 / 7))
    assert result.earned == pytest.approx(1 - phi(1.0) ** 7)
    assert result.needed == 18
    assert result.sentence == (
        "7 successes in a row show a success rate of at least 0.652 at 0.95 confidence, or 0.505 as the best of 6 "
        "tested plans; that it is at least 0.841 has the confidence 0.702. To show 0.841 at 0.95 confidence takes "
        "18 in a row."
    )


def test_the_simultaneous_bound_holds_for_the_best_of_several_plans():
    """Plans just below the bound, each tested until one passes: one does at most as often as was allowed."""
    bound = earned(7, 0.8, 0.9, tests=6).simultaneous - 1e-9
    assert 0.09 < 1 - (1 - bound**7) ** 6 <= 0.1
    assert 1 - (1 - earned(7, 0.8, 0.9).lower ** 7) ** 6 > 0.4
