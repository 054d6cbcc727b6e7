"""Plans, executes and learns: carries out, journals and answers the requests of a learner until it is finished."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from math import inf, isfinite
from typing import TYPE_CHECKING, Any

from robustopt.arrays import Array
from robustopt.confidence import Reading, clopper_pearson, paper_executions
from robustopt.config import Config, LearningConfig
from robustopt.errors import ConfigError, RunFolderError
from robustopt.learning import learner_of
from robustopt.learning.learner import Learner, Planned, Request, Result, Row, State, Trial, tell_all
from robustopt.learning.parameters import Cost
from robustopt.learning.physics import Physics
from robustopt.runs.beliefs import Planner, learned_from
from robustopt.runs.executors import JUDGED, Executor, Simulated
from robustopt.runs.foresight import PlannedForesight, usual_parameters
from robustopt.runs.journal import Journal
from robustopt.runs.plan_run import PlanResult
from robustopt.simulation.monte_carlo import is_random
from robustopt.solvers.batch import BatchPlanner
from robustopt.views import view

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from pandas import DataFrame

SAME_PLAN = 1e-6
"""Largest relative difference in duration of a plan that is made again."""


@dataclass(frozen=True)
class Judgement:
    """Fresh executions of a plan: their number, their successes, and the count of each status."""

    trials: int
    successes: int
    statuses: Mapping[str, int]

    @property
    def rate(self) -> float:
        """Share of the executions that succeeded."""
        return self.successes / self.trials

    def interval(self, confidence: float) -> tuple[float, float]:
        """Return the Clopper-Pearson interval of the success rate.

        Args:
            confidence: confidence level of the interval.
        """
        return clopper_pearson(self.successes, self.trials, confidence)


@dataclass(frozen=True)
class Learned:
    """Result of a learner, once it is finished or so far.

    Attributes:
        config: the task.
        learner: with its settings.
        state: all that the learner has seen.
        judged: fresh executions of the plan of each row, by its index.
    """

    config: Config
    learner: Learner[Any]
    state: State
    judged: Mapping[int, Judgement] = field(default_factory=dict)

    @property
    def settings(self) -> LearningConfig:
        """The `learning` section of the task, with its defaults."""
        return learning_of(self.config)

    @property
    def finished(self) -> bool:
        """Whether the learner has nothing left to ask."""
        return self.learner.finished(self.state)

    @property
    def rows(self) -> tuple[Row, ...]:
        """The plans that were tried, in order."""
        return self.learner.history(self.state)

    @property
    def best(self) -> Row | None:
        """The best plan that succeeded, None without one."""
        return self.learner.best(self.state)

    @property
    def returned(self) -> Row | None:
        """The plan that the algorithm returns, which may not have been executed as such."""
        return self.learner.returned(self.state)

    def judgement(self, row: Row | None) -> Judgement | None:
        """Return the fresh executions of a plan, None if there are none.

        Args:
            row: the row of the plan, or None.
        """
        index = next((i for i, other in enumerate(self.rows) if other is row), -1)
        return self.judged.get(index)

    def to_frame(self) -> DataFrame:
        """Return the plans that were tried as a table, one row each, with the columns of `iterations.csv`."""
        return view("robustopt.frames.learned_frame", self)

    def plot(self) -> Figure:
        """Return a figure of the learned interval, the duration and the success rate of every plan in order."""
        return view("robustopt.plotting.views.learned_figure", self)

    def _repr_html_(self) -> str:
        return view("robustopt.frames.learned_html", self)


Progress = Callable[[Learned], None]
"""Called with the result so far, whenever there is more than before."""


def learn(
    config: Config,
    executor: Executor | None = None,
    *,
    learner: Learner[Any] | None = None,
    journal: Journal | None = None,
    workers: int = 1,
    progress: Progress | None = None,
) -> Learned:
    """Run the learner of a configuration, or one of your own, to its end.

    The same configuration and seed give the same result, bit for bit, whatever the number of workers, and however often
    the learner was interrupted and continued from its journal.

    Args:
        config: the task; its `learning` section names the learner, its `execution` section the simulated world.
        executor: runs the plans, instead of the simulation.
        learner: a learner of your own, instead of the one that `learning.algorithm` names; see docs/extending.md.
        journal: holds earlier events and records new ones; without it nothing is kept.
        workers: number of processes that plan and simulate.
        progress: called with the result so far, whenever there is more than before.

    Returns:
        The result, with every plan that was tried.

    Raises:
        ConfigError: the learner or the world does not fit the task.
        SolverFailed: a plan failed its certificate.
        RunFolderError: the journal is of another task, or cannot be written.
        KeyboardInterrupt: interrupted; the journal has all that happened before.
    """
    executor, journal = executor or Simulated(config, workers), journal or Journal.in_memory()
    return _Campaign(config, executor, learner, journal, workers, progress).run()


class _Campaign:
    """Learner at work, with its planner, its executor and its journal."""

    def __init__(
        self,
        config: Config,
        executor: Executor,
        learner: Learner[Any] | None,
        journal: Journal,
        workers: int,
        progress: Progress | None,
    ) -> None:
        if not config.contact_owners:
            raise ConfigError("found no objects; expected at least one that friction holds", key="objects")
        self.config = config
        self.settings = learning_of(config)
        self.learner = learner or configured_learner(config, workers, hardware=not executor.fresh)
        self.executor, self.journal, self.progress = executor, journal, progress
        self.planner = Planner(config)
        self.state = replayed(self.learner, journal)
        self.judged = {i: found for i in range(len(self.state.rows)) if (found := self._known(i)) is not None}

    def run(self) -> Learned:
        self._say()
        while (request := self.learner.ask(self.state)) is not None:
            rows = len(self.state.rows)
            if request.executions == 0:
                self._plan(request)
            else:
                self._execute(request)
            self._say()
            if len(self.state.rows) > rows and self.settings.judged == "all":
                self._judge(rows)
        for i in self._to_judge():
            self._judge(i)
        return self.learned

    @property
    def learned(self) -> Learned:
        return Learned(self.config, self.learner, self.state, dict(self.judged))

    def _say(self) -> None:
        if self.progress is not None:
            self.progress(self.learned)

    def _plan(self, request: Request) -> None:
        result = self.planner.plan(request.belief)
        duration = result.plan.duration if result.certified else None
        self.journal.add_plan(request.belief, duration)
        self.state = self.learner.tell(self.state, Planned(duration))

    def _execute(self, request: Request) -> None:
        trial = self.state.trial
        assert trial is not None
        count = self.executor.ahead(request.executions, trial.executions)
        numbers = range(request.first, request.first + count)
        executions = self.executor.run(made_again(self.planner, trial), numbers, request.speed)
        self.state, used = tell_all(self.learner, self.state, [execution.outcome for execution in executions])
        self.journal.add_executions(request.speed, executions[:used])

    # Judging ---------------------------------------------------------------------------------------------

    def _to_judge(self) -> list[int]:
        """Return the rows whose success rate is wanted: all of them, or the best and the returned one."""
        rows = self.state.rows
        if self.settings.judged == "all":
            return list(range(len(rows)))
        wanted = (self.learner.best(self.state), self.learner.returned(self.state))
        return [i for i, row in enumerate(rows) if any(row is other for other in wanted)]

    def _judge(self, i: int) -> None:
        """Run the fresh executions of a row's plan that the journal does not have yet."""
        row, total = self.state.rows[i], self.settings.trials
        if row.trial.duration is None or row.result is Result.INFEASIBLE or not self.executor.fresh:
            return
        known = self.journal.judgements(i)
        missing = [JUDGED + k for k in range(total) if JUDGED + k not in known]
        if not missing:
            return
        while missing:
            count = self.executor.ahead(len(missing), total)
            numbers, missing = missing[:count], missing[count:]
            self.journal.add_judgements(i, self.executor.run(made_again(self.planner, row.trial), numbers, 1.0))
        found = self._known(i)
        if found is not None:
            self.judged[i] = found
        self._say()

    def _known(self, i: int) -> Judgement | None:
        """Return the fresh executions of a row's plan, once the journal has them all."""
        found = list(self.journal.judgements(i).values())
        if not found or len(found) < self.settings.trials:
            return None
        statuses = [status for _, status in found]
        counts = {status: statuses.count(status) for status in dict.fromkeys(statuses)}
        return Judgement(len(found), sum(success for success, _ in found), counts)


def made_again(planner: Planner, trial: Trial) -> PlanResult:
    """Return the plan of a trial, which an interrupted run has to make once more.

    Args:
        planner: the planner.
        trial: the trial.

    Raises:
        RunFolderError: the plan has another duration than before.
    """
    result = planner.plan(trial.belief)
    before, now = trial.duration, result.plan.duration if result.certified else inf
    assert before is not None, "a belief without a plan is not executed"
    if not abs(now - before) <= SAME_PLAN * before:
        found = f"made again it lasts {now:.9g} s" if isfinite(now) else "now there is no plan"
        raise RunFolderError(
            f"a plan in the journal lasts {before:.9g} s, and {found}; expected the same machine, the same versions of "
            "robustopt and of its libraries, and an unchanged robot model"
        )
    return result


def learning_of(config: Config, hardware: bool = False) -> LearningConfig:
    """Return the section `learning`, its executions per plan and parameters of `physics` filled in from the task.

    Args:
        config: the task.
        hardware: whether a person executes the plans on a robot, where executions vary.
    """
    settings = config.learning or LearningConfig()
    if settings.algorithm == Physics.name and not settings.parameters:
        settings = settings.model_copy(update={"parameters": usual_parameters(config)})
    if settings.executions_per_plan is not None:
        return settings
    varies = hardware or (config.execution is not None and is_random(config.execution))
    times = paper_executions(settings.K, Reading(settings.reading)) if varies else 1
    return settings.model_copy(update={"executions_per_plan": times})


def verdict_note(config: Config, hardware: bool = False) -> str:
    """Return a note on the success rate that a plan must have, empty if the user set it or one success suffices.

    Args:
        config: the task.
        hardware: whether a person executes the plans on a robot.
    """
    settings = learning_of(config, hardware)
    given = config.learning is not None and config.learning.executions_per_plan is not None
    times = settings.executions_per_plan or 1
    if given or times == 1 or not settings.parameters:
        return ""
    return (
        f"executions vary here, so a plan must succeed at a rate of about {1 - 1 / times:.2f}, or {times} times in a "
        f"row (K = {settings.K:g}); set learning.executions_per_plan to 1 to accept a single success"
    )


def configured_learner(config: Config, workers: int = 1, hardware: bool = False) -> Learner[Any]:
    """Return the learner that a configuration names, with all that it must know of the task.

    Args:
        config: the task.
        workers: number of processes that plan.
        hardware: whether a person executes the plans on a robot.

    Raises:
        ConfigError: the learner does not fit the task.
    """
    settings = learning_of(config, hardware)
    keys = [parameter.key for parameter in settings.parameters]
    foresight = PlannedForesight(learned_from(config, keys), keys) if settings.algorithm == Physics.name else None
    return learner_of(settings, cost_of(config, settings, workers), foresight)


def cost_of(config: Config, settings: LearningConfig, workers: int = 1) -> Cost:
    """Return f* of the learned parameters: the duration of their fastest plan, computed in batches and once each.

    Args:
        config: the task.
        settings: names the parameters.
        workers: number of processes.
    """
    keys = [parameter.key for parameter in settings.parameters]
    batch = BatchPlanner(learned_from(config, keys), workers)

    def cost(values: Array) -> Array:
        if config.solver.cost != "time":
            found = f"found {config.solver.cost} with {settings.algorithm}, which compares fastest plans"
            raise ConfigError(f"{found}; expected time", key="solver.cost")
        return batch.durations([dict(zip(keys, row, strict=True)) for row in values.tolist()])

    return cost


def replayed(learner: Learner[Any], journal: Journal) -> Any:
    """Return the state of a learner after all events of a journal.

    Args:
        learner: the learner.
        journal: the journal.

    Raises:
        RunFolderError: the journal does not answer the requests of this learner.
    """
    state = learner.initial()
    for number, entry in enumerate(journal.entries()):
        request = learner.ask(state)
        _require(request is not None and request.executions == 0 and request.belief == entry.belief, number)
        state = learner.tell(state, Planned(entry.duration))
        for speed, execution in entry.executions:
            request = learner.ask(state)
            fits = request is not None and (request.speed, request.first) == (speed, execution.number)
            _require(fits and request is not None and request.executions > 0, number)
            state = learner.tell(state, execution.outcome)
    return state


def _require(fits: bool, plan: int) -> None:
    if not fits:
        raise RunFolderError(
            f"the journal does not fit this task: plan {plan} in it is none that the learner asks for; "
            "expected the journal of the same configuration and the same version of robustopt"
        )
