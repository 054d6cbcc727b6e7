"""Models of the configuration: the section `learning`."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, FiniteFloat

from robustopt.config.section import AccelerationError, Friction, Level, NonNegative, Positive, Real, Section


class LearnedParameter(Section):
    key: str = Field(description="key of a numeric belief of the configuration, such as contact.friction.upper")
    optimistic: Real = Field(description="value for which plans are fastest")
    conservative: Real = Field(description="value for which plans are slowest")


class FirstBelief(Section):
    friction: Friction = Field(description="coefficient of friction of all interfaces")
    joint_acceleration: AccelerationError = Field(
        default=AccelerationError(), description="error of the executed joint acceleration, one value per joint"
    )


class LearningConfig(Section):
    algorithm: Literal[
        "bisection",
        "acceleration_interval",
        "ilrobs",
        "ilrobs-calibrated",
        "bnb-midpoint",
        "bnb-diagonal",
        "bnb-informed",
    ] = Field(default="ilrobs", description="learner")
    K: Annotated[FiniteFloat, Field(ge=0, le=6)] = Field(
        default=1.0,
        description="deviations of the acceleration error that a plan survives; ilrobs asks for N_e(K) = "
        "ceil(1 / (1 - Phi(K))) successes in a row",
    )
    reading: Literal["one-sided", "two-sided"] = Field(
        default="one-sided",
        description="what Phi(K) is: P(Z <= K), or P(|Z| <= K) as in the 68-95-99.7 rule",
    )
    friction: tuple[NonNegative, NonNegative] = Field(
        default=(0.0, 1.0),
        description="interval of the coefficient of friction that is searched; it replaces that of all interfaces",
    )
    delta: Positive = Field(
        default=0.05,
        description="interval of the friction at which bisection and ilrobs stop; for branch and bound the side of a "
        "box of parameters, as a part of their intervals",
    )
    try_upper: bool = Field(
        default=True, description="ilrobs: try the upper end of the friction first; false halves at once"
    )
    epsilon: Positive = Field(default=0.05, description="bisection: relative speed-up of the test for near-optimality")
    threshold: Positive = Field(
        default=0.05,
        description="acceleration_interval: it is stable when no endpoint of a joint moves by this much [rad/s^2 or "
        "m/s^2]",
    )
    executions: int = Field(default=1, ge=1, description="acceleration_interval: executions of each plan")
    iterations: int = Field(default=20, ge=1, description="acceleration_interval: most iterations")
    success_rate: Level = Field(default=0.9, description="ilrobs-calibrated: success rate that the plan must meet")
    confidence: Level = Field(
        default=0.95, description="confidence of statements about success rates; ilrobs-calibrated guarantees its own"
    )
    resolution: Positive = Field(
        default=0.01, description="ilrobs-calibrated: relative difference of durations that matters"
    )
    K_values: tuple[NonNegative, ...] = Field(
        default=(0.0, 0.5, 1.0, 2.0), description="ilrobs-calibrated: values of K that are searched, 0 first"
    )
    futility: Level = Field(
        default=0.05, description="ilrobs-calibrated: largest probability to reject a plan that meets the success rate"
    )
    patience: Annotated[FiniteFloat, Field(ge=1)] = Field(
        default=4.0,
        description="ilrobs-calibrated: a test gives up after this many times the executions that it takes at least",
    )
    first: FirstBelief | None = Field(
        default=None, description="ilrobs-calibrated: a belief that is tested first, such as what ilrobs returned"
    )
    prior: Level = Field(
        default=0.5, description="prior probability that a plan meets Phi(K), for how likely a failure was bad luck"
    )
    trials: Annotated[int, Field(ge=0, le=1_000_000)] = Field(
        default=100,
        description="fresh executions that the success rate of a learned plan is estimated with; 0 for none",
    )
    judged: Literal["result", "all"] = Field(
        default="all", description="plans whose success rate is estimated: those that are returned, or all"
    )
    parameters: tuple[LearnedParameter, ...] = Field(
        default=(), description="parameters that the branch-and-bound learners search"
    )
    budget: int = Field(default=40, ge=1, description="executions that the branch-and-bound learners may take")
    gap: Positive = Field(
        default=0.01, description="relative gap of the best plan to the lower bound at which they stop"
    )
    executions_per_plan: int = Field(
        default=1,
        ge=1,
        description="executions in a row that must succeed, 1 where executions do not vary; `bnb-informed` asks for a "
        "success rate of 1 - 1/N",
    )
    plans: int = Field(
        default=1000, ge=1, description="most plans that they make to know where to look; fewer where planning is slow"
    )
