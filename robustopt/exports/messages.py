"""Trajectories in the shape of ROS messages."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import yaml

from robustopt.errors import ConfigError
from robustopt.files import write_text
from robustopt.solvers.trajectory import Samples


def joint_trajectory(samples: Samples, joint_names: tuple[str, ...]) -> dict[str, Any]:
    """Return samples in the shape of a ROS `trajectory_msgs/JointTrajectory` message.

    Times are rounded to whole nanoseconds. All values are plain Python numbers, ready for `json.dump`.

    Args:
        samples: the samples.
        joint_names: names of the joints.
    """
    points = zip(samples.t.tolist(), samples.q.tolist(), samples.qd.tolist(), samples.qdd.tolist(), strict=True)
    return {
        "header": _header(),
        "joint_names": list(joint_names),
        "points": [
            {"positions": q, "velocities": qd, "accelerations": qdd, "time_from_start": _ros_duration(t)}
            for t, q, qd, qdd in points
        ],
    }


def _header() -> dict[str, Any]:
    return {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": ""}


def _ros_duration(t: float) -> dict[str, int]:
    sec, nanosec = divmod(round(t * 1e9), 1_000_000_000)
    return {"sec": sec, "nanosec": nanosec}


def robot_trajectory(samples: Samples, joint_names: tuple[str, ...]) -> dict[str, Any]:
    """Return samples in the shape of a MoveIt `moveit_msgs/RobotTrajectory` message; see `joint_trajectory`.

    Args:
        samples: the samples.
        joint_names: names of the joints.
    """
    floating = {"header": _header(), "joint_names": [], "points": []}
    return {"joint_trajectory": joint_trajectory(samples, joint_names), "multi_dof_joint_trajectory": floating}


def write_message(message: dict[str, Any], path: Path) -> None:
    """Write a message as JSON or YAML, which the suffix of the file tells.

    Args:
        message: the message.
        path: name of the file, which ends in .json, .yaml or .yml.

    Raises:
        ConfigError: the suffix is another one.
    """
    suffix = path.suffix.lower()
    if suffix == ".json":
        text = json.dumps(message, allow_nan=False) + "\n"
    elif suffix in (".yaml", ".yml"):
        dumper = getattr(yaml, "CSafeDumper", yaml.SafeDumper)  # the one in C is not part of every build
        text = yaml.dump(message, Dumper=dumper, sort_keys=False, default_flow_style=None, width=2**20)
    else:
        raise ConfigError(f"found the suffix {suffix!r}; expected .json, .yaml or .yml for a message", key="out")
    write_text(path, text)
