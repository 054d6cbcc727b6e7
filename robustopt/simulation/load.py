"""The load of the robot in the simulated world: tray, objects, cups and pads."""

from __future__ import annotations

from collections.abc import Mapping

import mujoco
import numpy as np

from robustopt.arrays import Array
from robustopt.config import Config
from robustopt.scene.patches import Law, patches
from robustopt.scene.placement import placements
from robustopt.simulation.holding import add_finger, add_hold
from robustopt.simulation.objects import add_carrier, add_contacts, add_object, add_pose_sensors, orientation
from robustopt.simulation.parameters import Parameters
from robustopt.simulation.physics import PREFIX, quaternion


def add_load(spec: mujoco.MjSpec, config: Config, parameters: Parameters, compensated: float) -> None:
    """Add tray, cups and pads to the carrier site, and the objects as free bodies.

    Args:
        spec: the robot, with a site at the carrier frame.
        config: the task.
        parameters: friction, inertia and forces.
        compensated: part of the tray's weight that the controller takes off the robot.
    """
    tool = add_carrier(spec, config, parameters, compensated)
    for name in placements(config):
        body = add_object(spec.worldbody, config, name, parameters, np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]))
        body.add_freejoint(name=PREFIX + name)
    add_contacts(spec, config, parameters)
    for patch in patches(config):
        if patch.law is not Law.FRICTION:
            add_hold(spec, config, tool, patch, parameters)
    add_pose_sensors(spec, config)


def fix_load(spec: mujoco.MjSpec, config: Config, parameters: Parameters, compensated: float) -> None:
    """Add tray, fingers and objects, all fixed to the robot; arguments as of `add_load`."""
    tool = add_carrier(spec, config, parameters, compensated)
    for name, placement in placements(config).items():
        add_object(tool, config, name, parameters, placement.position, orientation(placement))
    for patch in patches(config):
        if patch.law is Law.DRIVEN_PAD:
            add_finger(tool, patch, config.objects[patch.object])


def positions_of(config: Config, model: mujoco.MjModel) -> dict[str, int]:
    """Return the first index in qpos of each object."""
    return {name: int(model.joint(PREFIX + name).qposadr[0]) for name in placements(config)}


def place_load(config: Config, qpos: Array, at: Mapping[str, int], position: Array, frame: Array) -> None:
    """Put the objects in their places.

    Args:
        config: the task.
        qpos: positions to write to.
        at: first index in it of each object.
        position: origin of the carrier frame in the world (3,) [m].
        frame: axes of the carrier frame as columns, world (3, 3).
    """
    turn = quaternion(frame)
    for name, placement in placements(config).items():
        k = at[name]
        qpos[k : k + 3] = position + frame @ placement.position
        mujoco.mju_mulQuat(qpos[k + 3 : k + 7], turn, orientation(placement))
