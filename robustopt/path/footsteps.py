"""Footsteps: which feet stand where, when a foot swings, and where the centre of mass goes meanwhile.

The path has 2 K + 1 phases for K steps, all of the same length in s: both feet, one foot, both feet, and so on. The
swinging foot moves along a polynomial of fifth degree (x, y) and one of sixth degree (z), at rest at both ends. The
centre of mass follows a cubic spline that passes inside the standing foot while the other one swings (our choice).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from robustopt.config import Config, StanceConfig

Array = np.ndarray

ENTRY, EXIT = -0.02, 0.03
"""Where the centre of mass is along the standing foot when the other one lifts and when it lands, from its middle and
in the direction of travel [m]: it falls forward meanwhile."""

SLACK = 1.0 / 3.0
"""Part of `path.inset` by which the centre of mass is inside the middle of the standing foot halfway through a swing: a
straight line there would have to be entered with a sharper turn."""


@dataclass(frozen=True)
class Stance:
    """A phase of the path: `begin` to `end` in s, the feet that stand, and the step during which only one does.

    places: where the standing feet are, middle of the sole on the floor, (2,) by name [m]; step: index, -1 for none
    """

    begin: float
    end: float
    places: dict[str, Array]
    step: int

    @property
    def feet(self) -> tuple[str, ...]:
        return tuple(self.places)


@dataclass(frozen=True)
class Footsteps:
    """The phases of a path, K steps: `start`, `steps`: places of the feet before and after each step, (2,) by name;
    `swings`: foot of each step; `com`: x, y of the centre of mass as a spline over s; `lift` [m]
    """

    places: tuple[dict[str, Array], ...]
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

    def soles(self, s: float) -> dict[str, Array]:
        """Middle of both soles at s, (3,) each, world [m]."""
        phase = min(int(s * self.phases), self.phases - 1)
        after = self.places[(phase + 1) // 2]
        result = {name: np.append(place, 0.0) for name, place in after.items()}
        if phase % 2:
            foot, t = self.swings[phase // 2], s * self.phases - phase
            before = self.places[phase // 2][foot]
            way = t**3 * (10.0 - 15.0 * t + 6.0 * t * t)
            result[foot] = np.append(before + way * (after[foot] - before), self.lift * 64.0 * (t * (1.0 - t)) ** 3)
        return result


def footsteps(config: Config) -> Footsteps:
    """The footsteps of a configuration with `path.steps`."""
    start, steps = config.path.start, config.path.steps
    assert isinstance(start, StanceConfig)
    assert steps is not None
    places = [{"left_foot": np.array(start.left), "right_foot": np.array(start.right)}]
    for step in steps:
        places.append(places[-1] | {f"{step.foot}_foot": np.array(step.to)})
    swings = tuple(f"{step.foot}_foot" for step in steps)
    return Footsteps(tuple(places), swings, _com(places, swings, config.path.inset), config.path.lift)


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
