"""Inertias of links as a file gives them, and those that MuJoCo takes in their place.

MuJoCo compiles no body whose inertia is impossible, and no moving body without mass. A model is compiled with the
nearest possible inertia, which simulations use; plans use the inertia as written.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import NamedTuple

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from robustopt.arrays import Array
from robustopt.errors import ConfigProblem, RobotError

LEAST_MASS = 1e-6
"""Smallest mass of a link in simulation [kg] (our choice)."""
LEAST_MOMENT = 1e-9
"""Smallest part of a moment of inertia in simulation, and one that is nothing in a plan [kg m^2]: a gram at a
millimetre (our choice)."""
NO_MOMENT = 1e-12
"""Moment of inertia in place of none in a plan [kg m^2]: MuJoCo warns of joints that move nothing (our choice)."""
ROUNDING = 1e-9
"""Relative error of an inertia that counts as rounding (our choice)."""
MOST_EXCESS = 1.5
"""Largest ratio of a moment of inertia to the sum of the other two in a plan. No body has more than 1; errors of
identification and of tools stay below, as in published robots, and a digit in the wrong place goes beyond (our
choice)."""


class Inertia(NamedTuple):
    """The inertia of a link.

    Attributes:
        mass: mass [kg].
        com: centre of mass, frame of the link (3,) [m].
        about_com: inertia about it, axes of the link (3, 3) [kg m^2].
    """

    mass: float
    com: Array
    about_com: Array


NONE = Inertia(0.0, np.zeros(3), np.zeros((3, 3)))
"""The inertia of a frame without mass."""


def is_usable(inertia: Inertia, moves: bool) -> bool:
    """Return whether MuJoCo takes an inertia.

    Args:
        inertia: the inertia.
        moves: whether the link has a joint of its own.
    """
    if not moves and not inertia.about_com.any():
        return True
    low, middle, high = np.linalg.eigvalsh(inertia.about_com)
    heavy = not moves or inertia.mass >= LEAST_MASS * ROUNDING
    return bool(heavy and low > max(ROUNDING * high, LEAST_MOMENT**2) and low + middle > high * (1 + ROUNDING))


def nearest_possible(inertia: Inertia) -> Inertia:
    """Return the nearest inertia that MuJoCo takes: the second moments of mass along its axes become positive.

    Args:
        inertia: the inertia.
    """
    moments, axes = np.linalg.eigh(inertia.about_com)
    second = np.maximum(0.5 * moments.sum() - moments, LEAST_MOMENT)
    about_com = axes @ np.diag(second.sum() - second) @ axes.T
    return Inertia(max(inertia.mass, LEAST_MASS), inertia.com, about_com)


def in_words(inertia: Inertia) -> str:
    """Return mass and principal moments, such as `0.1 kg and 0.2, 0.3, 0.4 kg m^2`.

    Args:
        inertia: the inertia.
    """
    moments = ", ".join(f"{moment:.3g}" for moment in np.linalg.eigvalsh(inertia.about_com))
    return f"{inertia.mass:.3g} kg and {moments} kg m^2"


def restore(model: mujoco.MjModel, written: Mapping[str, Inertia]) -> None:
    """Give bodies of a compiled model their inertias as written.

    Args:
        model: the model, which is changed.
        written: the inertias, by name of the body.
    """
    for name, inertia in written.items():
        body = model.body(name).id
        moments, axes = np.linalg.eigh(inertia.about_com)
        moments = np.where(np.abs(moments) < NO_MOMENT, NO_MOMENT, moments)
        axes[:, 2] = np.cross(axes[:, 0], axes[:, 1])
        model.body_mass[body], model.body_ipos[body], model.body_inertia[body] = inertia.mass, inertia.com, moments
        model.body_iquat[body] = Rotation.from_matrix(axes).as_quat(scalar_first=True)
    if written:  # and what the compiler has derived from the others
        model.body_sameframe[:] = model.body_simple[:] = model.dof_simplenum[:] = 0
        model.body_subtreemass[:] = model.body_mass
        for body in range(model.nbody - 1, 0, -1):
            model.body_subtreemass[model.body_parentid[body]] += model.body_subtreemass[body]


def require_possible(model: mujoco.MjModel, written: Collection[str], sites: Collection[str], file: str) -> None:
    """Check the inertia of each link, with all that is fixed to it, of the chains that carry some sites.

    Args:
        model: the compiled model, with inertias as written.
        written: names of the bodies whose inertia MuJoCo does not take.
        sites: names of the sites.
        file: the model file, for messages.

    Raises:
        RobotError: an inertia is impossible; the error names link, numbers and remedy.
    """
    if not written:
        return
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    carrying = _carrying(model, sites)
    problems = []
    for group in sorted({int(model.body_weldid[model.body(name).id]) for name in written} & carrying):
        bodies = np.flatnonzero(model.body_weldid == group)
        inertia = _together(model, data, bodies)
        low, middle, high = np.linalg.eigvalsh(inertia.about_com)
        has_no_mass = inertia.mass <= 0 and high > LEAST_MOMENT
        if has_no_mass or low < -LEAST_MOMENT or high > MOST_EXCESS * (low + middle) + LEAST_MOMENT:
            names = [model.body(body).name for body in bodies if model.body(body).name in written]
            joint = model.joint(model.body_jntadr[group]).name
            problems.append(
                ConfigProblem(
                    "robot.model",
                    f"{file}: link {', '.join(names)}: no body has its mass and principal moments of inertia, with "
                    f"all that is fixed to it {in_words(inertia)}; expected a mass above 0, no negative moment, and "
                    f"none above the sum of the other two: correct its <inertial>, or lock joint {joint} "
                    f"(robot.locked: {{{joint}: ...}})",
                )
            )
    if problems:
        raise RobotError(problems)


def _carrying(model: mujoco.MjModel, sites: Collection[str]) -> set[int]:
    """Return the moving bodies that carry some sites, each the first of all that are fixed to one another."""
    found: set[int] = set()
    for site in sites:
        body = int(model.site_bodyid[model.site(site).id])
        while body:
            found.add(int(model.body_weldid[body]))
            body = int(model.body_parentid[body])
    return found - {0}


def _together(model: mujoco.MjModel, data: mujoco.MjData, bodies: Collection[int]) -> Inertia:
    """Return the inertia of several bodies, world axes, as if they were one."""
    masses = model.body_mass[bodies]
    total = float(masses.sum())
    center = masses @ data.xipos[bodies] / total if total > 0 else np.zeros(3)
    about = np.zeros((3, 3))
    for body, mass in zip(bodies, masses, strict=True):
        axes, arm = data.ximat[body].reshape(3, 3), data.xipos[body] - center
        about += axes @ np.diag(model.body_inertia[body]) @ axes.T + mass * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    return Inertia(total, center, about)
