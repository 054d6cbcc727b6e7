"""Executions of a robot on its feet: standing, the planned forces, how it fails, and what a trial depends on."""

from __future__ import annotations

import csv
import re
from dataclasses import asdict, replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from robustopt.cli import run
from robustopt.config import Config
from robustopt.config.load import load_config, with_values
from robustopt.errors import ConfigError
from robustopt.learning.learner import Belief
from robustopt.learning.moments import ErrorInterval
from robustopt.path.footsteps import footsteps
from robustopt.robot import Robot, load_robot
from robustopt.robot.model_file import MODELS
from robustopt.runs.beliefs import believing
from robustopt.runs.campaign import learn
from robustopt.simulation import Status, execute, monte_carlo
from robustopt.simulation.controller import Gains, Reference
from robustopt.simulation.execute import faster, prepare
from robustopt.simulation.gains import gains_of
from robustopt.simulation.interfaces import LANDING, Grounded, MeasuredContact, stands, turning
from robustopt.simulation.monte_carlo import Job, run_trials, simulate_trials
from robustopt.simulation.outcome import TrialOutcome
from robustopt.simulation.parameters import BodyParameters, Parameters
from robustopt.simulation.pictures import view_of
from robustopt.simulation.simulation import Workspace
from robustopt.simulation.trace import trace
from robustopt.simulation.video import HEIGHT, WIDTH
from robustopt.simulation.world import World
from robustopt.solvers import Plan, build_problem, solve
from robustopt.solvers.contact_forces import planned_forces
from robustopt.solvers.trajectory import Trajectory

CONFIG = Path(__file__).parent.parent / "configs" / "humanoid_step.yaml"
N = 33
N = 33
N = 33
MASS = 42.2
WEIGHT = MASS * 9.81
QUIET = "execution={truth: {friction: 0.3}}"
LENIENT = "execution.failure={foot_slip: 100, saturation: 100}"


def configured(*overrides: str) -> Config:
    return load_config(CONFIG, ["solver.collocation_points=80", QUIET, *overrides])


def plan_of(config: Config) -> Plan:
    return solve(build_problem(config))


@pytest.fixture(scope="module")
def plan() -> Plan:
    return plan_of(configured())


def outcome_of(plan: Plan, *overrides: str, speed: float = 1.0) -> TrialOutcome:
    (outcome,) = execute(plan, configured(*overrides), trials=1, speed=speed).outcomes
    return outcome


# Standing and stepping ------------------------------------------------------------------------------------


def standing(
    plan: Plan, config: Config, gravity: tuple[float, ...] = (0.0, 0.0, -9.81), seconds: float = 1.0
) -> tuple[TrialOutcome, dict[str, MeasuredContact]]:
    """A robot that stands where the plan starts, with the torque that this takes on a level floor."""
    job = prepare(plan, config)
    job = replace(job, config=job.config.model_copy(update={"gravity": gravity}))
    steps = round(seconds / job.execution.timestep)
    first = {name: np.repeat(getattr(job.planned, name)[:1], steps, axis=0) for name in ("q", "torque")}
    still, s = np.zeros_like(first["q"]), np.zeros(steps)
    planned = Reference(
        np.arange(steps) * 0.001, s, first["q"], still, still, np.ones(steps, dtype=bool), first["torque"]
    )
    job = replace(job, planned=planned)
    prepared, record = simulate_trials(job, [0], 1, Workspace())
    (outcome,) = run_trials(job, [0], 1)
    ground = [item for item in prepared.layout.interfaces if isinstance(item, Grounded)]
    return outcome, {item.name: item.measured(record, 0, 0.001) for item in ground}


def test_a_robot_that_stands_still_stays(plan):
    outcome, feet = standing(plan, configured())
    assert outcome.success
    assert max(outcome.objects[name].slip for name in ("left_foot", "right_foot")) < 1e-5
    assert outcome.objects["pelvis"].tilt < 1e-4
    assert abs(outcome.objects["pelvis"].drop) < 1e-3
    assert outcome.tracking_error < 1e-4
    for contact in feet.values():
        assert contact.force[:, 2] == pytest.approx(0.5 * WEIGHT, rel=0.01)


@pytest.mark.parametrize("mu", [0.1, 0.2])
def test_standing_feet_slip_where_coulombs_law_says(plan, mu):
    """On a floor that is tilted sideways."""
    config = configured(f"execution.truth.friction={mu}")
    for share, slips in ((0.95, False), (1.02, True)):
        angle = np.arctan(share * mu)
        outcome, _ = standing(plan, config, (0.0, 9.81 * np.sin(angle), -9.81 * np.cos(angle)), 1.5)
        assert (outcome.status is Status.SLIPPED) is slips, (share, outcome.objects)


def test_a_plan_that_is_right_about_its_world_succeeds(plan):
    outcome = outcome_of(plan)
    assert (outcome.status, outcome.what) == (Status.SUCCESS, "")
    assert max(outcome.objects[name].slip for name in ("left_foot", "right_foot")) < 1e-3
    assert outcome.tracking_error < 2e-3
    assert np.abs(outcome.error_mean).max() < 0.05
    assert len(outcome.error_mean) == N


def test_measured_foot_forces_are_the_planned_ones(plan):
    seen = trace(plan, 0, configured())
    _, wanted = seen.planned_forces.sample(seen.t)
    for name, contact in seen.contacts.items():
        error = np.abs(contact.force - wanted[name])[seen.moving]
        assert np.median(error[:, 2]) < 0.005 * WEIGHT
        assert np.mean(error[:, 2]) < 0.02 * WEIGHT
        assert np.mean(error[:, :2]) < 0.01 * WEIGHT
        loaded = seen.moving & (wanted[name][:, 2] > 0.9 * WEIGHT)
        place = seen.planned_forces.center_of_pressure(name)
        planned = np.column_stack([np.interp(seen.t[loaded], seen.planned_forces.t, place[:, k]) for k in range(2)])
        assert np.nanmedian(np.abs(contact.center_of_pressure[loaded] - planned)) < 0.003


def test_a_foot_counts_as_standing_from_a_little_after_it_landed():
    steps = footsteps(configured())
    found = {name: stands(steps.stances, name) for name in ("left_foot", "right_foot")}
    fifth = 1 / 5
    right = [(0.0, fifth), (2 * fifth + LANDING * fifth, 1.0)]
    assert [(item.begin, item.end) for item in found["right_foot"]] == [pytest.approx(pair) for pair in right]
    left = [(0.0, 3 * fifth), (4 * fifth + LANDING * fifth, 1.0)]
    assert [(item.begin, item.end) for item in found["left_foot"]] == [pytest.approx(pair) for pair in left]


# Failures -------------------------------------------------------------------------------------------------


def test_a_foot_slips_where_the_planner_took_friction_for_more_than_it_is(plan):
    outcome = outcome_of(plan, "execution.truth.friction={left_foot: 0.3, right_foot: 0.15}")
    assert (outcome.status, outcome.what) == (Status.SLIPPED, "right_foot")
    assert outcome.objects["right_foot"].slip > 0.01
    assert 0.0 < outcome.time < plan.duration
    careful = plan_of(configured("contact.friction={left_foot: 0.25, right_foot: 0.12}"))
    assert careful.duration > plan.duration
    assert outcome_of(careful, "execution.truth.friction={left_foot: 0.3, right_foot: 0.15}").success


def test_a_robot_falls_whose_torso_is_heavier_on_one_side(plan):
    outcome = outcome_of(plan, LENIENT, "execution.truth.center_of_mass={torso: [0.0, 0.1, 0.21]}")
    assert (outcome.status, outcome.what) == (Status.FELL, "pelvis")
    assert outcome.objects["pelvis"].tilt > np.pi / 4
    drop = outcome_of(
        plan, LENIENT, "execution.failure.trunk_tilt=10", "execution.truth.center_of_mass={torso: [0.0, 0.1, 0.21]}"
    )
    assert (drop.status, drop.what) == (Status.FELL, "pelvis")
    assert drop.time > outcome.time
    assert drop.objects["pelvis"].drop > 0.35 * 0.54


def test_a_margin_for_the_base_survives_a_torso_that_is_off():
    world = "execution.truth={friction: {left_foot: 0.3, right_foot: 0.15}, center_of_mass: {torso: [0, 0.03, 0.26]}}"
    friction = "contact.friction={left_foot: 0.2, right_foot: 0.12}"
    without, with_margin = (plan_of(configured(friction, f"uncertainty.base_acceleration={e}")) for e in (0.0, 0.3))
    assert not outcome_of(without, world).success
    assert outcome_of(with_margin, world).success


def test_a_joint_that_stays_at_its_limit_is_reported():
    tight = ("robot.limits={left_knee: {torque: 71}}", "contact.friction=0.4", "execution.truth.mass={torso: 17}")
    plan = plan_of(configured(*tight))
    outcome = outcome_of(plan, *tight, "execution.failure.foot_slip=100")
    assert (outcome.status, outcome.what, outcome.torque) == (Status.TORQUE_SATURATED, "left_knee", 1.0)


def test_a_simulation_that_diverges_is_never_a_success(plan):
    job = prepare(plan, configured())
    wild = Gains(np.full(N - 6, 1e12), np.zeros(N - 6), np.full(N - 6, 1e9), job.gains.inputs)
    far = replace(job.planned, torque=1e15 * np.ones_like(job.planned.torque))
    scene_limits = configured("robot.limits={all: {torque: 1e15}}")
    (outcome,) = run_trials(Job(scene_limits, wild, far, 0), [0], 1)
    assert outcome.status is Status.DIVERGED
    assert (outcome.error_steps, outcome.objects["pelvis"].status) == (0, Status.DIVERGED)


# Speed and what a trial depends on ------------------------------------------------------------------------


def test_the_feedforward_is_that_of_the_speed(plan):
    slow = faster(plan, 0.5)
    assert Trajectory.from_plan(slow).duration == pytest.approx(2 * plan.duration)
    torque, _ = planned_forces(slow).sample(np.array([-1.0, 1.0]))
    planned = prepare(plan, configured(), speed=0.5).planned
    assert planned.torque[0] == pytest.approx(torque[0])
    assert planned.torque[np.argmin(np.abs(planned.t - 1.0))] == pytest.approx(torque[1], abs=1.0)
    assert outcome_of(plan, speed=0.8).success
    assert not outcome_of(plan, speed=1.3).success


@pytest.mark.slow
def test_trials_do_not_depend_on_others_nor_on_who_runs_them(plan, monkeypatch):
    monkeypatch.setattr(monte_carlo, "cores", lambda: 2)
    monkeypatch.setattr(monte_carlo, "CHUNK", 3)
    config = configured(
        "execution.truth={friction: {left_foot: 0.3, right_foot: 0.2}, variation: {friction: 0.05, mass: {torso: 1}}}",
        "execution.disturbance={force_deviation: [20, 20, 0], hold: 0.05, calibration_deviation: 0.001, on: torso}",
    )
    many = execute(plan, config, trials=5)
    assert len({outcome.status for outcome in many.outcomes}) > 1
    assert len({outcome.mass["torso"] for outcome in many.outcomes}) == 5
    two = execute(plan, config, trials=5, workers=2)
    assert repr(two.outcomes) == repr(many.outcomes)
    assert two.feedback == many.feedback
    for k in (0, 4):
        (alone,) = execute(plan, config, numbers=[k]).outcomes
        assert repr(asdict(alone)) == repr(asdict(many.outcomes[k]))
    assert repr(execute(plan, config, trials=1, seed=1).outcomes) != repr(many.outcomes[:1])


# The world ------------------------------------------------------------------------------------------------


def test_the_truth_is_in_the_model():
    truth = {
        "friction": {"left_foot": 0.25, "default": 0.4}, "mass": {"torso": 10.0}, "contact_inset": {"left_foot": 0.01},
        "center_of_mass": {"left_shank": [0.0, 0.01, -0.1]},
    }  # fmt: skip
    config = with_values(configured(), {"execution.truth": truth})
    walker = plan_of(config).problem.robot
    world = World(config, scene_gains(walker), 0.001)
    assert set(world.nominal.bodies) == {"torso", "left_shank"}
    nominal = world.model(world.nominal)
    body = BodyParameters(10.0, np.array([0.0, 0.0, 0.2]), np.eye(3))
    model = world.model(
        Parameters({"left_foot": 0.25, "right_foot": 0.4}, {"torso": body}, inset=truth["contact_inset"])
    )
    assert nominal.body_mass.sum() == pytest.approx(MASS)
    assert model.body("torso").mass == 10.0
    assert model.body("torso").ipos == pytest.approx([0.0, 0.0, 0.2])
    for foot, mu, half in (("left_foot", 0.25, 0.1), ("right_foot", 0.4, 0.11)):
        spheres = [k for k in range(model.ngeom) if model.geom(k).name.startswith(f"{foot}_")]
        assert len(spheres) == 4
        assert model.geom_friction[spheres, 0] == pytest.approx(mu)
        assert np.ptp(model.geom_pos[spheres, 0]) == pytest.approx(2 * half)
    with pytest.raises(ConfigError, match=r"contact_inset.*leaves nothing of left_foot"):
        world.model(replace(world.nominal, inset={"left_foot": 0.2}))


def test_nothing_but_contacts_carries_the_robot_whatever_its_file_says(plan, tmp_path):
    text = (MODELS / "humanoid.xml").read_text()
    for element, attribute in (('<body name="torso"', ' gravcomp="1"'), ("<option", ' density="100"')):
        text = text.replace(element, element + attribute)
    (tmp_path / "own.xml").write_text(text)
    walker = plan.problem.robot
    world = World(configured(f"robot.model={tmp_path / 'own.xml'}"), scene_gains(walker), 0.001)
    model = world.model(world.nominal)
    assert not np.any(model.body_gravcomp)
    assert model.opt.density == model.opt.viscosity == 0.0


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('contype="1" conaffinity="0" priority="1"', 'contype="16" conaffinity="0" priority="1"'),
        (
            '_foot" type="box" size="0.11 0.06 0.015" pos="0.02 0 -0.05"',
            '_foot" type="box" size="0.11 0.06 0.021" pos="0.02 0 -0.05" contype="1"',
        ),
        (
            '_foot" type="box" size="0.11 0.06 0.015" pos="0.02 0 -0.05"',
            '_foot" type="box" size="0.11 0.06 0.021" pos="0.02 0 -0.05" contype="7340032" conaffinity="0"',
        ),
        ("<worldbody>", '<worldbody><geom name="ground" type="plane" size="0 0 1"/>'),
    ],
)
def test_the_feet_touch_the_floor_with_their_contact_points_alone(plan, tmp_path, old, new):
    """Whatever contact bits these have, however low other geoms of the feet are, and if the file has a floor too."""
    text = (MODELS / "humanoid.xml").read_text()
    assert old in text
    (tmp_path / "feet.xml").write_text(text.replace(old, new))
    other = plan_of(configured(f"robot.model={tmp_path / 'feet.xml'}"))
    assert standing(other, other.problem.config)[1]["left_foot"].force[-1] == pytest.approx(
        standing(plan, configured())[1]["left_foot"].force[-1], abs=1e-3
    )


@pytest.mark.parametrize("scale", [1, 2])
def test_the_camera_sees_the_whole_robot_all_the_way(plan, tmp_path, scale):
    """A long walk of the shipped robot, and one step of a robot of twice the size."""
    walk = "[" + ", ".join(f"{{foot: {'right' if k % 2 else 'left'}, to: [{0.1 * k}, {0.16 * (-1) ** k}]}}"
                           for k in range(1, 10 if scale == 1 else 2)) + "]"  # fmt: skip
    config = configured("solver.collocation_points=200", f"path.steps={walk}", f"path.pelvis_height={0.54 * scale}")
    view = view_of(config, load_robot(config), np.zeros((1, 0)))
    azimuth, elevation = np.deg2rad([view.azimuth, view.elevation])
    forward = np.array([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)])
    right = np.array([np.sin(azimuth), -np.cos(azimuth), 0.0])
    axes = np.array([right, np.cross(right, forward), forward])
    ends = [0.0, 0.1 * (9 if scale == 1 else 1)]
    points = np.array([[x, 0.2 * y, z] for x in ends for y in (-1, 1) for z in (0.0, 1.18 * scale)])
    x, y, depth = axes @ (points - view.lookat).T + np.array([[0.0], [0.0], [view.distance]])
    half = np.tan(np.deg2rad(45 / 2))
    assert np.abs(y / depth).max() < half
    assert np.abs(x / depth).max() < half * WIDTH / HEIGHT


def scene_gains(walker: Robot) -> Gains:
    return gains_of(configured(), walker, np.zeros((1, walker.n)))


def test_gains_are_those_of_the_model_file_or_of_the_configuration(plan):
    gains = scene_gains(plan.problem.robot)
    assert gains.kp[:3].tolist() == [1500.0, 3000.0, 3000.0]
    assert gains.kd == pytest.approx(0.02 * gains.kp)
    config = configured("execution.controller.kp=2000")
    assert gains_of(config, plan.problem.robot, np.zeros((1, N))).kp.tolist() == [2000.0] * (N - 6)


@pytest.mark.parametrize("armature", [0.03, 0.01, 0.0])
def test_default_gains_hold_the_robot_up_however_light_its_feet_are(armature, tmp_path):
    text = (MODELS / "humanoid.xml").read_text().replace('armature="0.1"', f'armature="{armature}"')
    (tmp_path / "motors.xml").write_text(re.sub(r'<position (.*?) kp="\d+" kv="\d+"', r"<motor \1", text))
    config = configured(f"robot.model={tmp_path / 'motors.xml'}")
    plan = plan_of(config)
    (outcome,) = execute(plan, config, trials=1).outcomes
    assert outcome.status is Status.SUCCESS
    gains = gains_of(config, plan.problem.robot, plan.problem.path(np.array([0.0])))
    height = plan.problem.robot.contacts_and_com(plan.problem.path(np.array([0.0]))[0])[0][2]
    assert gains.kp[:12].min() >= 9.99 * WEIGHT * height
    assert gains.kp[13:].max() < 2 * WEIGHT * height, "arms carry nothing"


def test_rates_of_the_base_are_the_changes_of_its_coordinates(plan):
    random = np.random.default_rng(0)
    walker, h = plan.problem.robot, 1e-6
    q, qd = 0.4 * random.standard_normal((20, N)), random.standard_normal((20, N))
    before, after = walker.qpos(q - h * qd), walker.qpos(q + h * qd)
    spins = np.empty((20, 3))
    for i in range(20):
        turned, rate = np.zeros(4), np.zeros(3)
        mujoco.mju_mulQuat(turned, before[i, 3:7] * [1, -1, -1, -1], after[i, 3:7])
        mujoco.mju_quat2Vel(rate, turned, 2 * h)
        spins[i] = rate
    assert turning(walker.qpos(q)[:, 3:7], spins) == pytest.approx(qd[:, 3:6], abs=1e-6)


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        (["execution.controller.feedforward=gravity"], "expected computed_torque"),
        (["execution.truth.mass={torsoo: 3}"], "the robot has no body torsoo"),
        (["execution.truth.friction={torso: 0.3}"], "nothing is called torso"),
        (["execution.disturbance.on=hand"], "nothing is called hand"),
        (["execution.timestep=0.02"], "unstable with this time step"),
        (["execution.disturbance.calibration_deviation=[1, 2]"], "one for each of the 27 joints"),
    ],
)
def test_a_mistake_is_one_clear_error(plan, overrides, message):
    with pytest.raises(ConfigError, match=message):
        execute(plan, configured(*overrides), trials=1)


def test_a_plan_of_another_task_is_refused(plan):
    with pytest.raises(ConfigError, match="of another task"):
        execute(plan, configured("path.lift=0.04"), trials=1)


# Commands -------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_task_is_executed_into_a_whole_run_folder(tmp_path, capsys):
    small = (QUIET, "execution.truth.friction={left_foot: 0.3, right_foot: 0.15}")
    assert run(["execute", str(CONFIG), *small, "--trials", "2", "--out", str(tmp_path / "run")]) == 0
    assert "2 slipped" in capsys.readouterr().out
    with (tmp_path / "run" / "executions.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["status"] for row in rows] == ["slipped", "slipped"]
    assert float(rows[0]["friction_right_foot"]) == 0.15
    assert float(rows[0]["slip_right_foot"]) > 0.01
    assert rows[0]["slip_pelvis"] == ""
    names = {path.name for path in (tmp_path / "run" / "figures").iterdir()}
    assert {"trials.svg", "foot_contacts.svg", "accelerations.svg"} <= names
    assert (tmp_path / "run" / "report.html").read_text().count("<img") >= 8
    again = tmp_path / "again"
    assert run(["execute", str(tmp_path / "run"), "--trials", "2", "--no-figures", "--out", str(again)]) == 0
    assert (again / "executions.csv").read_bytes() == (tmp_path / "run" / "executions.csv").read_bytes()


@pytest.mark.slow
def test_the_friction_of_both_feet_is_learned():
    learning = "learning={algorithm: bisection, friction: [0.05, 0.45], delta: 0.15, epsilon: 0.5, trials: 2}"
    config = configured("solver.collocation_points=200", "execution.truth.friction=0.15", learning)
    learned = learn(config)
    assert learned.finished
    assert learned.best is not None
    assert learned.best.trial.belief.friction == pytest.approx(0.15)
    assert learned.judgement(learned.best).rate == 1.0


def test_a_learned_error_is_that_of_the_base_and_of_the_joints():
    error = ErrorInterval(mean=tuple([-0.1] * 6 + [0.2] * 27), deviation=tuple([0.05] * 6 + [0.1] * 27), K=2.0)
    uncertain = believing(configured(), Belief(error=error)).uncertainty
    assert uncertain.base_acceleration == pytest.approx((0.2,) * 6)
    assert uncertain.joint_acceleration.mean == pytest.approx((0.2,) * 27)
    assert uncertain.joint_acceleration.K == 2.0
