"""Robot: model files, limits and the dynamics along a path."""

from __future__ import annotations

import hashlib
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from robustopt.config import Config
from robustopt.errors import RobotError
from robustopt.models import MODELS
from robustopt.path.collision import CollisionCheck
from robustopt.robot import Robot, load_robot
from robustopt.robot.model_file import model_hash, resolve_package
from robustopt.robot.preparation import load_model

FIXTURES = Path(__file__).parent / "fixtures"
TRAY = {"size": [0.3, 0.3, 0.01], "mass": 1.0}
G = 9.81


def make_config(robot: dict[str, Any], tray: dict[str, Any] | None = None, **more: Any) -> Config:
    path = {"tray_poses": [{"position": [0.0, 0.0, 0.0]}, {"position": [1.0, 0.0, 0.0]}]}
    return Config.model_validate(
        {"name": "test", "robot": robot, "tray": TRAY | (tray or {}), "path": path, "folder": FIXTURES, **more}
    )


def load(robot: dict[str, Any], tray: dict[str, Any] | None = None, **more: Any) -> Robot:
    return load_robot(make_config(robot, tray, **more))


PENDULUM = {"model": "double_pendulum.xml", "tool": "tip"}
TX90L = {"model": "tx90l"}


@pytest.fixture(scope="module")
def tx90l() -> Robot:
    return load(TX90L, {"pose": {"position": [0.0, 0.02, 0.18], "rpy": [0.1, -1.5, 0.2]}})


def random_motion(robot: Robot, count: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    lower, upper = np.maximum(robot.limits.lower, -3), np.minimum(robot.limits.upper, 3)
    return (
        rng.uniform(lower, upper, (count, robot.n)),
        rng.normal(size=(count, robot.n)),
        rng.normal(size=(count, robot.n)),
    )


def pendulum_dynamics(q: np.ndarray, qd: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Mass matrix, velocity-product torque and gravity torque of the fixture, in closed form."""
    m1, m2, l1, c1, c2, i1, i2, armature = 1.5, 0.8, 0.5, 0.3, 0.2, 0.05, 0.02, 0.02
    cos2, sin2 = np.cos(q[1]), np.sin(q[1])
    inertia_2 = i2 + m2 * c2**2
    coupling = inertia_2 + m2 * l1 * c2 * cos2
    mass = np.array(
        [[i1 + m1 * c1**2 + inertia_2 + m2 * (l1**2 + 2 * l1 * c2 * cos2) + armature, coupling], [coupling, inertia_2]]
    )
    h = m2 * l1 * c2 * sin2
    velocity = np.array([-h * (2 * qd[0] * qd[1] + qd[1] ** 2), h * qd[0] ** 2])
    second = m2 * c2 * np.sin(q[0] + q[1])
    gravity = G * np.array([(m1 * c1 + m2 * l1) * np.sin(q[0]) + second, second])
    return mass, velocity, gravity


def test_double_pendulum_has_its_closed_form_dynamics() -> None:
    robot = load(PENDULUM)
    q, q1, q2 = random_motion(robot, 20)
    found = robot.dynamics(q, q1, q2)
    for i in range(20):
        mass, velocity, gravity = pendulum_dynamics(q[i], q1[i])
        np.testing.assert_allclose(found.mass_matrix[i], mass, atol=1e-12)
        np.testing.assert_allclose(found.force_u[i], mass @ q1[i], atol=1e-12)
        np.testing.assert_allclose(found.force_x[i], mass @ q2[i] + velocity, atol=1e-12)
        np.testing.assert_allclose(found.force_0[i], gravity, atol=1e-12)


def test_double_pendulum_has_its_closed_form_kinematics() -> None:
    robot = load(PENDULUM)
    q, q1, q2 = random_motion(robot, 20)
    found = robot.dynamics(q, q1, q2).carrier
    assert found is not None
    first, both = q[:, 0], q.sum(axis=1)
    zero = np.zeros(20)
    tip = np.stack([-0.5 * np.sin(first) - 0.4 * np.sin(both), zero, -0.5 * np.cos(first) - 0.4 * np.cos(both)], axis=1)
    np.testing.assert_allclose(found.position, tip, atol=1e-12)
    np.testing.assert_allclose(found.rotation, Rotation.from_rotvec(np.outer(both, [0, 1, 0])).as_matrix(), atol=1e-12)
    np.testing.assert_allclose(found.gravity, np.stack([G * np.sin(both), zero, -G * np.cos(both)], axis=1), atol=1e-12)
    # centripetal: the tip is pulled towards the elbow at the total rate, the elbow towards the shoulder at its own
    rate, total = q1[:, 0], q1.sum(axis=1)
    world = np.stack(
        [0.5 * rate**2 * np.sin(first) + 0.4 * total**2 * np.sin(both), zero,
         0.5 * rate**2 * np.cos(first) + 0.4 * total**2 * np.cos(both)], axis=1
    )  # fmt: skip
    np.testing.assert_allclose(np.einsum("pij,pj->pi", found.rotation, found.bias[:, :3]), world, atol=1e-12)
    np.testing.assert_allclose(found.bias[:, 3:], 0.0, atol=1e-12)


PUBLISHED_FRAMES = [  # rotation of the child in the parent, row-major, and position [m], as published with the TX90L
    ([0, 1, 0, -1, 0, 0, 0, 0, 1], (-0.0248, 0.0, 0.242)),
    ([0, 0, -1, 1, 0, 0, 0, -1, 0], (-0.16, 0.05, 0.23)),
    ([1, 0, 0, 0, -1, 0, 0, 0, -1], (-0.0001, -0.5, 0.0)),
    ([1, 0, 0, 0, 0, 1, 0, -1, 0], (-0.0002, 0.156, 0.11)),
    ([1, 0, 0, 0, 0, -1, 0, 1, 0], (0.0008, 0.0305, 0.3952)),
    ([1, 0, 0, 0, 0, 1, 0, -1, 0], (0.0, 0.095, 0.0305)),
]


def test_tx90l_has_the_published_frames_and_limits() -> None:
    robot = load(TX90L)
    q, _, _ = random_motion(robot, 20)
    positions, rotations = robot.carrier_pose(q)
    for qi, position, rotation in zip(q, positions, rotations, strict=True):
        R, p = np.eye(3), np.zeros(3)
        for (rows, offset), angle in zip(PUBLISHED_FRAMES, qi, strict=True):
            p = p + R @ np.array(offset)
            R = R @ np.reshape(rows, (3, 3)) @ Rotation.from_rotvec([0, 0, angle]).as_matrix()
        np.testing.assert_allclose(position, p, atol=1e-12)
        np.testing.assert_allclose(rotation, R, atol=1e-12)
    limits = robot.limits
    np.testing.assert_allclose(np.rad2deg(limits.lower), [-179, -147.5, -145, -179, -140, -179])
    np.testing.assert_allclose(np.rad2deg(limits.upper), [179, 130, 145, 179, 115, 179])
    np.testing.assert_allclose(np.rad2deg(limits.velocity), [400, 400, 430, 540, 475, 760])
    np.testing.assert_allclose(np.rad2deg(limits.acceleration), 400)
    np.testing.assert_allclose(limits.torque, [800, 600, 400, 100, 50, 20])
    np.testing.assert_allclose(limits.dry_friction, [5, 5, 3, 1, 0.1, 0.1])
    np.testing.assert_allclose(limits.viscous_friction, [100, 100, 70, 40, 5, 0.5])


def test_tray_is_mounted_at_its_pose_in_the_tool_frame() -> None:
    flange = load(TX90L)
    mounted = load(TX90L, {"pose": {"position": [0.1, 0.2, 0.3], "rpy": [0.0, -np.pi / 2, 0.0]}})
    q, _, _ = random_motion(flange, 5)
    position, rotation = flange.carrier_pose(q)
    tray_position, tray_rotation = mounted.carrier_pose(q)
    np.testing.assert_allclose(tray_position, position + rotation @ [0.1, 0.2, 0.3], atol=1e-12)
    np.testing.assert_allclose(tray_rotation[:, :, 2], -rotation[:, :, 0], atol=1e-12)  # normal = -x of the flange


def test_a_body_can_be_the_tool() -> None:
    by_site, by_body = load(TX90L), load(TX90L | {"tool": "link6"})
    q, _, _ = random_motion(by_site, 3)
    np.testing.assert_array_equal(by_site.carrier_pose(q)[0], by_body.carrier_pose(q)[0])


def test_jacobian_is_the_derivative_of_the_tray_pose(tx90l: Robot) -> None:
    q, q1, q2 = random_motion(tx90l, 5)
    found = tx90l.dynamics(q, q1, q2)
    h = 1e-6
    for joint in range(tx90l.n):
        step = h * np.eye(tx90l.n)[joint]
        (p_after, R_after), (p_before, R_before) = tx90l.carrier_pose(q + step), tx90l.carrier_pose(q - step)
        linear = (p_after - p_before) / (2 * h)
        angular = Rotation.from_matrix(R_before.transpose(0, 2, 1) @ R_after).as_rotvec() / (2 * h)
        into_tray = found.carrier.rotation.transpose(0, 2, 1)
        np.testing.assert_allclose(
            found.carrier.jacobian[:, :3, joint], np.einsum("pij,pj->pi", into_tray, linear), atol=1e-8
        )
        np.testing.assert_allclose(found.carrier.jacobian[:, 3:, joint], angular, atol=1e-8)


def test_bias_completes_the_acceleration_of_the_tray(tx90l: Robot) -> None:
    q, q1, q2 = random_motion(tx90l, 5)
    found = tx90l.dynamics(q, q1, q2)

    def world_velocity(t: float) -> np.ndarray:
        moved = tx90l.dynamics(q + t * q1 + t**2 / 2 * q2, q1 + t * q2, q2)
        velocity = np.einsum("pij,pj->pi", moved.carrier.jacobian, q1 + t * q2)
        return np.hstack(
            [np.einsum("pij,pj->pi", moved.carrier.rotation, part) for part in (velocity[:, :3], velocity[:, 3:])]
        )

    h = 1e-5
    acceleration = (world_velocity(h) - world_velocity(-h)) / (2 * h)
    expected = np.einsum("pij,pj->pi", found.carrier.jacobian, q2) + found.carrier.bias
    for part in (slice(0, 3), slice(3, 6)):
        in_world = np.einsum("pij,pj->pi", found.carrier.rotation, expected[:, part])
        np.testing.assert_allclose(in_world, acceleration[:, part], atol=1e-7)


def test_tray_jacobian_of_one_point_agrees_with_the_dynamics(tx90l: Robot) -> None:
    q, q1, q2 = random_motion(tx90l, 3)
    found = tx90l.dynamics(q, q1, q2)
    position, rotation, jacobian = (part[0] for part in tx90l.carrier_jacobians(q[1:2]))
    np.testing.assert_allclose(position, found.carrier.position[1], atol=1e-14)
    np.testing.assert_allclose(rotation.T @ jacobian[:3], found.carrier.jacobian[1, :3], atol=1e-13)
    np.testing.assert_allclose(rotation.T @ jacobian[3:], found.carrier.jacobian[1, 3:], atol=1e-13)


@given(seed=st.integers(0, 10_000))
@settings(max_examples=25, deadline=None)
def test_the_torque_does_the_work_that_the_kinetic_energy_takes(seed: int) -> None:
    """d/ds (q'^T M q' / 2) = q'^T (M q'' + C q'): the velocity products do no work of their own (passivity)."""
    robot = load(TX90L)
    q, q1, q2 = random_motion(robot, 1, seed)
    h = 1e-6

    def energy(t: float) -> float:
        velocity = q1 + t * q2
        moved = robot.dynamics(q + t * q1 + t**2 / 2 * q2, velocity, q2)
        return float(velocity[0] @ moved.mass_matrix[0] @ velocity[0] / 2)

    power = float(q1[0] @ robot.dynamics(q, q1, q2).force_x[0])
    assert power == pytest.approx((energy(h) - energy(-h)) / (2 * h), rel=1e-5, abs=1e-5)


def test_the_torque_at_rest_is_the_gradient_of_the_potential_energy(tx90l: Robot) -> None:
    q, q1, q2 = random_motion(tx90l, 4)
    weight, h = float(tx90l.spec.compile().body_mass.sum()) * G, 1e-6
    force_0 = tx90l.dynamics(q, q1, q2).force_0
    for joint, step in enumerate(h * np.eye(6)):
        rise = (tx90l.center_of_mass(q + step) - tx90l.center_of_mass(q - step))[:, 2] / (2 * h)
        np.testing.assert_allclose(force_0[:, joint], weight * rise, atol=1e-5)


def test_mass_matrix_is_symmetric_and_positive(tx90l: Robot) -> None:
    mass = tx90l.dynamics(*random_motion(tx90l, 50)).mass_matrix
    np.testing.assert_allclose(mass, mass.transpose(0, 2, 1), atol=1e-12)
    assert np.linalg.eigvalsh(mass).min() > 0


def test_results_do_not_depend_on_what_was_asked_before(tx90l: Robot) -> None:
    q, q1, q2 = random_motion(tx90l, 6)
    together = tx90l.dynamics(q, q1, q2)
    tx90l.carrier_pose(q[::-1])
    alone = tx90l.dynamics(q[4:5], q1[4:5], q2[4:5])
    np.testing.assert_array_equal(together.force_x[4], alone.force_x[0])
    np.testing.assert_array_equal(together.carrier.bias[4], alone.carrier.bias[0])
    with pytest.raises(ValueError, match="read-only"):
        together.force_0[0] = 0.0


def test_a_spring_in_a_joint_counts_as_torque(tmp_path: Path) -> None:
    text = (FIXTURES / "double_pendulum.xml").read_text()
    (tmp_path / "sprung.xml").write_text(
        text.replace('axis="0 1 0" range="-2 2"', 'axis="0 1 0" range="-2 2" stiffness="3" springref="0.1"')
    )
    plain, sprung = load(PENDULUM), load({"model": "sprung.xml", "tool": "tip"}, folder=tmp_path)
    q, q1, q2 = random_motion(plain, 5)
    one, other = plain.dynamics(q, q1, q2), sprung.dynamics(q, q1, q2)
    np.testing.assert_allclose(other.force_0[:, 1] - one.force_0[:, 1], 3 * (q[:, 1] - 0.1), atol=1e-12)
    np.testing.assert_allclose(other.force_x, one.force_x, atol=1e-12)


def test_turning_the_base_is_turning_gravity_the_other_way() -> None:
    turn = Rotation.from_euler("xyz", [0.3, -0.7, 1.1])
    turned = load(TX90L | {"base": {"position": [1.0, 2.0, 3.0], "rpy": [0.3, -0.7, 1.1]}})
    level = load(TX90L, gravity=turn.inv().apply([0, 0, -G]).tolist())
    motion = random_motion(level, 6)
    one, other = turned.dynamics(*motion), level.dynamics(*motion)
    np.testing.assert_allclose(one.force_0, other.force_0, atol=1e-10)
    np.testing.assert_allclose(one.force_x, other.force_x, atol=1e-10)
    np.testing.assert_allclose(one.carrier.gravity, other.carrier.gravity, atol=1e-12)
    np.testing.assert_allclose(one.carrier.jacobian, other.carrier.jacobian, atol=1e-12)
    np.testing.assert_allclose(
        one.carrier.position, other.carrier.position @ turn.as_matrix().T + [1, 2, 3], atol=1e-12
    )


def test_locked_joints_hold_their_position() -> None:
    free = load(TX90L)
    locked = load(TX90L | {"locked": {"joint3": 1.2, "joint6": -0.4}, "base": {"rpy": [0.0, 0.0, 0.5]}})
    assert locked.joint_names == ("joint1", "joint2", "joint4", "joint5")
    free = load(TX90L | {"base": {"rpy": [0.0, 0.0, 0.5]}})
    q, q1, q2 = random_motion(free, 6)
    moving = [0, 1, 3, 4]
    q[:, [2, 5]], q1[:, [2, 5]], q2[:, [2, 5]] = [1.2, -0.4], 0.0, 0.0
    one = locked.dynamics(q[:, moving], q1[:, moving], q2[:, moving])
    other = free.dynamics(q, q1, q2)
    np.testing.assert_allclose(one.force_x, other.force_x[:, moving], atol=1e-10)
    np.testing.assert_allclose(one.force_0, other.force_0[:, moving], atol=1e-10)
    np.testing.assert_allclose(one.carrier.position, other.carrier.position, atol=1e-12)
    np.testing.assert_allclose(one.carrier.rotation, other.carrier.rotation, atol=1e-12)
    np.testing.assert_array_equal(locked.limits.torque, [800, 600, 100, 50])


def test_limits_come_from_the_file_and_the_configuration_overrides_them() -> None:
    limits = load(PENDULUM).limits
    np.testing.assert_array_equal(limits.velocity, [5, 6])
    np.testing.assert_array_equal(limits.acceleration, [50, 60])
    np.testing.assert_array_equal(limits.torque, [20, 5])  # the elbow's from its motor: gear 5, control 1, force 2
    np.testing.assert_array_equal(limits.dry_friction, [0.3, 0.1])
    changes = {"all": {"velocity": 1.0, "viscous_friction": 0.0}, "elbow": {"velocity": 2.0, "position": [-0.5, 0.5]}}
    changed = load(PENDULUM | {"limits": changes}).limits
    np.testing.assert_array_equal(changed.velocity, [1, 2])
    np.testing.assert_array_equal(changed.viscous_friction, [0, 0])
    np.testing.assert_array_equal(changed.lower, [-3, -0.5])
    np.testing.assert_array_equal(changed.upper, [3, 0.5])
    with pytest.raises(ValueError, match="read-only"):
        limits.torque[0] = 1e9


@pytest.mark.parametrize(
    ("actuator", "torque"),
    [
        ('<motor joint="elbow" gear="5" ctrlrange="-3 3" forcerange="-2 2"/>', 10.0),
        ('<motor joint="elbow" gear="-5" ctrlrange="-3 3"/>', 15.0),
        ('<general joint="elbow" gear="5" gainprm="4" ctrlrange="-3 2"/>', 40.0),
        ('<position joint="elbow" kp="100" ctrlrange="-1 1" forcerange="-7 7"/>', 7.0),
        ('<motor joint="elbow" ctrlrange="-3 3"/><motor joint="shoulder" ctrlrange="-9 9"/>', 3.0),
    ],
)
def test_a_torque_limit_is_what_the_actuator_can_give(tmp_path: Path, actuator: str, torque: float) -> None:
    text = (FIXTURES / "double_pendulum.xml").read_text(encoding="utf-8")
    text = re.sub("<actuator>.*</actuator>", f"<actuator>{actuator}</actuator>", text)
    (tmp_path / "arm.xml").write_text(text, encoding="utf-8")
    limits = load(PENDULUM | {"model": str(tmp_path / "arm.xml")}).limits.torque
    assert limits[1] == pytest.approx(torque)
    assert limits[0] == (9.0 if "shoulder" in actuator else 20.0)


def test_joint_friction_can_be_left_out() -> None:
    limits = load(TX90L | {"joint_friction": False}).limits
    assert not limits.dry_friction.any()
    assert not limits.viscous_friction.any()


URDF = {"model": "two_links.urdf", "tool": "tool"}
URDF_LIMITS = {"all": {"acceleration": 5.0}, "slide": {"velocity": 0.7}}


def test_urdf_carries_limits_and_joint_friction() -> None:
    robot = load(URDF | {"limits": URDF_LIMITS})
    assert robot.joint_names == ("hinge", "slide")
    np.testing.assert_array_equal(robot.hinges, [True, False])
    np.testing.assert_array_equal(robot.limits.lower, [-2, 0])
    np.testing.assert_array_equal(robot.limits.upper, [2.5, 0.3])
    np.testing.assert_array_equal(robot.limits.velocity, [3, 0.7])
    np.testing.assert_array_equal(robot.limits.torque, [40, 60])
    np.testing.assert_array_equal(robot.limits.dry_friction, [0.25, 0])
    np.testing.assert_array_equal(robot.limits.viscous_friction, [0.5, 0])
    q, q1, q2 = np.array([[0.5, 0.1]]), np.array([[1.0, 0.0]]), np.zeros((1, 2))
    found = robot.dynamics(q, q1, q2)
    np.testing.assert_allclose(found.carrier.position[0], [0.7 * np.cos(0.5), 0.7 * np.sin(0.5), 0.1], atol=1e-12)
    assert found.mass_matrix[0, 0, 0] == pytest.approx(0.03 + 2 * 0.2**2 + 0.01 + 1 * 0.6**2)
    assert found.force_x[0, 1] == pytest.approx(-1 * 0.6)  # centrifugal force on the slide, held inwards


def test_what_is_left_out_of_a_urdf_is_noted() -> None:
    notes = load(URDF | {"limits": URDF_LIMITS}).notes
    assert len(notes) == 1
    assert "package://nowhere_description/meshes/base.stl" in notes[0]
    assert "base_link" in notes[0]


def test_missing_limits_are_named_with_their_joints_all_at_once() -> None:
    with pytest.raises(RobotError) as error:
        load(URDF)
    (velocity,) = (problem.message for problem in error.value.problems)
    assert "velocity limit for slide;" in velocity
    with pytest.raises(RobotError) as error:
        load(URDF | {"limits": {"all": {"torque": np.inf}}})
    velocity, acceleration = (problem.message for problem in error.value.problems)
    assert "acceleration limit for hinge, slide;" in acceleration
    assert "`robot.limits.all: {acceleration: ...}`" in acceleration


def test_a_joint_with_a_torque_limit_needs_no_acceleration_limit() -> None:
    robot = load(URDF | {"limits": {"slide": {"velocity": 0.7, "acceleration": 3.0}}})
    np.testing.assert_array_equal(robot.limits.acceleration, [np.inf, 3.0])


FLAGS = '<option><flag gravity="disable" contact="disable" constraint="disable" spring="disable"/></option>'


def test_flags_of_the_file_change_neither_dynamics_nor_collisions(tmp_path: Path) -> None:
    text = (FIXTURES / "double_pendulum.xml").read_text(encoding="utf-8")
    (tmp_path / "arm.xml").write_text(text.replace("<worldbody>", FLAGS + "<worldbody>", 1), encoding="utf-8")
    plain, flagged = load(PENDULUM), load(PENDULUM | {"model": str(tmp_path / "arm.xml")})
    q = np.array([[0.3, -0.4]])
    zero = np.zeros_like(q)
    assert np.abs(plain.dynamics(q, zero, zero).force_0).min() > 0.1
    assert np.array_equal(plain.dynamics(q, zero, zero).force_0, flagged.dynamics(q, zero, zero).force_0)
    obstacle = '<worldbody><geom type="box" pos="0 0 0" size="9 9 9"/>'
    (tmp_path / "arm.xml").write_text(text.replace("<worldbody>", FLAGS + obstacle, 1), encoding="utf-8")
    config = make_config(PENDULUM | {"model": str(tmp_path / "arm.xml")})
    assert CollisionCheck(config, load_robot(config)).first(q) is not None


def test_joints_without_a_name_get_one(tmp_path: Path) -> None:
    text = (FIXTURES / "double_pendulum.xml").read_text(encoding="utf-8")
    text = text.replace('joint name="shoulder"', "joint")
    text = re.sub(r'<body name="\w+"', "<body", text)
    (tmp_path / "arm.xml").write_text(text, encoding="utf-8")
    robot = {"model": str(tmp_path / "arm.xml"), "tool": "tip"}
    assert load(robot).joint_names == ("joint_1", "elbow")
    assert load(robot | {"limits": {"joint_1": {"torque": 1.25}}}).limits.torque[0] == 1.25
    config = make_config(robot | {"locked": {"joint_1": 0.3}})
    found, plain = load_robot(config), load(PENDULUM | {"locked": {"shoulder": 0.3}})
    q = np.array([[0.2]])
    assert np.allclose(found.carrier_pose(q)[0], plain.carrier_pose(q)[0])


def bad(robot: dict[str, Any], **more: Any) -> str:
    with pytest.raises(RobotError) as error:
        load(robot, **more)
    assert all("\n" not in problem.message for problem in error.value.problems)
    return str(error.value)


def test_unknown_robots_and_files_are_named_with_the_choices() -> None:
    assert bad({"model": "tx90"}).startswith("robot.model: unknown robot 'tx90'")
    assert "tx90l" in bad({"model": "tx90"})
    assert f"no file {FIXTURES / 'missing.urdf'}" in bad({"model": "missing.urdf"})
    assert "not found in the share folders" in bad({"model": "package://nowhere/robot.urdf"})


def world(text: str) -> str:
    return f"<mujoco><worldbody><body>{text}</body></worldbody></mujoco>"


def test_what_xacro_left_in_comments_does_no_harm(tmp_path: Path) -> None:
    text = (FIXTURES / "two_links.urdf").read_text()
    (tmp_path / "arm.urdf").write_text(text.replace("</robot>", "<!-- $(find arm) ${prefix} --></robot>"))
    assert load({"model": "arm.urdf", "tool": "tool", "limits": URDF_LIMITS}, folder=tmp_path).n == 2


def test_what_tendons_do_and_no_plan_knows_is_noted(tmp_path: Path) -> None:
    tendons = "<tendon>{}</tendon>"
    joint = "<joint joint='elbow' coef='1'/>"
    for made, noted in (
        (f"<fixed name='cable' range='-0.2 0.2'>{joint}</fixed>", ["cable"]),
        (f"<fixed name='spring' stiffness='3'>{joint}</fixed><fixed damping='1'>{joint}</fixed>", ["tendon_1"]),
        (f"<fixed name='spring' stiffness='3'>{joint}</fixed>", []),
    ):
        text = (FIXTURES / "double_pendulum.xml").read_text().replace("</mujoco>", tendons.format(made) + "</mujoco>")
        (tmp_path / "arm.xml").write_text(text)
        notes = load(PENDULUM | {"model": "arm.xml"}, folder=tmp_path).notes
        assert [note.rpartition(": ")[2] for note in notes] == noted


@pytest.mark.parametrize(
    ("name", "text", "complaint"),
    [
        ("broken.xml", "<mujoco><worldbody>", "not a model that MuJoCo can read: "),
        ("broken.urdf", "<robot name='x'><link>", "not well-formed XML: "),
        ("arm.xacro", "<robot name='x'><link name='${prefix}tool'/></robot>", "expected the URDF that `xacro` makes"),
        ("arm.urdf", "<robot name='x'><xacro:include filename='a'/></robot>", "expected the URDF that `xacro` makes"),
        ("text.xml", "no XML at all", "not a model that MuJoCo can read: "),
        ("schema.xml", world("<jiont/>"), "jiont"),
        ("massless.xml", world("<joint/>"), "MuJoCo cannot use the model: "),
        ("rock.xml", world("<freejoint name='drift'/><geom size='1'/>"), "free joint 'drift'"),
        ("ball.xml", world("<joint name='hip' type='ball'/><geom size='1'/>"), "ball joint 'hip'"),
        ("fixed.xml", world("<geom size='1'/>"), "has no joint"),
    ],
)
def test_a_model_that_cannot_be_used_is_an_error_of_one_line(
    tmp_path: Path, name: str, text: str, complaint: str
) -> None:
    (tmp_path / name).write_text(text)
    message = bad({"model": name}, folder=tmp_path)
    assert message.startswith("robot.model: ")
    assert name in message
    assert complaint in message


def test_an_unknown_tool_is_an_error_that_lists_sites_and_bodies() -> None:
    message = bad(PENDULUM | {"tool": "gripper"})
    assert "no site or body 'gripper'" in message
    assert "its sites are: tip;" in message
    assert "its bodies are: upper, lower" in message


def test_unknown_joints_are_errors_that_list_the_joints() -> None:
    message = bad(PENDULUM | {"limits": {"wrist": {"velocity": 1.0}, "knee": {"torque": 1.0}}})
    assert "robot.limits.wrist: " in message
    assert "robot.limits.knee: " in message
    assert "its joints are: shoulder, elbow" in message
    assert "has no joint wrist; its joints are: shoulder, elbow" in bad(PENDULUM | {"locked": {"wrist": 0.0}})
    assert "at least one must move" in bad(PENDULUM | {"locked": {"shoulder": 0.0, "elbow": 0.0}})


def test_limits_for_the_wrong_number_of_joints_are_an_error(tmp_path: Path) -> None:
    text = (FIXTURES / "double_pendulum.xml").read_text()
    (tmp_path / "short.xml").write_text(text.replace('data="50 60"', 'data="50"'))
    message = bad({"model": "short.xml", "tool": "tip"}, folder=tmp_path)
    assert "acceleration_limit has 1 values; it needs one for each of the 2 joints" in message


def test_a_body_with_several_joints_is_locked_as_a_whole_or_not(tmp_path: Path) -> None:
    text = (FIXTURES / "gantry.xml").read_text()
    two = text.replace('<joint name="z" type="slide" axis="0 0 1" range="-2 2"/>', "").replace(
        '<joint name="yaw"', '<joint name="z" type="slide" axis="0 0 1" range="-2 2"/><joint name="yaw"'
    )
    (tmp_path / "two.xml").write_text(two)
    robot = {"model": "two.xml", "tool": "tool"}
    assert "lock yaw too, or none" in bad(robot | {"locked": {"z": 0.5}}, folder=tmp_path)
    both = load(robot | {"locked": {"z": 0.5, "yaw": np.pi / 2}}, folder=tmp_path)
    position, rotation = both.carrier_pose(np.array([[1.0, 2.0]]))
    np.testing.assert_allclose(position[0], [1.0, 2.0, 0.5], atol=1e-12)
    np.testing.assert_allclose(rotation[0], [[0, -1, 0], [1, 0, 0], [0, 0, 1]], atol=1e-12)


GRIPPER = """
<mujoco><compiler angle="radian" autolimits="true"/>
  <custom><numeric name="velocity_limit" data="1 1 1"/><numeric name="acceleration_limit" data="9 9 9"/></custom>
  <worldbody><body name="arm"><joint name="swing" actuatorfrcrange="-9 9"/><geom size=".1"/><site name="tool"/>
    <frame pos="0.1 0 0" euler="0 0 1">
      <body name="swing"><joint name="left" type="slide" axis="1 0 0" actuatorfrcrange="-9 9"/><geom size=".01"/></body>
      <body name="r"><joint name="right" type="slide" axis="1 0 0" actuatorfrcrange="-9 9"/><geom size=".01"/></body>
    </frame></body></worldbody>
  <tendon><fixed name="grip"><joint joint="left" coef="1"/><joint joint="right" coef="1"/></fixed></tendon>
  <equality><joint name="both" joint1="left" joint2="right"/></equality>
  <actuator><motor name="m" joint="swing"/><general name="g" tendon="grip"/></actuator>
  <sensor><jointpos joint="left"/><tendonpos tendon="grip"/><actuatorfrc actuator="g"/>
    <framepos objtype="body" objname="swing"/></sensor>
  <keyframe><key qpos="0 0.1 0.1"/></keyframe>
</mujoco>
"""


def test_locking_the_fingers_of_a_gripper_takes_out_what_hangs_on_them(tmp_path: Path) -> None:
    (tmp_path / "gripper.xml").write_text(GRIPPER)
    config = make_config(
        {"model": "gripper.xml", "tool": "tool", "locked": {"left": 0.5, "right": 0.0}}, folder=tmp_path
    )
    spec = load_model(config).spec
    model = spec.compile()
    assert [item.name for item in spec.actuators] == ["m"]
    assert [item.objname for item in spec.sensors] == ["swing"]
    assert (model.nv, model.ntendon, model.neq, model.nkey) == (1, 0, 0, 0)
    finger = np.array(
        [0.1 + 0.5 * np.cos(1.0), 0.5 * np.sin(1.0), 0.0]
    )  # moved along the frame that is turned by 1 rad
    np.testing.assert_allclose(model.body("swing").pos, finger, atol=1e-12)


def test_coupled_joints_are_an_error_that_names_the_constraint(tmp_path: Path) -> None:
    (tmp_path / "gripper.xml").write_text(GRIPPER)
    message = bad({"model": "gripper.xml", "tool": "tool"}, folder=tmp_path)
    assert "equality constraints (both)" in message


def test_package_addresses_are_looked_up_in_the_share_folders(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "my_arm" / "urdf"
    folder.mkdir(parents=True)
    (folder / "arm.urdf").write_text((FIXTURES / "two_links.urdf").read_text())
    monkeypatch.setenv("ROS_PACKAGE_PATH", str(tmp_path))
    assert resolve_package("package://my_arm/urdf/arm.urdf") == folder / "arm.urdf"
    robot = load({"model": "package://my_arm/urdf/arm.urdf", "tool": "tool", "limits": URDF_LIMITS})
    assert robot.joint_names == ("hinge", "slide")


def test_a_urdf_keeps_collision_meshes_that_are_found(tmp_path: Path) -> None:
    text = (
        (FIXTURES / "two_links.urdf")
        .read_text()
        .replace("package://nowhere_description/meshes/base.stl", "meshes/t.obj")
    )
    corners = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
    (tmp_path / "meshes").mkdir()
    (tmp_path / "meshes" / "t.obj").write_text(corners)
    (tmp_path / "two_links.urdf").write_text(text)
    robot = load(URDF | {"limits": URDF_LIMITS}, folder=tmp_path)
    assert robot.notes == ()
    assert robot.spec.compile().nmesh == 1


@pytest.mark.parametrize("named", ["sub/part.xml", "sub/inner.xml", "meshes/link.stl"])
def test_the_hash_of_a_model_is_that_of_all_files_that_it_names(tmp_path, named):
    for folder in ("sub", "meshes"):
        (tmp_path / folder).mkdir()
    model = tmp_path / "robot.xml"
    model.write_text('<mujoco><compiler meshdir="meshes"/><include file="sub/part.xml"/></mujoco>')
    (tmp_path / "sub" / "part.xml").write_text(
        '<mujocoinclude><mesh file="link.stl"/><include file="inner.xml"/></mujocoinclude>'
    )
    (tmp_path / "sub" / "inner.xml").write_text("<mujocoinclude/>")
    (tmp_path / "meshes" / "link.stl").write_bytes(b"solid")
    before = model_hash(model)
    assert model_hash(model) == before
    (tmp_path / named).write_bytes((tmp_path / named).read_bytes() + b" ")
    assert model_hash(model) != before


def test_the_hash_of_a_model_that_names_no_file_is_that_of_its_file():
    file = MODELS / "tx90l.xml"
    assert model_hash(file) == hashlib.sha256(file.read_bytes()).hexdigest()
