"""Intervals of the parameters: the wrenches and torques that the rows assume, against mechanics body by body."""

from __future__ import annotations

from functools import cache
from typing import Any

import mechanics
import mujoco
import numpy as np
import pytest
from scenes import BOX, FLAT, scene, waiter
from scipy.spatial.transform import Rotation

from robustopt.config import Config
from robustopt.limits import TimeScalingProblem
from robustopt.limits.bodies import INERTIA_TERMS, regressor, spin_regressor
from robustopt.limits.formulas import worst_wrench
from robustopt.limits.polygons import evaluate, facet_family
from robustopt.limits.uncertainty import acceleration_error, bodies, uncertainty_of
from robustopt.robot.preparation import CARRIER_SITE
from robustopt.solvers import build_problem

NONE, NO_TERMS = np.zeros((0, 0, 3)), np.zeros((0, 0, 0))

FEW = "solver.collocation_points=10"

SETS = {
    "nothing": "uncertainty={}",
    "acceleration": "uncertainty={joint_acceleration: {mean: [0.1, -0.2, 0, 0, 0.3, 0], deviation: 0.3, K: 1.5}}",
    "mass": "uncertainty={mass: {crate: [1.0, 1.4], tray: [0.8, 1.1], lid: [0.1, 0.2]}}",
    "centre of mass": "uncertainty={center_of_mass: {crate: [0.01, 0.004, 0.02], bottle: [0, 0, 0.03], "
    "lid: [0.01, 0, 0]}, inertia: {crate: [1, 1], bottle: [1, 1], lid: [1, 1]}}",
    "all": "uncertainty={mass: {crate: [1.0, 1.4], bottle: [0.7, 0.9]}, center_of_mass: {crate: [0.01, 0.004, 0.02], "
    "tray: [0.01, 0, 0], lid: [0.005, 0.005, 0]}, inertia: {crate: [1, 1], tray: [1, 1], lid: [1, 1]}, "
    "joint_acceleration: {deviation: [0.3, 0.1, 0, 0.2, 0, 0.4]}}",
}


@cache
def uncertain_problem(kind: str) -> TimeScalingProblem:
    """Objects with centres of mass off their middles, one turned, one on top of another; a path that turns the tray."""
    return build_problem(
        waiter("side_by_side", FEW, SETS[kind], "objects.crate.inertia=[0.003,0.004,0.005,0.001,0,0.0005]")
    )


def some_points(problem: TimeScalingProblem, count: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    return rng.integers(len(problem.s), size=count), rng.normal(scale=4.0, size=count), rng.uniform(0.0, 4.0, count)


# Parameters ----------------------------------------------------------------------------------------------


def test_regressor_is_newton_and_euler_about_another_point() -> None:
    rng = np.random.default_rng(0)
    a, alpha, omega, r = rng.normal(size=(4, 3))
    mass, root = 0.7, rng.normal(size=(3, 3))
    central = root @ root.T
    about_origin = central + mass * (r @ r * np.eye(3) - np.outer(r, r))
    phi = np.r_[mass, mass * r, [about_origin[i, j] for i, j in INERTIA_TERMS]]
    force = mass * (a + np.cross(alpha, r) + np.cross(omega, np.cross(omega, r)))
    moment = central @ alpha + np.cross(omega, central @ omega) + np.cross(r, force)
    np.testing.assert_allclose((regressor(a, alpha) + spin_regressor(omega)) @ phi, np.r_[force, moment], atol=1e-12)


def test_parameters_of_a_body_hold_every_displaced_centre_of_mass() -> None:
    """phi of a displaced body of known inertia equals psi, the linear terms and the squares of the displacement."""
    objects = {"crate": BOX | {"at": [0.1, -0.05], "yaw": 0.4, "center_of_mass": [0.01, 0.0, -0.02]}}
    reach = np.array([0.02, 0.01, 0.03])
    given = {"center_of_mass": {"crate": reach.tolist()}, "inertia": {"crate": [1, 1]}}
    body = bodies(scene(objects=objects, uncertainty=given))["crate"]
    turn = Rotation.from_euler("z", 0.4).as_matrix()
    rng = np.random.default_rng(1)
    for zeta in [*rng.uniform(-1, 1, (20, 3)), np.ones(3), np.zeros(3)]:
        moved = objects["crate"] | {"center_of_mass": (np.array([0.01, 0.0, -0.02]) + zeta * reach).tolist()}
        exact = bodies(scene(objects={"crate": moved}))["crate"].psi
        squares = np.r_[zeta**2, zeta[0] * zeta[1], zeta[0] * zeta[2], zeta[1] * zeta[2]]
        np.testing.assert_allclose(exact, body.psi + zeta @ body.linear + squares @ body.moments, atol=1e-15)
    np.testing.assert_allclose(body.linear[:, 1:4], (turn * reach).T, atol=1e-15)


def friction(config: Config) -> dict[str, float]:
    return uncertainty_of(config, 1, 0).worst_friction


def contact_shift(config: Config) -> dict[str, float]:
    return dict(uncertainty_of(config, 1, 0).contact_points)


def test_friction_is_the_lowest_believed_of_each_interface() -> None:
    objects = {"a": FLAT, "b": FLAT | {"on": "a"}, "c": FLAT | {"on": "b"}}
    assert friction(scene(objects=objects, contact={"friction": 0.4})) == {"a": 0.4, "b": 0.4, "c": 0.4}
    by_name = scene(
        objects=objects,
        contact={"friction": {"default": 0.4, "b": 0.3}},
        uncertainty={"friction": {"default": [0.2, 0.6], "c": [0.1, 0.9]}},
    )
    assert friction(by_name) == {"a": 0.2, "b": 0.2, "c": 0.1}
    partly = scene(objects=objects, contact={"friction": 0.4}, uncertainty={"friction": {"c": [0.1, 0.9]}})
    assert friction(partly) == {"a": 0.4, "b": 0.4, "c": 0.1}


def test_contact_shift_and_acceleration_error_read_one_value_or_one_each() -> None:
    objects = {"a": BOX, "b": BOX | {"on": "a"}}
    assert contact_shift(scene(objects=objects)) == {"a": 0.0, "b": 0.0}
    assert contact_shift(scene(objects=objects, uncertainty={"contact_points": 0.002})) == {"a": 0.002, "b": 0.002}
    named = scene(objects=objects, uncertainty={"contact_points": {"default": 0.001, "b": 0.003}})
    assert contact_shift(named) == {"a": 0.001, "b": 0.003}
    each = {"joint_acceleration": {"mean": [0.1, 0.2], "deviation": 0.3, "K": 2.0}}
    middle, radius = acceleration_error(scene("two_slides", uncertainty=each), 2, 0).arrays
    np.testing.assert_allclose(middle, [0.1, 0.2])
    np.testing.assert_allclose(radius, [0.6, 0.6])


# Wrenches ------------------------------------------------------------------------------------------------


def rows_of(problem: TimeScalingProblem, B: np.ndarray, family: Any, points: Any, u: Any, x: Any) -> np.ndarray:
    return evaluate(facet_family(B, family.loads, np.arange(len(B))), points, u, x)


@pytest.mark.parametrize("kind", ["nothing", "acceleration"])
def test_loads_are_what_newton_and_euler_require(kind: str) -> None:
    """Without intervals the load is exact; with an acceleration error it is that of its mean."""
    problem = uncertain_problem(kind)
    points, u, x = some_points(problem, 12)
    draw = mechanics.nominal(problem)
    for family in problem.limits.contacts:
        (names,), (about,) = family.system.loads, family.system.points
        expected = [
            mechanics.required_wrench(
                problem.config, names, draw, mechanics.tray_motion(problem, *values, draw.error), about
            )
            for values in zip(points, u, x, strict=True)
        ]
        np.testing.assert_allclose(family.wrench(points, u, x), expected, rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("kind", SETS)
def test_no_draw_of_the_parameters_exceeds_a_row(kind: str) -> None:
    problem = uncertain_problem(kind)
    points, u, x = some_points(problem, 6, seed=1)
    rng = np.random.default_rng(2)
    for family in problem.limits.contacts:
        (names,), (about,) = family.system.loads, family.system.points
        B = rng.normal(size=(20, 6)) / np.array([1.0, 1.0, 1.0, 0.05, 0.05, 0.05])
        bound = rows_of(problem, B, family, points, u, x)
        for k, values in enumerate(zip(points, u, x, strict=True)):
            for draw in mechanics.random_draws(problem, 12, rng):
                motion = mechanics.tray_motion(problem, *values, draw.error)
                found = B @ mechanics.required_wrench(problem.config, names, draw, motion, about)
                assert (found <= bound[k] + 1e-4 * np.abs(B).sum(axis=1)).all()


@pytest.mark.parametrize(("kind", "loss"), [("acceleration", 1e-4), ("mass", 1e-4), ("centre of mass", 0.02)])
def test_some_corner_of_the_box_attains_a_row(kind: str, loss: float) -> None:
    """Exact for acceleration errors and masses; squares of the centre of mass cost a little of the margin.

    The 3^n - 1 corners are not enumerated where the load is linear in each parameter: 2^n are enough.
    """
    problem = uncertain_problem(kind)
    points, u, x = some_points(problem, 2, seed=3)
    rng = np.random.default_rng(4)
    family = problem.limits.contacts[[f.system.objects for f in problem.limits.contacts].index(("crate",))]
    (names,), (about,) = family.system.loads, family.system.points
    B = rng.normal(size=(20, 6)) / np.array([1.0, 1.0, 1.0, 0.05, 0.05, 0.05])
    bound = rows_of(problem, B, family, points, u, x)
    nominal = np.einsum("fd,md->mf", B, family.wrench(points, u, x))
    for k, values in enumerate(zip(points, u, x, strict=True)):
        found = np.max(
            [
                B
                @ mechanics.required_wrench(
                    problem.config, names, draw, mechanics.tray_motion(problem, *values, draw.error), about
                )
                for draw in mechanics.corners(problem)
            ],
            axis=0,
        )
        margin = bound[k] - nominal[k]
        assert (bound[k] - found <= loss * margin + 1e-4 * np.abs(B).sum(axis=1)).all()
        assert (margin > 1e-3).all()


@pytest.mark.parametrize("kind", SETS)
def test_the_worst_wrench_attains_what_a_row_evaluates_to(kind: str) -> None:
    problem = uncertain_problem(kind)
    points, u, x = some_points(problem, 30, seed=5)
    for family in problem.limits.contacts:
        y = np.random.default_rng(6).normal(size=(30, 6))
        worst = worst_wrench(family.loads.at(points), y, u, x)
        values = np.diagonal(rows_of(problem, y, family, points, u, x))
        np.testing.assert_allclose(np.einsum("md,md->m", y, worst), values, rtol=1e-9, atol=1e-9)


# Torques -------------------------------------------------------------------------------------------------


def torque_by_mujoco(problem: TimeScalingProblem, point: int, u: float, x: float, draw: mechanics.Draw) -> np.ndarray:
    """Inverse dynamics of the arm with the tray and the objects welded to it, and joint friction against the path."""
    config, robot = problem.config, problem.robot
    spec = robot.spec.copy()
    tool = next(site for site in spec.sites if site.name == CARRIER_SITE).parent
    model = spec.compile()
    site = model.site(CARRIER_SITE)
    for name in ("tray", *config.objects):
        body = config.tray if name == "tray" else config.objects[name]
        placed = mechanics.placements(config)
        origin = np.zeros(3) if name == "tray" else placed[name].position
        turn = Rotation.from_euler("z", 0.0 if name == "tray" else placed[name].yaw)
        r = origin + turn.apply(np.array(body.center_of_mass) + draw.shift.get(name, np.zeros(3)))
        factor = draw.mass.get(name, 1.0)
        full = factor * turn.as_matrix() @ mechanics.inertia(config, name) @ turn.as_matrix().T
        part = tool.add_body(name=f"load_{name}", pos=site.pos, quat=site.quat)
        part.mass, part.ipos = factor * body.mass, r
        part.fullinertia = [full[0, 0], full[1, 1], full[2, 2], full[0, 1], full[0, 2], full[1, 2]]
        part.explicitinertial = True
    model = spec.compile()
    for bit in (mujoco.mjtDisableBit.mjDSBL_CONSTRAINT, mujoco.mjtDisableBit.mjDSBL_DAMPER):
        model.opt.disableflags |= int(bit)
    data = mujoco.MjData(model)
    q, q1, q2 = (problem.path.evaluate(problem.s[[point]], problem.piece[[point]], order)[0] for order in range(3))
    data.qpos[:], data.qvel[:], data.qacc[:] = q, q1 * np.sqrt(x), q1 * u + q2 * x + draw.error
    mujoco.mj_inverse(model, data)
    limits = robot.limits
    return data.qfrc_inverse + limits.dry_friction * np.sign(q1) + limits.viscous_friction * q1 * np.sqrt(x)


def turns(problem: TimeScalingProblem, point: int) -> np.ndarray:
    """Which joints turn around between a grid point and its neighbours."""
    q1 = problem.path.evaluate(problem.s, problem.piece, 1)[point - 1 : point + 2]
    return np.ptp(np.sign(q1), axis=0) > 0


@pytest.mark.parametrize("kind", ["nothing", "mass", "all"])
def test_torques_are_mujoco_s_with_the_load_welded_on(kind: str) -> None:
    problem = uncertain_problem(kind)
    points, u, x = some_points(problem, 5, seed=7)
    points = np.clip(points, 1, len(problem.s) - 2)
    limit = problem.robot.limits.torque
    excess = problem.limits.torque.sides(u, x, points)
    np.testing.assert_array_equal(problem.limits.torque.excess(u, x, points), np.maximum(excess[:, :6], excess[:, 6:]))
    for k, largest in enumerate(excess.max(axis=1)):
        at = u[[k]], x[[k]], points[[k]]
        assert problem.torque_exceeds(largest - 1e-9, *at)
        assert not problem.torque_exceeds(largest + 1e-9, *at)
    rng = np.random.default_rng(8)
    for k, (point, uk, xk) in enumerate(zip(points, u, x, strict=True)):
        for draw in [mechanics.nominal(problem), *mechanics.random_draws(problem, 6, rng)]:
            tau = torque_by_mujoco(problem, point, uk, xk, draw) / limit
            slack = excess[k] + 1 - np.r_[tau, -tau]
            # where a joint turns around between grid points, dry friction counts both ways
            assert (slack >= -1e-9).all()
            if kind == "nothing":
                share = 2 * problem.robot.limits.dry_friction / limit
                helped = np.where(slack[:6] > slack[6:], slack[:6], slack[6:])
                np.testing.assert_allclose(np.minimum(slack[:6], slack[6:]), 0.0, atol=1e-9)
                np.testing.assert_allclose(helped, np.where(turns(problem, point), share, 0.0), atol=1e-9)


def test_nominal_torques_of_a_plan_are_in_newton_metres() -> None:
    """Where a joint turns around, the nominal torque is that without its dry friction."""
    problem = uncertain_problem("nothing")
    P = len(problem.s)
    u, x = np.full(P, 0.7), np.full(P, 0.4)
    torques = problem.torques(u, x)
    for point in (2, 5, 8):
        dry = np.where(turns(problem, point), problem.robot.limits.dry_friction, 0.0)
        dry *= np.sign(problem.path.evaluate(problem.s[[point]], problem.piece[[point]], 1)[0])
        expected = torque_by_mujoco(problem, point, 0.7, 0.4, mechanics.nominal(problem))
        np.testing.assert_allclose(torques[point], expected - dry, rtol=1e-6, atol=1e-6)
