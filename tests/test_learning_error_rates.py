"""Error rates over 1,000 seeds against theory: exact laws of what bisection, ILROBS and the calibrated search return.

Every comparison is a two-sided exact binomial (or normal) test that a right program fails once in 10^5; seeds are
fixed, so it fails always or never.
"""

from collections import Counter
from itertools import pairwise
from math import prod, sqrt

import numpy as np
import pytest
from scipy.stats import binom, norm
from synthetic_worlds import World, acceptance_probability, bisection_law, ilrobs_law, run, states

from robustopt.confidence import paper_executions, phi
from robustopt.learning.bisection import Bisection
from robustopt.learning.calibrated import Calibrated
from robustopt.learning.ilrobs import Ilrobs
from robustopt.learning.learner import Belief
from robustopt.learning.moments import ErrorInterval

SEEDS = 1000
UNLIKELY = 1e-5


def agrees(count, seeds, probability):
    """Whether a count is what a probability makes of so many seeds."""
    return binom.ppf(UNLIKELY / 2, seeds, probability) <= count <= binom.isf(UNLIKELY / 2, seeds, probability)


def assert_law(found, law):
    counts = Counter(found)
    assert set(counts) <= set(law)
    assert sum(law.values()) == pytest.approx(1)
    for value, probability in law.items():
        assert agrees(counts[value], len(found), probability), (value, counts[value], probability)


def returned_friction(learner, state):
    best = learner.best(state)
    return None if best is None else best.trial.friction


# Bisection ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "world",
    [
        World(threshold=0.2, noise=0.02),
        World(threshold=0.2, noise=0.1),
        World(threshold=0.45, noise=0.05, knee=2.0),
        World(threshold=0.61, noise=0.03, logistic=True, knee=2.0),
    ],
    ids=["a little noise", "much noise", "friction binds", "logistic"],
)
def test_bisection_returns_what_theory_says(world):
    learner = Bisection()
    found = [returned_friction(learner, run(learner, world, seed)) for seed in range(SEEDS)]
    assert_law(found, bisection_law(world, 0.0, 1.0, 0.05, 0.05))


def test_probability_of_the_papers_decisions_in_closed_form():
    """All seven decisions of Table 1 are right with the product of their probabilities."""
    world = World(threshold=0.2, noise=0.01)
    demands = {"F": (0.33, 0.33, 0.25, 0.1875 * 1.05**2), "S": (0.125, 0.125 * 1.05**2, 0.1875)}
    z = {key: [(0.2 - demand) / 0.01 for demand in values] for key, values in demands.items()}
    expected = prod(norm.cdf(z["S"])) * prod(norm.sf(z["F"]))
    learner = Bisection()
    right = 0
    for seed in range(SEEDS):
        rows = run(learner, world, seed).rows
        right += [(row.result.value[0], row.trial.sped_up) for row in rows] == [
            ("f", None), ("f", None), ("f", None), ("s", True), ("s", False),
        ]  # fmt: skip
    assert 0.5 < expected < 0.8
    assert agrees(right, SEEDS, expected)


def test_bisection_returns_unsafe_plans_as_often_as_theory_says():
    """Unsafe: it fails more often than it succeeds. One success proves little in a noisy world."""
    world = World(threshold=0.45, noise=0.1, knee=2.0)
    learner = Bisection()
    law = bisection_law(world, 0.0, 1.0, 0.05, 0.05)
    expected = sum(p for mu, p in law.items() if mu is not None and world.success_rate(Belief(mu)) < 0.5)
    found = [returned_friction(learner, run(learner, world, seed)) for seed in range(SEEDS)]
    unsafe = sum(mu is not None and world.success_rate(Belief(mu)) < 0.5 for mu in found)
    assert 0.2 < expected < 0.6
    assert agrees(unsafe, SEEDS, expected)


# ILROBS ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("K", "try_upper"),
    [
        (1.0, True),
        (1.0, False),
        pytest.param(0.5, True, marks=pytest.mark.slow),
        pytest.param(2.0, True, marks=pytest.mark.slow),
        pytest.param(2.0, False, marks=pytest.mark.slow),
    ],
)
@pytest.mark.parametrize(
    "world",
    [
        World(threshold=0.5, noise=0.05, knee=2.0),
        World(threshold=0.37, noise=0.1, logistic=True, knee=2.0, margin=0.2),
    ],
    ids=["gaussian", "logistic with margins"],
)
def test_ilrobs_returns_what_theory_says(world, K, try_upper):
    learner = Ilrobs(K=K, try_upper=try_upper)
    law, mean = ilrobs_law(world, K, paper_executions(K), 0.05, try_upper)
    finals = [run(learner, world, seed) for seed in range(SEEDS)]
    assert_law([returned_friction(learner, state) for state in finals], law)
    executed = np.array([state.executed for state in finals])
    assert abs(executed.mean() - mean) < norm.isf(UNLIKELY / 2) * executed.std() / sqrt(SEEDS)


@pytest.mark.parametrize("K", [0.5, 1.0, 2.0])
def test_ilrobs_passes_plans_that_miss_its_rate_as_often_as_theory_says(K):
    """A plan whose rate is Phi(K) exactly passes with Phi^N_e, near 1 / e: N_e successes are weak evidence."""
    target, count = phi(K), paper_executions(K)
    middle = 0.5
    world = World(threshold=middle + 0.1 * norm.ppf(target - 1e-9), noise=0.1, knee=2.0)
    learner = Ilrobs(K=K, try_upper=False)
    passed = 0
    for seed in range(SEEDS):
        passed += next(state.rows[0] for state in states(learner, world, seed) if state.rows).trial.failures == 0
    assert world.success_rate(Belief(middle)) == pytest.approx(target, abs=1e-6)
    assert agrees(passed, SEEDS, target**count)


def test_estimated_errors_change_the_law_of_ilrobs_only_a_little():
    """With U and Delta from 100 samples per execution, not known, the answers stay within a binomial bound."""
    exact = World(threshold=0.37, noise=0.1, knee=2.0, margin=0.05)
    sampled = World(threshold=0.37, noise=0.1, knee=2.0, margin=0.05, samples=100)
    learner = Ilrobs(K=1.0, try_upper=False)
    law, _ = ilrobs_law(exact, 1.0, 7, 0.05, False)
    found = Counter(returned_friction(learner, run(learner, sampled, seed)) for seed in range(300))
    likely = max(law, key=law.get)
    assert agrees(found[likely], 300, law[likely])


# The calibrated search ------------------------------------------------------------------------------------


def all_bad(rate):
    """A world in which every plan misses the rate, by next to nothing: the worst case of the search."""

    class Bad(World):
        def success_rate(self, belief, speed=1.0):
            return rate - 1e-9

    return Bad(knee=2.0)


@pytest.mark.parametrize(("rate", "confidence", "seeds"), [(0.7, 0.8, 100), (0.5, 0.5, 100)])
def test_the_error_of_the_calibrated_search_in_the_worst_case(rate, confidence, seeds):
    """All plans just miss the rate: it accepts any of them with 1 - (1 - a)^M, a the exact error of one test."""
    learner = Calibrated(rate=rate, confidence=confidence, resolution=0.05)
    one = acceptance_probability(learner.test, rate - 1e-9)
    expected = 1 - (1 - one) ** learner.tests
    assert expected <= 1 - confidence
    wrong = sum(learner.best(run(learner, all_bad(rate), seed)) is not None for seed in range(seeds))
    assert agrees(wrong, seeds, expected)
    assert binom.cdf(wrong, seeds, 1 - confidence) < 0.99


@pytest.mark.slow
@pytest.mark.parametrize(("rate", "confidence"), [(0.7, 0.95), (0.7, 0.5)])
def test_the_error_of_the_calibrated_search_over_1000_seeds(rate, confidence):
    learner = Calibrated(rate=rate, confidence=confidence)
    expected = 1 - (1 - acceptance_probability(learner.test, rate - 1e-9)) ** learner.tests
    wrong = sum(learner.best(run(learner, all_bad(rate), seed)) is not None for seed in range(SEEDS))
    assert agrees(wrong, SEEDS, expected)
    assert wrong / SEEDS <= 1 - confidence


def fastest(world, rate):
    """Duration of the fastest plan of the world that meets the rate."""
    use = world.threshold - world.noise * norm.ppf(rate)
    return world.shortest * sqrt(world.knee / min(use, world.knee))


NOISY = World(threshold=0.5, noise=0.05, knee=2.0, margin=0.1)


@pytest.mark.parametrize(
    ("rate", "seeds"),
    [
        (0.7, 20),
        (0.9, 10),
        pytest.param(0.7, 300, marks=pytest.mark.slow),
        pytest.param(0.9, 100, marks=pytest.mark.slow),
        pytest.param(0.99, 20, marks=pytest.mark.slow),
    ],
)
def test_the_calibrated_search_meets_the_rate_and_is_near_the_fastest_plan_that_does(rate, seeds):
    learner = Calibrated(rate=rate)
    missed, slower = 0, []
    for seed in range(seeds):
        best = learner.best(run(learner, NOISY, seed))
        missed += NOISY.success_rate(best.trial.belief) < rate
        slower.append(best.trial.duration / fastest(NOISY, rate) - 1)
    assert missed <= binom.isf(UNLIKELY, seeds, 0.05)
    assert np.median(slower) < 0.05


def test_the_calibrated_search_makes_no_more_tests_than_it_paid_for():
    learner = Calibrated(rate=0.7, resolution=0.05)
    for seed in range(10):
        for world in (NOISY, World(threshold=-9.0), World(threshold=9.0)):
            rows = run(learner, world, seed).rows
            tested = [row for row in rows if row.trial.executions]
            assert len(tested) <= learner.tests
            assert all(row.trial.executions <= learner.test.limit for row in tested)


def test_every_accepted_plan_is_faster_than_the_one_before():
    learner = Calibrated(rate=0.7)
    for seed in range(10):
        rows = [row for row in run(learner, NOISY, seed).rows if row.result.value == "success"]
        durations = [row.trial.duration for row in rows]
        assert all(b * (1 + learner.resolution) <= a for a, b in pairwise(durations))


def test_the_calibrated_search_in_a_quiet_world_is_bisection_to_its_resolution():
    learner = Calibrated(rate=0.9, K_values=(0.0,))
    for threshold in (0.11, 0.37, 0.5, 0.61):
        best = learner.best(run(learner, World(threshold=threshold, knee=2.0)))
        assert 1 <= threshold / best.trial.friction < (1 + learner.resolution) ** 4
        assert best.trial.failures == 0


def test_a_belief_given_is_tested_first_and_the_result_is_not_slower_where_it_is_accepted():
    given, bad = Belief(0.4, ErrorInterval()), Belief(0.9, ErrorInterval())
    accepted = 0
    for seed in range(10):
        for first in (given, bad):
            learner = Calibrated(rate=0.7, first=first, resolution=0.02)
            state = run(learner, NOISY, seed)
            row = state.rows[0]
            assert row.trial.belief == first
            assert (row.low, row.high) == learner.friction
            assert learner.best(state).trial.duration <= NOISY.duration(given) or row.result.value != "success"
            accepted += row.result.value == "success"
            assert first is given or row.result.value == "failure"
    assert accepted >= 8
    assert Calibrated(first=given).tests == Calibrated().tests + 1


def test_ilrobs_first_makes_the_search_at_least_as_fast_where_its_plan_meets_the_rate_amply():
    learner = Ilrobs(K=1.0)
    for seed in range(10):
        best = learner.best(run(learner, NOISY, seed)).trial
        search = Calibrated(rate=0.5, first=best.belief, resolution=0.02)
        result = search.best(run(search, NOISY, 100 + seed)).trial
        assert NOISY.success_rate(best.belief) < 0.75 or result.duration <= best.duration
