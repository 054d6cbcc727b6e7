"""What a simulated world has to say of itself; trials, outcomes and pictures know nothing else of it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol, TypeVar

import mujoco
import numpy as np

from robustopt.config import Config, FailureConfig
from robustopt.simulation.controller import Gains, JointLayout, Reference
from robustopt.simulation.outcome import Criterion, Motion
from robustopt.simulation.scene import SceneBuilder, View
from robustopt.simulation.simulation import Record
from robustopt.simulation.truth import World
from robustopt.simulation.walker_scene import WalkerScene

Array = np.ndarray
L = TypeVar("L", bound=JointLayout)


class Scene(Protocol[L]):
    """A robot under its controller, and what friction holds: a tray with objects, or the robot itself on its feet.

    joint_names, torque_limit (m,): of the joints with a motor; driven: which of a plan's n coordinates these are;
    pushed: the body that a random force acts on where the configuration names none; believed: world of the planner's
    point values
    """

    joint_names: tuple[str, ...]
    torque_limit: Array
    driven: slice
    pushed: str
    believed: World

    def model(self, world: World, sky: bool = False) -> mujoco.MjModel:
        """The compiled world; `sky`: with a light background, for pictures."""

    def layout(self, model: mujoco.MjModel) -> L:
        """Where things are in a model of this scene."""

    def start(self, layout: L, q: Array, size: int) -> Array:
        """qpos (size,) with the robot at coordinates q (n,) and everything in its place."""

    def controls(self, model: mujoco.MjModel, layout: L, planned: Reference) -> Array:
        """Control inputs at every time step, (N, nu)."""

    def velocities(self, layout: L, record: Record, i: int) -> Array:
        """Rates of a plan's coordinates in a trial, before each step and after the last, (N + 1, n)."""

    def motions(self, layout: L, planned: Reference, record: Record, i: int) -> dict[str, Motion]:
        """Movement of all that friction holds in a trial, by name."""

    def criteria(self, failure: FailureConfig) -> Mapping[str, tuple[Criterion, ...]]:
        """How each of them fails; where several happen in the same step, the first counts."""

    def view(self, layout: L, qpos: Array) -> View:
        """Place of a camera for a trial with positions qpos (N, nq)."""


def scene_of(config: Config, gains: Gains, timestep: float) -> Scene[Any]:
    """The world of a configuration. Raises ConfigError where a key of `execution` does not fit the robot."""
    return WalkerScene(config, gains, timestep) if config.walks else SceneBuilder(config, gains, timestep)
