"""Plan new paths at the rate of a control loop, with the same robot, objects and settings.

A planner keeps the robot's model; all else is computed by the functions that plan a single task. So its plan
equals the plan of the configuration with the new path, bit for bit. Collisions and certificate are separate calls.
"""

from __future__ import annotations

import pickle
from collections.abc import Mapping, Sequence
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from robustopt.arrays import Array
from robustopt.config import Config, FramePose
from robustopt.config.load import with_values
from robustopt.errors import ConfigError
from robustopt.limits import TimeScalingProblem
from robustopt.path import build_path
from robustopt.path.build import first_collision
from robustopt.path.collision import Collision, CollisionCheck
from robustopt.processes import cores
from robustopt.robot import Robot, load_robot
from robustopt.solvers import Plan, build_rows, solve
from robustopt.solvers.batch import known_duration, shared_durations
from robustopt.solvers.replan import Replanned, replan

OF_JOINTS, OF_POSES = ("repeated",), ("start", "blend", "tolerance")
"""Keys of the section `path` that new joint paths and new poses take from the configuration; others have defaults."""


class Planner:
    """Planner of a configuration for any number of new paths of its arm.

    `BatchPlanner` plans one path for many settings; this plans many paths with one setting. A planner must not be used
    by two threads at the same time, because its robot has one workspace.

    Raises ConfigError or RobotError on first use if the configuration is not valid.

    Attributes:
        config: the configuration; its own path is not used.
        workers: largest number of processes that share the computation of durations.
    """

    def __init__(self, config: Config, workers: int | None = None) -> None:
        """Make the planner of a configuration; by default with one worker per processor core."""
        self.config = config
        self.workers = min(workers or cores(), cores())

    @cached_property
    def robot(self) -> Robot:
        """Return the robot, which all plans share."""
        return load_robot(self.config)

    @cached_property
    def _check(self) -> CollisionCheck:
        return CollisionCheck(self.config, self.robot)

    def configured(
        self, joints: ArrayLike | None = None, *, poses: Sequence[FramePose | Mapping[str, Any]] | None = None
    ) -> Config:
        """Return the configuration with a new path, given either by joint waypoints or by poses.

        The path begins and ends at rest and has no pauses. Its blend, tolerance and start, or its treatment of repeated
        waypoints, are those of the configuration.

        Args:
            joints: joint waypoints (W, n) [rad or m].
            poses: poses of the tray, or of the tool if there is no tray, as in the section `path`.

        Raises:
            ConfigError: not exactly one of both is given, a value is not allowed, or the robot walks.
        """
        if (joints is None) == (poses is None):
            raise ConfigError("expected either joint waypoints or poses", key="path")
        if self.config.path.steps is not None:
            raise ConfigError("a walking robot follows path.steps; expected the configuration of an arm", key="path")
        kept = self.config.path.model_dump(
            include=set(OF_POSES if joints is None else OF_JOINTS), exclude_defaults=True, exclude_none=True
        )
        if joints is not None:
            return with_values(self.config, {"path": {**kept, "joints": np.asarray(joints, dtype=float).tolist()}})
        key = "tool_poses" if self.config.tray is None else "tray_poses"
        plain = [
            pose.model_dump(exclude_none=True) if isinstance(pose, FramePose) else dict(pose) for pose in poses or ()
        ]
        return with_values(self.config, {"path": {**kept, key: plain}})

    def problem(
        self, joints: ArrayLike | None = None, *, poses: Sequence[FramePose | Mapping[str, Any]] | None = None
    ) -> TimeScalingProblem:
        """Return the problem of a new path; for arguments and errors see `plan`."""
        config = self.configured(joints, poses=poses)
        return build_rows(config, self.robot, build_path(config, self.robot, collisions=False))

    def plan(
        self, joints: ArrayLike | None = None, *, poses: Sequence[FramePose | Mapping[str, Any]] | None = None
    ) -> Plan:
        """Return the plan of a new path, given either by joint waypoints or by poses, without a collision check.

        It equals `solve(build_problem(configured(...)))` bit for bit, unless that path collides: then `build_problem`
        tries the other ways to move the arm along the poses.

        Args:
            joints: joint waypoints (W, n) [rad or m].
            poses: poses of the tray, or of the tool if there is no tray, as in the section `path`.

        Raises:
            ConfigError: not exactly one of both is given, a value is not allowed, or the robot walks.
            RobotError: the robot is not valid.
            PathError: the path cannot be followed.
        """
        return solve(self.problem(joints, poses=poses))

    def replan(self, running: Plan, from_time: float) -> Replanned:
        """Plan the rest of a running plan anew with the settings of this planner; see `robustopt.solvers.replan`.

        Args:
            running: the running plan, of a task that differs in its path, limits, nominal values and intervals only.
            from_time: time from the start of the running plan [s].

        Raises:
            Infeasible: the running plan has no timing.
            ConfigError: `from_time` is not within the running plan, or the rest of the task is another one.
        """
        return replan(running, from_time, self.config.model_copy(update={"path": running.problem.config.path}))

    def collision(self, plan: Plan) -> tuple[float, Collision] | None:
        """Return the s at which bodies collide first along the path of a plan, and their collision; None without one.

        Args:
            plan: a plan of this planner.

        Raises:
            RobotError: the tray or an object overlaps a body that is fixed to the tool.
            PathError: the path is too long to be checked.
        """
        return first_collision(plan.problem.path, self._check)

    def durations(self, paths: Sequence[ArrayLike]) -> Array:
        """Return the durations of the plans of joint paths, (k,) [s]; infinite if there is no plan.

        If the work takes long enough, several processes share it; the result does not depend on their number.

        Args:
            paths: joint waypoints of each path (W, n) [rad or m].

        Raises:
            ConfigError: a value is not allowed, or the robot walks.
            RobotError: the robot is not valid.
            PathError: a path cannot be followed.
            SolverFailed: the solver stops without an answer.
        """
        return shared_durations(paths, self._duration, _durations, self.config, self.workers)

    def _duration(self, joints: ArrayLike) -> float:
        return known_duration(self.plan(joints), "a joint path")


def _durations(task: bytes, paths: Sequence[ArrayLike]) -> list[float]:
    """Return the durations of joint paths, in a worker process; `task` is the pickled configuration."""
    planner = _planner_of(task)
    return [planner._duration(joints) for joints in paths]


@lru_cache(maxsize=1)
def _planner_of(task: bytes) -> Planner:
    """Return the planner of a worker process, which is kept while the task stays the same."""
    return Planner(pickle.loads(task), workers=1)
