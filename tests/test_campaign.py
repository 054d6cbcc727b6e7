"""Campaigns: a learner, its planner and an executor of known threshold; interrupted, continued, run ahead, judged."""

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import pytest
from learning_tasks import ALGORITHMS, THRESHOLD, Threshold, remember_plans, task

from robustopt.confidence import clopper_pearson
from robustopt.config import Config
from robustopt.config.load import with_values
from robustopt.errors import ConfigError, RunFolderError, SolverFailed
from robustopt.learning.learner import Belief, End, Result
from robustopt.learning.moments import ErrorInterval
from robustopt.learning.outcomes import Executed
from robustopt.runs import beliefs
from robustopt.runs.beliefs import believing, described
from robustopt.runs.campaign import Judgement, Learned, learn, replayed
from robustopt.runs.executors import JUDGED, Simulated
from robustopt.runs.journal import Execution, Journal
from robustopt.runs.learning_run import result_of
from robustopt.solvers import Status


@pytest.fixture(autouse=True)
def _plans_are_made_once(monkeypatch):
    remember_plans(monkeypatch)


def frictions(learned: Learned) -> list[float | None]:
    return [row.trial.belief.friction for row in learned.rows]


def results(learned: Learned) -> str:
    return "".join(row.result.value[0].upper() for row in learned.rows)


# End to end -----------------------------------------------------------------------------------------------


def test_bisection_ends_where_the_same_path_5_percent_faster_fails():
    learned = learn(task("bisection", trials=0), Threshold())
    assert frictions(learned) == [1.0, 0.5, 0.25, 0.375]
    assert results(learned) == "FFSS"
    assert [row.trial.sped_up for row in learned.rows] == [None, None, True, False]
    assert learned.state.end is End.NEAR_OPTIMAL
    assert learned.best is learned.rows[-1]
    assert learned.finished
    durations = [row.trial.duration for row in learned.rows]
    assert durations[0] < durations[1] < durations[3] < durations[2]


def test_ilrobs_halves_and_returns_what_it_did_not_execute():
    learned = learn(task("ilrobs", trials=0), Threshold())
    assert frictions(learned) == [1.0, 0.5, 0.25, 0.375, 0.4375, 0.40625, 0.375]
    assert results(learned) == "FFSSFFN"
    assert [row.trial.executions for row in learned.rows] == [1, 1, 7, 7, 1, 1, 0]
    assert (learned.rows[-1].low, learned.rows[-1].high) == (0.375, 0.40625)
    assert learned.best is learned.rows[3]
    assert learned.returned is learned.rows[-1]
    errors = learned.rows[-1].trial.belief.error
    assert errors is not None
    assert errors.half_width[0] == pytest.approx(0.3, rel=0.3)


def test_plans_survive_the_errors_that_the_plan_before_showed():
    learned = learn(task("ilrobs", trials=0), Threshold())
    for before, after in pairwise(learned.rows[:-1]):
        assert after.trial.belief.error.mean == before.trial.errors.mean
        assert after.trial.belief.error.deviation == before.trial.errors.deviation


def test_acceleration_interval_is_stable_and_leaves_friction_alone():
    learned = learn(task("acceleration_interval", believed=0.3, executions=5, threshold=0.2), Threshold())
    assert learned.state.end is End.STABLE
    assert set(frictions(learned)) == {None}
    assert results(learned) == "S" * len(learned.rows)
    assert learned.rows[-1].trial.belief.error.half_width[0] == pytest.approx(0.3, rel=0.2)
    assert learned.judgement(learned.best).rate == 1.0


def test_calibrated_accepts_plans_that_meet_the_rate_and_no_other():
    learned = learn(task("ilrobs-calibrated"), Threshold(noise=0.02, batch=5))
    accepted = [row.trial.belief.friction for row in learned.rows if row.result is Result.SUCCESS]
    assert accepted
    assert max(accepted) <= THRESHOLD
    assert learned.best.trial.belief.friction == max(accepted)


@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_what_is_known_is_said_as_it_comes(algorithm):
    said: list[Learned] = []
    learned = learn(task(algorithm), Threshold(noise=0.05), progress=said.append)
    assert said[0].state == said[0].learner.initial()
    assert said[-1] == learned
    known = [(item.state.executed, len(item.rows), len(item.judged)) for item in said]
    assert known == sorted(known)


# Interrupted ----------------------------------------------------------------------------------------------


def one_event(config: Config, folder: Path) -> Learned | None:
    """Continue the journal in a folder for one event; what was learned once it is finished."""
    calls = 0

    def stop(_: Learned) -> None:
        nonlocal calls
        calls += 1
        if calls == 2:
            raise KeyboardInterrupt

    journal = Journal.open(folder)
    try:
        return learn(config, Threshold(noise=0.05), journal=journal, progress=stop)
    except KeyboardInterrupt:
        return None
    finally:
        journal.close()


@pytest.mark.parametrize("algorithm", ALGORITHMS)
@pytest.mark.parametrize("judged", ["all", "result"])
def test_stopped_after_every_single_event_it_learns_the_same(tmp_path, algorithm, judged):
    config = task(algorithm, judged=judged)
    Journal.create(tmp_path)
    known, learned, sessions = Journal.in_memory(), None, 0
    whole = learn(config, Threshold(noise=0.05), journal=known)
    while learned is None:
        learned = one_event(config, tmp_path)
        sessions += 1
        assert sessions < 1000
    assert sessions > len(whole.rows) + whole.state.executed
    assert learned == whole
    journal = Journal.open(tmp_path)
    assert list(journal.entries()) == list(known.entries())
    for plan in range(len(whole.rows)):
        assert journal.judgements(plan) == known.judgements(plan)


@pytest.mark.parametrize("algorithm", ["ilrobs", "ilrobs-calibrated"])
def test_stopped_within_executions_it_learns_the_same(tmp_path, algorithm):
    config = task(algorithm)
    executor = Threshold(noise=0.05, batch=3)
    whole = learn(config, executor)
    for call in range(0, len(executor.calls), 1 + len(executor.calls) // 8):
        folder = tmp_path / str(call)
        folder.mkdir()
        Journal.create(folder)
        journal = Journal.open(folder)
        with pytest.raises(KeyboardInterrupt):
            learn(config, Threshold(noise=0.05, batch=3, stop=call), journal=journal)
        journal.close()
        assert learn(config, Threshold(noise=0.05, batch=3), journal=Journal.open(folder)) == whole


def test_a_finished_journal_asks_for_nothing(tmp_path):
    config, executor = task("ilrobs"), Threshold()
    journal = Journal.in_memory()
    whole = learn(config, Threshold(), journal=journal)
    assert learn(config, executor, journal=journal) == whole
    assert executor.calls == []


@pytest.mark.parametrize(
    "other",
    [
        task("bisection"),
        task("ilrobs", K=2.0),
        task("ilrobs", try_upper=False),
        task("ilrobs-calibrated"),
    ],
)
def test_a_journal_of_another_task_is_refused(other):
    journal = Journal.in_memory()
    learn(task("ilrobs", trials=0), Threshold(), journal=journal)
    with pytest.raises(RunFolderError, match=r"the journal does not fit this task: plan \d+ in it"):
        learn(other, Threshold(), journal=journal)


def test_a_journal_with_executions_that_nobody_asked_for_is_refused():
    journal, config = Journal.in_memory(), task("ilrobs", trials=0)
    learned = learn(config, Threshold(), journal=journal)
    journal.add_executions(1.0, [Execution(99, Executed(True, learned.rows[0].trial.errors))])
    with pytest.raises(RunFolderError, match="does not fit"):
        replayed(learned.learner, journal)


def test_a_plan_that_is_another_one_when_made_again_is_not_executed():
    config, journal, executor = task("ilrobs", trials=0), Journal.in_memory(), Threshold()
    whole = learn(config, Threshold())
    journal.add_plan(whole.rows[0].trial.belief, 1.001 * whole.rows[0].trial.duration)
    with pytest.raises(RunFolderError, match=r"a plan in the journal lasts .* and made again it lasts"):
        learn(config, executor, journal=journal)
    assert executor.calls == []


def test_the_best_plan_must_be_the_one_that_was_executed():
    config, journal = task("ilrobs", trials=0), Journal.in_memory()
    whole = learn(config, Threshold())
    best = whole.best
    trial = replace(best.trial, duration=1.001 * best.trial.duration)
    rows = tuple(replace(row, trial=trial) if row is best else row for row in whole.rows)
    other = replace(whole, state=replace(whole.state, rows=rows))
    assert result_of(whole, journal).planned.plan.duration == best.trial.duration
    with pytest.raises(RunFolderError, match="made again it lasts"):
        result_of(other, journal)


# Run ahead ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("algorithm", ALGORITHMS)
@pytest.mark.parametrize("batch", [2, 7, 1000])
def test_executions_ahead_change_nothing(algorithm, batch):
    config, one, many = task(algorithm), Journal.in_memory(), Journal.in_memory()
    alone = learn(config, Threshold(noise=0.05), journal=one)
    assert learn(config, Threshold(noise=0.05, batch=batch), journal=many) == alone
    assert list(one.entries()) == list(many.entries())


def test_simulation_runs_ahead_as_many_as_are_known():
    executor = Simulated(task(), workers=2)
    assert executor.ahead(wanted=1, done=10) == 1
    assert executor.ahead(wanted=100, done=10) == 10
    assert executor.ahead(wanted=10_000, done=9_000) == 50
    assert 1 <= executor.ahead(wanted=100, done=0) <= 100


# Judged ---------------------------------------------------------------------------------------------------


def test_all_plans_are_judged_by_the_same_fresh_executions():
    executor = Threshold(noise=0.05, batch=4)
    learned = learn(task("ilrobs", trials=30), executor)
    assert sorted(learned.judged) == list(range(len(learned.rows)))
    fresh = [numbers for numbers in executor.calls if numbers[0] >= JUDGED]
    assert sorted(k for numbers in fresh for k in numbers) == sorted(list(range(JUDGED, JUDGED + 30)) * 7)
    assert {len(numbers) for numbers in fresh} == {4, 2}, "as many at once as the executor takes"
    rates = [learned.judged[i].rate for i in sorted(range(7), key=lambda i: learned.rows[i].trial.friction)]
    assert rates == sorted(rates, reverse=True)
    first = learned.judged[0]
    assert (first.trials, first.successes, first.statuses) == (30, 0, {"slid": 30})


def test_only_what_is_returned_is_judged_where_that_is_asked_for():
    learned = learn(task("ilrobs", judged="result"), Threshold())
    assert sorted(learned.judged) == [3, 6]
    assert learned.judgement(learned.returned) == Judgement(10, 10, {"success": 10})
    assert learned.judgement(learned.rows[0]) is None
    assert learned.judgement(None) is None


@pytest.mark.parametrize(("trials", "fresh"), [(0, True), (10, False)])
def test_nothing_is_judged_without_fresh_executions(trials, fresh):
    executor = Threshold(fresh=fresh)
    assert learn(task("ilrobs", trials=trials), executor).judged == {}
    assert max(max(numbers) for numbers in executor.calls) < JUDGED


def test_judging_does_not_change_what_is_learned():
    alone = learn(task("ilrobs-calibrated", trials=0), Threshold(noise=0.05))
    judged = learn(task("ilrobs-calibrated", trials=50), Threshold(noise=0.05))
    assert alone.state == judged.state


def test_the_interval_of_a_judgement_is_that_of_clopper_and_pearson():
    assert Judgement(50, 40, {}).interval(0.9) == clopper_pearson(40, 50, 0.9)


# Beliefs --------------------------------------------------------------------------------------------------


def test_a_belief_stands_in_place_of_what_the_configuration_says():
    config = task(believed=0.5)
    config = with_values(config, {"uncertainty.friction": [0.4, 0.6]})
    assert believing(config, Belief()) is config
    learned = believing(config, Belief(0.3, ErrorInterval((0.1,), (0.2,), 2.0, 0.5)))
    assert (learned.contact.friction, learned.uncertainty.friction) == (0.3, None)
    error = learned.uncertainty.joint_acceleration
    assert error is not None
    assert (error.mean, error.deviation, error.K) == (0.05, 0.1, 2.0)
    assert believing(config, Belief(0.3, ErrorInterval())).uncertainty.joint_acceleration is None
    other = believing(config, Belief(parameters=(("contact.friction", 0.2), ("objects.block.mass", 0.4))))
    assert (other.contact.friction, other.uncertainty.friction, other.objects["block"].mass) == (0.2, None, 0.4)
    with pytest.raises(ConfigError, match="nonsense"):
        believing(config, Belief(parameters=(("contact.nonsense", 0.2),)))


def test_beliefs_in_words():
    assert described(Belief()) == "the nominal values"
    belief = Belief(0.5, ErrorInterval((0.0, 0.1), (0.2, 0.3), 2.0), (("objects.block.mass", 0.4),))
    words = "friction 0.5 and acceleration errors up to +-0.6 (K = 2) and objects.block.mass = 0.4"
    assert described(belief) == words


def test_a_belief_without_a_plan_is_an_outcome():
    learned = learn(task("ilrobs", trials=10), Threshold(deviation=30.0))
    infeasible = [i for i, row in enumerate(learned.rows) if row.result is Result.INFEASIBLE]
    assert infeasible
    assert all(learned.rows[i].trial.duration is None for i in infeasible)
    assert not set(infeasible) & set(learned.judged)
    shares = [row.trial.belief.error.share for row in learned.rows]
    assert shares[:2] == [1.0, 1.0]
    assert set(shares) > {1.0, 0.5}
    assert learned.best is not None


@pytest.mark.parametrize("algorithm", ["acceleration_interval", "bisection"])
def test_no_plan_at_all_is_an_end(algorithm):
    config = with_values(task(algorithm, 0.3, friction=[0.0, 0.3]), {"gravity": [5.0, 0.0, -9.81]})
    executor = Threshold()
    learned = learn(config, executor)
    assert set(results(learned)) == {"I"}
    assert (learned.best, learned.returned, learned.judged, executor.calls) == (None, None, {}, [])
    assert learned.state.end is (End.NO_PLAN if algorithm == "acceleration_interval" else End.NO_SUCCESS)


def test_a_plan_that_fails_its_certificate_ends_everything(monkeypatch):
    certify = beliefs.certify
    monkeypatch.setattr(beliefs, "certify", lambda *arguments: replace(certify(*arguments), passed=False))
    journal, config = Journal.in_memory(), task("ilrobs", friction=[0.0, 0.77])  # which no other test plans
    with pytest.raises(SolverFailed, match=r"the plan for friction 0\.77 failed its certificate"):
        learn(config, Threshold(), journal=journal)
    assert list(journal.entries()) == []


def test_a_solver_without_an_answer_ends_everything(monkeypatch):
    solve = beliefs.solve
    monkeypatch.setattr(beliefs, "solve", lambda rows: replace(solve(rows), status=Status.FAILED, message="Broken."))
    journal, config = Journal.in_memory(), task("ilrobs", friction=[0.0, 0.78])
    with pytest.raises(SolverFailed, match=r"no plan for friction 0\.78: Broken"):
        learn(config, Threshold(), journal=journal)
    assert list(journal.entries()) == []


def test_a_task_without_objects_has_nothing_to_learn():
    config = with_values(task(), {"objects": {}, "execution": None})
    with pytest.raises(ConfigError, match="expected at least one that friction holds"):
        learn(config, Threshold())


def test_learners_that_compare_fastest_plans_refuse_another_cost():
    config = with_values(
        task("bnb-midpoint", parameters=[{"key": "contact.friction", "optimistic": 1.0, "conservative": 0.1}]),
        {"solver": {"method": "ipopt", "collocation_points": 20, "cost": "effort", "weight": 1.0}},
    )
    with pytest.raises(ConfigError, match=r"found effort with bnb-midpoint.*expected time"):
        learn(config, Threshold())
