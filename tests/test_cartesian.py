"""Cartesian limits: closed forms of a line and an arc, sampled norms, certificate, diagnosis, mistakes."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scenes import CONFIGS, FIXTURES, plan_of, scene, waiter

import robustopt as ro
from robustopt.certificate import certify
from robustopt.config import Config
from robustopt.config.load import with_values
from robustopt.plotting.cartesian import cartesian_figure
from robustopt.plotting.style import house_style
from robustopt.robot import Robot
from robustopt.solvers import Plan, Status, build_problem
from robustopt.solvers.diagnosis import diagnose
from robustopt.solvers.trajectory import Trajectory, binding_shares

SAMPLES = 100_000
REACHED = 1e-3
SPEED, ACCELERATION = "tool Cartesian speed", "tool Cartesian acceleration"

LOOSE = {"velocity": 100.0, "acceleration": 1e4, "torque": 1e6}


def along_line(speed: float, acceleration: float, method: str = "reachability") -> Plan:
    """The tool of an arm moves on a straight line of 0.5 m; its joints are fast."""
    poses = [{"position": [0.75, y, 0.65], "yaw": 0.0} for y in (-0.25, 0.25)]
    limits = {"all": LOOSE}
    config = waiter("one_block", f"solver.method={method}", "solver.collocation_points=200")
    return plan_of(
        with_values(
            config,
            {
                "robot.limits": limits,
                "robot.cartesian_limits": {"tool": {"speed": speed, "acceleration": acceleration}},
                "path": {"tray_poses": poses},
                "objects": {},
                "contact": {"friction": 0.5},
                "uncertainty": {},
                "execution": None,
                "learning": None,
            },
        )
    )


def on_turntable(length: float = 6.0, **limits: float) -> Config:
    """A tool turns about the vertical axis of a turntable."""
    keys = {"limits": {"all": LOOSE}, "cartesian_limits": {"tool": limits}}
    return scene("turntable", length=length, robot_keys=keys, solver={"collocation_points": 300})
