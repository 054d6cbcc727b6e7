"""Configuration files: what is read, and what each mistake is answered with."""

import json
from pathlib import Path

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from robustopt.config import schema
from robustopt.config.load import dump, load_config, located, with_values
from robustopt.errors import ConfigError, ConfigProblem, PathError

DOCS = Path(__file__).parents[1] / "docs"
CONFIGS = sorted((Path(__file__).parents[1] / "configs").glob("*.yaml"))

TASK = """\
name: test-task
robot: {model: tx90l}
tray: {size: [0.3, 0.3, 0.01], mass: 1.0}
objects:
  lower: {shape: box, size: [0.08, 0.08, 0.12], mass: 0.5, on: tray, at: [0, 0]}
  upper: {shape: box, size: [0.08, 0.08, 0.12], mass: 0.5, on: lower, at: [0, 0]}
contact: {friction: 0.5, cone_edges: 16}
path:
  tray_poses:
    - {position: [0.75, -0.5, 0.75], yaw: -0.59}
    - {position: [0.75, 0.5, 0.75], yaw: 0.59}
uncertainty:
  friction: [0.4, 0.6]
solver: {method: ipopt, collocation_points: 200}
"""


@pytest.fixture
def task(tmp_path):
    """Writes a configuration and returns its path; `replace` pairs change the valid one."""

    def write(*replacements: tuple[str, str], text: str = TASK) -> Path:
        for old, new in replacements:
            assert old in text
            text = text.replace(old, new)
        path = tmp_path / "task.yaml"
        path.write_text(text, encoding="utf-8")
        return path

    return write


def problems(path: Path, *overrides: str) -> list[str]:
    with pytest.raises(ConfigError) as caught:
        load_config(path, overrides)
    return [str(problem).replace(str(path), "task.yaml") for problem in caught.value.problems]


# What is read ---------------------------------------------------------------------------------------------


def test_a_file_is_read_with_its_values_and_defaults(task):
    config = load_config(task())
    assert config.objects["upper"].on == "lower"
    assert config.uncertainty.friction == (0.4, 0.6)
    assert config.path.tray_poses[1].yaw == 0.59
    assert config.solver.cost == "time"
    assert config.folder.is_absolute()


def test_on_is_a_key_and_exponents_are_numbers(task):
    config = load_config(task(("mass: 1.0", "mass: 1e0"), ("collocation_points: 200", "weight: 1E-3")))
    assert config.tray.mass == 1.0
    assert config.solver.weight == 0.001
    assert load_config(task(("robot: {model: tx90l}", "robot: {model: on}"))).robot.model == "on"


def test_an_empty_section_is_all_defaults(task):
    config = load_config(task(("uncertainty:\n  friction: [0.4, 0.6]", "uncertainty:\nexecution:")))
    assert config.uncertainty.friction is None
    assert config.execution is None


def test_execution_and_learning_are_read(task):
    more = (
        "execution: {truth: {friction: {lower: 0.5, default: 0.4}}, timestep: 0.001, trials: 100,\n"
        "  controller: {kp: 3e4}, disturbance: {force_deviation: [2, 2, 0], on: upper}}\n"
        "learning: {algorithm: ilrobs, K: 1, delta: 0.05, epsilon: 0.05, friction: [0, 1]}\n"
    )
    config = load_config(task(text=TASK + more))
    assert config.execution.controller.kp == 3e4
    assert config.execution.disturbance.force_deviation == (2, 2, 0)
    assert config.learning.friction == (0, 1)


@pytest.mark.parametrize(
    ("intervals", "nominal"),
    [("[0.2, 0.3]", 0.25), ("{upper: [0.2, 0.3]}", {"default": 0.5, "upper": 0.25})],
)
def test_friction_that_is_only_an_interval_has_its_middle_as_point_value(task, intervals, nominal):
    path = task(("contact: {friction: 0.5, cone_edges: 16}\n", ""), ("[0.4, 0.6]", intervals))
    assert load_config(path).contact.friction == nominal


@pytest.mark.parametrize("path", CONFIGS, ids=lambda path: path.stem)
def test_shipped_configurations_are_valid(path):
    assert load_config(path).name


# Overrides ------------------------------------------------------------------------------------------------


def test_overrides_replace_values_entries_and_sections(task):
    config = load_config(
        task(),
        [
            "contact.friction=0.45",
            "path.tray_poses.0.yaw=-0.5",
            "path.tray_poses[1].position=[0.7, 0.5, 0.75]",
            "robot.limits.joint2.torque=40",
            "uncertainty={}",
            "objects.cup={shape: cylinder, radius: 0.02, height: 0.1, mass: 0.1, at: [0.1, 0.1]}",
            "solver.collocation_points=1_0",
            "solver.collocation_points=500",
        ],
    )
    assert config.contact.friction == 0.45
    assert [pose.yaw for pose in config.path.tray_poses] == [-0.5, 0.59]
    assert config.path.tray_poses[1].position == (0.7, 0.5, 0.75)
    assert config.robot.limits.joints["joint2"].torque == 40
    assert config.uncertainty.friction is None
    assert config.objects["cup"].radius == 0.02
    assert config.solver.collocation_points == 500


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("contact.friction", "found no key=value; expected for example solver.collocation_points=500"),
        ("=3", "found no key=value; expected for example solver.collocation_points=500"),
        ("contact.friction=abc", "contact.friction: found the text 'abc'; expected a plain number from 1e-06 to 100"),
        ("contact.frction=0.3", "contact.frction: unknown key; did you mean friction?"),
        ("contact..friction=0.3", "found an empty part of a key"),
        ("gravity=[0, 0, -1e300]", "gravity[2]: found -1e+300; expected a number from -1000000"),
        ("path.tray_poses.7.yaw=0", "path.tray_poses[7]: found position 7; expected 0 to 1"),
        ("path.tray_poses.first.yaw=0", "expected a position, because path.tray_poses is a list"),
        ("contact.friction.upper=0.3", "contact.friction is 0.5, which has no keys; replace it as a whole"),
        ("uncertainty.friction=[0.4,", "uncertainty.friction: not YAML"),
        ("uncertainty={mass: 1, mass: 2}", "uncertainty.mass: found twice; expected once"),
    ],
)
def test_a_wrong_override_is_named_with_its_text(task, override, message):
    (problem,) = problems(task(), override)
    assert problem.startswith(f"override '{override}': ")
    assert message in problem


# Mistakes, one at a time: what, where and what would be right ---------------------------------------------

WRONG_VALUES = [
    # what is replaced, by what, key, line, part of the message
    (
        "mass: 1.0",
        "mass: -1",
        "tray.mass",
        3,
        "found -1; expected a number from 1e-06 to 1000000 in kilograms (mass of the tray)",
    ),
    ("mass: 1.0", "mass: 0", "tray.mass", 3, "found 0; expected a number from 1e-06"),
    ("mass: 1.0", "mass: .nan", "tray.mass", 3, "found nan; expected a number"),
    ("mass: 1.0", "mass: .inf", "tray.mass", 3, "found inf; expected a number"),
    ("mass: 1.0", "mass: 1e999", "tray.mass", 3, "found inf; expected a number"),
    ("mass: 1.0", "mass: true", "tray.mass", 3, "found true; expected a number"),
    ("mass: 1.0", "mass: [1]", "tray.mass", 3, "found the list [1]; expected a number"),
    ("mass: 1.0", f"mass: 1{'0' * 400}", "tray.mass", 3, "expected a number"),
    ("mass: 1.0", f"mass: 1{'0' * 5000}", "tray.mass", 3, "expected a number"),
    (
        "mass: 1.0",
        "mass: 1 kg",
        "tray.mass",
        3,
        "found the text '1 kg'; expected a plain number from 1e-06 to 1000000 in kilograms",
    ),
    (
        "0.3, 0.01]",
        "300 mm, 0.01]",
        "tray.size[1]",
        3,
        "found the text '300 mm'; expected a plain number from 1e-06 to 100 in metres",
    ),
    (
        "0.3, 0.01]",
        "0.01]",
        "tray.size",
        3,
        "found the list [0.3, 0.01]; expected a list of three numbers from 1e-06 to",
    ),
    ("0.3, 0.01]", "0, 0.01]", "tray.size[1]", 3, "found 0; expected a number from 1e-06 to 100 in metres"),
    (
        "size: [0.3, 0.3, 0.01], ",
        "",
        "tray.size",
        3,
        "missing; expected a list of three numbers from 1e-06 to 100 in metres",
    ),
    (
        "tray: {size: [0.3, 0.3, 0.01], mass: 1.0}",
        "",
        "tray",
        1,
        "missing, but lower stands on it; expected a section with the keys size, mas",
    ),
    ("friction: 0.5", "friction: 0", "contact.friction", 7, "found 0; expected a number from 1e-06 to 100"),
    ("cone_edges: 16", "cone_edges: 16.5", "contact.cone_edges", 7, "found 16.5; expected a whole number from 3 to 64"),
    ("cone_edges: 16", "conedges: 16", "contact.conedges", 7, "unknown key; did you mean cone_edges? expected one of"),
    ("name: test-task", "name: ../up", "name", 1, "expected letters, digits"),
    ("name: test-task", "name: 12", "name", 1, "found 12; expected text"),
    ("name: test-task", "name: x\nname: y", "name", 2, "found twice, the first time in line 1; expected once"),
    ("name: test-task", "name: x\nfolder: y", "folder", 2, "unknown key"),
    ("200}", "2}", "solver.collocation_points", 14, "found 2; expected a whole number from 10 to 20000"),
    ("200}", "1000000}", "solver.collocation_points", 14, "found 1000000; expected a whole number from 10 to 20000"),
    (
        "method: ipopt",
        "method: best",
        "solver.method",
        14,
        "found the text 'best'; expected one of ipopt, reachability",
    ),
    ("method: ipopt", "cost: effort", "solver.weight", 14, "found 0; expected a number above 0 with cost effort"),
    ("[0.4, 0.6]", "[0.6, 0.4]", "uncertainty.friction", 13, "found [0.6, 0.4]; expected the lowest value first: [0.4"),
    ("[0.4, 0.6]", "[0, 0.6]", "uncertainty.friction[0]", 13, "found 0; expected a number from 1e-06"),
    ("[0.4, 0.6]", "[0.2, 0.3]", "uncertainty.friction", 13, "does not contain contact.friction = 0.5"),
    ("friction: [0.4, 0.6]", "mass: {upper: [0.6, 0.7]}", "uncertainty.mass.upper", 13, "objects.upper.mass = 0.5"),
    (
        "friction: [0.4, 0.6]",
        "mass: {tray: [-1, 2]}",
        "uncertainty.mass.tray[0]",
        13,
        "found -1; expected a number from 1e-06",
    ),
    (
        "friction: [0.4, 0.6]",
        "mass: {uper: [1, 2]}",
        "uncertainty.mass.uper",
        13,
        "did you mean upper? expected one of",
    ),
    (
        "friction: [0.4, 0.6]",
        "contact_points: 0.04",
        "uncertainty.contact_points",
        13,
        "expected less than half the size",
    ),
    (
        "friction: 0.5",
        "friction: {lower: 0.5}",
        "contact.friction",
        7,
        "no value for upper; expected one for each objec",
    ),
    (
        "friction: 0.5",
        "friction: {all: 0.5, lower: 0.5, upper: 0.5}",
        "contact.friction.all",
        7,
        "nothing is called al",
    ),
    ("on: lower", "on: middle", "objects.upper.on", 6, "nothing is called middle; expected one of tray, lower, upper"),
    ("on: tray", "on: upper", "objects.lower.on", 5, "lower stands on upper, which stands on lower; expected a chain"),
    ("on: lower", "on: upper", "objects.upper.on", 6, "upper stands on upper; expected a chain that ends on the tray"),
    ("on: lower", "on: [lower, lower]", "objects.upper.on", 6, "found lower twice; expected two different supports"),
    (
        "on: lower",
        "on: [lower, tray]",
        "objects.upper.on",
        6,
        "0.125 m for lower and 0.005 m for tray; expected two su",
    ),
    (
        "on: lower, at: [0, 0]",
        "on: tray, at: [0.03, 0]",
        "objects.upper",
        6,
        "it overlaps with lower; expected another `at`",
    ),
    ("on: lower, at: [0, 0]", "on: lower, at: [0.2, 0]", "objects.upper.at", 6, "is off the upper face of lower"),
    (
        "on: lower, at: [0, 0]",
        "on: lower, at: [0.05, 0]",
        "objects.upper",
        6,
        "so it tips over at rest; expected it abov",
    ),
    ("on: tray, at: [0, 0]", "on: tray, at: [0.3, 0]", "objects.lower.at", 5, "off the tray, which reaches from -0.15"),
    ("on: lower", "on: lower, center_of_mass: [0.05, 0, 0]", "objects.upper", 6, "so it tips over at rest"),
    (
        "on: lower",
        "on: lower, inertia: [1, 1, 3]",
        "objects.upper.inertia",
        6,
        "the largest exceeds the sum of the others",
    ),
    (
        "on: lower",
        "on: lower, inertia: [1, 1, -1]",
        "objects.upper.inertia",
        6,
        "principal moments are -1, 1, 1; expecte",
    ),
    ("on: lower", "on: lower, inertia: [1, 1]", "objects.upper.inertia", 6, "three numbers, or a list of six numbers"),
    ("on: lower", "on: lower, radius: 1", "objects.upper.radius", 6, "found radius for a box; expected only size"),
    (
        "upper: {shape: box",
        "upper: {shape: cylinder",
        "objects.upper.radius",
        6,
        "missing; expected radius and height for a",
    ),
    ("upper: {", "default: {", "objects.default", 6, "cannot be called default"),
    ("upper: {", "an upper: {", "objects.an upper", 6, "expected a name of letters, digits"),
    ("yaw: 0.59", "yaw: 0.59, rpy: [0, 0, 0]", "path.tray_poses[1]", 11, "found rpy and yaw; expected at most one"),
    ("yaw: 0.59", "quaternion: [0, 0, 0, 0]", "path.tray_poses[1].quaternion", 11, "which has no direction; expected"),
    ("0.5, 0.75], yaw: 0.59", "-0.5, 0.75], yaw: -0.59", "path.tray_poses[1]", 11, "the same waypoint as path.tray_po"),
    ("- {position: [0.75, 0.5, 0.75], yaw: 0.59}", "", "path.tray_poses", 9, "found 1 waypoint; expected at least two"),
    ("path:", "path:\n  joints: [[0], [1]]", "path", 8, "found both of tray_poses and joints; expected exactly one"),
    ("path:\n  tray_poses:", "path:\n  blend: 0\ndemo:", "demo", 10, "unknown key"),
]


@pytest.mark.parametrize(("old", "new", "key", "line", "message"), WRONG_VALUES, ids=lambda value: str(value)[:40])
def test_a_mistake_is_answered_with_place_finding_and_remedy(task, old, new, key, line, message):
    found = problems(task((old, new)))
    about_key = [problem for problem in found if problem.startswith(f"task.yaml:{line}: {key}: ")]
    assert about_key, found
    assert message in about_key[0]


JOINT_PATHS = [
    ("[[0, 1], [1, 1, 1]]", "path.joints[1]: found 3 joint positions; expected 2 as in path.joints[0]"),
    ("[[0, 1], [0, 1]]", "path.joints[1]: found the same waypoint as path.joints[0]; expected it once"),
    ("[[0, 1]]", "path.joints: found 1 waypoint; expected at least two"),
    ("[]", "path.joints: found 0 waypoints; expected at least two"),
    ("[[0, a], [1, 1]]", "path.joints[0][1]: found the text 'a'; expected a plain number"),
    ("7", "path.joints: found 7; expected a list of lists of numbers or texts, or text"),
]


@pytest.mark.parametrize(("joints", "message"), JOINT_PATHS)
def test_joint_waypoints_must_be_two_or_more_of_one_size(task, joints, message):
    (problem,) = problems(task(), f"path={{joints: {joints}}}")
    assert problem.startswith(f"override 'path={{joints: {joints}}}': {message}")


def test_an_inertia_in_six_numbers_may_have_products(task):
    config = load_config(task(("on: lower", "on: lower, inertia: [2, 2, 2, 0.5, 0, 0]")))
    assert config.objects["upper"].inertia == (2, 2, 2, 0.5, 0, 0)


def test_a_counterweight_may_hold_an_object_that_would_tip_alone(task):
    plank = "plank: {shape: box, size: [0.2, 0.05, 0.01], mass: 0.1, on: lower, at: [0.05, 0]}"
    weight = "weight: {shape: box, size: [0.02, 0.02, 0.02], mass: 1.0, on: plank, at: [-0.09, 0]}"
    alone = task(("upper: {shape: box, size: [0.08, 0.08, 0.12], mass: 0.5, on: lower, at: [0, 0]}", plank))
    assert "so it tips over at rest" in problems(alone)[0]
    held = ("upper: {shape: box, size: [0.08, 0.08, 0.12], mass: 0.5, on: lower, at: [0, 0]}", f"{plank}\n  {weight}")
    assert set(load_config(task(held)).objects) == {"lower", "plank", "weight"}


def test_objects_may_touch_and_stand_above_each_other(task):
    beside = task(("on: lower, at: [0, 0]", "on: tray, at: [0.08, 0]"))
    assert load_config(beside).objects["upper"].at == (0.08, 0)


def test_tipping_at_rest_is_left_to_the_solver_where_the_tray_is_tilted(task):
    path = task(("on: lower, at: [0, 0]", "on: lower, at: [0.05, 0]"), ("yaw: 0.59", "rpy: [0.3, 0, 0.59]"))
    assert load_config(path).objects["upper"].at == (0.05, 0)


# Files as a whole -----------------------------------------------------------------------------------------

WRONG_FILES = [
    ("name: [1, 2\n", ":2: not YAML: "),
    ("name: a: b\n", ":1: not YAML: mapping values are not allowed here; expected lines `key: value`"),
    ("name: x\nrobot:\n\tmodel: y\n", ":3: not YAML: found character '\\t' that cannot start any token; indent with"),
    ("- 1\n- 2\n", ":1: found the list [1, 2]; expected keys and values, such as `name: my-task`"),
    ("just text\n", ":1: found the text 'just text'; expected keys and values"),
    ("", ": found an empty file; expected keys and values"),
    ("# nothing\n", ": found an empty file; expected keys and values"),
    ("name: \x07\n", ":1: not YAML: found a control character; expected printable text"),
    ("name: x\n---\nname: y\n", ":2: not YAML: "),
    ("name: &a [*a]\n", ":1: not YAML: an alias contains itself; write the values out"),
    ("name: !!python/object:os.system x\n", "name: found the tag !!python/object:os.system; expected a plain value"),
    ("? [a]\n: 1\n", ":1: found a list or a section as a key; expected a name"),
    (f"name: {'[' * 3000}\n", ": nested too deeply to be a configuration"),
]


@pytest.mark.parametrize(("text", "message"), WRONG_FILES, ids=[message[:30] for _, message in WRONG_FILES])
def test_what_is_not_a_configuration_is_said_in_one_sentence(task, text, message):
    assert any(message in problem for problem in problems(task(text=text)))


def test_aliases_of_aliases_do_not_grow_without_bound(task):
    levels = "".join(f"l{i}: &l{i} [{', '.join([f'*l{i - 1}'] * 10)}]\n" for i in range(1, 9))
    (problem,) = problems(task(text=f"l0: &l0 [1]\n{levels}"))
    assert "more than 200,000 values; write the values out" in problem


def test_missing_file_folder_and_binary_file_are_told_apart(tmp_path):
    (tmp_path / "binary.yaml").write_bytes(b"\xff\xfe\x00name")
    for name, message in [("no.yaml", "no such file"), ("", "this is a folder"), ("binary.yaml", "is not UTF-8 text")]:
        with pytest.raises(ConfigError, match=message):
            load_config(tmp_path / name)


def test_all_mistakes_are_reported_at_once_file_first(task):
    path = task(
        ("model: tx90l", "modl: tx90l"),
        ("mass: 1.0", "mass: -1"),
        ("at: [0, 0]}\n  upper", "at: [0, abc]}\n  upper"),
        ("cone_edges", "edges"),
        ("yaw: 0.59", "yaw: 0.59, rpy: [0, 0, 0]"),
        ("[0.4, 0.6]", "[0.6, 0.4]"),
    )
    with pytest.raises(ConfigError) as caught:
        load_config(path, ["seed=-1", "uncertainty.mass={nobody: [1, 2]}"])
    assert [problem.key for problem in caught.value.problems] == [
        "robot.model",
        "robot.modl",
        "tray.mass",
        "objects.lower.at[1]",
        "contact.edges",
        "path.tray_poses[1]",
        "uncertainty.friction",
        "seed",
        "uncertainty.mass.nobody",
    ]


def test_a_mistake_found_later_gets_the_place_of_its_key(task):
    path = task()
    error = located(PathError("out of reach", key="path.tray_poses[1]"), path)
    assert str(error) == f"{path}:11: path.tray_poses[1]: out of reach"
    error = located(PathError("out of reach", key="path.blend"), path, ["path.blend=3"])
    assert str(error) == "override 'path.blend=3': path.blend: out of reach"


@settings(deadline=None)
@given(st.text(max_size=60))
def test_any_text_is_read_or_refused_in_words(tmp_path_factory, text):
    path = tmp_path_factory.mktemp("any") / "any.yaml"
    path.write_text(text, encoding="utf-8", errors="replace")
    with pytest.raises(ConfigError):
        load_config(path)


@settings(deadline=None)
@given(st.lists(st.text(max_size=30), min_size=1, max_size=3))
def test_any_override_is_applied_or_refused_in_words(tmp_path_factory, overrides):
    path = tmp_path_factory.mktemp("any") / "any.yaml"
    path.write_text(TASK, encoding="utf-8")
    with pytest.raises(ConfigError):
        load_config(path, ["solver.method=none", *overrides])


KEYS = [
    *("name", "robot", "robot.limits.all.position", "tray", "tray.size", "tray.mass", "tray.inertia", "objects"),
    *("objects.lower", "objects.lower.size.0", "objects.lower.at", "objects.lower.on", "objects.upper.on"),
    *("objects.upper.yaw", "objects.upper.radius", "objects.third", "contact", "contact.friction", "path"),
    *("path.joints", "path.tray_poses", "path.tray_poses.0", "path.tray_poses.1.quaternion", "uncertainty"),
    *("uncertainty.friction", "uncertainty.contact_points", "uncertainty.mass.upper", "execution", "learning.friction"),
]
VALUES = [
    *("0", "1e300", "-1e300", "1e-9", ".nan", ".inf", "[]", "{}", "null", "abc", "true", "-5", "9" * 330, "cylinder"),
    *("[0, 0]", "[1e300, 1e300, 1e300]", "[1, 2, 3, 4, 5, 6]", "[[0, 0], [1, 1]]", "{lower: 1}", "{lower: [1, 2]}"),
    *("[lower, upper]", "tray", "lower", "upper", "{position: [1, 1, 1], quaternion: [1e-300, 0, 0, 0]}"),
    "{shape: cylinder, radius: 0.05, height: 0.05, mass: 1, on: upper, at: [0.01, 0.02]}",
    "{shape: box, size: [0.05, 0.05, 0.05], mass: 1, on: [lower, upper]}",
]


@settings(deadline=None, max_examples=300)
@given(st.lists(st.tuples(st.sampled_from(KEYS), st.sampled_from(VALUES)), min_size=1, max_size=4))
def test_any_mixture_of_values_is_a_configuration_or_refused_with_places(tmp_path_factory, pairs):
    path = tmp_path_factory.mktemp("any") / "any.yaml"
    path.write_text(TASK, encoding="utf-8")
    found: list[ConfigProblem] = []
    try:
        config = load_config(path, [f"{key}={value}" for key, value in pairs])
    except ConfigError as error:
        found += error.problems
    if found:
        assert all(problem.location and len(str(problem)) < 900 for problem in found)
    else:
        copy = path.with_name("copy.yaml")
        copy.write_text(dump(config), encoding="utf-8")
        assert same(load_config(copy), config)


# Writing and changing -------------------------------------------------------------------------------------


def same(first, second) -> bool:
    return first.model_dump() == second.model_dump()


@settings(deadline=None)
@given(st.floats(1e-6, 1e6), st.floats(-1e9, 1e9))
def test_a_dump_reads_back_exactly(tmp_path_factory, mass, yaw):
    path = tmp_path_factory.mktemp("dump") / "task.yaml"
    path.write_text(TASK, encoding="utf-8")
    config = load_config(path, [f"tray.mass={mass!r}", f"path.tray_poses.0.yaw={yaw!r}"])
    copy = path.with_name("copy.yaml")
    copy.write_text(dump(config), encoding="utf-8")
    assert config.tray.mass == mass
    assert same(load_config(copy), config)


def test_a_dump_is_plain_yaml_with_every_default(task):
    data = yaml.safe_load(dump(load_config(task(), ["objects={}"])))
    assert data["solver"] == {"method": "ipopt", "collocation_points": 200, "cost": "time", "weight": 0.0}
    assert data["gravity"] == [0.0, 0.0, -9.81]
    assert "folder" not in data


def test_file_names_in_a_dump_hold_from_anywhere(task):
    config = load_config(task(), ["robot.model=arms/arm.urdf", "path={joints: waypoints.csv}"])
    data = yaml.safe_load(dump(config))
    assert data["robot"]["model"] == str(config.folder / "arms/arm.urdf")
    assert data["path"]["joints"] == str(config.folder / "waypoints.csv")
    for name in ("tx90l", "package://robots/arm.urdf"):
        assert yaml.safe_load(dump(with_values(config, {"robot.model": name})))["robot"]["model"] == name


def test_values_are_changed_in_a_checked_copy(task):
    config = load_config(task())
    changed = with_values(config, {"contact.friction": 0.41, "path.tray_poses.0.yaw": 0.1, "uncertainty.mass": {}})
    assert (changed.contact.friction, config.contact.friction) == (0.41, 0.5)
    assert changed.path.tray_poses[0].yaw == 0.1
    assert changed.folder == config.folder
    assert same(with_values(changed, {"contact.friction": 0.5, "path.tray_poses.0.yaw": -0.59}), config)
    with pytest.raises(
        ConfigError, match=r"contact.friction=-1: contact.friction: found -1; expected a number from 1e-06 to 100"
    ):
        with_values(config, {"contact.friction": -1})


# Generated pages ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", list(schema.files()))
def test_generated_pages_are_up_to_date(name):
    message = "run python -m robustopt.config.schema"
    assert (DOCS / name).read_text(encoding="utf-8") == schema.files()[name], message


def test_every_key_has_a_meaning_on_the_page_and_in_the_schema():
    page = schema.page()
    for name, model in schema.sections():
        for key in schema.fields(model):
            assert model.model_fields[key].description, f"{name}.{key}"
            assert f"| `{key}` |" in page
    assert json.loads(schema.files()[schema.SCHEMA])["additionalProperties"] is False
