"""Several hands that hold a tray together: their places, and their shares of its wrench.

Equilibrium does not determine how hands share a wrench. Arms are compliant, so each hand takes its least-squares share,
in which a moment at a hand counts as much as a force at the edge of its pad (our choice). Forces are then shared
evenly, and moments become opposed forces of the hands as far as these have a lever arm. The motion of the tray under
joint errors is dual to this: it is the mean of the motions that the single hands would give it, with the same weights.
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from robustopt.arrays import Array

PAD = 0.03
"""Length by which a moment at a hand is divided to be compared with a force [m]: about half a pad."""


@dataclass(frozen=True, eq=False)
class Hand:
    """One of several hands that hold the tray.

    Attributes:
        name: name of the tool in the configuration.
        body: name of the body of the model.
        point: place of the hand in the carrier frame (3,) [m].
        share: wrench of the hand per wrench on the tray, both about the carrier's origin, carrier axes (6, 6).
    """

    name: str
    body: str
    point: Array
    share: Array


def shares(points: Array) -> Array:
    """Return the share of each hand in a wrench, about the carrier's origin; they sum to the identity.

    Args:
        points: places of the k hands in the carrier frame (k, 3) [m].

    Returns:
        Matrices (k, 6, 6).
    """
    to_origin = np.tile(np.eye(6), (len(points), 1, 1))
    for transform, (x, y, z) in zip(to_origin, points, strict=True):
        transform[3:, :3] = [[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]
    weight = np.r_[np.ones(3), np.full(3, PAD)]
    stacked = np.hstack([transform * weight for transform in to_origin])
    least = (np.linalg.pinv(stacked)).reshape(len(points), 6, 6)
    return np.asarray(to_origin @ (weight[None, :, None] * least))


def tool_frames(model: mujoco.MjModel, qpos: Array, tools: tuple[str, ...]) -> tuple[Array, Array, list[str]]:
    """Return the frames of tools, sites or bodies, in the world, and the names of their bodies.

    Args:
        model: the model.
        qpos: positions of its joints.
        tools: names of the tools.

    Returns:
        Positions (k, 3) [m], rotations (k, 3, 3), and names of bodies.
    """
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_kinematics(model, data)
    sites = {model.site(k).name: k for k in range(model.nsite)}
    position, rotation, bodies = [], [], []
    for tool in tools:
        site = sites.get(tool)
        body = model.body(tool).id if site is None else int(model.site_bodyid[site])
        position.append((data.xpos[body] if site is None else data.site_xpos[site]).copy())
        rotation.append((data.xmat[body] if site is None else data.site_xmat[site]).reshape(3, 3).copy())
        bodies.append(model.body(body).name)
    return np.array(position), np.array(rotation), bodies
