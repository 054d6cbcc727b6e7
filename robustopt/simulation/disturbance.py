"""What differs between trials besides the world itself: a random force, and calibration offsets of the joints.

Each trial has generators of its own, spawned from the seed of the experiment and the number of the trial, one per
kind of randomness: no trial depends on how many others there are, nor on who computes it.
"""

from __future__ import annotations

import numpy as np

from robustopt.config import DisturbanceConfig
from robustopt.errors import ConfigError

Array = np.ndarray

WORLD, CALIBRATION, FORCE = range(3)
"""Kinds of randomness of a trial."""


def generator(seed: int, trial: int, kind: int) -> np.random.Generator:
    """The generator of one kind of randomness of one trial."""
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(trial, kind)))


def forces(disturbance: DisturbanceConfig, timestep: float, steps: int, random: np.random.Generator) -> Array:
    """Force on the disturbed body in each time step, world frame, shape (steps, 3) [N].

    A force f_k ~ N(0, deviation^2) is held for `hold`. Each step has the mean of the force over the step, so that the
    impulse up to any time does not depend on the time step.
    """
    deviation = np.array(disturbance.force_deviation)
    if not deviation.any():
        return np.zeros((steps, 3))
    held = int(np.ceil(steps * timestep / disturbance.hold - 1e-6)) + 1
    drawn = deviation * random.standard_normal((held, 3))
    impulse = np.vstack([np.zeros(3), np.cumsum(drawn, axis=0)])
    place = np.arange(steps + 1) * (timestep / disturbance.hold)
    whole = np.minimum(place.astype(int), held - 1)
    reached = impulse[whole] + (place - whole)[:, None] * drawn[whole]
    return np.asarray(np.diff(reached, axis=0) * (disturbance.hold / timestep))


def calibration(disturbance: DisturbanceConfig, joints: int, random: np.random.Generator) -> Array:
    """Offsets of the joints from where the controller takes them to be, (n,) [rad or m]."""
    deviation = disturbance.calibration_deviation
    if isinstance(deviation, tuple) and len(deviation) != joints:
        raise ConfigError(
            f"found {len(deviation)} values; expected one, or one for each of the {joints} joints",
            key="execution.disturbance.calibration_deviation",
        )
    return np.asarray(deviation, dtype=float) * random.standard_normal(joints)
