"""A certificate reads the task from the configuration that it is given, not from the plan."""

from __future__ import annotations

from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scenes import CONFIGS, FIXTURES, plan_of, scene

from robustopt.certificate import certify
from robustopt.certificate.task import configured_limits
from robustopt.config import Config
from robustopt.config.load import load_config, with_values
from robustopt.errors import ConfigError
from robustopt.limits import TimeScalingProblem
from robustopt.robot import JointLimits, load_robot
from robustopt.solvers import Plan, build_problem

WAY = [[0.0, 1.0, 0.1, 0.0], [0.5, 0.6, 0.15, 0.8], [0.9, 0.9, 0.1, 0.3]]
BLOCK = {"shape": "box", "size": [0.1, 0.1, 0.1], "mass": 2.0}


def carried(**sections: Any) -> Config:
    return scene(
        "scara", {"block": BLOCK}, joints=WAY, contact={"friction": 0.5},
        solver={"collocation_points": 40}, **sections,
    )  # fmt: skip


@pytest.fixture(scope="module")
def plan() -> Plan:
    return plan_of(carried())


OTHER: dict[str, Any] = {
    "robot.limits": {"shoulder": {"torque": 12.0}},
    "robot.limits.all": {"velocity": 0.8},
    "robot.limits.elbow": {"acceleration": 2.0},
    "robot.limits.lift": {"position": [-1.0, 2.0]},
    "robot.limits.turn": {"dry_friction": 400.0},
    "robot.base": {"rpy": [0.2, 0.0, 0.0]},
    "gravity": [0.0, 0.0, -1.0],
    "tray.pose": {"rpy": [0.0, 0.15, 0.0]},
    "path.joints": [[0.0, 1.0, 0.1, 0.0], [0.5, 0.3, 0.15, 0.8], [0.9, 0.9, 0.1, 0.3]],
    "objects.block.size": [0.1, 0.1, 0.35],
    "objects.block.mass": 90.0,
    "contact.friction": 0.2,
    "uncertainty.mass": {"block": [1.0, 90.0]},
}


@pytest.mark.parametrize("key", OTHER)
def test_the_verdict_is_that_of_a_fresh_plan_with_the_same_timing(plan: Plan, key: str) -> None:
    other = with_values(plan.problem.config, {"robot.limits": {}, key: OTHER[key]})
    fresh = certify(replace(plan, problem=build_problem(other)))
    found = certify(plan, config=other)
    assert found.margins == fresh.margins
    assert found.passed == fresh.passed
    own = certify(plan)
    assert own.passed
    assert found.margins != own.margins


def test_a_number_of_the_model_file_counts(plan: Plan, tmp_path: Path) -> None:
    text = (FIXTURES / "scara.xml").read_text(encoding="utf-8")
    (tmp_path / "scara.xml").write_text(text.replace('data="2 2 2 4"', 'data="2 1 2 4"'), encoding="utf-8")
    weaker = plan.problem.config.model_copy(update={"folder": tmp_path})
    found = certify(plan, config=weaker)
    assert not found.passed
    assert found.worst.limit == "elbow velocity"


def test_a_plan_with_other_stops_is_refused() -> None:
    straight = load_config(CONFIGS / "waiter_one_block.yaml", ["solver.collocation_points=30"])
    there_and_back = load_config(CONFIGS / "waiter_two_blocks.yaml", ["solver.collocation_points=30"])
    with pytest.raises(ConfigError, match=r"path: the plan has inner stops at s = none, this path at 0\.\d+, 0\.\d+"):
        certify(plan_of(straight), config=there_and_back)


def test_a_plan_says_nothing_about_the_limits_of_its_robot(plan: Plan) -> None:
    """The limits come from the configuration, even if the planner had read them wrongly."""
    problem = plan.problem
    wrong = {item.name: 1e6 * np.ones(4) for item in fields(JointLimits)} | {"lower": -1e6 * np.ones(4)}
    robot = load_robot(problem.config)
    robot.limits = JointLimits(**wrong)
    misread: TimeScalingProblem = replace(problem, robot=robot)
    fast = replace(plan, problem=misread, x=4.0 * plan.x, u=4.0 * plan.u)
    assert {name for name, margin in certify(fast).margins.items() if margin.on_grid < -0.5} >= {"shoulder velocity"}


# Limits ---------------------------------------------------------------------------------------------------


def same_limits(config: Config) -> None:
    robot = load_robot(config)
    found = configured_limits(config, robot)
    for item in fields(JointLimits):
        np.testing.assert_array_equal(getattr(found, item.name), getattr(robot.limits, item.name), err_msg=item.name)


@pytest.mark.parametrize(
    "name", ["waiter_one_block", "waiter_heavy", "pick_gripper", "humanoid_step", "humanoid_rail", "humanoid_tray"]
)
def test_limits_of_shipped_configurations_are_read_alike(name: str) -> None:
    same_limits(load_config(CONFIGS / f"{name}.yaml"))


def test_limits_of_a_urdf_file_are_read_alike() -> None:
    limits = {"all": {"acceleration": 5.0}, "slide": {"velocity": 0.4, "position": [0.0, 0.2]}}
    for friction in (True, False):
        robot = {"model": "two_links.urdf", "limits": limits, "joint_friction": friction}
        same_limits(scene(joints=[[0.0, 0.1], [1.0, 0.2]], robot_keys=robot))


MOTORS = """<mujoco><compiler angle="radian"/>
<custom><numeric name="velocity_limit" data="1 2 3 4"/><numeric name="acceleration_limit" data="5 6 7 8"/></custom>
<worldbody>{}</worldbody>
<actuator>
  <motor joint="a" gear="10" ctrllimited="true" ctrlrange="-2 3"/>
  <general joint="b" gear="-4" forcelimited="true" forcerange="-7 6"/>
  <motor joint="c" gear="3" ctrllimited="true" ctrlrange="-5 5" forcelimited="true" forcerange="-4 4"/>
  <position joint="d" kp="100" ctrllimited="true" ctrlrange="-1 1"/>
</actuator></mujoco>"""


def test_limits_of_actuators_are_read_alike(tmp_path: Path) -> None:
    links = ""
    for name, more in (("a", ""), ("b", ""), ("c", 'actuatorfrcrange="-90 11"'), ("d", 'actuatorfrcrange="-9 9"')):
        links += f'<body><joint name="{name}" axis="0 0 1" {more} frictionloss="0.5" damping="0.25"/>'
        links += '<inertial pos="0 0 0" mass="1" diaginertia="0.1 0.1 0.1"/>'
    (tmp_path / "arm.xml").write_text(MOTORS.format(links + '<site name="tool"/>' + 4 * "</body>"), encoding="utf-8")
    config = scene(robot_keys={"model": str(tmp_path / "arm.xml")}, joints=[[0.0] * 4, [0.1] * 4])
    same_limits(config)
    np.testing.assert_array_equal(configured_limits(config, load_robot(config)).torque, [20.0, 24.0, 11.0, 9.0])
