"""The learners of several parameters: sound bounds, Alg. 1 in one dimension, contradictions, noise, slow plans."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from monotone_problems import HELD_OUT, TUNING, problem
from real_problems import optimum
from scipy.stats import beta
from synthetic_worlds import World, run

from robustopt.errors import ConfigError
from robustopt.learning import boundary
from robustopt.learning.bisection import Bisection
from robustopt.learning.boundary import Cloud, cloud
from robustopt.learning.branch_and_bound import Diagonal, Midpoint
from robustopt.learning.cost_map import CostMap
from robustopt.learning.informed import TRUST, Informed, _chance_by_monotony
from robustopt.learning.learner import End, Executed, Planned, Result
from robustopt.learning.monotone import Knowledge
from robustopt.learning.parameters import Parameter

LEARNERS = (Midpoint, Diagonal, Informed)
every_learner = pytest.mark.parametrize("make", LEARNERS, ids=lambda learner: learner.name)


def unit(k):
    return tuple(Parameter(f"p{axis}", 0.0, 1.0) for axis in range(k))


def point_of(row):
    return np.array([value for _, value in row.trial.belief.parameters])


def solve(learner, success, limit=200):
    """The final state where `success` tells of a point whether its execution succeeds."""
    state = learner.initial()
    for _ in range(2 * limit):
        request = learner.ask(state)
        if request is None:
            return state
        point = np.array([value for _, value in request.belief.parameters])
        state = learner.tell(state, Executed(success(point)) if request.executions else Planned(1.0))
    raise AssertionError("it does not end")


# Points and costs -----------------------------------------------------------------------------------------


def test_values_are_geometric_where_both_ends_have_one_sign():
    assert Parameter("mu", 0.8, 0.05).value(0.5) == pytest.approx(0.2)
    assert Parameter("mu", 0.8, 0.0).value(0.5) == pytest.approx(0.4)
    assert Parameter("offset", -1.0, 3.0).value(0.25) == pytest.approx(0.0)
    for parameter in (Parameter("mu", 0.8, 0.05), Parameter("offset", -1.0, 3.0)):
        assert (parameter.value(0.0), parameter.value(1.0)) == (parameter.optimistic, parameter.conservative)


@pytest.mark.parametrize("k", [1, 2, 3])
def test_the_guide_is_exact_at_its_nodes_and_monotone_between_them(k):
    def cost(points):
        return np.mean((1 - 0.9 * points) ** -np.linspace(0.4, 0.6, k), axis=1)

    costs = CostMap(unit(k), cost, 1000)
    ends = np.array([np.zeros(k), np.ones(k)])
    assert costs.guide(ends) == pytest.approx(costs.exact(ends))
    random = np.random.default_rng(0)
    low = random.random((500, k))
    high = low + random.random((500, k)) * (1 - low)
    assert np.all(costs.guide(low) <= costs.guide(high) * (1 + 1e-12))
    assert costs.guide(low) == pytest.approx(costs.exact(low), rel=0.05)


def test_the_guide_takes_as_many_plans_as_it_may():
    asked = []

    def cost(values):
        asked.append(len(values))
        return 1 + np.sum(values, axis=1)

    CostMap(unit(3), cost, 100).guide(np.zeros((1, 3)))
    assert asked == [4**3]


# What monotony says ---------------------------------------------------------------------------------------

POINTS = st.lists(st.tuples(*[st.floats(0, 1)] * 3), max_size=8)


@given(failures=POINTS, others=st.lists(st.tuples(*[st.floats(0, 1)] * 3), min_size=1, max_size=20))
def test_every_point_that_no_failure_rules_out_is_above_a_lower_corner(failures, others):
    known = Knowledge.of(3, [], failures, [])
    corners = known.lower_corners()
    for point in np.array(others):
        if known.undecided(point[None])[0]:
            assert np.any(np.all(corners <= point, axis=1))


@given(failures=POINTS, successes=POINTS, share=st.tuples(*[st.floats(0, 1)] * 3))
def test_contracting_a_box_loses_nothing_undecided(failures, successes, share):
    known = Knowledge.of(3, successes, failures, [])
    point = np.array([share])
    low, high = known.contract(np.zeros((1, 3)), np.ones((1, 3)))
    if known.undecided(point)[0]:
        assert np.all(low <= point)
        assert np.all(point <= high)


# Soundness ------------------------------------------------------------------------------------------------


@every_learner
@settings(max_examples=6, deadline=None)
@given(k=st.integers(1, 3), seed=st.integers(0, 10**6), shapes=st.sampled_from([TUNING, HELD_OUT]))
def test_the_bound_never_exceeds_the_optimum_and_the_incumbent_succeeded(make, k, seed, shapes):
    task = problem(k, seed, shapes)
    learner = make(parameters=unit(k), cost=task.cost, budget=10)
    state = solve(learner, lambda point: task.execute(point, seed, 0))
    bounds = [row.lower_bound for row in state.rows]
    assert max(bounds) <= task.optimum * (1 + 1e-9)
    assert np.all(np.diff(bounds) >= -1e-12)
    best = learner.best(state)
    assert best is not None, "b is tested at the latest"
    assert task.success_rate(point_of(best))[0] == 1
    assert task.cost(point_of(best)[None])[0] >= task.optimum * (1 - 1e-6)
    assert state.rows[-1].gap == pytest.approx(learner.incumbent(state) / bounds[-1] - 1)
    assert state.rows[-1].contradictions == 0


@pytest.mark.parametrize("make", [Midpoint, Diagonal])
def test_the_gap_is_proven_in_the_end(make):
    learner = make(parameters=unit(2), cost=lambda v: 1 + 0.3 * v.sum(axis=1), budget=100, gap=0.16, delta=1e-3)
    state = solve(learner, lambda point: point.sum() >= 1)
    assert state.end is End.GAP
    assert learner.incumbent(state) <= 1.16 * 1.3
    assert state.rows[-1].gap <= 0.16


# One dimension: Alg. 1 ------------------------------------------------------------------------------------


@every_learner
@pytest.mark.parametrize("threshold", [0.03, 0.11, 0.37, 0.52, 0.61, 0.93])
def test_one_parameter_reaches_the_interval_of_alg_1_with_at_most_one_more_execution(make, threshold):
    bisection = run(Bisection(epsilon=1e-9), World(threshold=threshold, knee=9.0))
    plain = sum(row.trial.successes + row.trial.failures for row in bisection.rows)

    def cost(values):
        return 1 / np.sqrt(np.maximum(values[:, 0], 1e-6))

    learner = make(parameters=(Parameter("mu", 1.0, 0.0),), cost=cost, delta=0.05, gap=1e-6)
    state = solve(learner, lambda point: point[0] <= threshold)
    known = learner.knowledge(state)
    low = 1 - min(known.successes[:, 0], default=1.0)
    high = 1 - max(known.failures[:, 0], default=0.0)
    assert low <= threshold <= high
    assert high - low <= bisection.high - bisection.low + 1e-12
    assert state.executed <= plain + 1


# What may go wrong ----------------------------------------------------------------------------------------


@every_learner
def test_b_is_executed_before_anybody_says_that_nothing_succeeds(make):
    learner = make(parameters=unit(2), cost=problem(2, 0).cost, budget=8)
    state = solve(learner, lambda point: False)
    assert np.all(point_of(state.rows[-1]) == 1)
    assert state.executed == 8
    assert state.end is End.BUDGET
    assert learner.best(state) is None
    state = solve(learner, lambda point: bool(np.all(point == 1)))
    assert np.all(point_of(learner.best(state)) == 1)


@every_learner
def test_a_parameter_that_no_duration_depends_on_takes_one_execution(make):
    state = solve(make(parameters=unit(1), cost=lambda p: np.ones(len(p))), lambda point: True)
    assert [tuple(point_of(row)) for row in state.rows] == [(1.0,)]
    assert state.rows[-1].gap == 0.0


def test_a_budget_under_one_test_is_refused():
    with pytest.raises(ConfigError, match=r"found 6; expected at least learning\.executions_per_plan, 7"):
        Midpoint(parameters=unit(1), cost=problem(2, 0).cost, budget=6, executions_per_plan=7)


@every_learner
def test_no_plan_anywhere_is_an_outcome(make):
    learner = make(parameters=unit(2), cost=lambda values: np.full(len(values), np.inf))
    state = learner.initial()
    assert state.end is End.NO_PLAN
    assert learner.ask(state) is None


@every_learner
@pytest.mark.parametrize(
    ("cost", "found"),
    [
        (lambda p: 2 - p[:, 1] + p[:, 0], r"a plan of 2 s for p1 = 0 and a plan of 1 s for p1 = 1"),
        (lambda p: np.where(p[:, 1] < 0.1, np.inf, 1 + p[:, 0]), r"no plan for p1 = 0 and a plan of 1 s for p1 = 0\."),
        (lambda p: 1 + (p[:, 0] - 0.5) ** 2, r"a plan of 1.25 s for p0 = 0 and a plan of 1 s for p0 = 0.5"),
        (lambda p: 1 + p[:, 0], r"the same plans for every p1 from 0 to 1; .* leave the parameter out"),
    ],
    ids=["swapped", "swapped without a plan", "fastest in the middle", "without influence"],
)
def test_a_parameter_along_which_plans_do_not_get_slower_is_refused(make, cost, found):
    with pytest.raises(ConfigError, match=found):
        make(parameters=unit(2), cost=cost).initial()


@every_learner
def test_beliefs_without_a_plan_are_not_asked_for_where_f_says_so(make):
    def cost(values):
        return np.where(values.sum(axis=1) > 1.2, np.inf, 1 + values.sum(axis=1))

    state = solve(make(parameters=unit(2), cost=cost, budget=15), lambda point: point.min() > 0.3)
    assert all(point_of(row).sum() <= 1.2 for row in state.rows[:-1])
    assert any(row.result is Result.SUCCESS for row in state.rows)


@every_learner
def test_a_success_below_a_failure_is_reported_and_survived(make):
    outcomes = iter([False, True] * 100)
    learner = make(parameters=unit(2), cost=problem(2, 3).cost, budget=20, executions_per_plan=1)
    state = learner.initial()
    while (request := learner.ask(state)) is not None:
        state = learner.tell(state, Executed(next(outcomes)) if request.executions else Planned(1.0))
    known = learner.knowledge(state)
    pairs = sum(bool(np.all(s <= f)) for s in known.successes for f in known.failures)
    assert state.rows[-1].contradictions == pairs
    assert Knowledge.of(2, [(0.2, 0.2)], [(0.5, 0.5), (0.1, 0.9)], []).contradictions() == 1


def test_the_record_of_a_row_has_parameters_bound_and_gap():
    learner = Midpoint(parameters=(Parameter("contact.friction.upper", 1.0, 0.25),), cost=lambda v: 1 / v[:, 0])
    state = learner.tell(learner.tell(learner.initial(), Planned(2.0)), Executed(True))
    record = state.rows[0].record()
    assert record["parameters"] == pytest.approx({"contact.friction.upper": 0.5})
    assert (record["lower_bound"], record["contradictions"]) == (1.0, 0)
    assert record["gap"] == pytest.approx(1.0)


# Noise ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("make", [Midpoint, Diagonal])
def test_a_verdict_takes_executions_in_a_row(make):
    task = problem(2, 4, noise=0.05, rate=0.84)
    learner = make(parameters=unit(2), cost=task.cost, executions_per_plan=7, budget=60)
    numbers = iter(range(1000))
    state = solve(learner, lambda point: task.execute(point, 4, next(numbers)))
    for row in state.rows:
        assert row.trial.successes == 7 if row.result is Result.SUCCESS else row.trial.failures == 1
    assert state.executed <= 60


def noisy_informed(seed, budget):
    task = problem(2, seed, TUNING, noise=0.05, rate=0.84)
    learner = Informed(parameters=unit(2), cost=task.cost, executions_per_plan=7, budget=budget)
    numbers = iter(range(1000))
    return task, learner, solve(learner, lambda point: task.execute(point, seed, next(numbers)))


def test_the_incumbent_of_a_noisy_world_was_executed_and_is_trusted():
    task, learner, state = noisy_informed(0, 30)
    best = learner.best(state)
    assert best.result is Result.SUCCESS
    assert learner.incumbent(state) < 1.2 * task.optimum < task.cost(np.ones((1, 2)))[0]
    trusted = learner._confidence(state, learner.posterior(state), point_of(best)[None])
    assert trusted[0] >= TRUST


def test_failures_make_an_incumbent_doubtful():
    _, learner, state = noisy_informed(0, 20)
    before = learner.incumbent(state)
    state = replace(learner, budget=40)._next(replace(state, end=None), learner.lower_bound(state), before)
    while (request := learner.ask(state)) is not None and state.executed < 32:
        state = learner.tell(state, Executed(False) if request.executions else Planned(1.0))
    after = learner.incumbent(state)
    assert after is None or after > before


@given(successes=POINTS, failures=POINTS, share=st.tuples(*[st.floats(0, 1)] * 3))
def test_the_chance_by_monotony_counts_what_is_comparable(successes, failures, share):
    known, point = Knowledge.of(3, successes, failures, []), np.array([share])
    below = sum(all(np.array(other) <= share) for other in successes)
    above = sum(all(np.array(other) >= share) for other in failures)
    expected = beta.sf(0.8, 1.6 + below, 0.4 + above)
    assert _chance_by_monotony(known, point, 0.8) == pytest.approx([expected], rel=1e-6, abs=1e-12)


def test_the_posterior_finds_the_boundary_and_its_noise():
    random = np.random.default_rng(0)
    points = random.random((150, 2))
    outcomes = random.random(150) < 1 / (1 + np.exp(-(points.mean(axis=1) - 0.5) / 0.03))
    found = cloud(2, True, [tuple(point) for point in points.tolist()], outcomes.tolist())
    at = np.array([[0.6, 0.6], [0.4, 0.4], [0.85, 0.35], [0.15, 0.65]])
    chance = (found.margin(at) > 0).mean(axis=0)
    assert chance == pytest.approx([1, 0, 1, 0], abs=0.05)
    assert 0.02 < np.median(found.sigma) < 0.12


def test_a_posterior_made_anew_is_the_same():
    from robustopt.learning import boundary

    points, outcomes = [(0.2, 0.3), (0.8, 0.7), (0.5, 0.5)], [False, True, True]
    first = cloud(2, False, points, outcomes)
    boundary._CLOUDS.clear()
    again = cloud(2, False, points, outcomes)
    assert np.array_equal(first.z, again.z)


# Slow plans -----------------------------------------------------------------------------------------------


@every_learner
def test_few_plans_are_enough_where_planning_is_slow(make):
    task = problem(2, 5)
    asked = set()

    def cost(values):
        asked.update(map(tuple, values.tolist()))
        return task.cost(values)

    learner = make(parameters=unit(2), cost=cost, plans=150, budget=20)
    state = solve(learner, lambda point: task.execute(point, 0, 0))
    assert len(asked) < 300
    assert learner.incumbent(state) < 1.3 * task.optimum


@pytest.mark.parametrize(("k", "columns"), [(2, 33), (3, 13)])
@pytest.mark.parametrize("seed", range(len(TUNING)))
def test_brute_force_by_columns_finds_the_optimum(k, columns, seed):
    task = problem(k, seed, TUNING)
    best = optimum(task.cost, lambda point: task.margin(point[None])[0] >= 0, k, columns)
    assert task.margin(best[None])[0] >= 0
    assert task.cost(best[None])[0] <= 1.01 * task.optimum


# Where the model misfits ----------------------------------------------------------------------------------


def test_the_cheapest_success_is_lowered_along_the_axis_that_saves_most():
    learner = Informed(parameters=unit(2), cost=lambda points: 1 + points @ [1.0, 3.0])
    known = Knowledge.of(2, [(0.9, 0.9), (0.6, 0.8)], [(0.3, 0.9), (0.7, 0.4), (0.5, 0.5)], [])
    assert learner._along_axes(known, 9.0) == pytest.approx((0.6, 0.6))  # fails up to (0.6, 0.4)
    assert learner._along_axes(known, 3.35) is None  # 3.4 at that point, 3.85 at (0.45, 0.8)
    assert learner._along_axes(Knowledge.of(2, [], [], []), 9.0) is None


def test_informed_reaches_thresholds_of_four_parameters_that_no_sample_is_like():
    task = problem(4, 12, TUNING)  # by its model alone it stays 25 % above the optimum
    assert task.name == "orthant"
    learner = Informed(parameters=unit(4), cost=task.cost, budget=40)
    state = solve(learner, lambda point: task.margin(point[None])[0] >= 0)
    assert task.cost(point_of(learner.best(state))[None])[0] <= 1.05 * task.optimum


# Last bits ------------------------------------------------------------------------------------------------


def flat_in_parts(points):
    """Durations that are the same over whole regions, each parameter mattering only beyond its own place."""
    return np.max(1.0 + np.maximum(points - np.linspace(0.3, 0.5, points.shape[1]), 0.0) ** 2, axis=1)


@pytest.mark.parametrize("k", [2, 3])
@pytest.mark.parametrize("executions", [1, 3])
@every_learner
def test_the_last_bits_of_durations_and_margins_decide_nothing(make, k, executions, monkeypatch):
    margin = Cloud.margin

    def run_of(seed):
        random = np.random.default_rng(seed)

        def perturbed(values):
            return values if seed is None else values * (1 + 1e-12 * random.uniform(-1, 1, np.shape(values)))

        monkeypatch.setattr(Cloud, "margin", lambda self, points: perturbed(margin(self, points)))
        learner = make(
            parameters=unit(k), cost=lambda points: perturbed(flat_in_parts(points)), gap=0.002, plans=200,
            budget=24 if (k, executions) == (2, 1) else 12,
            executions_per_plan=executions,
        )  # fmt: skip
        return solve(learner, lambda point: bool(np.sum(point) > 0.9 * k / 2))

    exact = run_of(None)
    assert len(exact.points) > 5
    for seed in range(3):
        boundary._CLOUDS.clear()
        assert run_of(seed).points == exact.points
    boundary._CLOUDS.clear()
