"""Plans for what a learner believes, in place of what the configuration says."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import Any

from robustopt.certificate import certify
from robustopt.config import Config, with_values
from robustopt.config_model import BASE_COORDINATES as BASE
from robustopt.errors import SolverFailed
from robustopt.experiment import PlanResult
from robustopt.learning.learner import Belief
from robustopt.learning.moments import ErrorInterval
from robustopt.path import Path
from robustopt.problem import build_rows, robot_and_path
from robustopt.robot import Robot
from robustopt.timescaling import Status, solve
from robustopt.walker import Walker


def believing(config: Config, belief: Belief) -> Config:
    """The configuration with a belief in place of what it says itself.

    A learned coefficient of friction stands for all interfaces, and replaces their interval; a learned interval of the
    joint acceleration error replaces the configured one. Raises ConfigError where a key of the belief does not fit.
    """
    values: dict[str, Any] = {}
    if belief.friction is not None:
        values |= {"uncertainty.friction": None, "contact.friction": belief.friction}
    if belief.error is not None:
        values |= _acceleration(config, belief.error)
    if any(key.startswith("contact.friction") for key, _ in belief.parameters):
        values["uncertainty.friction"] = None
    return with_values(config, values | dict(belief.parameters)) if values or belief.parameters else config


def _acceleration(config: Config, error: ErrorInterval) -> Mapping[str, Any]:
    """[U - K Delta, U + K Delta] as `uncertainty.joint_acceleration`; one value stands for all joints.

    Of a robot on its feet the first six are the base's, whose interval `uncertainty.base_acceleration` lies about 0.
    """
    if error.is_zero:
        return {"uncertainty.joint_acceleration": None}
    mean, deviation = ([error.share * value for value in values] for values in (error.mean, error.deviation))
    values: dict[str, Any] = {}
    single = len(mean) == 1
    if config.walks and not single:
        base = zip(mean[:BASE], deviation[:BASE], strict=True)
        values["uncertainty.base_acceleration"] = [abs(u) + error.K * d for u, d in base]
        mean, deviation = mean[BASE:], deviation[BASE:]
    values["uncertainty.joint_acceleration"] = {
        "mean": mean[0] if single else mean,
        "deviation": deviation[0] if single else deviation,
        "K": error.K,
    }
    return values


class Planner:
    """Makes the plan of a belief, with its certificate; robot and path are the same for all beliefs."""

    def __init__(self, config: Config) -> None:
        self.config = config
        self._latest: tuple[Belief, PlanResult] | None = None

    def plan(self, belief: Belief) -> PlanResult:
        """The plan of a belief; an infeasible problem is an outcome.

        Raises SolverFailed where a plan fails its certificate or the solver stops without an answer, and ConfigError
        where the belief does not fit the configuration.
        """
        if (
            self._latest is None or self._latest[0] != belief
        ):  # the latest alone: plans are large, and made again exactly
            self._latest = belief, self._make(belief)
        return self._latest[1]

    def _make(self, belief: Belief) -> PlanResult:
        config = believing(self.config, belief)
        plan = solve(build_rows(config, *self._robot_and_path))
        if plan.status is Status.INFEASIBLE:
            return PlanResult(config, plan, None, None, {})
        if plan.status is not Status.SOLVED:
            raise SolverFailed(f"no plan for {described(belief)}: {plan.message}")
        certificate = certify(config, plan, "quick", config.seed)
        if not certificate.passed:
            raise SolverFailed(f"the plan for {described(belief)} failed its certificate: {certificate.sentence}")
        return PlanResult(config, plan, certificate, None, {})

    @cached_property
    def _robot_and_path(self) -> tuple[Robot | Walker, Path]:
        return robot_and_path(self.config)


def described(belief: Belief) -> str:
    """A belief in words."""
    parts = [] if belief.friction is None else [f"friction {belief.friction:g}"]
    if belief.error is not None and not belief.error.is_zero:
        parts.append(f"acceleration errors up to +-{max(belief.error.half_width):.3g} (K = {belief.error.K:g})")
    parts += [f"{key} = {value:g}" for key, value in belief.parameters]
    return " and ".join(parts) or "what the configuration says"
