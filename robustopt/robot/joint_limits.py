"""Joint limits and joint friction: from the model file, completed and overridden by `robot.limits`.

| limit | MJCF | URDF |
|---|---|---|
| position | joint `range` | `limit lower upper` |
| velocity | `<custom><numeric name="velocity_limit">`, one value per joint in their order | `limit velocity` |
| acceleration | `<custom><numeric name="acceleration_limit">`, likewise | nowhere |
| jerk | nowhere, none by default | nowhere |
| torque | joint `actuatorfrcrange`, gear times the force range of its only actuator | `limit effort` |
| dry friction | joint `frictionloss` | `dynamics friction` |
| viscous friction | joint `damping` | `dynamics damping` |

If a file bounds a torque twice, the smaller bound holds. The control range of a motor bounds its force. A joint with a
torque limit needs no acceleration limit.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields

import mujoco
import numpy as np

from robustopt.arrays import Array
from robustopt.config import Config
from robustopt.errors import ConfigProblem, RobotError
from robustopt.robot.model_file import joint_names
from robustopt.robot.preparation import RobotModel

VELOCITY_NUMERIC = "velocity_limit"
ACCELERATION_NUMERIC = "acceleration_limit"
REQUIRED_UNITS = {"velocity": "rad/s or m/s", "acceleration": "rad/s^2 or m/s^2", "torque": "N m or N"}
ROUNDING = 1e-6
"""Distance from its range at which a joint may be locked [rad or m]: files round the ends of ranges."""
MOST_SINGLE = 3
"""Most unknown joints that are errors one by one: a file of limits may be that of another robot."""
FRICTIONS = ("dry_friction", "viscous_friction")


@dataclass(frozen=True)
class JointLimits:
    """The limits of the coordinates of a robot, shape (n,) each.

    Attributes:
        lower, upper: limits of the position [rad or m]; infinite if the joint has none.
        velocity, acceleration, torque: largest absolute values [rad/s, rad/s^2, N m; for slides m/s, m/s^2, N].
        jerk: largest absolute value [rad/s^3 or m/s^3]; infinite if the joint has none.
        dry_friction: dry friction of the joints [N m or N].
        viscous_friction: viscous friction of the joints [N m s/rad or N s/m].
    """

    lower: Array
    upper: Array
    velocity: Array
    acceleration: Array
    jerk: Array
    torque: Array
    dry_friction: Array
    viscous_friction: Array

    def __post_init__(self) -> None:
        for item in fields(self):
            getattr(self, item.name).setflags(write=False)

    def behind_base(self, base: int) -> JointLimits:
        """Return the limits preceded by those of a floating base, which are infinite.

        Args:
            base: number of base coordinates.
        """
        endless, none = np.full(base, np.inf), np.zeros(base)
        first = dict.fromkeys(FRICTIONS, none) | {"lower": -endless}
        padded = {
            item.name: np.concatenate([first.get(item.name, endless), getattr(self, item.name)])
            for item in fields(self)
        }
        return JointLimits(**padded)


def joint_limits(config: Config, robot: RobotModel, names: tuple[str, ...]) -> JointLimits:
    """Return the limits of some joints.

    Args:
        config: the configuration, with `robot.limits` and `robot.joint_friction`.
        robot: the robot as read from its file.
        names: names of the joints.

    Raises:
        RobotError: limits are missing, `robot.limits` names joints that do not exist, or a joint is locked outside its
            range; the error lists all of them.
    """
    limits = _file_limits(robot)
    _override(config, robot, limits)
    _require_locked_within(config, robot, limits)
    chosen = [joint_names(robot.original).index(name) for name in names]
    limits = {kind: values[chosen] for kind, values in limits.items()}
    has_no_need = np.isnan(limits["acceleration"]) & np.isfinite(limits["torque"])
    limits["acceleration"] = np.where(has_no_need, np.inf, limits["acceleration"])
    _require(config, robot, names, limits)
    if not config.robot.joint_friction:
        limits |= {name: np.zeros(len(names)) for name in FRICTIONS}
    return JointLimits(**limits)


def _file_limits(robot: RobotModel) -> dict[str, Array]:
    """Return the limits in the model file, one value per joint of the file, NaN for a missing one."""
    model = robot.original
    limited = model.jnt_limited.astype(bool)
    return {
        "lower": np.where(limited, model.jnt_range[:, 0], -np.inf),
        "upper": np.where(limited, model.jnt_range[:, 1], np.inf),
        "velocity": _numeric(robot, VELOCITY_NUMERIC, robot.urdf_limits.velocity),
        "acceleration": _numeric(robot, ACCELERATION_NUMERIC, {}),
        "jerk": np.full(model.njnt, np.inf),
        "torque": _torque(model),
        "dry_friction": model.dof_frictionloss[model.jnt_dofadr],
        "viscous_friction": model.dof_damping[model.jnt_dofadr],
    }


def _numeric(robot: RobotModel, numeric: str, urdf: Mapping[str, float]) -> Array:
    """Return limits from a `<custom><numeric>`, which MJCF files may carry, or else from the URDF."""
    model, names = robot.original, joint_names(robot.original)
    found = [model.numeric(index).name for index in range(model.nnumeric)]
    if numeric not in found:
        return np.array([urdf.get(name, np.nan) for name in names])
    data = model.numeric(numeric).data
    if len(data) != len(names):
        raise RobotError(
            f"{robot.file.name}: the numeric {numeric} has {len(data)} values; it needs one for each of the "
            f"{len(names)} joints {', '.join(names)}",
            key="robot.model",
        )
    wrong = data[~(data >= 0)]
    if len(wrong):
        complaint = f"found {wrong[0]:g}; expected limits above 0, or inf for none"
        raise RobotError(f"{robot.file}: numeric {numeric}: {complaint}", key="robot.model")
    return np.where(data > 0, data, np.nan)


def _torque(model: mujoco.MjModel) -> Array:
    """Return torque limits: the smaller of the joint's `actuatorfrcrange` and the force of its only actuator."""
    limits = np.full(model.njnt, np.nan)
    on_joint = model.actuator_trntype == mujoco.mjtTrn.mjTRN_JOINT
    for joint in range(model.njnt):
        ranges = [_symmetric(model.jnt_actfrcrange[joint])] if model.jnt_actfrclimited[joint] else []
        driving = np.flatnonzero(on_joint & (model.actuator_trnid[:, 0] == joint))
        if len(driving) == 1:
            gear = abs(model.actuator_gear[driving[0], 0])
            ranges += [gear * force for force in _largest_forces(model, int(driving[0]))]
        limits[joint] = min((limit for limit in ranges if limit > 0), default=np.nan)
    return limits


def _largest_forces(model: mujoco.MjModel, actuator: int) -> list[float]:
    """List the bounds on an actuator's force: its force range and, for a motor, its control range times its gain."""
    forces = [_symmetric(model.actuator_forcerange[actuator])] if model.actuator_forcelimited[actuator] else []
    is_motor = (
        model.actuator_dyntype[actuator] == mujoco.mjtDyn.mjDYN_NONE
        and model.actuator_gaintype[actuator] == mujoco.mjtGain.mjGAIN_FIXED
        and model.actuator_biastype[actuator] == mujoco.mjtBias.mjBIAS_NONE
    )
    if is_motor and model.actuator_ctrllimited[actuator]:
        forces.append(abs(model.actuator_gainprm[actuator, 0]) * _symmetric(model.actuator_ctrlrange[actuator]))
    return forces


def _symmetric(limits: Array) -> float:
    """Return the smaller absolute value of a range: torque limits are the same in both directions (our choice)."""
    return float(min(-limits[0], limits[1]))


def _override(config: Config, robot: RobotModel, limits: dict[str, Array]) -> None:
    """Apply the values of `robot.limits`: first those for `all`, then those for each joint."""
    names = joint_names(robot.original)
    given = config.robot.limits.joints
    unknown = [name for name in given if name != "all" and name not in names]
    if unknown:
        known = f"its joints are: {', '.join(names)} (or `all`)"
        if len(unknown) > MOST_SINGLE:
            message = f"{robot.file.name} has no joints {', '.join(unknown)}; {known}"
            raise RobotError(message, key="robot.limits")
        message = f"{robot.file.name} has no such joint; {known}"
        raise RobotError([ConfigProblem(f"robot.limits.{name}", message) for name in unknown])
    for name in sorted(given, key=lambda name: name != "all"):
        joints = slice(None) if name == "all" else names.index(name)
        override = given[name]
        if override.position is not None:
            limits["lower"][joints], limits["upper"][joints] = override.position
        for kind in ("velocity", "acceleration", "jerk", "torque", *FRICTIONS):
            value = getattr(override, kind)
            if value is not None:
                limits[kind][joints] = value


def _require_locked_within(config: Config, robot: RobotModel, limits: dict[str, Array]) -> None:
    """Check that joints are locked at positions within their ranges."""
    problems = []
    for name, value in config.robot.locked.items():
        k = joint_names(robot.original).index(name)
        low, high = limits["lower"][k], limits["upper"][k]
        if not low - ROUNDING <= value <= high + ROUNDING:
            found = f"found {value:g}; expected a position in the range of the joint, {low:g} to {high:g}"
            problems.append(ConfigProblem(f"robot.locked.{name}", found))
    if problems:
        raise RobotError(problems)


def _require(config: Config, robot: RobotModel, names: tuple[str, ...], limits: dict[str, Array]) -> None:
    problems = []
    for kind, unit in REQUIRED_UNITS.items():
        missing = [name for name, value in zip(names, limits[kind], strict=True) if np.isnan(value)]
        if missing:
            problems.append(
                ConfigProblem(
                    "robot.limits",
                    f"{robot.file.name} has no {kind} limit for {', '.join(missing)}; add `robot.limits.{missing[0]}: "
                    f"{{{kind}: ...}}` for each, or `robot.limits.all: {{{kind}: ...}}` for every joint [{unit}]",
                )
            )
    if problems:
        raise RobotError(problems)
