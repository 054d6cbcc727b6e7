"""A driven carriage that holds a part with the cups and pads of the simulated world, for thresholds."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
from scenes import FIXTURES, G

from robustopt.config import Config
from robustopt.config.load import with_values
from robustopt.limits.bodies import inertia_matrix
from robustopt.robot.preparation import CARRIER_SITE
from robustopt.simulation.holding import held, holds_of
from robustopt.simulation.outcome import Motion
from robustopt.simulation.parameters import BodyParameters, Parameters
from robustopt.simulation.physics import physics_of, set_options
from robustopt.simulation.simulation import Workspace, simulate
from robustopt.simulation.world import add_load, place_load, positions_of

CARRIAGE = 100.0
"""Mass of the carriage [kg]."""

APPROACH, HOLD = 0.4, 1.0
"""Time over which an acceleration is approached, and for which it is held [s]."""

TIMESTEP = 0.001

DOWN = np.diag([1.0, -1.0, -1.0])
"""Axes of a tool that points down, as columns."""

ALONG = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
"""Axes of a tool that points along the world's x axis, as columns."""


def holding(held_by: dict[str, Any], *, friction: float = 0.5, **part: Any) -> Config:
    """A task of one part, by default a plate of 1 kg that is held in the middle of its upper face."""
    body = {"shape": "box", "size": [0.2, 0.2, 0.01], "mass": 1.0, "held_by": held_by, **part}
    data: dict[str, Any] = {
        "name": "test",
        "robot": {"model": "two_slides.xml", "tool": "tool", "collision": {"check": False}},
        "objects": {"part": body},
        "contact": {"friction": friction},
        "path": {"joints": [[0.0, 0.0], [1.0, 0.0]]},
        "folder": FIXTURES,
    }
    return with_values(Config.model_validate(data), {})


def parameters_of(config: Config) -> Parameters:
    """Nominal parameters, without a robot."""
    part = config.objects["part"]
    body = BodyParameters(part.mass, np.array(part.center_of_mass), inertia_matrix(part))
    assert part.held_by is not None
    friction = dict.fromkeys(config.contact_owners, float(config.contact.friction))  # type: ignore[arg-type]
    return Parameters(friction, {"part": body}, {"part": float(np.mean(part.held_by.tool.force))})


def carriage(config: Config, tool: np.ndarray) -> mujoco.MjModel:
    """A tool with these axes on three slides, whose motors take accelerations."""
    spec = mujoco.MjSpec()
    set_options(spec, physics_of(0, True), TIMESTEP)
    car = spec.worldbody.add_body(name="car", mass=CARRIAGE, inertia=[1.0, 1.0, 1.0], explicitinertial=True)
    quaternion = np.zeros(4)
    mujoco.mju_mat2Quat(quaternion, tool.ravel())
    car.add_site(name=CARRIER_SITE, quat=quaternion)
    for name, axis in zip("xyz", np.eye(3), strict=True):
        car.add_joint(name=name, type=mujoco.mjtJoint.mjJNT_SLIDE, axis=axis)
    add_load(spec, config, parameters_of(config), holds_of(config), 0.0)
    total = CARRIAGE + sum(body.mass for body in spec.bodies if body.name not in ("world", "car"))
    for name in "xyz":
        motor = spec.add_actuator(name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        motor.gear = [total, 0.0, 0.0, 0.0, 0.0, 0.0]
    return spec.compile()


def accelerated(
    config: Config, direction: np.ndarray, levels: np.ndarray, tool: np.ndarray = DOWN, hold: float = HOLD
) -> list[Motion]:
    """Movement of the part while the carriage is brought to accelerations and held there.

    direction: of the acceleration, world (3,); levels: (k,) [m/s^2]
    """
    model = carriage(config, tool)
    t = TIMESTEP * np.arange(1, round((APPROACH + hold) / TIMESTEP) + 1)
    rising = np.where(t < APPROACH, 0.5 - 0.5 * np.cos(np.pi * t / APPROACH), 1.0)
    control = np.zeros((len(levels), len(t), model.nu + 6 * model.nbody))
    control[:, :, :3] = np.asarray(levels)[:, None, None] * rising[:, None] * np.asarray(direction)
    control[:, :, 2] += G
    start = np.zeros((len(levels), model.nq))
    for qpos in start:
        place_load(config, qpos, positions_of(config, model), np.zeros(3), tool)
    record = simulate([model], start, control, 2, Workspace())
    assert not record.diverged.any()
    (interface,) = held(holds_of(config), model)
    return [interface.motion(None, record, i) for i in range(len(levels))]  # type: ignore[arg-type]


def fails(motion: Motion, opening: float = 2e-4, slide: float = 1e-3) -> bool:
    """Whether a part was lost or slid in the grip."""
    return bool(motion.lift.max() > opening or motion.slip.max() > slide)
