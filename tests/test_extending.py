"""The files of docs/extending.md run as they stand, outside of the package."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

import robustopt as ro
from robustopt.tasks import PAPER_TASK

PAGE = Path(__file__).parent.parent / "docs" / "extending.md"
LINES = 40

SECTIONS = dict(re.findall(r"^## (.+?)\n.*?```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.S | re.M))


def run(section, folder):
    file = folder / "extension.py"
    file.write_text(SECTIONS[section], encoding="utf-8")
    return subprocess.run([sys.executable, str(file)], cwd=folder, capture_output=True, text=True, check=True).stdout


@pytest.mark.parametrize("section", SECTIONS)
def test_each_file_is_short(section):
    assert len(SECTIONS[section].splitlines()) <= LINES


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
