"""The URDF files of the package example-robot-data, and configurations for them."""

import xml.etree.ElementTree as ET
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from robustopt.arrays import Array
from robustopt.config import Config
from robustopt.robot import Robot, load_robot
from robustopt.robot.model_file import share_folders

LEAST_JOINTS = 4
LIMITS = ("velocity", "effort")


@cache
def folder() -> Path | None:
    """The folder of the package, or None."""
    found = (share / "example-robot-data" / "robots" for share in share_folders())
    return next((place for place in found if place.is_dir()), None)


class Joints:
    """The joints of a URDF file."""

    def __init__(self, file: Path) -> None:
        self.file = file
        root = ET.parse(file).getroot()
        self.all = {joint.get("name", ""): joint for joint in root.findall("joint")}
        self.above = {self.link(name, "child"): name for name in self.all}
        self.links = [link.get("name", "") for link in root.findall("link")]

    def link(self, joint: str, role: str) -> str:
        element = self.all[joint].find(role)
        assert element is not None
        return element.get("link", "")

    def moves(self, joint: str) -> bool:
        return self.all[joint].get("type") in ("revolute", "continuous", "prismatic")

    def limit(self, joint: str, attribute: str) -> float:
        element = self.all[joint].find("limit")
        return 0.0 if element is None else float(element.get(attribute, "0"))

    def has_room(self, joint: str) -> bool:
        ranged = self.all[joint].get("type") != "continuous"
        return not ranged or self.limit(joint, "lower") < self.limit(joint, "upper")

    def chain(self, link: str) -> list[str]:
        """The joints between the base and a link, the first one first."""
        found = []
        while link in self.above:
            found.insert(0, self.above[link])
            link = self.link(found[0], "parent")
        return [joint for joint in found if self.moves(joint)]

    def longest(self, independent: bool = False) -> list[str]:
        """The longest chain; independent: of joints that have room and mimic no other."""
        kept = [[j for j in self.chain(link) if not independent or self.is_independent(j)] for link in self.links]
        return max(kept, key=len, default=[])

    def is_independent(self, joint: str) -> bool:
        return self.moves(joint) and self.has_room(joint) and self.all[joint].find("mimic") is None

    def config(self, moving: list[str], **keys: Any) -> Config:
        """A configuration that moves some joints and locks all others at the middle of their ranges, or at 0."""
        missing = {"velocity": 1.0, "effort": 1000.0}
        limits: dict[str, dict[str, Any]] = {"all": {"acceleration": 10.0}}
        for joint in moving:
            for kind in LIMITS:
                if self.limit(joint, kind) <= 0:
                    limits.setdefault(joint, {})[{"effort": "torque"}.get(kind, kind)] = missing[kind]
        locked = {joint: self.rest(joint) for joint in self.all if self.moves(joint) and joint not in moving}
        robot = {"model": str(self.file), "tool": self.link(moving[-1], "child"), "limits": limits, "locked": locked}
        robot |= {"collision": {"check": False}} | keys.pop("robot", {})
        given = {
            "name": self.file.stem, "robot": robot, "folder": Path(),
            "path": {"joints": (tuple(self.rest(joint) for joint in moving),) * 2},
        }  # fmt: skip
        return Config.model_validate(given | keys)

    def rest(self, joint: str) -> float:
        low, high = self.limit(joint, "lower"), self.limit(joint, "upper")
        if self.all[joint].get("type") == "continuous" or low <= 0.0 <= high:
            return 0.0
        return 0.5 * (low + high)


@cache
def files() -> dict[str, Joints]:
    """The files with a chain of at least four joints, by name."""
    place = folder()
    found = {} if place is None else {file.stem: Joints(file) for file in sorted(place.rglob("*.urdf"))}
    return {name: joints for name, joints in found.items() if len(joints.longest()) >= LEAST_JOINTS}


REACH = 0.3
"""Sum of the motions of all joints to either side of the middle of the path [rad or m]."""
LOAD = 0.3
"""Mass of the tray and the box [kg]."""
MARGIN = 0.9
"""Part of the torque limits that standing still may take."""
POSTURES = 300
"""Number of postures that are tried."""


def tray_task(joints: Joints) -> Config | None:
    """A short joint path with a tray that is level in its middle, and a box on it; None if no posture can be held."""
    moving = joints.longest(independent=True)
    robot = load_robot(joints.config(moving))
    low, high = np.clip(robot.limits.lower, -np.pi, np.pi), np.clip(robot.limits.upper, -np.pi, np.pi)
    step = np.minimum(REACH / robot.n, 0.2 * (high - low))
    rng = np.random.default_rng(0)
    for k in range(POSTURES):
        part = 0.5 if k == 0 else rng.uniform(0.25, 0.75, robot.n)
        middle = low + part * (high - low)
        path = middle + np.array([[-1.0], [1.0]]) * step
        if not _stands(robot, np.linspace(*path, 5)):
            continue
        axes = Rotation.from_matrix(robot.carrier_jacobians(middle[None])[1][0]).inv()
        pose = {"position": axes.apply([0.0, 0.0, 0.05]).tolist(), "rpy": axes.as_euler("xyz").tolist()}
        return joints.config(
            moving,
            tray={"size": (0.2, 0.2, 0.01), "mass": 0.1, "pose": pose},
            objects={"box": {"shape": "box", "size": (0.1, 0.1, 0.04), "mass": 0.2}},
            contact={"friction": 0.6},
            path={"joints": path.tolist()},
            solver={"method": "reachability", "collocation_points": 60},
        )
    return None


def _stands(robot: Robot, q: Array) -> bool:
    """Whether the joints can hold the robot and a load at its tool at some postures."""
    still = np.zeros_like(q)
    torque, _, _ = robot.inverse_dynamics(q, still, still)
    load = robot.carrier_jacobians(q)[2][:, 2] * LOAD * 9.81
    return bool((np.abs(torque + load) <= MARGIN * robot.limits.torque).all())
