"""Several hands that hold a tray: one contact system each, for its share of the wrench of everything on the tray.

Each hand presses the tray between a thumb on top and fingers below, like a gripper. The shares are fixed (see
`robot.hands`), so every hand has explicit rows; one feasible sharing proves that a sharing exists. A mismatch of the
hands' positions causes an internal force between them, which uses up friction. It acts at the centre of the pads,
across their normals, so the largest one, S, costs each hand as much as a closing force that is smaller by S / (2 mu).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from robustopt.arrays import Array
from robustopt.config import Config
from robustopt.config.object_model import HandsConfig, pad_names
from robustopt.errors import RobotError
from robustopt.geometry import RESOLUTION, contact_axes, rectangle
from robustopt.limits.laws import links
from robustopt.limits.systems import ContactSystem, coarse_edges, system_of
from robustopt.robot.hands import Hand
from robustopt.scene.patches import Law, Patch
from robustopt.scene.placement import TRAY


def hand_patches(config: Config, hands: Sequence[Hand]) -> tuple[Patch, ...]:
    """Return the patches of the hands that hold a tray: for each hand the thumb on top, then the fingers below.

    Args:
        config: the configuration.
        hands: the hands of the robot.

    Raises:
        RobotError: a pad reaches beyond the tray.
    """
    tray = config.tray
    if tray is None or tray.hands is None:
        return ()
    found: list[Patch] = []
    for hand in hands:
        _require_on_tray(hand, tray.hands, np.array(tray.size))
        for name, side, law in zip(pad_names(hand.name), (1.0, -1.0), (Law.DRIVEN_PAD, Law.FIXED_PAD), strict=True):
            axes = contact_axes(np.array([0.0, 0.0, -side]), np.array([1.0, 0.0, 0.0]))
            origin = np.array([*hand.point[:2], side * 0.5 * tray.size[2]])
            corners = rectangle(np.zeros(2), np.array(tray.hands.pad))
            fixed = tray.hands.pressure == "fixed"
            found.append(Patch(name, TRAY, hand.name.replace("_", " "), corners, origin, axes, law=law, fixed=fixed))
    return tuple(found)


def _require_on_tray(hand: Hand, hold: HandsConfig, size: Array) -> None:
    beyond = np.abs(hand.point[:2]) + 0.5 * np.array(hold.pad) - 0.5 * size[:2]
    if beyond.max() > RESOLUTION:
        x, y = hand.point[:2]
        raise RobotError(
            f"{hand.name}, at [{x:.3f}, {y:.3f}] m on the tray, reaches {1000 * beyond.max():.3g} mm beyond its edge; "
            "expected a larger tray, smaller pads, or another robot.posture",
            key="tray.hands.pad",
        )


def hand_systems(
    config: Config, hands: Sequence[Hand], friction: Mapping[str, float], shift: Mapping[str, float]
) -> tuple[ContactSystem, ...]:
    """Return the contact system of each hand that holds the tray.

    Args:
        config: the configuration.
        hands: the hands of the robot.
        friction: coefficient of friction by contact.
        shift: largest displacement of each contact point along x and along y, by contact [m].

    Raises:
        RobotError: a pad reaches beyond the tray.
    """
    patches = hand_patches(config, hands)
    edges = coarse_edges(config)
    found = []
    for link, hand in zip(links(patches, friction, edges, shift), hands, strict=True):
        system = system_of(link, (TRAY, *config.objects), edges)
        share = np.eye(system.dimension)
        share[:6, :6] = hand.share
        found.append(replace(system, pressed=(hand.name,), facets=system.facets @ share, transform=share))
    return tuple(found)


def hand_force(config: Config, hand: Hand, friction: Mapping[str, float]) -> float:
    """Return the lowest closing force of a hand, minus the part that an internal force uses up [N].

    The internal force S uses up S / (2 mu), see the head of the module (our choice).

    Args:
        config: the configuration; its tray must have hands.
        hand: the hand.
        friction: coefficient of friction by contact.

    Raises:
        RobotError: the internal force uses up the whole closing force.
    """
    hold = config.tray.hands if config.tray is not None else None
    assert hold is not None, "checked when the configuration was read"
    low = hold.force[0] if isinstance(hold.force, tuple) else hold.force
    mu = min(friction[name] for name in pad_names(hand.name)) * np.cos(np.pi / coarse_edges(config))
    used = 0.5 * hold.squeeze / mu
    if used >= low:
        raise RobotError(
            f"found {hold.squeeze:g} N, which friction {mu:.3g} at {low:g} N cannot hold; expected less than "
            f"{2.0 * mu * low:.4g} N, or a larger tray.hands.force",
            key="tray.hands.squeeze",
        )
    return low - used
