"""A single trial over time, to look at: simulated again, because trial k alone is trial k of many."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robustopt.config_model import Config
from robustopt.execution.execute import prepare
from robustopt.execution.feedback import acceleration_error
from robustopt.execution.monte_carlo import joint_positions, joint_velocities, outcome_of, simulate_trials
from robustopt.execution.outcome import Motion, TrialOutcome, motion_of_object, object_motion
from robustopt.execution.simulation import Workspace
from robustopt.timescaling import Plan

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Trace:
    """A trial over time, N steps, n joints.

    t: start of each step, 0 where the motion starts (N,) [s]; moving: (N,) steps of the motion; tracking_error: joint
    positions less their reference (N, n) [rad or m]; planned: joint acceleration; executed: that plus the low-passed
    error (see `feedback`), (N, n) [rad/s^2]; objects: movement of each against what it stands on; qpos: (N, nq)
    """

    outcome: TrialOutcome
    t: Array
    moving: NDArray[np.bool_]
    tracking_error: Array
    planned: Array
    executed: Array
    objects: Mapping[str, Motion]
    qpos: Array


def trace(config: Config, plan: Plan, trial: int, seed: int | None = None, speed: float = 1.0) -> Trace:
    """Simulate trial number `trial` of `execute` with the same arguments once more, and keep what it does over time."""
    job = prepare(config, plan, seed, speed)
    prepared, record = simulate_trials(job, [trial], 1, Workspace())
    layout, planned = prepared.layout, job.planned
    names = dict.fromkeys(interface.object for interface in layout.interfaces)
    motions = {
        name: motion_of_object(
            [object_motion(item, record.sensors[0]) for item in layout.interfaces if item.object == name]
        )
        for name in names
    }
    error, _ = acceleration_error(joint_velocities(record, layout, 0), planned.qdd, job.execution.timestep)
    return Trace(
        outcome=outcome_of(job, prepared, record, 0),
        t=planned.t,
        moving=planned.moving,
        tracking_error=joint_positions(record, layout, 0) - planned.q - prepared.offsets[0],
        planned=planned.qdd,
        executed=planned.qdd + error,
        objects=motions,
        qpos=record.qpos[0],
    )
