"""Models of the configuration: the path."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from robustopt.config.section import (
    Count,
    Distance,
    Length,
    NonNegative,
    Point2,
    Point3,
    Positive,
    Real,
    Section,
    Vector3,
    Vector4,
)


class FramePose(Section):
    """A pose along the path."""

    position: Point3 = Field(description="position of the tray's centre, or of the tool, in the world [m]")
    rpy: Vector3 | None = Field(default=None, description="roll, pitch, yaw about the fixed x, y, z axes [rad]")
    yaw: Real | None = Field(default=None, description="rotation of a level tray or tool about the vertical [rad]")
    quaternion: Vector4 | None = Field(
        default=None, description="orientation as a quaternion w, x, y, z of any non-zero length"
    )


class PathTolerance(Section):
    """Accuracy of the inverse kinematics between samples."""

    position: Positive = Field(
        default=0.0002, description="largest distance between the joint path and the path of poses [m]"
    )
    angle: Positive = Field(
        default=0.001, description="largest angle between the joint path and the path of poses [rad]"
    )


class StepConfig(Section):
    """One step of a walking robot."""

    foot: Literal["left", "right"] = Field(description="the foot that steps")
    to: Point2 = Field(
        description="position on the floor at which the middle of its sole lands, x and y in the world [m]"
    )


class StanceConfig(Section):
    """Positions of both feet on the floor."""

    left: Point2 = Field(description="middle of the left sole on the floor, x and y in the world [m]")
    right: Point2 = Field(description="middle of the right sole on the floor, x and y in the world [m]")


class RailConfig(Section):
    """A rail on which a hand of a walking robot rests."""

    hand: Literal["left", "right"] = Field(description="the hand that rests on the rail")
    at: Point3 = Field(description="position of the middle of its palm on the rail, in the world [m]")
    size: tuple[Length, Length] = Field(
        description="edge lengths of the part of the palm that touches the rail, along the rail and across it [m]"
    )
    length: Length = Field(
        default=0.3,
        description="length of the rail, a bar with its middle at this position; the robot must not collide with it "
        "[m]",
    )
    normal: Vector3 = Field(
        default=(0.0, 0.0, 1.0), description="direction out of the rail at this position, of any non-zero length"
    )
    along: Vector3 = Field(
        default=(1.0, 0.0, 0.0),
        description="direction of the rail and of the fingers; only its component perpendicular to the normal is used",
    )

    @property
    def contact(self) -> str:
        """Return the name of the contact, which is also the name of the hand's site in the model."""
        return f"{self.hand}_hand"


class PauseConfig(Section):
    """A pause at a waypoint."""

    waypoint: Count = Field(description="number of the waypoint or pose, from 0 for the first; the ends have no pause")
    time: Positive = Field(description="time for which the robot stands still there [s]")


class PathConfig(Section):
    """The path, given by exactly one of tray_poses, tool_poses, joints and steps."""

    tray_poses: tuple[FramePose, ...] | None = Field(
        default=None, description="poses of the tray, joined by straight segments"
    )
    tool_poses: tuple[FramePose, ...] | None = Field(
        default=None, description="poses of the tool, if there is no tray, joined by straight segments"
    )
    joints: tuple[tuple[Real, ...] | str, ...] | str | None = Field(
        default=None,
        description="joint waypoints, a file of them relative to the configuration (CSV, .npy, or a ROS "
        "JointTrajectory or RobotTrajectory as JSON or YAML), or several files in turn; joined by a C2 cubic spline "
        "[rad or m]",
    )
    unit: Literal["radians", "degrees"] = Field(default="radians", description="with joints: unit of the angles")
    repeated: Literal["drop", "stop"] = Field(
        default="drop",
        description="with joints: whether rows that repeat the one before are dropped, or the robot stops there; with "
        "drop, a repeated waypoint in a list is an error",
    )
    start_speed: NonNegative = Field(
        default=0.0,
        description="with joints: speed at the start, the length of the vector of joint velocities, which does not "
        "change there if jerk is limited [rad/s or m/s]",
    )
    end_speed: NonNegative = Field(
        default=0.0,
        description="with joints: speed at the end, the length of the vector of joint velocities, which does not "
        "change there if jerk is limited [rad/s or m/s]",
    )
    pauses: tuple[PauseConfig, ...] = Field(
        default=(), description="waypoints or poses at which the robot stops, and for how long; not with steps"
    )
    blend: NonNegative = Field(
        default=0.0,
        description="length of the path that is rounded on each side of a pose; with 0 the robot stops at the pose [m]",
    )
    tolerance: PathTolerance = Field(
        default=PathTolerance(),
        description="accuracy of the inverse kinematics between the samples of the path of poses",
    )
    steps: tuple[StepConfig, ...] | None = Field(
        default=None,
        description="steps of a walking robot with alternating feet; the soles stay level and point along x",
    )
    start: tuple[Real, ...] | StanceConfig | None = Field(
        default=None,
        description="joint positions near which the inverse kinematics starts, default: the best of many [rad or m]; "
        "with steps: positions of the feet before the first step [m]",
    )
    lift: Length = Field(default=0.05, description="with steps: height to which a foot is lifted [m]")
    inset: Distance = Field(
        default=0.012,
        description="with steps: distance from the middle of the standing foot at which the centre of mass passes it, "
        "on the side of the other foot [m]",
    )
    pelvis_height: Length | None = Field(
        default=None,
        description="with steps: height of the pelvis over the soles; default: as in the model's first keyframe [m]",
    )
    rail: RailConfig | None = Field(
        default=None, description="with steps: a rail on which a hand rests in one position throughout"
    )

    @property
    def joint_files(self) -> tuple[str, ...]:
        """Return the names of the files of joint waypoints; () without any."""
        if isinstance(self.joints, str):
            return (self.joints,)
        return tuple(entry for entry in self.joints or () if isinstance(entry, str))

    @property
    def joint_rows(self) -> tuple[tuple[float, ...], ...]:
        """Return the joint waypoints in the configuration itself; () without any."""
        return () if isinstance(self.joints, str) else tuple(row for row in self.joints or () if isinstance(row, tuple))

    @property
    def pause_times(self) -> dict[int, float]:
        """Return the time for which the robot pauses at each waypoint that has a pause [s]."""
        return {pause.waypoint: pause.time for pause in self.pauses}

    @property
    def poses(self) -> tuple[FramePose, ...] | None:
        """Return the poses of the carrier frame: the tray's, or the tool's if there is no tray."""
        return self.tray_poses if self.tray_poses is not None else self.tool_poses

    @property
    def poses_key(self) -> str:
        """Return the key under which these poses are given."""
        return "tray_poses" if self.tray_poses is not None else "tool_poses"
