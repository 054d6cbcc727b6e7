"""Checks of the path of a configuration."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise

import numpy as np

from robustopt.config.document import Finding, Key, show_key
from robustopt.config.model import Config
from robustopt.config.path_model import FramePose, PathConfig
from robustopt.geometry import RESOLUTION

MOST_POSES, MOST_STEPS = 1000, 200
"""Largest numbers of poses and of steps of a path: with more, it takes minutes to build (our choice)."""


def check_path(config: Config) -> Iterator[Finding]:
    """Yield the mistakes in the path.

    Args:
        config: the configuration.
    """
    path = config.path
    kinds = ("tray_poses", "tool_poses", "joints", "steps")
    given = [name for name in kinds if getattr(path, name) is not None]
    if len(given) != 1:
        found = f"{'both' if len(given) == 2 else 'all'} of {' and '.join(given)}" if given else "none of them"
        yield ("path",), f"found {found}; expected exactly one of {', '.join(kinds[:-1])} and {kinds[-1]}"
        return
    if path.poses is not None:
        key: Key = ("path", path.poses_key)
        for i, pose in enumerate(path.poses):
            yield from _orientation((*key, i), pose)
        yield from _waypoints(key, [_pose_numbers(pose) for pose in path.poses])
        if len(path.poses) > MOST_POSES:
            yield key, f"found {len(path.poses):,} poses; expected at most {MOST_POSES:,}"
    elif path.steps is not None and len(path.steps) > MOST_STEPS:
        yield ("path", "steps"), f"found {len(path.steps):,} steps; expected at most {MOST_STEPS:,}"
    elif path.joints is not None:
        yield from _joints(path)
    if path.joints is None:
        for name in ("unit", "repeated", "start_speed", "end_speed"):
            if getattr(path, name) != PathConfig.model_fields[name].default:
                stops = ", at whose ends the robot stops" if name.endswith("speed") else ""
                yield ("path", name), f"not allowed with {given[0]}{stops}; expected it with joints only"
    yield from _pauses(path, given[0])


def _pauses(path: PathConfig, kind: str) -> Iterator[Finding]:
    """Yield pauses that are not at an inner waypoint, or at the same one as another."""
    if path.pauses and path.steps is not None:
        yield ("path", "pauses"), "not allowed with steps; expected them with joints or poses only"
        return
    waypoints = None if path.joint_files else len(path.poses or path.joint_rows)
    seen: set[int] = set()
    for i, pause in enumerate(path.pauses):
        key = ("path", "pauses", i, "waypoint")
        if waypoints is not None and pause.waypoint >= waypoints - 1:
            yield key, f"found {pause.waypoint}; expected a number from 1 to {waypoints - 2}: an inner waypoint"
        elif pause.waypoint in seen:
            yield key, f"found {kind}[{pause.waypoint}] again; expected one pause at it"
        seen.add(pause.waypoint)


def _joints(path: PathConfig) -> Iterator[Finding]:
    if path.joint_files and path.joint_rows:
        yield ("path", "joints"), "found names of files among waypoints; expected either files or waypoints"
    elif not path.joint_files:
        yield from _waypoints(("path", "joints"), path.joint_rows, repeats=path.repeated == "stop")


def _waypoints(key: Key, waypoints: Sequence[Sequence[float]], repeats: bool = False) -> Iterator[Finding]:
    """Yield mistakes in a list of waypoints, in which one may follow itself if `repeats`."""
    name = show_key(key)
    if len(waypoints) < 2:
        yield key, f"found {len(waypoints)} waypoint{'' if len(waypoints) == 1 else 's'}; expected at least two"
    for i, (first, second) in enumerate(pairwise(waypoints)):
        if len(first) != len(second):
            yield (*key, i + 1), f"found {len(second)} joint positions; expected {len(first)} as in {name}[{i}]"
        elif not repeats and max((abs(a - b) for a, b in zip(first, second, strict=True)), default=0.0) <= RESOLUTION:
            yield (*key, i + 1), f"found the same waypoint as {name}[{i}]; expected it once"


def _orientation(key: Key, pose: FramePose) -> Iterator[Finding]:
    given = [name for name in ("rpy", "yaw", "quaternion") if getattr(pose, name) is not None]
    if len(given) > 1:
        yield key, f"found {' and '.join(given)}; expected at most one of rpy, yaw and quaternion"
    if pose.quaternion is not None and np.linalg.norm(pose.quaternion) < 1e-6:
        message = f"found {list(pose.quaternion)}, which has no direction; expected w, x, y, z, not all zero"
        yield (*key, "quaternion"), message


def _pose_numbers(pose: FramePose) -> tuple[float, ...]:
    rpy = pose.rpy or (0.0, 0.0, pose.yaw or 0.0)
    return (*pose.position, *rpy, *(pose.quaternion or (1.0, 0.0, 0.0, 0.0)))
