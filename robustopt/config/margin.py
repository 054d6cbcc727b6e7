"""Which uncertain quantities of a task have an interval: a plan has a margin for these alone."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from robustopt.config.model import Config
from robustopt.config.per_name import value_of


def has_intervals(config: Config) -> bool:
    """Return whether any quantity has an interval.

    Args:
        config: the configuration.
    """
    varies = (config.inertia_of(name) != (1.0, 1.0) for name in config.uncertainty.inertia)
    return any(varies) or any(wide for _, wide in (*_expected(config), *_bodies(config)))


def without_margin(config: Config) -> str:
    """Return a sentence about the quantities for which a plan has no margin, with the keys that would give one.

    Friction, contact points, holding forces and acceleration errors are expected to have intervals, because real ones
    always vary (our choice).

    Args:
        config: the configuration.

    Returns:
        The sentence, empty if all of them have intervals.
    """
    expected = [key for key, wide in _expected(config) if not wide]
    if not has_intervals(config):
        keys = dict.fromkeys([*expected, *(key for key, _ in _bodies(config))])
        return f"The plan has no margin: it holds for the nominal values alone. Keys that give one: {', '.join(keys)}."
    return f"The plan has a margin, but none for {', '.join(dict.fromkeys(expected))}." if expected else ""


def _expected(config: Config) -> Iterator[tuple[str, bool]]:
    """Yield the keys of quantities that always vary, and whether each has an interval."""
    uncertain, contacts = config.uncertainty, config.contact_owners.items()
    frictions = {name: value_of(uncertain.friction, (name, owner), (0.0, 0.0)) for name, owner in contacts}
    shifts = {name: value_of(uncertain.contact_points, (name, owner), 0.0) for name, owner in contacts}
    yield from _by_contact("uncertainty.friction", {name: high > low for name, (low, high) in frictions.items()})
    yield from _by_contact("uncertainty.contact_points", {name: shift > 0.0 for name, shift in shifts.items()})
    for name, body in config.objects.items():
        if body.held_by is not None:
            force = body.held_by.tool.force
            tool = "suction" if body.held_by.suction else "grip"
            yield f"objects.{name}.held_by.{tool}.force", isinstance(force, tuple) and force[1] > force[0]
    error = uncertain.joint_acceleration
    yield "uncertainty.joint_acceleration", error is not None and bool(error.K * np.max(error.deviation) > 0.0)
    if config.path.steps is not None:
        yield "uncertainty.base_acceleration", bool(np.max(uncertain.base_acceleration) > 0.0)


def _by_contact(key: str, wide: dict[str, bool]) -> Iterator[tuple[str, bool]]:
    """Yield a key whose value may differ between contacts: itself, or one key per contact if only some are wide."""
    if len(set(wide.values())) == 1:
        yield key, all(wide.values())
    else:
        yield from ((f"{key}.{name}", own) for name, own in wide.items())


def _bodies(config: Config) -> Iterator[tuple[str, bool]]:
    """Yield the keys of quantities of bodies, and whether any body has an interval."""
    uncertain = config.uncertainty
    if config.objects or config.tray is not None or uncertain.mass or uncertain.center_of_mass:
        yield "uncertainty.center_of_mass", any(max(reach) > 0.0 for reach in uncertain.center_of_mass.values())
        yield "uncertainty.mass", any(high > low for low, high in uncertain.mass.values())
