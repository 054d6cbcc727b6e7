"""Utilisation for random values of all uncertain parameters at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from robustopt.arrays import Array, Indices
from robustopt.certificate.bodies import Parameters
from robustopt.certificate.joints import KnownTorques, tell_torque, torques
from robustopt.certificate.loads import body_loads
from robustopt.certificate.motion import Motion
from robustopt.certificate.tally import Tally
from robustopt.certificate.world import World
from robustopt.certificate.worst import Search

CHUNK = 8192
"""Number of samples times instants that are checked together."""

STRIDE = 7
"""The acceleration error varies along the path: instant t of sample d uses the error of sample d + 7 t. As 7 is
prime, neighbouring instants and samples share no error.
"""


def check_samples(
    world: World,
    motion: Motion,
    known: Sequence[KnownTorques],
    searches: Sequence[Search],
    samples: Parameters,
    per_program: int,
    tally: Tally,
) -> None:
    """Check every instant with every sample; check only a few instants per sample if contacts share a wrench.

    Args:
        world: the bodies.
        motion: motion at all T instants.
        known: joints whose torque follows from the motion.
        searches: searches of the contact systems.
        samples: sets of values of all parameters.
        per_program: instants per sample for systems without a quick test; they differ from sample to sample.
        tally: receives the torques.
    """
    simple = [search for search in searches if search.system.simple]
    places = [*(part.at for part in known), *(search.index for search in simple)]
    for at in {own.tobytes(): own for own in places}.values():
        there = [part for part in known if np.array_equal(part.at, at)]
        tried = [search for search in simple if np.array_equal(search.index, at)]
        _check_everywhere(world, motion.at(at), there, tried, samples, at, tally)
    for search in searches:
        if not search.system.simple:
            _check_program(search, samples, min(per_program, len(search.index)))


def _check_everywhere(
    world: World,
    motion: Motion,
    known: Sequence[KnownTorques],
    searches: Sequence[Search],
    samples: Parameters,
    at: Indices,
    tally: Tally,
) -> None:
    """Check every sample at the instants `at`, to which motion, known and searches are restricted."""
    total, count = samples.error.shape[-1], len(at)
    size = max(1, CHUNK // count)
    index = np.tile(np.arange(count), min(size, total))
    tiled = motion.at(index)
    for first in range(0, total, size):
        chosen = np.repeat(np.arange(first, min(first + size, total)), count)
        part = slice(len(chosen))
        there, t = tiled.at(part), at[index[part]]
        values = _at(samples, chosen, t)
        loads = body_loads(world, there, values)
        wide = Parameters(*(_folded(array, count) for array in values.arrays()))
        wide_loads = [(_folded(rest, count), _folded(move, count)) for rest, move in loads]
        for own in known:
            torque = torques(world, own.joints, motion.free, wide_loads, wide)
            for j, limit in enumerate(own.limits):
                tell_torque(world, np.abs(torque[j]).ravel() / limit, j, values, t, tally)
        for search in searches:
            search.sample(index[part], there, search.part.values(values), search.part.loads(loads))


def _folded(values: Array, count: int) -> Array:
    """Return values (..., D count) as (..., D, count), to broadcast with those of `count` instants."""
    return values.reshape(*values.shape[:-1], values.shape[-1] // count, count)


def _check_program(search: Search, samples: Parameters, count: int) -> None:
    """Check every sample at `count` instants of a system, which differ from sample to sample."""
    samples, total, size = search.part.values(samples), samples.error.shape[-1], max(1, CHUNK // count)
    for first in range(0, total, size):
        chosen = np.arange(first, min(first + size, total))
        place = chosen[:, None] * 31 + np.arange(count) * len(search.index) // count
        index = (place % len(search.index)).ravel()
        values, there = _at(samples, np.repeat(chosen, count), search.index[index]), search.motion.at(index)
        search.sample(index, there, values, body_loads(search.world, there, values))


def _at(samples: Parameters, d: Indices, t: Indices) -> Parameters:
    """Return the values of samples d (k,) at instants t (k,)."""
    return replace(samples.at(d), error=samples.error[:, (d + STRIDE * t) % samples.error.shape[-1]])
