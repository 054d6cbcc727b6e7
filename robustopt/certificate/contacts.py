"""Utilisation of the contacts at the worst ends of all intervals.

At the gauge gamma of a contact system, y (gamma rest + move) = 0 for the direction y of the limit that is nearest, and
y w >= 0 for all wrenches w in the cone. Other parameters are worse where they make y (gamma rest + move) lower, or
leave y deeper inside the dual cone: to first order each parameter goes to the end of its interval that the sign of its
derivative says. From there the gauge and its y are found anew, a few times.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from robustopt.certificate.contact_points import Array, Flags, Indices, simply_held
from robustopt.certificate.force_closure import GAP, Gauge, gauge_from_rest
from robustopt.certificate.loads import at_lowest, body_loads, functional, system_load, tray_motion
from robustopt.certificate.motion import Motion
from robustopt.certificate.scene import Parameters, Scene, System
from robustopt.certificate.tally import Found, Tally

MOST_WEIGHT = 2.0
"""Gauge at which the search looks where the contact does not hold at all."""

SHARED = 3
"""The worst parameters of this many instants are tried at all instants."""

PROMISING = 0.95
"""Share of the worst utilisation so far from which a quick search goes on."""

TIPPING = 1e-3
"""A limit counts as tipping if the centre of pressure alone explains the utilisation to this accuracy."""


@dataclass(frozen=True)
class Thoroughness:
    """How a search goes about it.

    every: instants from one search to the next; rounds: steps of each; gap: accuracy of the gauge in them. What may be
    the worst is then solved to full accuracy.
    """

    every: int
    rounds: int
    gap: float


def check_contacts(
    scene: Scene, motion: Motion, system: System, starts: list[Parameters], how: Thoroughness, tally: Tally
) -> None:
    """Worst utilisation of one contact system.

    The search starts from each of `starts` (T sets of values), at every `how.every`-th instant. All instants are then
    tried with the worst values of the nearest of these. The worst of all are tried at all instants too; for bridges,
    for which there is no quick test, at the searched ones only.
    """
    search = _Search(scene, motion, system, how.gap, tally)
    every, rounds = how.every, how.rounds
    everywhere, quick = np.arange(len(motion.free)), len(system.objects) == 1
    chosen = everywhere[::every]
    rounds = rounds if scene.uncertain else 0
    for start in starts:
        search.follow(chosen, start.at(chosen), rounds)
    if every > 1:
        nearest = np.minimum((everywhere + every // 2) // every, len(chosen) - 1) * every
        search.follow(everywhere, search.worst.at(nearest), min(rounds, int(quick)), cull=True)
    if scene.uncertain:
        tried = everywhere if quick else chosen
        for t in np.argsort(-search.upper, kind="stable")[:SHARED]:
            search.follow(tried, search.worst.at(int(t)).repeated(len(tried)), 0, cull=True)
    search.report()


class _Search:
    """The worst values found so far at each instant, `worst`, and the bracket of their gauge, `upper`, `lower` (T,)."""

    def __init__(self, scene: Scene, motion: Motion, system: System, gap: float, tally: Tally) -> None:
        self.scene, self.motion, self.system, self.gap, self.tally = scene, motion, system, gap, tally
        count = len(motion.free)
        self.worst = scene.nominal.repeated(count)
        self.upper, self.lower = np.full(count, -np.inf), np.full(count, -np.inf)

    def follow(self, index: Indices, values: Parameters, rounds: int, cull: bool = False) -> None:
        """Try `values` at the instants `index`, and then `rounds` times the ends that look worse from there.

        With `cull`, instants that are clearly better than the worst of their kind so far are left alone.
        """
        for left in range(rounds, -1, -1):
            if cull:
                index, values = self._doubtful(index, values)
            if not len(index):
                return
            solution = self._try(index, values, self._level()[index] if cull else 0.0)
            if left:
                there = self.motion.at(index)
                ends = worse_ends(self.scene, there, self.system, values, solution)
                new = _differ(values, ends)
                if cull:
                    new &= solution.value >= PROMISING * self._level()[index]
                index, values = index[new], ends.at(np.flatnonzero(new))

    def _doubtful(self, index: Indices, values: Parameters) -> tuple[Indices, Parameters]:
        """The instants where no simple choice of forces shows that they are better than the worst so far."""
        there = self.motion.at(index)
        rest, move = system_load(self.system, body_loads(self.scene, tray_motion(there, values.error), values))
        level = np.maximum(self._level()[index], 0.0)
        contacts = self.scene.contacts(self.system, values)
        doubtful = ~(simply_held(contacts, rest) & simply_held(contacts, level * rest + move))
        self.tally.tests += len(index)
        return index[doubtful], values.at(np.flatnonzero(doubtful))

    def _try(self, index: Indices, values: Parameters, enough: Array | float) -> Gauge:
        solution = solve(self.scene, self.motion.at(index), self.system, values, self.gap, enough)
        better = solution.value > self.upper[index]
        found = index[better]
        for own, new in zip(self.worst.arrays(), values.arrays(), strict=True):
            own[..., found] = new[..., better]
        self.upper[found], self.lower[found] = solution.value[better], solution.lower[better]
        self.tally.tests += len(index)
        return solution

    def _level(self) -> Array:
        """The worst utilisation so far of the kind of each instant, on the grid or between, (T,)."""
        safe = np.minimum(self.lower, self.upper)
        grid = self.tally.grid
        levels = [safe[kind].max(initial=-np.inf) for kind in (grid, ~grid)]
        return np.asarray(np.where(grid, levels[0], levels[1]))

    def report(self) -> None:
        """Solve what may be the worst of its kind to full accuracy, and tell the tally."""
        for kind in (self.tally.grid, ~self.tally.grid):
            if not kind.any():
                continue
            close = np.flatnonzero(kind & (self.upper >= self._level()))
            values = self.worst.at(close)
            there = self.motion.at(close)
            utilisation = solve(self.scene, there, self.system, values, GAP).value
            best = int(np.argmax(utilisation))
            report(
                self.scene,
                there,
                self.system,
                values.at(best),
                best,
                int(close[best]),
                float(utilisation[best]),
                self.tally,
            )


def _differ(first: Parameters, second: Parameters) -> Flags:
    """Whether two times T sets of values differ, (T,)."""
    pairs = zip(first.arrays(), second.arrays(), strict=True)
    return np.asarray(np.any([(a != b).reshape(-1, a.shape[-1]).any(axis=0) for a, b in pairs], axis=0))


def solve(
    scene: Scene, motion: Motion, system: System, values: Parameters, gap: float, enough: Array | float = 0.0
) -> Gauge:
    """Gauge of a system at T instants with T sets of values; any that is at most `enough` will do."""
    loads = body_loads(scene, tray_motion(motion, values.error), values)
    return gauge_from_rest(scene.contacts(system, values), *system_load(system, loads), enough, gap)


def report(
    scene: Scene,
    motion: Motion,
    system: System,
    values: Parameters,
    index: int,
    instant: int,
    utilisation: float,
    tally: Tally,
) -> None:
    """Tell the tally a utilisation that was found with one set of values."""
    limit = limit_name(scene, motion.at(np.array([index])), system, values, utilisation)
    tally.add(system.name, Found(utilisation, instant, limit, scene.describe(values, system)))


def worse_ends(scene: Scene, motion: Motion, system: System, values: Parameters, solution: Gauge) -> Parameters:
    """Ends of all intervals that look worse for the limits y of a solution."""
    weight = np.minimum(np.where(np.isfinite(solution.value), solution.value, MOST_WEIGHT), MOST_WEIGHT)
    goals = [
        (b, functional(system, solution.y, block, weight)) for block, load in enumerate(system.loads) for b in load
    ]
    ends = at_lowest(scene, motion, values, goals)
    shift, friction = values.shift.copy(), values.friction.copy()
    friction[list(system.interfaces)] = scene.lower.friction[list(system.interfaces), None]
    if np.any(scene.upper.shift[:, system.points] > 0.0):
        shift[:, system.points] = _worse_shift(scene, system, values, solution.y)
    return replace(ends, shift=shift, friction=friction)


def _worse_shift(scene: Scene, system: System, values: Parameters, y: Array) -> Array:
    """Displacement of each contact point that leaves y deepest inside the dual cone of the point, (2, n, T).

    The point's cone asks v_z >= mu |v_t| of v = y_force + y_moment x p; the sign of the derivative of the difference
    by p decides, in the axes of the support.
    """
    contacts = scene.contacts(system, values)
    seen = contacts.seen(y)
    length = np.sqrt(seen[1] ** 2 + seen[2] ** 2)
    slope = np.zeros((2, *length.shape))
    for face in system.faces:
        part = slice(face.first, face.last)
        own = y[6 * face.above : 6 * face.above + 6]
        if face.below >= 0:
            own = own - y[6 * face.below : 6 * face.below + 6]
        ratio = contacts.mu[part] / np.where(length[part] > 0.0, length[part], np.inf)
        slope[0, part] = -own[4] - ratio * seen[2, part] * own[5]
        slope[1, part] = own[3] + ratio * seen[1, part] * own[5]
    turned = np.einsum("ijq,iqt->jqt", scene.point_turn[..., system.points], slope)
    upper = scene.upper.shift[:, system.points, None]
    return np.asarray(np.sign(turned) * upper)


def limit_name(scene: Scene, motion: Motion, system: System, values: Parameters, utilisation: float) -> str:
    """Slip or tipping, for a single interface at one instant: what happens there if friction were without bound?"""
    if len(system.interfaces) > 1:
        return system.name
    many = values.repeated(1)
    frictionless = replace(many, friction=np.full_like(many.friction, 1e3))
    alone = solve(scene, motion, system, frictionless, GAP).value[0]
    interface = scene.interfaces[system.interfaces[0]]
    if np.isclose(alone, utilisation, rtol=TIPPING):
        return f"tipping of {interface.object} over {interface.support}"
    return f"slip of {interface.object} on {interface.support}"
