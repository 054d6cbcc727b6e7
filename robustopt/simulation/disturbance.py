"""Random forces and calibration offsets of the joints.

Each trial has generators of its own, spawned from the seed of the experiment and the number of the trial, one per kind
of randomness: no trial depends on the number of others or on the process that computes it.
"""

from __future__ import annotations

import numpy as np

from robustopt.arrays import Array
from robustopt.config import DisturbanceConfig
from robustopt.errors import ConfigError

WORLD, CALIBRATION, FORCE = range(3)
"""Kinds of randomness of a trial."""


def generator(seed: int, trial: int, kind: int) -> np.random.Generator:
    """Return the generator of one kind of randomness of one trial."""
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(trial, kind)))


def forces(disturbance: DisturbanceConfig, timestep: float, steps: int, random: np.random.Generator) -> Array:
    """Sample the force on the disturbed body in each time step, world frame, shape (steps, 3) [N].

    A force f_k ~ N(0, deviation^2) is held for `hold`. Each step has the mean of the force over the step, so that the
    impulse up to any time does not depend on the time step.
    """
    deviation = np.array(disturbance.force_deviation)
    if not deviation.any():
        return np.zeros((steps, 3))
    held = int(np.ceil(steps * timestep / disturbance.hold - 1e-6)) + 1
    sampled = deviation * random.standard_normal((held, 3))
    impulse = np.vstack([np.zeros(3), np.cumsum(sampled, axis=0)])
    place = np.arange(steps + 1) * (timestep / disturbance.hold)
    whole = np.minimum(place.astype(int), held - 1)
    reached = impulse[whole] + (place - whole)[:, None] * sampled[whole]
    return np.asarray(np.diff(reached, axis=0) * (disturbance.hold / timestep))


def calibration(disturbance: DisturbanceConfig, joints: int, random: np.random.Generator) -> Array:
    """Sample the offsets of the joints from the positions that the controller assumes, (n,) [rad or m]."""
    deviation = disturbance.calibration_deviation
    if isinstance(deviation, tuple) and len(deviation) != joints:
        raise ConfigError(
            f"found {len(deviation)} values; expected one, or one for each of the {joints} joints",
            key="execution.disturbance.calibration_deviation",
        )
    return np.asarray(deviation, dtype=float) * random.standard_normal(joints)
