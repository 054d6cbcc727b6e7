"""Cartesian limits: closed forms of a line and of a circle, sampled motions, certificate, diagnosis, mistakes."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scenes import CONFIGS, plan_of, scene, waiter
from scipy.spatial.transform import Rotation

import robustopt as ro
from robustopt.certificate import certify
from robustopt.config import Config
from robustopt.config.load import dump, load_config, with_values
from robustopt.plotting.cartesian import cartesian_figure, point_norms
from robustopt.plotting.style import house_style
from robustopt.robot import load_robot
from robustopt.solvers import Plan, Status
from robustopt.solvers.diagnosis import diagnose
from robustopt.solvers.trajectory import Trajectory, binding_shares

SAMPLES = 100_000
SPEED, ACCELERATION = "tool Cartesian speed", "tool Cartesian acceleration"
LOOSE = {"all": {"velocity": 100.0, "acceleration": 1e4, "torque": 1e6}}


def limited(config: Config, **limits: float) -> Config:
    return with_values(config, {"robot.limits": {**LOOSE, "cartesian": {"tool": limits}}})


def line(method: str, **limits: float) -> Plan:
    """A tool that points down moves by 0.5 m on a straight line."""
    config = load_config(CONFIGS / "pick_suction.yaml", overrides=["uncertainty={}", "contact.friction=10"])
    ends = [{"position": [0.6, y, 0.5], "rpy": [np.pi, 0.0, np.arctan2(y, 0.6)]} for y in (-0.25, 0.25)]
    force = {"objects.carton.held_by.suction.force": 500.0, "path": {"tool_poses": ends}}
    return plan_of(limited(with_values(config, force), **limits), method)


def circle(points: int, method: str = "reachability") -> Plan:
    """A tool at 0.5 m from the axis of a turntable turns by 3 rad."""
    config = scene("turntable", length=3.0, solver={"collocation_points": points})
    return plan_of(limited(config, acceleration=2.0), method)


@cache
def curve() -> Plan:
    """A tray is carried along a curve by an arm whose acceleration has an error."""
    limits = "{speed: 0.4, acceleration: 2}"
    plan = plan_of(
        waiter("side_by_side", f"robot.limits.cartesian={{tool: {limits}, link3: {limits}}}"), "reachability"
    )
    assert plan.status is Status.SOLVED, plan.message
    return plan


@pytest.mark.parametrize("method", ["reachability", "ipopt"])
def test_a_line_takes_the_time_of_a_trapezoid(method: str) -> None:
    plan = line(method, speed=0.25, acceleration=2.0)
    assert plan.duration == pytest.approx(0.5 / 0.25 + 0.25 / 2.0, rel=1e-3)
    assert set(binding_shares(plan)) >= {SPEED, ACCELERATION}


def test_a_circle_is_limited_by_its_centripetal_acceleration() -> None:
    """v^2 = a r sin(2 s / r) until v = sqrt(a r), which takes sqrt(r / a) times half the integral of sin^-1/2."""
    plan, radius, limit = circle(400), 0.5, 2.0
    rise, fastest = 1.3110288 * np.sqrt(radius / limit), np.sqrt(limit * radius)
    times, speed, acceleration = point_norms(plan, plan.problem.robot.points[0])
    assert speed.max() == pytest.approx(fastest, rel=1e-3)
    assert (acceleration <= limit * (1.0 + 1e-6)).all()
    assert np.median(acceleration) >= (1.0 - 1e-3) * limit
    assert plan.duration == pytest.approx(2.0 * rise + (3.0 - np.pi / 2.0) * radius / fastest, rel=2e-3)
    assert times[-1] == pytest.approx(plan.duration)
    assert circle(20, "ipopt").duration == pytest.approx(circle(20).duration, rel=1e-4)


def test_no_instant_is_faster_than_the_limit_which_is_reached() -> None:
    plan = curve()
    config, robot = plan.problem.config, plan.problem.robot
    t = np.linspace(0.0, plan.duration, SAMPLES)
    position, axes = robot.carrier_pose(Trajectory.from_plan(plan).sample(t).q)
    assert config.tray is not None
    turn = Rotation.from_euler("xyz", config.tray.pose.rpy)
    tool = position - axes @ turn.inv().apply(config.tray.pose.position)
    speed = np.linalg.norm(np.diff(tool, axis=0), axis=1) / np.diff(t)
    assert 0.999 <= speed.max() / 0.4 <= 1.0 + 1e-9


def test_the_certificate_finds_the_limits_reached_and_not_exceeded() -> None:
    plan = curve()
    certificate = certify(plan)
    margins = {str(name): margin for name, margin in certificate.margins.items()}
    assert certificate.passed
    assert -1e-6 <= margins[SPEED].on_grid <= 1e-3
    assert margins[SPEED].between >= -1e-9
    assert -1e-6 <= margins[ACCELERATION].on_grid <= 5e-3  # the error out of the plane, and the chords
    assert margins[ACCELERATION].between >= -5e-3
    assert margins["link3 Cartesian speed"].on_grid > 0.0


def test_the_certificate_fails_a_plan_that_is_too_fast() -> None:
    plan, config = curve(), curve().problem.config
    lower = with_values(config, {"robot.limits.cartesian": {"tool": {"speed": 0.39}}})
    certificate = certify(plan, config=lower)
    assert not certificate.passed
    assert certificate.worst.limit == SPEED
    assert certificate.worst.margin == pytest.approx(1.0 - 0.4 / 0.39, rel=1e-2)


def test_jerk_limited_plans_keep_cartesian_limits() -> None:
    config = scene("turntable", length=3.0, solver={"collocation_points": 100})
    config = with_values(limited(config, speed=0.5, acceleration=2.0), {"robot.limits.all.jerk": 50.0})
    plan = plan_of(config)
    certificate = certify(plan)
    assert certificate.passed, certificate.sentence
    assert all(0.0 <= certificate.margins[name].between <= 1e-3 for name in certificate.margins if name == SPEED)
    assert set(binding_shares(plan)) >= {SPEED, ACCELERATION}


def test_infinite_limits_change_nothing() -> None:
    config = waiter("one_block", "solver.method=reachability")
    endless = {"robot.limits.cartesian": {"tool": {"speed": np.inf, "acceleration": np.inf}}}
    free, same = plan_of(config), plan_of(with_values(config, endless))
    assert np.array_equal(free.x, same.x)
    assert "cartesian" not in dump(config)


def test_a_limit_below_the_acceleration_error_has_a_remedy() -> None:
    config = waiter("one_block", "robot.limits.cartesian.tool.acceleration=0.05", "solver.collocation_points=50")
    diagnosis = diagnose(plan_of(config, "reachability"))
    assert diagnosis.conflicts == ((ACCELERATION,),)
    keys = [remedy.key for remedy in diagnosis.remedies]
    assert keys == ["robot.limits.cartesian.tool.acceleration", "uncertainty.joint_acceleration.K"]
    needed = with_values(config, {keys[0]: diagnosis.remedies[0].needed})
    assert plan_of(needed, "reachability").status is Status.SOLVED


def test_a_body_of_a_walking_robot_is_limited() -> None:
    walking = load_config(CONFIGS / "humanoid_step.yaml", overrides=["robot.limits.cartesian.pelvis.speed=0.05"])
    (point,) = load_robot(walking).points
    assert (point.name, point.speed, point.acceleration) == ("pelvis", 0.05, np.inf)
    with pytest.raises(ro.ConfigError, match=r"robot.limits.cartesian.tool: the robot carries nothing"):
        load_robot(with_values(walking, {"robot.limits.cartesian": {"tool": {"speed": 1.0}}}))


def test_an_unknown_body_is_told_with_similar_names_first() -> None:
    config = waiter("one_block", "robot.limits.cartesian={lnik3: {speed: 1}, tool: {speed: 1}}")
    with pytest.raises(ro.ConfigError, match=r"^robot.limits.cartesian.lnik3: .* one of link3, "):
        load_robot(config)


@pytest.mark.parametrize("value", ["0", "-1", ".nan", "fast"])
def test_a_wrong_value_is_refused(value: str) -> None:
    with pytest.raises(ro.ConfigError, match=r"robot.limits.cartesian.tool.speed: found .*; expected "):
        waiter("one_block", f"robot.limits.cartesian.tool.speed={value}")


def test_the_figure_has_a_column_for_each_point() -> None:
    with house_style():
        figure = cartesian_figure(curve(), "curve")
    assert [axes.get_title(loc="center") for axes in figure.axes] == ["tool", "link3", "", ""]


def test_the_norm_is_that_of_the_rows() -> None:
    plan = replace(curve())
    (tool, _) = plan.problem.limits.points
    excess = tool.excess(plan.u, plan.x[:-1], np.arange(len(plan.u)))
    assert -1e-3 <= excess[plan.problem.ds > 0].max() <= 1e-6
