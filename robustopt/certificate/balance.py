"""Balance of a contact system: the rows that its motion requires, and their gauge.

A system with a hold consists of a single block, so the effort of the hold is known. Its gauge is the larger one of the
gauge of the free cone and the gauge of the twist.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from robustopt.arrays import Array, Flags
from robustopt.certificate.bodies import Parameters
from robustopt.certificate.contact_points import Contacts, even_pressure, least_forces, simply_held
from robustopt.certificate.force_closure import GAP, Gauge, gauge, seen_from
from robustopt.certificate.loads import Functional, Load, body_loads
from robustopt.certificate.motion import Motion
from robustopt.certificate.systems import System
from robustopt.certificate.twist import Hold, spread_evenly, twist_gauge
from robustopt.certificate.world import World

# Required rows --------------------------------------------------------------------------------------------


def required(world: World, system: System, motion: Motion, loads: Sequence[Load], values: Parameters) -> Load:
    """Return the parts `rest` and `move` of the rows that a system requires, (rows, ...) each.

    The forces of vacuums and driven fingers are part of `rest`. For the floating base, `rest` is a unit force through
    the centre of its contacts. The contacts can always exert this force, whereas the base need not balance without
    motion.

    Args:
        world: the bodies.
        system: the system.
        motion: motion at the instants of the loads.
        loads: wrenches that all bodies require, see `body_loads`.
        values: parameters for which the loads were computed.
    """
    if system.at is not None:
        wrench = required_by_base(world, motion, loads, values.error)
        move = np.tensordot(system.loads[0].matrix, wrench, axes=1)
        rest = np.zeros_like(move)
        rest[2] = 1.0
        return rest, move - rest
    rest, move = (
        _total([np.tensordot(own.matrix, _total([loads[b][part] for b in own.bodies]), axes=1) for own in system.loads])
        for part in (0, 1)
    )
    if np.any(system.pull):
        rest = rest + np.tensordot(system.pull, values.force, axes=1)
    return rest, move


def required_by_base(world: World, motion: Motion, loads: Sequence[Load], error: Array) -> Array:
    """Return the wrench (6, ...) that contacts must exert on the floating base, about the world's origin [N, N m]."""
    wrench = motion.base_force
    for joint, value in enumerate(error):
        if np.any(value):
            wrench = wrench + motion.base_inertia[:, joint] * (value * motion.free)
    for body, (rest, move) in zip(world.bodies, loads, strict=True):
        if body.payload:
            wrench = wrench + np.einsum("ij...,j...->i...", motion.frames[body.frame].to_base, rest + move)
    return wrench


def _total(wrenches: Sequence[Array]) -> Array:
    total = wrenches[0]
    for wrench in wrenches[1:]:
        total = total + wrench
    return total


def goals(
    world: World, system: System, motion: Motion, y: Array, weight: Array
) -> tuple[list[Functional], Array | float]:
    """Return y (weight rest + move), for rows y (rows, T), as functionals of the bodies' wrenches.

    Returns:
        One functional per body, and the further gain per acceleration error that does not pass through them, (n, T).
    """
    if system.at is None:
        found = [(b, own.matrix.T @ y) for own in system.loads for b in own.bodies]
        return [Functional(b, pull[:3], pull[3:], weight) for b, pull in found], 0.0
    pull = system.loads[0].matrix.T @ y
    result = []
    for b, body in enumerate(world.bodies):
        if body.payload:
            own = np.einsum("ijt,it->jt", motion.frames[body.frame].to_base, pull)
            result.append(Functional(b, own[:3], own[3:]))
    return result, np.einsum("int,it->nt", motion.base_inertia, pull)


# Gauge ----------------------------------------------------------------------------------------------------


def balance(
    world: World, system: System, motion: Motion, values: Parameters, gap: float, enough: Array | float = 0.0
) -> Gauge:
    """Return the gauge of a system at T instants for T sets of values.

    Args:
        world: the bodies.
        system: the contact system.
        motion: motion at the instants.
        values: T sets of values.
        gap: accuracy.
        enough: gauge below which the search may stop (T,).
    """
    rest, move = required(world, system, motion, body_loads(world, motion, values), values)
    contacts = system.contact_points(values.friction, values.shift)
    certain = np.ones(rest.shape[-1], dtype=bool) if system.at is not None else None
    return gauge_of(system, contacts, rest, move, enough, gap, certain)


def gauge_of(
    system: System,
    contacts: Contacts,
    rest: Array,
    move: Array,
    enough: Array | float = 0.0,
    gap: float = GAP,
    held: Flags | None = None,
) -> Gauge:
    """Return the gauge of rest + move.

    If forces cannot balance `rest`, an even pressure replaces it as the reference.

    Args:
        system: the system.
        contacts: its contact points for T sets of values.
        rest: reference (rows, T).
        move: rows that the motion adds (rows, T).
        enough: gauge below which the search may stop (T,).
        gap: accuracy.
        held: whether forces balance `rest`, if this is known (T,).
    """
    held = _held_at(system, contacts, rest) if held is None else held
    rest, move = seen_from(contacts, held, rest, move)
    if system.hold is None:
        return gauge(contacts, rest, move, enough, gap)
    return _held_gauge(contacts, system.hold_of(contacts), rest, move, enough, gap)


def _held_at(system: System, contacts: Contacts, rest: Array) -> Flags:
    """Return whether forces balance `rest` (rows, T), including the twist of a hold with prescribed pressure."""
    held = certainly_held(system, contacts, rest)
    doubtful = np.flatnonzero(~held)
    if len(doubtful):
        own, rows = contacts[doubtful], rest[:, doubtful]
        even, certain = even_pressure(own, len(doubtful)), np.ones(len(doubtful), dtype=bool)
        held[doubtful] = gauge_of(system, own, even, rows - even, 1.0, held=certain).value <= 1.0 + GAP
    return held


def certainly_held(system: System, contacts: Contacts, rows: Array) -> Flags:
    """Return whether explicit forces balance rows (rows, T) and their twist.

    This is a sufficient condition, not a necessary one.
    """
    if system.simple:
        held = simply_held(contacts, rows)
    else:
        c = least_forces(contacts, rows)
        held = (c[0] >= np.hypot(c[1], c[2])).all(axis=0)
    if system.hold is not None:
        hold = system.hold_of(contacts)
        held = held & spread_evenly(hold, hold.effort(contacts, rows))
    return held


def _held_gauge(contacts: Contacts, hold: Hold, rest: Array, move: Array, enough: Array | float, gap: float) -> Gauge:
    """Return the gauge of a block that is held with prescribed pressure.

    If explicit forces show that the gauge of the free cone is below `enough`, only the gauge of the twist is computed.
    """
    doubtful = np.flatnonzero(~simply_held(contacts, enough * rest + move))
    at_rest, moved = hold.effort(contacts, rest), hold.effort(contacts, move)
    value, rates = twist_gauge(hold, at_rest, moved, enough)
    y = hold.rows(contacts, hold.cut(rates, hold.strength(at_rest + moved)))
    lower = value.copy()
    if len(doubtful):
        least = np.broadcast_to(np.asarray(enough), value.shape)[doubtful]
        free = gauge(contacts[doubtful], rest[:, doubtful], move[:, doubtful], least, gap)
        y[:, doubtful] = np.where(value[doubtful] > free.value, y[:, doubtful], free.y)
        value[doubtful] = np.maximum(value[doubtful], free.value)
        lower[doubtful] = np.maximum(lower[doubtful], free.lower)
    return Gauge(value, lower, y)
