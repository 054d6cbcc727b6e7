"""Settings of MuJoCo under which contacts follow Coulomb's law.

Every contact that a plan counts on is a pair with its own friction, because MuJoCo gives a contact of two shapes the
larger of their frictions. With elliptic cones and contacts as stiff as the time step allows, objects slip, tip and lose
their grip within 1 % of the closed forms and creep less than 0.1 mm/s (tests/test_fidelity.py, tests/test_holding.py).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import mujoco
import numpy as np

from robustopt.arrays import Array
from robustopt.robot.model_file import USUAL
from robustopt.simulation.parameters import BodyParameters

PREFIX = "robustopt_"
"""Prefix of the names of added parts, so that they differ from the names in the robot's file."""

SOLREF_STEPS = 2.0
"""Time constant of a contact in time steps: the smallest that MuJoCo considers stable. A contact drifts in proportion
to it while its support accelerates on a curved path."""

SOLIMP = (0.95, 0.95, 0.001, 0.5, 2.0)
"""Impedance of a contact: it chatters with values nearer to 1, and peels and twists too early with smaller values."""

HOLDING_RATIO = 100.0
"""Ratio of frictional to normal impedance if cups or pads hold a part: at 10 it creeps ten times faster."""


@dataclass(frozen=True)
class Physics:
    """Settings of the simulation that differ between kinds of robots.

    Attributes:
        integrator: MuJoCo's integrator.
        impedance_ratio: stiffness of friction relative to that in the normal direction; a large one prevents creep.
        iterations: largest number of iterations of the contact solver.
        tolerance: tolerance of the contact solver.
        compensated: fraction of the robot's weight that the controller compensates; without it, the weight is part of
            the torque that the controller adds.
        servos: types of the actuators of a model file whose gains count.
    """

    integrator: mujoco.mjtIntegrator
    impedance_ratio: float
    iterations: int
    tolerance: float
    compensated: float
    servos: frozenset[int]


PID, POSITION = int(mujoco.mjtDyn.mjDYN_PID), int(mujoco.mjtDyn.mjDYN_NONE)
ARM = Physics(mujoco.mjtIntegrator.mjINT_EULER, 10.0, 100, 1e-10, 1.0, frozenset({PID}))
WALKING = Physics(mujoco.mjtIntegrator.mjINT_IMPLICITFAST, 20.0, 50, 1e-8, 0.0, frozenset({PID, POSITION}))
"""The planned torque of a walking robot contains its weight; compensation would hold it up from outside."""


def physics_of(base: int, holds: bool) -> Physics:
    """Return the settings for a robot.

    Args:
        base: number of base coordinates, 0 for an arm.
        holds: whether cups or pads hold a part.
    """
    found = WALKING if base else ARM
    return replace(found, impedance_ratio=HOLDING_RATIO) if holds else found


def set_options(spec: mujoco.MjSpec, physics: Physics, timestep: float) -> None:
    """Set integrator and contact solver.

    Args:
        spec: specification of the world, which is changed.
        physics: the settings.
        timestep: time step [s].
    """
    option = spec.option
    option.timestep, option.integrator = timestep, physics.integrator
    option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    option.solver = mujoco.mjtSolver.mjSOL_NEWTON
    option.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
    option.impratio = physics.impedance_ratio
    option.tolerance, option.iterations, option.noslip_iterations = physics.tolerance, physics.iterations, 0
    option.disableflags, option.enableflags = int(mujoco.mjtDisableBit.mjDSBL_AUTORESET), 0


def add_contact(spec: mujoco.MjSpec, first: str, second: str, friction: float) -> None:
    """Let two shapes touch with a coefficient of friction of their own.

    Args:
        spec: specification of the world, which is changed.
        first: name of the one shape.
        second: name of the other shape.
        friction: coefficient of friction.
    """
    spec.add_pair(
        USUAL.default, geomname1=first, geomname2=second, condim=3, friction=[friction, friction, 0.0, 0.0, 0.0],
        solref=[SOLREF_STEPS * spec.option.timestep, 1.0], solimp=SOLIMP,
    )  # fmt: skip


def set_inertia(body: mujoco.MjsBody, parameters: BodyParameters) -> None:
    """Give a body its mass, centre of mass and inertia.

    Args:
        body: the body, which is changed.
        parameters: its inertial parameters.
    """
    body.explicitinertial = True
    body.mass, body.ipos = parameters.mass, parameters.center_of_mass
    i = parameters.inertia
    body.fullinertia = [i[0, 0], i[1, 1], i[2, 2], i[0, 1], i[0, 2], i[1, 2]]


def quaternion(axes: Array) -> Array:
    """Return the orientation of a frame as a quaternion (4,).

    Args:
        axes: axes of the frame as columns (3, 3).
    """
    found = np.zeros(4)
    mujoco.mju_mat2Quat(found, np.ascontiguousarray(axes).ravel())
    return found
