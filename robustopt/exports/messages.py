"""Trajectories in the shape of ROS messages."""

from __future__ import annotations

from typing import Any

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
