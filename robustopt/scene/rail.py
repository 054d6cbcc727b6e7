"""The rail on which a hand of a walking robot rests."""

from __future__ import annotations

import numpy as np

from robustopt.arrays import Array
from robustopt.config.path_model import RailConfig
from robustopt.geometry import contact_axes

RAIL_EDGE, RAIL_HEIGHT = 0.01, 0.02
"""Width of a rail beyond the palm on each side, and its height [m] (our choice)."""


def rail_box(rail: RailConfig) -> tuple[Array, Array, Array]:
    """Return a rail as a box.

    Args:
        rail: the rail.

    Returns:
        Centre (3,) [m], axes as columns (3, 3), and half the edge lengths (3,) [m], all in the world.
    """
    axes = contact_axes(rail.normal, rail.along)
    half = 0.5 * np.array([rail.length, rail.size[1] + 2.0 * RAIL_EDGE, RAIL_HEIGHT])
    return np.array(rail.at) - half[2] * axes[:, 2], axes, half
