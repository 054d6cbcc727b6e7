"""Configuration: a YAML file becomes one frozen, validated `Config`.

Units are SI, angles are radians. Every field carries its unit, default and meaning in its description; the
reference page and the JSON Schema are generated from them.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, FiniteFloat

Real = FiniteFloat
Positive = Annotated[FiniteFloat, Field(gt=0)]
NonNegative = Annotated[FiniteFloat, Field(ge=0)]
Vector2 = tuple[Real, Real]
Vector3 = tuple[Real, Real, Real]
Interval = tuple[Real, Real]


class Section(BaseModel):
    """A part of the configuration: immutable, unknown keys are errors."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class Pose(Section):
    position: Vector3 = Field((0.0, 0.0, 0.0), description="position [m]")
    rpy: Vector3 = Field((0.0, 0.0, 0.0), description="roll, pitch, yaw about the fixed x, y, z axes [rad]")


class JointLimitOverride(Section):
    position: Interval | None = Field(None, description="lowest and highest joint position [rad or m]")
    velocity: Positive | None = Field(None, description="largest joint speed [rad/s or m/s]")
    acceleration: Positive | None = Field(None, description="largest joint acceleration [rad/s^2 or m/s^2]")
    torque: Positive | None = Field(None, description="largest joint torque or force [N m or N]")
    dry_friction: NonNegative | None = Field(None, description="Coulomb friction of the joint [N m or N]")
    viscous_friction: NonNegative | None = Field(None, description="viscous friction of the joint [N m s/rad or N s/m]")


class Collision(Section):
    check: bool = Field(True, description="check the path for collisions of the arm, the tray and the objects")
    exclude: tuple[tuple[str, str], ...] = Field((), description="pairs of body names whose collisions are ignored")


class RobotConfig(Section):
    model: str = Field(
        description="name of a shipped robot (tx90l), or an MJCF or URDF file relative to the config file"
    )
    tool: str = Field("flange", description="site or body of the model that carries the tray")
    base: Pose = Field(Pose(), description="pose of the robot's base in the world")
    limits: dict[str, JointLimitOverride] = Field(
        {}, description="joint limits by joint name, over those of the model; the name `all` applies to every joint"
    )
    locked: dict[str, Real] = Field({}, description="joints that are held at a fixed position, by name [rad or m]")
    joint_friction: bool = Field(True, description="count dry and viscous joint friction in the torque limits")
    collision: Collision = Field(Collision(), description="collision check along the path")


class TrayConfig(Section):
    size: tuple[Positive, Positive, Positive] = Field(description="edge lengths of the tray, a box [m]")
    mass: Positive = Field(description="mass of the tray [kg]")
    pose: Pose = Field(Pose(), description="pose of the tray's centre in the tool frame")
    center_of_mass: Vector3 = Field(
        (0.0, 0.0, 0.0), description="centre of mass in the tray frame, whose origin is the tray's centre [m]"
    )
    inertia: tuple[Real, Real, Real] | tuple[Real, Real, Real, Real, Real, Real] | None = Field(
        None,
        description="inertia about the centre of mass, tray axes: ixx, iyy, izz[, ixy, ixz, iyz] [kg m^2]; default: of a uniform box",
    )


class ObjectConfig(Section):
    shape: Literal["box", "cylinder"] = Field(description="box or upright cylinder")
    size: tuple[Positive, Positive, Positive] | None = Field(None, description="edge lengths of a box [m]")
    radius: Positive | None = Field(None, description="radius of a cylinder [m]")
    height: Positive | None = Field(None, description="height of a cylinder [m]")
    mass: Positive = Field(description="mass [kg]")
    on: str | tuple[str, str] = Field(
        "tray", description="what the object stands on: `tray`, another object, or two of them (a bridge)"
    )
    at: Vector2 = Field(
        (0.0, 0.0),
        description="centre of the object's base in the frame of its support; for a bridge in the tray frame [m]",
    )
    yaw: Real = Field(
        0.0, description="turn about the vertical against its support; for a bridge against the tray [rad]"
    )
    center_of_mass: Vector3 = Field(
        (0.0, 0.0, 0.0), description="centre of mass in the object's frame, whose origin is its geometric centre [m]"
    )
    inertia: tuple[Real, Real, Real] | tuple[Real, Real, Real, Real, Real, Real] | None = Field(
        None,
        description="inertia about the centre of mass, object axes: ixx, iyy, izz[, ixy, ixz, iyz] [kg m^2]; default: of a uniform body of its shape",
    )


class ContactConfig(Section):
    friction: Positive | dict[str, Positive] = Field(
        0.5,
        description="coefficient of friction the planner believes: one value, or one per object for the interface under it (`default` for the rest)",
    )
    cone_edges: int = Field(16, ge=3, le=64, description="edges of the inner approximation of each friction cone")
    patch_points: int = Field(8, ge=3, le=32, description="contact points that stand for a round contact patch")


class TrayPose(Section):
    position: Vector3 = Field(description="position of the tray's centre in the world [m]")
    rpy: Vector3 | None = Field(None, description="roll, pitch, yaw about the fixed x, y, z axes [rad]")
    yaw: Real | None = Field(None, description="turn about the vertical, for a level tray [rad]")
    quaternion: tuple[Real, Real, Real, Real] | None = Field(None, description="orientation w, x, y, z")


class PathTolerance(Section):
    position: Positive = Field(0.0002, description="largest distance between the joint path and the tray path [m]")
    angle: Positive = Field(0.001, description="largest angle between the joint path and the tray path [rad]")


class PathConfig(Section):
    tray_poses: tuple[TrayPose, ...] | None = Field(None, description="poses of the tray, joined by straight segments")
    joints: tuple[tuple[Real, ...], ...] | str | None = Field(
        None,
        description="joint waypoints [rad], or a CSV file of them relative to the config file; joined by a C2 cubic spline",
    )
    blend: NonNegative = Field(
        0.0, description="length on each side of a corner of tray_poses that is rounded [m]; 0 stops there"
    )
    tolerance: PathTolerance = Field(
        PathTolerance(), description="accuracy of the inverse kinematics between the samples of the tray path"
    )
    start: tuple[Real, ...] | None = Field(
        None, description="joint position near which the inverse kinematics starts [rad]; default: the best of many"
    )


class AccelerationError(Section):
    mean: Real | tuple[Real, ...] = Field(
        0.0,
        description="mean U of the executed minus the planned joint acceleration, one value or one per joint [rad/s^2]",
    )
    deviation: NonNegative | tuple[NonNegative, ...] = Field(
        0.0, description="standard deviation D, one value or one per joint [rad/s^2]"
    )
    K: NonNegative = Field(1.0, description="the plan survives every error in [U - K D, U + K D]")


class UncertaintyConfig(Section):
    friction: Interval | dict[str, Interval] | None = Field(
        None,
        description="interval of the coefficient of friction, one for all or one per object for the interface under it",
    )
    contact_points: NonNegative | dict[str, NonNegative] | None = Field(
        None,
        description="each contact point may lie this far from its place along x and along y, one value for all or one per object for the interface under it [m]",
    )
    center_of_mass: dict[str, tuple[NonNegative, NonNegative, NonNegative]] = Field(
        {},
        description="largest distance of the centre of mass from its place along x, y, z of the object's (or the tray's) frame, by name [m]",
    )
    mass: dict[str, Interval] = Field(
        {}, description="interval of the mass by object name or `tray` [kg]; inertia scales with it"
    )
    joint_acceleration: AccelerationError | None = Field(None, description="error of the executed joint acceleration")


class SolverConfig(Section):
    method: Literal["ipopt", "reachability"] = Field(
        "ipopt",
        description="ipopt: outer nonlinear program with inner contact programs; reachability: minimum time only, fast",
    )
    collocation_points: int = Field(
        200, ge=10, le=100_000, description="number N of intervals of the grid along the path"
    )
    cost: Literal["time", "effort", "smoothness"] = Field(
        "time",
        description="time; or time plus weight times the integral of the squared relative torque (effort) or acceleration (smoothness)",
    )
    weight: NonNegative = Field(0.0, description="weight of the effort or smoothness term")


class Config(Section):
    name: str = Field(description="name of the task; the results folder takes it")
    robot: RobotConfig
    tray: TrayConfig
    objects: dict[str, ObjectConfig] = Field({}, description="the objects on the tray, by name")
    contact: ContactConfig = ContactConfig()
    path: PathConfig
    uncertainty: UncertaintyConfig = UncertaintyConfig()
    solver: SolverConfig = SolverConfig()
    gravity: Vector3 = Field((0.0, 0.0, -9.81), description="gravity in the world [m/s^2]")
    seed: int = Field(0, ge=0, description="seed of every random number of the run")
    folder: Path = Field(
        Path("."), exclude=True, description="folder that relative file names in the configuration refer to"
    )
