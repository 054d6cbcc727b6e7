"""Utilisation for random values of everything that is uncertain, all at once."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from robustopt.certificate.contact_points import Array, Contacts, Indices, even_pressure, simply_held
from robustopt.certificate.contacts import report
from robustopt.certificate.force_closure import gauge, gauge_from_rest
from robustopt.certificate.joints import load_utilisation
from robustopt.certificate.loads import Load, body_loads, system_load, tray_motion
from robustopt.certificate.motion import Motion
from robustopt.certificate.scene import Parameters, Scene, System
from robustopt.certificate.tally import Found, Tally

CHUNK = 8192
"""Draws times instants that are looked at together."""

NEWS = 1e-7
"""How much worse than the worst so far a utilisation must be to be of interest: ten times the accuracy of the gauge."""

STRIDE = 7
"""The joint acceleration error changes along the path: instant t of draw d uses the error of draw d + 7 t (a prime, so
that neighbouring instants and draws share no error)."""


def check_draws(scene: Scene, motion: Motion, draws: Parameters, per_bridge: int, tally: Tally) -> None:
    """Look at every instant with every draw; at bridges with `per_bridge` of the instants of each draw, in turn."""
    count, instants = draws.mass.shape[-1], len(motion.free)
    size = max(1, CHUNK // instants)
    for first in range(0, count, size):
        _Chunk(scene, motion, draws, np.arange(first, min(first + size, count)), tally).check(per_bridge)


@dataclass(eq=False)
class _Chunk:
    """Some draws at all T instants; its arrays end with the axes of the draws and of the instants."""

    scene: Scene
    motion: Motion
    draws: Parameters
    chosen: Indices
    tally: Tally

    def check(self, per_bridge: int) -> None:
        total, instants = self.draws.error.shape[-1], len(self.motion.free)
        self.error_of = (self.chosen[:, None] + STRIDE * np.arange(instants)) % total
        values = self.draws.at(self.chosen)
        widened = Parameters(*(array[..., None] for array in values.arrays()))
        varying = bool(np.any(self.scene.lower.error < self.scene.upper.error))
        error = self.draws.error[:, self.error_of] if varying else widened.error
        widened = replace(widened, error=error)
        motion = self.motion.widened()
        loads = body_loads(self.scene, tray_motion(motion, error), widened)
        self._check_torque(load_utilisation(motion, loads, error))
        for system in self.scene.systems:
            if len(system.objects) == 1:
                self._check_single(system, system_load(system, loads), widened)
            else:
                self._check_bridge(system, system_load(system, loads), per_bridge)

    def _check_torque(self, utilisation: Array) -> None:
        self.tally.tests += utilisation.size
        for j, joint in enumerate(self.scene.joints):
            name = f"{joint} torque"
            worst = utilisation[j].max(axis=0)
            news = worst > self.tally.threshold(name)
            if news.any():
                for t in self.tally.peaks(np.where(news, worst, -np.inf)):
                    d = int(np.argmax(utilisation[j, :, t]))
                    words = self.scene.describe(self._values(np.array([d]), np.array([t])).at(0), None)
                    self.tally.add(name, Found(float(worst[t]), t, name, words))

    def _check_single(self, system: System, load: Load, widened: Parameters) -> None:
        """Explicit forces decide most; where they do not, the gauge."""
        threshold = np.maximum(self.tally.threshold(system.name), 0.0) + NEWS
        rest, move = np.broadcast_arrays(*load)
        shape = rest.shape[1:]
        contacts = self.scene.contacts(system, self.draws.at(self.chosen))
        wide = Contacts(contacts.faces, contacts.point[..., None], contacts.mu[..., None])
        held = simply_held(wide, rest) & simply_held(wide, threshold * rest + move)
        self.tally.tests += held.size
        d, t = np.nonzero(~np.broadcast_to(held, shape))
        if len(d):
            solution = gauge_from_rest(contacts[d], rest[:, d, t], move[:, d, t], threshold[t])
            self._tell(system, solution.value, d, t, threshold)

    def _check_bridge(self, system: System, load: Load, per_bridge: int) -> None:
        """Whether forces balance at all at some of the instants; how far from the limit, only where they do not."""
        instants = len(self.motion.free)
        count = min(per_bridge, instants)
        d = np.repeat(np.arange(len(self.chosen)), count)
        step = np.arange(count) * instants // count
        t = ((self.chosen[:, None] * 31 + step) % instants).ravel()
        rest, move = (part[:, d, t] for part in np.broadcast_arrays(*load))
        contacts = self.scene.contacts(system, self.draws.at(self.chosen))[d]
        even = even_pressure(contacts, len(d))
        fails = np.flatnonzero(gauge(contacts, even, rest + move - even, 1.0).value > 1.0)
        self.tally.tests += len(d)
        if len(fails):
            d, t = d[fails], t[fails]
            solution = gauge_from_rest(contacts[fails], rest[:, fails], move[:, fails])
            self._tell(system, solution.value, d, t, self.tally.threshold(system.name))

    def _tell(self, system: System, utilisation: Array, d: Indices, t: Indices, threshold: Array) -> None:
        """Report the worst on the grid and between, if they are news."""
        for kind in (self.tally.grid[t], ~self.tally.grid[t]):
            excess = np.where(kind & (utilisation > threshold[t]), utilisation, -np.inf)
            best = int(np.argmax(excess))
            if excess[best] > -np.inf:
                values = self._values(d[best : best + 1], t[best : best + 1]).at(0)
                instant = int(t[best])
                report(self.scene, self.motion, system, values, instant, instant, float(utilisation[best]), self.tally)

    def _values(self, d: Indices, t: Indices) -> Parameters:
        """The values of draws d at instants t."""
        return replace(self.draws.at(self.chosen[d]), error=self.draws.error[:, self.error_of[d, t]])
