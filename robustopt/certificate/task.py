"""The task that a timing is checked for, read from a configuration: robot, path and joint limits.

Robot and path of a plan are used only if they are those of the configuration. The joint limits are read here, from the
model file and the section `robot.limits`, without the planner's reader.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Mapping
from dataclasses import dataclass
from math import inf, isfinite, isnan, nan
from typing import Any

import numpy as np

from robustopt.config import Config
from robustopt.errors import ConfigError, RobotError
from robustopt.path import Path, build_path
from robustopt.robot import JointLimits, Robot, load_robot
from robustopt.robot.model_file import model_file
from robustopt.scene.placement import solids
from robustopt.solvers import Plan


@dataclass(frozen=True, eq=False)
class Task:
    """Robot, path and joint limits of a configuration.

    Attributes:
        config: the configuration.
        robot: the robot; its limits are not used.
        path: the path.
        limits: limits of the coordinates.
    """

    config: Config
    robot: Robot
    path: Path
    limits: JointLimits


def task_of(plan: Plan, config: Config | None = None) -> Task:
    """Return the task of a configuration, along whose path the timing of a plan leads.

    Args:
        plan: the plan.
        config: the configuration; by default the plan's own.

    Raises:
        ConfigError: the configuration cannot be used, or the timing does not stop where its path does.
    """
    theirs, robot, path = plan.problem.config, plan.problem.robot, plan.problem.path
    config = theirs if config is None else config
    if config is not theirs and _what_moves(config) != _what_moves(theirs):
        robot = load_robot(config)
        path = build_path(config, robot)
        _require_stops(plan, path)
    return Task(config, robot, path, configured_limits(config, robot))


def _require_stops(plan: Plan, path: Path) -> None:
    """Check that the timing of a plan stops exactly where a path does."""
    theirs, own = plan.s[1:][np.diff(plan.s) == 0.0], path.breaks[1:-1]
    if not np.array_equal(theirs, own):
        found, expected = (", ".join(f"{s:.4g}" for s in stops) or "none" for stops in (theirs, own))
        raise ConfigError(
            f"the plan has inner stops at s = {found}, this path at {expected}; expected a plan along it", key="path"
        )


def _what_moves(config: Config) -> tuple[object, ...]:
    """Return everything that robot and path depend on."""
    tray = config.tray and config.tray.model_copy(update={"mass": 1.0, "center_of_mass": (0, 0, 0), "inertia": None})
    return config.folder, config.robot, config.gravity, config.path, tray, solids(config)


def configured_limits(config: Config, robot: Robot) -> JointLimits:
    """Return the limits of the coordinates of a robot, from its model file and `robot.limits`.

    Args:
        config: the configuration.
        robot: the robot, of which only the model as in its file and the names of its joints are used.

    Raises:
        RobotError: a joint has no limit of its velocity, acceleration or torque.
    """
    urdf, model = _urdf_limits(config), robot.original
    known = [model.joint(k).name for k in range(model.njnt)]
    every = config.robot.limits.joints.get("all")
    columns: dict[str, list[float]] = {name: [] for name in JointLimits.__dataclass_fields__}
    for name in robot.joint_names[robot.motors]:
        k, own = known.index(name), config.robot.limits.joints.get(name)
        filed = _filed(model, k) | urdf.get(name, {})
        chosen: dict[str, float] = {}
        for kind in columns:
            key = {"lower": "position", "upper": "position"}.get(kind, kind)
            given = next((v for it in (own, every) if it and (v := getattr(it, key)) is not None), None)
            if key == "position":
                given = given and given[kind == "upper"]
            chosen[kind] = filed[kind] if given is None else given
        if isfinite(chosen["torque"]) and isnan(chosen["acceleration"]):
            chosen["acceleration"] = inf
        for kind, column in columns.items():
            if isnan(chosen[kind]):
                raise RobotError(f"{name} has no {kind} limit", key=f"robot.limits.{name}")
            column.append(chosen[kind] if config.robot.joint_friction or not kind.endswith("friction") else 0.0)
    return JointLimits(**{kind: np.array(column) for kind, column in columns.items()}).behind_base(robot.base)


def _filed(model: Any, k: int) -> dict[str, float]:
    """Return the limits of joint k in its compiled model file, nan for one that is missing."""
    low, high = model.jnt_range[k] if model.jnt_limited[k] else (-inf, inf)
    speeds = {
        kind: next((float(it.data[k]) for i in range(model.nnumeric) if (it := model.numeric(i)).name == name), nan)
        for kind, name in (("velocity", "velocity_limit"), ("acceleration", "acceleration_limit"))
    }
    forces = [model.jnt_actfrcrange[k]] if model.jnt_actfrclimited[k] else []
    motors = np.flatnonzero((model.actuator_trntype == 0) & (model.actuator_trnid[:, 0] == k))
    if len(motors) == 1:  # transmission 0 is to a joint; dynamics, gain and bias 0 are those of a motor
        i = motors[0]
        gear = abs(model.actuator_gear[i, 0])
        if model.actuator_forcelimited[i]:
            forces.append(gear * model.actuator_forcerange[i])
        kinds = (model.actuator_dyntype[i], model.actuator_gaintype[i], model.actuator_biastype[i])
        if model.actuator_ctrllimited[i] and not any(kinds):
            forces.append(gear * abs(model.actuator_gainprm[i, 0]) * model.actuator_ctrlrange[i])
    bounds = [bound for force in forces if (bound := float(np.abs(force).min())) > 0.0 and force[0] < 0.0 < force[1]]
    dof = model.jnt_dofadr[k]
    return {
        "lower": float(low),
        "upper": float(high),
        **{kind: value if value > 0.0 else nan for kind, value in speeds.items()},
        "jerk": inf,
        "torque": min(bounds, default=nan),
        "dry_friction": float(model.dof_frictionloss[dof]),
        "viscous_friction": float(np.ravel(model.dof_damping[dof])[0]),
    }


def _urdf_limits(config: Config) -> Mapping[str, dict[str, float]]:
    """Return the limits of speed and torque in a URDF file by joint; {} for another kind of file."""
    root = ET.parse(model_file(config)).getroot()
    found: dict[str, dict[str, float]] = {}
    for joint in root.iter("joint") if root.tag == "robot" else ():
        limit = joint.find("limit")
        if limit is not None:
            values = {"velocity": limit.get("velocity"), "torque": limit.get("effort")}
            found[joint.get("name", "")] = {
                kind: float(text) for kind, text in values.items() if text is not None and float(text) > 0.0
            }
    return found
