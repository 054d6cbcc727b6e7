"""Content of robot files that MuJoCo refuses, and that a plan does not need or has exactly."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from robustopt import build_problem, certify, execute, solve
from robustopt.config import Config
from robustopt.errors import RobotError
from robustopt.path.collision import CollisionCheck
from robustopt.robot import Robot, load_robot

INERTIAL = (
    '<inertial><origin xyz="0 0 {com}"/><mass value="{mass}"/>'
    '<inertia ixx="{xx}" iyy="{yy}" izz="{zz}" ixy="{xy}" ixz="0" iyz="0"/></inertial>'
)
JOINT = (
    '<joint name="{name}" type="{type}"><parent link="{parent}"/><child link="{child}"/><origin xyz="{at}"/>'
    '<axis xyz="{axis}"/><limit lower="-2" upper="2" effort="80" velocity="2"/></joint>'
)
TETRAHEDRON = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
FACETS = ((0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3))


def inertial(
    mass: float = 1.0, xx: float = 0.01, yy: float = 0.01, zz: float = 0.01, xy: float = 0.0, com: float = 0.1
) -> str:
    return INERTIAL.format(mass=mass, xx=xx, yy=yy, zz=zz, xy=xy, com=com)


def joint(name: str, parent: str, child: str, type: str = "revolute", axis: str = "0 0 1", at: str = "0 0 0.2") -> str:
    return JOINT.format(name=name, type=type, parent=parent, child=child, axis=axis, at=at)


def urdf(links: dict[str, str], *more: str) -> str:
    """An arm of four joints q1 to q4 and links l1 to l4 on a base; links: contents that differ, and further links."""
    contents = {name: inertial() for name in ("base", "l1", "l2", "l3", "l4")} | links
    names = ["base", "l1", "l2", "l3", "l4"]
    axes = ["0 0 1", "0 1 0", "0 1 0", "0 0 1"]
    chain = [joint(f"q{k + 1}", names[k], names[k + 1], axis=axes[k]) for k in range(4)]
    written = [f'<link name="{name}">{content}</link>' for name, content in contents.items()]
    return f"<robot name='arm'>{''.join([*written, *chain, *more])}</robot>"


def config_of(text: str, folder: Path, **robot: object) -> Config:
    (folder / "arm.urdf").write_text(text)
    keys = {"model": "arm.urdf", "tool": "l4", "limits": {"all": {"acceleration": 5.0}}, **robot}
    locked = keys.get("locked", ())
    rows = [[-0.5, 0.1, -0.1, 0.0], [0.5, 0.1, -0.1, 0.0]]
    path = {"joints": tuple(tuple(row[: 4 - len(locked)]) for row in rows)}
    tray = {"size": (0.2, 0.2, 0.01), "mass": 0.1, "pose": {"position": (0.0, 0.0, 0.05)}}
    objects = {"box": {"shape": "box", "size": (0.1, 0.1, 0.04), "mass": 0.05}}
    given = {"name": "arm", "robot": keys, "path": path, "tray": tray, "objects": objects, "folder": folder}
    return Config.model_validate(
        given | {"contact": {"friction": 0.6}, "solver": {"method": "reachability", "collocation_points": 30}}
    )


def robot_of(text: str, folder: Path, **robot: object) -> Robot:
    return load_robot(config_of(text, folder, **robot))


def torque(robot: Robot) -> np.ndarray:
    q, qd, qdd = np.random.default_rng(1).uniform(-1, 1, (3, 5, robot.n))
    return robot.inverse_dynamics(q, qd, qdd)[0]


# Inertias -------------------------------------------------------------------------------------------------

ANTENNA = inertial(mass=1e-6, xx=2.4e-8, yy=2.8e-8, zz=3.8e-8, xy=6.1e-8)
CAMERA = inertial(mass=0.05, xx=1e-3, yy=1e-5, zz=1e-5)
NEGATIVE = inertial(xx=-0.02)


@pytest.mark.parametrize("content", [ANTENNA, CAMERA, NEGATIVE])
def test_impossible_inertia_on_the_base_does_not_matter(tmp_path, content):
    robot = robot_of(urdf({"extra": content}, joint("f", "base", "extra", "fixed")), tmp_path)
    (note,) = robot.notes
    assert note.startswith("link extra: has ")
    np.testing.assert_allclose(torque(robot), torque(robot_of(urdf({}), tmp_path)), rtol=1e-13, atol=1e-13)


def test_inertia_that_is_possible_with_its_neighbour_is_counted_exactly(tmp_path):
    camera = robot_of(urdf({"camera": CAMERA}, joint("f", "l4", "camera", "fixed", at="0 0 0")), tmp_path)
    assert camera.notes[0].startswith("link camera: has 0.05 kg and 1e-05, 1e-05, 0.001 kg m^2, which MuJoCo refuses")
    together = inertial(mass=1.05, xx=0.011, yy=0.01001, zz=0.01001)
    np.testing.assert_allclose(
        torque(camera), torque(robot_of(urdf({"l4": together}), tmp_path)), rtol=1e-12, atol=1e-12
    )


def test_a_link_that_rounding_makes_impossible_is_counted_as_written(tmp_path):
    robot = robot_of(urdf({"l2": inertial(xx=0.01, yy=0.01, zz=0.0205)}), tmp_path)
    assert robot.inertia_of("l2")[2] == pytest.approx(np.diag([0.01, 0.01, 0.0205]), abs=1e-15)
    assert "l2: has 1 kg and 0.01, 0.01, 0.0205 kg m^2" in robot.notes[0]


@pytest.mark.parametrize(
    ("content", "found"),
    [
        (inertial(zz=0.05), "1 kg and 0.01, 0.01, 0.05 kg m^2"),
        (NEGATIVE, "1 kg and -0.02, 0.01, 0.01 kg m^2"),
        (inertial(xy=0.03), "1 kg and -0.02, 0.01, 0.04 kg m^2"),
        (inertial(mass=0.0), "0 kg and 0.01, 0.01, 0.01 kg m^2"),
    ],
)
def test_impossible_inertia_that_the_path_moves_is_an_error(tmp_path, content, found):
    with pytest.raises(RobotError) as caught:
        robot_of(urdf({"l2": content}), tmp_path)
    message = str(caught.value)
    assert "arm.urdf: link l2: no body has its mass and principal moments of inertia, with all that is" in message
    assert f"fixed to it {found}; expected" in message
    assert "correct its <inertial>, or lock joint q2 (robot.locked: {q2: ...})" in message
    assert len(message.splitlines()) == 1


def test_the_remedy_of_an_impossible_inertia_helps(tmp_path):
    text = urdf({"l1": inertial(zz=0.05)})
    assert robot_of(text, tmp_path, locked={"q1": 0.0}).n == 3


def test_links_without_mass_are_taken(tmp_path):
    nothing = inertial(mass=0.0, xx=0.0, yy=0.0, zz=0.0)
    robot = robot_of(urdf({"l1": nothing, "l3": ""}), tmp_path)
    assert [note.partition(",")[0] for note in robot.notes] == ["link l1: has 0 kg and 0", "link l3: has no inertia"]
    assert "simulations use 1e-06 kg" in robot.notes[0]
    assert robot.mass == 3.0


def test_a_shape_without_inertia_has_no_mass(tmp_path):
    box = '<collision><geometry><box size="0.1 0.1 0.1"/></geometry></collision>'
    robot = robot_of(urdf({"hand": box}, joint("f", "l4", "hand", "fixed")), tmp_path)
    assert robot.mass == 5.0


def test_a_repaired_robot_is_executed(tmp_path):
    nothing = inertial(mass=0.0, xx=0.0, yy=0.0, zz=0.0)
    text = urdf({"l1": nothing, "camera": CAMERA}, joint("f", "l4", "camera", "fixed", at="0 0 0"))
    plan = solve(build_problem(config_of(text, tmp_path, collision={"check": False})))
    assert certify(plan).passed
    assert execute(plan, trials=1).success_rate == 1.0


# Meshes ---------------------------------------------------------------------------------------------------


def text_stl(size: float = 1.0) -> str:
    corners = [f"vertex {' '.join(map(str, size * TETRAHEDRON[k]))}" for facet in FACETS for k in facet]
    loops = [
        f"facet normal 0 0 0\nouter loop\n{chr(10).join(corners[k : k + 3])}\nendloop\nendfacet"
        for k in range(0, 12, 3)
    ]
    return "\n".join(["solid t", *loops, "endsolid t\n"])


def with_mesh(name: str, folder: Path, **robot: object) -> Config:
    mesh = f'<collision><geometry><mesh filename="{name}" scale="2 2 2"/></geometry></collision>'
    return config_of(urdf({"base": inertial() + mesh}), folder, **robot)


def test_an_stl_file_in_text_is_converted(tmp_path):
    (tmp_path / "t.stl").write_text(text_stl())
    config = with_mesh("t.stl", tmp_path)
    robot = load_robot(config)
    assert robot.notes == ("link base: t.stl is an STL file in text; converted",)
    model = robot.original
    corners = model.mesh_vert
    assert len(corners) == 4
    assert np.ptp(np.linalg.norm(corners[:, None] - corners, axis=2)) == pytest.approx(2 * np.sqrt(2), rel=1e-6)
    assert CollisionCheck(config, robot).first(np.zeros((1, 4))) is not None  # the arm stands in the tetrahedron


def test_numbers_of_an_stl_file_that_are_none_are_an_error(tmp_path):
    for wrong in ("nan", "x"):
        (tmp_path / "t.stl").write_text(text_stl().replace("vertex 0.0 0.0 0.0", f"vertex {wrong} 0 0", 1))
        with pytest.raises(RobotError, match=r"t\.stl: cannot be read: "):
            load_robot(with_mesh("t.stl", tmp_path))


def test_a_tiny_mesh_is_kept(tmp_path):
    (tmp_path / "t.stl").write_text(text_stl(1e-5))
    assert load_robot(with_mesh("t.stl", tmp_path)).original.nmesh == 1


@pytest.mark.parametrize("content", ["", "solid", "nonsense" * 100])
def test_a_mesh_that_is_none_is_left_out(tmp_path, content):
    (tmp_path / "t.stl").write_text(content)
    robot = load_robot(with_mesh("t.stl", tmp_path))
    (note,) = robot.notes
    assert note.startswith("link base: left out the mesh t, ")
    assert note.endswith("; collisions with it are not checked")
    assert robot.original.nmesh == 0


MJCF = """<mujoco><asset><mesh name="hull" file="gone.stl"/></asset><worldbody><body name="arm">
  {inertial}<geom type="mesh" mesh="hull" contype="0" conaffinity="0"/><joint name="q" range="-1 1"/>
  </body></worldbody></mujoco>"""


def test_a_missing_mesh_of_an_mjcf_file_is_left_out_if_no_mass_depends_on_it(tmp_path):
    def load(inertial: str) -> Robot:
        (tmp_path / "arm.xml").write_text(MJCF.format(inertial=inertial))
        keys = {"model": "arm.xml", "tool": "arm", "limits": {"all": {"velocity": 1.0, "torque": 5.0}}}
        path = {"joints": ((0.0,), (0.5,))}
        return load_robot(Config.model_validate({"name": "test", "robot": keys, "path": path, "folder": tmp_path}))

    robot = load('<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>')
    assert robot.notes == ("link arm: left out the mesh hull, Error opening file 'gone.stl'",)
    with pytest.raises(RobotError, match=r"Error opening file '.*gone\.stl'"):
        load("")


# Joints and languages -------------------------------------------------------------------------------------


def test_the_mimic_of_a_joint_that_does_not_exist_does_not_matter_on_a_locked_joint(tmp_path):
    text = urdf({}).replace("</joint></robot>", '<mimic joint="gone"/></joint></robot>')
    assert robot_of(text, tmp_path, locked={"q4": 0.0}).n == 3
    with pytest.raises(
        RobotError, match=r"joint q4: mimics 'gone', .* lock the joint \(robot\.locked: \{q4: \.\.\.\}\)"
    ):
        robot_of(text, tmp_path)


@pytest.mark.parametrize(
    ("name", "made"), [("arm.urdf.xacro", "arm.urdf"), ("arm.xacro", "arm.urdf"), ("arm.urdf", "arm_made.urdf")]
)
def test_a_xacro_file_says_how_to_run_xacro(tmp_path, name, made):
    config = config_of(urdf({"${prefix}tool": ""}), tmp_path, model=name)
    if name != "arm.urdf":
        shutil.move(tmp_path / "arm.urdf", tmp_path / name)
    with pytest.raises(RobotError, match=f"run `xacro {name} -o {made}`, and give {made}") as caught:
        load_robot(config)
    assert len(str(caught.value).splitlines()) == 1


def test_joints_that_mimic_a_locked_joint_are_held_where_it_puts_them(tmp_path):
    q3 = joint("q3", "l2", "l3", axis="0 1 0")
    mimic = '<mimic joint="q4" multiplier="-2" offset="0.1"/></joint>'
    text = urdf({}).replace(q3, q3.replace("</joint>", mimic))
    robot = robot_of(text, tmp_path, locked={"q4": 0.2})
    assert robot.n == 2
    (note,) = robot.notes
    assert note == "joints that mimic locked joints are held: q3 at -0.3"
