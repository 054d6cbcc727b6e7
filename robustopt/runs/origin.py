"""Origin of a run: written with it, and compared whenever the run is executed or continued."""

from __future__ import annotations

import hashlib
import json
import os
import platform
import subprocess
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path
from typing import Any

from robustopt import __version__
from robustopt.config import Config
from robustopt.config.document import shortened
from robustopt.config.load import dump, load_config, resolved
from robustopt.errors import RunFolderError
from robustopt.files import read_bytes, write_text
from robustopt.robot.model_file import model_file, model_hash
from robustopt.runs.records import Checkout, Machine, ModelFile, Provenance
from robustopt.runs.store import CONFIG, PROVENANCE, read_provenance, write_record

PACKAGES = ("numpy", "scipy", "mujoco", "casadi", "highspy", "numba", "pydantic", "PyYAML")
"""Packages whose versions a run records: those that can change its numbers."""


def write_origin(folder: Path, config: Config, arguments: Sequence[str]) -> None:
    """Write the resolved configuration and the provenance of a run.

    Args:
        folder: of the run.
        config: of the run.
        arguments: of the command line.
    """
    text = dump(config)
    write_text(folder / CONFIG, text)
    write_record(folder / PROVENANCE, provenance(config, text, arguments))


def provenance(config: Config, text: str, arguments: Sequence[str]) -> Provenance:
    """Return the data that it takes to repeat a run.

    Args:
        config: the configuration.
        text: the resolved configuration as YAML.
        arguments: arguments of the command.
    """
    return Provenance(
        created=datetime.now(UTC).isoformat(timespec="seconds"),
        arguments=("robustopt", *map(_as_text, arguments)),
        seed=config.seed,
        config_sha256=hashlib.sha256(text.encode()).hexdigest(),
        robot_model=ModelFile(name=config.robot.model, sha256=model_hash(model_file(config))),
        waypoints_sha256=_waypoints_hash(config),
        versions={"python": platform.python_version(), **versions()},
        git=_git(Path(__file__).resolve().parents[2]),
        machine=Machine(
            system=platform.system(), release=platform.release(), architecture=platform.machine(), cpus=os.cpu_count()
        ),
    )


def _as_text(argument: str) -> str:
    """Return an argument as UTF-8, even if the system passed bytes that are no text in its own encoding."""
    return argument.encode("utf-8", "surrogateescape").decode("utf-8", "replace")


def _waypoints_hash(config: Config) -> str | None:
    """Return the SHA-256 of the files of joint waypoints; None if the configuration has none, or one is missing."""
    files = [config.folder / name for name in config.path.joint_files]
    if not files or not all(map(os.path.isfile, files)):
        return None
    hashes = [hashlib.sha256(read_bytes(file)).hexdigest() for file in files]
    return hashes[0] if len(hashes) == 1 else hashlib.sha256("".join(hashes).encode()).hexdigest()


def versions() -> dict[str, str | None]:
    """Return the versions of this package and of those that can change its numbers."""
    return {"robustopt": __version__, **{name: _version(name) for name in PACKAGES}}


def _version(package: str) -> str | None:
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return None


def _git(checkout: Path) -> Checkout | None:
    """Return the commit of the checkout that this package is part of, and whether its files differ from it."""
    top = _git_output(checkout, "rev-parse", "--show-toplevel")
    if top is None or Path(top) != checkout:
        return None
    status = _git_output(checkout, "status", "--porcelain")
    commit = _git_output(checkout, "rev-parse", "HEAD")
    return Checkout(commit=commit, dirty=status != "" if status is not None else None)


def _git_output(folder: Path, *arguments: str) -> str | None:
    try:
        done = subprocess.run(["git", *arguments], cwd=folder, capture_output=True, text=True, timeout=10, check=True)
    except (OSError, subprocess.SubprocessError):
        return None
    return done.stdout.strip()


# Comparing ------------------------------------------------------------------------------------------------


def unchanged_config(folder: Path, overrides: Sequence[str] = ()) -> Config:
    """Return the configuration of a run, once it is clear that the run is still that of its files.

    Args:
        folder: of the run.
        overrides: `key=value`, applied on top of the stored configuration.

    Raises:
        RunFolderError: configuration, robot model or waypoints have changed since the run was begun.
        ConfigError: the configuration cannot be used any more, or an override does not fit.
    """
    origin = read_provenance(folder)
    try:
        text = read_bytes(folder / CONFIG)
    except OSError as error:
        raise RunFolderError(f"{folder / CONFIG}: cannot be read: {error.strerror}") from None
    if hashlib.sha256(text).hexdigest() != origin.config_sha256:
        raise _changed(folder, f"{CONFIG} has")
    config = load_config(folder / CONFIG)
    if model_hash(model_file(config)) != origin.robot_model.sha256:
        raise _changed(folder, f"the model file of {config.robot.model}, or one that it names, has")
    if origin.waypoints_sha256 is not None and _waypoints_hash(config) != origin.waypoints_sha256:
        raise _changed(folder, f"the waypoints {', '.join(config.path.joint_files)} have")
    return load_config(folder / CONFIG, overrides) if overrides else config


def _changed(folder: Path, files_have: str) -> RunFolderError:
    return RunFolderError(f"{folder}: {files_have} changed since the run was begun; expected no change, or a new run")


def require_same_config(folder: Path, stored: Config, given: Config) -> None:
    """Check that a configuration is that of a run.

    Args:
        folder: folder of the run.
        stored: configuration of the run.
        given: the configuration.

    Raises:
        RunFolderError: they differ; the message names every key that differs.
    """
    if dump(given) != dump(stored):
        changes = "; ".join(differences(resolved(stored), resolved(given)))
        raise RunFolderError(
            f"{folder}: was begun with another configuration: {changes}. Expected the same one, or a new run"
        )


def require_same_versions(folder: Path) -> None:
    """Check that a run was begun with the installed versions: results can differ between them, and must not be mixed.

    Args:
        folder: folder of the run.

    Raises:
        RunFolderError: the run was begun with other versions; the message names them.
    """
    before, now = read_provenance(folder).versions, versions()
    changed = [
        f"{name} was {before[name]} and is {now[name]}" for name in now if before.get(name, now[name]) != now[name]
    ]
    if changed:
        raise RunFolderError(
            f"{folder}: was begun with other versions: {'; '.join(changed)}. Expected the same ones, or a new run"
        )


def differences(stored: Any, given: Any, key: str = "") -> list[str]:
    """Return the differences between two resolved configurations, e.g. "seed was 0 and is 1".

    Args:
        stored: the one configuration, or a part of it.
        given: the other configuration, or the same part of it.
        key: key of this part.
    """
    if isinstance(stored, Mapping) and isinstance(given, Mapping):
        names = dict.fromkeys([*stored, *given])
        inner = (differences(stored.get(n), given.get(n), f"{key}.{n}" if key else n) for n in names)
        return [line for lines in inner for line in lines]
    if isinstance(stored, list) and isinstance(given, list) and len(stored) == len(given):
        pairs = enumerate(zip(stored, given, strict=True))
        return [line for i, (old, new) in pairs for line in differences(old, new, f"{key}[{i}]")]
    return [] if stored == given else [f"{key} was {_shown(stored)} and is {_shown(given)}"]


def _shown(value: Any) -> str:
    return "not given" if value is None else shortened(json.dumps(value), 80)
