"""Models of the configuration: the section `execution`."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from robustopt.config.section import Distance, Friction, Mass, NonNegative, Point3, Positive, Section, Vector3, Vector6


class VariationConfig(Section):
    """Random variation of the actual parameters from trial to trial."""

    distribution: Literal["normal", "uniform"] = Field(
        default="normal",
        description="distribution of the actual values over the trials: normal with the standard deviations below, or "
        "uniform within these deviations of the value; a friction, mass or force at or below 0 is sampled again",
    )
    friction: NonNegative | dict[str, NonNegative] = Field(
        default=0.0,
        description="deviation of the coefficient of friction, one value for all contacts, or by name as in "
        "truth.friction (`default` for the rest)",
    )
    mass: dict[str, NonNegative] = Field(
        default={}, description="deviation of the mass, by name as in truth.mass; the inertia scales with it [kg]"
    )
    center_of_mass: dict[str, tuple[NonNegative, NonNegative, NonNegative]] = Field(
        default={}, description="deviation of the centre of mass along x, y, z, by name as in truth.mass [m]"
    )
    force: dict[str, NonNegative] = Field(
        default={}, description="deviation of the force of the cups or the gripper, by name as in truth.force [N]"
    )


class TruthConfig(Section):
    """Actual parameters of the simulated world, unknown to the planner."""

    friction: Friction | dict[str, Friction] | None = Field(
        default=None,
        description="actual coefficient of friction, one value for all contacts, or by contact or object (`default` "
        "for the rest); default: the nominal value",
    )
    mass: dict[str, Mass] = Field(
        default={},
        description="actual mass, by name of an object, the `tray` or a body of a walking robot; the inertia scales "
        "with the mass [kg]",
    )
    center_of_mass: dict[str, Point3] = Field(
        default={}, description="actual centre of mass in the frame of the object, the tray or the body, by name [m]"
    )
    inertia: dict[str, Vector3 | Vector6] = Field(
        default={},
        description="actual inertia about the centre of mass, by name as in mass, in the form of objects; it does not "
        "scale with the mass [kg m^2]",
    )
    contact_inset: dict[str, Distance] = Field(
        default={},
        description="distance by which the base of an object, a lip, a pad, a sole or a palm is smaller than its "
        "shape on every side, by name [m]",
    )
    force: dict[str, Positive] = Field(
        default={},
        description="actual force of each suction cup, or of the gripper, by name of the held object; default: the "
        "nominal value, the middle of an interval [N]",
    )
    variation: VariationConfig = Field(
        default=VariationConfig(), description="variation of the actual values from trial to trial"
    )


class ControllerConfig(Section):
    """Joint controller of the simulated robot."""

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
        description="feedforward torque: gravity compensation of arm and tray (gravity), or also the torque of the "
        "planned motion with the nominal load (computed_torque); default: gravity, or for a walking robot "
        "computed_torque with the planned contact forces",
    )


class DisturbanceConfig(Section):
    """Random disturbances of an execution."""

    force_deviation: tuple[NonNegative, NonNegative, NonNegative] = Field(
        default=(0.0, 0.0, 0.0), description="standard deviation of a random force along the world's x, y, z [N]"
    )
    on: str | None = Field(
        default=None,
        description="body on whose centre of mass the force acts: `tray`, an object or a body of a walking robot; "
        "default: the floating base, the tray or the first object",
    )
    hold: Positive = Field(default=0.001, description="time for which a sampled force is held [s]")
    calibration_deviation: NonNegative | tuple[NonNegative, ...] = Field(
        default=0.0,
        description="standard deviation of the joints' calibration offsets, sampled once per trial, one value or one "
        "per joint [rad or m]",
    )


class FailureConfig(Section):
    """Criteria by which a trial fails."""

    slip: Positive = Field(
        default=0.005, description="an object has slid when a point of its base has moved this far on its support [m]"
    )
    tilt: Positive = Field(
        default=0.08726646259971647,
        description="an object has tipped when it leans this far from upright on its support [rad]",
    )
    drop: Positive = Field(default=0.005, description="an object has fallen when it is this far below its place [m]")
    lift: Positive = Field(
        default=0.001, description="an object has lost contact when all of its base is this far above its support [m]"
    )
    saturation: NonNegative = Field(
        default=0.01, description="longest time for which a joint torque may stay at its limit without interruption [s]"
    )
    foot_slip: Positive = Field(
        default=0.01,
        description="a standing foot, or a hand on a rail, has slipped when one of its contact points has moved this "
        "far [m]",
    )
    opening: Positive = Field(
        default=0.0002,
        description="a held part is lost when a point of a lip, or of the fixed pad, is this far away from it [m]",
    )
    grip_slip: Positive = Field(
        default=0.003, description="a held part has slid when it has moved this far along a lip or pad [m]"
    )
    hand_lift: Positive = Field(
        default=0.005, description="a hand has lost contact when all of its palm is this far above its rail [m]"
    )
    trunk_tilt: Positive = Field(
        default=0.7853981633974483,
        description="a walking robot has fallen when its floating base is this far from upright [rad]",
    )
    trunk_drop: Positive = Field(
        default=0.35,
        lt=1,
        description="a walking robot has also fallen when its base is lower than planned by this fraction of the "
        "planned height",
    )


class ExecutionConfig(Section):
    """Execution of a plan in simulation."""

    truth: TruthConfig = Field(
        default=TruthConfig(), description="actual parameters of the simulated world; the planner never reads them"
    )
    timestep: Positive = Field(
        default=0.001, description="time step of the simulation; objects at rest drift in proportion to it [s]"
    )
    controller: ControllerConfig = Field(
        default=ControllerConfig(),
        description="joint controller; gains that are not given come from the model file, or else from the joint "
        "inertia",
    )
    disturbance: DisturbanceConfig = Field(
        default=DisturbanceConfig(), description="random disturbances of the execution"
    )
    hold: tuple[NonNegative, NonNegative] = Field(
        default=(0.2, 0.6),
        description="time for which the robot stands still before and after the motion, except at an end at which it "
        "moves [s]",
    )
    failure: FailureConfig = Field(default=FailureConfig(), description="criteria by which a trial fails")
    trials: int = Field(default=100, ge=1, le=1_000_000, description="number of Monte Carlo trials")
    confidence: Positive = Field(
        default=0.95, lt=1, description="confidence level of the Clopper-Pearson interval of the success rate"
    )
