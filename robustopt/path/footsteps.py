"""Footsteps: places of the feet, phases of the path, and path of the centre of mass.

The path has 2 K + 1 phases for K steps, all of the same length in s: both feet, one foot, both feet, and so on. The
swinging foot moves along polynomials of fifth degree (x, y) and sixth degree (z), at rest at both ends. The centre of
mass follows a cubic spline that passes inside the standing foot while the other one swings (our choice). A hand on a
rail stays in its place along the whole path.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from robustopt.arrays import Array
from robustopt.config import FEET, Config, StanceConfig
from robustopt.geometry import contact_axes

ENTRY, EXIT = -0.02, 0.03
"""Offset of the centre of mass from the middle of the standing foot along the direction of travel, when the other lifts
and when it lands [m]: the robot falls forward in between."""

SLACK = 1.0 / 3.0
"""Part of `path.inset` that is left halfway through a swing: a straight line past the standing foot would have to be
entered with a sharper turn."""


@dataclass(frozen=True, eq=False)
class Place:
    """A place of a contact, at rest or in the air.

    Attributes:
        position: middle of the contact in the world (3,) [m].
        axes: axes of the contact as columns, z away from the surface on which it rests (3, 3).
    """

    position: Array
    axes: Array

    def world(self, points: Array) -> Array:
        """Return points of the contact in the world, (k, 3) [m].

        Args:
            points: points in the frame of the contact (k, 3), or in its plane (k, 2) [m].
        """
        flat = points.shape[1] == 2
        return self.position + points @ (self.axes[:, :2] if flat else self.axes).T


def _on_floor(position: Array) -> Place:
    """Return the place of a level sole with its middle at `position` (2,) or (3,) [m]."""
    return Place(np.append(position, np.zeros(3 - len(position))), np.eye(3))


@dataclass(frozen=True)
class Stance:
    """A phase of the path with a constant set of contacts.

    Attributes:
        begin: s at the begin.
        end: s at the end.
        places: places of the contacts that hold, by name, feet first.
        step: index of the step in which one foot swings, -1 if none does.
    """

    begin: float
    end: float
    places: dict[str, Place]
    step: int

    @property
    def contacts(self) -> tuple[str, ...]:
        """Return the names of the contacts that hold."""
        return tuple(self.places)

    @property
    def words(self) -> str:
        """Return its contacts in words: "both feet", "left foot and right hand"."""
        feet = [name for name in self.places if name in FEET]
        others = [name for name in self.places if name not in FEET]
        named = ["both feet" if len(feet) == 2 else feet[0], *others]
        return " and ".join(name.replace("_", " ") for name in named)


@dataclass(frozen=True)
class Footsteps:
    """The phases of a path with K steps.

    Attributes:
        places: places of the contacts, by name, before the first and after each step (K + 1).
        swings: name of the foot of each step (K).
        com: x, y of the centre of mass as a spline over s [m].
        lift: height of a swinging foot [m].
    """

    places: tuple[dict[str, Place], ...]
    swings: tuple[str, ...]
    com: CubicSpline
    lift: float

    @property
    def phases(self) -> int:
        """Return the number of phases, 2 K + 1."""
        return 2 * len(self.swings) + 1

    @property
    def stances(self) -> tuple[Stance, ...]:
        """Return all phases in order, without gaps."""
        result = []
        for k in range(self.phases):
            places, step = self.places[k // 2], -1
            if k % 2:
                step = k // 2
                places = {name: place for name, place in places.items() if name != self.swings[step]}
            result.append(Stance(k / self.phases, (k + 1) / self.phases, places, step))
        return tuple(result)

    def label(self, s: float) -> str:
        """Describe a position along the path, such as "during steps[0], right foot in the air, at 40 %".

        Args:
            s: the position along the path.
        """
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
        """Return the places of all contacts, including a swinging foot in the air.

        Args:
            s: position along the path.
        """
        phase = min(int(s * self.phases), self.phases - 1)
        result = dict(self.places[(phase + 1) // 2])
        if phase % 2:
            foot, t = self.swings[phase // 2], s * self.phases - phase
            before, after = self.places[phase // 2][foot].position[:2], result[foot].position[:2]
            way = t**3 * (10.0 - 15.0 * t + 6.0 * t * t)
            height = self.lift * 64.0 * (t * (1.0 - t)) ** 3
            result[foot] = _on_floor(np.append(before + way * (after - before), height))
        return result


def footsteps(config: Config) -> Footsteps:
    """Return the footsteps of a walking robot.

    Args:
        config: the configuration, with `path.steps`.
    """
    start, steps = config.path.start, config.path.steps
    assert isinstance(start, StanceConfig), "checked when the configuration was read"
    assert steps is not None, "the path of the configuration has no steps"
    feet = [{"left_foot": np.array(start.left), "right_foot": np.array(start.right)}]
    for step in steps:
        feet.append(feet[-1] | {f"{step.foot}_foot": np.array(step.to)})
    swings = tuple(f"{step.foot}_foot" for step in steps)
    rail = config.path.rail
    hand = {rail.contact: Place(np.array(rail.at), contact_axes(rail.normal, rail.along))} if rail else {}
    places = tuple({name: _on_floor(place) for name, place in standing.items()} | hand for standing in feet)
    return Footsteps(places, swings, _com(feet, swings, config.path.inset), config.path.lift)


def _com(places: list[dict[str, Array]], swings: tuple[str, ...], inset: float) -> CubicSpline:
    """Return the centre of mass over s, (2,) [m]: from the middle of the feet over each standing foot to the middle."""
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
