"""Joint waypoints from files of loggers and planners: what is read, what is noted, and one error per mistake."""

import json
from pathlib import Path

import numpy as np
import pytest
import yaml
from scenes import scene

import robustopt as ro
from robustopt.path.joint_waypoints import Waypoints, joint_waypoints
from robustopt.recordings import recording

JOINTS = ("j1", "j2", "j3")
ARM = """
<mujoco><worldbody><body><joint name="j1" axis="0 0 1" range="-180 180"/><geom size="0.02"/>
<body pos="0.3 0 0"><joint name="j2" axis="0 0 1" range="-180 180"/><geom size="0.02"/>
<body pos="0.3 0 0"><joint name="j3" type="slide" axis="0 0 1" range="-1 1"/><geom size="0.02"/>
<site name="tool"/></body></body></body></worldbody></mujoco>
"""
LIMITS = {"velocity": 1.0, "acceleration": 5.0, "torque": ".inf"}


@pytest.fixture
def load(tmp_path):
    """Waypoints of files with some contents, read in the unit and way of other keys of the path."""

    def load(*files: tuple[str, str], **keys) -> Waypoints:
        for name, content in files:
            (tmp_path / name).write_text(content, encoding="utf-8")
        locked = keys.pop("locked", {})
        names = [name for name, _ in files]
        path = {"joints": names if len(names) > 1 else names[0], **keys}
        data = {"name": "t", "robot": {"model": "tx90l", "locked": locked}, "path": path}
        config = ro.load_config(data, folder=tmp_path)
        return joint_waypoints(config, JOINTS, np.array([True, True, False]))

    return load


@pytest.fixture
def refused(load):
    def refused(*files: tuple[str, str], **keys) -> str:
        with pytest.raises(ro.ConfigError) as caught:
            load(*files, **keys)
        assert len(caught.value.problems) == 1
        assert "\n" not in str(caught.value)
        return str(caught.value)

    return refused


EXPECTED = [[0.0, 0.1, 0.2], [1.0, 1.1, 0.3], [2.0, 0.5, 0.4]]


# Tables ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "text",
    [
        "0,0.1,0.2\n1,1.1,0.3\n2,0.5,0.4\n",
        "0;0.1;0.2\r\n1;1.1;0.3\r\n2;0.5;0.4\r\n",
        "0\t0.1\t0.2\n1\t1.1\t0.3\n2\t0.5\t0.4",
        "0.0e+00 1.0e-01 2.0e-01\n1 1.1 .3\n2 0.5   0.4\n",
        "# by hand\n\n0, 0.1, 0.2\n% home\n1, 1.1, 0.3\n// end\n2, 0.5, 0.4\n",
        "0,0.1,0.2,\n1,1.1,0.3,\n2,0.5,0.4,\n",
        "j3,j1,j2\n0.2,0,0.1\n0.3,1,1.1\n0.4,2,0.5\n",
        "# j3 j1 j2\n0.2 0 0.1\n0.3 1 1.1\n0.4 2 0.5\n",
        "q_j1;q_j2;q_j3\n0;0.1;0.2\n1;1.1;0.3\n2;0.5;0.4\n",
        "position_j1,pos.j2,j3/position\n0,0.1,0.2\n1,1.1,0.3\n2,0.5,0.4\n",
        '"j1 [rad]","j2 (rad)","j3 [m]"\n0,0.1,0.2\n1,1.1,0.3\n2,0.5,0.4\n',
        "/joint_states/j1/position,/joint_states/j2/position,/joint_states/j3/position\n0,.1,.2\n1,1.1,.3\n2,.5,.4\n",
    ],
    ids=[
        *("comma", "semicolon", "tab", "spaces", "comments", "end"),
        *("order", "comment header", "q", "position", "units", "topics"),
    ],
)
def test_a_table_is_read_in_the_order_of_the_joints(load, text):
    waypoints = load(("w.csv", text))
    np.testing.assert_allclose(waypoints.q, EXPECTED, atol=1e-15)
    assert (waypoints.notes, waypoints.recorded, list(waypoints.stops)) == ((), None, [])


def test_other_columns_are_noted_once_and_times_kept(load):
    text = "time,qd_j1,j1,j2,j3,mode\n10,0,0,0.1,0.2,run\n10.5,x,1,1.1,0.3,\n12.5,2,2,0.5,0.4,run\n"
    waypoints = load(("w.csv", text))
    np.testing.assert_allclose(waypoints.q, EXPECTED)
    assert waypoints.notes == ("w.csv: columns not used: qd_j1, mode",)
    assert waypoints.recorded == 2.5


@pytest.mark.parametrize(
    ("head", "scale"), [("t", 1), ("time [ms]", 1e-3), ("timestamp_ns", 1e-9), ("Time (s)", 1), ("time_from_start", 1)]
)
def test_a_time_column_has_a_unit(load, head, scale):
    waypoints = load(("w.csv", f"j1,j2,j3,{head}\n0,0,0,100\n1,1,1,100\n2,1,1,400\n"))
    assert waypoints.recorded == pytest.approx(300 * scale, rel=1e-12)


def test_a_clock_of_texts_is_not_used(load):
    waypoints = load(("w.csv", "timestamp,j1,j2,j3\n10:00:01,0,0,0\n10:00:02,1,1,1\n"))
    assert waypoints.notes == ("w.csv: columns not used: timestamp",)
    assert waypoints.recorded is None


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("j1,j2\n0,0\n1,1\n", "the columns are j1, j2; they must be the joints j1, j2, j3, in any order and among "
         "others; found none for j3"),
        ("j1,q_j2,pos_j2,j3\n0,0,0,0\n", "the columns q_j2 and pos_j2 are both for the joint j2; expected one"),
        ("0,0\n1,1\n", "without a header, but has 2 values; the robot has 3 joints: j1, j2, j3"),
        ("j1,j2,j3\n" + "0,0,0\n" * 12 + "0,0\n" * 12, "12 rows have 2 values; expected 3; first: line 14"),
        ("# log\nj1,j2,j3\n0,0\n0,0,0,0\n", "2 rows have 2 to 4 values; expected 3; first: line 3"),
        ("j1,j2,j3\n0,0,0\n1,b,c\n", "2 values are not finite numbers; first: 'b' in line 3, column j2"),
        ("0;0;0\n1;1,5;2\n", "first: '1,5' in line 2, column j2; expected a decimal point: 1.5"),
        ("0,0,0\n1,,2\n", "1 value is not a finite number; first: '' in line 2, column j2"),
        ("t,j1,j2,j3\n0,0,0,0\n2,1,1,1\n1.5,2,2,2\n1,3,3,3\n", "the time runs backwards 2 times, first from 2 s to "
         "1.5 s, line 4; expected times in order"),
        ("j1 [deg],j2 [deg],j3\n0,0,0\n90,0,0\n", "the column j1 [deg] is in degrees; expected path.unit: degrees"),
    ],
)  # fmt: skip
def test_one_mistake_in_a_table_is_one_error(refused, text, told):
    message = refused(("w.csv", text))
    assert told in message
    assert "w.csv: " in message


def test_degrees_turn_hinges_alone(load, refused):
    text = "j1 [deg],j2_deg,j3 [m]\n0,0,0.1\n90,-45,0.2\n180,30,0.3\n"
    waypoints = load(("w.csv", text), unit="degrees")
    np.testing.assert_allclose(waypoints.q, [[0, 0, 0.1], [np.pi / 2, -np.pi / 4, 0.2], [np.pi, np.pi / 6, 0.3]])
    assert waypoints.notes == ()
    assert "the column j1 [rad] is in radians" in refused(("v.csv", "j1 [rad],j2,j3\n0,0,0\n1,1,1\n"), unit="degrees")


@pytest.mark.parametrize(
    ("rows", "unit", "told"),
    [
        ("0,0,0\n30,45,0.5\n", "radians", "the angles reach over 45 rad, more than a turn; if they are degrees: path"),
        ("90,0,0\n92,1,0\n", "radians", "reach over 92 rad"),
        ("-3.2,0,0\n3.2,1,0\n", "radians", "reach over 6.4 rad"),
        ("0,0,0\n1.5,1,0.5\n", "degrees", "the angles reach over 1.5 degrees only; if they are radians"),
    ],
)  # fmt: skip
def test_angles_that_look_like_the_other_unit_are_noted(load, rows, unit, told):
    (note,) = load(("w.csv", rows), unit=unit).notes
    assert told in note


@pytest.mark.parametrize("rows", ["0,0,0\n6.2,-3,0\n", "0,0,-50\n1,1,50\n"])
def test_angles_below_a_turn_and_slides_raise_no_doubt(load, rows):
    assert load(("w.csv", rows)).notes == ()


# Repeated rows --------------------------------------------------------------------------------------------

DWELL = "0,0,0\n" * 3 + "1,1,0.1\n" * 4 + "2,0,0.2\n" + "1,0,0.5\n" * 2


def test_repeated_rows_are_dropped_with_one_note(load):
    waypoints = load(("w.csv", DWELL))
    np.testing.assert_array_equal(waypoints.q, [[0, 0, 0], [1, 1, 0.1], [2, 0, 0.2], [1, 0, 0.5]])
    assert waypoints.notes == ("6 waypoints repeat the one before; dropped; path.repeated: stop keeps them as stops",)
    assert not len(waypoints.stops)


def test_repeated_rows_can_be_stops(load):
    waypoints = load(("w.csv", DWELL), repeated="stop")
    assert len(waypoints.q) == 4
    assert list(waypoints.stops) == [1]
    assert waypoints.notes == (
        "6 waypoints repeat the one before; the robot stops at 1 place between start and end for them",
    )


def test_a_robot_rests_at_a_stop_of_its_list():
    joints, limits = [[0.0], [0.4], [0.4], [1.0]], {"limits": {"all": {"velocity": 2.0, "acceleration": 2.0}}}
    config = scene(robot_keys=limits)
    config = ro.with_values(config, {"path.repeated": "stop", "path.joints": joints})
    plan = ro.solve(ro.build_problem(config))
    assert list(plan.problem.path.breaks) == pytest.approx([0.0, 0.4, 1.0])
    assert plan.x[np.searchsorted(plan.s, 0.4)] == 0
    assert plan.duration == pytest.approx(2 * np.sqrt(0.4 / 2) + 2 * np.sqrt(0.6 / 2), rel=1e-6)
    with pytest.raises(ro.ConfigError, match=r"path\.joints\[2\]: found the same waypoint"):
        ro.with_values(scene(), {"path.joints": joints})


# Arrays and messages --------------------------------------------------------------------------------------


def test_arrays_are_read(tmp_path):
    np.save(tmp_path / "w.npy", np.asfortranarray(EXPECTED))
    config = ro.load_config({"name": "t", "robot": {"model": "tx90l"}, "path": {"joints": "w.npy"}}, folder=tmp_path)
    np.testing.assert_array_equal(joint_waypoints(config, JOINTS, np.ones(3, bool)).q, EXPECTED)
    for array, told in (
        (np.zeros((4, 2)), "an array of shape (4, 2) and type float64; expected one row per waypoint with 3 numbers"),
        (np.zeros(3), "an array of shape (3,)"),
        (np.array([[None, 1, 2]]), "cannot be read as an array: "),
        (np.array([[0, 0, 0], [np.nan, 0, 0]]), "1 row has values that are not finite numbers; first: row 1"),
    ):
        np.save(tmp_path / "w.npy", array, allow_pickle=True)
        with pytest.raises(ro.PathError) as caught:
            joint_waypoints(config, JOINTS, np.ones(3, bool))
        assert told in str(caught.value)
    head = b"\x93NUMPY\x01\x00v\x00{'descr': '<f8', 'fortran_order': False, 'shape': (100000000000, 3), }"
    for content in (b"", b"\x93NUMPY", b"PK\x03\x04", head.ljust(127) + b"\n"):
        (tmp_path / "w.npy").write_bytes(content)
        with pytest.raises(ro.PathError, match="cannot be read as an array"):
            joint_waypoints(config, JOINTS, np.ones(3, bool))


def message(names=("j2", "j1", "finger", "j3"), finger=(0.02, 0.02, 0.02), **changes) -> dict:
    points = [
        {"positions": [dict(zip(JOINTS, q, strict=True)).get(n, f) for n in names], "velocities": [0.0] * len(names),
         "time_from_start": {"sec": 2 * i, "nanosec": 500_000_000}}
        for i, (q, f) in enumerate(zip(EXPECTED, finger, strict=True))
    ]  # fmt: skip
    return {"header": {"frame_id": ""}, "joint_names": list(names), "points": points, **changes}


def written(data, name: str) -> tuple[str, str]:
    return name, json.dumps(data) if name.endswith(".json") else yaml.safe_dump(data)


@pytest.mark.parametrize("name", ["w.json", "w.yaml", "w.yml"])
@pytest.mark.parametrize("wrap", [lambda m: m, lambda m: {"joint_trajectory": m, "multi_dof_joint_trajectory": {}}])
def test_messages_are_read_in_the_order_of_the_joints(load, name, wrap):
    waypoints = load(written(wrap(message()), name))
    np.testing.assert_array_equal(waypoints.q, EXPECTED)
    assert waypoints.recorded == 4.0
    assert waypoints.notes == (f"{name}: joints not used: finger",)


def test_messages_of_ros_1_and_of_the_ros_tools_are_read(load):
    old = message()
    for i, point in enumerate(old["points"]):
        point["time_from_start"] = {"secs": i, "nsecs": 250_000_000 * i}
    assert load(written({"trajectory": old}, "w.json")).recorded == 2.5
    text = yaml.safe_dump(message()).replace("0.1", "1e-1") + "---\n"
    np.testing.assert_array_equal(load(("w.yaml", text)).q, EXPECTED)


def test_another_joint_may_move_if_it_is_locked(load, refused):
    moving = written(message(finger=(0.0, 0.02, 0.04)), "w.json")
    assert "joints move that the robot does not have: finger by 0.04; expected them in robot.locked" in refused(moving)
    np.testing.assert_array_equal(load(moving, locked={"finger": 0.02}).q, EXPECTED)


def without_time(i):
    data = message()
    del data["points"][i]["time_from_start"]
    return data


def shortened(*points):
    data = message()
    for i in points:
        data["points"][i]["positions"].pop()
    return data


@pytest.mark.parametrize(
    ("data", "told"),
    [
        (message(names=("j1", "j2")), "has no positions of j3; its joints are j1, j2"),
        (message(names=("j1", "j1", "j2", "j3")), "repeat a name"),
        (shortened(1, 2), "2 points have not one position for each of the 4 joint_names; first: points[1] with 3"),
        (without_time(1), "1 point has no time_from_start with sec and nanosec; first: points[1]"),
        (message(points=message()["points"][::-1]), "the time runs backwards 2 times, first from 4.5 s to 2.5 s"),
        (message(points=None), "has no list of points"),
        (message(points=[]), "a path needs at least two waypoints; there is none"),
        ([1, 2], "is not a message"),
        ({"a": 1}, "has no joint_names; expected a ROS JointTrajectory or RobotTrajectory"),
        ({"joint_trajectory": message(), "multi_dof_joint_trajectory": {"points": [{}]}}, "multi_dof_joint_trajectory"),
        (message(points=[{"positions": [0, 0, True, "x"]}] * 3), "6 positions are not finite numbers; first: 'True' in "
         "points[0]"),
    ],
)  # fmt: skip
def test_one_mistake_in_a_message_is_one_error(refused, data, told):
    assert told in refused(written(data, "w.json"))


@pytest.mark.parametrize(
    ("name", "text"),
    [("w.json", "{"), ("w.yaml", "a: ["), ("w.json", "[" * 100_000), ("w.json", '{"a": 1' + "0" * 9999)],
)
def test_what_is_no_message_is_one_error(refused, name, text):
    assert "cannot be read as" in refused((name, text))


def test_files_are_bounded(refused, monkeypatch):
    monkeypatch.setattr(recording, "MOST_ROWS", 2)
    assert "found more than 2 waypoints; expected fewer" in refused(written(message(), "w.json"))


# Several files --------------------------------------------------------------------------------------------


def test_files_in_turn_are_one_path(load):
    second = "t,j3,j2,j1\n0,0.4004,0.5,2\n1.5,0.1,0,0\n"
    waypoints = load(written(message(names=JOINTS), "a.json"), ("b.csv", second))
    np.testing.assert_allclose(waypoints.q, [*EXPECTED, [0, 0, 0.1]])
    assert (waypoints.notes, waypoints.recorded, list(waypoints.stops)) == ((), 5.5, [])
    assert list(load(("a.csv", "0,0,0\n1,1,1\n"), ("b.csv", "1,1,1\n2,0,0\n"), repeated="stop").stops) == [1]
    assert load(("a.csv", "0,0,0\n1,1,1\n"), ("b.csv", second.replace("0.4004,0.5,2", "1,1,1"))).recorded is None


def test_a_gap_between_files_is_an_error(refused):
    told = refused(("a.csv", "0,0,0\n1,1,1\n"), ("b.csv", "1,1.35,1\n2,0,0\n"))
    assert "b.csv: begins 0.35 from the end of a.csv (joint j2); expected its first waypoint to be the last one" in told
    assert "a.csv: has no waypoints" in refused(("a.csv", "j1,j2,j3\n"), ("b.csv", "1,1,1\n2,0,0\n"))
    assert "nowhere.csv: cannot be read: No such file" in refused(("a.csv", "0,0,0\n1,1,1\n"), joints="nowhere.csv")


@pytest.mark.parametrize(
    ("path", "told"),
    [
        ({"joints": ["a.csv", [0, 0]]}, "found names of files among waypoints; expected either files or waypoints"),
        ({"joints": ["a.csv", 3]}, "path.joints[1]: found 3; expected a list of numbers, or text"),
        ({"joints": "a.csv", "unit": "deg"}, "path.unit: found the text 'deg'; expected one of radians, degrees"),
        ({"tray_poses": [{"position": [0, 0, 0]}, {"position": [1, 0, 0]}], "unit": "degrees"},
         "path.unit: not allowed with tray_poses; expected it with joints only"),
    ],
)  # fmt: skip
def test_keys_of_joints_are_checked(path, told):
    tray = {"size": [0.1, 0.1, 0.01], "mass": 1}
    with pytest.raises(ro.ConfigError) as caught:
        ro.load_config({"name": "t", "robot": {"model": "tx90l"}, "tray": tray, "path": path})
    assert told in str(caught.value)


# Plans ----------------------------------------------------------------------------------------------------


@pytest.fixture
def task(tmp_path) -> Path:
    (tmp_path / "arm.xml").write_text(ARM)
    data = {
        "name": "replay",
        "robot": {"model": "arm.xml", "tool": "tool", "collision": {"check": False}, "limits": {"all": LIMITS}},
        "tray": {"size": [0.1, 0.1, 0.01], "mass": 0.1},
        "path": {"joints": "log.csv"},
        "solver": {"method": "reachability", "collocation_points": 60},
    }
    (tmp_path / "task.yaml").write_text(yaml.safe_dump(data).replace("'.inf'", ".inf"))
    return tmp_path / "task.yaml"


def test_a_plan_is_compared_with_its_recording(run, task, tmp_path):
    (tmp_path / "log.csv").write_text("t,j1,j2,j3,qd_j1\n0,0,0,0,1\n5,0.5,0.2,0,1\n5,0.5,0.2,0,1\n20,1,0.2,0.1,1\n")
    code, out, err = run("plan", task, "--no-figures", "--out", "first")
    assert (code, err) == (0, "")
    data = json.loads((tmp_path / "first" / "summary.json").read_text())
    assert data["recorded"] == 20.0
    faster = f"{20 / data['duration']:.2f} times as fast."
    assert f"Recorded duration 20.0000 s, planned {data['duration']:.4f} s: {faster}" in " ".join(out.split())
    assert data["notes"] == [
        "log.csv: columns not used: qd_j1",
        "1 waypoint repeats the one before; dropped; path.repeated: stop keeps them as stops",
    ]
    assert "log.csv: columns not used: qd_j1" in out
    assert run("export", "first", "--format", "csv", "--out", "again.csv")[0] == 0
    assert run("plan", task, "--no-figures", "--out", "second", "path.joints=again.csv", "-q")[0] == 0
    again = json.loads((tmp_path / "second" / "summary.json").read_text())
    assert again["recorded"] == pytest.approx(data["duration"], abs=0.004)
    assert again["notes"] == ["again.csv: columns not used: s, sd, sdd, qd_j1, qd_j2, qd_j3, qdd_j1, qdd_j2, qdd_j3"]


def test_a_joint_beyond_its_limit_raises_the_doubt_about_its_unit(run, task, tmp_path):
    (tmp_path / "log.csv").write_text("0,0,0\n45,30,0.1\n")
    code, out, err = run("plan", task, "--no-figures")
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert "beyond its limit" in err
    assert "the angles reach over 45 rad, more than a turn; if they are degrees: path.unit: degrees" in err
    assert run("plan", task, "--no-figures", "path.unit=degrees", "-q") == (0, "", "")


def test_a_run_of_several_files_knows_when_one_changes(run, task, tmp_path):
    (tmp_path / "a.csv").write_text("0,0,0\n0.5,0.2,0\n")
    (tmp_path / "b.csv").write_text("0.5,0.2,0\n1,0.2,0.1\n")
    assert run("plan", task, "--no-figures", "path.joints=[a.csv, b.csv]", "--out", "first", "-q")[0] == 0
    stored = ro.load_config(tmp_path / "first" / "config.yaml")
    assert stored.path.joints == (str(tmp_path / "a.csv"), str(tmp_path / "b.csv"))
    assert run("export", "first", "-q") == (0, "", "")
    (tmp_path / "b.csv").write_text("0.5,0.2,0\n1,0.2,0.2\n")
    code, _, err = run("export", "first")
    assert code == 2
    assert "b.csv have changed since the run was begun" in err
