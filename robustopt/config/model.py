"""Models of the configuration: what each key means, its unit, default and bounds.

Units are SI, angles are radians. The reference page and the JSON Schema are generated from the descriptions here;
what relates several keys to each other is in `check`.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field

from robustopt.config.execution_model import ExecutionConfig
from robustopt.config.learning_model import LearningConfig
from robustopt.config.section import (
    Acceleration3,
    AccelerationError,
    Distance,
    Friction,
    Interval,
    Length,
    Mass,
    NonNegative,
    Point2,
    Point3,
    Pose,
    Positive,
    Real,
    Section,
    Size,
    Vector3,
    Vector4,
    Vector6,
)

FEET = ("left_foot", "right_foot")
"""Names of the feet of a robot that steps: its contacts, with the hand that it has on a rail, if any."""

HANDS = ("left_hand", "right_hand")
"""Names of its hands."""

BASE_COORDINATES = 6
"""Coordinates of the floating base of such a robot: they come before its joints."""


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
        "under it, per foot and hand of a robot on its feet (`default` for the rest); where it is not given and "
        "uncertainty.friction is, the middle of that",
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


class RailConfig(Section):
    hand: Literal["left", "right"] = Field(description="the hand that rests on the rail")
    at: Point3 = Field(description="where the middle of its palm rests on the rail, in the world [m]")
    size: tuple[Length, Length] = Field(
        description="edge lengths of the part of the palm that touches the rail, along the rail and across it [m]"
    )
    length: Length = Field(
        default=0.3,
        description="length of the rail, a bar with its middle at that place; the robot must not run into it [m]",
    )
    normal: Vector3 = Field(
        default=(0.0, 0.0, 1.0), description="direction out of the rail at that place, of any length but 0"
    )
    along: Vector3 = Field(
        default=(1.0, 0.0, 0.0),
        description="direction of the rail, and of the fingers: what of it is at a right angle to the normal",
    )

    @property
    def contact(self) -> str:
        """Name of the contact, which is that of the hand's site in the model."""
        return f"{self.hand}_hand"


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
    rail: RailConfig | None = Field(
        default=None, description="with steps: a rail on which a hand rests in one place all the way"
    )


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
        if not self.walks:
            return tuple(self.objects)
        return FEET if self.path.rail is None else (*FEET, self.path.rail.contact)
