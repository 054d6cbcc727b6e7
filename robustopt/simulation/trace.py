"""One trial over time. It is simulated again, because trial k by itself equals trial k of many."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from robustopt.arrays import Array, Flags
from robustopt.config import Config
from robustopt.simulation.execute import faster, prepare
from robustopt.simulation.feedback import acceleration_error
from robustopt.simulation.interfaces import Grounded, MeasuredContact
from robustopt.simulation.monte_carlo import outcome_of, simulate_trials, tracking_error
from robustopt.simulation.outcome import Motion, TrialOutcome
from robustopt.simulation.simulation import Workspace
from robustopt.solvers import Plan
from robustopt.solvers.contact_forces import ContactForces, planned_forces


@dataclass(frozen=True)
class Trace:
    """A trial over time: N steps, n coordinates of the plan, m joints with a motor.

    Attributes:
        outcome: outcome of the trial.
        t: start of each step, 0 at the start of the motion (N,) [s].
        moving: whether the step is part of the motion (N,).
        tracking_error: joint positions minus their reference (N, m) [rad or m].
        planned: planned acceleration (N, n) [rad/s^2 or m/s^2].
        executed: planned acceleration plus the low-passed error (N, n) [rad/s^2 or m/s^2].
        objects: movement by name of each object, environment contact and floating base.
        qpos: state of MuJoCo after each step (N, nq).
        joint_names: joints with a motor (m,).
        thresholds: largest allowed movement by the same names and by kind: slip, tilt, drop, lift.
        contacts: measured force by environment contact.
        planned_forces: planned forces of these contacts, None without any.
    """

    outcome: TrialOutcome
    t: Array
    moving: Flags
    tracking_error: Array
    planned: Array
    executed: Array
    objects: Mapping[str, Motion]
    qpos: Array
    joint_names: tuple[str, ...]
    thresholds: Mapping[str, Mapping[str, float]]
    contacts: Mapping[str, MeasuredContact] = field(default_factory=dict)
    planned_forces: ContactForces | None = None


def trace(plan: Plan, trial: int, config: Config | None = None, seed: int | None = None, speed: float = 1.0) -> Trace:
    """Simulate a trial of `execute` once more and keep its movement over time.

    Args:
        plan: the plan.
        trial: number of the trial.
        config: configuration in place of that of the plan, as for `execute`.
        seed: seed, in place of that of the configuration.
        speed: factor on the speed of the plan.

    Returns:
        The trial over time.

    Raises:
        Infeasible, ConfigError, SimulationFailed: as `execute`.
    """
    job = prepare(plan, config, seed, speed)
    prepared, record = simulate_trials(job, [trial], 1, Workspace())
    world, layout, planned = job.world, prepared.layout, job.planned
    error, _ = acceleration_error(world.velocities(layout, record, 0), planned.qdd, job.execution.timestep)
    criteria = layout.criteria(job.execution.failure)
    ground = [item for item in layout.interfaces if isinstance(item, Grounded)]
    contacts = {item.name: item.measured(record, 0, job.execution.timestep) for item in ground}
    return Trace(
        outcome=outcome_of(job, prepared, record, 0),
        t=planned.t,
        moving=planned.moving,
        tracking_error=tracking_error(job, prepared, record, 0),
        planned=planned.qdd,
        executed=planned.qdd + error,
        objects=layout.motions(planned, record, 0),
        qpos=record.qpos[0],
        joint_names=world.joint_names,
        thresholds={name: {item.kind: item.limit for item in items} for name, items in criteria.items()},
        contacts=contacts,
        planned_forces=planned_forces(faster(plan, speed)) if contacts else None,
    )
