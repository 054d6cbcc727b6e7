"""Read configurations from files, text and mappings, change them, and write them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from robustopt.config.document import Document, Key, read_file, read_text, split_key, write_yaml
from robustopt.config.limits_file import with_limits_file
from robustopt.config.model import ROBOT_SOURCES, Config
from robustopt.config.validate import validate, with_sections
from robustopt.errors import ConfigError
from robustopt.models import MODELS

Source = str | Path | Mapping[str, Any]
"""Path of a file, YAML text, or a mapping with the values."""


def load_config(source: Source, overrides: Sequence[str] = (), folder: str | Path | None = None) -> Config:
    """Return the configuration in a file, in YAML text or in a mapping.

    Args:
        source: path of a YAML file, YAML text (recognised by a line break), or a mapping of keys to values.
        overrides: `key=value` texts that replace values of the source; the value is YAML. Keys are joined by dots, and
            entries of lists are numbered from 0: `path.tray_poses.0.yaw=0.3`, `uncertainty={}`.
        folder: folder that relative file names in the configuration refer to; default: the folder of the file, or the
            current one.

    Returns:
        The configuration, checked.

    Raises:
        ConfigError: the source or an override has mistakes; the error lists all of them, with location and remedy.
    """
    file = _file(source)
    if folder is None:
        folder = file.parent if file is not None else "."
    return with_limits_file(validate(_document(source, overrides), Path(folder).absolute()))


def located(error: ConfigError, source: Source, overrides: Sequence[str] = ()) -> ConfigError:
    """Return an error with the locations of its keys added.

    Only building the robot and the path reveals some mistakes, at a stage at which the document is no longer at hand.

    Args:
        error: the error.
        source: source of the configuration, as for `load_config`.
        overrides: overrides of the configuration, as for `load_config`.
    """
    document = _document(source, overrides)
    problems = [replace(p, location=p.location or document.locate(split_key(p.key))) for p in error.problems]
    return ConfigError(problems)


def _file(source: Source) -> Path | None:
    """Return the path of a source that is a file."""
    return None if isinstance(source, Mapping) or "\n" in str(source) else Path(source)


def _document(source: Source, overrides: Sequence[str]) -> Document:
    file = _file(source)
    if isinstance(source, Mapping):
        document = Document(data=_plain(source))
    else:
        document = read_text(str(source), "text") if file is None else read_file(file)
    if isinstance(document.data, dict) or document.data is None:
        for override in overrides:
            document.override(override)
    return document


def with_values(config: Config, values: Mapping[str, Any]) -> Config:
    """Return a copy of a configuration with some values replaced, checked as by `load_config`.

    Args:
        config: the configuration, which is not changed.
        values: new values by dotted key, such as {"contact.friction": 0.3}.

    Raises:
        ConfigError: a key is unknown, or a value does not fit.
    """
    keys = {key: split_key(key) for key in values}
    sections = {str(key[0]) for key in keys.values()}
    document = Document(data=_plain(config.model_dump(include=sections, exclude_none=True)))
    _assign(document, keys, values)
    if not document.problems and (changed := with_sections(config, document.data)) is not None:
        return with_limits_file(changed)
    document = Document(data=_plain(config.model_dump(exclude_none=True)))
    _assign(document, keys, values)
    return with_limits_file(validate(document, config.folder))


def _assign(document: Document, keys: Mapping[str, Key], values: Mapping[str, Any]) -> None:
    for key, value in values.items():
        document.assign(keys[key], Document(data=_plain(value)), f"{key}={value}")


def dump(config: Config) -> str:
    """Return YAML from which `load_config` reads an equal configuration in any folder; floats read back exactly.

    Args:
        config: the configuration.
    """
    return write_yaml(resolved(config))


def resolved(config: Config) -> dict[str, Any]:
    """Return every key with its value as plain data, including defaults; file names are absolute.

    Args:
        config: the configuration.
    """
    data: dict[str, Any] = _plain(config.model_dump(exclude_none=True))
    if _is_file(config):
        data["robot"]["model"] = _absolute(config, config.robot.model)
    if files := [_absolute(config, name) for name in config.path.joint_files]:
        data["path"]["joints"] = files[0] if isinstance(config.path.joints, str) else files
    return data


def _is_file(config: Config) -> bool:
    """Return whether the robot model is a file relative to the configuration, neither shipped nor of a package."""
    model = config.robot.model
    shipped = (MODELS / f"{model}.xml").is_file()
    return not shipped and model.partition(":")[0] not in ("package", *ROBOT_SOURCES)


def _absolute(config: Config, name: str) -> str:
    return str((config.folder / name).absolute())


def _plain(value: Any) -> Any:
    """Return plain data: mappings with text as keys, tuples and arrays as lists, paths as text."""
    if isinstance(value, Mapping):
        # readers of YAML 1.1 take the key `on` for true
        return {"on" if key is True else str(key): _plain(inner) for key, inner in value.items()}
    if hasattr(value, "tolist"):
        value = value.tolist()
    if isinstance(value, Path):
        return str(value)
    return [_plain(inner) for inner in value] if isinstance(value, (list, tuple)) else value
