"""Utilisation of the contacts at the worst ends of all intervals.

At the gauge gamma of a contact system, y (gamma rest + move) = 0 for the direction y of the limit that is nearest, and
y w >= 0 for all wrenches w in the cone. Other parameters are worse where they make y (gamma rest + move) lower, or
leave y deeper inside the dual cone: to first order each parameter goes to the end of its interval that the sign of its
derivative says. From there the gauge and its y are found anew, a few times.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from robustopt.certificate.contact_points import Array, Indices
from robustopt.certificate.force_closure import GAP, Gauge, gauge_from_rest
from robustopt.certificate.loads import at_lowest, body_loads, functional, system_load, tray_motion
from robustopt.certificate.motion import Motion
from robustopt.certificate.scene import Parameters, Scene, System
from robustopt.certificate.tally import Found, Tally

SEARCH_GAP = 1e-4
"""Accuracy of the gauge during the search; what may be the worst is then solved to the full accuracy."""

MOST_WEIGHT = 2.0
"""Gauge at which the search looks where the contact does not hold at all."""

SHARED = 3
"""The worst parameters of this many instants are tried at all instants."""

TIPPING = 1e-3
"""A limit counts as tipping if the centre of pressure alone explains the utilisation to this accuracy."""


def check_contacts(
    scene: Scene, motion: Motion, system: System, starts: list[Parameters], rounds: int, tally: Tally
) -> None:
    """Worst utilisation of one contact system, searched at every instant from each of `starts` (T sets of values)."""
    search = _Search(scene, motion, system, tally)
    for start in starts:
        search.follow(start, rounds if scene.uncertain else 0)
    if scene.uncertain:
        count = len(search.upper)
        for t in np.argsort(-search.upper, kind="stable")[:SHARED]:
            search.follow(search.worst.at(int(t)).repeated(count), 0)
    search.report()


class _Search:
    """The worst values found so far at each instant, `worst`, and the bracket of their gauge, `upper`, `lower` (T,)."""

    def __init__(self, scene: Scene, motion: Motion, system: System, tally: Tally) -> None:
        self.scene, self.motion, self.system, self.tally = scene, motion, system, tally
        count = len(motion.free)
        self.worst = scene.nominal.repeated(count)
        self.upper, self.lower = np.full(count, -np.inf), np.full(count, -np.inf)

    def follow(self, values: Parameters, rounds: int) -> None:
        """Try `values`, and then `rounds` times the ends that look worse from there, where these are new."""
        index = np.arange(len(self.upper))
        for left in range(rounds, -1, -1):
            solution = self._try(index, values)
            if not left:
                return
            there = self.motion.at(index)
            ends = worse_ends(self.scene, there, self.system, values, solution)
            new = np.zeros(len(index), dtype=bool)
            for old, end in zip(values.arrays(), ends.arrays(), strict=True):
                new |= (old != end).reshape(-1, len(index)).any(axis=0)
            index, values = index[new], ends.at(np.flatnonzero(new))
            if not len(index):
                return

    def _try(self, index: Indices, values: Parameters) -> Gauge:
        solution = solve(self.scene, self.motion.at(index), self.system, values, SEARCH_GAP)
        better = solution.value > self.upper[index]
        found = index[better]
        for own, new in zip(self.worst.arrays(), values.arrays(), strict=True):
            own[..., found] = new[..., better]
        self.upper[found], self.lower[found] = solution.value[better], solution.lower[better]
        self.tally.tests += len(index)
        return solution

    def report(self) -> None:
        """Solve what may be the worst of its kind to full accuracy, and tell the tally."""
        for kind in (self.tally.grid, ~self.tally.grid):
            if not kind.any():
                continue
            level = np.minimum(self.lower, self.upper)[kind].max()
            close = np.flatnonzero(kind & (self.upper >= level))
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


def solve(scene: Scene, motion: Motion, system: System, values: Parameters, gap: float) -> Gauge:
    """Gauge of a system at T instants with T sets of values."""
    loads = body_loads(scene, tray_motion(motion, values.error), values)
    return gauge_from_rest(scene.contacts(system, values), *system_load(system, loads), gap=gap)


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
