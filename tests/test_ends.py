"""Speeds at the ends of a path, pauses at waypoints, and plans of the rest of a running plan."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scenes import CONFIGS, FLAT, G, bang_bang, plan_of, scene, waiter

import robustopt as ro
from robustopt.exports.cycles import whole_cycles
from robustopt.solvers.trajectory import Trajectory

MU = 0.3
"""Friction of the block, which bounds the acceleration of the slide to MU G."""

LENGTH = 1.0


def slide(method: str = "reachability", points: int = 200, **path: Any) -> ro.Config:
    """A block on a tray on one slide; keyword arguments are keys of the path."""
    config = scene(
        "slide", {"block": {**FLAT, "on": "tray"}}, contact={"friction": MU},
        solver={"method": method, "collocation_points": points},
    )  # fmt: skip
    return ro.with_values(config, {f"path.{key}": value for key, value in path.items()})


def shortest(length: float, start: float, end: float) -> float:
    """Shortest time over a length between two speeds with the acceleration MU G either way [s]."""
    acceleration = MU * G
    fastest = np.sqrt(acceleration * length + (start**2 + end**2) / 2)
    return float((2 * fastest - start - end) / acceleration)


# Speeds at the ends ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("method", ["reachability", "ipopt"])
@pytest.mark.parametrize(("start", "end"), [(0.8, 0.0), (0.0, 0.5), (0.8, 0.5)])
def test_speeds_at_the_ends_have_the_closed_form(method: str, start: float, end: float) -> None:
    plan = plan_of(slide(method, start_speed=start, end_speed=end))
    assert plan.duration == pytest.approx(shortest(LENGTH, start, end), rel=2e-3)
    trajectory = Trajectory.from_plan(plan)
    assert trajectory.sample(0.0).qd[0, 0] == pytest.approx(start, abs=1e-12)
    assert trajectory.sample(trajectory.duration).qd[0, 0] == pytest.approx(end, abs=1e-12)
    assert ro.certify(plan).passed


def test_a_certificate_asks_for_the_speeds_of_its_configuration() -> None:
    plan = plan_of(slide(start_speed=0.8))
    certificate = ro.certify(plan, config=slide(start_speed=0.7))
    assert not certificate.passed
    assert certificate.worst.limit == "timing"


def test_a_start_that_is_too_fast_is_infeasible_and_the_remedy_is_the_fastest_start() -> None:
    plan = plan_of(slide(start_speed=3.0))
    assert plan.status is ro.Status.INFEASIBLE
    diagnosis = ro.diagnose(plan)
    assert "no timing that starts at the given speed reaches the end" in diagnosis.sentence
    remedy = next(remedy for remedy in diagnosis.remedies if remedy.key == "path.start_speed")
    assert remedy.enough
    assert remedy.needed == pytest.approx(np.sqrt(2 * MU * G * LENGTH), rel=2e-3)


def test_an_end_that_is_too_fast_is_infeasible() -> None:
    diagnosis = ro.diagnose(plan_of(slide(end_speed=3.0)))
    assert "no timing that starts from rest reaches the end at path.end_speed" in diagnosis.sentence
    assert any(remedy.key == "path.end_speed" for remedy in diagnosis.remedies)


def test_a_speed_beyond_a_velocity_limit_is_an_error() -> None:
    config = ro.with_values(slide(end_speed=1.0), {"robot.limits": {"all": {"velocity": 0.75}}})
    with pytest.raises(
        ro.ConfigError, match=r"path\.end_speed: found 1; expected at most 0\.75, because of .*velocity"
    ):
        plan_of(config)


def test_an_exported_motion_says_that_its_end_is_slower() -> None:
    plan = plan_of(slide(end_speed=0.5))
    motion = whole_cycles(plan, 0.1)
    assert motion.samples.qd[-1, 0] == pytest.approx(0.5 / motion.factor)
    assert "its speed at the end is lower by as much" in " ".join(motion.notes)


@pytest.mark.parametrize(
    ("path", "message"),
    [
        ({"start_speed": -1.0}, "path.start_speed"),
        ({"pauses": [{"waypoint": 1, "time": 0.5}]}, "path.pauses[0].waypoint: found 1; expected"),
        ({"pauses": [{"waypoint": 0, "time": 0.5}]}, "path.pauses[0].waypoint"),
    ],
)
def test_mistakes_are_named(path: dict[str, Any], message: str) -> None:
    with pytest.raises(ro.ConfigError) as error:
        slide(**path)
    assert message in str(error.value)


def test_poses_stop_at_their_ends() -> None:
    with pytest.raises(ro.ConfigError, match=r"path\.end_speed: not allowed with tray_poses, at whose ends the robot"):
        waiter("one_block", "path.end_speed=0.2")


def test_a_repeated_last_row_is_a_stop() -> None:
    joints = [[0.0], [0.5], [1.0], [1.0]]
    with pytest.raises(ro.PathError, match=r"found 0\.2, but the waypoint there is repeated"):
        plan_of(slide(joints=joints, repeated="stop", end_speed=0.2))


# Pauses ----------------------------------------------------------------------------------------------------


def test_a_pause_is_a_stop_that_takes_its_time() -> None:
    plan = plan_of(slide(joints=[[0.0], [0.4], [1.0]], pauses=[{"waypoint": 1, "time": 0.5}]))
    moving = bang_bang(0.4, MU * G) + bang_bang(0.6, MU * G)
    assert plan.duration == pytest.approx(moving + 0.5, rel=2e-3)
    trajectory = Trajectory.from_plan(plan)
    assert trajectory.duration == pytest.approx(plan.duration, abs=1e-12)
    arrival = bang_bang(0.4, MU * G)
    during = trajectory.sample(np.linspace(arrival + 0.02, arrival + 0.48, 20))
    np.testing.assert_allclose(during.q[:, 0], 0.4, atol=1e-12)
    np.testing.assert_array_equal(during.qd, 0.0)
    np.testing.assert_array_equal(during.qdd, 0.0)
    assert ro.certify(plan).passed


def test_a_stored_plan_keeps_its_pause(tmp_path: Any) -> None:
    from robustopt.runs.stored_plan import read_plan

    config = slide(joints=[[0.0], [0.4], [1.0]], pauses=[{"waypoint": 1, "time": 0.5}])
    plan = plan_of(config)
    plan.export(tmp_path)
    stored = read_plan(config, tmp_path / "plan.csv")
    assert stored.duration == pytest.approx(plan.duration, abs=1e-12)
    np.testing.assert_allclose(stored.x, plan.x, rtol=1e-15)


def test_a_pause_at_a_rounded_pose_stops_there() -> None:
    poses = [{"position": [0.75, y, 0.75]} for y in (-0.2, 0.0, 0.2)]
    config = ro.with_values(waiter("one_block", "solver.method=reachability"), {"path.tray_poses": poses})
    straight = plan_of(config)
    paused = plan_of(ro.with_values(config, {"path.pauses": [{"waypoint": 1, "time": 0.25}]}))
    assert straight.problem.path.breaks.tolist() == [0.0, 1.0]
    np.testing.assert_allclose(paused.problem.path.breaks, [0.0, 0.5, 1.0])
    assert paused.duration > straight.duration + 0.25


# The rest of a running plan --------------------------------------------------------------------------------


@pytest.mark.parametrize("part", [0.0, 0.3, 0.8, 0.95])
def test_without_a_change_the_rest_is_that_of_the_running_plan(part: float) -> None:
    running = plan_of(waiter("two_blocks", "solver.method=reachability", "solver.collocation_points=60"))
    new = ro.replan(running, part * running.duration)
    assert new.time >= part * running.duration
    assert new.plan.duration == pytest.approx(running.duration - new.time, rel=1e-6)
    before, after = Trajectory.from_plan(running).sample(new.time), Trajectory.from_plan(new.plan).sample(0.0)
    np.testing.assert_allclose(after.q, before.q, atol=1e-12)
    np.testing.assert_allclose(after.qd, before.qd, atol=1e-12)
    assert ro.certify(new.plan).passed


def test_less_friction_slows_the_rest_down_to_its_closed_form() -> None:
    running = plan_of(slide())
    half = 0.5 * MU
    new = ro.replan(running, 0.3, ro.with_values(slide(), {"contact.friction": half}))
    covered, speed = 0.5 * MU * G * new.time**2, MU * G * new.time
    acceleration = half * G
    fastest = np.sqrt(acceleration * (LENGTH - covered) + speed**2 / 2)
    assert new.plan.duration == pytest.approx((2 * fastest - speed) / acceleration, rel=2e-3)
    assert ro.certify(new.plan).passed


def test_too_late_for_less_friction_is_infeasible() -> None:
    running = plan_of(slide())
    new = ro.replan(running, 0.9 * running.duration, ro.with_values(slide(), {"contact.friction": 0.1}))
    assert new.plan.status is ro.Status.INFEASIBLE
    assert "no timing that starts at the given speed" in ro.diagnose(new.plan).sentence


def test_after_a_stop_the_rest_begins_when_the_pause_is_over() -> None:
    running = plan_of(slide(joints=[[0.0], [0.4], [1.0]], pauses=[{"waypoint": 1, "time": 0.5}]))
    arrival = bang_bang(0.4, MU * G)
    new = ro.replan(running, arrival + 0.1)
    assert new.time == pytest.approx(arrival + 0.5, rel=5e-3)
    assert new.plan.duration == pytest.approx(bang_bang(0.6, MU * G), rel=5e-3)


def test_the_rest_of_a_walk_is_planned_but_not_executed() -> None:
    config = ro.load_config(CONFIGS / "humanoid_step.yaml")
    running = plan_of(config, "reachability")
    new = ro.replan(running, 0.6 * running.duration, ro.with_values(config, {"solver.method": "reachability"}))
    assert new.plan.duration == pytest.approx(running.duration - new.time, rel=1e-6)
    assert ro.certify(new.plan).passed
    with pytest.raises(ro.ConfigError, match="the rest of the plan of a walking robot cannot be executed"):
        ro.execute(new.plan, trials=1)


def test_a_running_plan_beyond_a_new_velocity_limit_is_an_error() -> None:
    slower = ro.with_values(slide(), {"robot.limits": {"all": {"velocity": 0.5}}})
    with pytest.raises(ro.ConfigError, match=r"from_time: found a speed of .* there; expected at most 0\.5, because"):
        ro.replan(plan_of(slide()), 0.4, slower)


@pytest.mark.parametrize("time", [-0.1, 10.0, float("nan")])
def test_a_time_outside_of_the_running_plan_is_an_error(time: float) -> None:
    with pytest.raises(ro.ConfigError, match="from_time: found"):
        ro.replan(plan_of(slide()), time)


def test_another_path_is_an_error() -> None:
    with pytest.raises(ro.ConfigError, match="another task"):
        ro.replan(plan_of(slide()), 0.1, slide(joints=[[0.0], [0.9]]))


def test_figures_show_pauses(tmp_path: Any) -> None:
    from robustopt.plotting import write_figures
    from robustopt.plotting.cartesian import point_norms

    config = slide(points=20, joints=[[0.0], [0.4], [1.0]], pauses=[{"waypoint": 1, "time": 0.5}])
    plan = plan_of(
        ro.with_values(config, {"robot.limits": {"all": {"jerk": 50.0}, "cartesian": {"tool": {"speed": 0.5}}}})
    )
    times, speed, _ = point_norms(plan, plan.problem.robot.points[0])
    pausing = np.flatnonzero(np.diff(times) > 0.45)
    np.testing.assert_allclose(np.diff(times)[pausing], 0.5)
    np.testing.assert_array_equal(speed[[*pausing, *(pausing + 1)]], 0.0)
    assert {"joints.svg", "cartesian.svg", "contacts.svg"} <= {
        path.name for path in write_figures(plan, config, tmp_path)
    }


# Executions ------------------------------------------------------------------------------------------------


def test_a_motion_that_begins_and_ends_in_motion_is_executed() -> None:
    """The block does not move on the tray: all bodies have the velocities of the plan from the first step on."""
    config = ro.with_values(
        slide(start_speed=0.8, end_speed=0.5),
        {"execution": {"controller": {"feedforward": "computed_torque"}, "truth": {"friction": {"block": 1.02 * MU}}}},
    )
    plan = plan_of(config)
    executions = ro.execute(plan, trials=1)
    assert executions.successes == 1
    assert executions.steps == np.ceil(plan.duration / executions.timestep)
    assert executions.outcomes[0].tracking_error < 1e-4
    assert executions.outcomes[0].objects["block"].slip < 1e-5


def test_too_little_friction_fails_soon_after_a_start_in_motion() -> None:
    config = ro.with_values(slide(start_speed=0.8), {"execution": {"truth": {"friction": {"block": 0.8 * MU}}}})
    outcome = ro.execute(plan_of(config), trials=1).outcomes[0]
    sliding = np.sqrt(2 * 0.005 / (0.2 * MU * G))  # until the block has moved by failure.slip
    assert outcome.status.value == "slid"
    assert outcome.time == pytest.approx(sliding, rel=0.1)


def test_the_rest_of_a_running_plan_is_executed_with_its_suction_cup() -> None:
    config = ro.load_config(
        CONFIGS / "pick_suction.yaml", overrides=["solver.method=reachability", "solver.collocation_points=60"]
    )
    running = plan_of(config)
    new = ro.replan(running, 0.4 * running.duration)
    assert ro.execute(new.plan, trials=1).successes == 1


def test_the_rest_goes_on_with_the_lag_of_the_running_plan() -> None:
    """Without it, the acceleration would overshoot, and the block would move by 2.8 instead of 0.8 mm."""
    running = plan_of(waiter("one_block", "solver.method=reachability", "solver.collocation_points=60"))
    new = ro.replan(running, 0.2 * running.duration)
    whole, rest = (ro.execute(plan, trials=1).outcomes[0] for plan in (running, new.plan))
    assert rest.objects["block"].slip == pytest.approx(whole.objects["block"].slip, rel=0.2)
    assert rest.tracking_error == pytest.approx(whole.tracking_error, rel=0.02)
