"""Part of `bench_planning.py`: planning at the rate of a control loop, one block on a tray."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from itertools import cycle
from pathlib import Path
from typing import Any

import numpy as np
from bench_figure import Record
from timing import interleaved, spread

from robustopt.arrays import Array
from robustopt.certificate.certify import certify
from robustopt.config import Config
from robustopt.config.load import load_config
from robustopt.solvers import build_problem, solve
from robustopt.solvers.planner import Planner
from robustopt.solvers.reachability import passes

CONFIG = "waiter_one_block"
JOINTS, POSES, COLLISION, CERTIFICATE = "new joint path", "new tray poses", "collision check", "certificate"
PUBLIC, PASSES = "ro.solve", "passes"
MANY = "joint paths, all together"
WAYPOINTS, FARTHEST = 15, 0.02
"""Waypoints of a joint path, and how far it is moved from the configured one, at random [rad]."""


def control_rate(repetitions: int, points: tuple[int, ...], paths: int) -> Iterator[Record]:
    """Time plans of new paths, checks apart, and the public call beside its compiled kernel.

    Args:
        repetitions: rounds in which the calls take turns.
        points: numbers of collocation points of the public call; new paths have the first.
        paths: number of joint paths that are planned together.
    """
    planner = Planner(_configured(points[0]))
    joints = _joint_paths(planner, paths)
    plan, next_joints, next_poses = planner.plan(joints[0]), cycle(joints), cycle(_pose_paths(repetitions))
    calls: dict[str, Callable[[], object]] = {
        JOINTS: lambda: planner.plan(next(next_joints)),
        POSES: lambda: planner.plan(poses=next(next_poses)),
        COLLISION: partial(planner.collision, plan),
        CERTIFICATE: partial(certify, plan),
    }
    for name, times in interleaved(calls, repetitions).items():
        yield _record(name, points[0], times)
    for count in points:
        yield from _public_call(count, repetitions)
    planner.durations(joints)  # begins the worker processes
    for workers in sorted({1, planner.workers}):
        many = Planner(planner.config, workers)
        (times,) = interleaved({MANY: partial(many.durations, joints)}, 1).values()
        yield {**_record(MANY, points[0], times), "settings": paths, "workers": workers}


def _public_call(points: int, repetitions: int) -> Iterator[Record]:
    problem = build_problem(_configured(points))
    rows = problem.a, problem.b, problem.c, problem.x_max, problem.ds
    seconds = interleaved({PUBLIC: partial(solve, problem), PASSES: partial(passes, *rows)}, repetitions)
    for name, times in seconds.items():
        yield {**_record(name, points, times), "times_passes": float(np.median(times / seconds[PASSES]))}


def _record(name: str, points: int, times: Array) -> Record:
    late = float(np.quantile(times, 0.95))
    return {"part": "control rate", "config": CONFIG, "solver": name, "N": points, **spread(times), "late": late}


def _configured(points: int) -> Config:
    file = Path(__file__).resolve().parents[1] / "configs" / f"{CONFIG}.yaml"
    return load_config(file, [f"solver.collocation_points={points}", "solver.method=reachability"])


def _joint_paths(planner: Planner, count: int) -> list[Array]:
    middle = build_problem(planner.config).path(np.linspace(0.0, 1.0, WAYPOINTS))
    moved = np.random.default_rng(0).uniform(-FARTHEST, FARTHEST, (count, middle.shape[1]))
    return [middle + shift for shift in moved]


def _pose_paths(count: int) -> list[list[dict[str, Any]]]:
    return [
        [
            {"position": [0.75, -0.5 + d, 0.75], "yaw": -0.588},
            {"position": [0.75, 0.5 + d, 0.75 + d], "yaw": 0.588},
        ]
        for d in np.random.default_rng(1).uniform(-0.05, 0.05, count).tolist()
    ]
