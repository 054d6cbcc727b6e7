"""Models of the configuration: what each key means, its unit, default and bounds.

Units are SI, angles are radians. The reference page and the JSON Schema are generated from the descriptions here;
what relates several keys to each other is in `config_check`. Lengths, masses and friction are bounded to what a robot
can carry, so that no later computation overflows (our choice).
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, FiniteFloat, model_validator

Real = FiniteFloat
Positive = Annotated[FiniteFloat, Field(gt=0)]
NonNegative = Annotated[FiniteFloat, Field(ge=0)]
Length = Annotated[FiniteFloat, Field(ge=1e-6, le=100)]
Coordinate = Annotated[FiniteFloat, Field(ge=-1000, le=1000)]
Acceleration = Annotated[FiniteFloat, Field(ge=-1e6, le=1e6)]
Distance = Annotated[FiniteFloat, Field(ge=0, le=100)]
Mass = Annotated[FiniteFloat, Field(ge=1e-6, le=1e6)]
Friction = Annotated[FiniteFloat, Field(ge=1e-6, le=100)]
Level = Annotated[FiniteFloat, Field(gt=0, lt=1)]
Point2 = tuple[Coordinate, Coordinate]
Point3 = tuple[Coordinate, Coordinate, Coordinate]
Size = tuple[Length, Length, Length]
Vector3 = tuple[Real, Real, Real]
Vector4 = tuple[Real, Real, Real, Real]
Vector6 = tuple[Real, Real, Real, Real, Real, Real]
Acceleration3 = tuple[Acceleration, Acceleration, Acceleration]
Interval = tuple[Real, Real]

FEET = ("left_foot", "right_foot")
"""Names of the contacts of a robot on its feet."""

BASE_COORDINATES = 6
"""Coordinates of the floating base of such a robot: they come before its joints."""


class Section(BaseModel):
    """A part of the configuration: immutable, unknown keys are errors, an empty section is all defaults."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    @model_validator(mode="before")
    @classmethod
    def _empty_section(cls, data: Any) -> Any:
        return {} if data is None else data


class Pose(Section):
    position: Point3 = Field(default=(0.0, 0.0, 0.0), description="position [m]")
    rpy: Vector3 = Field(default=(0.0, 0.0, 0.0), description="roll, pitch, yaw about the fixed x, y, z axes [rad]")


class JointLimitOverride(Section):
    position: Interval | None = Field(default=None, description="lowest and highest joint position [rad or m]")
    velocity: Positive | None = Field(default=None, description="largest joint speed [rad/s or m/s]")
    acceleration: Positive | None = Field(default=None, description="largest joint acceleration [rad/s^2 or m/s^2]")
    torque: Positive | None = Field(default=None, description="largest joint torque or force [N m or N]")
    dry_friction: NonNegative | None = Field(default=None, description="Coulomb friction of the joint [N m or N]")
    viscous_friction: NonNegative | None = Field(
        default=None, description="viscous friction of the joint [N m s/rad or N s/m]"
    )


class Collision(Section):
    check: bool = Field(default=True, description="check the path for collisions of the arm, the tray and the objects")
    exclude: tuple[tuple[str, str], ...] = Field(
        default=(), description="pairs of body names whose collisions are ignored"
    )


class RobotConfig(Section):
    model: str = Field(
        description="name of a shipped robot (tx90l, humanoid), or an MJCF or URDF file relative to the "
        "configuration file"
    )
    tool: str = Field(default="flange", description="site or body of the model that carries the tray")
    base: Pose = Field(default=Pose(), description="pose of the robot's base in the world")
    limits: dict[str, JointLimitOverride] = Field(
        default={},
        description="joint limits by joint name, over those of the model; the name `all` applies to every joint",
    )
    locked: dict[str, Real] = Field(
        default={}, description="joints that are held at a fixed position, by name [rad or m]"
    )
    joint_friction: bool = Field(default=True, description="count dry and viscous joint friction in the torque limits")
    collision: Collision = Field(default=Collision(), description="collision check along the path")


class TrayConfig(Section):
    size: Size = Field(description="edge lengths of the tray, a box [m]")
    mass: Mass = Field(description="mass of the tray [kg]")
    pose: Pose = Field(default=Pose(), description="pose of the tray's centre in the tool frame")
    center_of_mass: Point3 = Field(
        default=(0.0, 0.0, 0.0),
        description="centre of mass in the tray frame, whose origin is the tray's centre [m]",
    )
    inertia: Vector3 | Vector6 | None = Field(
        default=None,
        description="inertia about the centre of mass, tray axes: ixx, iyy, izz, or ixx, iyy, izz, ixy, ixz, iyz; "
        "without it that of a uniform box [kg m^2]",
    )


class ObjectConfig(Section):
    shape: Literal["box", "cylinder"] = Field(description="shape; a cylinder stands upright")
    size: Size | None = Field(default=None, description="edge lengths of a box [m]")
    radius: Length | None = Field(default=None, description="radius of a cylinder [m]")
    height: Length | None = Field(default=None, description="height of a cylinder [m]")
    mass: Mass = Field(description="mass [kg]")
    on: str | tuple[str, str] = Field(
        default="tray", description="what the object stands on: `tray`, another object, or two of them (a bridge)"
    )
    at: Point2 = Field(
        default=(0.0, 0.0),
        description="centre of the object's base in the frame of its support; for a bridge in the tray frame [m]",
    )
    yaw: Real = Field(
        default=0.0, description="turn about the vertical against its support; for a bridge against the tray [rad]"
    )
    center_of_mass: Point3 = Field(
        default=(0.0, 0.0, 0.0),
        description="centre of mass in the object's frame, whose origin is its geometric centre [m]",
    )
    inertia: Vector3 | Vector6 | None = Field(
        default=None,
        description="inertia about the centre of mass, object axes: ixx, iyy, izz, or ixx, iyy, izz, ixy, ixz, iyz; "
        "without it that of a uniform body of the shape [kg m^2]",
    )


class ContactConfig(Section):
    friction: Friction | dict[str, Friction] = Field(
        default=0.5,
        description="coefficient of friction the planner believes: one value, or one per object for the interface "
        "under it (`default` for the rest); where it is not given and uncertainty.friction is, the middle of that",
    )
    cone_edges: int = Field(
        default=16, ge=3, le=64, description="edges of the inner approximation of each friction cone"
    )
    patch_points: int = Field(default=8, ge=3, le=32, description="contact points that stand for a round contact patch")


class TrayPose(Section):
    position: Point3 = Field(description="position of the tray's centre in the world [m]")
    rpy: Vector3 | None = Field(default=None, description="roll, pitch, yaw about the fixed x, y, z axes [rad]")
    yaw: Real | None = Field(default=None, description="turn about the vertical, for a level tray [rad]")
    quaternion: Vector4 | None = Field(default=None, description="orientation w, x, y, z, of any length but 0")


class PathTolerance(Section):
    position: Positive = Field(
        default=0.0002, description="largest distance between the joint path and the tray path [m]"
    )
    angle: Positive = Field(default=0.001, description="largest angle between the joint path and the tray path [rad]")


class StepConfig(Section):
    foot: Literal["left", "right"] = Field(description="the foot that steps")
    to: Point2 = Field(description="where the middle of its sole lands on the floor, x and y in the world [m]")


class StanceConfig(Section):
    left: Point2 = Field(description="middle of the left sole on the floor, x and y in the world [m]")
    right: Point2 = Field(description="middle of the right sole on the floor, x and y in the world [m]")


class PathConfig(Section):
    tray_poses: tuple[TrayPose, ...] | None = Field(
        default=None, description="poses of the tray, joined by straight segments"
    )
    joints: tuple[tuple[Real, ...], ...] | str | None = Field(
        default=None,
        description="joint waypoints, or a CSV file of them relative to the configuration file; "
        "joined by a C2 cubic spline [rad or m]",
    )
    blend: NonNegative = Field(
        default=0.0, description="length on each side of a corner of tray_poses that is rounded; 0 stops there [m]"
    )
    tolerance: PathTolerance = Field(
        default=PathTolerance(),
        description="accuracy of the inverse kinematics between the samples of the tray path",
    )
    steps: tuple[StepConfig, ...] | None = Field(
        default=None, description="steps of a robot on its feet, one foot after the other, soles level along x"
    )
    start: tuple[Real, ...] | StanceConfig | None = Field(
        default=None,
        description="joint position near which the inverse kinematics starts, without it the best of many [rad or m]; "
        "with steps where the feet stand before the first one [m]",
    )
    lift: Length = Field(default=0.05, description="with steps: how high the foot is lifted [m]")
    inset: Distance = Field(
        default=0.012,
        description="with steps: how far inside the middle of the standing foot, towards the other one, the centre of "
        "mass passes [m]",
    )
    pelvis_height: Length | None = Field(
        default=None,
        description="with steps: height of the pelvis over the soles; without it that of the model's first keyframe "
        "[m]",
    )


class AccelerationError(Section):
    mean: Real | tuple[Real, ...] = Field(
        default=0.0,
        description="mean U of the executed minus the planned joint acceleration, one value or one per joint [rad/s^2]",
    )
    deviation: NonNegative | tuple[NonNegative, ...] = Field(
        default=0.0, description="standard deviation D of it, one value or one per joint [rad/s^2]"
    )
    K: NonNegative = Field(default=1.0, description="the plan survives every error in [U - K D, U + K D]")


class UncertaintyConfig(Section):
    friction: tuple[Friction, Friction] | dict[str, tuple[Friction, Friction]] | None = Field(
        default=None,
        description="interval of the coefficient of friction, one for all or one per object for the interface "
        "under it (`default` for the rest)",
    )
    contact_points: Distance | dict[str, Distance] | None = Field(
        default=None,
        description="each contact point may lie this far from its place along x and along y, one value for all or "
        "one per object for the interface under it (`default` for the rest) [m]",
    )
    center_of_mass: dict[str, tuple[Distance, Distance, Distance]] = Field(
        default={},
        description="largest distance of the centre of mass from its place along x, y, z of the object's (or the "
        "tray's) frame, by object name or `tray` [m]",
    )
    mass: dict[str, tuple[Mass, Mass]] = Field(
        default={},
        description="interval of the mass, which scales the inertia, by object name or `tray` [kg]",
    )
    joint_acceleration: AccelerationError | None = Field(
        default=None, description="error of the executed joint acceleration"
    )
    base_acceleration: NonNegative | tuple[NonNegative, ...] = Field(
        default=0.0,
        description="with path.steps: largest error of the acceleration of the floating base, one value for all, or "
        "six: along x, y, z [m/s^2] and about z, y, x [rad/s^2]",
    )


class SolverConfig(Section):
    method: Literal["ipopt", "reachability"] = Field(
        default="ipopt",
        description="an outer nonlinear program with inner contact programs (ipopt), or minimum time only and fast "
        "(reachability)",
    )
    collocation_points: int = Field(
        default=200, ge=10, le=100_000, description="number N of intervals of the grid along the path"
    )
    cost: Literal["time", "effort", "smoothness"] = Field(
        default="time",
        description="what is minimised: time, or time plus `weight` times the integral of the squared relative torque "
        "(effort) or acceleration (smoothness)",
    )
    weight: NonNegative = Field(default=0.0, description="weight of the effort or smoothness term")


class OutputConfig(Section):
    period: Positive = Field(
        default=0.004, description="controller period at which the trajectory is sampled for export [s]"
    )


class VariationConfig(Section):
    distribution: Literal["normal", "uniform"] = Field(
        default="normal",
        description="how values are drawn for each trial: normal, with the deviations below, or uniform, at most the "
        "deviations below from the value; a friction or mass at or below 0 is drawn again",
    )
    friction: NonNegative | dict[str, NonNegative] = Field(
        default=0.0,
        description="deviation of the coefficient of friction, one for all or one per object for the interface "
        "under it (`default` for the rest)",
    )
    mass: dict[str, NonNegative] = Field(
        default={}, description="deviation of the mass, by name as in truth.mass; the inertia scales with it [kg]"
    )
    center_of_mass: dict[str, tuple[NonNegative, NonNegative, NonNegative]] = Field(
        default={}, description="deviation of the centre of mass along x, y, z, by name as in truth.mass [m]"
    )


class TruthConfig(Section):
    friction: Friction | dict[str, Friction] | None = Field(
        default=None,
        description="true coefficient of friction, one value, or one per object for the interface under it "
        "(`default` for the rest); without it what the planner believes",
    )
    mass: dict[str, Mass] = Field(
        default={},
        description="true mass, which scales the inertia, by name of an object, the `tray` or a body of a robot on its "
        "feet [kg]",
    )
    center_of_mass: dict[str, Point3] = Field(
        default={}, description="true centre of mass in the frame of the object, the tray or the body, by name [m]"
    )
    inertia: dict[str, Vector3 | Vector6] = Field(
        default={},
        description="true inertia about the centre of mass, by name as in mass, in the form of objects; it does not "
        "scale with the mass [kg m^2]",
    )
    contact_inset: dict[str, Distance] = Field(
        default={},
        description="how much smaller than its shape the base of an object, or a foot, is on every side, by name [m]",
    )
    variation: VariationConfig = Field(
        default=VariationConfig(), description="how true values vary from trial to trial about those above"
    )


class ControllerConfig(Section):
    kp: NonNegative | tuple[NonNegative, ...] | None = Field(
        default=None, description="proportional gain, one value or one per joint [N m/rad or N/m]"
    )
    ki: NonNegative | tuple[NonNegative, ...] | None = Field(
        default=None, description="integral gain, one value or one per joint [N m/(rad s) or N/(m s)]"
    )
    kd: NonNegative | tuple[NonNegative, ...] | None = Field(
        default=None, description="derivative gain, one value or one per joint [N m s/rad or N s/m]"
    )
    feedforward: Literal["gravity", "computed_torque"] | None = Field(
        default=None,
        description="torque that is added to that of the gains: gravity compensation of arm and tray, or also the "
        "torque that the planned motion takes with the load that the planner believes; without it the first, for a "
        "robot on its feet the second, with the planned contact forces",
    )


class DisturbanceConfig(Section):
    force_deviation: tuple[NonNegative, NonNegative, NonNegative] = Field(
        default=(0.0, 0.0, 0.0), description="standard deviation of a random force along the world's x, y, z [N]"
    )
    on: str | None = Field(
        default=None,
        description="what the force acts on, in its centre of mass: `tray` or an object, of a robot on its feet any "
        "body; without it the tray, or the floating base",
    )
    hold: Positive = Field(default=0.001, description="time for which a drawn force is held [s]")
    calibration_deviation: NonNegative | tuple[NonNegative, ...] = Field(
        default=0.0,
        description="standard deviation of the joints' calibration offsets, drawn once per trial, one value or one "
        "per joint [rad or m]",
    )


class FailureConfig(Section):
    slip: Positive = Field(
        default=0.005, description="an object has slid when a point of its base has moved this far on its support [m]"
    )
    tilt: Positive = Field(
        default=0.08726646259971647, description="it has tipped when it is this far from upright on its support [rad]"
    )
    drop: Positive = Field(default=0.005, description="it has fallen when it is this far below its place [m]")
    lift: Positive = Field(
        default=0.001, description="it has lost contact when all of its base is this far above its support [m]"
    )
    saturation: NonNegative = Field(
        default=0.01, description="a joint torque may stay at its limit for this long without a break [s]"
    )
    foot_slip: Positive = Field(
        default=0.01,
        description="a standing foot has slipped when one of its contact points has moved this far on the floor [m]",
    )
    trunk_tilt: Positive = Field(
        default=0.7853981633974483,
        description="a robot on its feet has fallen when its floating base is this far from upright [rad]",
    )
    trunk_drop: Positive = Field(
        default=0.35,
        lt=1,
        description="it has also fallen when its base is lower than planned by this part of the planned height",
    )


class ExecutionConfig(Section):
    truth: TruthConfig = Field(
        default=TruthConfig(), description="what the simulated world really is; the planner never reads it"
    )
    timestep: Positive = Field(default=0.001, description="time step; objects drift in proportion to it [s]")
    controller: ControllerConfig = Field(
        default=ControllerConfig(),
        description="joint controller; gains not given are those of the model file, else from the joint's inertia",
    )
    disturbance: DisturbanceConfig = Field(default=DisturbanceConfig(), description="random force during the execution")
    hold: tuple[NonNegative, NonNegative] = Field(
        default=(0.2, 0.6), description="time for which the robot stands still before and after the motion [s]"
    )
    failure: FailureConfig = Field(default=FailureConfig(), description="what counts as a failure")
    trials: int = Field(default=100, ge=1, le=1_000_000, description="number of Monte Carlo trials")
    confidence: Positive = Field(
        default=0.95, lt=1, description="level of the Clopper-Pearson interval of the success rate"
    )


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


def _empty_mapping(data: Any) -> Any:
    return {} if data is None else data


class Config(Section):
    name: str = Field(description="name of the task; the results folder takes it")
    robot: RobotConfig = Field(description="the robot")
    tray: TrayConfig | None = Field(
        default=None, description="the tray that the robot carries; required, but for a robot that steps"
    )
    objects: Annotated[dict[str, ObjectConfig], BeforeValidator(_empty_mapping)] = Field(
        default={}, description="the objects on the tray, by name"
    )
    contact: ContactConfig = Field(default=ContactConfig(), description="contacts between tray and objects")
    path: PathConfig = Field(description="the path: exactly one of tray_poses, joints and steps")
    uncertainty: UncertaintyConfig = Field(
        default=UncertaintyConfig(),
        description="intervals that the plan must survive; one replaces the point value, which must lie in it",
    )
    solver: SolverConfig = Field(default=SolverConfig(), description="the solver")
    output: OutputConfig = Field(default=OutputConfig(), description="what is written")
    execution: ExecutionConfig | None = Field(
        default=None, description="execution in simulation; checked, but not read by `plan`"
    )
    learning: LearningConfig | None = Field(default=None, description="learning; checked, but not read by `plan`")
    gravity: Acceleration3 = Field(default=(0.0, 0.0, -9.81), description="gravity in the world [m/s^2]")
    seed: int = Field(default=0, ge=0, description="seed of every random number of the run")
    folder: Path = Field(
        default=Path("."), exclude=True, description="folder that relative file names in the configuration refer to"
    )

    @property
    def walks(self) -> bool:
        """Whether the robot stands on its feet rather than carrying a tray."""
        return self.path.steps is not None

    @property
    def carried_tray(self) -> TrayConfig:
        """The tray of a robot that carries one."""
        assert self.tray is not None, "a robot on its feet carries no tray"
        return self.tray

    @property
    def interfaces(self) -> tuple[str, ...]:
        """Names of the contacts whose friction and contact points the planner has beliefs about."""
        return FEET if self.walks else tuple(self.objects)
