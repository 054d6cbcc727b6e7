"""A humanoid with a hand on a rail: a third contact in the path, the plan, the certificate and the execution."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from scipy.optimize import linprog
from walkers import believing, walker_of

from robustopt.certificate import certify
from robustopt.config import Config
from robustopt.config.load import load_config, with_values
from robustopt.errors import ConfigError, PathError, RobotError
from robustopt.geometry import common_direction, contact_axes
from robustopt.limits import TimeScalingProblem
from robustopt.plotting import figures, house_style, write_execution_figures
from robustopt.robot.model_file import MODELS
from robustopt.simulation import Status, execute
from robustopt.simulation.execute import prepare
from robustopt.simulation.trace import trace
from robustopt.solvers import Plan, build_problem, solve
from robustopt.solvers.batch import BatchPlanner, with_setting
from robustopt.solvers.contact_forces import planned_forces

CONFIGS = Path(__file__).parent.parent / "configs"
CONFIG = CONFIGS / "humanoid_rail.yaml"
HAND = "left_hand"
QUIET = "execution={truth: {friction: {default: 0.1, left_hand: 0.5}}}"
UP = np.array([0.0, 0.0, 1.0])


def configured(*overrides: str) -> Config:
    return load_config(CONFIG, ["solver.collocation_points=60", QUIET, *overrides])


@pytest.fixture(scope="module")
def problem() -> TimeScalingProblem:
    return build_problem(configured())


@pytest.fixture(scope="module")
def plan(problem: TimeScalingProblem) -> Plan:
    return solve(problem)


@pytest.fixture(scope="module")
def fine() -> Plan:
    """A plan on a grid that is fine enough to be executed."""
    return solve(build_problem(configured("solver.collocation_points=120")))


def on_feet(mu: float) -> dict[str, Any]:
    return {"contact.friction": {"default": mu, HAND: 0.5}}


# Path -----------------------------------------------------------------------------------------------------


def test_the_palm_stays_in_its_place_while_the_robot_walks(problem: TimeScalingProblem) -> None:
    walker, path = walker_of(problem), problem.path
    q = path(np.linspace(0.0, 1.0, 173))
    corners = walker.contact_points(q)[HAND]
    ahead, aside = np.array([-0.04, 0.04, 0.04, -0.04]), np.array([-0.025, -0.025, 0.025, 0.025])
    expected = np.column_stack([0.3 + ahead, 0.27 + aside, np.full(4, 0.7)])
    np.testing.assert_allclose(corners, np.broadcast_to(expected, corners.shape), atol=1e-6)
    assert all(HAND in stance.places for stance in path.stances)
    arm = walker.limbs[HAND]
    assert [walker.joint_names[k] for k in arm][:1] == ["left_shoulder_pitch"]
    assert len(arm) == 7
    assert (q[:, arm] >= walker.limits.lower[arm]).all()
    assert (q[:, arm] <= walker.limits.upper[arm]).all()
    others = [k for k, name in enumerate(walker.joint_names) if name == "waist" or name.startswith("right_shoulder")]
    np.testing.assert_allclose(q[:, others], np.broadcast_to(walker.posture[others], (len(q), len(others))), atol=1e-12)


def test_a_palm_on_a_tilted_rail_lies_flat_on_it() -> None:
    problem = build_problem(configured("path.rail.normal=[0, -1, 2]", "path.rail.along=[1, 0.5, 0]"))
    corners = walker_of(problem).contact_points(problem.path(np.array([0.0, 0.5])))[HAND]
    axes = contact_axes([0, -1, 2], [1, 0.5, 0])
    local = (corners - [0.3, 0.27, 0.7]) @ axes
    np.testing.assert_allclose(np.abs(local), np.broadcast_to([0.04, 0.025, 0.0], local.shape), atol=1e-6)


@pytest.mark.parametrize(
    ("override", "words"),
    [
        (
            "path.rail.at=[0.3, 0.6, 0.7]",
            "before steps[0], on both feet, at 0 %: the left hand does not reach its place",
        ),
        ("path.rail.at=[0.1, 0.4, 0.7]", "between steps[0] and steps[1], on both feet, at"),
        ("path.rail.hand=right", "the right hand does not reach its place on the rail"),
        ("robot.limits={left_elbow: {position: [-1.2, 0]}}", "left_elbow would be at"),
        ("path.rail.length=1.0", "torso and the rail collide"),
    ],
)
def test_a_rail_out_of_reach_says_where_on_the_way(override: str, words: str) -> None:
    friction = "contact.friction=0.1"
    with pytest.raises(PathError) as caught:
        build_problem(load_config(CONFIG, [friction, "execution=null", override]))
    assert caught.value.problems[0].key == "path.rail.at"
    assert words in caught.value.problems[0].message
    assert "expected a" in caught.value.problems[0].message


# Contacts -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("normal", [[0, 0, 1], [0, -1, 1], [0.3, -1, 0.2]])
def test_facets_are_the_cone_of_all_contact_forces(problem: TimeScalingProblem, normal: list[float]) -> None:
    """Against linear programs over the forces, for wrenches on both sides of the cone's surface."""
    tilted = build_problem(with_values(problem.config, {"path.rail.normal": normal}))
    rng = np.random.default_rng(3)
    for family in tilted.limits.contacts[:2]:
        system = family.system
        assert system.contacts[-1] == HAND
        assert system.complete
        assert (system.facets @ system.generators).max() < 1e-8
        np.testing.assert_allclose(system.facets @ system.interior, -1.0, rtol=0.5)
        sides = set()
        for size in np.linspace(0.1, 3.0, 30):
            wrench = system.interior + size * rng.normal(size=6) * [0.3, 0.3, 0.1, 0.2, 0.2, 0.1]
            answer = linprog(np.zeros(system.generators.shape[1]), A_eq=system.generators, b_eq=wrench, method="highs")
            sides.add(answer.status)
            assert (answer.status == 0) == bool((system.facets @ wrench).max() <= 1e-7)
        assert sides == {0, 2}


def test_all_forces_point_along_the_common_direction() -> None:
    assert common_direction([UP, UP], [0.3, 5.0]) is UP
    for normal, mu, hand in (([0, 1, 0], 0.5, 0.5), ([0, 1, 0.2], 0.2, 2.0), ([0, 0.9, -0.3], 0.3, 0.2)):
        n = np.array(normal) / np.linalg.norm(normal)
        d = common_direction([UP, UP, n], [0.1, mu, hand])
        assert d is not None
        for axis, friction in ((UP, mu), (n, hand)):
            assert d @ axis > friction * np.linalg.norm(np.cross(d, axis))
    assert common_direction([UP, np.array([0.0, 1.0, 0.0])], [1.0, 1.0]) is None
    assert common_direction([UP, -UP], [0.1, 0.1]) is None


# Plans ----------------------------------------------------------------------------------------------------


def test_a_rail_makes_a_plan_faster_and_possible_on_a_slippery_floor(problem: TimeScalingProblem) -> None:
    """At equal beliefs a plan with the rail is never slower than without it; the less friction there is under the feet
    the more it gains, and where the feet alone cannot do the steps, the hand makes them possible."""
    free = build_problem(with_values(problem.config, {"path.rail": None, "contact.friction": 0.3, "execution": None}))
    gains = []
    for mu in (0.8, 0.2, 0.1, 0.06):
        alone = solve(believing(free, {"contact.friction": mu})).duration
        held = solve(believing(problem, on_feet(mu))).duration
        gains.append(alone / held)
    assert min(gains) > 1.0
    assert all(later > earlier for earlier, later in pairwise(gains[1:]))
    assert gains[-1] > 1.3
    assert not np.isfinite(solve(believing(free, {"contact.friction": 0.03})).duration)
    assert np.isfinite(solve(believing(problem, on_feet(0.03))).duration)


@pytest.mark.slow
def test_less_certainty_about_the_hand_never_makes_a_plan_faster(problem: TimeScalingProblem) -> None:
    families: dict[str, list[Any]] = {
        "contact.friction": [{"default": 0.1, HAND: mu} for mu in (0.8, 0.5, 0.2, 0.05)],
        "uncertainty.friction": [{HAND: [low, 0.6]} for low in (0.5, 0.3, 0.1)],
        "uncertainty.contact_points": [{"default": 0.01, HAND: d} for d in (0.0, 0.012, 0.024)],
    }
    for key, values in families.items():
        times = [solve(believing(problem, {key: value}), "reachability").duration for value in values]
        assert all(later >= earlier - 1e-4 * earlier for earlier, later in pairwise(times)), (key, times)
        if "friction" in key:
            assert times[-1] > 1.01 * times[0]


@pytest.mark.slow
def test_both_solvers_find_the_same_plan_and_it_passes_its_certificate(problem: TimeScalingProblem) -> None:
    for values in ({}, {"uncertainty.mass": {"torso": [13.0, 15.0]}, "uncertainty.friction": {HAND: [0.4, 0.6]}}):
        uncertain = believing(problem, values)
        fast, exact = solve(uncertain, "reachability"), solve(uncertain, "ipopt")
        assert fast.status.value == exact.status.value == "solved"
        assert fast.duration == pytest.approx(exact.duration, rel=1e-4)
        certificate = certify(fast)  # on the grid, which is too coarse for what is in between
        assert min(margin.on_grid for margin in certificate.margins.values()) > -1e-4
        contacts = {name: m.on_grid for name, m in certificate.margins.items() if name.startswith("contact of")}
        assert set(contacts) == {
            f"contact of {feet} and left hand" for feet in ("both feet", "left foot", "right foot")
        }
        assert min(contacts.values()) < 0.01


@pytest.mark.parametrize(
    "values",
    [
        {"contact.friction": {"default": 0.1, HAND: 0.2}},
        {"uncertainty.friction": {HAND: [0.2, 0.5]}},
        {"uncertainty.base_acceleration": 0.4},
    ],
)
def test_a_plan_for_a_better_hold_fails_its_certificate(plan: Plan, values: dict[str, Any]) -> None:
    certificate = certify(plan, config=with_values(plan.problem.config, values))
    assert not certificate.passed
    contacts = [m.on_grid for name, m in certificate.margins.items() if name.endswith("and left hand")]
    assert min(contacts) < -0.01


def test_a_weak_arm_slows_a_plan_down(problem: TimeScalingProblem) -> None:
    weak = build_problem(with_values(problem.config, {"robot.limits": {"left_elbow": {"torque": 8.0}}}))
    plan = solve(weak)
    assert plan.duration > 1.01 * solve(problem).duration
    assert plan.problem.limits.torque.sharing is not None
    assert plan.problem.limits.torque.sharing.rows
    margins = certify(plan).margins
    assert -1e-4 < margins["left_elbow torque"].on_grid < 0.05


def test_arm_torques_hold_for_the_parameters_that_the_feet_like_least(problem: TimeScalingProblem) -> None:
    """At the middle of all intervals the arm had half of its strength in reserve; where the feet have nothing left, an
    error of the base is the arm's to make up for. The planner once looked at the middle only."""
    slippery = believing(problem, on_feet(0.06))
    margins = certify(solve(slippery)).margins
    assert min(m.on_grid for name, m in margins.items() if name.endswith("torque")) > -1e-4


def test_a_batch_may_differ_in_the_friction_of_the_hand(problem: TimeScalingProblem) -> None:
    settings: list[dict[str, Any]] = [{"contact.friction.left_hand": 0.3}, {"uncertainty.contact_points": 0.02}]
    found = BatchPlanner(problem.config, workers=2).durations(settings)
    for setting, time in zip(settings, found, strict=True):
        assert solve(build_problem(with_setting(problem.config, setting)), "reachability").duration == time


def test_planned_forces_are_possible_and_make_the_motion(plan: Plan) -> None:
    """In the cones of all contacts, and with them MuJoCo needs no push on the base and the planned torques."""
    forces, walker = planned_forces(plan), walker_of(plan.problem)
    model = mujoco.MjModel.from_xml_path(str(MODELS / "humanoid.xml"))
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT) | int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
    data, n = mujoco.MjData(model), walker.n
    assert forces.residual.max() < 1e-6
    assert forces.pressed(HAND)[:, 2].min() > 0.0
    for name, mu in (("left_foot", 0.1), (HAND, 0.5)):
        pushes = forces.forces[name]
        assert (np.hypot(pushes[..., 0], pushes[..., 1]) <= mu * pushes[..., 2] + 1e-9).all()
    u, x = np.repeat(plan.u, 2), np.column_stack([plan.x[:-1], plan.x[1:]]).ravel()
    q, q1, q2 = (plan.problem.path(forces.s[1:-1], order) for order in range(3))
    for k in range(0, len(u), 11):
        data.qpos[:], data.qvel[:] = walker.qpos(q[k : k + 1])[0], q1[k] * np.sqrt(x[k])
        data.qacc[:] = q1[k] * u[k] + q2[k] * x[k]
        mujoco.mj_inverse(model, data)
        need, jacobian = data.qfrc_inverse.copy(), np.zeros((3, n))
        for name, pushes in forces.forces.items():
            for push, point in zip(pushes[k + 1], forces.points[name][k + 1], strict=True):
                mujoco.mj_jac(model, data, jacobian, None, point, model.site(name).bodyid[0])
                need -= jacobian.T @ push
        np.testing.assert_allclose(need, forces.torque[k + 1], atol=2e-3)


# Executions -----------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_plan_that_is_right_about_its_world_succeeds_with_the_planned_forces(fine: Plan, tmp_path: Path) -> None:
    seen = trace(fine, 0, configured("solver.collocation_points=120"))
    assert seen.outcome.status is Status.SUCCESS
    assert seen.outcome.objects[HAND].slip < 0.008
    assert seen.planned_forces is not None
    _, wanted = seen.planned_forces.sample(seen.t)
    force = seen.contacts[HAND].force[seen.moving]
    assert wanted[HAND][seen.moving, 2].max() > 60.0
    assert np.abs(force[:, 2] - wanted[HAND][seen.moving, 2]).mean() < 5.0
    assert (np.hypot(force[:, 0], force[:, 1]) <= 0.52 * force[:, 2] + 1.0).all()
    with house_style():
        drawn = figures(fine, fine.problem.config)
    assert "left hand" in [text.get_text() for text in drawn["feet"].axes[0].get_legend().get_texts()]
    robot = fine.problem.robot
    assert tmp_path / "foot_contacts.svg" in write_execution_figures(fine.problem.config, [seen], robot, tmp_path)


def test_a_hand_slips_where_its_rail_is_smoother_than_believed(fine: Plan) -> None:
    smooth = configured("execution={truth: {friction: {default: 0.1, left_hand: 0.1}}}")
    (outcome,) = execute(fine, with_values(smooth, {"solver.collocation_points": 120}), trials=1).outcomes
    assert outcome.status is Status.SLIPPED
    assert outcome.objects[HAND].status is Status.SLIPPED
    assert outcome.objects[HAND].slip > 0.01


def test_a_hand_loses_contact_where_it_is_pulled_off(fine: Plan) -> None:
    pulled = configured("execution={failure: {foot_slip: 100, hand_lift: 0.002}, disturbance: {on: left_hand, "
                        "force_deviation: [0, 0, 150], hold: 0.3}}", "solver.collocation_points=120")  # fmt: skip
    outcomes = execute(fine, pulled, trials=3).outcomes
    lost = [item for item in outcomes if item.objects[HAND].status is Status.LOST_CONTACT]
    assert lost
    assert all(item.objects[HAND].lift > 0.002 for item in lost)


def test_the_rail_and_the_palm_are_in_the_model(fine: Plan, tmp_path: Path) -> None:
    """And a knuckle of the model file is no part of the palm."""
    text, hand = (MODELS / "humanoid.xml").read_text(), '<geom name="left_hand"'
    assert text.count(hand) == 1
    knuckle = '<geom name="knuckle" type="sphere" size="0.01" pos="0 0 -0.01" mass="0" conaffinity="8"/>'
    (tmp_path / "knuckle.xml").write_text(text.replace(hand, knuckle + hand))
    inset = "execution.truth.contact_inset={left_hand: 0.01}"
    config = configured("path.rail.normal=[0, -1, 2]", inset, f"robot.model={tmp_path / 'knuckle.xml'}")
    job = prepare(solve(build_problem(config)))
    world = job.world
    model = world.model(job.parameters(0))
    data, axes = mujoco.MjData(model), contact_axes([0, -1, 2], [1, 0, 0])
    data.qpos[:] = world.start(world.layout(model), build_problem(config).path(np.array([0.0]))[0], model.nq)
    mujoco.mj_kinematics(model, data)
    spheres = [k for k in range(model.ngeom) if model.geom(k).name.startswith("robustopt_left_hand")]
    local = (data.geom_xpos[spheres] - [0.3, 0.27, 0.7]) @ axes
    np.testing.assert_allclose(np.abs(local), np.broadcast_to([0.03, 0.015, 0.01], (4, 3)), atol=2e-3)
    assert model.geom_friction[spheres, 0] == pytest.approx(0.5)
    np.testing.assert_array_equal(model.geom("knuckle").pos, [0.0, 0.0, -0.01])
    rail = model.geom("robustopt_rail")
    np.testing.assert_allclose(data.geom_xmat[rail.id].reshape(3, 3), axes, atol=1e-12)
    assert model.geom_conaffinity[rail.id] & model.geom_contype[spheres].max()


# Configuration --------------------------------------------------------------------------------------------

MISTAKES = [
    ("path.rail.hand=middle", "path.rail.hand", "expected one of left, right"),
    ("path.rail.size=[0, 0.05]", "path.rail.size", "found 0; expected a number from 1e-06"),
    ("path.rail.size=null", "path.rail.size", "found nothing; expected a list of two numbers"),
    ("path.rail.place=[0, 0, 1]", "path.rail.place", "unknown key"),
    ("path.rail.at=[0.3, 0.27, -0.1]", "path.rail.at", "expected a position above the floor"),
    ("path.rail.normal=[0, 0, 0]", "path.rail.normal", "which has no direction"),
    ("path.rail.length=0.05", "path.rail.length", "expected at least 0.08 m, the palm's length"),
    ("path.rail.along=[0, 0, 3]", "path.rail.along", "found the direction of the normal"),
    ("path.rail.normal=[0, 0.1, -1]", "path.rail.normal", "could press against each other with any force"),
    ("contact.friction={left_foot: 1, right_foot: 1}", "contact.friction", "no value for left_hand"),
    ("contact.friction={default: 1, right_hand: 1}", "contact.friction.right_hand", "nothing is called right_hand"),
    ("uncertainty.friction={left_hand: [0.6, 0.7]}", "uncertainty.friction.left_hand", "does not contain"),
    ("execution.truth.friction={right_hand: 1}", "execution.truth.friction.right_hand", "nothing is called right_hand"),
]


@pytest.mark.parametrize(("override", "key", "words"), MISTAKES, ids=[key + o[-9:] for o, key, _ in MISTAKES])
def test_a_mistake_names_its_key_and_what_would_be_right(override: str, key: str, words: str) -> None:
    with pytest.raises(ConfigError) as caught:
        load_config(CONFIG, [override])
    found = {problem.key: problem.message for problem in caught.value.problems}
    assert any(name.startswith(key) and words in message for name, message in found.items()), found


def test_a_rail_needs_steps_and_a_hand() -> None:
    with pytest.raises(ConfigError, match=r"path\.rail: not allowed without path\.steps"):
        load_config(CONFIGS / "waiter_two_blocks.yaml", ["path.rail={hand: left, at: [0, 0, 1], size: [0.1, 0.1]}"])
    with pytest.raises(ConfigError, match=r"leaves no certain part of left_hand, 0\.08 by 0\.05 m"):
        build_problem(configured("uncertainty.contact_points={left_hand: 0.03}"))


def test_a_model_without_hands_says_so(tmp_path: Path) -> None:
    text = (MODELS / "humanoid.xml").read_text()
    (tmp_path / "handless.xml").write_text(text.replace('site name="left_hand"', 'site name="left_paw"'))
    with pytest.raises(RobotError, match=r"no site 'left_hand' in the middle of a palm"):
        build_problem(configured(f"robot.model={tmp_path / 'handless.xml'}"))
    config = configured()
    (tmp_path / "low.xml").write_text(text.replace('<site name="left_hand"', '<site name="at_hand"').replace(
        '<geom name="left_upper_arm"', '<site name="left_hand"/><geom name="left_upper_arm"'))  # fmt: skip
    with pytest.raises(RobotError, match="left_hand hangs from 3 joints; expected at least 6"):
        build_problem(with_values(config, {"robot.model": str(tmp_path / "low.xml")}))
