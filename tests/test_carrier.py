"""The kind of a robot, and the carrier frame of arms and walking robots, with and without a tray."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from robustopt.config import Config
from robustopt.config.load import load_config
from robustopt.errors import PathError, RobotError
from robustopt.path import build_path
from robustopt.path.collision import CollisionCheck
from robustopt.robot import Dynamics, Robot, load_robot
from robustopt.robot.preparation import CARRIER_SITE

CONFIGS = Path(__file__).parent.parent / "configs"
TRAY = {"size": [0.2, 0.2, 0.01], "mass": 0.5, "pose": {"position": [0.1, 0.0, -0.1], "rpy": [0.3, 1.2, 0.4]}}
SWEEP = [{"position": [x, 0.6, 0.6], "rpy": [np.pi, 0, 0]} for x in (-0.2, 0.2)]
CUP = {"cups": [{"radius": 0.015}], "force": 60, "pose": {"position": [0, 0, 0.05]}}


def walking(*overrides: str) -> Config:
    return load_config(CONFIGS / "humanoid_step.yaml", list(overrides))


def carrying() -> Config:
    """A humanoid with a tray in its left hand."""
    config = walking("robot.tool=left_hand").model_dump(mode="json", exclude_none=True)
    return Config.model_validate(config | {"tray": TRAY, "execution": None})


def arm(**sections: Any) -> Config:
    usual = {"name": "test", "robot": {"model": "tx90l", "tool": "flange"}, "path": {"tool_poses": SWEEP}}
    return Config.model_validate(usual | sections)


def motion(robot: Robot, count: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    return tuple(0.5 * rng.normal(size=(count, robot.n)) for _ in range(3))


# The kind of a robot --------------------------------------------------------------------------------------


def test_a_free_joint_makes_a_walking_robot() -> None:
    fixed, legged = load_robot(arm()), load_robot(walking())
    assert (fixed.base, legged.base) == (0, 6)
    assert fixed.motors == slice(0, None)
    assert fixed.contacts == {}
    assert set(legged.contacts) == {"left_foot", "right_foot"}
    assert legged.joint_names[:6] == ("base_x", "base_y", "base_z", "base_yaw", "base_pitch", "base_roll")
    assert np.isinf(legged.limits.torque[:6]).all()
    assert (fixed.has_carrier, legged.has_carrier) == (True, False)


def test_a_walking_robot_needs_steps() -> None:
    with pytest.raises(RobotError, match=r"robot\.model: humanoid\.xml has the free joint .*; give path\.steps"):
        load_robot(arm(robot={"model": "humanoid"}))


def test_steps_need_a_walking_robot() -> None:
    with pytest.raises(RobotError, match=r"robot\.model: tx90l\.xml has no free joint, .*; give a model"):
        load_robot(walking("robot.model=tx90l"))


def test_a_robot_that_carries_nothing_has_no_carrier_frame() -> None:
    robot = load_robot(walking())
    assert robot.dynamics(*motion(robot, 2)).carrier is None
    with pytest.raises(RobotError, match="give a tray or objects"):
        robot.carrier_pose(robot.posture[None])


# The carrier frame ----------------------------------------------------------------------------------------


def test_without_a_tray_the_carrier_frame_is_the_frame_of_the_tool() -> None:
    bare, mounted = load_robot(arm()), load_robot(arm(tray=TRAY))
    q, _, _ = motion(bare, 5)
    (position, rotation), (tray, turned) = bare.carrier_pose(q), mounted.carrier_pose(q)
    pose = TRAY["pose"]
    np.testing.assert_allclose(tray, position + rotation @ pose["position"], atol=1e-12)
    np.testing.assert_allclose(turned, rotation @ Rotation.from_euler("xyz", pose["rpy"]).as_matrix(), atol=1e-12)


def test_a_path_leads_the_tool_through_its_poses() -> None:
    config = arm()
    robot = load_robot(config)
    path = build_path(config, robot)
    position, rotation = robot.carrier_pose(path([0.0, 0.5, 1.0]))
    np.testing.assert_allclose(position, [[-0.2, 0.6, 0.6], [0.0, 0.6, 0.6], [0.2, 0.6, 0.6]], atol=0.0002)
    np.testing.assert_allclose(rotation[:, 2, 2], -1.0, atol=1e-5)
    assert path.label(0.5) == "between tool_poses[0] and tool_poses[1], at 50 %"
    assert path.stances == ()


def test_a_pose_of_the_tool_out_of_reach_is_named() -> None:
    config = arm(path={"tool_poses": [SWEEP[0], SWEEP[1] | {"position": [5, 0, 0.6]}]})
    with pytest.raises(PathError, match=r"path\.tool_poses\[1\]: is out of reach"):
        build_path(config, load_robot(config))


def test_a_tray_in_a_hand_changes_nothing_but_the_carrier() -> None:
    bare, robot = load_robot(walking()), load_robot(carrying())
    given = motion(bare, 4)
    one, other = bare.dynamics(*given), robot.dynamics(*given)
    for item in (item.name for item in fields(Dynamics) if item.name not in {"carrier", "contact_jacobians"}):
        np.testing.assert_array_equal(getattr(one, item), getattr(other, item))
    assert (one.carrier is None, other.carrier is None) == (True, False)


def test_the_carrier_of_a_walking_robot_moves_as_its_motion_says() -> None:
    robot = load_robot(carrying())
    q, q1, q2 = motion(robot, 3)
    found, h = robot.dynamics(q, q1, q2).carrier, 1e-4
    assert found is not None
    before, now, after = (robot.carrier_pose(q + t * q1 + t**2 / 2 * q2) for t in (-h, 0.0, h))
    np.testing.assert_allclose(found.position, now[0], atol=1e-12)
    np.testing.assert_allclose(found.rotation, now[1], atol=1e-12)
    velocity = np.einsum("pij,pj->pi", found.jacobian, q1)
    acceleration = np.einsum("pij,pj->pi", found.jacobian, q2) + found.bias
    in_world = [np.einsum("pij,pj->pi", found.rotation, part[:, :3]) for part in (velocity, acceleration)]
    np.testing.assert_allclose(in_world[0], (after[0] - before[0]) / (2 * h), atol=1e-6)
    np.testing.assert_allclose(in_world[1], (after[0] - 2 * now[0] + before[0]) / h**2, atol=1e-5)
    turn = Rotation.from_matrix(before[1].transpose(0, 2, 1) @ after[1]).as_rotvec() / (2 * h)
    np.testing.assert_allclose(velocity[:, 3:], turn, atol=1e-6)


def test_the_world_of_a_simulation_has_the_same_carrier_and_feet() -> None:
    robot = load_robot(carrying())
    model = robot.world_spec.compile()
    data = mujoco.MjData(model)
    q, _, _ = motion(robot, 3)
    points = robot.contact_points(q)["left_foot"]
    for qi, qpos, position, corners in zip(q, robot.qpos(q), robot.carrier_pose(q)[0], points, strict=True):
        assert len(qpos) == len(qi) + 1 == model.nq
        data.qpos[:] = qpos
        mujoco.mj_kinematics(model, data)
        np.testing.assert_allclose(data.site(CARRIER_SITE).xpos, position, atol=1e-12)
        foot = data.site("left_foot")
        sole = foot.xpos + robot.contacts["left_foot"].points @ foot.xmat.reshape(3, 3).T
        np.testing.assert_allclose(sole, corners, atol=1e-12)


# Collisions of the load -----------------------------------------------------------------------------------


def test_a_held_part_is_checked_in_its_place() -> None:
    """Hanging, the part of 0.25 m reaches the first link in this posture; held by its front it does not."""
    posture = np.array([[0.0, 0.0, 2.2, 0.0, 2.0, 0.0]])
    found = {}
    for face in ("top", "front"):
        part = {"shape": "box", "size": [0.04, 0.04, 0.25], "mass": 0.4, "held_by": {"suction": CUP | {"face": face}}}
        config = arm(objects={"part": part})
        found[face] = CollisionCheck(config, load_robot(config)).first(posture)
    assert found["top"] is not None
    assert found["top"].bodies == ("link1", "part")
    assert found["front"] is None


def test_pairs_in_exclude_count_for_a_walking_robot_too() -> None:
    near = ["path.start={left: [0.0, 0.055], right: [0.0, -0.055]}", "path.steps=[{foot: right, to: [0.1, -0.055]}]"]
    config = walking(*near)
    with pytest.raises(PathError, match="collide") as caught:
        build_path(config, load_robot(config))
    pair = str(caught.value).partition("they may touch, ")[2].removesuffix(" in robot.collision.exclude")
    config = walking(*near, f"robot.collision.exclude=[{pair}]")
    check = CollisionCheck(config, load_robot(config))
    path = build_path(walking(*near, "robot.collision.check=false"), load_robot(config))
    left = check.first(path(np.linspace(0, 1, 50)))
    assert left is None or f"[{', '.join(left.bodies)}]" != pair
