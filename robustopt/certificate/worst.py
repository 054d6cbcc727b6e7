"""Utilisation of the contacts at the worst ends of all intervals.

At the gauge gamma of a contact system, y (gamma rest + move) = 0 for the direction y of the limit that is nearest, and
y w >= 0 for all rows w in the cone. Other parameters are worse if they make y (gamma rest + move) lower, or leave y
deeper inside the dual cone: to first order each parameter goes to the end of its interval that the sign of its
derivative says. From there the gauge and its y are found anew, a few times.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from robustopt.arrays import Array, Flags, Indices
from robustopt.certificate import names
from robustopt.certificate.balance import balance, certainly_held, goals, required
from robustopt.certificate.bodies import Parameters
from robustopt.certificate.force_closure import GAP, Gauge
from robustopt.certificate.loads import at_lowest, body_loads
from robustopt.certificate.motion import Motion
from robustopt.certificate.systems import System
from robustopt.certificate.tally import Found, Tally
from robustopt.certificate.world import World
from robustopt.limits.names import LimitKind, LimitName

MOST_WEIGHT = 2.0
"""Gauge at which the search looks where the contact does not hold at all."""

SHARED = 3
"""The worst parameters of this many instants are tried at all instants."""

PROMISING = 0.95
"""Share of the worst utilisation so far from which a quick search goes on."""

SAME = 1e-3
"""A limit counts as the cause if it alone explains the utilisation to this accuracy."""

ENDLESS = 1e3
"""Coefficient of friction with which nothing slides."""


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
    world: World, system: System, motion: Motion, starts: Sequence[Parameters], how: Thoroughness, tally: Tally
) -> tuple[Indices, Parameters]:
    """Find the worst utilisation of one contact system.

    The search starts from each of `starts` (T sets of values), at every `how.every`-th instant. All instants are then
    tried with the worst values of the nearest of these. The worst of all are tried at all instants too; for systems
    without a quick test at the searched ones only.

    Args:
        world, system: the bodies and the system.
        motion: at the instants of the system.
        starts: each T sets of values.
        how: thoroughness.
        tally: told the worst.

    Returns:
        the instants that were searched, (S,) among those of the system, and the worst values there, S sets.
    """
    search = _Search(world, system, motion, how.gap, tally)
    every, rounds = how.every, how.rounds if world.uncertain else 0
    everywhere = np.arange(len(motion.free))
    chosen = everywhere[::every]
    for start in starts:
        search.follow(chosen, start.at(chosen), rounds)
    if every > 1:
        nearest = np.minimum((everywhere + every // 2) // every, len(chosen) - 1) * every
        search.follow(everywhere, search.worst.at(nearest), min(rounds, int(system.simple)), cull=True)
    if world.uncertain:
        tried = everywhere if system.simple else chosen
        for t in np.argsort(-search.upper, kind="stable")[:SHARED]:
            search.follow(tried, search.worst.at(int(t)).repeated(len(tried)), 0, cull=True)
    search.report()
    return chosen, search.worst.at(chosen)


class _Search:
    """The worst values found so far at each instant, `worst`, and the bracket of their gauge, `upper`, `lower` (T,)."""

    def __init__(self, world: World, system: System, motion: Motion, gap: float, tally: Tally) -> None:
        self.world, self.system, self.motion, self.gap, self.tally = world, system, motion, gap, tally
        count = len(motion.free)
        self.index = np.arange(count) if system.at is None else system.at
        self.grid = tally.grid[self.index]
        self.worst = world.nominal.repeated(count)
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
                ends = worse_ends(self.world, self.system, self.motion.at(index), values, solution)
                new = _differ(values, ends)
                if cull:
                    new &= solution.value >= PROMISING * self._level()[index]
                index, values = index[new], ends.at(np.flatnonzero(new))

    def _doubtful(self, index: Indices, values: Parameters) -> tuple[Indices, Parameters]:
        """Return the instants where no simple choice of forces shows that they are better than the worst so far."""
        there, system = self.motion.at(index), self.system
        rest, move = required(self.world, system, there, body_loads(self.world, there, values), values)
        level = np.maximum(self._level()[index], 0.0)
        contacts = system.contact_points(values.friction, values.shift)
        doubtful = ~(certainly_held(system, contacts, rest) & certainly_held(system, contacts, level * rest + move))
        self.tally.tests += len(index)
        return index[doubtful], values.at(np.flatnonzero(doubtful))

    def _try(self, index: Indices, values: Parameters, enough: Array | float) -> Gauge:
        solution = balance(self.world, self.system, self.motion.at(index), values, self.gap, enough)
        better = solution.value > self.upper[index]
        found = index[better]
        for own, new in zip(self.worst.arrays(), values.arrays(), strict=True):
            own[..., found] = new[..., better]
        self.upper[found], self.lower[found] = solution.value[better], solution.lower[better]
        self.tally.tests += len(index)
        return solution

    def _level(self) -> Array:
        """Return the worst utilisation so far of the kind of each instant, on the grid or between, (T,)."""
        safe = np.minimum(self.lower, self.upper)
        levels = [safe[kind].max(initial=-np.inf) for kind in (self.grid, ~self.grid)]
        return np.where(self.grid, levels[0], levels[1])

    def report(self) -> None:
        """Solve what may be the worst of its kind to full accuracy, and tell the tally."""
        for kind in (self.grid, ~self.grid):
            if not kind.any():
                continue
            close = np.flatnonzero(kind & (self.upper >= self._level()))
            values, there = self.worst.at(close), self.motion.at(close)
            utilisation = balance(self.world, self.system, there, values, GAP).value
            best = int(np.argmax(utilisation))
            instant, worst = int(self.index[close[best]]), float(utilisation[best])
            report(self.world, self.system, there.at(np.array([best])), values.at(best), instant, worst, self.tally)


def _differ(first: Parameters, second: Parameters) -> Flags:
    """Return whether two times T sets of values differ, (T,)."""
    pairs = zip(first.arrays(), second.arrays(), strict=True)
    return np.asarray(np.any([(a != b).reshape(-1, a.shape[-1]).any(axis=0) for a, b in pairs], axis=0))


def report(
    world: World, system: System, there: Motion, values: Parameters, instant: int, utilisation: float, tally: Tally
) -> None:
    """Tell the tally a utilisation that was found with one set of values; `there` is the motion at this instant."""
    limit = limit_name(world, system, there, values, utilisation)
    tally.add(system.name, Found(utilisation, instant, limit, world.describe(values, system)))


def worse_ends(world: World, system: System, motion: Motion, values: Parameters, solution: Gauge) -> Parameters:
    """Return the ends of all intervals that look worse for the limits y of a solution."""
    weight = np.minimum(np.where(np.isfinite(solution.value), solution.value, MOST_WEIGHT), MOST_WEIGHT)
    functionals, joint_goal = goals(world, system, motion, solution.y, weight)
    ends = at_lowest(world, motion, values, functionals, joint_goal)
    shift, friction, force = values.shift.copy(), values.friction.copy(), values.force.copy()
    own, pressing = list(system.contacts), np.flatnonzero(np.any(system.pull, axis=0))
    friction[own] = world.lower.friction[own, None]
    gain = system.pull[:, pressing].T @ solution.y
    force[pressing] = np.where(gain >= 0.0, world.lower.force[pressing, None], world.upper.force[pressing, None])
    if np.any(world.upper.shift[:, system.points] > 0.0):
        shift[:, system.points] = _worse_shift(world, system, values, solution.y)
    return replace(ends, shift=shift, friction=friction, force=force)


def _worse_shift(world: World, system: System, values: Parameters, y: Array) -> Array:
    """Return the displacement of each contact point that leaves y deepest inside the dual cone of the point, (2, n, T).

    The point's cone asks v_z >= mu |v_t| of v = y_force + y_moment x p, z along its normal; the sign of the derivative
    of the difference by p decides, along the axes of the support.
    """
    contacts = system.contact_points(values.friction, values.shift)
    seen = contacts.seen(y)
    length = np.sqrt(seen[1] ** 2 + seen[2] ** 2)
    tangent = seen[1:] / np.where(length > 0.0, length, np.inf)
    slope = np.zeros((3, *length.shape))
    for face in system.faces:
        moment = y[6 * face.above + 3 : 6 * face.above + 6]
        if face.below >= 0:
            moment = moment - y[6 * face.below + 3 : 6 * face.below + 6]
        axes = np.eye(3) if face.axes is None else face.axes
        along, mu = tangent[:, face.part], contacts.mu[face.part]
        pull = axes[:, 2, None, None] - mu * np.einsum("ic,cnt->int", axes[:, :2], along)
        slope[:, face.part] = np.cross(pull, moment[:, None], axis=0)
    turned = np.einsum("ijq,iqt->jqt", system.turn, slope)
    return np.asarray(np.sign(turned) * world.upper.shift[:, system.points, None])


def limit_name(world: World, system: System, there: Motion, values: Parameters, utilisation: float) -> LimitName:
    """Return the name of the limit of a single support or hold at one instant: tipping, slip or twist.

    Its utilisation is that without bounds on friction if it tips, and that without prescribed pressure if it slips.
    """
    if not system.known or system.at is not None:
        return system.name
    many = values.repeated(1)
    patch = world.contacts[system.contacts[0]].patch
    endless = replace(many, friction=np.full_like(many.friction, ENDLESS))
    if np.isclose(balance(world, system, there, endless, GAP).value[0], utilisation, rtol=SAME):
        return names.failure(LimitKind.TIPPING, patch)
    free = replace(system, hold=None)
    slips = system.hold is None or np.isclose(balance(world, free, there, many, GAP).value[0], utilisation, rtol=SAME)
    return names.failure(LimitKind.SLIP if slips else LimitKind.TWIST, patch)
