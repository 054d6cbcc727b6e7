"""Plans for the values that a learner asks about, in place of the nominal ones of the configuration."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from robustopt.certificate import certify
from robustopt.config import BASE_COORDINATES as BASE
from robustopt.config import Config
from robustopt.config.document import split_key
from robustopt.config.load import with_values
from robustopt.errors import SolverFailed
from robustopt.learning.learner import Belief
from robustopt.learning.moments import ErrorInterval
from robustopt.limits import rows_along
from robustopt.limits.grid import numbered_grid
from robustopt.limits.track import Track, build_track
from robustopt.runs.plan_run import PlanResult
from robustopt.solvers import Status, solve, track_of
from robustopt.solvers.batch import with_setting


def believing(config: Config, belief: Belief) -> Config:
    """Return the configuration with the values of a belief in place of its own.

    A learned coefficient of friction applies to all contacts; a learned interval of the joint acceleration error
    replaces the configured one.

    Args:
        config: the configuration.
        belief: values by key.

    Raises:
        ConfigError: a key of the belief does not fit the configuration.
    """
    values: dict[str, Any] = {}
    if belief.friction is not None:
        values |= {"uncertainty.friction": None, "contact.friction": belief.friction}
    if belief.error is not None:
        values |= _acceleration(config, belief.error)
    config = with_values(config, values) if values else config
    if not belief.parameters:
        return config
    return with_setting(learned_from(config, [key for key, _ in belief.parameters]), dict(belief.parameters))


def learned_from(config: Config, keys: Sequence[str]) -> Config:
    """Return the configuration without the intervals of friction that replace learned coefficients.

    Args:
        config: the task.
        keys: of the learned values, such as contact.friction or contact.friction.upper.
    """
    intervals = config.uncertainty.friction
    learned = [split_key(key) for key in keys if split_key(key)[:2] == ("contact", "friction")]
    if intervals is None or not learned:
        return config
    if ("contact", "friction") in learned:
        return with_values(config, {"uncertainty.friction": None})
    by_name = intervals if isinstance(intervals, Mapping) else {"default": intervals}
    named = {name: by_name.get(name, by_name.get("default")) for name in config.contact_owners}
    left = {name: bounds for name, bounds in named.items() if bounds and ("contact", "friction", name) not in learned}
    return with_values(config, {"uncertainty.friction": left or None})


def _acceleration(config: Config, error: ErrorInterval) -> Mapping[str, Any]:
    """Return [U - K Delta, U + K Delta] as `uncertainty.joint_acceleration`; one value stands for all joints.

    The first six values of a legged robot are the base's, whose interval `uncertainty.base_acceleration` is symmetric.
    """
    if error.is_zero:
        return {"uncertainty.joint_acceleration": None}
    mean, deviation = ([error.share * value for value in values] for values in (error.mean, error.deviation))
    values: dict[str, Any] = {}
    single = len(mean) == 1
    if config.path.steps is not None and not single:
        base = zip(mean[:BASE], deviation[:BASE], strict=True)
        values["uncertainty.base_acceleration"] = [abs(u) + error.K * d for u, d in base]
        mean, deviation = mean[BASE:], deviation[BASE:]
    values["uncertainty.joint_acceleration"] = {
        "mean": mean[0] if single else mean,
        "deviation": deviation[0] if single else deviation,
        "K": error.K,
    }
    return values


FINER_GRIDS = (1, 2, 4)
"""Factors on the configured number of collocation points, tried in turn: violations between grid points shrink with its
square."""


class Planner:
    """Planner of beliefs, with certificates; robot and path are the same for all beliefs."""

    def __init__(self, config: Config, certified: bool = True) -> None:
        """Make the planner of a task; certified: False for plans that only serve to compare durations."""
        self.config = config
        self._certified = certified
        self._latest: tuple[Belief, PlanResult] | None = None
        self._tracks: dict[int, Track] = {}

    def plan(self, belief: Belief) -> PlanResult:
        """Return the plan of a belief; an infeasible problem is an outcome, not an error.

        Args:
            belief: the belief.

        Raises:
            SolverFailed: the plan fails its certificate, or the solver stops without an answer.
            ConfigError: the belief does not fit the configuration.
        """
        if self._latest is None or self._latest[0] != belief:  # keep one alone: plans are large, and soon made again
            self._latest = belief, self._make(belief)
        return self._latest[1]

    def _make(self, belief: Belief) -> PlanResult:
        """Return the plan on the configured grid, or on a finer one if it violates a limit between grid points."""
        for finer in FINER_GRIDS:
            result = self._on_grid(belief, finer)
            if result.certificate is None or result.certificate.passed:
                return result
            if result.certificate.worst.on_grid:
                break
        assert result.certificate is not None
        sentence = result.certificate.sentence
        raise SolverFailed(f"the plan for {described(belief)} failed its certificate: {sentence}")

    def _on_grid(self, belief: Belief, finer: int) -> PlanResult:
        config = believing(self.config, belief)
        plan = solve(rows_along(self._track(finer), config))
        if plan.status not in (Status.SOLVED, Status.INFEASIBLE):
            raise SolverFailed(f"no plan for {described(belief)}: {plan.message}")
        solved = self._certified and plan.status is Status.SOLVED
        return PlanResult(config, plan, certify(plan, "quick", config.seed) if solved else None, None, {})

    def _track(self, finer: int) -> Track:
        """Return the track of the task's own values, which all beliefs share, or a finer one."""
        if finer not in self._tracks:
            self._tracks[finer] = track_of(self.config) if finer == 1 else self._finer(finer)
        return self._tracks[finer]

    def _finer(self, finer: int) -> Track:
        known, points = self._track(1), self.config.solver.collocation_points
        grid = known.grid.split(finer) if points == "auto" else numbered_grid(known.path, finer * points)
        return build_track(known.robot, known.path, grid)


def described(belief: Belief) -> str:
    """Return a belief in words.

    Args:
        belief: the belief.
    """
    parts = [] if belief.friction is None else [f"friction {belief.friction:g}"]
    if belief.error is not None and not belief.error.is_zero:
        parts.append(f"acceleration errors up to +-{max(belief.error.half_width):.3g} (K = {belief.error.K:g})")
    parts += [f"{key} = {value:g}" for key, value in belief.parameters]
    return " and ".join(parts) or "the nominal values"
