"""The contract that every learner keeps, in worlds that succeed, fail, are noisy, or have no plan."""

import json
from dataclasses import FrozenInstanceError, replace
from functools import cache
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from synthetic_worlds import Forecast, World, answer, cost, half_width, run, run_batched, states

from robustopt.confidence import Reading
from robustopt.config import LearningConfig
from robustopt.errors import ConfigError, RobustOptError
from robustopt.learning import LEARNERS, learner_of
from robustopt.learning.acceleration_interval import AccelerationInterval
from robustopt.learning.bisection import Bisection
from robustopt.learning.branch_and_bound import Diagonal, Midpoint
from robustopt.learning.calibrated import Calibrated
from robustopt.learning.ilrobs import Ilrobs
from robustopt.learning.informed import Informed
from robustopt.learning.learner import Belief, Executed, Planned, Result, Row, State, Trial, tell_all
from robustopt.learning.moments import ErrorInterval, Moments, endpoint_change, shrunk
from robustopt.learning.parameters import Parameter
from robustopt.learning.physics import Physics

UPPER, LOWER = Parameter("contact.friction.upper", 1.0, 0.05), Parameter("contact.friction.lower", 0.8, 0.0)

CASES = {
    "bisection": Bisection(),
    "bisection, fine": Bisection(friction=(0.1, 0.8), delta=0.001, epsilon=0.01),
    "acceleration_interval": AccelerationInterval(K=2.0, friction=0.3, executions=3),
    "acceleration_interval, as configured": AccelerationInterval(
        start=ErrorInterval((0.0, 0.0), (1.0, 1.0), 1.0), threshold=1e-6, iterations=4
    ),
    "ilrobs": Ilrobs(),
    "ilrobs, two-sided": Ilrobs(K=2.0, reading=Reading.TWO_SIDED, try_upper=False, friction=(0.1, 0.9)),
    "ilrobs-calibrated": Calibrated(rate=0.7, K_values=(0.0, 1.0), resolution=0.02),
    "ilrobs-calibrated, from a belief": Calibrated(
        rate=0.6, K_values=(0.0,), resolution=0.05, first=Belief(0.2, ErrorInterval((0.1, 0.0), (0.2, 0.1), 1.0))
    ),
    "bnb-midpoint": Midpoint(parameters=(UPPER, LOWER), cost=cost, budget=15),
    "bnb-midpoint, one parameter": Midpoint(parameters=(LOWER,), cost=cost),
    "bnb-midpoint, three in a row": Midpoint(parameters=(UPPER, LOWER), cost=cost, executions_per_plan=3),
    "bnb-diagonal": Diagonal(parameters=(UPPER, LOWER), cost=cost, delta=0.2, gap=0.05, budget=15),
    "bnb-diagonal, few plans": Diagonal(
        parameters=(UPPER, LOWER, replace(UPPER, key="x")), cost=cost, plans=30, budget=8
    ),
    "bnb-informed": Informed(parameters=(UPPER, LOWER), cost=cost, budget=6),
    "bnb-informed, three in a row": Informed(parameters=(UPPER, LOWER), cost=cost, budget=6, executions_per_plan=3),
    "physics": Physics(parameters=(UPPER, LOWER), cost=cost, foresight=Forecast(), budget=6),
    "physics, one parameter": Physics(parameters=(UPPER,), cost=cost, foresight=Forecast(), budget=8),
    "physics, three in a row": Physics(
        parameters=(UPPER, LOWER), cost=cost, foresight=Forecast(), budget=6, executions_per_plan=3
    ),
}

WORLDS = {
    "quiet": World(threshold=0.2),
    "noisy": World(threshold=0.3, noise=0.05, margin=0.1, knee=0.5, samples=40),
    "logistic": World(threshold=0.5, noise=0.03, logistic=True, margin=0.2, knee=2.0, samples=20),
    "often infeasible": World(threshold=0.4, noise=0.05, margin=0.1, knee=0.8, feasible=(1.5, 0.0)),
    "all succeeds": World(threshold=9.0),
    "all fails": World(threshold=-9.0),
    "no plan": World(feasible=(0.0, -1.0)),
    "errors only": World(threshold=-9.0, mean=(5.0, 0.0), deviation=(4.0, 0.0), feasible=(0.0, 0.1)),
}

LONGEST = 3000
"""More outcomes than any case here takes."""

every_case = pytest.mark.parametrize("learner", CASES.values(), ids=CASES)
every_world = pytest.mark.parametrize("world", WORLDS.values(), ids=WORLDS)


def test_every_learner_is_a_case():
    assert {type(learner) for learner in CASES.values()} == set(LEARNERS)


@every_case
@every_world
def test_it_finishes_and_says_why(learner, world):
    seen = list(states(learner, world))
    assert len(seen) < LONGEST
    assert not any(learner.finished(state) or state.end for state in seen[:-1])
    last = seen[-1]
    assert learner.finished(last)
    assert learner.ask(last) is None
    assert last.end is not None
    assert last.end.sentence.endswith(".")


@every_case
@every_world
def test_the_same_seed_gives_the_same_states(learner, world):
    assert list(states(learner, world, 3)) == list(states(learner, world, 3))


@every_case
@every_world
def test_the_last_bits_of_durations_and_errors_decide_nothing(learner, world, monkeypatch):
    before = run(learner, world, 3)
    random, execute, duration = np.random.default_rng(0), World.execute, World.duration

    def perturbed(value):
        return value * (1 + 1e-12 * random.uniform(-1, 1))

    def planned(self, belief):
        found = duration(self, belief)
        return None if found is None else perturbed(found)

    def executed(self, *arguments):
        told = execute(self, *arguments)
        total = tuple(perturbed(value) for value in told.errors.total)
        return replace(told, errors=replace(told.errors, total=total))

    monkeypatch.setattr(World, "duration", planned)
    monkeypatch.setattr(World, "execute", executed)
    after = run(learner, world, 3)
    assert after.end is before.end
    assert [row.result for row in after.rows] == [row.result for row in before.rows]
    for one, other in zip(before.rows, after.rows, strict=True):
        assert other.trial.belief.friction == one.trial.belief.friction


@every_case
def test_seeds_differ_in_a_noisy_world(learner):
    finals = {learner.dump(run(learner, WORLDS["noisy"], seed)) for seed in range(5)}
    assert len(finals) > 1


@every_case
@every_world
def test_a_stored_state_has_the_same_future(learner, world):
    seen = list(states(learner, world, 1))
    for index in sorted({int(i) for i in np.linspace(0, len(seen) - 1, 12)}):
        text = learner.dump(seen[index])
        json.loads(text, parse_constant=pytest.fail)
        again = learner.load(text)
        assert again == seen[index]
        assert type(again) is type(seen[index])
        assert run(learner, world, 1, start=again) == seen[-1]


@every_case
@every_world
def test_tell_leaves_the_state_as_it_was(learner, world):
    state = learner.initial()
    with pytest.raises(FrozenInstanceError):
        state.executed = 1
    while (request := learner.ask(state)) is not None and state.executed < 20:
        before = learner.dump(state)
        following = learner.tell(state, answer(world, request))
        assert learner.dump(state) == before
        assert learner.ask(state) == request
        state = following


@every_case
@every_world
def test_requests_number_executions_and_bound_them(learner, world):
    for state in states(learner, world):
        request = learner.ask(state)
        if request is None:
            break
        assert request.first == state.executed
        assert request.executions >= (0 if state.trial.duration is None else 1)
        assert request.speed >= 1
        ahead = state
        for _ in range(request.executions):
            assert (learner.ask(ahead).belief, learner.ask(ahead).speed) == (request.belief, request.speed)
            ahead = learner.tell(ahead, Executed(success=True))
            if ahead.rows != state.rows or learner.ask(ahead).speed != request.speed:
                break
        else:
            assert request.executions == 0


@every_case
@every_world
def test_history_only_grows_and_counts_every_execution(learner, world):
    seen = list(states(learner, world))
    for before, after in pairwise(seen):
        rows = learner.history(after)
        assert rows[: len(before.rows)] == before.rows
        assert after.executed - before.executed in (0, 1)
    rows = learner.history(seen[-1])
    assert sum(row.trial.executions for row in rows) == seen[-1].executed
    assert [row.iteration for row in rows] == sorted(row.iteration for row in rows)
    for row in rows:
        assert (row.trial.duration is None) == (row.result is Result.INFEASIBLE)
        assert row.result.sentence.endswith(".")
        json.dumps(row.record(), allow_nan=False)


@every_case
@every_world
def test_the_best_plan_succeeded(learner, world):
    state = run(learner, world, 2)
    best = learner.best(state)
    if best is None:
        assert learner.returned(state) is None
        return
    assert best.trial.successes > 0
    assert best.trial.duration == world.duration(best.trial.belief)
    if world.noise == 0:
        assert world.success_rate(best.trial.belief) == 1
        assert best.trial.failures == 0


@every_case
@pytest.mark.parametrize("world", ["all fails", "no plan", "errors only"])
def test_no_success_is_an_outcome(learner, world):
    state = run(learner, WORLDS[world])
    assert learner.best(state) is None
    assert learner.returned(state) is None


@every_case
def test_executions_without_errors_are_no_crash(learner):
    state, silent = learner.initial(), Executed(success=False)
    while (request := learner.ask(state)) is not None:
        state = learner.tell(state, Planned(5.0) if request.executions == 0 else silent)
    assert learner.best(state) is None


@every_case
@every_world
def test_executions_run_ahead_change_nothing(learner, world):
    random = np.random.default_rng(0)
    batched, ran = run_batched(learner, world, lambda: int(random.integers(1, 30)), seed=4)
    assert batched == run(learner, world, 4)
    assert ran >= batched.executed


@every_case
def test_answers_to_what_was_not_asked(learner):
    state = learner.initial()
    with pytest.raises(RobustOptError, match="expected a plan"):
        learner.tell(state, Executed(success=True))
    state = learner.tell(state, Planned(5.0))
    with pytest.raises(RobustOptError, match="expected an execution"):
        learner.tell(state, Planned(5.0))
    final = run(learner, WORLDS["quiet"])
    with pytest.raises(RobustOptError, match="expected nothing more"):
        learner.tell(final, Executed(success=True))


def test_nothing_is_told_of_no_outcomes():
    learner = Bisection()
    state = learner.tell(learner.initial(), Planned(1.0))
    assert tell_all(learner, state, []) == (state, 0)


# Values ---------------------------------------------------------------------------------------------------

FLOATS = st.floats(allow_nan=False, allow_infinity=False)
VALUES = st.lists(FLOATS, min_size=2, max_size=2).map(tuple)
MOMENTS = st.builds(Moments, st.integers(1, 10**9), VALUES, VALUES)
INTERVALS = st.builds(ErrorInterval, VALUES, VALUES, FLOATS, FLOATS)
TRIALS = st.builds(
    Trial, st.builds(Belief, st.none() | FLOATS, st.none() | INTERVALS), st.none() | FLOATS, st.integers(0, 10**9),
    st.integers(0, 10**9), st.none() | st.booleans(), MOMENTS,
)  # fmt: skip
ROWS = st.builds(Row, st.integers(1, 99), TRIALS, st.sampled_from(Result), st.none() | FLOATS, st.none() | FLOATS)


@cache
def initial(learner):
    """The initial state, made once: it may take a search for the first plan."""
    return learner.initial()


@every_case
@settings(deadline=None)  # the first example makes the initial state
@given(rows=st.lists(ROWS, max_size=3).map(tuple), trial=st.none() | TRIALS)
def test_floats_are_stored_exactly(learner, rows, trial):
    state = replace(initial(learner), rows=rows, trial=trial)
    assert isinstance(state, State)
    assert learner.load(learner.dump(state)) == state


@given(st.lists(st.lists(st.floats(-100, 100), min_size=1, max_size=30), min_size=1, max_size=5))
def test_pooled_moments_are_those_of_all_samples(sets):
    pooled = Moments()
    for samples in sets:
        values = np.array(samples)
        pooled += Moments.of_means(len(samples), [values.mean()], [(values**2).mean()])
    everything = np.concatenate([np.array(samples) for samples in sets])
    assert pooled.count == len(everything)
    assert pooled.mean[0] == pytest.approx(everything.mean(), abs=1e-9)
    assert pooled.deviation[0] == pytest.approx(everything.std(), abs=1e-5)
    assert Moments() + pooled == pooled + Moments() == pooled


def test_an_interval_is_given_up_in_halves():
    interval = ErrorInterval((0.2,), (0.1,), 3.0)
    assert interval.middle == pytest.approx((0.2,))
    assert interval.half_width == pytest.approx((0.3,))
    shares = []
    while interval is not None:
        shares.append(interval.share)
        interval = shrunk(interval)
    assert shares == [1, 0.5, 0.25, 0.125, 0]
    assert shrunk(None) is None
    assert shrunk(ErrorInterval((0.0,), (0.0,), 1.0)) is None
    assert half_width(Belief(0.5, ErrorInterval((0.2,), (0.1,), 3.0, 0.5))) == pytest.approx(0.15)


def test_how_far_endpoints_move():
    old, new = ErrorInterval((0.0, 1.0), (0.5, 0.0), 2.0), ErrorInterval((0.25, 1.0), (0.5, 0.1), 2.0)
    assert endpoint_change(old, new) == pytest.approx(0.25)
    assert endpoint_change(ErrorInterval(), new) == pytest.approx(1.25)
    assert endpoint_change(new, ErrorInterval()) == pytest.approx(1.25)
    assert endpoint_change(ErrorInterval(), ErrorInterval()) == 0


# Settings -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("learner", LEARNERS)
def test_a_configuration_names_its_learner(learner):
    parameters = [{"key": "contact.friction", "optimistic": 1.0, "conservative": 0.1}]
    settings = {"algorithm": learner.name, "delta": 0.02, "parameters": parameters}
    made = learner_of(LearningConfig.model_validate(settings), cost, Forecast())
    assert type(made) is learner
    assert getattr(made, "delta", 0.02) == 0.02


def test_settings_reach_the_learner():
    settings = LearningConfig(algorithm="ilrobs", K=2.0, delta=0.01, friction=(0.1, 0.7))
    assert learner_of(settings) == Ilrobs(K=2.0, delta=0.01, friction=(0.1, 0.7))
    settings = LearningConfig(algorithm="bisection", epsilon=0.1, friction=(0.1, 0.7))
    assert learner_of(settings) == Bisection(epsilon=0.1, friction=(0.1, 0.7))


def test_settings_reach_the_learners_of_several_parameters():
    parameters = ({"key": "contact.friction", "optimistic": 1.0, "conservative": 0.1},)
    given = {"parameters": parameters, "budget": 9, "gap": 0.2, "executions_per_plan": 7, "plans": 50}
    settings = LearningConfig.model_validate({"algorithm": "bnb-midpoint", **given})
    expected = {**given, "parameters": (Parameter("contact.friction", 1.0, 0.1),), "cost": cost}
    assert learner_of(settings, cost) == Midpoint(**expected)


def test_learners_of_several_parameters_need_their_cost():
    with pytest.raises(RobustOptError, match="bnb-informed: found no cost"):
        learner_of(LearningConfig(algorithm="bnb-informed"))
    with pytest.raises(RobustOptError, match="physics: found no foresight"):
        learner_of(LearningConfig(algorithm="physics"), cost)


def test_a_learner_that_is_not_here():
    settings = LearningConfig.model_construct(algorithm="annealing")
    with pytest.raises(ConfigError, match=r"learning\.algorithm: found annealing; expected one of bisection"):
        learner_of(settings)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Bisection(friction=(0.5, 0.5)), r"learning\.friction: found \[0\.5, 0\.5\]"),
        (lambda: Bisection(epsilon=0), r"learning\.epsilon: found 0"),
        (lambda: Ilrobs(delta=-1), r"learning\.delta: found -1"),
        (lambda: Calibrated(rate=1.0), r"learning\.success_rate: found 1"),
        (lambda: Calibrated(friction=(0.0, 1.0)), r"learning\.friction: found 0"),
        (lambda: Calibrated(K_values=(1.0,)), r"learning\.K_values: found \[1\.0\]"),
        (lambda: Calibrated(patience=0.5), r"learning\.patience: found 0\.5"),
        (lambda: AccelerationInterval(executions=0), "at least one execution"),
        (lambda: Midpoint(parameters=(), cost=cost), r"learning\.parameters: found none"),
        (
            lambda: Midpoint(parameters=(UPPER, UPPER), cost=cost),
            r"learning\.parameters: found contact\.friction\.upper",
        ),
        (lambda: Parameter("path.blend", 1.0, 1.0), r"learning\.parameters: found 1 and 1 for path\.blend"),
        (lambda: Diagonal(parameters=(UPPER,), cost=cost, budget=0), r"learning\.budget: found 0"),
    ],
)
def test_settings_that_cannot_be(make, message):
    with pytest.raises(ConfigError, match=message):
        make()
