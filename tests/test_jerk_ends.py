"""Jerk-limited plans that begin or end in motion: closed forms of one axis, the rest of running plans, conflicts."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scenes import plan_of, scene, waiter
from scipy.optimize import brentq

import robustopt as ro
from robustopt.runs.stored_plan import read_plan
from robustopt.solvers.trajectory import Samples, Trajectory

ACCELERATION = 5.0


def one_axis(jerk: float, points: int = 200, **path: Any) -> ro.Config:
    """One slide that moves by 1 m; keyword arguments are keys of the path."""
    limits = {"velocity": 100.0, "acceleration": ACCELERATION, "torque": 1e6, "jerk": jerk}
    config = scene(robot_keys={"limits": {"all": limits}}, solver={"collocation_points": points})
    return ro.with_values(config, {f"path.{key}": value for key, value in path.items()})


def change_of_speed(before: float, after: float, jerk: float) -> tuple[float, float]:
    """Shortest time of a change of speed without acceleration at its ends [s], and the way that it takes [m]."""
    change = abs(after - before)
    short = change < ACCELERATION**2 / jerk
    time = 2.0 * np.sqrt(change / jerk) if short else change / ACCELERATION + ACCELERATION / jerk
    return float(time), float(0.5 * (before + after) * time)


def double_s(start: float, end: float, jerk: float) -> float:
    """Shortest time over 1 m between two speeds, both without acceleration [s]."""

    def way(fastest: float) -> float:
        return change_of_speed(start, fastest, jerk)[1] + change_of_speed(fastest, end, jerk)[1] - 1.0

    fastest = float(brentq(way, max(start, end), 100.0, xtol=1e-14))
    return change_of_speed(start, fastest, jerk)[0] + change_of_speed(fastest, end, jerk)[0]


def at_ends(plan: ro.Plan) -> Samples:
    """States at the start and at the end."""
    trajectory = Trajectory.from_plan(plan)
    return trajectory.sample(np.array([0.0, trajectory.duration]))


@pytest.mark.parametrize("jerk", [10.0, 50.0, 300.0, 1e4])
@pytest.mark.parametrize(("start", "end"), [(0.5, 0.0), (0.0, 0.5), (0.8, 0.3), (1e-3, 0.0), (2.0, 2.0), (0.01, 2.0)])
def test_one_axis_needs_the_time_of_the_double_s(start: float, end: float, jerk: float) -> None:
    plan = plan_of(one_axis(jerk, start_speed=start, end_speed=end), "reachability")
    shortest = double_s(start, end, jerk)
    assert shortest * (1.0 - 1e-6) <= plan.duration <= 1.001 * shortest
    samples = at_ends(plan)
    np.testing.assert_allclose(samples.qd[:, 0], [start, end], atol=1e-12)
    np.testing.assert_allclose(samples.qdd[:, 0], 0.0, atol=1e-9)
    assert ro.certify(plan).passed


@pytest.mark.parametrize(("start", "end"), [(0.8, 0.3), (2.15, 0.0)])
def test_both_formulations_have_one_optimum(start: float, end: float) -> None:
    """With 2.15 m/s there is hardly any choice: 10^(1/3) m/s is the fastest start from which 1 m is enough."""
    config = one_axis(10.0, 60, start_speed=start, end_speed=end)
    assert plan_of(config, "ipopt").duration == pytest.approx(plan_of(config, "reachability").duration, rel=1e-6)


def arm(**path: Any) -> ro.Config:
    """An arm without a load on a curved path through a stop."""
    joints = [
        [0, -0.2, 1, 0, 0.5, 0],
        [0.3, 0, 1.2, 0.2, 0.4, 0.3],
        [0.5, 0.2, 1, 0.5, 0.2, 0.1],
        [0.6, 0, 0.7, 0, 0, 0],
    ]
    config = waiter("one_block", "robot.limits.all={jerk: 200}", "solver.collocation_points=80")
    keys = {"name": "arm", "robot": config.robot.model_dump(), "path": {"joints": joints, **path}}
    return ro.Config.model_validate({**keys, "solver": {"collocation_points": 80}})


def test_the_joints_keep_their_speed_at_the_ends_of_a_curved_path() -> None:
    plan = plan_of(arm(start_speed=0.6, end_speed=0.3, pauses=[{"waypoint": 1, "time": 0.1}]), "reachability")
    ends = at_ends(plan)
    np.testing.assert_allclose(np.linalg.norm(ends.qd, axis=1), [0.6, 0.3], atol=1e-12)
    np.testing.assert_allclose(np.sum(ends.qd * ends.qdd, axis=1), 0.0, atol=1e-9)
    assert np.abs(ends.qdd).max() > 1e-3
    assert ro.certify(plan).passed


def test_a_certificate_asks_for_the_acceleration_at_a_moving_end() -> None:
    plan = plan_of(one_axis(50.0, 60, start_speed=0.5), "reachability")
    new = ro.replan(plan, 0.2)
    other = new.plan.problem.path.with_speeds(0.5, 0.0)
    new.plan.problem.path.end_accelerations = (1.01 * new.plan.problem.path.end_accelerations[0], 0.0)
    assert other.end_accelerations == (0.0, 0.0)
    certificate = ro.certify(new.plan)
    assert not certificate.passed
    assert certificate.worst.limit == "x jerk"


def test_a_stored_plan_keeps_its_moving_ends(tmp_path: Any) -> None:
    config = arm(start_speed=0.6, end_speed=0.3)
    plan = plan_of(config, "reachability")
    plan.export(tmp_path)
    back = read_plan(config, tmp_path / "plan.csv")
    np.testing.assert_allclose(back.u, plan.u, atol=1e-9)
    np.testing.assert_allclose(back.u_end, plan.u_end, atol=1e-9)
    assert back.duration == pytest.approx(plan.duration, rel=1e-12)
    assert ro.certify(back).passed


# Conflicts -------------------------------------------------------------------------------------------------


def test_a_start_that_is_too_fast_for_the_jerk_limit_names_the_fastest_one() -> None:
    plan = plan_of(one_axis(10.0, 60, start_speed=2.5), "reachability")
    assert plan.status is ro.Status.INFEASIBLE
    assert plan.message == "No timing of the path was found that satisfies the limits."
    diagnosis = ro.diagnose(plan)
    assert "no timing that starts at the given speed reaches the end. Limits in conflict: x jerk." in diagnosis.sentence
    needed = {remedy.key: remedy.needed for remedy in diagnosis.remedies if remedy.enough}
    assert needed["path.start_speed"] == pytest.approx(10.0 ** (1.0 / 3.0), rel=1e-3)
    fastest = 2.5 / ACCELERATION  # stops after 2.5 / 2 * (2.5 / 5 + 5 / jerk) m
    assert needed["robot.limits.x.jerk"] == pytest.approx(ACCELERATION / (2.0 / 2.5 - fastest), rel=1e-3)


# The rest of a running plan --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("part", "method"),
    [*((part, "reachability") for part in (0.001, 0.3, 0.6, 0.9, 0.999)), (0.8, "ipopt"), (0.999, "ipopt")],
)
def test_without_a_change_the_rest_is_that_of_the_running_plan(part: float, method: str) -> None:
    running = plan_of(
        waiter("two_blocks", "robot.limits.all={jerk: 300}", "solver.collocation_points=60"), "reachability"
    )
    config = ro.with_values(running.problem.config, {"solver.method": method})
    new = ro.replan(running, min(part * running.duration, Trajectory.from_plan(running).times[-2]), config)
    assert new.plan.duration == pytest.approx(running.duration - new.time, rel=1e-6)
    before, after = Trajectory.from_plan(running).sample(new.time), Trajectory.from_plan(new.plan).sample(0.0)
    np.testing.assert_allclose(after.qd, before.qd, atol=1e-9)
    np.testing.assert_allclose(after.qdd, before.qdd, atol=1e-9)
    if method == "reachability":
        assert ro.certify(new.plan).passed


def test_other_limits_change_the_rest_without_a_jump() -> None:
    config = waiter("one_block", "robot.limits.all={jerk: 300}", "solver.collocation_points=60")
    running = plan_of(config, "reachability")
    changes = {"robot.limits": {"all": {"jerk": 200.0, "velocity": 2.0}}, "solver.method": "reachability"}
    new = ro.replan(running, 0.1, ro.with_values(config, changes))
    before, after = Trajectory.from_plan(running).sample(new.time), Trajectory.from_plan(new.plan).sample(0.0)
    np.testing.assert_allclose(after.qdd, before.qdd, atol=1e-9)
    assert new.plan.duration > running.duration - new.time
    assert ro.certify(new.plan).passed


def test_jerk_limits_may_begin_with_the_rest() -> None:
    """The running plan has constant sdd on each interval; the new one goes on from the last one."""
    running = plan_of(waiter("one_block", "solver.collocation_points=60"), "reachability")
    config = waiter("one_block", "robot.limits.all={jerk: 500}", "solver.collocation_points=60")
    new = ro.replan(running, 0.2, ro.with_values(config, {"solver.method": "reachability"}))
    assert new.plan.status is ro.Status.SOLVED
    before = Trajectory.from_plan(running).sample(new.time - 1e-9)
    np.testing.assert_allclose(Trajectory.from_plan(new.plan).sample(0.0).qdd, before.qdd, atol=1e-6)


def test_a_motion_that_cannot_brake_any_more_is_infeasible() -> None:
    running = plan_of(one_axis(50.0, 60), "reachability")
    new = ro.replan(running, 0.9 * running.duration, one_axis(40.0, 60))
    assert new.plan.status is ro.Status.INFEASIBLE
    diagnosis = ro.diagnose(new.plan)
    assert "no timing that starts at the given speed reaches the end. Limits in conflict: x jerk." in diagnosis.sentence
    (remedy,) = diagnosis.remedies
    assert remedy.key == "robot.limits.x.jerk"
    assert 40.0 < remedy.needed <= 50.0
