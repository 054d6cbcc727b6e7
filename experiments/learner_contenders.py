"""Contenders of the learners of several parameters: the same contract and verdicts, other choices of points.

Every contender skips points that are decided or cost too much, so none wastes an execution that `monotone` shows to be
useless. Optuna's samplers get the cost as objective, success as a constraint, and the inferences from monotony at no
cost.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from importlib.util import find_spec
from typing import ClassVar

import numpy as np

from robustopt.arrays import Array
from robustopt.learning.branch_and_bound import BranchAndBound, BranchState, Diagonal, Midpoint
from robustopt.learning.informed import Informed
from robustopt.learning.learner import Result
from robustopt.learning.monotone import Knowledge
from robustopt.learning.parameters import Point

DRAWS = 2000
"""Number of points from which a random one is taken."""


@dataclass(frozen=True, kw_only=True)
class Contender(BranchAndBound):
    """A method with random choices; `seed` is their seed."""

    seed: int = 0

    def _least(self, state: BranchState) -> float:
        return float(self.map.exact(np.zeros((1, self.k)))[0])

    def _random(self, state: BranchState) -> np.random.Generator:
        return np.random.default_rng([self.seed, len(state.rows)])

    def _useful(self, points: Array, known: Knowledge, cut: float) -> Array:
        return points[known.undecided(points) & (self.map.exact(points) < cut)]

    def _any(self, state: BranchState, known: Knowledge, cut: float) -> Point | None:
        """Return a random undecided point that costs less than `cut`."""
        random = self._random(state)
        for _ in range(50):
            points = self._useful(random.random((DRAWS, self.k)), known, cut)
            if len(points):
                return tuple(points[0].tolist())
        return None


@dataclass(frozen=True, kw_only=True)
class RandomSearch(Contender):
    name: ClassVar[str] = "random"

    def _propose(self, state: BranchState, known: Knowledge, cut: float) -> Point | None:
        return self._any(state, known, cut)


@dataclass(frozen=True, kw_only=True)
class Grid(Contender):
    """The centres of the cells of 2^k, then 4^k, 8^k, 16^k grids, in random order."""

    name: ClassVar[str] = "grid"

    def _propose(self, state: BranchState, known: Knowledge, cut: float) -> Point | None:
        for side in (2, 4, 8, 16):
            axes = np.meshgrid(*[(np.arange(side) + 0.5) / side] * self.k, indexing="ij")
            points = self._useful(np.stack(axes, axis=-1).reshape(-1, self.k), known, cut)
            if len(points):
                return tuple(self._random(state).choice(points).tolist())
        return None


@dataclass(frozen=True, kw_only=True)
class Optuna(Contender):
    """A sampler of Optuna; the study is made again from all executions, so that `ask` stays a pure function.

    Attributes:
        proposals: number of proposals for one execution; if all are useless, a random undecided point is executed.
    """

    proposals: ClassVar[int] = 30

    def _propose(self, state: BranchState, known: Knowledge, cut: float) -> Point | None:
        import optuna

        optuna.logging.set_verbosity(optuna.logging.ERROR)
        study = optuna.create_study(sampler=self._sampler(int(self._random(state).integers(2**31))))
        space = {str(axis): optuna.distributions.FloatDistribution(0, 1) for axis in range(self.k)}

        def tell(point: Point, success: bool) -> None:
            constraint = {"success": (-1.0,) if success else (1.0,)}
            cost = float(self.map.exact(np.array([point]))[0])
            coordinates = {str(axis): value for axis, value in enumerate(point)}
            study.add_trial(
                optuna.create_trial(params=coordinates, distributions=space, value=cost, user_attrs=constraint,
                                    system_attrs={"constraints": list(constraint["success"])})
            )  # fmt: skip

        tell((1.0,) * self.k, True)
        for row, point in zip(state.rows, state.points, strict=True):
            tell(point, row.result is Result.SUCCESS)
        for _ in range(self.proposals):
            trial = study.ask(space)
            point = tuple(float(trial.params[str(axis)]) for axis in range(self.k))
            at = np.array([point])
            if known.undecided(at)[0] and self.map.exact(at)[0] < cut:
                return point
            failed = bool(np.any(np.all(at <= known.failures, axis=1)))
            trial.set_user_attr("success", (1.0,) if failed else (-1.0,))
            study.tell(trial, float(self.map.exact(at)[0]))
        return self._any(state, known, cut)

    @abstractmethod
    def _sampler(self, seed: int):
        """Return the sampler of Optuna."""


@dataclass(frozen=True, kw_only=True)
class Tpe(Optuna):
    name: ClassVar[str] = "optuna TPE"

    def _sampler(self, seed: int):
        from optuna.samplers import TPESampler

        return TPESampler(seed=seed, n_startup_trials=5, multivariate=True, constraints_func=_constraint)


@dataclass(frozen=True, kw_only=True)
class Gp(Optuna):
    name: ClassVar[str] = "optuna GP"
    proposals: ClassVar[int] = 3  # each fits a Gaussian process, for half a second

    def _sampler(self, seed: int):
        from optuna.samplers import GPSampler

        return GPSampler(seed=seed, n_startup_trials=5, deterministic_objective=True, constraints_func=_constraint)


def _constraint(trial) -> tuple[float, ...]:
    return trial.user_attrs["success"]


OURS: tuple[type[BranchAndBound], ...] = (Informed, Diagonal, Midpoint)


def contenders() -> dict[str, Callable[..., BranchAndBound]]:
    """Return all methods by name; Optuna's GP sampler only if torch is installed, which it needs."""
    others: list[type[Contender]] = [RandomSearch, Grid, Tpe]
    if find_spec("torch"):
        others.append(Gp)
    return {learner.name: learner for learner in (*OURS, *others)}
