"""Utilisation for random values of everything that is uncertain, all at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from robustopt.arrays import Array, Indices
from robustopt.certificate import names
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
        _Chunk(world, motion, samples, chosen, tally).check(known, per_program)


class _Chunk:
    """D of the samples at all T instants; its arrays end with the axes of the samples and of the instants."""

    def __init__(self, world: World, motion: Motion, samples: Parameters, chosen: Indices, tally: Tally) -> None:
        self.world, self.motion, self.samples, self.chosen, self.tally = world, motion, samples, chosen, tally
        instants, total = len(motion.free), samples.error.shape[-1]
        self.error_of = (chosen[:, None] + STRIDE * np.arange(instants)) % total
        self.values = samples.at(chosen)
        varying = bool(np.any(world.lower.error < world.upper.error))
        shape = (len(samples.error), len(chosen), instants)
        error = samples.error[:, self.error_of] if varying else np.broadcast_to(self.values.error[..., None], shape)
        self.wide = replace(self.values.widened(), error=error)

    def check(self, known: Sequence[Torques], per_program: int) -> None:
        """Look at the torques that are known and at all systems."""
        everywhere, wide = np.arange(len(self.motion.free)), self.motion.widened()
        loads = body_loads(self.world, wide, self.wide)
        for part in known:
            at = everywhere if part.at is None else part.at
            error, own = self.wide.error[..., at], [(rest[..., at], move[..., at]) for rest, move in loads]
            torque = torques(self.world, part.joints.widened(), self.motion.free[at], own, error)
            self._tell_torque(np.abs(torque) / part.limits[:, None, None], at)
        for system in self.world.systems:
            if system.at is None:
                load = required(self.world, system, wide, loads, self.wide)
            else:
                there, own = wide.at(system.at), [(rest[..., system.at], move[..., system.at]) for rest, move in loads]
                values = replace(self.wide, error=self.wide.error[..., system.at])
                load = required(self.world, system, there, own, values)
            rest, move = np.broadcast_arrays(*load)
            at = everywhere if system.at is None else system.at
            (self._check_simple if system.simple else self._check_program)(system, rest, move, at, per_program)

    def _tell_torque(self, utilisation: Array, at: Indices) -> None:
        self.tally.tests += utilisation.size
        for j, joint in enumerate(self.world.joints[self.world.base :]):
            name = names.joint_limit(joint, "torque")
            worst = utilisation[j].max(axis=0)
            news = worst > self.tally.threshold(name)[at]
            for t in self.tally.peaks(np.where(news, worst, -np.inf), at) if news.any() else ():
                if news[t]:
                    d = int(np.argmax(utilisation[j, :, t]))
                    words = self.world.describe(self._sample(d, int(at[t])), None)
                    self.tally.add(name, Found(float(worst[t]), int(at[t]), name, words))

    def _check_simple(self, system: System, rest: Array, move: Array, at: Indices, _: int) -> None:
        """Let explicit forces decide most, and the gauge the rest."""
        threshold = np.maximum(self.tally.threshold(system.name)[at], 0.0) + NEWS
        contacts = system.contact_points(self.values.friction, self.values.shift)
        wide = replace(contacts, point=contacts.point[..., None], mu=contacts.mu[..., None])
        held = certainly_held(system, wide, rest) & certainly_held(system, wide, threshold * rest + move)
        self.tally.tests += held.size
        d, t = np.nonzero(~np.broadcast_to(held, rest.shape[1:]))
        if len(d):
            value = gauge_of(system, contacts[d], rest[:, d, t], move[:, d, t], threshold[t]).value
            self._tell(system, value, d, at[t], threshold[t])

    def _check_program(self, system: System, rest: Array, move: Array, at: Indices, per_program: int) -> None:
        """Find whether forces balance at all at some of the instants; how far from the limit, only if they do not."""
        instants = len(at)
        count = min(per_program, instants)
        d = np.repeat(np.arange(len(self.chosen)), count)
        t = ((self.chosen[:, None] * 31 + np.arange(count) * instants // count) % instants).ravel()
        contacts = system.contact_points(self.values.friction, self.values.shift)[d]
        rest, move = rest[:, d, t], move[:, d, t]
        even = even_pressure(contacts, len(d))
        certain = np.ones(len(d), dtype=bool)
        fails = np.flatnonzero(gauge_of(system, contacts, even, rest + move - even, 1.0, held=certain).value > 1.0)
        self.tally.tests += len(d)
        if len(fails):
            value = gauge_of(system, contacts[fails], rest[:, fails], move[:, fails]).value
            where = at[t[fails]]
            self._tell(system, value, d[fails], where, self.tally.threshold(system.name)[where])

    def _tell(self, system: System, utilisation: Array, d: Indices, t: Indices, threshold: Array) -> None:
        """Report the worst on the grid and between, if they are news."""
        for kind in (self.tally.grid[t], ~self.tally.grid[t]):
            excess = np.where(kind & (utilisation > threshold), utilisation, -np.inf)
            best = int(np.argmax(excess))
            if excess[best] > -np.inf:
                values, instant = self._sample(int(d[best]), int(t[best])), int(t[best])
                there = self.motion.at(np.array([instant]))
                report(self.world, system, there, values, instant, float(utilisation[best]), self.tally)

    def _sample(self, d: int, t: int) -> Parameters:
        """Return the values of sample d at instant t."""
        return replace(self.samples.at(int(self.chosen[d])), error=self.samples.error[:, self.error_of[d, t]])
