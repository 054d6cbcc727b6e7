"""The files of docs/extending.md, run from outside of the package as a user would."""

import re
import subprocess
import sys
from pathlib import Path

import pytest
from learning_tasks import THRESHOLD, task
from scenes import CONFIGS

import robustopt as ro
from robustopt.config.load import dump
from robustopt.tasks import PAPER_TASK

PAGE = Path(__file__).parent.parent / "docs" / "extending.md"

LONGEST = 40
"""Lines of a complete extension."""


def extensions() -> dict[str, str]:
    """Return the first Python block of every section by its heading."""
    sections = re.split(r"^## ", PAGE.read_text(encoding="utf-8"), flags=re.MULTILINE)[1:]
    blocks = {text.split("\n", 1)[0]: re.search(r"^```python\n(.*?)^```", text, re.S | re.M) for text in sections}
    return {heading: block[1] for heading, block in blocks.items() if block is not None}


def run(heading: str, folder: Path, *arguments: str) -> str:
    """Run the file of a section in a folder; return its output."""
    (folder / "extension.py").write_text(extensions()[heading], encoding="utf-8")
    command = [sys.executable, "extension.py", *arguments]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=300)
    assert (done.returncode, done.stderr) == (0, "")
    return done.stdout


@pytest.mark.parametrize("heading", extensions())
def test_an_extension_is_short(heading):
    assert len(extensions()[heading].splitlines()) <= LONGEST


def test_a_learner_of_a_user_runs(tmp_path):
    (tmp_path / "task.yaml").write_text(dump(task()), encoding="utf-8")
    output = run("Add a learner", tmp_path, "task.yaml", "learning.trials=0", "execution.disturbance={}")
    rows = [line.split() for line in output.splitlines()]
    assert [result for _, result in rows] == ["success"] * (len(rows) - 1) + ["failure"]
    assert float(rows[-2][0]) < 0.95 * THRESHOLD < float(rows[-1][0])  # creep ends the last percents of friction


def test_a_limit_of_a_user_bounds_the_plan(tmp_path):
    free, slow, binds = map(float, re.findall(r"[\d.]+\d|\d+", run("Add a limit", tmp_path)))
    assert slow > 1.2 * free
    assert binds > 50


def test_a_contact_law_of_a_user_bounds_the_plan(tmp_path):
    smooth, ribbed = map(float, re.findall(r"[\d.]+\d", run("Add a contact law", tmp_path)))
    assert ribbed > 1.2 * smooth


def test_a_law_for_no_contact_is_refused():
    config = ro.load_config(PAPER_TASK)
    with pytest.raises(ro.RobustOptError, match="which is no contact of an object; expected"):
        ro.build_problem(config, laws={"plank": lambda patch, mu, edges: None})


@pytest.mark.parametrize(("name", "contact"), [("pick_gripper", "casting_pad1"), ("pick_suction", "carton")])
def test_a_law_for_cups_or_pads_is_refused(name, contact):
    config = ro.load_config(CONFIGS / f"{name}.yaml")
    with pytest.raises(ro.ConfigError, match=f"a law for {contact}, where the tool holds the object; expected no law"):
        ro.build_problem(config, laws={contact: lambda patch, mu, edges: None})
