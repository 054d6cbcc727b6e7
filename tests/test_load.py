"""Configurations from files, text and mappings: the same values, and the places of mistakes."""

from pathlib import Path
from types import MappingProxyType

import numpy as np
import pytest
import yaml

from robustopt.config.load import load_config, located
from robustopt.errors import ConfigError, RobotError

CONFIGS = Path(__file__).parents[1] / "configs"


def test_text_and_a_mapping_give_the_configuration_of_the_file(tmp_path):
    path = CONFIGS / "waiter_two_blocks.yaml"
    text = path.read_text()
    values = yaml.safe_load(text)
    overrides = ["contact.friction=0.3"]
    read = [load_config(source, overrides, folder=CONFIGS) for source in (path, str(path), text, values)]
    assert all(config == read[0] for config in read)
    assert load_config(text).folder == Path.cwd()
    assert load_config(text, folder=tmp_path).folder == tmp_path
    assert load_config(path).folder == CONFIGS
    assert "contact" not in values or values["contact"].get("friction") != 0.3  # the mapping stays as it is


def test_a_mapping_may_hold_arrays_tuples_paths_and_other_mappings():
    values = yaml.safe_load((CONFIGS / "waiter_one_block.yaml").read_text())
    expected = load_config(values)
    values["gravity"] = np.array([0.0, 0.0, -9.81])
    values["tray"] = MappingProxyType({**values["tray"], "size": tuple(values["tray"]["size"])})
    values["robot"]["model"] = Path(values["robot"]["model"])
    assert load_config(values) == expected.model_copy(update={"gravity": (0.0, 0.0, -9.81)})


@pytest.mark.parametrize(
    ("source", "message"),
    [
        ("name: x\nsolver: {metod: ipopt}\n", "text:2: solver.metod: unknown key; did you mean method?"),
        ("name: [\n", "text:2: not YAML: "),
        ({"name": "x", "solver": {"metod": "ipopt"}}, "solver.metod: unknown key; did you mean method?"),
        ({"name": "x", "seed": object()}, "seed: found <object object"),
        ({"name": "x", 3: 4}, "3: unknown key; expected one of name"),
        ({}, "robot: missing; expected a section"),
    ],
)
def test_mistakes_in_text_and_mappings_have_their_places(source, message):
    with pytest.raises(ConfigError) as caught:
        load_config(source)
    assert any(str(problem).startswith(message) for problem in caught.value.problems), str(caught.value)


def test_places_are_found_in_text_too():
    text = (CONFIGS / "waiter_one_block.yaml").read_text()
    error = located(RobotError("no site", key="robot.tool"), text)
    line = 1 + next(i for i, row in enumerate(text.splitlines()) if "tool:" in row)
    assert str(error) == f"text:{line}: robot.tool: no site"
