"""A robot on its feet: closed forms, dynamics against MuJoCo, cones against programs, and what must not change."""

from __future__ import annotations

import json
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import mujoco
import numpy as np
import pytest
from scipy.optimize import linprog
from walkers import believing, walker_of

from robustopt.certificate import certify
from robustopt.certificate.balance import required_by_base
from robustopt.certificate.joints import torques
from robustopt.certificate.loads import body_loads
from robustopt.certificate.motion import instants, motion, stances
from robustopt.certificate.task import task_of
from robustopt.certificate.world import build_world
from robustopt.cli import run
from robustopt.config import Config
from robustopt.config.load import load_config, with_values
from robustopt.errors import ConfigError, PathError, RobotError
from robustopt.learning.learner import Belief
from robustopt.limits import TimeScalingProblem
from robustopt.limits.formulas import evaluate
from robustopt.limits.torque_sharing import Sharing
from robustopt.path.footsteps import footsteps
from robustopt.plotting import figures, house_style
from robustopt.robot.model_file import MODELS
from robustopt.runs.beliefs import Planner
from robustopt.runs.beliefs import believing as believing_config
from robustopt.solvers import Plan, Status, build_problem, solve
from robustopt.solvers.batch import BatchPlanner, with_setting
from robustopt.solvers.contact_forces import planned_forces
from robustopt.solvers.plan import interval_ends
from robustopt.solvers.sharing import SharingSearch
from robustopt.solvers.trajectory import Trajectory

CONFIG = Path(__file__).parent.parent / "configs" / "humanoid_step.yaml"
BASE = 6
N = 33
"""Coordinates of the shipped humanoid: six of its base, 27 joints."""


def configured(*overrides: str) -> Config:
    return load_config(CONFIG, ["solver.collocation_points=60", *overrides])


@pytest.fixture(scope="module")
def problem() -> TimeScalingProblem:
    return build_problem(configured())


@pytest.fixture(scope="module")
def plan(problem: TimeScalingProblem) -> Plan:
    return solve(problem)


def sharing_of(problem: TimeScalingProblem) -> Sharing:
    sharing = problem.limits.torque.sharing
    assert sharing is not None
    return sharing


def duration(problem: TimeScalingProblem, values: dict[str, Any]) -> float:
    found = solve(believing(problem, values), "reachability")
    assert found.status is Status.SOLVED
    return found.duration


# Path -----------------------------------------------------------------------------------------------------


def test_standing_feet_stay_and_the_centre_of_mass_follows_its_spline(problem: TimeScalingProblem) -> None:
    walker, path = walker_of(problem), problem.path
    s = np.linspace(0.0, 1.0, 173)
    q = path(s)
    found = walker.contact_points(q)
    for stance in path.stances:
        during = (s >= stance.begin) & (s <= stance.end)
        for name, place in stance.places.items():
            expected = place.world(walker.contacts[name].points)
            np.testing.assert_allclose(
                found[name][during], np.broadcast_to(expected, found[name][during].shape), atol=1e-6
            )
    center = np.array([walker.contacts_and_com(qi)[0][:2] for qi in q])
    np.testing.assert_allclose(center, footsteps(problem.config).com(s), atol=1e-6)
    np.testing.assert_array_equal(q[:, 3:6], 0.0)


def test_a_swinging_foot_is_lifted_and_at_rest_where_it_lifts_and_lands(problem: TimeScalingProblem) -> None:
    steps = footsteps(problem.config)
    middle = steps.at(0.3)["right_foot"].position
    np.testing.assert_allclose(middle, [0.1, -0.16, problem.config.path.lift])
    for s in (0.2, 0.4):
        rate = (steps.at(s + 1e-6)["right_foot"].position - steps.at(s - 1e-6)["right_foot"].position) / 2e-6
        np.testing.assert_allclose(rate, 0.0, atol=1e-4)


def test_every_switch_is_a_grid_point_at_which_both_stances_hold(problem: TimeScalingProblem) -> None:
    contacts, switches = problem.limits.contacts, problem.path.switches
    assert [family.last for family in contacts[:-1]] == [family.first for family in contacts[1:]]
    np.testing.assert_array_equal(problem.s[[family.first for family in contacts[1:]]], switches)
    assert not problem.rest[1:-1].any()


def test_labels_say_which_foot_is_in_the_air(problem: TimeScalingProblem) -> None:
    label = problem.path.label
    assert label(0.0) == "before steps[0], on both feet, at 0 %"
    assert label(0.3) == "during steps[0], right foot in the air, at 50 %"
    assert label(0.5) == "between steps[0] and steps[1], on both feet, at 50 %"
    assert label(1.0) == "after steps[1], on both feet, at 100 %"


@pytest.mark.parametrize(
    ("override", "key", "words"),
    [
        ("path.steps=[{foot: right, to: [0.8, -0.16]}]", "path.steps[0]", "the legs do not reach both feet at s ="),
        ("path.pelvis_height=0.6", "path.steps[0]", "a lower path.pelvis_height"),
        ("robot.limits={left_knee: {position: [0, 1.2]}}", "path.start", "left_knee would be at"),
        ("path.start={left: [0, 0.03], right: [0, -0.03]}", "path.start", "collide"),
    ],
)
def test_a_path_out_of_reach_or_beyond_a_joint_says_where(override: str, key: str, words: str) -> None:
    with pytest.raises(PathError) as caught:
        build_problem(configured(override))
    assert caught.value.problems[0].key == key
    assert words in caught.value.problems[0].message


# Dynamics -------------------------------------------------------------------------------------------------


def free_model() -> mujoco.MjModel:
    model = mujoco.MjModel.from_xml_path(str(MODELS / "humanoid.xml"))
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT) | int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
    return model


def test_inverse_dynamics_are_those_of_the_model_with_its_free_joint(problem: TimeScalingProblem) -> None:
    walker, model, rng = walker_of(problem), free_model(), np.random.default_rng(0)
    data = mujoco.MjData(model)
    q, qd, qdd = rng.normal(0.0, 0.3, (5, N)), rng.normal(size=(5, N)), rng.normal(0.0, 5.0, (5, N))
    qd[:, 3:6] = qdd[:, 3:6] = 0.0  # the turn's rates mean other numbers in other coordinates
    force, _, _ = walker.inverse_dynamics(q, qd, qdd)
    for k, qpos in enumerate(walker.qpos(q)):
        data.qpos[:], data.qvel[:], data.qacc[:] = qpos, qd[k], qdd[k]
        mujoco.mj_inverse(model, data)
        rotation = data.body("pelvis").xmat.reshape(3, 3)
        push = data.qfrc_inverse[:3]
        moment = rotation @ data.qfrc_inverse[3:6] + np.cross(data.body("pelvis").xpos, push)
        np.testing.assert_allclose(force[k, :BASE], np.r_[push, moment], rtol=1e-9, atol=1e-8)
        np.testing.assert_allclose(force[k, BASE:], data.qfrc_inverse[BASE:], rtol=1e-9, atol=1e-8)


def test_dynamics_along_the_path_are_affine_parts_of_inverse_dynamics(problem: TimeScalingProblem) -> None:
    walker, rng = walker_of(problem), np.random.default_rng(1)
    q, q1, q2 = rng.normal(0.0, 0.3, (4, N)), rng.normal(size=(4, N)), rng.normal(size=(4, N))
    u, x = rng.normal(size=(4, 1)), rng.random((4, 1))
    parts = walker.dynamics(q, q1, q2)
    force, inertia, jacobians = walker.inverse_dynamics(q, q1 * np.sqrt(x), q1 * u + q2 * x)
    np.testing.assert_allclose(parts.force_u * u + parts.force_x * x + parts.force_0, force, rtol=1e-8, atol=1e-8)
    np.testing.assert_allclose(parts.mass_matrix, inertia, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(parts.contact_jacobians["left_foot"], jacobians["left_foot"], rtol=1e-9, atol=1e-9)


def test_standing_still_takes_the_weight(problem: TimeScalingProblem) -> None:
    walker = walker_of(problem)
    q = problem.path(np.array([0.0]))
    force, _, _ = walker.inverse_dynamics(q, 0.0 * q, 0.0 * q)
    center = walker.contacts_and_com(q[0])[0]
    weight = walker.mass * 9.81
    np.testing.assert_allclose(force[0, :BASE], [0, 0, weight, weight * center[1], -weight * center[0], 0], atol=1e-9)


UNCERTAIN = {
    "uncertainty.center_of_mass": {"torso": [0.01, 0.02, 0.03], "left_shank": [0.0, 0.0, 0.02]},
    "uncertainty.mass": {"torso": [12.0, 16.0], "right_thigh": [3.0, 4.0]},
    "uncertainty.joint_acceleration": {"mean": 0.1, "deviation": 0.2, "K": 1},
}


def test_rows_over_the_load_bound_every_value_of_the_parameters(problem: TimeScalingProblem) -> None:
    """Random rows at random (u, x): at least as large as with the forces of a model of random bodies, and hardly more
    than the largest of them over the corners of one direction."""
    uncertain, walker = believing(problem, UNCERTAIN), walker_of(problem)
    loads, rng = sharing_of(uncertain).loads, np.random.default_rng(2)
    points = np.arange(0, 60, 12)
    u, x = rng.normal(size=len(points)), 0.1 * rng.random(len(points))
    q, q1, q2 = (problem.path(problem.s[points], order) for order in range(3))
    qd, qdd = q1 * np.sqrt(x)[:, None], q1 * u[:, None] + q2 * x[:, None]
    rows = rng.normal(size=(len(points), 8, N))
    none = np.zeros((0, 0, 0))
    bound = evaluate(rows, loads.at(points), none, none, u, x)
    size = np.abs(bound).max()
    largest = np.full(bound.shape, -np.inf)
    for _ in range(60):
        sides = rng.choice([-1.0, 1.0], 41)
        bodies = {
            "torso": (14.0 + 2.0 * sides[0], walker.inertia_of("torso")[1] + sides[1:4] * [0.01, 0.02, 0.03]),
            "left_shank": (2.3, walker.inertia_of("left_shank")[1] + sides[4:7] * [0.0, 0.0, 0.02]),
            "right_thigh": (3.5 + 0.5 * sides[7], walker.inertia_of("right_thigh")[1]),
        }
        force, inertia, _ = walker.inverse_dynamics(q, qd, qdd, bodies)
        error = np.r_[0.2 * sides[8:14], 0.1 + 0.2 * sides[14:41]]
        values = np.einsum("pfn,pn->pf", rows, force + inertia @ error)
        assert (values <= bound + 1e-9 * size).all()
        largest = np.maximum(largest, values)
    assert (bound - largest).max() < 0.1 * size


# Contacts -------------------------------------------------------------------------------------------------


def test_facets_of_every_stance_are_the_cone_of_its_forces(problem: TimeScalingProblem) -> None:
    uneven = believing(problem, {"contact.friction": {"left_foot": 0.4, "right_foot": 0.15}})
    rng = np.random.default_rng(3)
    for family in uneven.limits.contacts[:3]:
        system = family.system
        assert system.complete
        assert (system.facets @ system.generators).max() < 1e-8
        sides = set()
        for size in np.linspace(0.1, 3.0, 24):
            way = rng.normal(size=6) * [0.3, 0.3, 0.0, 0.1, 0.1, 0.05]
            wrench = system.interior + size * way
            answer = linprog(np.zeros(system.generators.shape[1]), A_eq=system.generators, b_eq=wrench, method="highs")
            sides.add(answer.status)
            assert (answer.status == 0) == bool((system.facets @ wrench).max() <= 1e-7 * wrench[2])
        assert sides == {0, 2}


def test_less_certainty_or_friction_never_makes_a_plan_faster(problem: TimeScalingProblem) -> None:
    families: dict[str, list[Any]] = {
        "contact.friction": [0.8, 0.3, 0.2, 0.1],
        "uncertainty.base_acceleration": [0.0, 0.1, 0.3],
        "uncertainty.contact_points": [0.0, 0.01, 0.02],
        "uncertainty.center_of_mass": [{}, {"torso": [0.01, 0.01, 0.02]}, {"torso": [0.02, 0.02, 0.04]}],
        "uncertainty.mass": [{}, {"torso": [13.0, 15.0]}, {"torso": [12.0, 16.0]}],
    }
    for key, values in families.items():
        times = [duration(problem, {key: value}) for value in values]
        assert all(later >= earlier - 1e-6 * earlier for earlier, later in pairwise(times)), key
        assert times[-1] > times[0], key


def test_each_foot_has_a_friction_of_its_own(problem: TimeScalingProblem) -> None:
    even = duration(problem, {"contact.friction": 0.3})
    left = duration(problem, {"contact.friction": {"left_foot": 0.12, "right_foot": 0.3}})
    both = duration(problem, {"contact.friction": {"default": 0.12}})
    assert even < left < both
    interval = duration(problem, {"uncertainty.friction": {"left_foot": [0.12, 0.4]}})
    assert interval == pytest.approx(left, rel=1e-9)


@pytest.mark.slow
def test_both_solvers_find_the_same_plan(problem: TimeScalingProblem) -> None:
    for values in ({}, UNCERTAIN):
        uncertain = believing(problem, values)
        fast, exact = solve(uncertain, "reachability"), solve(uncertain, "ipopt")
        assert fast.status is exact.status is Status.SOLVED
        assert fast.duration == pytest.approx(exact.duration, rel=1e-4)


def test_plans_of_a_batch_are_those_of_their_settings(problem: TimeScalingProblem) -> None:
    settings: list[dict[str, Any]] = [
        {"contact.friction.left_foot": 0.2, "uncertainty.base_acceleration": 0.1},
        {"contact.friction.right_foot": 0.25, "uncertainty.center_of_mass.torso.2": 0.02},
        {"uncertainty.contact_points": 0.02},
    ]
    found = BatchPlanner(problem.config, workers=2).durations(settings)
    for setting, time in zip(settings, found, strict=True):
        assert solve(build_problem(with_setting(problem.config, setting)), "reachability").duration == time


# Torques --------------------------------------------------------------------------------------------------

WEAK = {"robot.limits": {f"{side}_ankle_roll": {"torque": 8.0} for side in ("left", "right")}}


def test_weak_joints_slow_a_plan_down_also_where_both_feet_share_the_load() -> None:
    weak = build_problem(with_values(configured(), WEAK))
    free = duration(build_problem(configured()), {})
    plans = [solve(weak, method) for method in ("reachability", "ipopt")]
    assert plans[0].duration > 1.1 * free
    assert plans[0].duration == pytest.approx(plans[1].duration, rel=1e-4)
    for found in plans:
        sharing = sharing_of(found.problem)
        assert sharing.rows
        u, x, points = interval_ends(found)
        assert SharingSearch(np.ones(N, dtype=bool)).missing_rows(sharing, points, u, x)[0] == []
    margins = certify(plans[0]).margins  # on the grid, which is too coarse for what is in between
    assert min(margin.on_grid for margin in margins.values()) > -1e-6


def test_torques_are_looked_at_even_where_none_binds(problem: TimeScalingProblem, plan: Plan) -> None:
    certificate = certify(plan)
    joints = [name for name in certificate.margins if name.endswith(" torque")]
    assert len(joints) == N - BASE
    assert min(certificate.margins[name].on_grid for name in joints) > 0.3
    too_fast = certify(_with_limits(plan, 20.0))
    assert not too_fast.passed
    assert too_fast.worst.limit.endswith(" torque")


def _with_limits(plan: Plan, torque: float) -> Plan:
    """The same timing of a robot with other torque limits."""
    weak = build_problem(with_values(plan.problem.config, {"robot.limits": {"all": {"torque": torque}}}))
    return replace(plan, problem=weak)


# Certificate ----------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_plan_passes_its_certificate_tightly(problem: TimeScalingProblem) -> None:
    for values in ({}, UNCERTAIN):
        uncertain = believing(problem, values | {"solver.collocation_points": 200})
        certificate = certify(solve(uncertain))
        assert certificate.passed, certificate.sentence
        contacts = [margin.on_grid for name, margin in certificate.margins.items() if name.startswith("contact of")]
        assert len(contacts) == 3
        assert min(contacts) < 0.01


@pytest.mark.parametrize(
    ("values", "limit"),
    [
        ({"contact.friction": 0.2}, "contact of"),
        ({"uncertainty.base_acceleration": 0.4}, "contact of"),
        ({"uncertainty.contact_points": 0.02}, "contact of"),
        ({"uncertainty.center_of_mass": {"torso": [0.03, 0.03, 0.0]}}, "contact of"),
        ({"uncertainty.mass": {"torso": [7.0, 20.0]}}, "contact of"),
    ],
)
def test_a_plan_for_less_uncertainty_fails_its_certificate(plan: Plan, values: dict[str, Any], limit: str) -> None:
    certificate = certify(plan, config=with_values(plan.problem.config, values))
    assert not certificate.passed
    assert certificate.worst.limit.startswith(limit)
    assert certificate.worst.on_grid or certificate.margins[certificate.worst.limit].on_grid < 0


def test_a_full_certificate_agrees_and_is_the_same_again(problem: TimeScalingProblem, plan: Plan) -> None:
    quick, again = certify(plan, seed=3), certify(plan, seed=3, config=with_values(problem.config, {}))
    assert quick == again


def test_the_certificate_stands_on_one_foot_at_every_switch_of_three_steps() -> None:
    """Rounding separates k / 7 from the switches of the path, and a switch counted as one on both feet."""
    steps = (
        "path.steps=[{foot: right, to: [0.1, -0.16]}, {foot: left, to: [0.2, 0.16]}, {foot: right, to: [0.2, -0.16]}]"
    )
    problem = build_problem(configured(steps))
    at = SimpleNamespace(s=problem.path.switches)
    standing = stances(problem.path, at)
    assert [len(problem.path.stances[k].contacts) for k in standing] == [1] * 6


def test_base_and_joints_require_the_forces_of_mujocos_inverse_dynamics(
    problem: TimeScalingProblem, plan: Plan
) -> None:
    """With random masses, centres of mass and errors, and the torques of a foot that stands alone."""
    config = with_values(problem.config, UNCERTAIN)
    at = instants(plan, ())
    stance = stances(plan.problem.path, at)
    world = build_world(config, problem.robot, problem.path, stance)
    moving, joints = motion(task_of(plan), at, world.links)
    here = np.flatnonzero((stance == 1) & (at.free > 0))[::7]
    values = world.sample(np.random.default_rng(4), 1, corners=False).at(0).repeated(len(here))
    there = moving.at(here)
    loads = body_loads(world, there, values)
    (contact,) = problem.path.stances[1].contacts
    base = required_by_base(world, there, loads, values.error)
    torque = torques(world, joints.at(here).standing_on(contact, there), there.free, loads, values)
    names = [body.name for body in world.bodies]
    bodies = {
        name: (
            values.mass[names.index(name), 0],
            problem.robot.inertia_of(name)[1] + values.com[names.index(name), :, 0],
        )
        for name in world.links
    }
    s, sd = at.s[here], np.sqrt(at.x[here])[:, None]
    q, q1, q2 = (problem.path(s, order) for order in range(3))
    qdd = q1 * at.u[here][:, None] + q2 * sd**2 + values.error.T
    force, _, jacobians = problem.robot.inverse_dynamics(q, q1 * sd, qdd, bodies)
    np.testing.assert_allclose(base.T, force[:, :BASE], rtol=1e-8, atol=1e-6)
    expected = force[:, BASE:] - np.einsum("tkm,tk->tm", jacobians[contact][:, :, BASE:], force[:, :BASE])
    np.testing.assert_allclose(torque.T, expected, rtol=1e-8, atol=1e-6)


# Planned forces -------------------------------------------------------------------------------------------


def test_standing_still_both_feet_share_the_weight_evenly(plan: Plan) -> None:
    forces, walker = planned_forces(plan), walker_of(plan.problem)
    for instant in (0, -1):
        for name in walker.contacts:
            np.testing.assert_allclose(forces.total(name)[instant], [0, 0, 0.5 * walker.mass * 9.81], atol=1e-5)
        center = footsteps(plan.problem.config).com(forces.s[instant])
        np.testing.assert_allclose(forces.center_of_pressure()[instant], center, atol=1e-6)


def test_planned_forces_are_possible_and_make_the_motion(plan: Plan) -> None:
    """In the cones of the believed friction, none in the air, and with them MuJoCo needs no push on the base."""
    forces, walker = planned_forces(plan), walker_of(plan.problem)
    model, data = free_model(), mujoco.MjData(free_model())
    assert forces.residual.max() < 1e-6
    for name, pushes in forces.forces.items():
        size = np.hypot(pushes[..., 0], pushes[..., 1])
        assert (size <= 0.3 * pushes[..., 2] + 1e-9).all()
        assert (pushes[..., 2] >= 0.0).all()
        in_air = [name not in stance.places for stance in plan.problem.path.stances]
        middle = 0.5 * (forces.s[1:-1:2] + forces.s[2:-1:2])
        flying = np.repeat(np.array(in_air)[np.minimum((5 * middle).astype(int), 4)], 2)
        assert np.all(forces.total(name)[1:-1][flying] == 0.0)
    u, x = np.repeat(plan.u, 2), np.column_stack([plan.x[:-1], plan.x[1:]]).ravel()
    q, q1, q2 = (plan.problem.path(forces.s[1:-1], order) for order in range(3))
    for k in range(0, len(u), 7):
        data.qpos[:], data.qvel[:] = walker.qpos(q[k : k + 1])[0], q1[k] * np.sqrt(x[k])
        data.qacc[:] = q1[k] * u[k] + q2[k] * x[k]
        mujoco.mj_inverse(model, data)
        need = data.qfrc_inverse.copy()
        for name, pushes in forces.forces.items():
            body = model.site(name).bodyid[0]
            jacobian = np.zeros((3, N))
            for push, point in zip(pushes[k + 1], forces.points[name][k + 1], strict=True):
                if np.any(push):
                    mujoco.mj_jac(model, data, jacobian, None, point, body)
                    need -= jacobian.T @ push
        np.testing.assert_allclose(need[:BASE], 0.0, atol=1e-3)
        np.testing.assert_allclose(need[BASE:], forces.torque[k + 1, BASE:], atol=1e-3)


def test_a_foot_that_lifts_or_lands_does_so_gently(plan: Plan) -> None:
    """Its force is next to nothing at the switch: the last instant on both feet and the first on one agree."""
    forces, weight = planned_forces(plan), walker_of(plan.problem).mass * 9.81
    contacts = plan.problem.limits.contacts
    for earlier, later in pairwise(contacts):
        before, after = 2 * later.first, 2 * later.first + 1
        assert forces.t[before] == forces.t[after]
        for name in forces.forces:
            stood, stands = name in earlier.system.contacts, name in later.system.contacts
            if stood != stands:
                assert forces.total(name)[before if stood else after, 2] < 0.02 * weight


def test_forces_are_sampled_in_time(plan: Plan) -> None:
    forces = planned_forces(plan)
    torque, feet = forces.sample(np.array([-1.0, 0.5 * (forces.t[7] + forces.t[8]), forces.t[-1] + 1.0]))
    np.testing.assert_allclose(torque[0], forces.torque[0])
    np.testing.assert_allclose(torque[1], 0.5 * (forces.torque[7] + forces.torque[8]), atol=1e-9)
    np.testing.assert_allclose(feet["left_foot"][2], forces.total("left_foot")[-1])


# Outputs --------------------------------------------------------------------------------------------------


def test_every_figure_is_drawn(plan: Plan) -> None:
    with house_style():
        drawn = figures(plan, plan.problem.config)
    joints = {f"joints_{k}" for k in range(1, 5)}
    assert {"phase_plane", "feet", "footprints", "contacts", "binding"} | joints == set(drawn)


def test_the_command_plans_and_writes_a_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["plan", str(CONFIG), "--out", str(tmp_path / "run"), "--json", "--no-figures"]) == 0
    summary = json.loads(capsys.readouterr().out)
    assert summary["status"] == "solved"
    assert summary["certificate"]["passed"]
    assert 3.0 < summary["duration"] < 4.2
    assert run(["plan", str(CONFIG), "--dry-run", "--quiet"]) == 0
    assert run(["validate", str(CONFIG), "--quiet"]) == 0


def test_too_little_friction_is_infeasible_in_words(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["plan", str(CONFIG), "contact.friction=0.02", "solver.collocation_points=60", "--out"]
    assert run([*arguments, str(tmp_path / "run"), "--json", "--no-figures"]) == 3
    diagnosis = json.loads(capsys.readouterr().out)["diagnosis"]
    assert any("slip of both feet" in conflict for conflict in diagnosis["conflicts"])
    assert any(remedy["sentence"].startswith("contact.friction: at least") for remedy in diagnosis["remedies"])


# Configuration --------------------------------------------------------------------------------------------

MISTAKES = [
    ("objects={box: {shape: box, size: [0.1, 0.1, 0.1], mass: 1}}", "tray", "missing, but box stands on it"),
    ("robot.locked={waist: 0}", "robot.locked", "not allowed with path.steps"),
    ("path.blend=0.1", "path.blend", "not allowed with path.steps"),
    ("robot.base={position: [1, 0, 0]}", "robot.base", "path.start gives the place"),
    ("path.steps.0.foot=middle", "path.steps[0].foot", "expected one of left, right"),
    ("path.steps.1.foot=right", "path.steps[1].foot", "expected alternating feet"),
    ("path.steps=[]", "path.steps", "found no steps"),
    ("path.steps.0.to=[0, -0.16]", "path.steps[0].to", "stands there already"),
    ("path.steps.0.to=[0.2, 0.3]", "path.steps[0].to", "the feet would cross"),
    ("path.start=null", "path.start", "missing; expected the positions of the feet"),
    ("path.start=[0, 1]", "path.start", "found joint positions; expected the positions of the feet"),
    ("path.start={left: [0, -0.16], right: [0, 0.16]}", "path.start", "not to the left"),
    ("path.joints=[[0], [1]]", "path", "found both of joints and steps"),
    ("solver.cost=effort", "solver.cost", "found effort with path.steps"),
    ("solver.collocation_points=20", "solver.collocation_points", "expected at least 40"),
    ("uncertainty.base_acceleration=[1, 2]", "uncertainty.base_acceleration", "expected one, or six"),
    ("contact.friction={left_foot: 0.3}", "contact.friction", "no value for right_foot; expected one for each object"),
    ("contact.friction={left_foot: 0.3, hand: 1}", "contact.friction.hand", "expected one of left_foot, right_foot"),
    ("uncertainty.friction={left_foot: [0.4, 0.5]}", "uncertainty.friction.left_foot", "does not contain"),
    ("uncertainty.contact_points={hand: 0.1}", "uncertainty.contact_points.hand", "nothing is called hand"),
]


@pytest.mark.parametrize(
    ("override", "key", "words"), MISTAKES, ids=[key + override[-9:] for override, key, _ in MISTAKES]
)
def test_a_mistake_names_its_key_and_what_would_be_right(override: str, key: str, words: str) -> None:
    with pytest.raises(ConfigError) as caught:
        load_config(CONFIG, [override])
    found = {problem.key: problem.message for problem in caught.value.problems}
    assert words in found.get(key, ""), found


@pytest.mark.parametrize(
    ("steps", "key"),
    [
        ("[{foot: left, to: [0.2, -0.3], yaw: 0.3}]", "path.steps[0].yaw"),
        ("[{foot: left, to: [0.2, -0.3, 0.1]}]", "path.steps[0].to"),
        ("3", "path.steps"),
    ],
)
def test_steps_that_are_wrong_are_not_taken_for_a_task_with_a_tray(steps: str, key: str) -> None:
    with pytest.raises(ConfigError) as caught:
        load_config(CONFIG, ["path.start={left: [0, -0.3], right: [0, -0.6]}", f"path.steps={steps}"])
    assert [problem.key for problem in caught.value.problems] == [key]


@pytest.mark.parametrize(
    ("override", "kind", "key", "words"),
    [
        ("uncertainty.center_of_mass={belly: [0, 0, 0.1]}", RobotError, "uncertainty.center_of_mass.belly", "no body"),
        (
            "uncertainty.mass={torso: [1, 2]}",
            RobotError,
            "uncertainty.mass.torso",
            "does not contain the model's mass, 14",
        ),
        (
            "uncertainty.contact_points=0.06",
            ConfigError,
            "uncertainty.contact_points",
            "leaves no certain part of left_foot",
        ),
        ("robot.limits={left_knee: {dry_friction: 1}}", RobotError, "robot.joint_friction", "joint_friction: false"),
        ("robot.model=tx90l", RobotError, "robot.model", "tx90l.xml has no free joint"),
        ("tray={size: [0.3, 0.3, 0.01], mass: 1}", RobotError, "robot.tool", "has no site or body 'flange'"),
    ],
)
def test_what_only_the_model_shows_is_an_error_of_its_key(override: str, kind: Any, key: str, words: str) -> None:
    with pytest.raises(kind) as caught:
        build_problem(configured(override))
    assert caught.value.problems[0].key == key
    assert words in caught.value.problems[0].message


@pytest.mark.parametrize(
    ("place", "addition", "words"),
    [
        ('<joint name="left_knee"', ' stiffness="20"', "has springs in left_knee"),
        (
            "<actuator>",
            '<tendon><fixed name="t" stiffness="9"><joint joint="waist" coef="1"/></fixed></tendon>',
            "has springs in t",
        ),
        ("<actuator>", '<equality><joint name="e" joint1="left_elbow"/></equality>', "equality constraints (e)"),
    ],
)
def test_a_walker_whose_simulation_has_forces_that_plans_do_not_count_is_refused(
    tmp_path: Path, place: str, addition: str, words: str
) -> None:
    text = (MODELS / "humanoid.xml").read_text()
    assert place in text
    changed = addition + place if addition.startswith("<") else place + addition
    (tmp_path / "own.xml").write_text(text.replace(place, changed))
    with pytest.raises(RobotError) as caught:
        build_problem(configured(f"robot.model={tmp_path / 'own.xml'}"))
    assert words in str(caught.value)


def test_an_arm_has_a_tray_and_no_base_acceleration() -> None:
    waiter = CONFIG.parent / "waiter_two_blocks.yaml"
    with pytest.raises(ConfigError) as caught:
        load_config(
            waiter, ["tray=null", "uncertainty.base_acceleration=1", "path.start={left: [0, 1], right: [0, 0]}"]
        )
    assert {"tray", "uncertainty.base_acceleration", "path.start"} <= {p.key for p in caught.value.problems}


# In MuJoCo ------------------------------------------------------------------------------------------------


def on_the_floor(friction: float) -> mujoco.MjModel:
    """The shipped model, all as in its file, on a floor."""
    spec = mujoco.MjSpec.from_file(str(MODELS / "humanoid.xml"))
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[5, 5, 0.1])
    model = spec.compile()
    model.geom_friction[np.array(model.geom_priority) == 1, 0] = friction
    return model


@pytest.mark.parametrize(("believed", "slips"), [(0.2, False), (0.8, True)])
def test_the_planned_torques_make_the_model_walk_without_any_balance(believed: float, slips: bool) -> None:
    """Open loop: joint gains of the file and the planned torques; it slips only where less friction was there than
    the plan believed."""
    plan = solve(build_problem(load_config(CONFIG, [f"contact.friction={believed}"])))
    model, walker = on_the_floor(0.2), walker_of(plan.problem)
    data = mujoco.MjData(model)
    t = np.arange(-0.3, plan.duration + 0.7, model.opt.timestep)
    wanted, (torque, _) = Trajectory.from_plan(plan).sample(t), planned_forces(plan).sample(t)
    kp, kd = model.actuator_gainprm[:, 0], -model.actuator_biasprm[:, 2]
    control = wanted.q[:, BASE:] + (kd * wanted.qd[:, BASE:] + torque[:, BASE:]) / kp
    data.qpos[:] = walker.qpos(wanted.q[:1])[0]
    for row in control:
        data.ctrl[:] = row
        mujoco.mj_step(model, data)
    goal = walker.qpos(wanted.q[-1:])[0]
    off = np.abs(data.qpos[:2] - goal[:2]).max()
    assert abs(data.qpos[2] - goal[2]) < 0.002
    assert data.body("torso").xmat[8] > np.cos(0.01)
    assert (off > 0.01) if slips else (off < 0.002)


# Found by learners -----------------------------------------------------------------------------------------


def test_forces_that_rounding_errors_keep_from_balancing_are_found_all_the_same() -> None:
    """Of 77,000 force programs of this plan one stopped 4e-8 short of balance, and counted as impossible."""
    config = load_config(CONFIG, ["contact.friction={left_foot: 0.142262, right_foot: 0.142262}"])
    certificate = certify(solve(build_problem(config)), "quick", 0)
    assert certificate.passed
    assert certificate.margin > -0.01


@pytest.mark.slow
def test_a_learner_plans_on_a_finer_grid_where_limits_are_left_between_points() -> None:
    config = load_config(CONFIG)
    belief = Belief(parameters=(("contact.friction.left_foot", 0.1), ("contact.friction.right_foot", 0.1)))
    coarse = Planner(config, certified=False).plan(belief).plan
    assert not certify(coarse, "quick", 0, believing_config(config, belief)).passed
    result = Planner(config).plan(belief)
    assert result.certified
    assert len(result.plan.s) == 2 * len(coarse.s) - 1
    assert result.plan.duration == pytest.approx(coarse.duration, rel=0.01)
