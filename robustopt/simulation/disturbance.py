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
    """Return the random generator of one kind of randomness in one trial.

    Args:
        seed: seed of the experiment.
        trial: number of the trial.
        kind: WORLD, CALIBRATION or FORCE.
    """
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(trial, kind)))


def forces(disturbance: DisturbanceConfig, timestep: float, steps: int, random: np.random.Generator) -> Array:
    """Sample the force on the disturbed body in each time step, world frame, (steps, 3) [N].

    A force f_k ~ N(0, deviation^2) is held for `hold`. The force in a time step is the mean over the step, so the
    impulse up to any time does not depend on the time step (our choice).

    Args:
        disturbance: deviation of the force, and the time for which it is held.
        timestep: time step [s].
        steps: number of time steps.
        random: generator of the trial.
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
    """Sample the calibration offset of each joint, its actual minus its assumed position, (n,) [rad or m].

    Args:
        disturbance: deviation of the offsets.
        joints: number n of joints.
        random: generator of the trial.

    Raises:
        ConfigError: the deviation has neither one value nor one for each joint.
    """
    deviation = disturbance.calibration_deviation
    if isinstance(deviation, tuple) and len(deviation) != joints:
        raise ConfigError(
            f"found {len(deviation)} values; expected one, or one for each of the {joints} joints",
            key="execution.disturbance.calibration_deviation",
        )
    return np.asarray(deviation, dtype=float) * random.standard_normal(joints)
