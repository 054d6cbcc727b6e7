"""The section `learning` of the configuration."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, FiniteFloat

from robustopt.config.section import AccelerationError, Count, Friction, Level, NonNegative, Positive, Real, Section


class LearnedParameter(Section):
    """A parameter that the branch-and-bound learners search."""

    key: str = Field(description="key of a numeric nominal value, such as contact.friction.upper")
    optimistic: Real = Field(description="end of the searched interval with the fastest plans")
    conservative: Real = Field(description="end of the searched interval with the slowest plans")


class FirstBelief(Section):
    """A belief that `ilrobs-calibrated` tests first."""

    friction: Friction = Field(description="coefficient of friction of all contacts")
    joint_acceleration: AccelerationError = Field(
        default=AccelerationError(), description="error of the actual joint acceleration, one value per joint"
    )


class LearningConfig(Section):
    """Settings of a learner."""

    algorithm: Literal[
        "bisection",
        "acceleration_interval",
        "ilrobs",
        "ilrobs-calibrated",
        "bnb-midpoint",
        "bnb-diagonal",
        "bnb-informed",
        "physics",
    ] = Field(default="ilrobs", description="algorithm of the learner; bnb-midpoint is a baseline for comparisons")
    K: Annotated[FiniteFloat, Field(ge=0, le=6)] = Field(
        default=1.0,
        description="number of standard deviations of the acceleration error for which a plan must hold; ilrobs "
        "accepts a plan after N_e(K) = ceil(1 / (1 - Phi(K))) successes in a row",
    )
    reading: Literal["one-sided", "two-sided"] = Field(
        default="one-sided", description="definition of Phi(K): P(Z <= K), or P(|Z| <= K) as in the 68-95-99.7 rule"
    )
    friction: tuple[NonNegative, NonNegative] = Field(
        default=(0.0, 1.0),
        description="interval in which the coefficient of friction is searched; the learned value replaces the "
        "friction of all contacts",
    )
    delta: Positive | None = Field(
        default=None,
        description="width of the friction interval at which bisection and ilrobs stop, by default 0.05; for learners "
        "of several parameters the smallest side of a box of parameters, relative to their intervals, by default 0.005",
    )
    try_upper: bool = Field(
        default=True, description="ilrobs: start at the upper end of the friction; false: start in the middle"
    )
    epsilon: Positive = Field(default=0.05, description="bisection: relative speed-up of the test for near-optimality")
    threshold: Positive = Field(
        default=0.05,
        description="acceleration_interval: the interval is stable if no end of any joint's interval moves by this "
        "much [rad/s^2 or m/s^2]",
    )
    executions: Count = Field(default=1, description="acceleration_interval: executions of each plan")
    iterations: Count = Field(default=20, description="acceleration_interval: largest number of iterations")
    success_rate: Level = Field(default=0.9, description="ilrobs-calibrated: success rate that the plan must meet")
    confidence: Level = Field(
        default=0.95,
        description="confidence of statements about success rates; ilrobs-calibrated guarantees its result with it",
    )
    resolution: Positive = Field(
        default=0.01, description="ilrobs-calibrated: smallest relative difference of durations that matters"
    )
    K_values: tuple[NonNegative, ...] = Field(
        default=(0.0, 0.5, 1.0, 2.0), description="ilrobs-calibrated: values of K to search, 0 first"
    )
    futility: Level = Field(
        default=0.05,
        description="ilrobs-calibrated: largest probability that a test rejects a plan that meets the success rate",
    )
    patience: Annotated[FiniteFloat, Field(ge=1)] = Field(
        default=4.0,
        description="ilrobs-calibrated: a test gives up after this multiple of the executions that the shortest "
        "acceptance takes",
    )
    first: FirstBelief | None = Field(
        default=None, description="ilrobs-calibrated: a belief to test first, such as the result of ilrobs"
    )
    prior: Level = Field(
        default=0.5,
        description="prior probability that a plan meets the success rate Phi(K); it enters the probability that a "
        "plan that failed still meets it",
    )
    trials: Annotated[int, Field(ge=0, le=1_000_000)] = Field(
        default=100,
        description="number of fresh executions that estimate the success rate of a learned plan; 0 for none",
    )
    judged: Literal["result", "all"] = Field(
        default="all", description="plans whose success rate is estimated: the returned plans only, or all"
    )
    parameters: tuple[LearnedParameter, ...] = Field(
        default=(),
        description="parameters that the learners of several parameters search; without any, physics learns the "
        "friction of all contacts and how far their contact points lie inside",
    )
    budget: Count = Field(default=40, description="largest number of executions of the branch-and-bound learners")
    gap: Positive = Field(
        default=0.005,
        description="branch and bound: relative gap between the best plan and the lower bound at which the search "
        "stops",
    )
    executions_per_plan: Count | None = Field(
        default=None,
        description="learners of several parameters: number N of successes in a row that a plan needs; bnb-informed "
        "and physics require a success rate of 1 - 1/N. By default 1 where executions do not vary, and N_e(K) where "
        "the world of `execution` is random",
    )
    plans: Count = Field(
        default=1000,
        description="branch and bound: largest number of plans made to guide the search; reduce it if planning is slow",
    )
