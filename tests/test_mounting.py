"""Trays and objects against the bodies that are fixed to the tool, and faces that point down."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
import pytest
from scenes import FIXTURES

from robustopt.config import Config
from robustopt.config.load import load_config, with_values
from robustopt.errors import ConfigError
from robustopt.path.build import build_path
from robustopt.robot import load_robot
from robustopt.robot.model_file import resolve_package
from robustopt.solvers import build_problem

MUG = {"shape": "cylinder", "radius": 0.04, "height": 0.1, "mass": 0.3, "on": "tray"}
TURNED = {"position": [0.0, 0.0, 0.05], "rpy": [np.pi, 0.0, 0.0]}
LIFT = {"joints": [[0.0, 0.0], [0.2, 0.1]]}


def mounted(
    pose: dict[str, Any] | None = None, objects: dict[str, Any] | None = None, tray: bool = True, **more: Any
) -> Config:
    """A task of the hand of the fixtures, whose tray is at a pose in front of its tip."""
    robot = {"model": "hand.xml", "tool": "tip", "locked": {"open": 0.0}, **more.pop("robot", {})}
    data: dict[str, Any] = {"name": "test", "robot": robot, "objects": objects or {}, "path": LIFT, **more}
    if tray:
        data["tray"] = {"size": [0.2, 0.2, 0.01], "mass": 0.3, "pose": pose or {}}
    return with_values(Config.model_validate({**data, "folder": FIXTURES}), {})


def build(config: Config) -> None:
    build_path(config, load_robot(config))


def refused(config: Config) -> str:
    with pytest.raises(ConfigError) as caught:
        build(config)
    return str(caught.value)


def test_a_mug_in_the_hand_is_found_with_its_depth():
    # the turned tray is 0.05 m in front of the tip, the mug reaches back over the tip, 0.1 m in front of the palm
    far, near = ({**TURNED, "position": [0.0, 0.0, z]} for z in (0.05, 0.0))
    upside_down = {"gravity": [0.0, 0.0, 9.81]}
    build(mounted({**far, "position": [0.0, 0.0, 0.3]}, {"mug": MUG}, **upside_down))
    message = refused(mounted(near, {"mug": MUG}, **upside_down))
    # the palm ends 0.07 m below the tip, the mug 0.105 m below it
    assert "tray.pose: palm and mug, which move together, overlap, 35.0 mm deep; change tray.pose" in message
    assert "add [palm, mug] to robot.collision.exclude" in message
    slim = MUG | {"radius": 0.02}
    assert "finger and mug" in refused(mounted(near, {"mug": slim | {"at": [0.0, -0.06]}}, **upside_down))
    ignored = {"collision": {"exclude": [["mug", "palm"]]}}
    build(mounted(near, {"mug": slim}, robot=ignored, **upside_down))
    build(mounted(near, {"mug": MUG}, robot={"collision": {"check": False}}, **upside_down))


def test_the_depth_is_that_of_mujoco():
    message = refused(mounted({"position": [0.0, 0.0, -0.09]}, {"mug": MUG}))
    box = mujoco.MjSpec()
    box.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.02, 0.08, 0.03])
    box.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_CYLINDER, size=[0.04, 0.05, 0], pos=[0, 0, 0.065])
    model = box.compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    depth = -1000 * mujoco.mj_geomDistance(model, data, 0, 1, 1.0, None)
    assert f"palm and mug, which move together, overlap, {depth:.1f} mm deep" in message


def test_a_tray_may_overlap_its_mount_but_nothing_else_of_the_hand():
    build(mounted({"position": [0.0, 0.0, -0.08]}, robot={"collision": {"exclude": [["tray", "finger"]]}}))
    message = refused(mounted({"position": [0.0, 0.0, -0.08]}))
    assert message.startswith("tray.pose: finger and tray, which move together, overlap")
    assert "palm" not in message
    # on the wrist the hand is in the way
    assert "palm and tray" in refused(mounted({"position": [0.0, 0.0, 0.08]}, robot={"tool": "wrist"}))


@pytest.mark.parametrize(("depth", "allowed"), [(0.0, True), (0.004, True), (0.006, False)])
def test_a_held_part_may_be_pressed_into_what_holds_it(depth, allowed):
    cup = {"suction": {"cups": [{"radius": 0.01}], "force": 40.0, "pose": {"position": [0.0, 0.0, -0.07 - depth]}}}
    part = {"shape": "box", "size": [0.03, 0.03, 0.04], "mass": 0.2, "held_by": cup}
    config = mounted(None, {"part": part}, tray=False)
    if allowed:
        build(config)
    else:
        found = refused(config)
        assert found.startswith(
            "objects.part: palm and part, which move together, overlap, 6.0 mm deep; change objects.part"
        )


@pytest.mark.parametrize(
    ("rpy", "angle"),
    [((np.pi, 0.0, 0.0), "180"), ((0.0, 2.0, 0.0), "114.6"), ((0.0, -np.pi / 2, 0.0), "90")],
)
def test_a_face_that_does_not_point_up_is_an_error(rpy, angle):
    message = refused(mounted({"position": [0.0, 0.0, 0.4], "rpy": list(rpy)}, {"mug": MUG}))
    assert message.startswith(
        f"tray.pose.rpy: at joints[0]: the face of tray that carries mug points {angle} degrees away from up"
    )
    assert "expected less than 90 degrees: change tray.pose.rpy" in message


def test_a_steep_face_an_empty_tray_and_a_world_without_gravity_are_no_errors():
    build(mounted({"position": [0.0, 0.0, 0.4], "rpy": [0.0, 1.5, 0.0]}, {"mug": MUG}))
    turned = {"position": [0.0, 0.0, 0.4], "rpy": [np.pi, 0.0, 0.0]}
    build(mounted(turned))
    build(mounted(turned, {"mug": MUG}, gravity=[0.0, 0.0, 0.0]))


def test_up_is_against_gravity():
    level = {"position": [0.0, 0.0, 0.4]}
    build(mounted(level, {"mug": MUG}, gravity=[5.0, 0.0, -5.0]))
    assert "points 135 degrees away from up" in refused(mounted(level, {"mug": MUG}, gravity=[5.0, 0.0, 5.0]))


def test_a_part_that_hangs_below_a_held_part_is_an_error():
    cup = {"suction": {"cups": [{"radius": 0.02}], "force": 40.0, "face": "bottom"}}
    part = {"shape": "box", "size": [0.1, 0.1, 0.04], "mass": 0.2}
    lid = {"shape": "box", "size": [0.05, 0.05, 0.02], "mass": 0.1, "on": "part"}
    build(mounted(None, {"part": part | {"held_by": cup}, "lid": lid}, tray=False))
    below = {"suction": {**cup["suction"], "face": "top"}}
    message = refused(mounted(None, {"part": part | {"held_by": below}, "lid": lid}, tray=False))
    assert message.startswith(
        "objects.part.held_by: at joints[0]: the face of part that carries lid points 180 degrees"
    )


PANDA = "package://example-robot-data/robots/panda_description/urdf/panda.urdf"
TASK = f"""
name: panda
robot:
  model: {PANDA}
  tool: panda_hand_tcp
  locked: {{panda_finger_joint1: 0.0, panda_finger_joint2: 0.0}}
  limits: {{all: {{acceleration: 5.0}}}}
tray: {{size: [0.2, 0.2, 0.01], mass: 0.3, pose: {{position: [0, 0, 0.0]}}}}
objects: {{mug: {{shape: cylinder, radius: 0.04, height: 0.1, mass: 0.3, on: tray}}}}
contact: {{friction: 0.4}}
path: {{tray_poses: [{{position: [0.45, -0.2, 0.6]}}, {{position: [0.45, 0.2, 0.6]}}]}}
"""


@pytest.mark.skipif(resolve_package(PANDA) is None, reason="needs example-robot-data")
def test_a_mug_in_the_hand_of_a_panda_is_found():
    build_problem(load_config(TASK, ["tray.pose.position=[0,0,0.02]"]))
    with pytest.raises(ConfigError, match=r"panda_hand and mug, which move together, overlap, 67\.6 mm deep"):
        build_problem(load_config(TASK, ["tray.pose.rpy=[3.14159265,0,0]"]))
