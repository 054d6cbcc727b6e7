"""Limits that grow without bound: a plan never gets slower, and everything else still binds."""

import json

import numpy as np
import pytest
from scenes import CONFIGS, FLAT, G, bang_bang, plan_of, scene

from robustopt.certificate import certify
from robustopt.config import Config
from robustopt.config.load import dump, load_config
from robustopt.errors import ConfigError
from robustopt.robot import Robot, load_robot
from robustopt.solvers import Plan, Status
from robustopt.solvers.diagnosis import diagnose

SLOW, MORE = pytest.mark.slow, ("heavy", "two_blocks", "bridge")
METHODS = ("reachability", "ipopt")
SCALES = (1.0, 10.0, 1e3, 1e6, 1e9, 1e12, 1e300, np.inf)
KINDS = {
    "velocity": ("velocity",),
    "acceleration": ("acceleration",),
    "torque": ("torque",),
    "all": ("velocity", "acceleration", "torque"),
}
SAME = {"reachability": 1e-9, "ipopt": 3e-9}
"""Relative increase of a duration that counts as none: Ipopt solves to 1e-9 in the terms of its own."""


def relaxed(name: str, kinds: tuple[str, ...], factor: float, *overrides: str) -> Config:
    """Return a shipped task with limits of every joint multiplied by a factor."""
    file, changes = CONFIGS / f"{name}.yaml", ["solver.collocation_points=60", *overrides]
    robot = load_robot(load_config(file, changes))
    for kind in kinds:
        for joint, limit in zip(
            robot.joint_names[robot.base :], getattr(robot.limits, kind)[robot.base :], strict=True
        ):
            changes.append(f"robot.limits.{joint}.{kind}={in_yaml(limit * factor)}")
    return load_config(file, changes)


def in_yaml(value: float) -> str:
    return repr(float(value)) if np.isfinite(value) else ".inf"


def solved(config: Config, method: str) -> Plan:
    plan = plan_of(config, method)
    assert plan.status is Status.SOLVED, plan.message
    return plan


@pytest.mark.parametrize("method", ["reachability", pytest.param("ipopt", marks=SLOW)])
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", ["waiter_one_block", *(pytest.param(f"waiter_{more}", marks=SLOW) for more in MORE)])
def test_a_relaxed_limit_never_lengthens_a_plan(name, kind, method):
    plans = [solved(relaxed(name, KINDS[kind], factor), method) for factor in SCALES]
    durations = np.array([plan.duration for plan in plans])
    assert (durations[1:] <= durations[:-1] * (1 + SAME[method])).all()
    np.testing.assert_allclose(durations[3:], durations[-1], rtol=10 * SAME[method])
    assert all(certify(plan).passed for plan in (plans[4], plans[-1]))


@pytest.mark.parametrize("factor", [1e3, 1e9, 1e300, np.inf])
def test_where_only_a_cup_binds_no_row_is_lost(factor):
    plan = solved(relaxed("pick_suction", KINDS["all"], factor), "reachability")
    assert plan.duration == pytest.approx(solved(relaxed("pick_suction", KINDS["all"], 100.0), "reachability").duration)
    assert certify(plan).passed


@pytest.mark.parametrize("factor", SCALES)
def test_an_infeasible_task_keeps_its_conflict(factor):
    config = relaxed("waiter_two_blocks", ("velocity", "acceleration"), factor, "solver.collocation_points=20")
    plan = plan_of(load_config(dump(config), ["robot.limits.joint2.torque=20"]), "reachability")
    assert plan.status is Status.INFEASIBLE
    assert diagnose(plan).conflicts == (("joint2 torque",),)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("limit", [1e9, 1e300, np.inf])
def test_friction_alone_gives_the_closed_form(limit, method):
    config = scene(
        objects={"block": {**FLAT, "on": "tray"}}, contact={"friction": 0.3}, solver={"method": method},
        robot_keys={"limits": {"all": {"velocity": limit, "acceleration": limit, "torque": limit}}},
    )  # fmt: skip
    assert plan_of(config).duration == pytest.approx(bang_bang(1.0, 0.3 * G), rel=1e-6)


@pytest.mark.parametrize("method", METHODS)
def test_a_joint_without_a_limit_is_not_held_back_where_a_slow_joint_rests(method):
    def planned(velocity):
        limits = {"x": {"velocity": 1e-2}, "y": {"velocity": velocity, "acceleration": 1e4, "torque": np.inf}}
        steps = [[0.0, 0.0], [1e-3, 0.0], [1e-3, 1e-9], [1e-3, 0.5], [1e-3, 1.0]]
        return plan_of(scene("two_slides", joints=steps, robot_keys={"limits": limits}), method)

    slow, fast = planned(100.0), planned(np.inf)
    assert fast.duration <= slow.duration * (1 + 1e-9)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("limit", [1e9, 1e300, np.inf])
def test_a_speed_that_nothing_bounds_is_an_error(limit, method):
    limits = {"all": {"velocity": limit, "acceleration": limit, "torque": limit}}
    with pytest.raises(
        ConfigError, match=r"robot\.limits: nothing bounds the speed of x at s = .*; give robot\.limits"
    ):
        plan_of(scene(robot_keys={"limits": limits}), method)


@pytest.mark.parametrize("kind", ["velocity", "acceleration", "torque"])
def test_two_of_three_limits_may_be_missing(kind):
    limits = {"all": dict.fromkeys(KINDS["all"], np.inf) | {kind: 2.0}}
    plan = plan_of(scene(robot_keys={"limits": limits}, solver={"collocation_points": 400}))
    mass = 3.0 if kind == "torque" else 1.0
    expected = 0.5 if kind == "velocity" else bang_bang(1.0, 2.0 / mass)
    assert plan.duration == pytest.approx(expected, rel=1e-2)
    assert certify(plan).passed


@pytest.mark.parametrize("kind", ["velocity", "acceleration", "torque"])
@pytest.mark.parametrize("value", [".nan", "-.inf", "0", "-1"])
def test_only_positive_numbers_and_infinity_are_limits(kind, value):
    with pytest.raises(ConfigError, match=f"robot.limits.all.{kind}: found .*; expected a number above 0 or .inf"):
        load_config(CONFIGS / "waiter_one_block.yaml", [f"robot.limits.all.{kind}={value}"])


def test_a_position_range_may_be_open_but_is_no_nan():
    file = CONFIGS / "waiter_one_block.yaml"
    config = load_config(file, ["robot.limits.joint1.position=[-.inf, .inf]"])
    assert load_config(dump(config)).robot.limits.joints["joint1"].position == (-np.inf, np.inf)
    with pytest.raises(ConfigError, match=r"position\[1\]: found nan; expected a number or \.inf"):
        load_config(file, ["robot.limits.joint1.position=[0, .nan]"])


def test_a_plan_without_limits_is_executed_reported_and_drawn(run, tmp_path):
    endless = "robot.limits.all={velocity: .inf, acceleration: .inf, torque: .inf}"
    task = [CONFIGS / "waiter_one_block.yaml", endless, "solver.collocation_points=40", "execution.trials=2"]
    code, out, _ = run("execute", *task, "--json", "--out", tmp_path / "run")
    assert code == 0
    assert json.loads(out)["certificate"]["passed"]
    assert (tmp_path / "run" / "report.html").read_text().count("data:image/svg+xml") == 5


@pytest.mark.parametrize("method", METHODS)
def test_without_load_and_torque_limits_a_plan_needs_no_dynamics(method, monkeypatch):
    robot = {"model": "tx90l", "tool": "flange", "limits": {"all": {"torque": np.inf}}}
    path = {"joints": [[0.0] * 6, [0.5] * 6]}
    config = Config.model_validate({"name": "bare", "robot": robot, "objects": {}, "path": path})
    with monkeypatch.context() as without:
        without.setattr(Robot, "dynamics", lambda *_: pytest.fail("no limit needs the dynamics"))
        plan = solved(config, method)
    assert np.isfinite(plan.problem.torques(np.append(plan.u, 0.0), plan.x)).all()
