"""Summary of a learner: the record of every plan, and the result with the confidence that it deserves."""

from __future__ import annotations

from math import isclose
from typing import Any

from robustopt.confidence import Reading, paper_executions, phi, probability_of_rate
from robustopt.config import LearningConfig
from robustopt.evidence import grouped
from robustopt.learning.calibrated import Calibrated
from robustopt.learning.earned import earned
from robustopt.learning.learner import End, Result, Row
from robustopt.learning.physics import Physics
from robustopt.runs.beliefs import described
from robustopt.runs.campaign import Learned
from robustopt.runs.plan_run import PlanResult, summary
from robustopt.runs.records import FailuresRecord, Iteration, LearningRecord, RunStatus, Summary


def learning_summary(learned: Learned, planned: PlanResult | None, diverged: bool) -> Summary:
    """Return the summary of a learner that is finished.

    Args:
        learned: the result.
        planned: the best plan, made again.
        diverged: whether every simulation diverged.
    """
    own = Summary(
        kind="learning",
        name=learned.config.name,
        status=_status(learned, diverged),
        message=sentence(learned),
        learning=_learning_record(learned),
    )
    if planned is None:
        return own.model_copy(update={"duration": None})
    return summary(planned).model_copy(update={name: getattr(own, name) for name in own.model_fields_set})


def _status(learned: Learned, diverged: bool) -> RunStatus:
    if learned.best is not None:
        return RunStatus.LEARNED
    if diverged:
        return RunStatus.SIMULATION_FAILED
    return RunStatus.NO_PLAN if learned.state.end is End.NO_PLAN else RunStatus.NO_SUCCESS


def _learning_record(learned: Learned) -> LearningRecord:
    """Return the part of a summary about learning."""
    best, returned, end = learned.best, learned.returned, learned.state.end
    assert end is not None
    return LearningRecord(
        algorithm=learned.learner.name,
        end=end.value,
        iterations=max((row.iteration for row in learned.rows), default=0),
        plans=len(learned.rows),
        executions=learned.state.executed,
        target_rate=target_rate(learned.settings),
        best=row_record(learned, best) if best else None,
        returned=row_record(learned, returned) if returned else None,
        confidence=confidence_sentence(learned),
        rows=tuple(row_record(learned, row) for row in learned.rows),
        failures=tuple(
            FailuresRecord.model_validate(group)
            for group in grouped(failure for row in learned.rows for failure in row.trial.failed)
        ),
    )


_FIXED_FRICTION = (End.STABLE, End.ITERATION_LIMIT)
"""Ends of the learner that leaves friction alone."""


def sentence(learned: Learned) -> str:
    """Return the result of a learner in a few sentences.

    Args:
        learned: the learned intervals.
    """
    best, end = learned.best, learned.state.end
    assert end is not None
    spent = f"{_count(learned.state.executed, 'execution')} of {_count(_executed_plans(learned), 'plan')}"
    if best is None:
        friction = " Friction stayed at its nominal value; `ilrobs` learns it too." if end in _FIXED_FRICTION else ""
        return f"{end.sentence} {spent}.{friction}{_even_the_slowest(learned)}"
    trial = best.trial
    times = f"{trial.successes} of {trial.successes + trial.failures} times{_fresh(learned, best)}"
    text = f"A plan of {trial.duration:.4f} s, for {described(trial.belief)}, succeeded {times}."
    returned = learned.returned
    if returned is not None and returned is not best:
        answer = f"{described(returned.trial.belief)}: {returned.trial.duration:.4f} s, not executed as such"
        text += f" The algorithm returns {answer}{_fresh(learned, returned)}."
    return f"{text} {end.sentence} {spent}.{_unconfirmed(learned, best)}{_too_few_in_a_row(learned, best)}"


def _unconfirmed(learned: Learned, best: Row) -> str:
    """Return a warning if the search by physics ended before its result had succeeded as often as it must."""
    if not isinstance(learned.learner, Physics) or best.trial.successes >= learned.learner.executions_per_plan:
        return ""
    wanted = learned.learner.executions_per_plan
    return f" The plan was not confirmed by {wanted} executions in a row: raise learning.budget."


def _too_few_in_a_row(learned: Learned, best: Row) -> str:
    """Return the advice to ask for more than one success if fresh executions of the best plan differ."""
    judgement, settings = learned.judgement(best), learned.settings
    varied = judgement is not None and 0 < judgement.successes < judgement.trials
    if not (varied and best.trial.belief.parameters and settings.executions_per_plan == 1):
        return ""
    times = max(paper_executions(settings.K, Reading(settings.reading)), 2)
    return (
        " Executions vary here, and one that succeeds says little of a plan: learning.executions_per_plan="
        f"{times} asks for a rate of about {1 - 1 / times:.2f}."
    )


def _count(number: int, name: str) -> str:
    return f"{number:,} {name}{'' if number == 1 else 's'}"


def _even_the_slowest(learned: Learned) -> str:
    """Return a warning if a plan failed with all parameters at their conservative ends, which are meant to be safe."""
    ends = {parameter.key: parameter.conservative for parameter in learned.settings.parameters}
    for row in learned.rows:
        values = dict(row.trial.belief.parameters)
        if values and row.trial.failures and all(isclose(values[key], end) for key, end in ends.items()):
            return (
                " Even the conservative values of all parameters failed, so nothing in these intervals is known to be"
                " safe: choose more conservative ones, or look for another cause."
            )
    return ""


def _fresh(learned: Learned, row: Row) -> str:
    judgement = learned.judgement(row)
    if judgement is None:
        return ""
    confidence = learned.settings.confidence
    low, high = (f"{100 * end:.1f}" for end in judgement.interval(confidence))
    return (
        f", and in {judgement.successes:,} of {judgement.trials:,} fresh executions "
        f"({low} to {high} % at {100 * confidence:g} % confidence)"
    )


def _executed_plans(learned: Learned) -> int:
    return sum(row.trial.executions > 0 for row in learned.rows)


def target_rate(settings: LearningConfig) -> float:
    """Return the success rate that plans must meet: Phi(K) for ilrobs, else the configured one.

    Args:
        settings: the section `learning`.
    """
    return phi(settings.K, Reading(settings.reading)) if settings.algorithm == "ilrobs" else settings.success_rate


def confidence_sentence(learned: Learned) -> str:
    """Return a sentence with the confidence that the executions of the best plan earn.

    Args:
        learned: the learned intervals.
    """
    best, settings = learned.best, learned.settings
    if best is None:
        return ""
    if isinstance(learned.learner, Calibrated):
        return (
            f"With a confidence of {settings.confidence:g} no accepted plan, this one among them, has a success "
            f"rate below {settings.success_rate:g}."
        )
    rate = target_rate(settings)
    return earned(best.trial.successes, rate, settings.confidence, max(_executed_plans(learned), 1)).sentence


def row_record(learned: Learned, row: Row) -> Iteration:
    """Return the record of a plan, with its fresh executions and the probability that its failure was bad luck.

    Args:
        learned: the learned intervals.
        row: the row of the plan.
    """
    extra: dict[str, object] = {}
    if row.trial.failures and not row.trial.belief.parameters:
        rate = target_rate(learned.settings)
        successes, failures = row.trial.successes, row.trial.failures
        extra["bad_luck"] = probability_of_rate(successes, failures, rate, learned.settings.prior)
    if row.lower_bound is not None and row.gap is not None:
        extra["incumbent"] = row.lower_bound * (1 + row.gap)
    judgement = learned.judgement(row)
    if judgement is not None:
        low, high = judgement.interval(learned.settings.confidence)
        extra |= {"fresh_trials": judgement.trials, "fresh_successes": judgement.successes}
        extra |= {"success_rate": judgement.rate, "success_low": low, "success_high": high}
        extra["fresh_statuses"] = dict(judgement.statuses)
    return Iteration.model_validate({**row.record(), **extra})


def row_columns(learned: Learned, row: Row) -> dict[str, Any]:
    """Return the record of a plan as the columns of `iterations.csv`.

    Args:
        learned: the learned intervals.
        row: the row of the plan.
    """
    record = row_record(learned, row)
    failures = "; ".join(f"{group.name} ({group.count})" for group in record.failures)
    return record.model_dump(exclude_unset=True) | {"failures": failures}


def trial_record(learned: Learned) -> Iteration | None:
    """Return the record of the plan that is under test, None at the end.

    Args:
        learned: the learned intervals.
    """
    trial = learned.state.trial
    if trial is None:
        return None
    iteration = max((row.iteration for row in learned.rows), default=0) + 1
    return Iteration.model_validate({**Row(iteration, trial, Result.UNDECIDED).record(), "result": None})
