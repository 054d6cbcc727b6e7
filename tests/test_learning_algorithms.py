"""Bisection, the acceleration interval and ILROBS against the paper and against worlds of known answers."""

import pytest
from synthetic_worlds import World, half_width, run

from robustopt.confidence import Reading
from robustopt.learning.acceleration_interval import AccelerationInterval
from robustopt.learning.bisection import Bisection
from robustopt.learning.ilrobs import Ilrobs
from robustopt.learning.learner import Belief, End, Executed, Planned, Result
from robustopt.learning.moments import ErrorInterval, Moments

# Alg. 1 ---------------------------------------------------------------------------------------------------


def test_table_1_of_the_paper():
    """A true friction between 0.1875 and 0.1875 * 1.05^2 = 0.2067, and other limits from 0.329 up."""
    learner = Bisection(delta=0.05, epsilon=0.05)
    state = run(learner, World(threshold=0.2, knee=0.329, shortest=3.229))
    rows = [row.record() for row in learner.history(state)]
    assert [row["friction"] for row in rows] == [1, 0.5, 0.25, 0.125, 0.1875]
    assert [row["result"][0].upper() for row in rows] == list("FFFSS")
    assert [row["sped_up"] for row in rows] == [None, None, None, True, False]
    assert [row["friction_high"] for row in rows] == [1, 0.5, 0.25, 0.25, 0.25]
    assert [row["friction_low"] for row in rows] == [0, 0, 0, 0.125, 0.1875]
    assert [row["duration"] for row in rows] == pytest.approx([3.229, 3.229, 3.704, 5.238, 4.277], abs=2e-3)
    assert state.end is End.NEAR_OPTIMAL
    assert state.executed == 7
    assert learner.best(state).trial.friction == 0.1875


def test_bisection_speeds_up_only_what_succeeded():
    learner = Bisection(epsilon=0.1)
    state = learner.tell(learner.initial(), Planned(3.0))
    assert (learner.ask(state).speed, learner.ask(state).executions) == (1, 1)
    state = learner.tell(state, Executed(success=True))
    assert (learner.ask(state).speed, learner.ask(state).executions) == (1.1, 1)
    assert learner.best(state) is None, "the test of the plan is not over"


@pytest.mark.parametrize("threshold", [0.03, 0.11, 0.37, 0.5, 0.61, 0.93])
def test_bisection_encloses_the_threshold(threshold):
    learner = Bisection(delta=0.001, epsilon=0.0005)
    state = run(learner, World(threshold=threshold, knee=9.0))
    assert state.low <= threshold < state.high
    assert state.high - state.low <= 0.001 or state.end is End.NEAR_OPTIMAL
    assert threshold / learner.best(state).trial.friction < 1.0005**2 or state.high - state.low <= 0.001


def test_bisection_ends_at_its_upper_end_where_all_succeeds():
    learner = Bisection()
    state = run(learner, World(threshold=9.0))
    assert len(state.rows) == 1
    assert (state.low, state.high, state.end) == (1.0, 1.0, End.INTERVAL)


def test_bisection_goes_up_where_there_is_no_plan():
    class Slope(World):
        def duration(self, belief):
            return None if belief.friction < 0.3 else super().duration(belief)

    learner = Bisection(epsilon=0.001)
    state = run(learner, Slope(threshold=0.4, knee=2.0))
    results = [(row.trial.friction, row.result) for row in state.rows]
    assert results[:4] == [
        (1, Result.FAILURE), (0.5, Result.FAILURE), (0.25, Result.INFEASIBLE), (0.375, Result.SUCCESS),
    ]  # fmt: skip
    assert learner.best(state).trial.friction <= 0.4


# The acceleration interval alone --------------------------------------------------------------------------


def test_the_interval_settles_where_the_errors_do_not_depend_on_the_plan():
    learner = AccelerationInterval(K=2.0, friction=0.3, executions=2)
    world = World(threshold=0.5)
    state = run(learner, world)
    assert state.end is End.STABLE
    assert len(state.rows) == 2
    assert state.interval.middle == pytest.approx(world.mean)
    assert state.interval.half_width == pytest.approx([2 * d for d in world.deviation])
    assert learner.best(state).trial.belief.error == state.interval
    assert state.change == pytest.approx(0, abs=1e-12)


def test_the_interval_is_estimated_from_samples():
    learner = AccelerationInterval(K=1.0, friction=0.3, executions=40, threshold=0.02)
    world = World(threshold=0.5, samples=100)
    for seed in range(5):
        state = run(learner, world, seed)
        assert state.end is End.STABLE
        error = 5 * 0.5 / (40 * 100) ** 0.5
        assert state.interval.mean == pytest.approx(world.mean, abs=error)
        assert state.interval.deviation == pytest.approx(world.deviation, abs=error)


def test_an_interval_that_never_settles_ends_at_the_limit():
    learner = AccelerationInterval(K=1.0, iterations=6, threshold=0.1)
    state, size = learner.initial(), 1.0
    while (request := learner.ask(state)) is not None:
        if request.executions == 0:
            state = learner.tell(state, Planned(1.0))
        else:
            size = 3.0 - size
            state = learner.tell(state, Executed(True, Moments.of_means(10, [0.0], [size])))
    assert state.end is End.ITERATION_LIMIT
    assert len(state.rows) == 6


def test_failures_count_for_the_interval_but_not_as_the_best():
    learner = AccelerationInterval(friction=0.3, executions=4)
    world = World(threshold=0.1)
    state = run(learner, world)
    assert state.end is End.STABLE
    assert state.interval.mean == pytest.approx(world.mean)
    assert learner.best(state) is None


# Alg. 2 ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("try_upper", "iterations"), [(True, 6), (False, 5)])
@pytest.mark.parametrize("threshold", [0.5, 0.37, 0.61])
def test_the_number_of_iterations_is_arithmetic(try_upper, iterations, threshold):
    learner = Ilrobs(K=1.0, delta=0.05, try_upper=try_upper)
    state = run(learner, World(threshold=threshold, knee=9.0))
    assert max(row.iteration for row in state.rows) == iterations
    assert state.high - state.low == 2**-5
    assert state.low <= threshold < state.high


@pytest.mark.parametrize(("reading", "count"), [(Reading.ONE_SIDED, 7), (Reading.TWO_SIDED, 4)])
def test_a_plan_must_succeed_many_times_in_a_row(reading, count):
    learner = Ilrobs(reading=reading, try_upper=False)
    state = learner.tell(learner.initial(), Planned(3.0))
    assert learner.ask(state).executions == count
    for i in range(count):
        assert learner.ask(state).executions == count - i
        state = learner.tell(state, Executed(success=True))
    assert (state.low, state.high) == (0.5, 1.0)
    state = learner.tell(state, Planned(3.0))
    state = learner.tell(state, Executed(success=True))
    state = learner.tell(state, Executed(success=False))
    assert (state.low, state.high) == (0.5, 0.75)
    assert state.rows[-1].trial.successes == 1


def test_errors_of_the_executions_up_to_the_first_failure_make_the_next_interval():
    learner = Ilrobs(K=2.0, try_upper=False)
    state = learner.tell(learner.initial(), Planned(3.0))
    assert state.trial.belief.error.is_zero
    for success, mean in ((True, 0.0), (True, 1.0), (False, 2.0)):
        state = learner.tell(state, Executed(success, Moments.of_means(10, [mean], [mean**2 + 0.25])))
    error = state.trial.belief.error
    assert error.mean == pytest.approx((1.0,))
    assert error.deviation == pytest.approx(((0.25 + 2 / 3) ** 0.5,))
    assert error.half_width[0] == pytest.approx(2 * (0.25 + 2 / 3) ** 0.5)
    state = learner.tell(state, Planned(4.0))
    state = learner.tell(state, Executed(False, Moments.of_means(10, [5.0], [26.0])))
    assert state.trial.belief.error.mean == (5.0,), "the latest executions alone"
    assert state.trial.belief.error.deviation == (1.0,)


def test_what_it_returns_is_planned_beside_what_was_executed():
    learner = Ilrobs(K=1.0, try_upper=False)
    world = World(threshold=0.5, knee=9.0, margin=0.1, samples=50)
    state = run(learner, world)
    best, returned = learner.best(state), learner.returned(state)
    assert best.result is Result.SUCCESS
    assert returned.result is Result.NOT_EXECUTED
    assert returned is state.rows[-1]
    assert returned.trial.friction == best.trial.friction == state.low
    assert returned.trial.belief.error == state.error
    assert returned.trial.duration == world.duration(returned.trial.belief)
    assert returned.trial.executions == 0


def test_an_interval_too_wide_for_a_plan_is_given_up_in_halves():
    world = World(threshold=0.4, knee=9.0, margin=0.0, deviation=(1.0,), mean=(0.0,), feasible=(0.0, 0.3))
    learner = Ilrobs(K=1.0, try_upper=False)
    state = run(learner, world)
    second = [row for row in state.rows if row.iteration == 2]
    assert [row.trial.belief.error.share for row in second] == [1, 0.5, 0.25]
    assert [row.result for row in second] == [Result.INFEASIBLE, Result.INFEASIBLE, Result.SUCCESS]
    assert half_width(second[-1].trial.belief) == 0.25
    assert learner.returned(state).trial.belief.error.share == 0.25
    assert state.low <= 0.4 < state.high


def test_friction_goes_up_where_not_even_the_problem_without_errors_has_a_plan():
    class Slope(World):
        def duration(self, belief):
            return None if belief.friction < 0.3 else super().duration(belief)

    learner = Ilrobs(K=1.0)
    state = run(learner, Slope(threshold=0.4, knee=9.0))
    quarter = [row for row in state.rows if row.trial.friction == 0.25]
    assert [row.trial.belief.error.share for row in quarter] == [1, 0.5, 0.25, 0.125, 0]
    assert quarter[-1].low == 0.25
    assert learner.best(state).trial.friction == 0.375


def test_ilrobs_at_its_upper_end_needs_one_iteration():
    learner = Ilrobs()
    state = run(learner, World(threshold=9.0))
    assert state.executed == learner.executions
    assert learner.returned(state).trial.belief.friction == 1.0
    assert [row.iteration for row in state.rows] == [1, 1]


def test_ilrobs_starts_without_errors():
    for learner in (Ilrobs(), Ilrobs(try_upper=False)):
        assert learner.ask(learner.initial()).belief == Belief(1.0 if learner.try_upper else 0.5, ErrorInterval())
