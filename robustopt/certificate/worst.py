"""Utilisation of the contacts at the worst ends of all intervals.

At the gauge gamma of a contact system, the direction y of the nearest limit satisfies y (gamma rest + move) = 0, and y
w >= 0 for all rows w in the cone. Other parameters are worse if they make y (gamma rest + move) lower, or if y lies
deeper inside their dual cone. To first order, the sign of its derivative sends each parameter to one end of its
interval. The gauge and its y are computed again for these ends, a few times.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from robustopt.arrays import Array, Flags, Indices
from robustopt.certificate import names
from robustopt.certificate.balance import balance, certainly_held, goals, required
from robustopt.certificate.bodies import Parameters
from robustopt.certificate.force_closure import GAP, Gauge
from robustopt.certificate.loads import Load, at_lowest, body_loads
from robustopt.certificate.motion import Motion
from robustopt.certificate.part import part_of
from robustopt.certificate.systems import System
from robustopt.certificate.tally import Found, Tally
from robustopt.certificate.world import World
from robustopt.limits.names import LimitKind, LimitName

MOST_WEIGHT = 2.0
"""Gauge at which the search continues if no forces hold the contact."""

SHARED = 3
"""Number of instants whose worst parameters are tried at all instants."""

PROMISING = 0.95
"""A quick search continues at instants whose utilisation is at least this share of the worst one so far."""

NEWS = 1e-7
"""A sample counts if its utilisation exceeds the worst one so far by this much: ten times the accuracy of the gauge."""

SAME = 1e-3
"""A limit counts as the cause if it alone gives the same utilisation, to this relative accuracy."""

ENDLESS = 1e3
"""Coefficient of friction at which nothing slides."""


@dataclass(frozen=True)
class Thoroughness:
    """Steps and accuracy of a search.

    The gauges that may be the worst are afterwards computed to full accuracy.

    Attributes:
        every: step between the instants at which a search starts.
        rounds: number of steps of each search.
        gap: accuracy of the gauge during the search.
    """

    every: int
    rounds: int
    gap: float


class Search:
    """Search for the worst values of a contact system at each of its instants.

    Attributes:
        part: part of the world that the system depends on.
        world: this part as a world; all values of a search are of its parameters.
        system: the system in this world.
        index: the instants (T,).
        grid: True at grid points (T,).
        worst: worst values found so far, T sets.
        upper: upper bound of their gauge (T,).
        lower: lower bound of their gauge (T,).
    """

    def __init__(self, world: World, system: System, motion: Motion, gap: float, tally: Tally) -> None:
        """Begin a search; `motion` covers all instants, and `gap` is the accuracy of the gauge."""
        self.part, self.gap, self.tally = part_of(world, system), gap, tally
        self.world = self.part.world(world, system)
        (self.system,) = self.world.systems
        self.index = np.arange(len(motion.free)) if system.at is None else system.at
        self.motion = motion if system.at is None else motion.at(system.at)
        self.grid = tally.grid[self.index]
        self.worst = self.world.nominal.repeated(len(self.index))
        self.upper, self.lower = np.full(len(self.index), -np.inf), np.full(len(self.index), -np.inf)

    def run(self, starts: Sequence[Parameters], how: Thoroughness) -> Indices:
        """Search from each of `starts`, and return the searched instants (S,), as indices among its own.

        The starts are values of the parameters of the whole world. The search runs at every `how.every`-th instant.
        Then every instant is tried with the worst values of its nearest searched instant. The worst values of all are
        tried at every instant as well, or only at the searched ones if the system has no quick test.
        """
        everywhere, rounds = np.arange(len(self.index)), how.rounds if self.world.uncertain else 0
        chosen = everywhere[:: how.every]
        for start in starts:
            self.follow(chosen, self.part.values(start).at(self.index[chosen]), rounds)
        if how.every > 1:
            nearest = np.minimum((everywhere + how.every // 2) // how.every, len(chosen) - 1) * how.every
            self.follow(everywhere, self.worst.at(nearest), min(rounds, int(self.system.simple)), cull=True)
        if self.world.uncertain:
            tried = everywhere if self.system.simple else chosen
            for t in np.argsort(-self.upper, kind="stable")[:SHARED]:
                self.follow(tried, self.worst.at(int(t)).repeated(len(tried)), 0, cull=True)
        self._refine()
        return chosen

    def _refine(self) -> None:
        """Compute the gauges that may be the worst to full accuracy; later gauges have this accuracy too."""
        self.gap = GAP
        close = np.flatnonzero(self.upper >= self._level())
        solution = balance(self.world, self.system, self.motion.at(close), self.worst.at(close), GAP)
        self.upper[close], self.lower[close] = solution.value, solution.lower

    def sample(self, index: Indices, there: Motion, values: Parameters, loads: Sequence[Load]) -> None:
        """Try many sets of values at its instants `index`, after `run`, with the motion and the loads there."""
        level = np.maximum(self._level()[index], 0.0)
        doubtful = self._doubtful(index, there, values, loads, level + NEWS)
        if len(doubtful):
            self._try(index[doubtful], values.at(doubtful), level[doubtful])

    def follow(self, index: Indices, values: Parameters, rounds: int, cull: bool = False) -> None:
        """Try `values` at the instants `index`, and then, `rounds` times, the ends of the intervals that look worse.

        With `cull`, the search skips instants that are clearly better than the worst one so far, on the grid or
        between.
        """
        for left in range(rounds, -1, -1):
            if cull:
                there = self.motion.at(index)
                loads = body_loads(self.world, there, values)
                doubtful = self._doubtful(index, there, values, loads, self._level()[index])
                index, values = index[doubtful], values.at(doubtful)
            if not len(index):
                return
            solution = self._try(index, values, self._level()[index] if cull else 0.0)
            if left:
                ends = worse_ends(self.world, self.system, self.motion.at(index), values, solution)
                new = _differ(values, ends)
                if cull:
                    new &= solution.value >= PROMISING * self._level()[index]
                index, values = index[new], ends.at(np.flatnonzero(new))

    def _doubtful(
        self, index: Indices, there: Motion, values: Parameters, loads: Sequence[Load], level: Array
    ) -> Indices:
        """Return the positions in `index` at which no explicit forces show a utilisation below the level."""
        rest, move = required(self.world, self.system, there, loads, values)
        level = np.maximum(level, 0.0)
        contacts = self.system.contact_points(values.friction, values.shift)
        held = certainly_held(self.system, contacts, rest) & certainly_held(self.system, contacts, level * rest + move)
        self.tally.tests += len(index)
        return np.flatnonzero(~held)

    def _try(self, index: Indices, values: Parameters, enough: Array | float) -> Gauge:
        solution = balance(self.world, self.system, self.motion.at(index), values, self.gap, enough)
        better = np.argsort(solution.value, kind="stable")  # the worst comes last, and stays
        better = better[solution.value[better] > self.upper[index[better]]]
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
        """Add the worst utilisation at grid points and between them to the tally."""
        for kind in (self.grid, ~self.grid):
            if not kind.any():
                continue
            worst = np.flatnonzero(kind)[np.argmax(self.upper[kind])]
            values, value = self.worst.at(int(worst)), float(self.upper[worst])
            cause = partial(limit_name, self.world, self.system, self.motion.at(worst[None]), values, value)
            words, name = self.world.describe(values, self.system), self.system.name
            self.tally.add(name, Found(value, int(self.index[worst]), name, words, cause))


def _differ(first: Parameters, second: Parameters) -> Flags:
    """Return whether two sets of values differ, for T pairs of sets, (T,)."""
    pairs = zip(first.arrays(), second.arrays(), strict=True)
    return np.asarray(np.any([(a != b).reshape(-1, a.shape[-1]).any(axis=0) for a, b in pairs], axis=0))


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
    """Return the displacement of each contact point with which y lies deepest inside the point's dual cone, (2, n, T).

    With v = y_force + y_moment x p, whose z is along the normal, the dual cone is v_z >= mu |v_t|. The sign of the
    derivative of v_z - mu |v_t| with respect to p decides for each axis of the support.
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

    It is tipping if the utilisation is the same with unlimited friction, and slip if it is the same with free pressure.
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
