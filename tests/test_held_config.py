"""Configurations with held parts: what each mistake is answered with, and too little force at rest."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from scenes import CONFIGS, FIXTURES, G

from robustopt.cli import run
from robustopt.config.load import load_config

TASK = f"""\
name: held-task
robot: {{model: {FIXTURES / "three_slides.xml"}, tool: tool, collision: {{check: false}}}}
objects:
  part: {{shape: box, size: [0.1, 0.1, 0.06], mass: 1.0, held_by: {{suction: {{cups: [{{radius: 0.03}}], force: 40}}}}}}
contact: {{friction: 0.5}}
path: {{joints: [[0, 0, 0], [0.5, 0.2, 0.1]]}}
solver: {{method: reachability, collocation_points: 20}}
"""

HELD = "objects.part.held_by"
CYLINDER = "{shape: cylinder, radius: 0.05, height: 0.06, mass: 1.0, held_by: "


@pytest.fixture
def task(tmp_path: Path) -> Path:
    path = tmp_path / "task.yaml"
    path.write_text(TASK, encoding="utf-8")
    return path


MISTAKES = {
    "cup beside the part": (
        f"{HELD}.suction.cups=[{{at: [-0.02, 0], radius: 0.02}}, {{at: [0.04, 0], radius: 0.03}}]",
        f"{HELD}.suction.cups[1]",
        "the lip at [0.04, 0] m reaches 20 mm beyond the top face of the part; expected all of it on the face",
    ),
    "cup beside a cylinder": (
        f"objects.part={CYLINDER}{{suction: {{cups: [{{at: [0.03, 0.03], radius: 0.02}}], force: 40}}}}}}",
        f"{HELD}.suction.cups[0]",
        "reaches 12.4 mm beyond the top face of the part; expected",
    ),
    "cup beside a side face": (
        f"{HELD}.suction={{face: left, cups: [{{at: [0.01, 0], radius: 0.03}}], force: 40}}",
        f"{HELD}.suction.cups[0]",
        "10 mm beyond the left face of the part; expected all of it on the face, which is 0.06 m along z and 0.1 m "
        "along x of the part",
    ),
    "two parts in one place": (
        "objects.other={shape: box, size: [0.1, 0.1, 0.1], mass: 1.0, held_by: {suction: {pose: {position: "
        "[0.09, 0, 0.02]}, cups: [{radius: 0.03}], force: 40}}}",
        "objects.other",
        "it overlaps with part; expected another `held_by.suction.pose`, or another size",
    ),
    "a name twice": (
        f"objects={{part_pad1: {CYLINDER}{{suction: {{pose: {{position: [0.3, 0, 0]}}, cups: [{{radius: 0.01}}], "
        "force: 9}}}, part: {shape: box, size: [0.1, 0.1, 0.1], mass: 1.0, held_by: {grip: {pad: [0.02, 0.02], "
        "force: 9}}}}",
        "objects.part_pad1",
        "a contact is already called part_pad1; expected another name",
    ),
    "a tool that is no section": (
        f"{HELD}=suction",
        HELD,
        "found the text 'suction'; expected a section with the keys suction, grip",
    ),
    "cups overlap": (
        f"{HELD}.suction.cups=[{{at: [-0.01, 0], radius: 0.02}}, {{at: [0.02, 0], radius: 0.02}}]",
        f"{HELD}.suction.cups[1]",
        "the lip overlaps that of cups[0] by 10 mm; expected lips apart",
    ),
    "no cups": (f"{HELD}.suction.cups=[]", f"{HELD}.suction.cups", "found no cups; expected at least one"),
    "no force": (f"{HELD}.suction.force=0", f"{HELD}.suction.force", "found 0; expected a number above 0"),
    "no force in an interval": (
        f"{HELD}.suction.force=[0, 9]",
        f"{HELD}.suction.force[0]",
        "expected a number above 0",
    ),
    "interval reversed": (
        f"{HELD}.suction.force=[45, 35]",
        f"{HELD}.suction.force",
        "found [45, 35]; expected the lowest value first: [35, 45]",
    ),
    "both on and held_by": ("objects.part.on=tray", "objects.part.on", "not allowed with held_by"),
    "a pressure and held_by": (
        "objects.part.pressure=fixed",
        "objects.part.pressure",
        "expected it in held_by.suction",
    ),
    "a place and held_by": ("objects.part.at=[0.1, 0]", "objects.part.at", "expected it in held_by.suction"),
    "two tools": (
        f"{HELD}.grip={{pad: [0.02, 0.02], force: 40}}",
        HELD,
        "found both suction and grip; expected one of them",
    ),
    "no tool": (f"{HELD}={{}}", HELD, "found neither suction nor grip; expected one of them"),
    "a wide pad": (
        f"{HELD}={{grip: {{pad: [0.2, 0.02], force: 40}}}}",
        f"{HELD}.grip.pad",
        "a pad of 0.2 m reaches 50 mm beyond the part, which is 0.1 m wide there; expected pads that lie on the part",
    ),
    "a pad below the part": (
        f"{HELD}={{grip: {{pad: [0.02, 0.02], force: 40, depth: 0.055}}}}",
        f"{HELD}.grip.pad",
        "reaches 5 mm beyond the part, which is 0.06 m wide there; expected",
    ),
    "pads on edges": (
        f"{HELD}={{grip: {{pad: [0.02, 0.02], force: 40, yaw: 0.3}}}}",
        f"{HELD}.grip.yaw",
        "found 0.3 rad, which leaves no flat face at the pads; expected a multiple of pi / 2",
    ),
    "a cylinder in a grip": (
        f"objects.part={CYLINDER}{{grip: {{pad: [0.02, 0.02], force: 40}}}}}}",
        f"{HELD}.grip",
        "found a gripper on a cylinder; expected cups on its top or bottom",
    ),
    "a cup at the side of a cylinder": (
        f"objects.part={CYLINDER}{{suction: {{face: left, cups: [{{radius: 0.01}}], force: 40}}}}}}",
        f"{HELD}.suction",
        "found the face left on a cylinder; expected cups on its top or bottom",
    ),
    "an object without a tray": (
        "objects.block={shape: box, size: [0.05, 0.05, 0.05], mass: 0.2}",
        "tray",
        "missing, but block stands on it; expected",
    ),
    "an unknown contact": (
        "uncertainty.contact_points={part_cup1: 0.001}",
        "uncertainty.contact_points.part_cup1",
        "nothing is called part_cup1; did you mean part? expected one of part, default",
    ),
    "nothing certain of a lip": (
        "uncertainty.contact_points=0.04",
        "uncertainty.contact_points",
        "leaves no certain part of the contact of part on cup; expected less",
    ),
}


@pytest.mark.parametrize("name", MISTAKES)
def test_a_mistake_is_one_line_with_its_key_and_a_remedy(
    name: str, task: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    override, key, words = MISTAKES[name]
    assert run(["validate", str(task), override, "--quiet"]) == 2
    out, err = capsys.readouterr()
    (line,) = err.splitlines()
    assert f": {key}: " in line
    assert words in line
    assert "; expected" in line or "; did you mean" in line or key == "objects.part.on"
    assert not out


def test_poses_of_the_tool_are_for_a_robot_without_a_tray(task: Path, capsys: pytest.CaptureFixture[str]) -> None:
    poses = "path={tool_poses: [{position: [0, 0, 0]}, {position: [0, 0, 1]}]}"
    tray = "tray={size: [0.3, 0.3, 0.01], mass: 1.0}"
    assert run(["validate", str(task), poses, tray, "--quiet"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert ": path.tool_poses: not allowed with a tray; expected tray_poses" in line


def test_a_held_part_in_the_tray_overlaps_with_it(task: Path, capsys: pytest.CaptureFixture[str]) -> None:
    tray = "tray={size: [0.3, 0.3, 0.01], mass: 1.0, pose: {position: [0, 0, 0.03]}}"
    assert run(["validate", str(task), tray, "--quiet"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert ": objects.part: it overlaps with tray; expected another `held_by.suction.pose`" in line


@pytest.mark.parametrize("part", ["tray", "tray.hands"])
def test_several_tools_need_a_tray_with_hands(part: str, capsys: pytest.CaptureFixture[str]) -> None:
    changes = [f"{part}=null", "objects={}", "contact.friction=0.5", "uncertainty.contact_points=0.001"]
    assert run(["validate", str(CONFIGS / "humanoid_tray.yaml"), *changes, "--quiet"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert f": robot.tool: found left_hand and right_hand, but {part} is missing; expected it, or one tool" in line


def test_hands_on_a_tray_need_several_tools(task: Path, capsys: pytest.CaptureFixture[str]) -> None:
    tray = "tray={size: [0.3, 0.3, 0.01], mass: 1.0, hands: {pad: [0.02, 0.02], force: 9}}"
    assert run(["validate", str(task), tray, "objects={}", "--quiet"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert ": tray.hands: found hands, but one tool, tool; expected robot.tool to list hands" in line


@pytest.mark.parametrize(
    "tool", ["{suction: {cups: [{radius: 0.03}]}}", "{grip: {force: 40}}", "{grip: {pad: 3, force: 1}}"]
)
def test_a_tool_that_lacks_a_value_is_answered_in_words_alone(
    tool: str, task: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["validate", str(task), f"{HELD}={tool}", "--quiet"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert f": {HELD}." in line
    assert "expected" in line


def test_contacts_of_held_parts_take_friction_by_their_own_name_then_by_that_of_the_part(task: Path) -> None:
    pads = f"{HELD}={{grip: {{pad: [0.02, 0.02], force: 40}}}}"
    config = load_config(task, [pads, "contact.friction={part_pad1: 0.7, part: 0.4}"])
    assert config.contact_owners == {"part_pad1": "part", "part_pad2": "part"}
    two = load_config(
        task, [f"{HELD}.suction.cups=[{{at: [-0.02, 0], radius: 0.01}}, {{at: [0.02, 0], radius: 0.01}}]"]
    )
    assert list(two.contact_owners) == ["part_cup1", "part_cup2"]
    assert list(load_config(task).contact_owners) == ["part"]


def test_a_vacuum_below_the_weight_at_rest_names_the_force_that_is_needed(
    task: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    weak = [f"{HELD}.suction.force=6", "--quiet", "--no-figures", "--json"]
    assert run(["plan", str(task), *weak, "--out", str(tmp_path / "weak")]) == 3
    diagnosis = json.loads(capsys.readouterr().out)["diagnosis"]
    key = f"{HELD}.suction.force"
    assert diagnosis["standstill"]
    assert diagnosis["conflicts"] == [["peel of part off cup"]]
    (remedy,) = diagnosis["remedies"]
    needed = remedy["needed"]
    assert (remedy["key"], remedy["found"], remedy["enough"]) == (key, 6.0, True)
    assert needed == pytest.approx(G, rel=2e-3)
    assert run(["plan", str(task), f"{key}=6", "--no-figures", "--out", str(tmp_path / "told")]) == 3
    assert f"{key}: at least {needed:.4g} instead of 6" in " ".join("".join(capsys.readouterr()).split())
    task.write_text(TASK.replace("force: 40", f"force: {needed}"), encoding="utf-8")
    assert run(["plan", str(task), "--quiet", "--no-figures", "--out", str(tmp_path / "enough")]) == 0
