"""Certificate: closed forms of sliding and tipping on simple robots, MuJoCo as oracle, and plans that must fail."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import mujoco
import numpy as np
import pytest
from scenes import scene, waiter
from scipy.optimize import linprog

from robustopt.certificate import LEVELS, Certificate, certify
from robustopt.certificate.balance import balance
from robustopt.certificate.bodies import Body, Parameters
from robustopt.certificate.force_closure import GAP
from robustopt.certificate.joints import KnownTorques, torques
from robustopt.certificate.loads import body_loads
from robustopt.certificate.motion import Motion, instants, motion, stances
from robustopt.certificate.samples import check_samples
from robustopt.certificate.systems import System
from robustopt.certificate.tally import Tally
from robustopt.certificate.task import task_of
from robustopt.certificate.world import World, build_world
from robustopt.certificate.worst import Search, Thoroughness
from robustopt.config import Config
from robustopt.errors import SolverFailed
from robustopt.robot import load_robot
from robustopt.robot.preparation import CARRIER_SITE
from robustopt.solvers import Plan

G = 9.81
LOW = {"shape": "box", "size": [0.2, 0.2, 0.04], "mass": 0.5}
"""A box that slides before it tips: its half width is five times the height of its centre."""
TALL = {"shape": "box", "size": [0.1, 0.1, 0.4], "mass": 0.5}
"""A box that tips at a quarter of gravity."""


class OnePiece:
    """A path of one piece."""

    stances = switches = ()
    pauses, end_speeds = 0.0, (0.0, 0.0)

    def __call__(self, s: np.ndarray, order: int = 0) -> np.ndarray:
        return self.evaluate(s, np.zeros(len(s), dtype=int), order)

    def fine_grid(self) -> np.ndarray:
        return np.linspace(0.0, 1.0, 21)


class LinePath(OnePiece):
    """q(s) = start + s direction, one piece."""

    def __init__(self, direction: list[float]) -> None:
        self.direction = np.array(direction)

    def evaluate(self, s: np.ndarray, piece: np.ndarray, order: int = 0) -> np.ndarray:
        values = (s, np.ones_like(s), np.zeros_like(s))[order]
        return values[:, None] * self.direction


class CubicPath(OnePiece):
    """q(s) = bend @ (s, s^2, s^3)."""

    def __init__(self, bend: np.ndarray) -> None:
        self.bend = bend

    def evaluate(self, s: np.ndarray, piece: np.ndarray, order: int = 0) -> np.ndarray:
        powers = np.stack([[s, s**2, s**3], [np.ones_like(s), 2 * s, 3 * s**2], [0 * s, 2 + 0 * s, 6 * s]][order])
        return powers.T @ self.bend


class BumpPath(OnePiece):
    """One joint: q'' is a half wave of height `bump` for s between 0.4 and 0.6, and 0 elsewhere."""

    def __init__(self, bump: float) -> None:
        self.bump = bump

    def evaluate(self, s: np.ndarray, piece: np.ndarray, order: int = 0) -> np.ndarray:
        k, d = np.pi / 0.2, np.clip(s - 0.4, 0.0, 0.2)
        after = np.maximum(s - 0.6, 0.0)
        position = s + self.bump / k * (d - np.sin(k * d) / k + 2.0 * after)
        terms = (position, 1.0 + self.bump / k * (1.0 - np.cos(k * d)), self.bump * np.sin(k * d))
        return np.asarray(terms[order][:, None])


def timing(config: Config, path: Any, u: np.ndarray) -> Any:
    """A plan with the given u on a uniform grid; x starts and must end at 0."""
    s = np.linspace(0.0, 1.0, len(u) + 1)
    x = np.concatenate([[0.0], np.cumsum(2.0 * np.diff(s) * u)])
    x[-1] = 0.0 if abs(x[-1]) < 1e-12 else x[-1]
    problem = SimpleNamespace(path=path, robot=load_robot(config), config=config, limits=SimpleNamespace(laws={}))
    piece = np.zeros(len(s), dtype=np.intp)
    return SimpleNamespace(s=s, piece=piece, x=x, u=u, u_end=u, change=0 * u, steady=True, problem=problem)


def there_and_stop(config: Config, acceleration: float, path: Any = None, intervals: int = 10) -> Any:
    """Speed up along the first half of the path and brake along the second; the path is 1 m of the first joint."""
    joints = load_robot(config).n
    path = path or LinePath([1.0] + [0.0] * (joints - 1))
    return timing(config, path, np.repeat([acceleration, -acceleration], intervals // 2))


def seen(config: Config, plan: Any, between: tuple[float, ...] = ()) -> tuple[World, Motion, Any]:
    """World and motion of a plan, and its instants."""
    at = instants(plan, between)
    world = build_world(config, plan.problem.robot, plan.problem.path, stances(plan.problem.path, at))
    return world, motion(task_of(plan), at, world.links)[0], at


def margin(certificate: Certificate, limit: str) -> float:
    return certificate.margins[limit].on_grid


def on_slide(objects: dict[str, Any], mu: float = 0.5, **sections: Any) -> Config:
    return scene("slide", objects, contact={"friction": mu}, **sections)


# Closed forms: one object ---------------------------------------------------------------------------------


@pytest.mark.parametrize(("mu", "acceleration"), [(0.5, 2.0), (0.2, 1.5), (0.2, 2.5)])
def test_sliding(mu: float, acceleration: float) -> None:
    config = on_slide({"box": LOW}, mu)
    certificate = certify(there_and_stop(config, acceleration))
    assert margin(certificate, "contact of box on tray") == pytest.approx(1 - acceleration / (mu * G), abs=1e-7)
    assert certificate.passed == (acceleration <= mu * G)
    if not certificate.passed:
        assert certificate.worst.limit == "slip of box on tray"
        assert certificate.worst.parameters["friction"] == {"box on tray": mu}
        assert "fails its certificate" in certificate.sentence
        assert "collocation_points" not in certificate.sentence


@pytest.mark.parametrize("angle", [0.0, 0.3, np.pi / 4, 2.0])
def test_sliding_is_the_same_in_every_direction(angle: float) -> None:
    """An exact cone has no edges."""
    config = scene("two_slides", {"box": LOW}, contact={"friction": 0.5})
    plan = there_and_stop(config, 3.0, LinePath([np.cos(angle), np.sin(angle)]))
    assert margin(certify(plan), "contact of box on tray") == pytest.approx(1 - 3.0 / (0.5 * G), abs=1e-7)


@pytest.mark.parametrize("acceleration", [2.0, 2.4525, 2.6])
def test_tipping(acceleration: float) -> None:
    config = on_slide({"box": TALL}, 1.0)
    certificate = certify(there_and_stop(config, acceleration))
    assert margin(certificate, "contact of box on tray") == pytest.approx(1 - acceleration / (G / 4), abs=1e-7)
    assert certificate.passed == (acceleration <= G / 4)
    if not certificate.passed:
        assert certificate.worst.limit == "tipping of box over tray"


def test_an_offset_center_of_mass_tips_towards_its_side() -> None:
    """Braking tips forwards: the centre of pressure starts 10 mm ahead, and 40 mm are left."""
    config = on_slide({"box": TALL | {"center_of_mass": [0.01, 0.0, 0.05]}}, 1.0)
    certificate = certify(there_and_stop(config, 1.0))
    assert margin(certificate, "contact of box on tray") == pytest.approx(1 - (0.25 / G) / 0.04, abs=1e-7)


def test_a_turned_box_tips_over_its_turned_edge() -> None:
    config = on_slide({"box": TALL | {"yaw": np.pi / 6}}, 1.0)
    certificate = certify(there_and_stop(config, 1.0))
    moved = 0.2 / G * np.array([np.cos(np.pi / 6), np.sin(np.pi / 6)])
    assert margin(certificate, "contact of box on tray") == pytest.approx(1 - moved.max() / 0.05, abs=1e-7)


def test_a_cylinder_tips_over_its_rim() -> None:
    config = on_slide({"can": {"shape": "cylinder", "radius": 0.05, "height": 0.4, "mass": 1.0}}, 1.0)
    certificate = certify(there_and_stop(config, 1.0))
    assert margin(certificate, "contact of can on tray") == pytest.approx(1 - (0.2 / G) / 0.05, abs=1e-6)


def test_what_overhangs_tips_over_the_edge_of_its_support() -> None:
    """Half of the base stands on the pedestal: the patch ends below the centre, 20 mm of it are behind."""
    objects = {
        "pedestal": {"shape": "box", "size": [0.1, 0.2, 0.02], "mass": 5.0},
        "box": {"shape": "box", "size": [0.1, 0.2, 0.1], "mass": 0.5, "on": "pedestal", "at": [0.03, 0.0]},
    }
    config = on_slide(objects, 1.0)
    certificate = certify(there_and_stop(config, 1.0))
    assert margin(certificate, "contact of box on pedestal") == pytest.approx(1 - (0.05 / G) / 0.02, abs=1e-7)


def test_lifting_takes_weight_off() -> None:
    """Downwards at 45 degrees: friction has only g - a_z to work with; the gauge counts the weight as it is at rest."""
    config = scene("gantry", {"box": LOW}, joints=[[0, 0, 0, 0], [1, 0, -1, 0]], contact={"friction": 0.5})
    plan = there_and_stop(config, 1.0, LinePath([1.0, 0.0, -1.0, 0.0]))
    assert margin(certify(plan), "contact of box on tray") == pytest.approx(1 - (1 / 0.5 + 1) / G, abs=1e-7)


def test_turning_at_constant_speed_throws_outwards() -> None:
    """The box stands half a metre from the axis: m v^2 / r, with no acceleration along the path."""
    config = scene("turntable", {"box": LOW}, contact={"friction": 0.5})
    u = np.concatenate([[40.0], np.zeros(8), [-40.0]])
    certificate = certify(timing(config, LinePath([0.7]), u))
    x = 2 * 0.1 * 40.0
    worst_of_ends = np.hypot(0.7**2 * x * 0.5, 0.7 * 40.0 * 0.5)
    assert margin(certificate, "contact of box on tray") < 1 - worst_of_ends / (0.5 * G) + 1e-7


def test_spinning_up_twists() -> None:
    """About its own centre a box twists with I_z alpha; its four corners hold mu m g times half the diagonal."""
    config = scene("gantry", {"box": LOW}, joints=[[0, 0, 0, 0], [0, 0, 0, 1]], contact={"friction": 0.02})
    alpha = 5.0
    inertia = (0.2**2 + 0.2**2) / 12
    plan = timing(config, LinePath([0.0, 0.0, 0.0, 1.0]), np.array([alpha, -alpha]))
    expected = 1 - inertia * alpha / (0.02 * G * 0.1 * np.sqrt(2))
    assert margin(certify(plan), "contact of box on tray") == pytest.approx(expected, abs=1e-6)


# Closed forms: several objects ----------------------------------------------------------------------------


def test_a_stack_tips_as_one_over_its_base() -> None:
    upper = {"shape": "box", "size": [0.1, 0.1, 0.3], "mass": 1.0, "on": "lower"}
    lower = {"shape": "box", "size": [0.2, 0.2, 0.1], "mass": 2.0}
    config = on_slide({"lower": lower, "upper": upper}, 1.0)
    certificate = certify(there_and_stop(config, 1.0))
    height = (2.0 * 0.05 + 1.0 * 0.25) / 3.0
    assert margin(certificate, "contact of lower on tray") == pytest.approx(1 - height / G / 0.1, abs=1e-7)
    assert margin(certificate, "contact of upper on lower") == pytest.approx(1 - 0.15 / G / 0.05, abs=1e-7)


def test_each_interface_has_its_own_friction() -> None:
    objects = {"lower": LOW, "upper": LOW | {"on": "lower"}, "other": LOW | {"at": [0.0, 0.2]}}
    config = on_slide(objects | {"lower": LOW | {"at": [0.0, -0.2]}}, {"upper": 0.3, "default": 0.6})  # type: ignore[arg-type]
    certificate = certify(there_and_stop(config, 2.0))
    assert margin(certificate, "contact of upper on lower") == pytest.approx(1 - 2.0 / (0.3 * G), abs=1e-7)
    assert margin(certificate, "contact of lower on tray") == pytest.approx(1 - 2.0 / (0.6 * G), abs=1e-7)
    assert margin(certificate, "contact of other on tray") == pytest.approx(1 - 2.0 / (0.6 * G), abs=1e-7)
    assert certificate.worst.limit == "slip of upper on lower"


BRIDGE = {
    "left": {"shape": "box", "size": [0.1, 0.1, 0.05], "mass": 0.4, "at": [-0.15, 0.0]},
    "right": {"shape": "box", "size": [0.1, 0.1, 0.05], "mass": 0.6, "at": [0.15, 0.0]},
    "plank": {"shape": "box", "size": [0.4, 0.06, 0.02], "mass": 0.5, "on": ["left", "right"]},
    "cup": {"shape": "cylinder", "radius": 0.03, "height": 0.06, "mass": 0.2, "on": "plank", "at": [0.05, 0.0]},
}


def test_a_bridge_slides_at_the_friction_ratio() -> None:
    config = on_slide(BRIDGE, 0.2)
    certificate = certify(there_and_stop(config, 1.5))
    assert margin(certificate, "balance of plank on left and right") == pytest.approx(1 - 1.5 / (0.2 * G), abs=1e-6)
    assert margin(certificate, "contact of cup on plank") == pytest.approx(1 - 1.5 / (0.2 * G), abs=1e-6)


def test_a_bridge_against_a_linear_program_over_all_forces() -> None:
    """Slippery posts under a rough plank, on a turning tray: forces of 64 edges at all sixteen contact points."""
    config = scene("turntable", BRIDGE, contact={"friction": {"left": 0.3, "right": 0.4, "plank": 0.6, "cup": 0.6}})
    plan = timing(config, LinePath([1.0]), np.array([1.5, 1.0, -1.0, -1.5]))
    world, moving, at = seen(config, plan, (0.5,))
    system = next(system for system in world.systems if len(system.loads) == 3)
    values = world.nominal.repeated(len(at.s))
    exact = balance(world, system, moving, values, GAP).value
    loads = body_loads(world, moving, values)
    for t in range(0, len(at.s), 3):
        outer = _by_linear_program(world, system, loads, t)
        assert exact[t] - 1e-6 <= outer <= exact[t] * (1 + 2e-3) + 2e-3


def _by_linear_program(world: World, system: System, loads: list[tuple[np.ndarray, np.ndarray]], t: int) -> float:
    """From the patches of the contacts and the wrenches of the bodies, moments about the tray's origin."""
    angle = 2 * np.pi * np.arange(64) / 64
    objects = ["left", "right", "plank"]
    columns = []
    for k in system.contacts:
        patch, mu = world.contacts[k].patch, world.nominal.friction[k]
        for point in patch.points:
            force = np.stack([mu * np.cos(angle), mu * np.sin(angle), np.ones(64)])
            wrench = np.concatenate([force, np.cross(point, force, axisb=0, axisc=0)])
            blocks = np.zeros((3, 6, 64))
            blocks[objects.index(patch.object)] += wrench
            if patch.support in objects:
                blocks[objects.index(patch.support)] -= wrench
            columns.append(blocks.reshape(-1, 64))
    names = [body.name for body in world.bodies]
    carried = {"left": ["left"], "right": ["right"], "plank": ["plank", "cup"]}
    rest, move = (
        np.concatenate([sum(loads[names.index(b)][part][:, t] for b in carried[name]) for name in objects])
        for part in range(2)
    )
    matrix = np.column_stack([*columns, -rest])
    cost = np.append(np.zeros(matrix.shape[1] - 1), 1.0)
    return float(linprog(cost, A_eq=matrix, b_eq=move, method="highs").x[-1])


# Closed forms: what is uncertain --------------------------------------------------------------------------


def test_the_lowest_friction_counts() -> None:
    config = on_slide({"box": LOW}, 0.5, uncertainty={"friction": [0.3, 0.7]})
    certificate = certify(there_and_stop(config, 2.5))
    assert margin(certificate, "contact of box on tray") == pytest.approx(1 - 2.5 / (0.3 * G), abs=1e-7)
    assert certificate.worst.parameters == {"friction": {"box on tray": 0.3}}
    assert certificate.samples == 100


def test_contact_points_that_are_closer_tip_sooner() -> None:
    config = on_slide({"box": TALL}, 1.0, uncertainty={"contact_points": 0.01})
    certificate = certify(there_and_stop(config, 1.0))
    assert margin(certificate, "contact of box on tray") == pytest.approx(1 - (0.2 / G) / 0.04, abs=1e-6)


def test_the_center_of_mass_may_be_higher_and_nearer_to_the_edge() -> None:
    config = on_slide({"box": TALL}, 1.0, uncertainty={"center_of_mass": {"box": [0.01, 0.0, 0.02]}})
    certificate = certify(there_and_stop(config, 1.0))
    assert margin(certificate, "contact of box on tray") == pytest.approx(1 - (0.22 / G) / 0.04, abs=1e-6)
    assert certificate.worst.limit == "tipping of box over tray"
    worst = certificate.worst.parameters["center_of_mass"]
    assert isinstance(worst, dict)
    assert worst["box"][2] == 0.02


def test_a_heavier_load_on_top_tips_a_stack_sooner() -> None:
    upper = {"shape": "box", "size": [0.1, 0.1, 0.3], "mass": 1.0, "on": "lower"}
    lower = {"shape": "box", "size": [0.2, 0.2, 0.1], "mass": 2.0}
    config = on_slide({"lower": lower, "upper": upper}, 1.0, uncertainty={"mass": {"upper": [0.5, 2.0]}})
    certificate = certify(there_and_stop(config, 1.0))
    height = (2.0 * 0.05 + 2.0 * 0.25) / 4.0
    assert margin(certificate, "contact of lower on tray") == pytest.approx(1 - height / G / 0.1, abs=1e-6)


def test_the_acceleration_error_adds_to_the_acceleration() -> None:
    error = {"joint_acceleration": {"mean": 0.1, "deviation": 0.2, "K": 2.0}}
    config = on_slide({"box": LOW}, 0.5, uncertainty=error)
    certificate = certify(there_and_stop(config, 2.0))
    assert margin(certificate, "contact of box on tray") == pytest.approx(1 - 2.5 / (0.5 * G), abs=1e-7)
    assert certificate.margins["x acceleration"].on_grid == pytest.approx(1 - 2.5 / 1000.0, abs=1e-12)
    assert certificate.worst.parameters["joint_acceleration"] == {"x": 0.5}


def test_standstill_has_no_acceleration_error() -> None:
    error = {"joint_acceleration": {"mean": 0.0, "deviation": 5.0, "K": 1.0}}
    config = on_slide({"box": LOW}, 0.5, uncertainty=error)
    plan = there_and_stop(config, 0.1)
    world, moving, at = seen(config, plan)
    still = np.flatnonzero(at.free == 0.0)
    values = world.upper.repeated(len(still))
    rest = balance(world, world.systems[0], moving.at(still), values, GAP)
    np.testing.assert_allclose(rest.value, 0.0, atol=1e-7)


# Joints ---------------------------------------------------------------------------------------------------


def test_joint_limits() -> None:
    limits = {
        "x": {"position": [-1.0, 3.0], "velocity": 2.0, "acceleration": 1.25, "torque": 10.0, "dry_friction": 1.0}
    }
    limits["x"]["viscous_friction"] = 0.5  # type: ignore[assignment]
    uncertain = {"mass": {"box": [0.4, 0.6], "tray": [0.9, 1.1]}, "joint_acceleration": {"deviation": 0.05}}
    config = on_slide({"box": LOW}, 0.5, robot_keys={"limits": limits}, uncertainty=uncertain)
    margins = certify(there_and_stop(config, 1.0)).margins
    assert margins["x position"].on_grid == pytest.approx(0.5)
    assert margins["x velocity"].on_grid == pytest.approx(0.5)
    assert margins["x acceleration"].on_grid == pytest.approx(1 - 1.05 / 1.25)
    torque = (2.0 + 1.1 + 0.6) * 1.05 + 1.0 + 0.5 * 1.0
    assert margins["x torque"].on_grid == pytest.approx(1 - torque / 10.0, abs=1e-9)


def test_a_joint_that_does_not_move_counts_with_dry_friction_of_either_sign() -> None:
    limits = {"all": {"dry_friction": 3.0, "torque": 100.0}}
    config = scene("gantry", {"box": LOW}, joints=[[0, 0, 0, 0], [1, 0, 0, 0]], robot_keys={"limits": limits})
    margins = certify(there_and_stop(config, 1.0)).margins
    weight = (2.0 + 1.0 + 1.0 + 0.5) * G
    assert margins["z torque"].on_grid == pytest.approx(1 - (weight + 3.0) / 100.0, abs=1e-9)


def test_load_torque_against_a_model_with_the_load_in_it() -> None:
    """MuJoCo's inverse dynamics of the arm with tray and stack as one body, for random motions."""
    stack = {
        "lower": TALL | {"at": [0.05, -0.02], "yaw": 0.3, "center_of_mass": [0.01, 0.0, 0.02]},
        "upper": {"shape": "cylinder", "radius": 0.04, "height": 0.1, "mass": 0.7, "on": "lower", "at": [0.01, 0.0]},
    }
    robot_keys = {"model": "tx90l", "tool": "flange", "joint_friction": False}
    tray = {"size": [0.3, 0.3, 0.02], "mass": 1.5, "center_of_mass": [0.02, 0.0, 0.0]}
    tray["pose"] = {"position": [0.0, 0.1, 0.18], "rpy": [0.2, -1.4, 0.1]}
    config = scene(objects=stack, joints=[[0.0] * 6, [1.0] * 6], robot_keys=robot_keys, tray=tray)
    robot = load_robot(config)
    rng = np.random.default_rng(0)
    plan = timing(config, CubicPath(rng.normal(size=(3, 6))), np.array([3.0, -3.0]))
    plan.problem.robot = robot
    world, moving, at = seen(config, plan, (0.3, 0.7))
    _, joints = motion(task_of(plan), at)
    error = rng.normal(size=(6, len(at.s))) * at.free
    values = replace(world.nominal.repeated(len(at.s)), error=error)
    own = torques(world, joints, at.free, body_loads(world, moving, values), values).T
    qdd = (joints.acceleration + error).T
    np.testing.assert_allclose(own, _with_load(robot, world, joints.position.T, joints.velocity.T, qdd), atol=1e-9)


def _with_load(robot: Any, world: World, q: np.ndarray, qd: np.ndarray, qdd: np.ndarray) -> np.ndarray:
    spec = robot.spec.copy()
    site = next(site for site in spec.sites if site.name == CARRIER_SITE)
    body = site.parent.add_body(name="load", pos=site.pos, quat=site.quat)
    for k, item in enumerate(world.bodies):
        xx, yy, zz, xy, xz, yz = item.inertia
        own = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        inertia = item.mass * item.turn @ own @ item.turn.T
        full = [inertia[i, j] for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))]
        body.add_body(name=f"load{k}", mass=item.mass, ipos=item.center, fullinertia=full, explicitinertial=True)
    model = spec.compile()
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT | mujoco.mjtDisableBit.mjDSBL_DAMPER)
    model.dof_frictionloss[:] = 0
    data = mujoco.MjData(model)
    result = []
    for row in zip(q, qd, qdd, strict=True):
        data.qpos[:], data.qvel[:], data.qacc[:] = row
        mujoco.mj_inverse(model, data)
        result.append(data.qfrc_inverse.copy())
    return np.array(result)


# The search and the samples ---------------------------------------------------------------------------------

EVERYTHING = {
    "friction": [0.3, 0.5],
    "contact_points": 0.004,
    "center_of_mass": {"upper": [0.004, 0.003, 0.02], "lower": [0.003, 0.002, 0.01]},
    "mass": {"upper": [0.3, 0.7], "lower": [0.4, 0.6]},
    "joint_acceleration": {"deviation": 0.2},
}


def shaken() -> tuple[Config, Any]:
    """A stack on a gantry that moves in all its directions at once; nothing binds at any special place."""
    lower = {"shape": "box", "size": [0.1, 0.12, 0.08], "mass": 0.5, "at": [0.05, 0.03], "yaw": 0.4}
    upper = {"shape": "cylinder", "radius": 0.04, "height": 0.12, "mass": 0.5, "on": "lower", "at": [0.01, -0.01]}
    config = scene(
        "gantry", {"lower": lower, "upper": upper}, joints=[[0] * 4, [1] * 4], contact={"friction": 0.4},
        uncertainty=EVERYTHING, robot_keys={"limits": {"all": {"acceleration": 100.0, "torque": 1000.0}}},
    )  # fmt: skip
    plan = timing(config, LinePath([1.0, 0.6, 0.2, 1.0]), 1.4 * np.array([0.9, 0.3, 0.6, -0.6, -0.9, -0.3]))
    return config, plan


def test_no_sample_is_worse_than_the_search() -> None:
    config, plan = shaken()
    world, moving, at = seen(config, plan, (0.5,))
    rng = np.random.default_rng(5)
    for system in world.systems:
        tally = Tally(at.grid)
        start = world.nominal.repeated(len(at.s))
        search = Search(world, system, moving, 1e-6, tally)
        search.run([start], Thoroughness(1, 4, 1e-6))
        search.report()
        searched = max(found.utilisation for found in tally.worst.values())
        for corners in (True, False):
            samples = world.sample(rng, 200 * len(at.s), corners)
            many = moving.at(np.tile(np.arange(len(at.s)), 200))
            sampled = balance(world, system, many, samples, 1e-6).value.max()
            assert 0.5 < sampled <= searched + 1e-6


def test_samples_are_told_where_they_are_worse_than_what_is_known() -> None:
    """Without the search before them the samples find nearly as much, and exactly what they say."""
    config, plan = shaken()
    world, moving, at = seen(config, plan)
    tally = Tally(at.grid)
    known = [KnownTorques(motion(task_of(plan), at)[1], plan.problem.robot.limits.torque, np.arange(len(at.s)))]
    searches = [Search(world, system, moving, GAP, tally) for system in world.systems]
    check_samples(world, moving, known, searches, world.sample(np.random.default_rng(1), 300, corners=True), 4, tally)
    for search in searches:
        search.report()
    for system in world.systems:
        found = tally.worst[system.name, True]
        assert found.utilisation == pytest.approx(_again(world, moving, system, found), abs=1e-6)
        nominal = balance(world, system, moving, world.nominal.repeated(len(at.s)), GAP).value.max()
        assert found.utilisation > 1.1 * nominal
    assert tally.tests >= 300 * len(at.s) * (4 + len(world.systems))


def _inertia(body: Body, words: Any) -> np.ndarray:
    """The inertia per unit of mass that was reported, or the nominal one."""
    reported = words.get("inertia", {}).get(body.name)
    return body.inertia if reported is None else np.array(reported) / words["mass"].get(body.name, body.mass)


def _again(world: World, moving: Any, system: System, found: Any) -> float:
    """The utilisation at the parameters that were reported, from the words alone."""
    words, nominal = found.parameters, world.nominal
    friction = np.array([words["friction"].get(contact.name, np.nan) for contact in world.contacts])
    shift = np.zeros_like(nominal.shift)
    for contact in world.contacts:
        moved = words["contact_points"].get(contact.name, np.zeros((contact.last - contact.first, 2)))
        shift[:, contact.first : contact.last] = np.array(moved).T
    values = Parameters(
        mass=np.array([words["mass"].get(body.name, body.mass) for body in world.bodies]),
        com=np.array([words["center_of_mass"].get(body.name, (0.0, 0.0, 0.0)) for body in world.bodies]),
        inertia=np.array([_inertia(body, words) for body in world.bodies]),
        friction=np.where(np.isnan(friction), nominal.friction, friction),
        force=nominal.force,
        shift=shift,
        error=np.array([words["joint_acceleration"][joint] for joint in world.joints]),
    )
    there = moving.at(np.array([found.instant]))
    return float(balance(world, system, there, values.repeated(1), GAP).value[0])


def test_the_same_seed_gives_the_same_certificate() -> None:
    _, plan = shaken()
    first, second, other = certify(plan, seed=1), certify(plan, seed=1), certify(plan, seed=2)
    assert first == second
    assert first.margins == second.margins
    assert other.seed != first.seed


def test_levels_agree_on_a_small_plan(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(LEVELS, "full", replace(LEVELS["full"], samples=500))
    _, plan = shaken()
    quick, full = certify(plan), certify(plan, "full")
    assert full.samples == 500
    assert full.instants > quick.instants
    for limit, found in full.margins.items():
        assert found.on_grid == pytest.approx(quick.margins[limit].on_grid, abs=2e-5)
        assert found.on_grid <= quick.margins[limit].on_grid + 1e-7


# Verdicts -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("excess", "passes"), [(-0.005, True), (0.005, True), (0.02, False)])
def test_between_grid_points_one_per_cent_is_forgiven(excess: float, passes: bool) -> None:
    """x is 2 and u is 0 in the middle interval, where q'' has its half wave: all of it lies between grid points."""
    config = on_slide({}, robot_keys={"limits": {"x": {"acceleration": 10.0}}})
    plan = timing(config, BumpPath(5.0 * (1 + excess)), np.array([2.5, 2.5, 0.0, -2.5, -2.5]))
    certificate = certify(plan)
    assert certificate.margins["x acceleration"].between == pytest.approx(-excess, abs=1e-12)
    assert ("try more solver.collocation_points than" in certificate.sentence) == (not passes)
    assert certificate.margins["x acceleration"].on_grid > 0.5
    assert certificate.passed is passes
    if excess > 0:
        assert certificate.worst.limit == "x acceleration"
        assert not certificate.worst.on_grid
        assert certificate.worst.s == pytest.approx(0.5)


def test_a_violation_on_the_grid_is_not_forgiven() -> None:
    config = on_slide({"box": LOW}, 0.5)
    assert certify(there_and_stop(config, 0.5 * G)).passed
    certificate = certify(there_and_stop(config, 0.5 * G * (1 + 5e-6)))
    assert not certificate.passed
    assert certificate.margin == pytest.approx(-5e-6, abs=1e-7)
    assert certificate.worst.on_grid


def test_a_tray_too_steep_to_stand_on_fails() -> None:
    tilted = {"pose": {"rpy": [0.6, 0.0, 0.0]}}
    config = on_slide({"box": LOW}, 0.5, tray=tilted)
    certificate = certify(there_and_stop(config, 0.01))
    assert not certificate.passed
    assert certificate.worst.limit == "slip of box on tray"
    level = on_slide({"box": LOW}, 0.8, tray=tilted)
    assert certify(there_and_stop(level, 0.01)).passed


@pytest.mark.parametrize("what", ["negative", "no stop", "jump"])
def test_numbers_that_are_no_timing_fail(what: str) -> None:
    config = on_slide({"box": LOW}, 0.5)
    plan = there_and_stop(config, 1.0)
    if what == "negative":
        plan.x[3] = -0.1
    elif what == "no stop":
        plan.x[-1] = 0.1
    else:
        plan.u[4] = 0.9
    certificate = certify(plan)
    assert not certificate.passed
    assert certificate.worst.limit == "timing"


def test_stops_are_looked_at_and_empty_intervals_are_not() -> None:
    config = on_slide({"box": LOW}, 0.5)
    plan = there_and_stop(config, 1.0)
    s = np.concatenate([0.5 * plan.s, 0.5 + 0.5 * plan.s])
    x, u = np.tile(plan.x, 2) * 0.5, np.concatenate([plan.u, [0.0], plan.u]) * 0.5
    piece = np.zeros(len(s), dtype=np.intp)
    u = 2 * 2 * u
    stopping = SimpleNamespace(s=s, piece=piece, x=2 * x, u=u, u_end=u, change=0 * u, steady=True, problem=plan.problem)
    at = instants(stopping, (0.5,))
    assert np.count_nonzero(at.free == 0.0) == 4
    assert len(at.s) == 20 * 3 + 4
    assert at.t.max() == pytest.approx(2 * np.sqrt(2 * 0.5 / 2.0) * np.sqrt(2))
    assert certify(stopping).margins["timing"].on_grid > 0.999


def test_misuse() -> None:
    config = on_slide({"box": LOW}, 0.5)
    plan = there_and_stop(config, 1.0)
    with pytest.raises(ValueError, match="quick, full"):
        certify(plan, "thorough")
    with pytest.raises(SolverFailed, match="not finite"):
        certify(SimpleNamespace(**vars(plan) | {"x": np.nan * plan.x}))
    plan.x = plan.u = np.zeros(0)
    plan.message = "No timing of the path satisfies the limits."
    with pytest.raises(SolverFailed, match="No timing"):
        certify(plan)


def test_every_interval_of_a_long_grid_is_looked_at() -> None:
    """At both ends and, as there are many, in the middle alone; twice as still standing."""
    config = on_slide({"box": LOW}, 0.5)
    certificate = certify(there_and_stop(config, 1.0, intervals=3000))
    assert certificate.intervals == 3000
    assert 9000 < certificate.instants < 9010


# Plans ----------------------------------------------------------------------------------------------------

ALL_KINDS = [
    "contact.friction=0.4",
    "uncertainty.friction=[0.3,0.5]",
    "uncertainty.contact_points=0.002",
    "uncertainty.center_of_mass={upper: [0.003, 0.003, 0.01]}",
    "uncertainty.mass={upper: [0.45, 0.55]}",
    "uncertainty.joint_acceleration={mean: 0, deviation: 0.3, K: 1}",
]


@pytest.fixture(scope="module")
def robust() -> tuple[Config, Plan]:
    from robustopt.solvers import build_problem
    from robustopt.solvers import solve as solve_plan

    config = waiter("two_blocks", "solver.method=reachability", "solver.collocation_points=60", *ALL_KINDS)
    return config, solve_plan(build_problem(config))


def test_a_robust_plan_passes_narrowly(robust: tuple[Config, Plan]) -> None:
    certificate = certify(robust[1])
    assert certificate.passed
    assert -0.01 < certificate.margin < 0.02


def test_the_same_plan_two_per_cent_faster_fails(robust: tuple[Config, Plan]) -> None:
    _, plan = robust
    certificate = certify(replace(plan, x=1.02**2 * plan.x, u=1.02**2 * plan.u))
    assert not certificate.passed
    assert certificate.worst.limit in {"slip of upper on lower", "slip of lower on tray", "tipping of lower over tray"}


def test_utilisation_grows_with_the_square_of_the_speed(robust: tuple[Config, Plan]) -> None:
    """On a level tray all wrenches of the motion scale together, and the acceleration error is taken away."""
    config, plan = robust
    exact = config.model_copy(
        update={"uncertainty": config.uncertainty.model_copy(update={"joint_acceleration": None})}
    )
    slow = certify(plan, config=exact)
    fast = certify(replace(plan, x=1.21 * plan.x, u=1.21 * plan.u), config=exact)
    for limit in ("contact of lower on tray", "contact of upper on lower", "joint2 acceleration"):
        assert 1 - fast.margins[limit].on_grid == pytest.approx(1.21 * (1 - slow.margins[limit].on_grid), abs=1e-3)


def test_a_plan_for_exact_values_fails_when_they_are_uncertain(robust: tuple[Config, Plan]) -> None:
    from robustopt.solvers import build_problem
    from robustopt.solvers import solve as solve_plan

    risky = waiter("two_blocks", "solver.method=reachability", "solver.collocation_points=60", "contact.friction=0.4")
    certificate = certify(solve_plan(build_problem(risky)), config=robust[0])
    assert not certificate.passed
    assert certificate.worst.parameters["friction"]
