"""The configuration: read from YAML, change, and write back."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from robustopt.config.document import Document, read_yaml, split_key, write_yaml
from robustopt.config.model import Config
from robustopt.config.validate import validate, with_sections
from robustopt.errors import ConfigError
from robustopt.models import MODELS


def load_config(path: str | Path, overrides: Sequence[str] = ()) -> Config:
    """The configuration in a YAML file, with `key=value` overrides on top, the value in YAML.

    Keys are joined by dots, entries of lists are numbered from 0: `path.tray_poses.0.yaw=0.3`, `uncertainty={}`.
    Raises ConfigError with every mistake of the file and the overrides: where, what was found, what would be right.
    """
    return validate(_document(path, overrides), Path(path).absolute().parent)


def located(error: ConfigError, path: str | Path, overrides: Sequence[str] = ()) -> ConfigError:
    """The same mistakes with the places of their keys, for what only shows once the robot or the path is built."""
    document = _document(path, overrides)
    problems = [replace(p, location=p.location or document.locate(split_key(p.key))) for p in error.problems]
    return ConfigError(problems)


def _document(path: str | Path, overrides: Sequence[str]) -> Document:
    document = read_yaml(Path(path))
    if isinstance(document.data, dict) or document.data is None:
        for override in overrides:
            document.override(override)
    return document


def with_values(config: Config, values: Mapping[str, Any]) -> Config:
    """A copy with other values at dotted keys, such as {"contact.friction": 0.3}, checked as `load_config` does."""
    keys = {key: split_key(key) for key in values}
    sections = {key[0] for key in keys.values()}
    document = Document(data=_plain({str(name): _dumped(getattr(config, str(name), None)) for name in sections}))
    for key, value in values.items():
        document.assign(keys[key], Document(data=_plain(value)), f"{key}={value}")
    if not document.problems and (changed := with_sections(config, document.data)) is not None:
        return changed
    document = Document(data=_plain(config.model_dump(exclude_none=True)))
    for key, value in values.items():
        document.assign(keys[key], Document(data=_plain(value)), f"{key}={value}")
    return validate(document, config.folder)


def _dumped(section: Any) -> Any:
    """A section, or a mapping of sections, as plain data."""
    if isinstance(section, dict):
        return {name: _dumped(inner) for name, inner in section.items()}
    return section.model_dump(exclude_none=True) if isinstance(section, BaseModel) else section


def dump(config: Config) -> str:
    """YAML that `load_config` reads as an equal configuration, wherever the file is put; floats read back exactly."""
    return write_yaml(resolved(config))


def resolved(config: Config) -> dict[str, Any]:
    """Every key with its value as plain data, defaults included; names of files are absolute."""
    data: dict[str, Any] = _plain(config.model_dump(exclude_none=True))
    if _is_file(config):
        data["robot"]["model"] = _absolute(config, config.robot.model)
    if isinstance(config.path.joints, str):
        data["path"]["joints"] = _absolute(config, config.path.joints)
    return data


def _is_file(config: Config) -> bool:
    """Whether the robot is a file relative to the configuration, not a shipped robot and not in a package."""
    model = config.robot.model
    shipped = (MODELS / f"{model}.xml").is_file()
    return not shipped and not model.startswith("package://")


def _absolute(config: Config, name: str) -> str:
    return str((config.folder / name).absolute())


def _plain(value: Any) -> Any:
    """Tuples and arrays as lists, so that parts of them can be assigned and written."""
    if isinstance(value, dict):
        return {key: _plain(inner) for key, inner in value.items()}
    if hasattr(value, "tolist"):
        value = value.tolist()
    return [_plain(inner) for inner in value] if isinstance(value, (list, tuple)) else value
