"""Collisions of the arm, the tray and the objects along a path, found by MuJoCo.

The tray and the objects are bodies fixed to the tool, at rest where the configuration puts them. Bodies that cannot
move against each other are not checked, nor are neighbours in the chain of links, nor pairs of links that overlap in
every position of the arm: coarse shapes that overlap by construction.
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from robustopt.config import Config
from robustopt.errors import ConfigProblem, RobotError
from robustopt.path.inverse_kinematics import spread
from robustopt.robot import Robot
from robustopt.robot.model_file import TRAY_SITE, USUAL
from robustopt.scene.placement import placements

TOUCH = 1e-4
"""Overlap that counts as touching [m]: rounding and the tolerance of the path, well below any collision of interest."""
POSTURES = 32
"""Postures in which two links must overlap, in all of them, to count as overlapping by construction."""
PREFIX = "robustopt_"
"""Keeps the names of the tray and the objects apart from those of the robot's bodies."""
EVERYTHING = 0x7FFFFFFF
"""Collision bits of the tray and the objects: they collide with whatever of the robot collides at all."""


@dataclass(frozen=True)
class Collision:
    """The first collision along a sequence of joint positions: its `index`, the two bodies, the overlap [m]."""

    index: int
    bodies: tuple[str, str]
    depth: float


class CollisionCheck:
    """Collision check of the robot with the tray and the objects of a configuration.

    `overlapping`: pairs of links that overlap by construction and are not checked.
    Raises RobotError if `robot.collision.exclude` names a body that does not exist.
    """

    def __init__(self, config: Config, robot: Robot) -> None:
        self._model = _with_load(config, robot)
        self._data = mujoco.MjData(self._model)
        self._names = [_shown(self._model.body(i).name) for i in range(self._model.nbody)]
        self._ignored = _adjacent(self._model) | self._excluded(config)
        overlapping = self._always_overlapping(spread(robot, POSTURES))
        self.overlapping = tuple(sorted(self._name(pair) for pair in overlapping))
        self._ignored |= overlapping

    def first(self, q: np.ndarray) -> Collision | None:
        """The first collision at the joint positions `q` (P, n), or None."""
        for index, qi in enumerate(q):
            overlaps = self._overlaps(qi)
            if overlaps:
                pair = max(overlaps, key=lambda pair: overlaps[pair])
                return Collision(index, self._name(pair), overlaps[pair])
        return None

    def _overlaps(self, q: np.ndarray) -> dict[tuple[int, int], float]:
        """Overlap of each pair of bodies that collide at `q` (n,), deepest contact [m]."""
        model, data = self._model, self._data
        data.qpos[:] = q
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_collision(model, data)
        if not data.ncon:
            return {}
        overlaps: dict[tuple[int, int], float] = {}
        bodies = np.sort(model.geom_bodyid[data.contact.geom], axis=1)
        for pair, distance in zip(map(tuple, bodies.tolist()), data.contact.dist.tolist(), strict=True):
            if distance < -TOUCH and pair not in self._ignored:
                overlaps[pair] = max(-distance, overlaps.get(pair, 0.0))
        return overlaps

    def _always_overlapping(self, postures: np.ndarray) -> set[tuple[int, int]]:
        overlapping: set[tuple[int, int]] | None = None
        for q in postures:
            found = {pair for pair in self._overlaps(q) if not any(map(self._is_load, pair))}
            overlapping = found if overlapping is None else overlapping & found
        return overlapping or set()

    def _excluded(self, config: Config) -> set[tuple[int, int]]:
        pairs, problems = set(), []
        for i, names in enumerate(config.robot.collision.exclude):
            unknown = [name for name in names if name not in self._names]
            problems += [
                ConfigProblem(
                    f"robot.collision.exclude[{i}]",
                    f"there is no body {name!r}; the bodies are: {', '.join(filter(None, self._names))}",
                )
                for name in unknown
            ]
            if not unknown:
                first, second = sorted(self._names.index(name) for name in names)
                pairs.add((first, second))
        if problems:
            raise RobotError(problems)
        return pairs

    def _is_load(self, body: int) -> bool:
        return str(self._model.body(body).name).startswith(PREFIX)

    def _name(self, pair: tuple[int, int]) -> tuple[str, str]:
        return self._names[pair[0]], self._names[pair[1]]


def _with_load(config: Config, robot: Robot) -> mujoco.MjModel:
    """The robot's model with the tray and the objects as bodies fixed to the tool."""
    spec = robot.spec.copy()
    spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_FILTERPARENT)
    site = spec.site(TRAY_SITE)
    tray = site.parent.add_body(name=f"{PREFIX}tray", pos=site.pos, quat=site.quat)
    solid = {"default": USUAL.default, "contype": EVERYTHING, "conaffinity": EVERYTHING}
    tray.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=np.array(config.carried_tray.size) / 2, **solid)
    for name, placement in placements(config).items():
        shape = config.objects[name]
        half_turn = placement.yaw / 2
        body = tray.add_body(
            name=f"{PREFIX}{name}", pos=placement.position, quat=[np.cos(half_turn), 0, 0, np.sin(half_turn)]
        )
        if shape.size is not None:
            body.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=np.array(shape.size) / 2, **solid)
        else:
            size = [shape.radius, placement.half_height, 0]
            body.add_geom(type=mujoco.mjtGeom.mjGEOM_CYLINDER, size=size, **solid)
    return spec.compile()


def _adjacent(model: mujoco.MjModel) -> set[tuple[int, int]]:
    """Pairs of neighbours in the chain of links; links that are fixed to each other count as one.

    The tray and the objects are neighbours of nothing: they may well hit the last but one link.
    """
    links = [i for i in range(model.nbody) if not str(model.body(i).name).startswith(PREFIX)]
    carrier = model.body_weldid[model.body_parentid[model.body_weldid]]
    return {
        (one, other)
        for one in links
        for other in links
        if one < other and carrier[other] == model.body_weldid[one] and _carries(model, one, other)
    }


def _carries(model: mujoco.MjModel, body: int, child: int) -> bool:
    """Whether `body` moves, or, if it stands still, is one of those that `child` hangs from."""
    ancestors = {0}
    while child:
        child = int(model.body_parentid[child])
        ancestors.add(child)
    return bool(model.body_weldid[body]) or body in ancestors


def _shown(name: str) -> str:
    return name.removeprefix(PREFIX)
