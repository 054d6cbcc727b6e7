"""Jerk-limited plans: closed form of one axis, two formulations, samples, certificate, executions."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scenes import FLAT, G, bang_bang, plan_of, scene, waiter
from scipy.interpolate import make_interp_spline

from robustopt.arrays import Array
from robustopt.certificate import certify
from robustopt.config import Config
from robustopt.limits.names import LimitKind
from robustopt.path import Path as JointPath
from robustopt.runs.stored_plan import read_plan
from robustopt.simulation.execute import execute, faster
from robustopt.solvers import Plan, Status, build_problem, solve
from robustopt.solvers.binding import joint_jerk
from robustopt.solvers.jerk import solve_jerk
from robustopt.solvers.trajectory import Trajectory

ACCELERATION = 5.0


def one_axis(jerk: float | None, points: int = 200, acceleration: float = ACCELERATION) -> Config:
    """One slide that moves by 1 m without a speed limit that matters."""
    limits = {"velocity": 100.0, "acceleration": acceleration, "torque": 1e6} | ({} if jerk is None else {"jerk": jerk})
    return scene(robot_keys={"limits": {"all": limits}}, solver={"collocation_points": points})


def shortest(length: float, acceleration: float, jerk: float) -> float:
    """Shortest time from rest to rest with bounded acceleration and jerk [s]."""
    if acceleration**3 < jerk**2 * length / 2.0:
        part = acceleration / jerk
        return float(part + np.sqrt(part**2 + 4.0 * length / acceleration))
    return float(4.0 * (length / (2.0 * jerk)) ** (1.0 / 3.0))


@cache
def limited(name: str, jerk: float, method: str = "reachability", points: int = 100) -> Plan:
    config = waiter(name, f"robot.limits.all={{jerk: {jerk}}}", f"solver.collocation_points={points}")
    plan = solve(build_problem(config), method)
    assert plan.status is Status.SOLVED, plan.message
    return plan


@pytest.mark.parametrize("jerk", [10.0, 50.0, 1e2, 1e3, 1e4])
def test_one_axis_needs_the_time_of_the_closed_form(jerk: float) -> None:
    plan = plan_of(one_axis(jerk))
    assert shortest(1.0, ACCELERATION, jerk) <= plan.duration <= 1.001 * shortest(1.0, ACCELERATION, jerk)


def test_without_a_limit_jerk_changes_nothing() -> None:
    without, endless = plan_of(one_axis(None)), plan_of(one_axis(np.inf))
    assert without.duration == endless.duration == pytest.approx(bang_bang(1.0, ACCELERATION), rel=1e-7)
    assert without.steady
    assert endless.steady


def test_the_duration_falls_to_the_one_without_a_limit() -> None:
    durations = [limited("one_block", jerk).duration for jerk in (100.0, 300.0, 1e3, 1e4)]
    without = plan_of(waiter("one_block", "solver.collocation_points=100"), "reachability").duration
    assert (np.diff(durations) < 0.0).all()
    assert durations[-1] == pytest.approx(without, rel=2e-3)


@pytest.mark.parametrize(("name", "jerk"), [("one_block", 200.0), ("two_blocks", 100.0)])
def test_both_formulations_have_one_optimum(name: str, jerk: float) -> None:
    own, ipopt = (limited(name, jerk, method) for method in ("reachability", "ipopt"))
    assert own.duration == pytest.approx(ipopt.duration, rel=1e-6)
    assert own.message == ipopt.message
    assert own.message.startswith("Because jerk is limited, the plan is a local optimum")


@pytest.mark.parametrize("name", ["one_block", "two_blocks", "side_by_side"])
def test_limits_hold_between_samples_too(name: str) -> None:
    plan = limited(name, 300.0, points=200)
    period = 1e-4
    samples = Trajectory.from_plan(plan).every(period)
    jerk = np.abs(np.diff(samples.qdd[:-1], axis=0)) / period
    assert jerk.max() <= 300.0 * (1.0 + 1e-3)
    assert jerk.max() >= 300.0 * (1.0 - 1e-2)
    assert np.abs(samples.qdd[[0, -1]]).max() <= 1e-6
    assert np.abs(np.diff(samples.qd, axis=0)[:-1] / period - samples.qdd[:-2]).max() <= 300.0 * period
    assert certify(plan).passed


def test_rows_hold_at_the_ends_and_for_the_mean_of_each_interval() -> None:
    plan = limited("two_blocks", 300.0)
    problem, mean = plan.problem, 0.5 * (plan.u + plan.u_end)
    inner = np.flatnonzero((problem.ds > 0.0) & ~problem.rest[:-1] & ~problem.rest[1:])
    for end, u in ((0, plan.u), (1, plan.u_end), (0, mean), (1, mean)):
        at = inner + end
        rows = problem.a[at] * u[inner, None] + problem.b[at] * plan.x[at, None] + problem.c[at]
        assert rows.max() <= 0.0


def test_intervals_are_those_of_a_constant_rate() -> None:
    plan = limited("two_blocks", 300.0)
    speed, dt, u = np.sqrt(plan.x), plan.steps, plan.u
    rate = np.divide(plan.change, dt, out=np.zeros_like(dt), where=dt > 0.0)
    np.testing.assert_allclose(speed[:-1] + u * dt + rate * dt**2 / 2.0, speed[1:], atol=1e-9)
    np.testing.assert_allclose(speed[:-1] * dt + u * dt**2 / 2.0 + rate * dt**3 / 6.0, np.diff(plan.s), atol=1e-11)
    assert plan.duration == pytest.approx(dt.sum())


def test_jerk_is_limited_where_the_third_derivative_of_the_path_bends() -> None:
    """The path of a walking robot bends like this next to a switch of its contacts."""
    s, ends = np.linspace(0.0, 1.0, 201), np.array([0.0, 1.0])
    path = JointPath([make_interp_spline(s, (s + 2e-4 * np.sin(60.0 * s))[:, None], k=5)], ends, ends, "path.joints")
    plan = solve_jerk(replace(build_problem(one_axis(100.0, points=40)), path=path))
    share = np.linspace(0.0, 1.0, 41)[:, None]
    q1, q2, q3 = (path(values, order)[:, 0] for order in (1, 2, 3) for values in [np.ravel(_between(plan.s, share))])
    x, u = (np.ravel(_between(values, share)) for values in (plan.x, np.r_[plan.u, 0.0]))
    jerk = q3 * x**1.5 + 3.0 * q2 * np.sqrt(x) * u + q1 * np.tile(plan.change[1:-1] / plan.steps[1:-1], len(share))
    assert 99.0 < np.abs(jerk).max() < 101.0


def _between(values: Array, share: Array) -> Array:
    """Return values at shares of the intervals between the points that are not at rest, (shares, P - 3)."""
    return (1.0 - share) * values[1:-2] + share * values[2:-1]


def test_jerk_is_named_where_it_binds() -> None:
    plan = limited("one_block", 100.0)
    named = {name for names in plan.active for name in names}
    assert any(name.endswith(" jerk") for name in named)
    assert np.abs(joint_jerk(plan)).max() == pytest.approx(100.0, rel=1e-4)


# Certificate -------------------------------------------------------------------------------------------


def test_a_certificate_finds_too_much_jerk() -> None:
    plan = limited("one_block", 100.0)
    assert certify(plan).passed
    quick = certify(faster(plan, 1.02))
    assert not quick.passed
    assert any(name.kind == LimitKind.JERK and margin.on_grid < -0.02 for name, margin in quick.margins.items())


def test_a_jump_of_the_acceleration_is_too_much_jerk() -> None:
    config = waiter("one_block", "solver.collocation_points=100")
    steady = solve(build_problem(config), "reachability")
    found = certify(steady, config=waiter("one_block", "robot.limits.all={jerk: 1e4}", "solver.collocation_points=100"))
    assert not found.passed
    assert found.worst.limit.kind == LimitKind.JERK


def test_a_certificate_notices_a_motion_that_is_none() -> None:
    plan = limited("one_block", 100.0)
    change = plan.change.copy()
    change[40] += 1e-3 * plan.u.max()
    assert not certify(replace(plan, change=change)).passed


# Contacts, stops, records ------------------------------------------------------------------------------


def test_a_block_that_may_slip_bounds_the_acceleration() -> None:
    config = scene(
        objects={"block": FLAT}, contact={"friction": 0.3},
        robot_keys={"limits": {"all": {"velocity": 100.0, "acceleration": 100.0, "torque": 1e6, "jerk": 50.0}}},
        solver={"collocation_points": 200},
    )  # fmt: skip
    plan = plan_of(config)
    assert plan.duration == pytest.approx(shortest(1.0, 0.3 * G, 50.0), rel=2e-3)


def test_the_robot_stands_still_without_acceleration_at_a_stop() -> None:
    plan = limited("two_blocks", 300.0)
    stops = np.flatnonzero(plan.problem.ds == 0.0)
    assert len(stops) == 2
    for k in stops:
        assert plan.x[k] == plan.x[k + 1] == plan.u_end[k - 1] == plan.u[k + 1] == 0.0


def test_a_stored_plan_is_read_back(tmp_path: Path) -> None:
    plan = limited("two_blocks", 300.0)
    plan.export(tmp_path)
    back = read_plan(plan.problem.config, tmp_path / "plan.csv")
    np.testing.assert_allclose(back.u_end, plan.u_end, rtol=0, atol=1e-9)
    np.testing.assert_array_equal(back.u, plan.u)
    assert back.duration == pytest.approx(plan.duration, rel=1e-12)


def test_a_plan_is_executed() -> None:
    plan = limited("one_block", 300.0, points=200)
    executions = execute(plan, trials=2, seed=1)
    assert executions.successes == 2


def test_a_path_on_which_the_robot_cannot_stand_still_is_refused_in_words() -> None:
    problem = build_problem(waiter("one_block", "robot.limits.all={jerk: 100}", "solver.collocation_points=50"))
    c = problem.c.copy()
    c[20, 0] = 0.01
    plan = solve_jerk(replace(problem, c=c))
    assert plan.status is Status.FAILED
    assert "must be able to stand still everywhere" in plan.message
    assert plan.stuck == 20


@pytest.mark.parametrize("acceleration", [ACCELERATION, np.inf])
def test_a_limit_of_a_joint_that_does_not_move_changes_nothing(acceleration: float) -> None:
    limits = {"all": {"velocity": 100.0, "acceleration": acceleration, "torque": 20.0}, "y": {"jerk": 10.0}}
    still = plan_of(scene("two_slides", robot_keys={"limits": limits}))
    without = plan_of(scene("two_slides", robot_keys={"limits": {"all": limits["all"]}}))
    assert still.status is Status.SOLVED
    assert still.duration == pytest.approx(without.duration, rel=1e-3)


def test_velocities_hold_between_grid_points_too() -> None:
    limits = "robot.limits.all={jerk: 100, velocity: 0.3}"
    plan = plan_of(waiter("two_blocks", limits, "solver.collocation_points=200"), "reachability")
    used = np.abs(Trajectory.from_plan(plan).every(0.001).qd) / plan.problem.robot.limits.velocity
    assert 0.999 < used.max() < 1.003
