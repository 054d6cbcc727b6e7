"""Robot files as their makers publish them, beside pinocchio, which reads them on its own."""

import numpy as np
import pytest
import robot_files
from robot_files import Joints

from robustopt import build_problem, certify, solve
from robustopt.arrays import Array
from robustopt.config import Config
from robustopt.robot import Robot, load_robot
from robustopt.solvers import Status

QUICK = (
    "allegro_left_hand",
    "human",
    "icub_reduced",
    "romeo_laas_small",
    "simple_humanoid",
    "tiago_no_hand",
    "ur5_robot",
)
"""An impossible inertia in each finger; links without mass; moments of rounding errors; impossible inertias in arms and
legs; a mesh in text; antennas; and a plain arm."""
SAME = 1e-10
"""Largest relative difference to pinocchio."""

STUCK = ("talos_left_arm", "talos_full_v2", "talos_full_v2_box")
"""Files in which the dry friction of the last joint, a gripper, is its whole torque limit: it cannot move."""

pin = pytest.importorskip("pinocchio", reason="needs pin, of the extra `test`")


def every_file() -> list[object]:
    """The names of all files; those that are not quick are marked as slow."""
    names = list(robot_files.files())
    marked = [name if name in QUICK else pytest.param(name, marks=pytest.mark.slow) for name in names]
    return marked or [
        pytest.param("", marks=pytest.mark.skip(reason="needs example-robot-data, of the extra `robots`"))
    ]


def moving(joints: Joints) -> list[str]:
    """All joints that can move on their own; the last one carries the tool, at the end of the longest chain."""
    tool = joints.longest(independent=True)[-1]
    return [*(joint for joint in joints.all if joints.is_independent(joint) and joint != tool), tool]


class Reference:
    """A robot as pinocchio reads it; the locked joints of a configuration do not move."""

    def __init__(self, joints: Joints, config: Config) -> None:
        self.model, self.locked = pin.buildModelFromUrdf(str(joints.file)), config.robot.locked

    def torque(self, names: tuple[str, ...], q: Array, qd: Array, qdd: Array) -> Array:
        model, posture = self.model, pin.neutral(self.model)
        for name, value in [*self.locked.items(), *zip(names, q, strict=True)]:
            joint = model.joints[model.getJointId(name)]
            posture[joint.idx_q : joint.idx_q + joint.nq] = value if joint.nq == 1 else (np.cos(value), np.sin(value))
        order = [model.joints[model.getJointId(name)].idx_v for name in names]
        v, a = np.zeros((2, model.nv))
        v[order], a[order] = qd, qdd
        return pin.rnea(model, model.createData(), posture, v, a)[order]


def require_same_dynamics(robot: Robot, reference: Reference) -> None:
    assert robot.mass == pytest.approx(sum(inertia.mass for inertia in reference.model.inertias), rel=SAME)
    rng = np.random.default_rng(0)
    q, qd, qdd = rng.uniform(-1, 1, (3, 3, robot.n))
    torque, _, _ = robot.inverse_dynamics(q, qd, qdd)
    expected = np.array([reference.torque(robot.joint_names, *row) for row in zip(q, qd, qdd, strict=True)])
    assert np.abs(torque - expected).max() <= SAME * np.abs(expected).max()


def require_same_limits(robot: Robot, reference: Reference, joints: Joints) -> None:
    model, limits = reference.model, robot.limits
    for k, name in enumerate(robot.joint_names):
        joint = model.joints[model.getJointId(name)]
        if joint.nq == 1:
            low, high = model.lowerPositionLimit[joint.idx_q], model.upperPositionLimit[joint.idx_q]
            assert (limits.lower[k], limits.upper[k]) == (low, high)
        else:
            assert (limits.lower[k], limits.upper[k]) == (-np.inf, np.inf)
        if joints.limit(name, "velocity") > 0:
            assert limits.velocity[k] == model.upperVelocityLimit[joint.idx_v]
        if joints.limit(name, "effort") > 0:
            assert limits.torque[k] == model.upperEffortLimit[joint.idx_v]


@pytest.mark.parametrize("name", every_file())
def test_a_published_file_loads_and_has_the_numbers_of_pinocchio(name: str) -> None:
    joints = robot_files.files()[name]
    config = joints.config(moving(joints))
    robot, reference = load_robot(config), Reference(joints, config)
    require_same_dynamics(robot, reference)
    require_same_limits(robot, reference, joints)


def test_there_are_47_published_files() -> None:
    if robot_files.folder() is None:
        pytest.skip("needs example-robot-data, of the extra `robots`")
    assert len(robot_files.files()) == 47


@pytest.mark.parametrize("name", every_file())
def test_a_published_robot_carries_a_box_on_a_level_tray(name: str) -> None:
    """44 of the 47 plan and are certified."""
    config = robot_files.tray_task(robot_files.files()[name])
    assert config is not None, "no posture can be held"
    plan = solve(build_problem(config))
    assert plan.status is (Status.INFEASIBLE if name in STUCK else Status.SOLVED)
    assert name in STUCK or certify(plan).passed
