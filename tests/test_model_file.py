"""Model files with impossible numbers: each is an error that names joint or link, and file."""

import numpy as np
import pytest

from robustopt.config import Config
from robustopt.errors import RobotError
from robustopt.robot import Robot, load_robot

INERTIAL = '<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>'
MJCF = """<mujoco><compiler angle="radian"/><worldbody><body name="arm">{inertial}
  <joint name="hinge" axis="{axis}" {joint}/></body></worldbody>{extra}</mujoco>"""
URDF = """<robot name="r"><link name="base"/><link name="arm"><inertial><origin xyz="{com}"/><mass value="{mass}"/>
  <inertia ixx="{ixx}" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="hinge" type="{type}"><parent link="{parent}"/><child link="arm"/><axis xyz="{axis}"/>
  <limit {range} effort="{effort}" velocity="{velocity}"/>{joint}</joint>{extra}</robot>"""
SOUND = {
    "com": "0 0 0", "mass": "1", "ixx": "1", "type": "revolute", "parent": "base", "axis": "0 0 1", "effort": "5",
    "range": 'lower="-1" upper="1"', "velocity": "2", "joint": "", "extra": "", "inertial": INERTIAL,
}  # fmt: skip


@pytest.fixture
def read(tmp_path):
    """Read a robot from a file with some parts replaced."""

    def call(template: str, changes: dict[str, str], **robot: object) -> Robot:
        name = "arm.urdf" if template is URDF else "arm.xml"
        (tmp_path / name).write_text(template.format(**SOUND | changes))
        limits = {"acceleration": 1.0} if template is URDF else {"velocity": 1.0, "acceleration": 1.0, "torque": 5.0}
        keys = {"model": name, "tool": "arm", "limits": {"all": limits}, **robot}
        path = {"joints": ((0.0,), (0.5,))}
        return load_robot(Config.model_validate({"name": "test", "robot": keys, "path": path, "folder": tmp_path}))

    return call


def message(read, template, changes, **robot) -> str:
    with pytest.raises(RobotError) as caught:
        read(template, changes, **robot)
    return str(caught.value)


def joint(text: str) -> dict[str, str]:
    return {"joint": text}


def body(**inertial: str) -> dict[str, str]:
    numbers = {"pos": "0 0 0", "mass": "1", "diaginertia": "1 1 1"} | inertial
    return {"inertial": f"<inertial {' '.join(f'{key}={chr(34)}{value}{chr(34)}' for key, value in numbers.items())}/>"}


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    ("changes", "complaint"),
    [
        *((joint(f'{name}="{value}"'), f"joint hinge: {words} is {value}; expected a number of at least 0")
          for name, words in (("armature", "armature"), ("damping", "damping"), ("frictionloss", "dry friction"),
                              ("stiffness", "stiffness")) for value in ("-1", "nan", "inf", "-inf")),
        (joint('range="0.3 0.3"'), "joint hinge: range from 0.3 to 0.3, which leaves it no room; expected lower below"),
        (joint('range="0.5 0.3"'), "joint hinge: range from 0.5 to 0.3; expected the lower end first"),
        (joint('range="nan 1"'), "joint hinge: range from nan to 1; expected the lower end first"),
        (joint('range="-1 nan" limited="true"'), "joint hinge: range from -1 to nan"),
        (joint('range="inf inf"'), "joint hinge: range from inf to inf"),
        (joint('actuatorfrcrange="1 -1"'), "joint hinge: force range from 1 to -1; expected a range with 0 inside"),
        (joint('actuatorfrcrange="1 2"'), "joint hinge: force range from 1 to 2"),
        (joint('springref="nan"'), "joint hinge: springref is nan"),
        ({"axis": "nan 0 1"}, "joint hinge: axis is nan; expected finite numbers"),
        ({"axis": "inf 0 1"}, "joint hinge: axis is inf"),
        ({"axis": "0 0 0"}, "axis too small in joint Element name 'hinge'"),
        *((body(mass=value), f"link arm: mass is {value}; expected a number of at least 0")
          for value in ("inf", "nan", "-1")),
        *((body(diaginertia=f"1 {value} 1"), f"link arm: inertia is {value}") for value in ("inf", "nan", "-1")),
        (body(mass="0"), "mass and inertia of moving bodies must be larger than mjMINVAL Element name 'arm'"),
        (body(pos="0 inf 0"), "link arm: centre of mass is inf"),
        ({"inertial": '<geom name="shell" size="1" density="inf"/>'}, "geom shell: density is inf"),
        ({"extra": '<actuator><motor joint="hinge" forcerange="2 1"/></actuator>'}, "actuator of hinge: force range"),
        ({"extra": '<actuator><motor joint="hinge" gear="nan"/></actuator>'}, "actuator of hinge: gear is nan"),
        ({"extra": '<custom><numeric name="velocity_limit" data="nan"/></custom>'}, "velocity_limit: found nan"),
        ({"extra": '<custom><numeric name="acceleration_limit" data="-1"/></custom>'}, "acceleration_limit: found -1"),
        ({"extra": '<equality><joint joint1="hinge" polycoef="nan 0 0 0 0"/></equality>'}, "equality constraint"),
    ],
)  # fmt: skip
def test_impossible_numbers_of_an_mjcf_file_are_named(read, tmp_path, changes, complaint):
    found = message(read, MJCF, changes)
    assert found.startswith(f"robot.model: {tmp_path / 'arm.xml'}: ")
    assert complaint in found


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    ("changes", "complaint"),
    [
        *((joint(f'<dynamics {name}="{value}"/>'), f"joint hinge: {name} is '{value}'; expected a number of at least 0")
          for name in ("damping", "friction") for value in ("-1", "nan", "inf", "x")),
        *(({"range": f'lower="{low}" upper="{high}"'}, complaint) for low, high, complaint in (
            ("0.3", "0.3", "joint hinge: range from 0.3 to 0.3, which leaves it no room"),
            ("0", "0", "joint hinge: range from 0 to 0, which leaves it no room"),
            ("0.5", "0.3", "joint hinge: range from 0.5 to 0.3; expected the lower end first"),
            ("nan", "1", "joint hinge: lower limit is 'nan'"),
            ("-1", "x", "joint hinge: upper limit is 'x'"))),
        ({"range": ""}, "joint hinge: range from 0 to 0"),
        *(({"velocity": value}, f"joint hinge: velocity is '{value}'; expected a number above 0, or inf for none")
          for value in ("nan", "-2", "fast")),
        ({"effort": "nan"}, "joint hinge: effort is 'nan'"),
        ({"axis": "0 0 0"}, "joint hinge: axis is zero; expected a direction, such as 0 0 1"),
        ({"axis": "nan 0 0"}, "joint hinge: axis is 'nan 0 0'; expected a finite number"),
        (joint('<origin xyz="inf 0 0"/>'), "joint hinge: position of the origin is 'inf 0 0'"),
        (joint('<mimic joint="elbow"/>'), "joint hinge: mimics 'elbow', but there is no such other joint"),
        (joint('<mimic joint="hinge"/>'), "joint hinge: mimics 'hinge'"),
        *(({"mass": value}, f"link arm: mass is '{value}'") for value in ("inf", "nan", "-1")),
        ({"mass": "0"}, "link arm: no body has its mass and principal moments of inertia, with all that is fixed to it "
                        "0 kg and 1, 1, 1 kg m^2; expected a mass above 0"),
        *(({"ixx": value}, f"link arm: inertia ixx is '{value}'") for value in ("inf", "nan")),
        ({"ixx": "-1"}, "1 kg and -1, 1, 1 kg m^2; expected a mass above 0, no negative moment"),
        ({"ixx": "4"}, "1 kg and 1, 1, 4 kg m^2; expected a mass above 0, no negative moment, and none above the sum "
                       "of the other two: correct its <inertial>, or lock joint hinge (robot.locked: {hinge: ...})"),
        ({"com": "nan 0 0"}, "link arm: centre of mass is 'nan 0 0'"),
        ({"type": "screw"}, "joint hinge: found the type 'screw'; expected one of revolute, "),
        ({"parent": "nowhere"}, "joint hinge: there is no link 'nowhere' for its parent; expected one of base, arm"),
        ({"extra": '<link name="arm"/>'}, "found 2 links called 'arm'"),
    ],
)  # fmt: skip
def test_impossible_content_of_a_urdf_file_is_named(read, tmp_path, changes, complaint):
    found = message(read, URDF, changes)
    assert found.startswith(f"robot.model: {tmp_path / 'arm.urdf'}: ")
    assert complaint in found


def test_all_mistakes_are_listed_at_once(read):
    found = message(read, URDF, {"mass": "inf", "axis": "0 0 0", "joint": '<dynamics damping="-1"/>'})
    assert len(found.splitlines()) == 3


@pytest.mark.parametrize("template", [MJCF, URDF])
def test_a_joint_without_room_may_be_given_a_range(read, template):
    still = {"range": 'lower="0.3" upper="0.3"', "joint": 'range="0.3 0.3"' if template is MJCF else ""}
    limits = {"acceleration": 1.0, "velocity": 1.0, "torque": 5.0}
    robot = read(template, still, limits={"all": limits, "hinge": {"position": (-np.inf, np.inf)}})
    assert (robot.limits.lower[0], robot.limits.upper[0]) == (-np.inf, np.inf)


def test_infinity_means_no_limit(read):
    changes = {"velocity": "inf", "effort": "inf", "range": 'lower="-inf" upper="inf"'}
    limits = read(URDF, changes).limits
    assert np.isinf([limits.velocity, limits.torque, limits.lower, limits.upper]).all()
    extra = '<custom><numeric name="velocity_limit" data="inf"/></custom>'
    limits = read(
        MJCF, {"extra": extra, "joint": 'actuatorfrcrange="-inf inf"'}, limits={"all": {"acceleration": 1.0}}
    ).limits
    assert np.isinf([limits.velocity, limits.torque]).all()


def test_a_joint_is_locked_within_its_range(read):
    changes = {"inertial": f'{INERTIAL}<body name="hand">{INERTIAL}<joint name="wrist" range="-1 1"/></body>'}
    found = message(read, MJCF, changes, locked={"wrist": 1.5})
    assert found == "robot.locked.wrist: found 1.5; expected a position in the range of the joint, -1 to 1"
    assert read(MJCF, changes, locked={"wrist": 1.0}).joint_names == ("hinge",)


def test_a_faulty_file_ends_a_command_with_exit_code_2(run, tmp_path):
    (tmp_path / "arm.urdf").write_text(URDF.format(**SOUND | {"mass": "inf"}))
    task = (
        "name: t\nrobot: {model: arm.urdf, tool: arm, limits: {all: {acceleration: 1}}}\npath: {joints: [[0], [0.5]]}\n"
    )
    (tmp_path / "task.yaml").write_text(task)
    for command in ("validate", "plan"):
        code, _, err = run(command, tmp_path / "task.yaml")
        assert code == 2
        assert "link arm: mass is 'inf'" in err
