"""Joint limits and joint friction: from the model file, completed and overridden by `robot.limits`.

Where they are read from:

| limit | MJCF | URDF |
|---|---|---|
| position | joint `range` | `limit lower upper` |
| velocity | `<custom><numeric name="velocity_limit">`, one value per joint in their order | `limit velocity` |
| acceleration | `<custom><numeric name="acceleration_limit">`, likewise | nowhere |
| torque | joint `actuatorfrcrange`, else gear times the actuator's force, or motor's control range | `limit effort` |
| dry friction | joint `frictionloss` | `dynamics friction` |
| viscous friction | joint `damping` | `dynamics damping` |
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields

import mujoco
import numpy as np

from robustopt.config import Config
from robustopt.errors import ConfigProblem, RobotError
from robustopt.robot.model_file import RobotModel, joint_names

VELOCITY_NUMERIC = "velocity_limit"
ACCELERATION_NUMERIC = "acceleration_limit"
REQUIRED_UNITS = {"velocity": "rad/s or m/s", "acceleration": "rad/s^2 or m/s^2", "torque": "N m or N"}


@dataclass(frozen=True)
class JointLimits:
    """Limits of the joints, shape (n,) each.

    `lower`, `upper`: position [rad or m], infinite where the joint is not limited. `velocity`, `acceleration`,
    `torque`: largest absolute values [rad/s, rad/s^2, N m; for slides m/s, m/s^2, N]. `dry_friction` [N m or N] and
    `viscous_friction` [N m s/rad or N s/m] of the joints.
    """

    lower: np.ndarray
    upper: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray
    torque: np.ndarray
    dry_friction: np.ndarray
    viscous_friction: np.ndarray

    def __post_init__(self) -> None:
        for item in fields(self):
            getattr(self, item.name).setflags(write=False)


def joint_limits(config: Config, robot: RobotModel, names: tuple[str, ...]) -> JointLimits:
    """Limits of the joints `names`; raises one RobotError that lists every limit that is missing."""
    limits = _file_limits(robot)
    _override(config, robot, limits)
    chosen = [joint_names(robot.original).index(name) for name in names]
    limits = {kind: values[chosen] for kind, values in limits.items()}
    _require(config, robot, names, limits)
    if not config.robot.joint_friction:
        limits |= {"dry_friction": np.zeros(len(names)), "viscous_friction": np.zeros(len(names))}
    return JointLimits(**limits)


def _file_limits(robot: RobotModel) -> dict[str, np.ndarray]:
    """What the model file says, one value per joint of the file, NaN where it says nothing."""
    model = robot.original
    limited = model.jnt_limited.astype(bool)
    return {
        "lower": np.where(limited, model.jnt_range[:, 0], -np.inf),
        "upper": np.where(limited, model.jnt_range[:, 1], np.inf),
        "velocity": _numeric(robot, VELOCITY_NUMERIC, robot.urdf_limits.velocity),
        "acceleration": _numeric(robot, ACCELERATION_NUMERIC, {}),
        "torque": _torque(model),
        "dry_friction": model.dof_frictionloss[model.jnt_dofadr],
        "viscous_friction": model.dof_damping[model.jnt_dofadr],
    }


def _numeric(robot: RobotModel, numeric: str, urdf: Mapping[str, float]) -> np.ndarray:
    """Limits from `<custom><numeric>`, which MJCF files may carry, or else from the URDF."""
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
    return np.where(data > 0, data, np.nan)


def _torque(model: mujoco.MjModel) -> np.ndarray:
    """Torque limits: `actuatorfrcrange` of the joint, or else what the one actuator that drives it can do."""
    limits = np.full(model.njnt, np.nan)
    for joint in range(model.njnt):
        if model.jnt_actfrclimited[joint]:
            limits[joint] = _symmetric(model.jnt_actfrcrange[joint])
            continue
        driving = [
            actuator
            for actuator in range(model.nactuator)
            if model.actuator_trntype[actuator] == mujoco.mjtTrn.mjTRN_JOINT
            and model.actuator_trnid[actuator, 0] == joint
        ]
        if len(driving) == 1:
            limits[joint] = abs(model.actuator_gear[driving[0], 0]) * _largest_force(model, driving[0])
    return np.where(limits > 0, limits, np.nan)


def _largest_force(model: mujoco.MjModel, actuator: int) -> float:
    """Largest force of an actuator before its gear; NaN where the file does not limit it."""
    if model.actuator_forcelimited[actuator]:
        return _symmetric(model.actuator_forcerange[actuator])
    plain = model.actuator_dyntype[actuator] == mujoco.mjtDyn.mjDYN_NONE
    plain = plain and model.actuator_gaintype[actuator] == mujoco.mjtGain.mjGAIN_FIXED
    motor = plain and model.actuator_biastype[actuator] == mujoco.mjtBias.mjBIAS_NONE
    if motor and model.actuator_ctrllimited[actuator]:
        return _symmetric(model.actuator_gainprm[actuator, 0] * model.actuator_ctrlrange[actuator])
    return float("nan")


def _symmetric(limits: np.ndarray) -> float:
    """The smaller side of a range: torque is limited alike both ways (our choice)."""
    return float(min(-limits[0], limits[1]))


def _override(config: Config, robot: RobotModel, limits: dict[str, np.ndarray]) -> None:
    """Put the values of `robot.limits` in place: first those of `all`, then those of each joint."""
    names = joint_names(robot.original)
    given = config.robot.limits
    unknown = [name for name in given if name != "all" and name not in names]
    if unknown:
        raise RobotError(
            [
                ConfigProblem(
                    f"robot.limits.{name}",
                    f"{robot.file.name} has no such joint; its joints are: {', '.join(names)} (or `all`)",
                )
                for name in unknown
            ]
        )
    for name in sorted(given, key=lambda name: name != "all"):
        joints = slice(None) if name == "all" else names.index(name)
        override = given[name]
        if override.position is not None:
            limits["lower"][joints], limits["upper"][joints] = override.position
        for kind in ("velocity", "acceleration", "torque", "dry_friction", "viscous_friction"):
            value = getattr(override, kind)
            if value is not None:
                limits[kind][joints] = value


def _require(config: Config, robot: RobotModel, names: tuple[str, ...], limits: dict[str, np.ndarray]) -> None:
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
