"""Footsteps: what rests where, when a foot swings, and where the centre of mass goes meanwhile.

The path has 2 K + 1 phases for K steps, all of the same length in s: both feet, one foot, both feet, and so on. The
swinging foot moves along a polynomial of fifth degree (x, y) and one of sixth degree (z), at rest at both ends. The
centre of mass follows a cubic spline that passes inside the standing foot while the other one swings (our choice). A
hand on a rail stays in its place all the way.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from robustopt.config import FEET, Config, StanceConfig
from robustopt.geometry import contact_axes

Array = np.ndarray

ENTRY, EXIT = -0.02, 0.03
"""Where the centre of mass is along the standing foot when the other one lifts and when it lands, from its middle and
in the direction of travel [m]: it falls forward meanwhile."""

SLACK = 1.0 / 3.0
"""Part of `path.inset` by which the centre of mass is inside the middle of the standing foot halfway through a swing: a
straight line there would have to be entered with a sharper turn."""


@dataclass(frozen=True, eq=False)
class Place:
    """Where a contact rests, or a foot is in the air: `position` of its middle in the world (3,) [m], `axes` of its
    frame as columns (3, 3), z away from what it rests on."""

    position: Array
    axes: Array

    def world(self, points: Array) -> Array:
        """Points in the frame of the contact, (k, 2) in its plane or (k, 3), in the world (k, 3)."""
        flat = points.shape[1] == 2
        return self.position + points @ (self.axes[:, :2] if flat else self.axes).T


def on_floor(position: Array) -> Place:
    """The place of a level sole, its middle at (2,) or (3,) [m]."""
    return Place(np.append(position, np.zeros(3 - len(position))), np.eye(3))


@dataclass(frozen=True)
class Stance:
    """A phase of the path: `begin` to `end` in s, what rests where, and the step during which only one foot does.

    places: of the contacts that hold, by name, feet first; step: index, -1 for none
    """

    begin: float
    end: float
    places: dict[str, Place]
    step: int

    @property
    def contacts(self) -> tuple[str, ...]:
        return tuple(self.places)

    @property
    def words(self) -> str:
        """Its contacts as a person names them: "both feet", "left foot and right hand"."""
        feet = [name for name in self.places if name in FEET]
        others = [name for name in self.places if name not in FEET]
        named = ["both feet" if len(feet) == 2 else feet[0], *others]
        return " and ".join(name.replace("_", " ") for name in named)


@dataclass(frozen=True)
class Footsteps:
    """The phases of a path, K steps: `places`: of the contacts before the first and after each step, by name; `swings`:
    foot of each step; `com`: x, y of the centre of mass as a spline over s; `lift` [m]
    """

    places: tuple[dict[str, Place], ...]
    swings: tuple[str, ...]
    com: CubicSpline
    lift: float

    @property
    def phases(self) -> int:
        return 2 * len(self.swings) + 1

    @property
    def stances(self) -> tuple[Stance, ...]:
        """All phases in order; where one ends the next one begins."""
        result = []
        for k in range(self.phases):
            places, step = self.places[k // 2], -1
            if k % 2:
                step = k // 2
                places = {name: place for name, place in places.items() if name != self.swings[step]}
            result.append(Stance(k / self.phases, (k + 1) / self.phases, places, step))
        return tuple(result)

    def label(self, s: float) -> str:
        """Where `s` is, e.g. "during steps[0], right foot in the air, at 40 %"."""
        phase = min(int(s * self.phases), self.phases - 1)
        share = f"at {100 * (s * self.phases - phase):.0f} %"
        step, count = phase // 2, len(self.swings)
        if phase % 2:
            return f"during steps[{step}], {self.swings[step].replace('_', ' ')} in the air, {share}"
        if step == 0:
            return f"before steps[0], on both feet, {share}"
        if step == count:
            return f"after steps[{count - 1}], on both feet, {share}"
        return f"between steps[{step - 1}] and steps[{step}], on both feet, {share}"

    def at(self, s: float) -> dict[str, Place]:
        """Where all contacts are at s, that of a swinging foot in the air."""
        phase = min(int(s * self.phases), self.phases - 1)
        result = dict(self.places[(phase + 1) // 2])
        if phase % 2:
            foot, t = self.swings[phase // 2], s * self.phases - phase
            before, after = self.places[phase // 2][foot].position[:2], result[foot].position[:2]
            way = t**3 * (10.0 - 15.0 * t + 6.0 * t * t)
            height = self.lift * 64.0 * (t * (1.0 - t)) ** 3
            result[foot] = on_floor(np.append(before + way * (after - before), height))
        return result


def footsteps(config: Config) -> Footsteps:
    """The footsteps of a configuration with `path.steps`."""
    start, steps = config.path.start, config.path.steps
    assert isinstance(start, StanceConfig)
    assert steps is not None
    feet = [{"left_foot": np.array(start.left), "right_foot": np.array(start.right)}]
    for step in steps:
        feet.append(feet[-1] | {f"{step.foot}_foot": np.array(step.to)})
    swings = tuple(f"{step.foot}_foot" for step in steps)
    rail = config.path.rail
    hand = {rail.contact: Place(np.array(rail.at), contact_axes(rail.normal, rail.along))} if rail else {}
    places = tuple({name: on_floor(place) for name, place in standing.items()} | hand for standing in feet)
    return Footsteps(places, swings, _com(feet, swings, config.path.inset), config.path.lift)


def _com(places: list[dict[str, Array]], swings: tuple[str, ...], inset: float) -> CubicSpline:
    """Centre of mass over s, (2,) [m]: from the middle of the feet over each standing foot to the middle again."""
    phases = 2 * len(swings) + 1
    middles = [np.mean(list(standing.values()), axis=0) for standing in places]
    travel = middles[-1] - middles[0]
    length = np.linalg.norm(travel)
    ahead = travel / length if length > 1e-3 else np.array([1.0, 0.0])
    s, points = [0.0], [middles[0]]
    for k, foot in enumerate(swings):
        standing = next(place for name, place in places[k].items() if name != foot)
        inward = middles[k] + 0.5 * (middles[k + 1] - middles[k]) - standing
        inward = inward - ahead * (inward @ ahead)
        inward = inward / max(float(np.linalg.norm(inward)), 1e-9)
        for t, along, inside in ((0.0, ENTRY, 1.0), (0.5, 0.5 * (ENTRY + EXIT), SLACK), (1.0, EXIT, 1.0)):
            s.append((2 * k + 1 + t) / phases)
            points.append(standing + along * ahead + inside * inset * inward)
    return CubicSpline([*s, 1.0], np.array([*points, middles[-1]]), bc_type="natural")
