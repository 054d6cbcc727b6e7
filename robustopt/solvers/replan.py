"""Retiming of the rest of a running plan, whose limits have changed."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from robustopt.config import Config
from robustopt.errors import ConfigError, Infeasible
from robustopt.limits import rows_along
from robustopt.limits.grid import Grid
from robustopt.limits.track import build_track
from robustopt.robot import load_robot
from robustopt.solvers.plan import Plan
from robustopt.solvers.same_task import require_same_task
from robustopt.solvers.solve import solve
from robustopt.solvers.trajectory import Trajectory


@dataclass(frozen=True)
class Replanned:
    """A new plan of the rest of a path.

    Attributes:
        plan: the new plan. It begins on the path where the running plan is at `time`, at the same speed, and with the
            same acceleration if jerk is limited.
        time: time of the running plan at which the new plan takes over [s].
    """

    plan: Plan
    time: float


def replan(running: Plan, from_time: float, config: Config | None = None) -> Replanned:
    """Plan the rest of a running plan anew, for other limits, nominal values or intervals.

    The new plan takes over at the first grid point of the running plan that is reached at `from_time` or later, and
    has the same grid points from there on. So the rest of the running plan is a solution if nothing has changed. If
    jerk is limited, the acceleration is continuous at this point.

    Args:
        running: the running plan, with a timing.
        from_time: time from the start of the running plan [s].
        config: the new configuration, whose robot, path and scene are those of the running plan except for limits,
            masses and friction; by default that of the running plan.

    Returns:
        The new plan and the time at which it takes over. If no timing from there on is within the new limits, the
        status of the plan is infeasible.

    Raises:
        Infeasible: the running plan has no timing.
        ConfigError: `from_time` is not within the running plan, its path is another one, or its speed there is beyond
            a new limit of speed.
    """
    if running.x.size == 0:
        raise Infeasible(f"There is no running plan: {running.message}")
    old = running.problem
    config = old.config if config is None else config
    require_same_task(config, running, other_limits=True)
    times = Trajectory.from_plan(running).times
    if not 0.0 <= from_time <= times[-2]:
        raise ConfigError(
            f"found {from_time:g} s; expected a time from 0 to {times[-2]:.6g} s, the last grid point before the end",
            key="from_time",
        )
    k = int(np.searchsorted(times, from_time))
    k += bool(old.ds[k] == 0.0)  # the second copy of the grid point of a stop
    acceleration = float(running.u_end[k - 1]) if k else old.path.end_accelerations[0]
    path = old.path.after(float(running.s[k]), int(running.piece[k]), float(np.sqrt(running.x[k])), acceleration)
    robot = old.robot if config.robot == old.config.robot else load_robot(config)
    track = build_track(robot, path, Grid(running.s[k:], running.piece[k:] - running.piece[k]))
    rest = np.array([running.x[k:], np.append(running.u, running.u_end[-1])[k:]])
    return Replanned(solve(replace(rows_along(track, config), running=rest)), float(times[k]))
