"""Plans of new paths against plans of the configuration with the new path: the same bits."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest
from scenes import CONFIGS

import robustopt as ro
from robustopt.arrays import Array
from robustopt.solvers import batch

POSES: list[dict[str, Any]] = [
    {"position": [0.72, -0.4, 0.75], "yaw": -0.4},
    {"position": [0.75, 0.35, 0.8], "yaw": 0.4},
]


@cache
def planner_of(name: str, *overrides: str) -> ro.Planner:
    settings = ["solver.method=reachability", "solver.collocation_points=40", *overrides]
    return ro.Planner(ro.load_config(CONFIGS / f"{name}.yaml", settings))


def waypoints(planner: ro.Planner, count: int = 15) -> Array:
    """Return joint waypoints near the path of the configuration."""
    path = ro.build_problem(planner.config).path
    q = path(np.linspace(0.1, 0.9, count))
    return q + 0.01 * np.sin(3.0 * np.arange(q.size).reshape(q.shape))


def same(plan: ro.Plan, other: ro.Plan) -> bool:
    assert plan.status is other.status is ro.Status.SOLVED
    return plan.x.tobytes() == other.x.tobytes() and plan.duration == other.duration


@pytest.mark.parametrize("name", ["waiter_two_blocks", "pick_suction"])
def test_joint_paths_are_planned_as_by_the_configuration_with_them(name: str) -> None:
    planner = planner_of(name)
    q = waypoints(planner)
    for joints in (q, q[::-1]):
        config = planner.configured(joints)
        assert same(planner.plan(joints), ro.solve(ro.build_problem(config)))
        assert same(planner.plan(joints.tolist()), planner.plan(joints))


def test_poses_are_planned_as_by_the_configuration_with_them() -> None:
    planner = planner_of("waiter_one_block")
    config = ro.with_values(planner.config, {"path.tray_poses": POSES})
    assert planner.configured(poses=POSES) == config
    assert same(planner.plan(poses=POSES), ro.solve(ro.build_problem(config)))
    assert config.path.tray_poses is not None
    assert same(planner.plan(poses=config.path.tray_poses), planner.plan(poses=POSES))
    assert ro.certify(planner.plan(poses=POSES)).passed


def test_settings_of_a_path_stay_and_its_pauses_go() -> None:
    planner = planner_of("waiter_one_block", "path.blend=0.05", "path.tolerance.position=0.0001")
    assert planner.configured(poses=POSES).path.blend == 0.05
    assert planner.configured(poses=POSES).path.tolerance.position == 0.0001
    assert planner.configured(np.outer([0.0, 0.1], np.ones(6))).path.blend == 0.0


def test_collisions_are_a_call_of_their_own() -> None:
    planner = planner_of("waiter_one_block")
    free = planner.plan(poses=POSES)
    assert planner.collision(free) is None
    bent = np.array([-0.59, -0.06, 0.3, -1.85, -2.37, 1.24])
    start, end = free.problem.path(np.array([0.0, 1.0]))
    joints = np.stack([start, bent, end])
    plan = planner.plan(joints)
    found = planner.collision(plan)
    assert found is not None
    assert 0.0 < found[0] < 1.0
    with pytest.raises(ro.PathError, match=" and ".join(found[1].bodies)):
        ro.build_problem(planner.configured(joints))


def test_many_paths_have_the_durations_of_each_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(batch, "ALONE", (0.0, 0.0))
    monkeypatch.setattr(batch, "STARTED", (0.0, 0.0))
    alone = planner_of("waiter_two_blocks")
    shared = ro.Planner(alone.config)
    shared.workers = 2
    q = waypoints(alone)
    paths = [q + 0.001 * k for k in range(6)]
    assert shared.durations(paths).tolist() == [alone.plan(path).duration for path in paths]


def test_wrong_paths_are_refused() -> None:
    planner = planner_of("waiter_one_block")
    with pytest.raises(ro.ConfigError, match="either joint waypoints or poses"):
        planner.plan()
    with pytest.raises(ro.PathError, match="the robot has 6 joints"):
        planner.plan(np.arange(10.0).reshape(2, 5))
    with pytest.raises(ro.ConfigError, match="walking"):
        planner_of("humanoid_step").plan(np.zeros((2, 6)))


def test_the_rest_of_a_running_plan_is_planned_with_the_settings_of_the_planner() -> None:
    joints = waypoints(planner_of("waiter_one_block"))
    running = planner_of("waiter_one_block").plan(joints)
    slower = planner_of("waiter_one_block", "robot.limits.all={velocity: 0.8}")
    new = slower.replan(running, 0.2)
    expected = ro.replan(running, 0.2, slower.configured(joints))
    assert new.time == expected.time
    assert same(new.plan, expected.plan)
    assert new.plan.duration > running.duration - new.time
