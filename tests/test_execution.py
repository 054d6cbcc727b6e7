"""Executions: outcomes against closed forms, what a trial depends on, and what bad input is answered with."""

import os
import sys
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path

import mujoco
import numpy as np
import pytest
from scenes import BOX, FIXTURES, FLAT, G, plan_of, scene, waiter
from scipy.stats import binom

from robustopt import processes
from robustopt.confidence import clopper_pearson
from robustopt.config import DisturbanceConfig, ExecutionConfig, TruthConfig
from robustopt.config.load import with_values
from robustopt.errors import ConfigError, Infeasible, SimulationFailed
from robustopt.learning.moments import Moments
from robustopt.processes import cores
from robustopt.robot import load_robot
from robustopt.simulation import Status, Workers, execute, monte_carlo
from robustopt.simulation.controller import POSITION_VELOCITY, Gains, JointLayout, reference
from robustopt.simulation.disturbance import FORCE, WORLD, forces, generator
from robustopt.simulation.execute import Executions, prepare
from robustopt.simulation.feedback import acceleration_error, feedback_of, with_errors
from robustopt.simulation.gains import BANDWIDTH, STABILITY, _stable_part, gains_of, require_stable
from robustopt.simulation.monte_carlo import Job, is_random, run_all, run_trials, share_cores, simulate_trials
from robustopt.simulation.outcome import TrialOutcome
from robustopt.simulation.parameters import actual_parameters, nominal_parameters, varies
from robustopt.simulation.simulation import Workspace
from robustopt.simulation.trace import trace
from robustopt.simulation.world import World
from robustopt.solvers.trajectory import Trajectory

CAN = {"shape": "cylinder", "radius": 0.05, "height": 0.1, "mass": 0.3, "at": [0.0, 0.2]}
FOLLOW = {"controller": {"feedforward": "computed_torque"}}


def on_a_slide(body: dict, friction: float, **execution):
    """A task of one object on a slide, and its plan."""
    config = scene(objects={"body": body}, contact={"friction": friction}, execution=FOLLOW | execution)
    return config, plan_of(config)


@pytest.fixture(scope="module")
def slide():
    disturbance = {"force_deviation": [20.0, 20.0, 0.0], "calibration_deviation": 0.001}
    truth = {"friction": 0.5, "variation": {"friction": 0.1}}
    return on_a_slide(FLAT, 0.45, truth=truth, disturbance=disturbance, hold=[0.05, 0.1])


# Outcomes -------------------------------------------------------------------------------------------------


def test_a_plan_that_is_right_about_its_world_succeeds():
    config, plan = on_a_slide(FLAT, 0.5, truth={"friction": 0.55})
    executions = execute(plan, config, trials=1)
    (outcome,) = executions.outcomes
    assert (outcome.status, outcome.what, outcome.success) == (Status.SUCCESS, "", True)
    assert np.isnan(outcome.time)
    assert outcome.objects["body"].slip < 1e-3
    assert outcome.tracking_error < 1e-3
    assert executions.success_rate == 1.0


def test_a_block_slides_when_and_where_coulombs_law_says():
    """Planned at mu_b g, carried at mu g: the slip is (mu_b - mu) g t^2 / 2, and s = mu_b g t^2 / 2 / length."""
    config, plan = on_a_slide(FLAT, 0.5, truth={"friction": 0.4})
    (outcome,) = execute(plan, config, trials=1).outcomes
    time = np.sqrt(2 * 0.005 / (0.1 * G))
    assert (outcome.status, outcome.what) == (Status.SLID, "body")
    assert outcome.time == pytest.approx(time, rel=0.05)
    assert outcome.s == pytest.approx(0.5 * 0.5 * G * outcome.time**2, rel=0.02)
    assert outcome.objects["body"].status is Status.SLID


def test_an_object_whose_mass_sits_higher_than_believed_tips():
    tall = BOX | {"size": [0.08, 0.08, 0.16]}
    config, plan = on_a_slide(tall, 2.0, truth={"center_of_mass": {"body": [0.0, 0.0, 0.04]}})
    (outcome,) = execute(plan, config, trials=1).outcomes
    assert (outcome.status, outcome.what) == (Status.TIPPED, "body")


def test_an_object_loses_contact_where_the_tray_falls_faster_than_it():
    config = scene("lift", objects={"body": FLAT}, length=-1.0, execution=FOLLOW)
    plan = plan_of(config)
    assert execute(plan, config, trials=1, speed=0.9).success_rate == 1.0
    (outcome,) = execute(plan, config, trials=1, speed=1.2).outcomes
    assert (outcome.status, outcome.what) == (Status.LOST_CONTACT, "body")


def test_a_drive_that_stays_at_its_limit_is_reported():
    limits = {"x": {"torque": 20.0, "viscous_friction": 10.0}}
    keys = {"limits": limits, "joint_friction": False}
    config = scene(objects={"body": FLAT}, contact={"friction": 2.0}, robot_keys=keys, execution=FOLLOW)
    (outcome,) = execute(plan_of(config), config, trials=1).outcomes
    assert (outcome.status, outcome.what, outcome.torque) == (Status.TORQUE_SATURATED, "x", 1.0)
    assert outcome.objects["body"].status is Status.SUCCESS
    allowed = with_values(config, {"execution.failure.saturation": 10.0})
    assert execute(plan_of(allowed), allowed, trials=1).success_rate == 1.0


def test_a_simulation_that_diverges_is_never_a_success(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    config = scene(objects={"body": FLAT}, robot_keys={"limits": {"x": {"torque": 1e15}}})
    planned = reference(Trajectory.from_plan(plan_of(config)), 0.001, (0.1, 0.1))
    wild = Gains(np.array([1e9]), np.zeros(1), np.array([1e9]), POSITION_VELOCITY)
    (outcome,) = run_trials(Job(config, wild, planned, 0), [0], 1)
    assert outcome.status is Status.DIVERGED
    assert list(tmp_path.iterdir()) == []
    assert not outcome.success
    assert outcome.error_steps == 0
    assert outcome.objects["body"].status is Status.DIVERGED


def test_the_load_of_a_bridge_and_a_round_object_are_carried():
    for name in ("bridge", "side_by_side"):
        config = waiter(name, "uncertainty={}", "solver.collocation_points=100", "solver.method=reachability")
        (outcome,) = execute(plan_of(config), config, trials=1, speed=0.8).outcomes
        assert outcome.success, (name, outcome)
        assert set(outcome.objects) == set(config.objects)


def test_a_wrong_belief_fails_and_a_careful_one_succeeds():
    """Two blocks, truly mu = 0.5: planned at 1 they fall over, at 0.25 they stay."""
    for believed, rate in ((1.0, 0.0), (0.25, 1.0)):
        disturbance = "execution.disturbance.force_deviation=[2, 2, 0]"
        config = waiter("two_blocks", f"contact.friction={believed}", "execution.truth.friction=0.5", disturbance)
        assert execute(plan_of(config, "reachability"), config, trials=3).success_rate == rate


def test_the_last_bits_of_a_plan_decide_no_trial(monkeypatch):
    config = waiter("two_blocks", "contact.friction=0.3232", "uncertainty={}", "execution.truth.friction=0.35")
    plan = plan_of(config)
    place = World.start
    random = np.random.default_rng(0)

    def moved(self, layout, q, size):
        return place(self, layout, q, size) + 1e-14 * random.uniform(-1, 1, size)

    before = execute(plan, config, trials=4)
    monkeypatch.setattr(World, "start", moved)
    after = execute(replace(plan, x=plan.x * (1 + 1e-12)), config, trials=4)
    for one, other in zip(before.outcomes, after.outcomes, strict=True):
        assert one.status is other.status
        for name, moved_by in one.objects.items():
            assert other.objects[name].slip == pytest.approx(moved_by.slip, rel=1e-5)
            assert other.objects[name].tilt == pytest.approx(moved_by.tilt, rel=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["one_block", "two_blocks"])
def test_success_is_monotone_in_speed(name):
    disturbance = "execution.disturbance.force_deviation=[2, 2, 0]"
    config = waiter(name, "uncertainty={}", "contact.friction=0.4", "execution.truth.friction=0.5", disturbance)
    plan = plan_of(config, "reachability")
    rates = [execute(plan, config, trials=10, speed=speed).success_rate for speed in np.linspace(0.7, 1.3, 10)]
    assert rates == sorted(rates, reverse=True)
    assert (rates[0], rates[-1]) == (1.0, 0.0)


SETTINGS = {
    "masses from shapes": '<compiler angle="radian" inertiafromgeom="true"/>',
    "lower bounds of masses": '<compiler angle="radian" boundmass="1.5" boundinertia="0.01"/>',
    "frames in centres of mass": '<compiler angle="radian" alignfree="true"/>',
    "water": '<option density="1000" viscosity="0.1" wind="1 0 0"/>',
    "geoms": '<default><geom margin="0.02" pos="0.1 0 0" type="capsule" condim="6" friction="2 1 1"/></default>',
    "pairs": '<default><pair margin="0.02" solreffriction="0.5 1"/></default>',
    "motors": '<default><motor ctrlrange="-1 1" gear="50"/></default>',
    "servos": '<default><position kp="300" forcerange="-1 1" ctrlrange="-0.1 0.1"/></default>',
    "actuators": '<default><general dyntype="integrator" actrange="-1 1" actearly="true"/></default>',
}
"""What a robot's file may say of all that it has, and would say of tray, objects and drives as well."""


def like_the_slide(folder: Path, setting: str) -> Path:
    """The slide of the fixtures with a setting, the tool in a body of a default class of its own."""
    text = (FIXTURES / "slide.xml").read_text(encoding="utf-8")
    text = text.replace("<worldbody>", setting + "<worldbody>").replace(
        '<site name="tool"/>', '<site name="tool" pos="0 0 0"/>'
    )
    inertial = '<geom type="box" pos="0 0 0" size="0.1 0.1 0.1" mass="2"/>'
    file = folder / "slide.xml"
    file.write_text(
        text.replace('<inertial pos="0 0 0" mass="2" diaginertia="0.1 0.1 0.1"/>', inertial), encoding="utf-8"
    )
    return file


@pytest.mark.parametrize("setting", SETTINGS)
def test_settings_of_a_robots_file_do_not_reach_what_it_carries(setting, tmp_path):
    bodies = {"box": FLAT | {"center_of_mass": [0.03, 0.02, 0.0]}, "can": CAN}
    outcomes = []
    for text in ("", SETTINGS[setting]):
        inside = [["carriage", name] for name in ("tray", *bodies)]  # the geometry of the carriage is where these are
        robot = {"model": str(like_the_slide(tmp_path, text)), "collision": {"check": True, "exclude": inside}}
        truth = {"friction": 0.55}
        config = scene(objects=bodies, robot_keys=robot, contact={"friction": 0.5}, execution=FOLLOW | {"truth": truth})
        outcomes += execute(plan_of(config), config, trials=1).outcomes
    plain, other = outcomes
    assert plain.success
    assert other.torque == pytest.approx(plain.torque, rel=1e-6)
    for name, body in plain.objects.items():
        assert other.objects[name].slip == pytest.approx(body.slip, abs=1e-6)


@pytest.mark.parametrize("unit", ["degree", "radian"])
def test_the_world_has_the_joint_limits_of_the_plan(unit, tmp_path):
    """The file's limits are softened by a margin, and the configuration's are wider."""
    text = (FIXTURES / "turntable.xml").read_text(encoding="utf-8").replace('angle="radian"', f'angle="{unit}"')
    span = np.degrees([-0.5, 0.5]) if unit == "degree" else [-0.5, 0.5]
    joint = f'axis="0 0 1" range="{span[0]} {span[1]}" margin="0.2"'
    (tmp_path / "table.xml").write_text(text.replace('axis="0 0 1"', joint), encoding="utf-8")
    for limit, length in (None, 0.45), ([-1.0, 1.0], 0.95):
        limits = {"limits": {"turn": {"position": limit}}} if limit else {}
        robot = {"model": str(tmp_path / "table.xml")} | limits
        config = scene(objects={"box": FLAT}, robot_keys=robot, length=length, execution=FOLLOW)
        (outcome,) = execute(plan_of(config), config, trials=1).outcomes
        assert outcome.tracking_error < 1e-3
        model = World(config, Gains(*np.ones((3, 1)), POSITION_VELOCITY), 0.001).rigid()
        assert model.jnt_range[0] == pytest.approx(limit or [-0.5, 0.5])


@pytest.mark.parametrize(("outer", "inner", "span"), [("radian", "degree", 28.65), ("degree", "radian", 0.5)])
def test_a_part_of_a_file_may_have_its_own_unit_of_angle(outer, inner, span, tmp_path):
    text = (FIXTURES / "turntable.xml").read_text(encoding="utf-8").replace('angle="radian"', f'angle="{inner}"')
    text = text.replace('axis="0 0 1"', f'axis="0 0 1" range="-{span} {span}"')
    (tmp_path / "part.xml").write_text(text, encoding="utf-8")
    (tmp_path / "whole.xml").write_text(
        f'<mujoco><compiler angle="{outer}"/><asset><model name="part" file="part.xml"/></asset>'
        '<worldbody><frame><attach model="part" prefix="the_"/></frame></worldbody></mujoco>'
    )
    limits = {"the_turn": {"velocity": 5.0, "acceleration": 20.0, "torque": 100.0}}
    robot = {"model": str(tmp_path / "whole.xml"), "tool": "the_tool", "limits": limits}
    config = scene(objects={"box": FLAT}, robot_keys=robot, length=0.3)
    model = World(config, Gains(*np.ones((3, 1)), POSITION_VELOCITY), 0.001).rigid()
    assert model.jnt_range[0] == pytest.approx([-0.5, 0.5], rel=1e-3)


# What a trial depends on ----------------------------------------------------------------------------------


def test_the_planner_never_reads_the_truth():
    truths = ({}, {"friction": 0.1, "mass": {"body": 3.0}, "center_of_mass": {"body": [0.01, 0.0, 0.02]}})
    first, second = (on_a_slide(BOX, 0.5, truth=truth)[1] for truth in truths)
    assert np.array_equal(first.x, second.x)
    assert first.duration == second.duration


def test_trial_k_of_many_equals_trial_k_alone(slide):
    config, plan = slide
    many = execute(plan, config, trials=60)
    assert 0.0 < many.success_rate < 1.0
    for k in (0, 24, 25, 59):
        (alone,) = execute(plan, config, numbers=[k]).outcomes
        assert _same(alone, many.outcomes[k])


@pytest.mark.parametrize(
    "random",
    [
        {"truth": {"variation": {"friction": 0.1}}},
        {"truth": {"variation": {"center_of_mass": {"tray": [0.0, 0.0, 0.01]}}}},
        {"disturbance": {"force_deviation": [0.0, 5.0, 0.0]}},
        {"disturbance": {"calibration_deviation": [0.001]}},
    ],
)
def test_whatever_is_drawn_at_random_makes_trials_differ(random):
    assert is_random(ExecutionConfig(**random))
    assert not is_random(ExecutionConfig(truth={"friction": 0.3}, disturbance={"hold": 0.1}))


def test_where_nothing_is_random_one_simulation_stands_for_all_trials():
    config, plan = on_a_slide(FLAT, 0.45, hold=[0.05, 0.1])
    many = execute(plan, config, trials=31)
    assert many.alike
    assert [outcome.trial for outcome in many.outcomes] == list(range(31))
    one_by_one = run_trials(_job((config, plan)), range(31), 2)
    assert all(map(_same, many.outcomes, one_by_one))


def test_the_number_of_workers_changes_no_number(slide, monkeypatch):
    monkeypatch.setattr(monte_carlo, "cores", lambda: 2)
    config, plan = slide
    one, two = (execute(plan, config, trials=55, workers=workers) for workers in (1, 2))
    assert len(one.outcomes) == len(two.outcomes) == 55
    assert all(map(_same, one.outcomes, two.outcomes))
    assert one.feedback == two.feedback
    other = execute(plan, config, trials=55, seed=1)
    assert not any(map(_same, one.outcomes, other.outcomes))


def _same(one, other) -> bool:
    """Equal in every number, bit for bit, with nan equal to nan."""
    return repr(asdict(one)) == repr(asdict(other))


def sampled(truth: TruthConfig, friction: float, seed: int, trials: int):
    """Nominal parameters of a task with one object, and those of its trials."""
    config = scene(objects={"body": FLAT}, contact={"friction": friction}, execution={"truth": truth.model_dump()})
    nominal = nominal_parameters(config, load_robot(config))
    return nominal, [actual_parameters(nominal, config, generator(seed, k, WORLD)) for k in range(trials)]


def test_a_world_that_varies_is_sampled_about_its_value():
    truth = TruthConfig.model_validate(
        {"mass": {"body": 2.0}, "variation": {"friction": 0.05, "mass": {"body": 0.1}, "distribution": "uniform"}}
    )
    nominal, worlds = sampled(truth, 0.3, 7, 400)
    friction = np.array([world.friction["body"] for world in worlds])
    mass = np.array([world.bodies["body"].mass for world in worlds])
    assert 0.25 <= friction.min() < 0.26
    assert 0.34 < friction.max() <= 0.35
    assert mass.mean() == pytest.approx(2.0, abs=0.01)
    body = nominal.bodies["body"]
    assert worlds[0].bodies["body"].inertia == pytest.approx(body.inertia * mass[0] / body.mass)
    assert varies(truth)
    assert not varies(TruthConfig(friction=0.2))


def test_a_friction_is_never_sampled_at_or_below_zero():
    _, worlds = sampled(TruthConfig.model_validate({"variation": {"friction": 1.0}}), 0.05, 0, 200)
    assert min(world.friction["body"] for world in worlds) > 0


def test_a_trace_is_the_trial_over_time(slide):
    config, plan = slide
    many = execute(plan, config, trials=30)
    for outcome in (next(o for o in many.outcomes if o.success), next(o for o in many.outcomes if not o.success)):
        seen = trace(plan, outcome.trial, config)
        assert _same(seen.outcome, outcome)
        assert np.abs(seen.tracking_error).max() == outcome.tracking_error
        assert seen.objects["body"].slip.max() == outcome.objects["body"].slip
        error = (seen.executed - seen.planned)[seen.moving & ~(seen.t >= outcome.time)]
        assert len(error) == outcome.error_steps
        if outcome.success:
            assert error.mean(axis=0) == pytest.approx(outcome.error_mean)
        else:
            assert seen.t[np.argmax(seen.objects["body"].slip > 0.005)] == outcome.time


# Disturbance and feedback ---------------------------------------------------------------------------------


@pytest.mark.parametrize("hold", [0.001, 0.004, 0.0025])
def test_the_impulse_of_the_force_does_not_depend_on_the_time_step(hold):
    disturbance = DisturbanceConfig(force_deviation=(2.0, 3.0, 0.0), hold=hold)
    coarse, fine = (forces(disturbance, h, round(1.0 / h), generator(3, 5, FORCE)) for h in (0.002, 0.0005))
    impulse = np.cumsum(fine, axis=0)[3::4] * 0.0005
    assert np.cumsum(coarse, axis=0) * 0.002 == pytest.approx(impulse, abs=1e-12)
    held = forces(disturbance, hold, 4000, generator(0, 0, FORCE))
    assert held.std(axis=0) == pytest.approx([2.0, 3.0, 0.0], rel=0.05)
    assert held.mean(axis=0) == pytest.approx([0.0, 0.0, 0.0], abs=0.15)


def test_calibration_offsets_move_the_arm_and_stay_for_the_trial():
    config, plan = on_a_slide(FLAT, 0.2, disturbance={"calibration_deviation": 0.01})
    planned = reference(Trajectory.from_plan(plan), 0.001, (0.1, 0.1))
    gains = gains_of(config, plan.problem.robot, planned.q[:1])
    prepared, record = simulate_trials(Job(config, gains, planned, 0), range(40), 2, Workspace())
    assert prepared.offsets.std() == pytest.approx(0.01, rel=0.3)
    reached = record.qpos[:, -1, prepared.layout.joints]
    assert reached == pytest.approx(planned.q[-1] + prepared.offsets, abs=1e-4)


def test_the_acceleration_error_is_what_the_velocity_shows():
    _, plan = on_a_slide(FLAT, 0.5)
    planned = reference(Trajectory.from_plan(plan), 0.001, (0.1, 0.1))
    velocity = np.vstack([np.zeros(1), np.cumsum(planned.qdd + 0.3, axis=0) * 0.001])
    filtered, raw = acceleration_error(velocity, planned.qdd, 0.001)
    assert raw == pytest.approx(np.full_like(raw, 0.3))
    assert filtered == pytest.approx(np.full_like(raw, 0.3))
    t = planned.t[:, None] + 0.1
    for frequency, factor in ((5.0, 1.0), (50.0, 0.5), (400.0, 0.0)):
        wave = 0.2 * np.sin(2 * np.pi * frequency * t)
        swung = np.vstack([np.zeros(1), np.cumsum(planned.qdd + wave, axis=0) * 0.001])
        inner = slice(200, -200)
        assert acceleration_error(swung, planned.qdd, 0.001)[0][inner].std() == pytest.approx(
            factor * wave.std(), abs=5e-3
        )


def _outcome(status: Status, time: float) -> TrialOutcome:
    what = "" if status is Status.SUCCESS else "body"
    return TrialOutcome(0, status, what, time, 0.5, "", {}, 0.0, 0.0, {}, {})


def test_errors_count_while_the_robot_moves_up_to_the_first_failure():
    """The error is 1 to 0.3 s and a thousand after it, as if the object had hit the arm; standing still it is 5."""
    _, plan = on_a_slide(FLAT, 0.5)
    planned = reference(Trajectory.from_plan(plan), 0.001, (0.1, 0.1))
    error = np.where(planned.moving, np.where(planned.t < 0.3, 1.0, 1000.0), 5.0)[:, None]
    velocity = np.vstack([np.zeros(1), np.cumsum(planned.qdd + error, axis=0) * 0.001])
    at = float(planned.t[np.flatnonzero(planned.t >= 0.3)[0]])
    failed = with_errors(_outcome(Status.SLID, at), velocity, planned, 0.001)
    assert failed.error_steps == 300
    assert (failed.error_unfiltered_mean, failed.error_unfiltered_square) == (
        pytest.approx([1.0]),
        pytest.approx([1.0]),
    )
    assert failed.error_mean == pytest.approx([1.0], abs=0.05)
    passed = with_errors(_outcome(Status.SUCCESS, np.nan), velocity, planned, 0.001)
    assert passed.error_steps == planned.moving.sum() > 300
    early = with_errors(_outcome(Status.TIPPED, -0.05), velocity, planned, 0.001)
    assert (early.error_steps, early.error_mean) == (0, ())
    assert with_errors(_outcome(Status.DIVERGED, np.nan), velocity, planned, 0.001).error_steps == 0
    late = with_errors(_outcome(Status.FELL, plan.duration + 0.05), velocity, planned, 0.001)
    assert late.error_steps == passed.error_steps


def test_the_low_pass_holds_up_to_where_a_trial_is_cut_off():
    noise = np.random.default_rng(0).standard_normal((4000, 300, 1))
    ends = np.array(
        [acceleration_error(np.cumsum(e, axis=0) * 0.001, np.zeros((299, 1)), 0.001)[0][[149, -1]] for e in noise]
    )
    middle, end = ends.std(axis=0)
    assert end[0] < 1.6 * middle[0] < 0.6


def test_feedback_weighs_every_sample_the_same():
    short = replace(
        _outcome(Status.SLID, 0.1), error_steps=100, error_mean=(3.0,), error_square=(9.0,),
        error_unfiltered_mean=(3.0,), error_unfiltered_square=(9.0,),
    )  # fmt: skip
    long = replace(
        _outcome(Status.SUCCESS, np.nan), error_steps=300, error_mean=(-1.0,), error_square=(2.0,),
        error_unfiltered_mean=(-1.0,), error_unfiltered_square=(5.0,),
    )  # fmt: skip
    feedback = feedback_of([short, _outcome(Status.DIVERGED, np.nan), long])
    assert feedback is not None
    assert (feedback.trials, feedback.samples, feedback.mean) == (2, 400, (0.0,))
    assert (feedback.deviation[0] ** 2, feedback.unfiltered_deviation[0] ** 2) == (
        pytest.approx(3.75),
        pytest.approx(6),
    )
    assert feedback_of([_outcome(Status.DIVERGED, np.nan)]) is None


def test_the_moments_of_trials_give_the_feedback_of_all(slide):
    config, plan = slide
    executions = execute(plan, config, trials=30)
    trials = [Moments.of_means(o.error_steps, o.error_mean, o.error_square) for o in executions.outcomes]
    together = sum(trials, Moments())
    whole = max(o.error_steps for o in executions.outcomes)
    assert all((o.error_steps == whole) == o.success for o in executions.outcomes)
    assert together.count == executions.feedback.samples
    assert together.mean == pytest.approx(executions.feedback.mean)
    assert together.deviation == pytest.approx(executions.feedback.deviation)


def test_feedback_shrinks_with_the_torque_fed_forward():
    deviations = []
    for feedforward in ("gravity", "computed_torque"):
        config = waiter("one_block", "uncertainty={}", f"execution.controller.feedforward={feedforward}")
        executions = execute(plan_of(config, "reachability"), config, trials=2, speed=0.8)
        assert executions.feedback is not None
        assert executions.feedback.trials == 2
        assert np.all(np.array(executions.feedback.unfiltered_deviation) >= executions.feedback.deviation)
        deviations.append(np.array(executions.feedback.deviation))
    assert np.all(deviations[1][:3] < 0.3 * deviations[0][:3])


# Statistics -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("successes", "trials"), [(0, 10), (10, 10), (7, 20), (97, 100)])
def test_the_interval_of_clopper_and_pearson_is_that_of_the_binomial_tails(successes, trials):
    low, high = clopper_pearson(successes, trials, 0.9)
    if successes > 0:
        assert binom.sf(successes - 1, trials, low) == pytest.approx(0.05)
    if successes < trials:
        assert binom.cdf(successes, trials, high) == pytest.approx(0.05)
    assert 0 <= low <= successes / trials <= high <= 1
    assert (low == 0, high == 1) == (successes == 0, successes == trials)


def test_no_trial_says_nothing():
    none = Executions((), 5, 0, 1.0, 1.0, 0.001, 100, 0.95, None)
    assert (none.complete, none.interval, none.counts) == (False, (0.0, 1.0), {})
    assert np.isnan(none.success_rate)


def test_workers_times_threads_never_exceed_the_cores(monkeypatch):
    assert cores() >= 1
    monkeypatch.setattr(monte_carlo, "cores", lambda: 6)
    assert [share_cores(workers) for workers in (1, 2, 4, 6, 50)] == [(1, 6), (2, 3), (4, 1), (6, 1), (6, 1)]


# What goes wrong ------------------------------------------------------------------------------------------


def test_an_interruption_keeps_the_chunks_that_were_done(slide):
    config, plan = slide

    def interrupt(done: int, total: int, successes: int) -> None:
        assert (done, total) == (25, 60)
        assert 0 <= successes <= done
        raise KeyboardInterrupt

    executions = execute(plan, config, trials=60, progress=interrupt)
    assert (len(executions.outcomes), executions.requested, executions.complete) == (25, 60, False)
    assert executions.interrupted
    assert all(map(_same, executions.outcomes, execute(plan, config, trials=25).outcomes))


@pytest.mark.parametrize("workers", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_an_interruption_after_the_last_chunk_still_counts(slide, workers):
    config, plan = slide

    def interrupt(done: int, total: int, _successes: int) -> None:
        if done == total:
            raise KeyboardInterrupt

    executions = execute(plan, config, trials=30, workers=workers, progress=interrupt)
    assert executions.complete
    assert executions.interrupted
    assert not execute(plan, config, trials=30).interrupted


def _dies_once(flag, job, trials, threads):
    if trials[0] == 25 and not os.path.exists(flag):
        open(flag, "w").close()
        os._exit(1)
    return run_trials(job, trials, threads)


def _always_dies(job, trials, threads):
    os._exit(1)


def _job(slide) -> Job:
    config, plan = slide
    return prepare(plan, config)


def test_a_worker_that_dies_loses_no_trial_and_changes_no_number(slide, tmp_path, monkeypatch):
    monkeypatch.setattr(monte_carlo, "cores", lambda: 2)
    expected, _ = run_all(_job(slide), range(55), Workers(1), None)
    monkeypatch.setattr(monte_carlo, "run_trials", partial(_dies_once, str(tmp_path / "died")))
    outcomes, complete = run_all(_job(slide), range(55), Workers(2), None)
    assert (tmp_path / "died").exists()
    assert complete
    assert len(outcomes) == 55
    assert all(map(_same, outcomes, expected))


@pytest.mark.slow
def test_workers_that_die_again_and_again_are_an_error(slide, monkeypatch):
    monkeypatch.setattr(monte_carlo, "cores", lambda: 2)
    monkeypatch.setattr(monte_carlo, "run_trials", _always_dies)
    monkeypatch.setattr(processes, "RETRIES", 1)
    with pytest.raises(SimulationFailed, match="Worker processes died 2 times"):
        run_all(_job(slide), range(30), Workers(2), None)


def test_a_time_step_that_is_too_long_for_the_controller_is_refused():
    config = waiter("two_blocks", "contact.friction=0.25", "execution.timestep=0.005")
    with pytest.raises(ConfigError, match=r"0\.005 s, but the controller of joint6 is unstable with this time step"):
        execute(plan_of(config, "reachability"), config, trials=1)


def test_default_gains_are_stable_for_joints_whose_axes_fall_together():
    """Two hinges about one axis, between them next to nothing: they have 0.001 kg m^2 against each other, not 1."""
    a, e, h = 1.0, 1e-3, 1e-3
    matrices = np.array([[[a + e, a], [a, a]]])
    stiffness = (h * BANDWIDTH) ** 2 / 4 + h * BANDWIDTH

    def share(inertia):
        return np.linalg.eigvals(np.linalg.solve(matrices[0], stiffness * np.diag(inertia))).real.max()

    largest = np.array([a + e, a])
    assert share(largest) > 50
    assert share(_stable_part(largest, matrices, h)) == pytest.approx(STABILITY, rel=1e-6)
    apart = np.array([[[2.0, 0.1], [0.1, 1.0]]])
    assert _stable_part(np.array([2.5, 1.5]), apart, h).tolist() == [2.5, 1.5]
    assert _stable_part(largest, matrices, 0.02).tolist() == largest.tolist(), "too long a time step is not mended"


def test_default_gains_count_how_what_is_carried_turns():
    """A light turntable under a load that is not above its axis: I = 0.1 of the table, tray and block by hand."""
    block = {"shape": "box", "size": [0.2, 0.1, 0.3], "mass": 1.5, "at": [0.1, -0.05], "yaw": 0.3}
    config = scene("gantry", {"block": block}, joints=[[0, 0, 0, 0], [0, 0, 0, 1]], execution={})
    inertia = 0.1 + (0.6**2 + 0.6**2) / 12 + 1.5 * ((0.2**2 + 0.1**2) / 12 + 0.1**2 + 0.05**2)
    plan = plan_of(config)
    gains = gains_of(config, plan.problem.robot, np.zeros((1, 4)))
    assert gains.kp == pytest.approx(np.array([12.5, 8.5, 5.5, inertia]) * BANDWIDTH**2)
    doubts = {"mass": {"block": [0.5, 1.6]}, "center_of_mass": {"block": [0.02, 0.02, 0.1]}}
    uncertain = scene("gantry", {"block": block}, joints=config.path.joints, execution={}, uncertainty=doubts)
    assert gains_of(uncertain, plan.problem.robot, np.zeros((1, 4))).kp.tolist() == gains.kp.tolist()


def test_a_load_much_heavier_than_the_robot_is_carried_with_default_gains():
    load = {"shape": "box", "size": [0.4, 0.4, 0.05], "mass": 100.0, "on": "tray"}
    world = {"truth": {"friction": 0.42}}
    config = scene(objects={"load": load}, contact={"friction": 0.4}, execution=FOLLOW | world)
    executions = execute(plan_of(config), config, trials=1)
    assert executions.success_rate == 1.0
    assert executions.outcomes[0].tracking_error < 1e-3


def test_an_arm_like_a_shoulder_elbow_and_wrist_is_driven_with_default_gains():
    straight = [[0.0, 0.3, 0.0, 0.05, 0.0, -0.35, 0.0], [0.4, 0.2, 0.0, 0.05, 0.0, -0.25, 0.0]]
    level, friction = {"pose": {"rpy": [-np.pi / 2, 0.0, 0.0]}}, {"friction": 0.5}
    config = scene("seven_joints", {"body": FLAT}, joints=straight, tray=level, contact=friction, execution=FOLLOW)
    plan = plan_of(config)
    assert execute(plan, config, trials=1).success_rate == 1.0


def on_a_rail(integrator: str, timestep: float, kp: float, ki: float, kd: float) -> tuple:
    """One joint of 10 kg with a damping of 2 N s/m, its controller as MuJoCo's actuator, and the arguments of
    `require_stable`."""
    model = mujoco.MjModel.from_xml_string(
        f"""<mujoco><option timestep='{timestep}' integrator='{integrator}' gravity='0 0 0'/><worldbody><body>
        <joint name='rail' type='slide' axis='1 0 0' damping='2'/><geom size='0.1' mass='10'/></body></worldbody>
        <actuator><pid joint='rail' input='pos vel' kp='{kp}' ki='{ki}' kv='{kd}'/></actuator></mujoco>"""
    )
    gains = Gains(np.array([kp]), np.array([ki]), np.array([kd]), POSITION_VELOCITY)
    return model, JointLayout(np.array([0]), np.array([0]), np.array([0])), gains, ("rail",), np.zeros((2, 1))


def grows(model: mujoco.MjModel) -> bool:
    """Whether a small error is larger at the end than at first."""
    data = mujoco.MjData(model)
    data.qpos[0] = 1e-3
    reached = []
    for _ in range(4000):
        mujoco.mj_step(model, data)
        reached.append(abs(data.qpos[0]) + abs(data.qvel[0]))
        if reached[-1] > 1e3:
            return True
    return max(reached[-400:]) > max(reached[:400])


@pytest.mark.parametrize("integrator", ["Euler", "implicitfast"])
@pytest.mark.parametrize(
    ("kp", "ki", "kd", "timestep"),
    [
        (100.0, 0.0, 20.0, 0.01),
        (100.0, 190.0, 20.0, 0.01),
        (100.0, 260.0, 20.0, 0.01),
        (1e5, 0.0, 400.0, 0.01),
        (1e5, 0.0, 2300.0, 0.01),
        (1e6, 0.0, 100.0, 0.01),
        (1e5, 2e6, 400.0, 0.005),
        (1e5, 6e6, 400.0, 0.005),
    ],
)
def test_what_is_refused_as_unstable_is_what_grows_in_mujoco(integrator, kp, ki, kd, timestep):
    """With kd implicit the rule for the time step is stricter than the loop needs; that for integral gains is not."""
    strict = integrator == "implicitfast" and timestep**2 * kp + 2 * timestep * (kd - 2) >= 40
    arguments = on_a_rail(integrator, timestep, kp, ki, kd)
    if grows(arguments[0]) or strict:
        with pytest.raises(ConfigError, match=r"(ki|timestep): found"):
            require_stable(*arguments)
    else:
        require_stable(*arguments)


def test_the_joint_whose_integral_gain_is_too_large_is_named():
    """Both joints move the lighter one, but only the first has an integral gain."""
    model = mujoco.MjModel.from_xml_string(
        """<mujoco><option timestep='0.001'/><worldbody>
        <body><joint type='slide' axis='1 0 0'/><geom size='0.1' mass='1'/>
        <body><joint type='slide' axis='1 0 0'/><geom size='0.1' mass='0.2'/></body></body></worldbody></mujoco>"""
    )
    gains = Gains(np.array([100.0, 100.0]), np.array([5000.0, 0.0]), np.array([20.0, 5.0]), POSITION_VELOCITY)
    layout = JointLayout(np.array([0, 1]), np.array([0, 1]), np.array([0, 2]))
    with pytest.raises(ConfigError, match="ki: found 5000, but the controller of first is unstable"):
        require_stable(model, layout, gains, ("first", "second"), np.zeros((1, 2)))


def test_a_plan_with_a_number_that_is_not_finite_is_refused(slide):
    config, plan = slide
    x = plan.x.copy()
    x[7] = np.nan
    with pytest.raises(SimulationFailed, match="not a finite number at grid point 7"):
        execute(replace(plan, x=x), config, trials=1)


def test_a_plan_of_another_task_is_refused(slide):
    config, plan = slide
    other = scene("lift", objects={"body": FLAT})
    with pytest.raises(ConfigError, match="the plan is of another task, test: robot differs; expected a plan"):
        execute(plan, other, trials=1)
    moved = with_values(config, {"objects.body.at": [0.01, 0.0], "path.joints": [[0.0], [0.5]]})
    with pytest.raises(ConfigError, match="path, objects differ"):
        execute(plan, moved, trials=1)
    believed = with_values(config, {"contact.friction": 0.1, "execution.truth.friction": 0.6})
    assert len(execute(plan, believed, trials=1).outcomes) == 1


def test_a_task_without_a_plan_is_refused():
    config = scene(objects={"body": FLAT}, contact={"friction": 0.1}, gravity=[0.0, 5.0, -9.81])
    with pytest.raises(Infeasible):
        execute(plan_of(config), config, trials=1)


@pytest.mark.parametrize(
    ("execution", "message"),
    [
        ({"controller": {"kp": [1.0, 2.0]}}, "found 2 values; expected one, or one for each of the joints x"),
        ({"disturbance": {"calibration_deviation": [0.1, 0.2]}}, "found 2 values; expected one, or one for each"),
        ({"truth": {"contact_inset": {"body": 0.2}}}, "MuJoCo refuses the actual world: .*size"),
        (
            {"truth": {"inertia": {"body": [1.0, 1.0, 5.0]}}},
            "MuJoCo refuses the actual world: .*inertia",
        ),
        ({"timestep": 0.2}, "expected less than a tenth of the motion"),
    ],
)
def test_keys_that_do_not_fit_the_robot_are_refused(execution, message):
    config, plan = on_a_slide(FLAT, 0.5, **execution)
    with pytest.raises(ConfigError, match=message):
        execute(plan, config, trials=1)


def test_a_motion_of_too_many_time_steps_is_refused(monkeypatch):
    monkeypatch.setattr(sys.modules["robustopt.simulation.execute"], "MOST_STEPS", 1000)
    config, plan = on_a_slide(FLAT, 0.5)
    with pytest.raises(ConfigError, match=r"found 0.001 s, so a trial of .* s has 1,\d+ of them; .* 1,000") as error:
        execute(plan, config, trials=1)
    assert error.value.problems[0].key == "execution.timestep"


def test_gains_come_from_the_configuration_the_model_or_the_inertia():
    arm = waiter("one_block", "execution.controller.kp=[1, 2, 3, 4, 5, 6]")
    robot = plan_of(arm, "reachability").problem.robot
    gains = gains_of(arm, robot, np.zeros((1, 6)))
    assert gains.kp.tolist() == [1, 2, 3, 4, 5, 6]
    assert gains.kd.tolist() == [1000, 2000, 500, 40, 10, 2]
    config, plan = on_a_slide(FLAT, 0.5)
    mass = 2.0 + 1.0 + 0.5
    derived = gains_of(config, plan.problem.robot, np.zeros((1, 1)))
    assert (derived.kp[0], derived.kd[0], derived.ki[0]) == pytest.approx((mass * 2500, mass * 100, 0))
    assert ExecutionConfig().controller.kp is None
