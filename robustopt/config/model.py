"""Models of the configuration: meaning, unit, default and bounds of each key.

Units are SI, angles are radians. The reference page and the JSON Schema are generated from the descriptions here. The
module `check` checks the relations between keys.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, ConfigDict, Field

from robustopt.config.execution_model import ExecutionConfig
from robustopt.config.learning_model import LearningConfig
from robustopt.config.object_model import ContactConfig, ObjectConfig, TrayConfig, contact_names, pad_names
from robustopt.config.path_model import PathConfig
from robustopt.config.section import (
    Acceleration3,
    AccelerationError,
    Distance,
    Friction,
    Limit,
    Mass,
    NonNegative,
    Pose,
    Positive,
    Range,
    Real,
    Section,
    Seed,
)

FEET = ("left_foot", "right_foot")
"""Names of the feet of a walking robot."""

HANDS = ("left_hand", "right_hand")
"""Names of the hands of a walking robot."""

BASE_COORDINATES = 6
"""Number of coordinates of a floating base, which come before the joints."""


ROBOT_SOURCES = ("example-robot-data", "menagerie", "robosuite", "dm_control")
"""Sources of robots that `robot.model: SOURCE:NAME` names."""


class JointLimitOverride(Section):
    """Limits and friction of a joint, in place of the model's; the name `all` stands for every joint."""

    position: Range | None = Field(
        default=None, description="lowest and highest joint position; `-.inf` and `.inf` for none [rad or m]"
    )
    velocity: Limit | None = Field(default=None, description="largest joint speed; `.inf` for no limit [rad/s or m/s]")
    acceleration: Limit | None = Field(
        default=None, description="largest joint acceleration; `.inf` for no limit [rad/s^2 or m/s^2]"
    )
    jerk: Limit | None = Field(
        default=None, description="largest joint jerk; none by default, or `.inf` [rad/s^3 or m/s^3]"
    )
    torque: Limit | None = Field(
        default=None, description="largest joint torque or force; `.inf` for no limit [N m or N]"
    )
    dry_friction: NonNegative | None = Field(default=None, description="Coulomb friction of the joint [N m or N]")
    viscous_friction: NonNegative | None = Field(
        default=None, description="viscous friction of the joint [N m s/rad or N s/m]"
    )


TOOL = "tool"
"""Name of the tool frame in `robot.limits.cartesian`."""


class CartesianLimit(Section):
    """Limits of the origin of a frame in the world."""

    speed: Limit | None = Field(default=None, description="largest speed; none by default, or `.inf` [m/s]")
    acceleration: Limit | None = Field(
        default=None, description="largest acceleration; none by default, or `.inf` [m/s^2]"
    )


class RobotLimits(Section):
    """Limits of joints by their names, beside those of points."""

    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, JointLimitOverride]

    cartesian: dict[str, CartesianLimit] | None = Field(
        default=None,
        description="limits of the speed and acceleration of points in the world: of the origin of the tool frame, by "
        "the name `tool`, or of that of a body of the model, by the name of the body",
    )

    @property
    def joints(self) -> dict[str, JointLimitOverride]:
        """Return the limits of joints by name, `all` included."""
        return dict(self.__pydantic_extra__)


class Collision(Section):
    """Collision check along the path."""

    check: bool = Field(
        default=True, description="whether to check the path for collisions of the robot, the tray and the objects"
    )
    exclude: tuple[tuple[str, str], ...] = Field(
        default=(), description="pairs of body names whose collisions are ignored"
    )


class RobotConfig(Section):
    """The robot: its model, tool, base and limits."""

    model: str = Field(
        description="name of a shipped robot (tx90l, humanoid), an MJCF or URDF file relative to the configuration, "
        "`package://NAME/...`, or SOURCE:NAME of `robustopt robots`, such as `example-robot-data:panda`"
    )
    tool: str | tuple[str, ...] = Field(
        default="flange",
        description="site or body of the model that carries the tray or holds the parts; or a list of the hands of a "
        "walking robot that hold the tray together: the tool frame then has the axes of the first hand and its origin "
        "midway between the hands",
    )
    posture: dict[str, Real] = Field(
        default={},
        description="positions of the joints of a walking robot that do not move along the path, by joint name; "
        "default: their positions in the model's first keyframe [rad or m]",
    )

    @property
    def tools(self) -> tuple[str, ...]:
        """Return the names of the tool or tools."""
        return (self.tool,) if isinstance(self.tool, str) else self.tool

    base: Pose = Field(default=Pose(), description="pose of the robot's base in the world")
    limits: RobotLimits = Field(
        default=RobotLimits.model_validate({}),
        description="limits of the joints by their names, and of points of the robot in the world",
    )
    limits_file: str | tuple[str, ...] | None = Field(
        default=None,
        description="file in the format of MoveIt's joint_limits.yaml or pilz_cartesian_limits.yaml, relative to the "
        "configuration, or a list of such files; their limits replace those of the model, and `limits` replaces theirs",
    )
    locked: dict[str, Real] = Field(
        default={}, description="fixed positions of locked joints, by joint name [rad or m]"
    )
    joint_friction: bool = Field(
        default=True, description="include dry and viscous joint friction in the joint torques"
    )
    collision: Collision = Field(default=Collision(), description="collision check along the path")


class UncertaintyConfig(Section):
    """Intervals of the uncertain quantities."""

    friction: tuple[Friction, Friction] | dict[str, tuple[Friction, Friction]] | None = Field(
        default=None,
        description="interval of the coefficient of friction, one for all contacts, or by contact or object (`default` "
        "for the rest)",
    )
    contact_points: Distance | dict[str, Distance] | None = Field(
        default=None,
        description="largest distance of each contact point from its nominal position along x and along y, one value "
        "for all contacts, or by contact or object (`default` for the rest) [m]",
    )
    center_of_mass: dict[str, tuple[Distance, Distance, Distance]] = Field(
        default={},
        description="largest distance of the centre of mass from its nominal position along x, y, z of the object's or "
        "the tray's frame, by object name or `tray` [m]",
    )
    mass: dict[str, tuple[Mass, Mass]] = Field(
        default={}, description="interval of the mass, by object name or `tray`; the inertia scales with the mass [kg]"
    )
    inertia: dict[str, Literal["realizable"] | tuple[Positive, Positive]] = Field(
        default={},
        description="inertia about the centre of mass, by object name or `tray`; `realizable`: that of any "
        "distribution of the mass within the shape that has the centre of mass; or the lowest and highest factor on "
        "the given inertia; default: `realizable` for a body whose centre of mass has an interval, else the given "
        "inertia",
    )
    joint_acceleration: AccelerationError | None = Field(
        default=None, description="interval of the error of the joint acceleration"
    )
    base_acceleration: NonNegative | tuple[NonNegative, ...] = Field(
        default=0.0,
        description="with path.steps: largest error of the acceleration of the floating base, one value, or six: along "
        "x, y, z [m/s^2] and about z, y, x [rad/s^2]",
    )


class SolverConfig(Section):
    """The solver and its grid."""

    method: Literal["ipopt", "reachability"] = Field(
        default="ipopt",
        description="solver: a nonlinear program with inner contact programs (ipopt), or a faster method that "
        "minimises time only (reachability)",
    )
    collocation_points: Annotated[int, Field(ge=10, le=20_000)] | Literal["auto"] = Field(
        default="auto",
        description="number N of grid intervals along the path; auto: as many as it takes for a duration within 0.1 % "
        "of that of ever finer grids, and for limits that hold between grid points",
    )
    cost: Literal["time", "effort", "smoothness"] = Field(
        default="time",
        description="cost: time, or time plus `weight` times the integral of the squared relative torque (effort) or "
        "acceleration (smoothness)",
    )
    weight: NonNegative = Field(default=0.0, description="weight of the effort or smoothness term")


class OutputConfig(Section):
    """Files that a run writes."""

    period: Positive = Field(
        default=0.004, ge=1e-5, le=1e6, description="period at which the exported trajectory is sampled [s]"
    )


def _empty_mapping(data: Any) -> Any:
    return {} if data is None else data


class Config(Section):
    """Configuration of a task."""

    name: str = Field(description="name of the task and of its results folder")
    robot: RobotConfig = Field(description="the robot")
    tray: TrayConfig | None = Field(
        default=None, description="the tray that the tool carries; required if an object stands on it"
    )
    objects: Annotated[dict[str, ObjectConfig], BeforeValidator(_empty_mapping)] = Field(
        default={}, description="the objects that stand on the tray or are held by the tool, by name"
    )
    contact: ContactConfig = Field(
        default=ContactConfig(), description="friction, and the approximation of the contacts"
    )
    path: PathConfig = Field(description="the path: exactly one of tray_poses, tool_poses, joints and steps")
    uncertainty: UncertaintyConfig = Field(
        default=UncertaintyConfig(),
        description="intervals for which the plan must hold; the nominal value must lie in its interval",
    )
    solver: SolverConfig = Field(default=SolverConfig(), description="the solver")
    output: OutputConfig = Field(default=OutputConfig(), description="files that a run writes")
    execution: ExecutionConfig | None = Field(
        default=None, description="execution in simulation; `plan` checks this section but does not use it"
    )
    learning: LearningConfig | None = Field(
        default=None, description="learning; `plan` checks this section but does not use it"
    )
    gravity: Acceleration3 = Field(
        default=(0.0, 0.0, -9.81), description="acceleration due to gravity, in the world frame [m/s^2]"
    )
    seed: Seed = Field(default=0, description="seed of all random numbers of the run")
    folder: Path = Field(
        default=Path("."), exclude=True, description="folder that relative file names in the configuration refer to"
    )

    def inertia_of(self, name: str) -> Literal["realizable"] | tuple[float, float]:
        """Return `realizable`, or the interval of the factor on the inertia of the tray or an object.

        Args:
            name: name of the object, or `tray`.
        """
        moves = any(self.uncertainty.center_of_mass.get(name, ()))
        return self.uncertainty.inertia.get(name, "realizable" if moves else (1.0, 1.0))

    @property
    def environment_contacts(self) -> tuple[str, ...]:
        """Return the names of the robot's contacts with its environment: its feet, and a hand on a rail."""
        if self.path.steps is None:
            return ()
        return FEET if self.path.rail is None else (*FEET, self.path.rail.contact)

    @property
    def contact_owners(self) -> dict[str, str]:
        """Return the object of each contact, by the name of the contact; an environment contact has its own name.

        Friction and contact points may be given by either name.
        """
        own = {name: name for name in self.environment_contacts}
        if self.tray is not None and self.tray.hands is not None:
            own |= {pad: "tray" for tool in self.robot.tools for pad in pad_names(tool)}
        return own | {contact: name for name, body in self.objects.items() for contact in contact_names(name, body)}
