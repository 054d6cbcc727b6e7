"""Check that the faces on which objects stand point up where the robot rests.

A contact with friction only presses. At rest it must carry the weight, a force along the vertical, so the outward
normal of its face must have a part that points up: at 90 degrees or more no friction holds an object. Below that, the
limits of the plan decide.
"""

from __future__ import annotations

import numpy as np

from robustopt.config import Config
from robustopt.errors import ConfigProblem, PathError
from robustopt.path.path import Path
from robustopt.robot import Robot
from robustopt.scene.placement import TRAY, placements

LEVEL = 1e-6
"""Upward part of a normal that counts as none: rounding errors of an angle of 90 degrees."""


def require_upright(config: Config, robot: Robot, path: Path) -> None:
    """Check the face under each standing object at the start of the path and at its stops.

    Args:
        config: the configuration.
        robot: the robot.
        path: the path.

    Raises:
        PathError: a face points sideways or down.
    """
    if not robot.has_carrier or not np.any(config.gravity):
        return
    roots = {
        placement.root: (placement.frame.rotation[:, 2], name)
        for name, placement in reversed(placements(config).items())
        if config.objects[name].held_by is None
    }
    _, rotations = robot.carrier_pose(path(path.breaks))
    problems = []
    for root, (normal, name) in roots.items():
        upward = rotations @ normal @ robot.up
        wrong = np.flatnonzero(upward <= LEVEL)
        if len(wrong):
            angle = np.degrees(np.arccos(np.clip(upward[wrong[0]], -1.0, 1.0)))
            place = path.label(float(path.breaks[wrong[0]]))
            own = "tray.pose.rpy" if root == TRAY else f"objects.{root}.held_by"
            of_path = f"path.{config.path.poses_key}" if config.path.poses is not None else None
            problems.append(
                ConfigProblem(
                    of_path or own,
                    f"{place}: the face of {root} that carries {name} points {angle:.4g} degrees away from up, and "
                    f"{name} would fall off; expected less than 90 degrees: change {own}, or the poses or joints of "
                    "the path",
                )
            )
    if problems:
        raise PathError(problems)
