"""A single trial over time, to look at: simulated again, because trial k alone is trial k of many."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from robustopt.config import Config
from robustopt.simulation.execute import faster, prepare
from robustopt.simulation.feedback import acceleration_error
from robustopt.simulation.footing import MeasuredContact
from robustopt.simulation.monte_carlo import outcome_of, simulate_trials, tracking_error
from robustopt.simulation.outcome import Motion, TrialOutcome
from robustopt.simulation.simulation import Workspace
from robustopt.simulation.walker_scene import WalkerLayout, WalkerScene
from robustopt.solvers import Plan
from robustopt.solvers.contact_forces import ContactForces, planned_forces

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Trace:
    """A trial over time, N steps, n coordinates of the plan, m of them joints with a motor.

    t: start of each step, 0 where the motion starts (N,) [s]; moving: (N,) steps of the motion; tracking_error: joint
    positions less their reference (N, m) [rad or m]; planned: acceleration; executed: that plus the low-passed error
    (see `feedback`), (N, n) [rad/s^2]; objects: movement of each against what it stands on, of the contacts and the
    trunk of a robot on its feet; qpos: (N, nq); joint_names: (m,); thresholds: of slip, tilt, drop and lift, by name;
    contacts: what was done to each of these contacts; planned_forces: what was to be done
    """

    outcome: TrialOutcome
    t: Array
    moving: NDArray[np.bool_]
    tracking_error: Array
    planned: Array
    executed: Array
    objects: Mapping[str, Motion]
    qpos: Array
    joint_names: tuple[str, ...]
    thresholds: Mapping[str, float]
    contacts: Mapping[str, MeasuredContact] = field(default_factory=dict)
    planned_forces: ContactForces | None = None


def trace(config: Config, plan: Plan, trial: int, seed: int | None = None, speed: float = 1.0) -> Trace:
    """Simulate trial number `trial` of `execute` with the same arguments once more, and keep what it does over time."""
    job = prepare(config, plan, seed, speed)
    prepared, record = simulate_trials(job, [trial], 1, Workspace())
    scene, layout, planned = prepared.scene, prepared.layout, job.planned
    error, _ = acceleration_error(scene.velocities(layout, record, 0), planned.qdd, job.execution.timestep)
    criteria = [item for items in scene.criteria(job.execution.failure).values() for item in items]
    contacts: dict[str, MeasuredContact] = {}
    wanted = None
    if isinstance(scene, WalkerScene) and isinstance(layout, WalkerLayout):
        contacts, wanted = scene.contacts(layout, record, 0), planned_forces(faster(plan, speed))
    return Trace(
        outcome=outcome_of(job, prepared, record, 0),
        t=planned.t,
        moving=planned.moving,
        tracking_error=tracking_error(job, prepared, record, 0),
        planned=planned.qdd,
        executed=planned.qdd + error,
        objects=scene.motions(layout, planned, record, 0),
        qpos=record.qpos[0],
        joint_names=scene.joint_names,
        thresholds={item.kind: item.limit for item in criteria},
        contacts=contacts,
        planned_forces=wanted,
    )
