"""Paths: geometry of the tray path, inverse kinematics, joint waypoints, and every way in which a path is refused."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

import robustopt.path
from robustopt.config import Config, PathConfig
from robustopt.config.load import load_config
from robustopt.errors import PathError, RobotError
from robustopt.path import build_path
from robustopt.path.collision import CollisionCheck
from robustopt.path.inverse_kinematics import rotation_vector
from robustopt.path.pose_path import TURN_LENGTH, PosePath, pose_path
from robustopt.robot import Robot, load_robot
from robustopt.robot.model_file import resolve_package

FIXTURES = Path(__file__).parent / "fixtures"
GANTRY = {"model": "gantry.xml", "tool": "tool"}
SCARA = {"model": "scara.xml", "tool": "tool", "collision": {"check": False}}
EDGE_ON = {"size": [0.3, 0.3, 0.01], "mass": 1.0, "pose": {"position": [0, 0, 0.18], "rpy": [0, -np.pi / 2, 0]}}
FLAT = {"size": [0.3, 0.3, 0.01], "mass": 1.0}
AZIMUTH = float(np.arctan2(0.5, 0.75))
SWEEP = [
    {"position": [0.75, -0.5, 0.75], "yaw": -AZIMUTH},
    {"position": [0.75, 0.5, 0.75], "yaw": AZIMUTH},
]


def build(
    path: dict[str, Any], robot: dict[str, Any] | None = None, tray: dict[str, Any] | None = None, **more: Any
) -> tuple[robustopt.path.Path, Robot]:
    config = Config.model_validate(
        {"name": "test", "robot": robot or GANTRY, "tray": tray or FLAT, "path": path, "folder": FIXTURES, **more}
    )
    loaded = load_robot(config)
    return build_path(config, loaded), loaded


def build_tx90l(poses: list[dict[str, Any]], robot: dict[str, Any] | None = None, **more: Any) -> tuple[Any, Robot]:
    path = {"tray_poses": poses} | more.pop("path", {})
    return build(path, {"model": "tx90l"} | (robot or {}), more.pop("tray", EDGE_ON), **more)


def refused(*args: Any, error: type[Exception] = PathError, builder: Any = build, **more: Any) -> str:
    with pytest.raises(error) as caught:
        builder(*args, **more)
    return str(caught.value)


def poses(*positions: tuple[float, float, float], **same: Any) -> list[dict[str, Any]]:
    return [{"position": list(position), **same} for position in positions]


# the tray path


def test_a_straight_segment_is_straight_and_turns_at_a_constant_rate() -> None:
    path = pose_path(
        PathConfig.model_validate({"tray_poses": [{"position": [0, 0, 0]}, {"position": [1, 2, 2], "yaw": 1.2}]})
    )
    assert path.length == pytest.approx(np.hypot(3.0, TURN_LENGTH * 1.2))
    share = np.linspace(0, 1, 7)
    position, rotation = path.pose(share * path.length)
    np.testing.assert_allclose(position, np.outer(share, [1, 2, 2]), atol=1e-12)
    np.testing.assert_allclose(rotation, Rotation.from_euler("z", 1.2 * share[:, None]).as_matrix(), atol=1e-12)


def corner(blend: float, *points: tuple[float, float, float], yaws: tuple[float, ...] = ()) -> PosePath:
    listed = [
        {"position": list(point), "yaw": yaw} for point, yaw in zip(points, yaws or [0.0] * len(points), strict=True)
    ]
    return pose_path(PathConfig.model_validate({"tray_poses": listed, "blend": blend}))


def test_a_right_angle_is_rounded_within_the_blend_and_nowhere_else() -> None:
    path = corner(0.2, (0, 0, 0), (1, 0, 0), (1, 1, 0))
    np.testing.assert_array_equal(path.breaks, [0.0, 2.0])
    position, _ = path.pose(np.array([0.0, 0.8, 1.0, 1.2, 2.0]))
    # at the middle, the smoothstep has integrated to 3/16 of the blend's full length 0.4 on the side of each leg
    middle = 2 * 0.2 * (0.5**3 - 0.5**4 / 2)
    np.testing.assert_allclose(
        position, [[0, 0, 0], [0.8, 0, 0], [1 - middle, middle, 0], [1, 0.2, 0], [1, 1, 0]], atol=1e-12
    )


def test_a_blend_is_cut_to_half_of_its_shorter_segment() -> None:
    path = corner(5.0, (0, 0, 0), (1, 0, 0), (1, 0.4, 0))
    np.testing.assert_allclose(path.blend, [0, 0.2, 0])


@pytest.mark.parametrize("blend", [0.0, 0.1])
def test_a_reversal_is_a_stop_whatever_the_blend(blend: float) -> None:
    path = corner(blend, (0, 0, 0), (1, 0, 0), (0, 0, 0), yaws=(0.0, 0.5, 0.0))
    np.testing.assert_allclose(path.breaks, [0, path.length / 2, path.length])


def test_a_corner_without_blend_is_a_stop() -> None:
    np.testing.assert_allclose(corner(0.0, (0, 0, 0), (1, 0, 0), (1, 1, 0)).breaks, [0, 1, 2])


@pytest.mark.parametrize("blend", [0.0, 0.1])
def test_a_waypoint_on_the_way_is_neither_a_stop_nor_rounded(blend: float) -> None:
    path = corner(blend, (0, 0, 0), (0.3, 0.3, 0), (1, 1, 0), yaws=(0.0, 0.3, 1.0))
    assert len(path.breaks) == 2
    assert not path.blend.any()


def test_another_turning_rate_is_a_corner_even_on_a_straight_line() -> None:
    assert len(corner(0.0, (0, 0, 0), (0.5, 0, 0), (1, 0, 0), yaws=(0.0, 0.1, 0.9)).breaks) == 3


vectors = st.tuples(*[st.floats(-1, 1)] * 3)


@given(ends=st.tuples(vectors, vectors), angles=st.tuples(vectors, vectors, vectors), blend=st.floats(0.02, 0.3))
@settings(max_examples=40, deadline=None)
def test_a_rounded_corner_is_twice_continuously_differentiable(
    ends: tuple[Any, Any], angles: tuple[Any, Any, Any], blend: float
) -> None:
    listed = [{"position": p, "rpy": rpy} for p, rpy in zip([ends[0], (0.1, 0.2, 0.3), ends[1]], angles, strict=True)]
    try:
        path = pose_path(PathConfig.model_validate({"tray_poses": listed, "blend": blend}))
    except PathError:
        assume(False)
    assume(path.blend[1] > 0.02)
    h = 1e-4
    for end in (path.start[1] - path.blend[1], path.start[1] + path.blend[1]):
        before, after = end - h * np.arange(4), end + h * np.arange(4)
        for sides in _one_sided(path, before), _one_sided(path, after):
            assert np.isfinite(sides[0]).all()
        (velocity_before, acceleration_before), (velocity_after, acceleration_after) = (
            _one_sided(path, before, -h), _one_sided(path, after, h)
        )  # fmt: skip
        np.testing.assert_allclose(velocity_before, velocity_after, atol=30 * (h / path.blend[1]) ** 2 + 1e-9)
        # the third derivative is at most 3 |d| / r^2 or so: over a step h the second derivative moves no further
        np.testing.assert_allclose(acceleration_before, acceleration_after, atol=30 * h / path.blend[1] ** 2 + 1e-3)


def _one_sided(path: PosePath, sigma: np.ndarray, h: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    """First and second one-sided differences of position and of the turn from the first of the poses."""
    position, rotation = path.pose(sigma)
    turned = np.array([rotation_vector((rotation[0].T @ R).ravel().tolist()) for R in rotation])
    values = np.hstack((position, turned))
    velocity = (-3 * values[0] + 4 * values[1] - values[2]) / (2 * h)
    acceleration = (2 * values[0] - 5 * values[1] + 4 * values[2] - values[3]) / h**2
    return velocity, acceleration


def test_orientation_can_be_given_as_angles_or_quaternion() -> None:
    rpy = (0.2, -0.3, 0.7)
    quaternion = 3.0 * Rotation.from_euler("xyz", rpy).as_quat(scalar_first=True)
    listed = [{"position": [0, 0, 0], "rpy": rpy}, {"position": [1, 0, 0], "quaternion": quaternion.tolist()}]
    path = pose_path(PathConfig.model_validate({"tray_poses": listed}))
    roll, pitch, yaw = (Rotation.from_euler(axis, angle).as_matrix() for axis, angle in zip("xyz", rpy, strict=True))
    np.testing.assert_allclose(path.rotation, [yaw @ pitch @ roll] * 2, atol=1e-12)


# joint paths from tray poses


def test_a_gantry_moves_as_its_tray_does() -> None:
    path, robot = build({"tray_poses": [{"position": [-1, 0, 0.5], "yaw": -1.0}, {"position": [1, 1, 0], "yaw": 1.0}]})
    s = np.linspace(0, 1, 33)
    start, end = np.array([-1, 0, 0.5, -1.0]), np.array([1, 1, 0, 1.0])
    np.testing.assert_allclose(path(s), start + np.outer(s, end - start), atol=1e-9)
    np.testing.assert_allclose(path(s, 1), np.tile(end - start, (33, 1)), atol=1e-7)
    np.testing.assert_allclose(path(s, 2), 0.0, atol=1e-5)
    assert robot.joint_names == ("x", "y", "z", "yaw")


def test_a_turn_on_the_spot_is_a_path() -> None:
    path, _ = build({"tray_poses": [{"position": [0, 0, 0], "yaw": yaw} for yaw in (0.0, 2.5, 5.0)]})
    np.testing.assert_array_equal(path.breaks, [0, 1])
    np.testing.assert_allclose(path(np.array([0.25, 1.0]))[:, 3], [1.25, 5.0], atol=1e-9)


def test_pieces_are_as_long_as_their_part_of_the_path() -> None:
    path, _ = build({"tray_poses": poses((0, 0, 0), (1, 0, 0), (1, 2, 0), (1, 1, 0))})
    np.testing.assert_allclose(path.breaks, [0, 0.25, 0.75, 1], atol=1e-12)
    np.testing.assert_array_equal(path.piece_at(np.array([0, 0.2, 0.25, 0.74, 0.75, 1.0])), [0, 0, 1, 1, 2, 2])
    at_stop = np.array([0.25, 0.25])
    np.testing.assert_allclose(path.evaluate(at_stop, np.array([0, 1])), [[1, 0, 0, 0]] * 2, atol=1e-9)
    np.testing.assert_allclose(path.evaluate(at_stop, np.array([0, 1]), 1), [[4, 0, 0, 0], [0, 4, 0, 0]], atol=1e-7)
    np.testing.assert_allclose(path(np.array([0.25]), 1), [[0, 4, 0, 0]], atol=1e-7)


def test_labels_are_in_the_words_of_the_configuration() -> None:
    path, _ = build({"tray_poses": poses((0, 0, 0), (1, 0, 0), (1, 2, 0), (1, 1, 0))})
    assert path.label(0.0) == "at tray_poses[0]"
    assert path.label(0.25) == "at tray_poses[1]"
    assert path.label(0.45) == "between tray_poses[1] and tray_poses[2], at 40 %"
    assert path.label(1.0) == "at tray_poses[3]"


@pytest.fixture(scope="module")
def sweeps() -> tuple[Any, Robot]:
    return build_tx90l([SWEEP[0], SWEEP[1], SWEEP[0], SWEEP[1]])


def test_three_sweeps_of_the_tx90l_follow_the_pose_path(sweeps: tuple[Any, Robot]) -> None:
    path, robot = sweeps
    wanted = pose_path(PathConfig.model_validate({"tray_poses": [SWEEP[0], SWEEP[1], SWEEP[0], SWEEP[1]]}))
    np.testing.assert_allclose(path.breaks, [0, 1 / 3, 2 / 3, 1])
    s = np.linspace(0, 1, 1501)
    position, rotation = robot.carrier_pose(path(s))
    wanted_position, wanted_rotation = wanted.pose(s * wanted.length)
    assert np.linalg.norm(position - wanted_position, axis=1).max() < 0.0002
    assert Rotation.from_matrix(rotation.transpose(0, 2, 1) @ wanted_rotation).magnitude().max() < 0.001
    at_waypoints = robot.carrier_pose(path(path.waypoints))[0]
    np.testing.assert_allclose(at_waypoints, wanted.position, atol=1e-9)


def test_three_sweeps_of_the_tx90l_have_the_elbow_up_and_keep_clear_of_the_limits(sweeps: tuple[Any, Robot]) -> None:
    path, robot = sweeps
    q = path(np.linspace(0, 1, 301))
    assert np.abs(q[:, 1]).max() < 0.5  # the upper arm stands up
    assert np.minimum(q - robot.limits.lower, robot.limits.upper - q).min() > 0.3


def test_derivatives_are_derivatives_of_one_another(sweeps: tuple[Any, Robot]) -> None:
    path, _ = sweeps
    s, h = np.linspace(0.01, 0.32, 40), 1e-5
    for order in (0, 1, 2):
        difference = (path(s + h, order) - path(s - h, order)) / (2 * h)
        np.testing.assert_allclose(path(s, order + 1), difference, atol=1e-3 * 10**order)


def test_a_sweep_back_is_the_sweep_there_mirrored_in_time(sweeps: tuple[Any, Robot]) -> None:
    path, _ = sweeps
    s = np.linspace(0, 1 / 3, 50)
    np.testing.assert_allclose(path(2 / 3 - s), path(s), atol=1e-7)


def test_the_same_configuration_gives_the_same_path(sweeps: tuple[Any, Robot]) -> None:
    again, _ = build_tx90l([SWEEP[0], SWEEP[1], SWEEP[0], SWEEP[1]])
    s = np.linspace(0, 1, 50)
    np.testing.assert_array_equal(again(s), sweeps[0](s))


def test_a_finer_tolerance_is_kept() -> None:
    path, robot = build_tx90l(SWEEP, path={"tolerance": {"position": 1e-9, "angle": 1e-9}})
    wanted = pose_path(PathConfig.model_validate({"tray_poses": SWEEP}))
    s = np.linspace(0, 1, 777)
    assert np.linalg.norm(robot.carrier_pose(path(s))[0] - wanted.pose(s * wanted.length)[0], axis=1).max() < 3e-9


def test_the_base_pose_moves_the_robot_not_the_path(sweeps: tuple[Any, Robot]) -> None:
    turn = Rotation.from_euler("z", 0.9)
    moved = [
        {"position": (np.array([1, 2, 0.5]) + turn.apply(pose["position"])).tolist(), "yaw": pose["yaw"] + 0.9}
        for pose in SWEEP
    ]
    path, _ = build_tx90l(moved, {"base": {"position": [1, 2, 0.5], "rpy": [0, 0, 0.9]}})
    s = np.linspace(0, 1, 20)
    np.testing.assert_allclose(path(s), sweeps[0](s / 3), atol=1e-8)


def test_the_start_position_chooses_the_branch() -> None:
    start = [-0.64, 2.09, 1.8, 0.06, -1.27, -0.02]  # elbow down
    path, _ = build_tx90l(SWEEP, path={"start": start})
    np.testing.assert_allclose(path(np.zeros(1))[0], start, atol=0.02)


def test_hinges_start_in_the_turn_that_leaves_room_for_the_path() -> None:
    yaws = [3.0, 5.5, 8.0, 10.5]  # 7.5 rad in all, within [-7, 7] only if the path starts a full turn lower
    path, robot = build({"tray_poses": [{"position": [0, 0, 0], "yaw": yaw} for yaw in yaws]})
    yaw = path(np.linspace(0, 1, 50))[:, 3]
    assert yaw.max() - yaw.min() == pytest.approx(7.5, abs=1e-6)
    assert yaw.min() > robot.limits.lower[3]
    assert yaw.max() < robot.limits.upper[3]


def test_a_redundant_arm_follows_smoothly() -> None:
    seven = {"model": "seven_joints.xml", "tool": "tool"}
    listed = poses((0.35, -0.25, 0.5), (0.4, 0.2, 0.6), (0.3, 0.3, 0.4))
    small = {"size": [0.1, 0.1, 0.01], "mass": 0.2}
    path, robot = build({"tray_poses": listed, "blend": 0.1}, seven, small)
    s = np.linspace(0, 1, 400)
    wanted = pose_path(PathConfig.model_validate({"tray_poses": listed, "blend": 0.1}))
    assert np.linalg.norm(robot.carrier_pose(path(s))[0] - wanted.pose(s * wanted.length)[0], axis=1).max() < 0.0002
    assert np.abs(path(s, 1)).max() < 15
    assert np.minimum(path(s) - robot.limits.lower, robot.limits.upper - path(s)).min() > 0


# tray poses that are refused


def test_too_few_and_repeated_poses_are_errors() -> None:
    assert "at least two poses; there is 1" in refused({"tray_poses": poses((0, 0, 0))})
    message = refused({"tray_poses": poses((0, 0, 0), (0, 0, 0), (1, 0, 0), (1, 0, 0))})
    assert "path.tray_poses[1]: repeats tray_poses[0]" in message
    assert "path.tray_poses[3]: repeats tray_poses[2]" in message


def test_half_a_turn_is_an_error_that_asks_for_a_pose_between() -> None:
    message = refused({"tray_poses": [{"position": [0, 0, 0]}, {"position": [1, 0, 0], "yaw": np.pi}]})
    assert message.startswith("path.tray_poses[1]: is half a turn from tray_poses[0]")


def test_a_pose_that_is_hardly_out_of_reach_says_by_how_much(tmp_path: Path) -> None:
    poses = [{"position": [0.2, 0, 0]}, {"position": [0.4, 0, 0], "rpy": [0.0, 0.002, 0.0]}]  # a gantry does not tilt
    message = refused({"tray_poses": poses})
    assert "path.tray_poses[1]: is out of reach" in message
    assert "0.002 rad away" in message


def test_every_pose_out_of_reach_is_named_with_its_distance() -> None:
    far = [SWEEP[0], {"position": [1.9, 0, 0.75]}, SWEEP[1], {"position": [0.75, 0, 2.9]}]
    message = refused(far, builder=build_tx90l)
    assert "path.tray_poses[1]: is out of reach: the nearest pose is" in message
    assert "path.tray_poses[3]: is out of reach" in message
    assert "tray_poses[0]" not in message
    assert "tray_poses[2]" not in message


def test_an_orientation_out_of_reach_is_named() -> None:
    message = refused({"tray_poses": [{"position": [0, 0, 0]}, {"position": [1, 0, 0], "rpy": [0.5, 0, 0]}]})
    assert "path.tray_poses[1]: is out of reach" in message
    assert "0.5 rad away" in message


def test_a_joint_limit_on_the_way_is_named() -> None:
    message = refused({"tray_poses": poses((0, 0, 0), (0, 0, 1.5))}, GANTRY | {"limits": {"z": {"position": [-1, 1]}}})
    assert "at tray_poses[1]: z would be at 1.500 m, beyond its limit of 1.000 m" in message


def test_a_segment_that_leaves_the_reach_between_reachable_poses_is_named() -> None:
    # the line y = 0.1 m enters the hole of 0.2 m around the shoulder at x = sqrt(0.2^2 - 0.1^2) = 0.173 m
    message = refused({"tray_poses": poses((0.4, 0.1, 0), (-0.4, 0.1, 0))}, SCARA)
    assert "path.tray_poses: between tray_poses[0] and tray_poses[1], at 28 %: the arm gets out of reach" in message


def test_a_singularity_on_the_way_is_an_error(tmp_path: Path) -> None:
    # with links of one length, the line 0.5 mm beside the shoulder asks it to turn round within a millimetre
    text = (FIXTURES / "scara.xml").read_text()
    (tmp_path / "scara.xml").write_text(text.replace('pos="0.3 0 0"', 'pos="0.5 0 0"'))
    beside = {"tray_poses": poses((0.4, 0.0005, 0), (-0.4, 0.0005, 0))}
    message = refused(beside, SCARA, folder=tmp_path)
    assert "between tray_poses[0] and tray_poses[1], at 50 %: the arm meets a singularity" in message


def test_a_path_that_passes_a_singularity_at_a_distance_is_followed(tmp_path: Path) -> None:
    text = (FIXTURES / "scara.xml").read_text()
    (tmp_path / "scara.xml").write_text(text.replace('pos="0.3 0 0"', 'pos="0.5 0 0"'))
    path, robot = build({"tray_poses": poses((0.4, 0.05, 0), (-0.4, 0.05, 0))}, SCARA, folder=tmp_path)
    s = np.linspace(0, 1, 400)
    np.testing.assert_allclose(robot.carrier_pose(path(s))[0][:, 1], 0.05, atol=0.0002)
    # the shoulder turns with the azimuth and with the fold of the elbow; where the tray is nearest, at distance d, the
    # fold rests and the azimuth turns by 1 / d per metre, over 0.8 m
    assert np.abs(path(s, 1)[:, 0]).max() == pytest.approx(0.8 / 0.05, rel=0.01)


def test_a_path_into_another_body_is_named_with_the_bodies() -> None:
    through = {"tray_poses": poses((0, 0, 0), (0, 4, 0))}
    message = refused(through)
    # the tray's edge, 0.15 m ahead of its centre, meets the wall's face at y = 2.9 m, at 2.75 / 4 of the way
    assert "between tray_poses[0] and tray_poses[1], at 69 %: world and tray collide" in message
    assert "add [world, tray] to robot.collision.exclude" in message
    build(through, GANTRY | {"collision": {"exclude": [["tray", "world"]]}})
    build(through, GANTRY | {"collision": {"check": False}})


def test_objects_on_the_tray_collide_too() -> None:
    long = {"shape": "box", "size": [0.1, 0.9, 0.1], "mass": 0.5, "on": "tray"}
    message = refused({"tray_poses": poses((0, 0, 0), (0, 4, 0))}, objects={"plank": long})
    # the plank's end, 0.45 m ahead, meets the wall at 2.45 / 4 of the way; it is found within the step of the check
    assert "at 61 %: world and plank collide" in message or "at 62 %: world and plank collide" in message


def test_the_arm_collides_with_itself() -> None:
    message = refused(
        {"joints": [[0, 0, 0, 0, 0, 0], [0, -2.5, 2.5, 0, 0, 0]]},
        {"model": "tx90l", "limits": {"all": {"position": [-4, 4]}}},
    )
    assert "collide" in message
    assert "between joints[0] and joints[1], at" in message


def test_the_tray_may_not_hit_the_last_link_but_one() -> None:
    wrist = FLAT | {"pose": {"position": [0.0, 0.0, -0.08]}}
    message = refused({"joints": [[0.0] * 6, [0.0] * 5 + [1.0]]}, {"model": "tx90l"}, wrist)
    assert "at joints[0]: link5 and tray collide" in message


def test_neighbouring_links_of_the_tx90l_never_collide_by_construction() -> None:
    config = Config.model_validate(
        {"name": "test", "robot": {"model": "tx90l"}, "tray": FLAT, "path": {"joints": [[0.0] * 6, [0.1] * 6]}}
    )
    robot = load_robot(config)
    check = CollisionCheck(config, robot)
    assert check.overlapping == ()
    rest = np.zeros(6)
    for joint in range(6):  # every joint through its whole range, the others straight
        sweep = np.tile(rest, (60, 1))
        sweep[:, joint] = np.linspace(robot.limits.lower[joint], robot.limits.upper[joint], 60)
        collisions = [check.first(sweep[i : i + 1]) for i in range(60)]
        names = {collision.bodies for collision in collisions if collision}
        assert all(_links_apart(pair) > 1 for pair in names), names


def _links_apart(pair: tuple[str, str]) -> int:
    number = {"world": 0, "base": 0, "tray": 99} | {f"link{i}": i for i in range(1, 7)}
    return abs(number[pair[0]] - number[pair[1]])


def test_links_that_always_overlap_are_not_checked(tmp_path: Path) -> None:
    text = (FIXTURES / "seven_joints.xml").read_text().replace('size="0.04" mass="2"', 'size="0.12" mass="2"')
    (tmp_path / "seven_joints.xml").write_text(text)
    seven = {"model": "seven_joints.xml", "tool": "tool"}
    config = Config.model_validate(
        {"name": "test", "robot": seven, "tray": FLAT, "path": {"joints": [[0.0] * 7, [0.1] * 7]}, "folder": tmp_path}
    )
    check = CollisionCheck(config, load_robot(config))
    assert ("b2", "b4") in check.overlapping  # thick links on both sides of a short one
    assert ("b2", "b6") not in check.overlapping


def test_exclusions_must_name_bodies() -> None:
    exclude = {"collision": {"exclude": [["tray", "floor"]]}}
    message = refused({"tray_poses": poses((0, 0, 0), (1, 0, 0))}, GANTRY | exclude, error=RobotError)
    assert message.startswith(
        "robot.collision.exclude[0]: there is no body 'floor'; the bodies are: world, x, y, z, turn, tray"
    )


def test_the_start_position_has_one_value_for_each_joint() -> None:
    message = refused(SWEEP, builder=build_tx90l, path={"start": [0.0, 1.0]})
    assert "path.start: has 2 values; the robot has 6 joints: joint1" in message


# joint waypoints


def test_two_joint_waypoints_are_joined_by_a_line_and_three_by_a_parabola() -> None:
    s = np.linspace(0, 1, 11)
    line, _ = build({"joints": [[0, 0, 0, 0], [1, -1, 0.5, 2]]})
    np.testing.assert_allclose(line(s), np.outer(s, [1, -1, 0.5, 2]), atol=1e-12)
    np.testing.assert_allclose(line(s, 2), 0.0, atol=1e-12)
    parabola, _ = build({"joints": [[0, 0, 0, 0], [0, 1, 0, 0], [1, 1, 0, 0]]})
    np.testing.assert_allclose(parabola(s)[:, 0], -s + 2 * s**2, atol=1e-12)
    np.testing.assert_allclose(parabola(s)[:, 1], 3 * s - 2 * s**2, atol=1e-12)
    assert parabola.label(0.5) == "at joints[1]"


def test_joint_waypoints_are_joined_by_the_not_a_knot_spline_over_chord_length() -> None:
    waypoints = np.random.default_rng(3).uniform(-1, 1, (7, 4))
    path, _ = build({"joints": waypoints.tolist()}, GANTRY | {"limits": {"all": {"position": [-9, 9]}}})
    chord = np.concatenate(([0], np.cumsum(np.linalg.norm(np.diff(waypoints, axis=0), axis=1))))
    np.testing.assert_allclose(path.waypoints, chord / chord[-1], atol=1e-15)
    s = np.linspace(0, 1, 101)
    expected = CubicSpline(chord / chord[-1], waypoints, bc_type="not-a-knot")
    for order in (0, 1, 2):
        np.testing.assert_allclose(path(s, order), expected(s, order), atol=1e-9)
    np.testing.assert_array_equal(path.breaks, [0, 1])


def test_a_spline_that_overshoots_a_limit_between_waypoints_is_refused() -> None:
    swing = [[0, 0, 0, 0], [1.9, 0, 0, 0], [1.9, 1.5, 0, 0], [0, 1.5, 0, 0]]
    message = refused({"joints": swing})
    assert "path.joints: between joints[1] and joints[2], at" in message
    assert "x would be at 2.065 m, beyond its limit of 2.000 m" in message


def test_a_waypoint_on_a_limit_is_allowed() -> None:
    path, _ = build({"joints": [[-2, 0, 0, 0], [2, 0, 0, 0]]})
    np.testing.assert_allclose(path(np.ones(1))[0], [2, 0, 0, 0], atol=1e-12)


@pytest.mark.parametrize(
    "text",
    [
        "0,0,0,0\n1,2,0.5,0.25\n",
        "x,y,z,yaw\n0,0,0,0\n1,2,0.5,0.25\n",
        "\ufeffyaw, x, z, y\n0, 0, 0, 0\n0.25, 1, 0.5, 2\n\n",
    ],
    ids=["no header", "header", "columns in another order"],
)
def test_waypoints_can_come_from_a_csv_file(tmp_path: Path, text: str) -> None:
    (tmp_path / "w.csv").write_text(text, encoding="utf-8")
    (tmp_path / "gantry.xml").write_text((FIXTURES / "gantry.xml").read_text())
    path, _ = build({"joints": "w.csv"}, folder=tmp_path)
    np.testing.assert_allclose(path(np.array([0.0, 1.0])), [[0, 0, 0, 0], [1, 2, 0.5, 0.25]], atol=1e-12)


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("x,y,z,roll\n0,0,0,0\n", "the columns are x, y, z, roll; they must be the joints x, y, z, yaw"),
        ("0,0,0,0\n1,2,three,0\n", "1 value is not a finite number; first: 'three' in line 2, column z"),
        ("0,0,0,0\n1,2,nan,0\n", "1 value is not a finite number; first: 'nan' in line 2, column z"),
        ("0,0,0,0\n1,2\n", "1 row has 2 values; expected 4; first: line 2"),
        ("0,0\n1,2\n", "has 2 values; the robot has 4 joints: x, y, z, yaw"),
        ("", "at least two waypoints; there is none"),
        ("0,0,0,0\n", "at least two waypoints; there is 1"),
    ],
)
def test_a_csv_file_that_cannot_be_used_says_why(tmp_path: Path, text: str, complaint: str) -> None:
    (tmp_path / "w.csv").write_text(text)
    (tmp_path / "gantry.xml").write_text((FIXTURES / "gantry.xml").read_text())
    assert complaint in refused({"joints": "w.csv"}, folder=tmp_path)


def test_a_missing_csv_file_is_named() -> None:
    assert f"{FIXTURES / 'nowhere.csv'}: cannot be read" in refused({"joints": "nowhere.csv"})


@pytest.mark.parametrize("decimals", [9, 17])
def test_a_log_that_begins_and_ends_slowly_is_taken(decimals: int) -> None:
    """2 s at 1 kHz from rest to rest: its first and last waypoints are 4e-7 of the path apart."""
    t = np.arange(2001) / 1000
    s = np.where(t < 1, t**2 / 2, 1 - (2 - t) ** 2 / 2)
    path, _ = build({"joints": np.round(np.column_stack([s, np.sin(s), 0 * s, s / 3]), decimals).tolist()})
    tangents = path(np.array([0.0, 1.0]), 1)
    np.testing.assert_allclose(tangents[:, 1] / tangents[:, 0], np.cos([0.0, 1.0]), atol=2e-3)
    np.testing.assert_allclose(tangents[:, 3] / tangents[:, 0], 1 / 3, atol=2e-3)


def test_repeated_and_misshapen_waypoints_are_errors() -> None:
    rest = [0.0, 0.0, 0.0, 0.0]
    assert "path.joints[1]: repeats joints[0]" in refused({"joints": [rest, rest, [1, 0, 0, 0]]})
    nearly = [1.0, 5e-7, 0, 0]
    assert "path.joints[2]: repeats joints[1]" in refused({"joints": [rest, [1, 0, 0, 0], nearly, [2, 0, 0, 0]]})
    message = refused({"joints": [rest, [1, 0, 0], [1, 0, 0, 0, 0]]})
    assert "path.joints[1]: has 3 values; the robot has 4 joints" in message
    assert "path.joints[2]: has 5 values" in message


# shipped configurations

CONFIGS = sorted((Path(__file__).parents[1] / "configs").glob("waiter_*.yaml"))


@pytest.mark.parametrize("file", CONFIGS, ids=[file.stem for file in CONFIGS])
def test_the_paths_of_the_shipped_configurations_follow_their_tray_paths(file: Path) -> None:
    config = load_config(file)
    if config.robot.model.startswith("package://") and resolve_package(config.robot.model) is None:
        pytest.skip("needs the optional package example-robot-data: pip install robustopt[robots]")
    robot = load_robot(config)
    path, wanted = build_path(config, robot), pose_path(config.path)
    s = np.linspace(0, 1, 501)
    position, rotation = robot.carrier_pose(path(s))
    wanted_position, wanted_rotation = wanted.pose(s * wanted.length)
    assert np.linalg.norm(position - wanted_position, axis=1).max() < config.path.tolerance.position
    turn = Rotation.from_matrix(rotation.transpose(0, 2, 1) @ wanted_rotation).magnitude().max()
    assert turn < config.path.tolerance.angle
    assert np.minimum(path(s) - robot.limits.lower, robot.limits.upper - path(s)).min() > 0.05


def test_a_redundant_arm_with_locked_fingers_from_its_urdf_file() -> None:
    model = "package://example-robot-data/robots/panda_description/urdf/panda.urdf"
    if resolve_package(model) is None:
        pytest.skip("needs the optional package example-robot-data: pip install robustopt[robots]")
    panda = {
        "model": model,
        "tool": "panda_hand",
        "locked": {"panda_finger_joint1": 0.02, "panda_finger_joint2": 0.02},
        "limits": {"all": {"acceleration": 10.0}},
    }
    tray = {"size": [0.24, 0.24, 0.01], "mass": 0.5, "pose": {"position": [0.0, 0.0, 0.13]}}
    listed = poses((0.45, -0.35, 0.5), (0.55, 0.0, 0.6), (0.45, 0.35, 0.5))
    path, robot = build({"tray_poses": listed, "blend": 0.1}, panda, tray)
    assert robot.n == 7
    assert robot.notes == ()
    assert np.abs(path(np.linspace(0, 1, 300), 1)).max() < 10
