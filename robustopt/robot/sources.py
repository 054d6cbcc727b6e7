"""The files of the robots of other packages, by name.

Packages are searched without importing them. Their robots are called `SOURCE:NAME`, such as `example-robot-data:panda`.
"""

from __future__ import annotations

import difflib
import os
import site
import sys
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path

from robustopt.config import ROBOT_SOURCES
from robustopt.config.document import shortened
from robustopt.errors import RobotError
from robustopt.robot.joint_count import included_in

MENAGERIE_ROOT = "MENAGERIE_ROOT"
"""Environment variable with the folder of MuJoCo Menagerie, as its own package uses it."""

REMEDIES = {
    "example-robot-data": "pip install example-robot-data",
    "menagerie": f"set {MENAGERIE_ROOT} to a clone of https://github.com/google-deepmind/mujoco_menagerie",
    "robosuite": "pip install robosuite",
    "dm_control": "pip install dm_control",
}
"""Ways to get the robots of a source."""

MOST_NEAR, LEAST_NEAR = 5, 0.4
"""Largest number of similar names that an error lists, and their least similarity from 0 to 1 (our choice)."""


def share_folders() -> tuple[Path, ...]:
    """Return the folders in which `package://NAME/...` is looked up as `NAME/...`.

    ROS and pip packages install robot descriptions there: the folders of the environment variables ROS_PACKAGE_PATH,
    AMENT_PREFIX_PATH and CMAKE_PREFIX_PATH, then the share folders of this Python.
    """
    folders = [Path(entry) for entry in os.environ.get("ROS_PACKAGE_PATH", "").split(os.pathsep) if entry]
    for variable in ("AMENT_PREFIX_PATH", "CMAKE_PREFIX_PATH"):
        folders += [Path(entry) / "share" for entry in os.environ.get(variable, "").split(os.pathsep) if entry]
    for packages in [*site.getsitepackages(), site.getusersitepackages()]:
        folders.append(Path(packages) / "cmeel.prefix" / "share")
    return (*folders, Path(sys.prefix) / "share")


def resolve_package(uri: str) -> Path | None:
    """Return the file of a package URI, or None if no share folder has it.

    Args:
        uri: the URI, `package://NAME/...`.
    """
    relative = uri.removeprefix("package://")
    return next((folder / relative for folder in share_folders() if os.path.isfile(folder / relative)), None)


def robots_of(source: str) -> dict[str, Path]:
    """Return the model files of a source by name of the robot; {} if the source is not there.

    Args:
        source: the source, one of `SOURCES`.
    """
    return SOURCES[source]()


def source_file(source: str, name: str) -> Path:
    """Return the model file of a robot of a source.

    Args:
        source: the source, one of `SOURCES`.
        name: name of the robot there.

    Raises:
        RobotError: the source is not there, or has no such robot.
    """
    robots = robots_of(source)
    if not robots:
        raise RobotError(f"no robots of {source} were found; {REMEDIES[source]}", key="robot.model")
    if name not in robots:
        near = [known for known in robots if name and name.lower() in known.lower()]
        near += [known for known in difflib.get_close_matches(name, robots, MOST_NEAR, LEAST_NEAR) if known not in near]
        similar = f"similar ones: {', '.join(near[:MOST_NEAR])}; " if near else ""
        message = f"{source} has no robot {shortened(repr(name))}; {similar}`robustopt robots` lists all"
        raise RobotError(message, key="robot.model")
    return robots[name]


def _example_robot_data() -> dict[str, Path]:
    folders = [folder / "example-robot-data" / "robots" for folder in share_folders()]
    return next((_by_stem(folder, "*.urdf") for folder in folders if folder.is_dir()), {})


def _menagerie() -> dict[str, Path]:
    """Return the models of Menagerie: a folder each, whose scene includes its model, and `FOLDER/MODEL` for others."""
    root = os.environ.get(MENAGERIE_ROOT)
    found: dict[str, Path] = {}
    for folder in sorted(path for path in Path(root).glob("*") if path.is_dir()) if root else ():
        files = sorted(folder.glob("*.xml"))
        scenes = [file for file in files if file.stem.startswith("scene")]
        models = [file for file in files if file not in scenes]
        if not models:
            continue
        included = [folder / name for scene in scenes for name in included_in(scene)]
        default = next((file for file in included if file in models), models[0])
        found[folder.name] = default
        found |= {f"{folder.name}/{file.stem}": file for file in files if file != default}
    return found


def _robosuite() -> dict[str, Path]:
    folders = [folder / "models" / "assets" / "robots" for folder in _package("robosuite")]
    return {file.parent.name: file for folder in folders for file in sorted(folder.glob("*/robot.xml"))}


def _dm_control() -> dict[str, Path]:
    return next((_by_stem(folder, "*.xml") for folder in _package("dm_control")), {})


def _package(name: str) -> Iterator[Path]:
    """Yield the folders of an installed package, without importing it."""
    spec = find_spec(name)
    yield from map(Path, (spec and spec.submodule_search_locations) or ())


def _by_stem(folder: Path, pattern: str) -> dict[str, Path]:
    """Return files by their stem, or by folder and stem if several have the same; those for tests are left out."""
    found = ((file, file.relative_to(folder).parts) for file in sorted(folder.rglob(pattern)))
    files = [file for file, parts in found if not any(part.startswith("test") for part in parts)]
    stems = [file.stem for file in files]
    return {
        file.stem if stems.count(file.stem) == 1 else file.relative_to(folder).with_suffix("").as_posix(): file
        for file in files
    }


SOURCES = dict(zip(ROBOT_SOURCES, (_example_robot_data, _menagerie, _robosuite, _dm_control), strict=True))
"""Functions that find the robots of each source."""
