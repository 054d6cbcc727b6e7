"""Utilisation for random values of everything that is uncertain, all at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from robustopt.arrays import Array, Indices
from robustopt.certificate.balance import certainly_held, gauge_of, required
from robustopt.certificate.bodies import Parameters
from robustopt.certificate.contact_points import even_pressure
from robustopt.certificate.joints import torques
from robustopt.certificate.loads import body_loads
from robustopt.certificate.motion import Joints, Motion
from robustopt.certificate.systems import System
from robustopt.certificate.tally import Found, Tally
from robustopt.certificate.world import World
from robustopt.certificate.worst import report
from robustopt.limits.names import LimitKind, LimitName

CHUNK = 8192
"""Samples times instants that are looked at together."""

NEWS = 1e-7
"""How much worse than the worst so far a utilisation must be to be of interest: ten times the accuracy of the gauge."""

STRIDE = 7
"""The acceleration error changes along the path: instant t of sample d uses the error of sample d + 7 t (a prime, so
that neighbouring instants and samples share no error)."""


@dataclass(frozen=True, eq=False)
class Torques:
    """Joints whose torque follows from the motion, at the instants `at`, None for all; limits: (m,) of the torques."""

    joints: Joints
    limits: Array
    at: Indices | None


def check_samples(
    world: World, motion: Motion, known: Sequence[Torques], samples: Parameters, per_program: int, tally: Tally
) -> None:
    """Look at every instant with every sample, and at few of them where contacts share.

    Args:
        world: the bodies.
        motion: at all T instants.
        known: joints whose torque follows from the motion.
        samples: values of everything.
        per_program: instants per sample for systems without a quick test, others for each sample.
        tally: told what is news.
    """
    count = samples.error.shape[-1]
    size = max(1, CHUNK // len(motion.free))
    for first in range(0, count, size):
        chosen = np.arange(first, min(first + size, count))
        _Chunk(world, motion, samples, chosen, tally).check(known)
    size = max(1, CHUNK // per_program)
    for system in world.systems:
        for first in range(0, 0 if system.simple else count, size):
            chosen = np.arange(first, min(first + size, count))
            _check_program(world, system, motion, samples, chosen, per_program, tally)


def _errors(samples: Parameters, d: Indices, t: Indices) -> Array:
    """Return the acceleration errors (n, ...) of samples d at instants t."""
    return samples.error[:, (d + STRIDE * t) % samples.error.shape[-1]]


def _check_program(
    world: World, system: System, motion: Motion, samples: Parameters, chosen: Indices, per_program: int, tally: Tally
) -> None:
    """Find whether forces balance at all at some of the instants; how far from the limit, only if they do not."""
    at = np.arange(len(motion.free)) if system.at is None else system.at
    count = min(per_program, len(at))
    d = np.repeat(chosen, count)
    t = at[((chosen[:, None] * 31 + np.arange(count) * len(at) // count) % len(at)).ravel()]
    there, values = motion.at(t), replace(samples.at(d), error=_errors(samples, d, t))
    rest, move = required(world, system, there, body_loads(world, there, values), values)
    contacts = system.contact_points(values.friction, values.shift)
    even, certain = even_pressure(contacts, len(d)), np.ones(len(d), dtype=bool)
    fails = np.flatnonzero(gauge_of(system, contacts, even, rest + move - even, 1.0, held=certain).value > 1.0)
    tally.tests += len(d)
    if len(fails):
        value = gauge_of(system, contacts[fails], rest[:, fails], move[:, fails]).value
        threshold = tally.threshold(system.name)[t[fails]]
        _tell(world, system, motion, samples, (value, d[fails], t[fails], threshold), tally)


def _tell(
    world: World,
    system: System,
    motion: Motion,
    samples: Parameters,
    found: tuple[Array, Indices, Indices, Array],
    tally: Tally,
) -> None:
    """Report the worst on the grid and between, if they are news.

    Args:
        world, system, motion, samples: what was looked at.
        found: utilisations, their samples and instants, and the utilisations that were known there, (k,) each.
        tally: told the news.
    """
    utilisation, d, t, threshold = found
    for kind in (tally.grid[t], ~tally.grid[t]):
        excess = np.where(kind & (utilisation > threshold), utilisation, -np.inf)
        best = int(np.argmax(excess))
        if excess[best] > -np.inf:
            one, there = t[best : best + 1], motion.at(t[best : best + 1])
            values = replace(samples.at(int(d[best])), error=_errors(samples, d[best : best + 1], one)[:, 0])
            report(world, system, there, values, int(t[best]), float(utilisation[best]), tally)


class _Chunk:
    """D of the samples at all T instants; its arrays end with the axes of the samples and of the instants."""

    def __init__(self, world: World, motion: Motion, samples: Parameters, chosen: Indices, tally: Tally) -> None:
        self.world, self.motion, self.samples, self.chosen, self.tally = world, motion, samples, chosen, tally
        instants = np.arange(len(motion.free))
        self.values = samples.at(chosen)
        varying = bool(np.any(world.lower.error < world.upper.error))
        shape = (len(samples.error), len(chosen), len(instants))
        error = np.broadcast_to(self.values.error[..., None], shape)
        self.wide = replace(
            self.values.widened(), error=_errors(samples, chosen[:, None], instants) if varying else error
        )

    def check(self, known: Sequence[Torques]) -> None:
        """Look at the torques that are known and at the systems with a quick test."""
        everywhere, wide = np.arange(len(self.motion.free)), self.motion.widened()
        loads = body_loads(self.world, wide, self.wide)
        for part in known:
            at = everywhere if part.at is None else part.at
            values, own = self._values(at), [(rest[..., at], move[..., at]) for rest, move in loads]
            torque = torques(self.world, part.joints.widened(), self.motion.free[at], own, values)
            self._tell_torque(np.abs(torque) / part.limits[:, None, None], at)
        for system in self.world.systems:
            if system.simple:
                there, own, values, at = wide, loads, self.wide, everywhere
                if system.at is not None:
                    at, there, values = system.at, wide.at(system.at), self._values(system.at)
                    own = [(rest[..., at], move[..., at]) for rest, move in loads]
                rest, move = np.broadcast_arrays(*required(self.world, system, there, own, values))
                self._check_simple(system, rest, move, at)

    def _values(self, at: Indices) -> Parameters:
        """Return the samples at some instants."""
        return replace(self.wide, error=self.wide.error[..., at])

    def _tell_torque(self, utilisation: Array, at: Indices) -> None:
        self.tally.tests += utilisation.size
        for j, joint in enumerate(self.world.joints[self.world.base :]):
            name = LimitName(LimitKind.TORQUE, joint)
            worst = utilisation[j].max(axis=0)
            news = worst > self.tally.threshold(name)[at]
            for t in self.tally.peaks(np.where(news, worst, -np.inf), at) if news.any() else ():
                if news[t]:
                    d = int(np.argmax(utilisation[j, :, t]))
                    error = self.wide.error[:, d, at[t]]
                    words = self.world.describe(replace(self.values.at(d), error=error), None)
                    self.tally.add(name, Found(float(worst[t]), int(at[t]), name, words))

    def _check_simple(self, system: System, rest: Array, move: Array, at: Indices) -> None:
        """Let explicit forces decide most, and the gauge the rest."""
        threshold = np.maximum(self.tally.threshold(system.name)[at], 0.0) + NEWS
        contacts = system.contact_points(self.values.friction, self.values.shift)
        wide = replace(contacts, point=contacts.point[..., None], mu=contacts.mu[..., None])
        held = certainly_held(system, wide, rest) & certainly_held(system, wide, threshold * rest + move)
        self.tally.tests += held.size
        d, t = np.nonzero(~np.broadcast_to(held, rest.shape[1:]))
        if len(d):
            value = gauge_of(system, contacts[d], rest[:, d, t], move[:, d, t], threshold[t]).value
            found = value, self.chosen[d], at[t], threshold[t]
            _tell(self.world, system, self.motion, self.samples, found, self.tally)
