"""Robots by name: `SOURCE:NAME`, the list of them, and limits from a file of MoveIt."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest
import robot_files

from robustopt.cli import run
from robustopt.config import Config
from robustopt.config.load import dump, load_config, with_values
from robustopt.errors import ConfigError, RobotError
from robustopt.robot import load_robot, sources
from robustopt.robot.listing import missing, robots
from robustopt.robot.model_file import model_file

FIXTURES = Path(__file__).parent / "fixtures"
ARM = (FIXTURES / "double_pendulum.xml").read_text(encoding="utf-8")
SCENE = """<mujoco><include file="ur5e.xml"/><worldbody><light pos="0 0 2"/>
  <geom name="floor" type="plane" size="0 0 0.05" pos="0 0 -3"/></worldbody></mujoco>"""
LIMITS = """joint_limits:
  shoulder: {has_velocity_limits: true, max_velocity: 1.5, has_acceleration_limits: true, max_acceleration: 4}
  elbow: {has_velocity_limits: false, max_velocity: 9, has_jerk_limits: true, max_jerk: 50}
"""


def config_of(model: str, folder: Path = FIXTURES, **robot: object) -> Config:
    keys = {"model": model, "tool": "tip", **robot}
    path = {"joints": [[0.0, 0.0], [0.5, 0.1]]}
    return load_config({"name": "test", "robot": keys, "path": path}, folder=folder)


def file_of(model: str) -> Path:
    return model_file(config_of(model))


@pytest.fixture
def menagerie(tmp_path, monkeypatch):
    """A folder in the layout of MuJoCo Menagerie."""
    folder = tmp_path / "universal_robots_ur5e"
    folder.mkdir()
    (folder / "ur5e.xml").write_text(ARM)
    (folder / "a_hand.xml").write_text('<mujoco><worldbody><body><joint type="free"/></body></worldbody></mujoco>')
    (folder / "scene.xml").write_text(SCENE)
    monkeypatch.setenv("MENAGERIE_ROOT", str(tmp_path))
    return folder


@pytest.fixture
def packages(tmp_path, monkeypatch):
    """Packages in the layouts of robosuite and dm_control."""
    for name in ("robosuite/models/assets/robots/panda/robot.xml", "dm_control/suite/arm.xml",
                 "dm_control/mjcf/test_assets/arm.xml"):  # fmt: skip
        (tmp_path / name).parent.mkdir(parents=True)
        (tmp_path / name).write_text(ARM)
    for name in ("robosuite", "dm_control"):
        (tmp_path / name / "__init__.py").write_text('raise ImportError("it is heavy")')
        monkeypatch.delitem(sys.modules, name, raising=False)
    monkeypatch.syspath_prepend(str(tmp_path))
    return tmp_path


def test_the_model_of_a_menagerie_folder_is_the_one_in_its_scene(menagerie):
    assert file_of("menagerie:universal_robots_ur5e") == menagerie / "ur5e.xml"
    assert file_of("menagerie:universal_robots_ur5e/scene") == menagerie / "scene.xml"
    for name in ("universal_robots_ur5e", "universal_robots_ur5e/scene"):
        robot = load_robot(config_of(f"menagerie:{name}"))
        assert robot.joint_names == ("shoulder", "elbow")


def test_robots_of_packages_are_found_without_importing_them(packages):
    assert file_of("robosuite:panda") == packages / "robosuite/models/assets/robots/panda/robot.xml"
    assert file_of("dm_control:arm") == packages / "dm_control/suite/arm.xml"


@pytest.mark.skipif(robot_files.folder() is None, reason="needs example-robot-data, of the extra `robots`")
def test_files_of_example_robot_data_are_named_by_their_stem():
    assert file_of("example-robot-data:panda") == robot_files.files()["panda"].file
    complaint = "example-robot-data has no robot 'ur5'; similar ones: ur5_gripper, ur5_joint_limited_robot, ur5_robot"
    with pytest.raises(RobotError, match=complaint):
        file_of("example-robot-data:ur5")
    with pytest.raises(RobotError, match=r"no robot 'ur55'; similar ones: .*ur5_robot"):
        file_of("example-robot-data:ur55")


def test_a_source_that_is_missing_says_how_to_get_it(monkeypatch):
    monkeypatch.delenv("MENAGERIE_ROOT", raising=False)
    with pytest.raises(RobotError, match="no robots of menagerie were found; set MENAGERIE_ROOT to a clone") as caught:
        file_of("menagerie:universal_robots_ur5e")
    assert len(str(caught.value).splitlines()) == 1
    assert "menagerie" in missing()


def test_the_name_of_a_source_is_kept_in_a_stored_configuration(menagerie):
    assert "model: menagerie:universal_robots_ur5e" in dump(config_of("menagerie:universal_robots_ur5e"))


def test_the_list_of_robots_counts_the_joints_of_the_longest_chain(menagerie, packages, monkeypatch, capsys):
    monkeypatch.setattr(sources, "share_folders", tuple)
    found = {robot.name: robot for robot in robots()}
    assert (found["tx90l"].joints, found["humanoid"].source) == (6, "robustopt")
    assert found["menagerie:universal_robots_ur5e"].joints == 2
    assert found["menagerie:universal_robots_ur5e/scene"].joints == 2
    assert "menagerie:universal_robots_ur5e/a_hand" not in found  # nothing of it can move
    assert found["robosuite:panda"].file.endswith("robot.xml")
    assert run(["robots", "--json"]) == 0
    listed = json.loads(capsys.readouterr().out)
    assert listed["robots"][0] == vars(robots()[0])
    assert set(listed["missing"]) == {"example-robot-data"}
    assert run(["robots"]) == 0
    assert "menagerie:universal_robots_ur5e" in capsys.readouterr().out


@pytest.mark.skipif(robot_files.folder() is None, reason="needs example-robot-data, of the extra `robots`")
def test_joints_of_published_files_are_counted():
    counted = {robot.name.partition(":")[2]: robot.joints for robot in robots() if robot.source == "example-robot-data"}
    assert {name: len(joints.longest()) for name, joints in robot_files.files().items()}.items() <= counted.items()


# Limits of MoveIt -----------------------------------------------------------------------------------------


@pytest.fixture
def arm(tmp_path):
    (tmp_path / "arm.xml").write_text(ARM)
    (tmp_path / "joint_limits.yaml").write_text(LIMITS)
    return tmp_path


def test_limits_of_a_moveit_file_replace_those_of_the_model(arm):
    plain = load_robot(config_of("arm.xml", arm)).limits
    config = config_of("arm.xml", arm, limits_file="joint_limits.yaml")
    limits = load_robot(config).limits
    np.testing.assert_array_equal(limits.velocity, [1.5, plain.velocity[1]])
    np.testing.assert_array_equal(limits.acceleration, [4.0, plain.acceleration[1]])
    assert load_config(dump(config)).robot.limits == config.robot.limits
    changed = with_values(config_of("arm.xml", arm), {"robot.limits_file": "joint_limits.yaml"})
    assert changed.robot.limits == config.robot.limits


PILZ = "cartesian_limits: {max_trans_vel: 1, max_trans_acc: 2.25, max_trans_dec: 1.5, max_rot_vel: 1.57}"


@pytest.mark.parametrize(
    ("files", "given", "expected"),
    [
        ("pilz.yaml", {}, (1.0, 1.5)),
        (["joint_limits.yaml", "pilz.yaml"], {}, (1.0, 1.5)),
        ("both.yaml", {"cartesian": {"tool": {"speed": 0.3}, "b1": {"speed": 2.0}}}, (0.3, 1.5)),
    ],
)
def test_limits_of_the_tool_are_read_from_a_file_of_moveit(arm, files, given, expected):
    (arm / "pilz.yaml").write_text(PILZ)
    (arm / "both.yaml").write_text(f"{LIMITS}\n{PILZ}")
    config = config_of("arm.xml", arm, limits_file=files, limits=given)
    tool = config.robot.limits.cartesian["tool"]
    assert (tool.speed, tool.acceleration) == expected
    assert set(config.robot.limits.cartesian) == {"tool", *given.get("cartesian", {})}
    assert ("shoulder" in config.robot.limits.joints) == (files != "pilz.yaml")
    assert load_config(dump(config)).robot.limits == config.robot.limits


@pytest.mark.parametrize("given", [{"all": {"velocity": 2.0}}, {"shoulder": {"velocity": 2.0}}])
def test_limits_of_the_configuration_replace_those_of_the_file(arm, given):
    limits = load_robot(config_of("arm.xml", arm, limits_file="joint_limits.yaml", limits=given)).limits
    assert (limits.velocity[0], limits.acceleration[0]) == (2.0, 4.0)


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("joints: {}", "joint_limits.yaml:1: joint_limits: found nothing; expected limits by joint name"),
        ("joint_limits: [1, 2]", "joint_limits: found the list"),
        ("joint_limits: {shoulder: 3}", "joint_limits.shoulder: found 3; expected a section"),
        ("joint_limits: {shoulder: {has_velocity_limits: yes}}", "has_velocity_limits: found the text 'yes'; expected"),
        ("joint_limits: {shoulder: {has_velocity_limits: true}}", "max_velocity: found nothing; expected a number"),
        ("joint_limits: {shoulder: {has_velocity_limits: true, max_velocity: -1}}", "max_velocity: found -1; expected"),
        ("joint_limits: {shoulder: [", "not YAML"),
        ("cartesian_limits: 3", "joint_limits.yaml:1: cartesian_limits: found 3; expected a section"),
        ("cartesian_limits: {max_trans_dec: -5}", "cartesian_limits.max_trans_dec: found -5; expected a number"),
    ],
)  # fmt: skip
def test_mistakes_in_a_moveit_file_are_named_with_their_line(arm, text, complaint):
    (arm / "joint_limits.yaml").write_text(text)
    with pytest.raises(ConfigError) as caught:
        config_of("arm.xml", arm, limits_file="joint_limits.yaml")
    assert complaint in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1


def test_a_moveit_file_of_another_robot_is_one_error(arm):
    names = [f"panda_joint{k}" for k in range(7)]
    entry = "{has_velocity_limits: true, max_velocity: 1}"
    (arm / "joint_limits.yaml").write_text("joint_limits:\n" + "".join(f"  {name}: {entry}\n" for name in names))
    with pytest.raises(RobotError) as caught:
        load_robot(config_of("arm.xml", arm, limits_file="joint_limits.yaml"))
    complaint = f"robot.limits: arm.xml has no joints {', '.join(names)}; its joints are: shoulder, elbow (or `all`)"
    assert str(caught.value) == complaint


def test_a_moveit_file_that_is_missing_is_named(arm):
    with pytest.raises(ConfigError, match=r"none\.yaml: robot\.limits_file: no such file"):
        config_of("arm.xml", arm, limits_file="none.yaml")
