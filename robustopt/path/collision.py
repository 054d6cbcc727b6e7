"""Collisions of the robot, the tray and the objects along a path, found by MuJoCo.

The tray and the objects are bodies fixed to the tool, at rest in their configured places. They are checked against all
other bodies: once against those that are fixed to the tool too, along the path against the rest. The tray may overlap
the body that it is mounted on, and a held part may be pressed a little into what holds it. Three kinds of pairs of
links are not checked: links that cannot move relative to each other, neighbours in the chain, and links whose coarse
shapes overlap in every posture.
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from robustopt.arrays import Array
from robustopt.config import Config, RailConfig
from robustopt.errors import ConfigProblem, RobotError
from robustopt.path.inverse_kinematics import spread
from robustopt.robot import Robot
from robustopt.robot.model_file import USUAL
from robustopt.robot.preparation import CARRIER_SITE
from robustopt.scene.placement import TRAY, placements
from robustopt.scene.rail import rail_box

TOUCH = 1e-4
"""Overlap that counts as touching [m]: rounding and the tolerance of the path, well below any collision of interest."""
PRESSED = 0.005
"""Depth to which a held part may overlap the bodies that hold it [m]: lips and pads yield (our choice)."""
POSTURES = 32
"""Postures in which two links must overlap, in all of them, to count as overlapping by construction."""
PREFIX = "robustopt_"
"""Keeps the names of the tray and the objects apart from those of the robot's bodies."""
RAIL = f"{PREFIX}rail"
"""Name of a rail among the geoms of a model."""
EVERYTHING = 0x7FFFFFFF
"""Collision bits of the tray and the objects: they collide with every part of the robot that collides at all."""


@dataclass(frozen=True)
class Collision:
    """A collision in a sequence of postures.

    Attributes:
        index: index of the posture.
        bodies: names of the two bodies.
        depth: overlap [m].
    """

    index: int
    bodies: tuple[str, str]
    depth: float


class CollisionCheck:
    """A collision check of the robot with the tray and the objects of a configuration.

    Attributes:
        overlapping: pairs of links that overlap by construction and are not checked.

    Raises:
        RobotError: `robot.collision.exclude` names a body that does not exist, or the tray or an object overlaps a body
            that is fixed to the tool.
    """

    def __init__(self, config: Config, robot: Robot) -> None:
        self._model = _with_load(config, robot)
        self._data = mujoco.MjData(self._model)
        self._names = [_shown(self._model.body(i).name) for i in range(self._model.nbody)]
        self._ignored = _adjacent(self._model) | self._excluded(config)
        if robot.has_carrier:
            self._require_apart_from_the_tool(config)
        overlapping = self._always_overlapping(spread(robot, POSTURES))
        self.overlapping = tuple(sorted(self._name(pair) for pair in overlapping))
        self._ignored |= overlapping

    def first(self, q: Array) -> Collision | None:
        """Return the first collision along a path, or None.

        Args:
            q: coordinates along the path (P, n) [rad or m].
        """
        for index, qi in enumerate(q):
            overlaps = self._overlaps(qi)
            if overlaps:
                pair = max(overlaps, key=lambda pair: overlaps[pair])
                return Collision(index, self._name(pair), overlaps[pair])
        return None

    def _require_apart_from_the_tool(self, config: Config) -> None:
        """Check the tray and the objects against the bodies that are fixed to the tool, in whatever posture."""
        problems = []
        for (link, load), depth in self._fixed_overlaps(config).items():
            first, second = self._name((link, load))
            tray = config.tray is not None
            remedy = "tray.pose" if tray else f"objects.{second}"
            problems.append(
                ConfigProblem(
                    remedy if tray or second in config.objects else "robot.tool",
                    f"{first} and {second}, which move together, overlap, {1000 * depth:.1f} mm deep; change "
                    f"{remedy}{f' or objects.{second}' if tray and second in config.objects else ''}, or, if they may "
                    f"touch, add [{first}, {second}] to robot.collision.exclude",
                )
            )
        if problems:
            raise RobotError(problems)

    def _fixed_overlaps(self, config: Config) -> dict[tuple[int, int], float]:
        """Return the overlap of each load with each body that is fixed to the tool, deepest geoms [m]."""
        model, data = self._model, self._data
        mujoco.mj_kinematics(model, data)
        carrier = next(i for i in range(model.nbody) if self._is_load(i))
        fixed = np.flatnonzero(model.body_weldid[model.geom_bodyid] == model.body_weldid[carrier])
        colliding = (model.geom_contype[fixed] | model.geom_conaffinity[fixed]) != 0
        mount, overlaps = _mount(model, carrier), dict[tuple[int, int], float]()
        bodies = [(int(geom), int(model.geom_bodyid[geom])) for geom in fixed[colliding]]
        for other, link in bodies:
            for geom, load in bodies:
                pair = (min(link, load), max(link, load))
                mounted = link == mount and self._names[load] == TRAY and config.tray is not None
                if self._is_load(link) or not self._is_load(load) or pair in self._ignored or mounted:
                    continue
                name = self._names[load]
                held = name in config.objects and config.objects[name].held_by is not None
                depth = -mujoco.mj_geomDistance(model, data, geom, other, TOUCH, None)
                if depth > (PRESSED if held else TOUCH):
                    overlaps[link, load] = max(depth, overlaps.get((link, load), 0.0))
        return overlaps

    def _overlaps(self, q: Array) -> dict[tuple[int, int], float]:
        """Return the overlap of each pair of bodies that collide at `q` (n,), deepest contact [m]."""
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

    def _always_overlapping(self, postures: Array) -> set[tuple[int, int]]:
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
    """Compile the robot's model with the tray and the objects as bodies fixed to the tool."""
    spec = robot.spec.copy()
    spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_FILTERPARENT)
    if robot.has_carrier:
        site = spec.site(CARRIER_SITE)
        name = "carrier" if config.tray is None else "tray"
        carrier = site.parent.add_body(name=f"{PREFIX}{name}", pos=site.pos, quat=site.quat)
        if config.tray is not None:
            _add_solid(carrier, mujoco.mjtGeom.mjGEOM_BOX, np.array(config.tray.size) / 2)
        if config.objects:
            _add_objects(carrier, config)
    return spec.compile()


def _add_objects(carrier: mujoco.MjsBody, config: Config) -> None:
    for name, placement in placements(config).items():
        shape = config.objects[name]
        quaternion = np.zeros(4)
        mujoco.mju_mat2Quat(quaternion, placement.rotation.ravel())
        body = carrier.add_body(name=f"{PREFIX}{name}", pos=placement.position, quat=quaternion)
        if shape.size is not None:
            _add_solid(body, mujoco.mjtGeom.mjGEOM_BOX, np.array(shape.size) / 2)
        else:
            _add_solid(body, mujoco.mjtGeom.mjGEOM_CYLINDER, np.array([shape.radius, placement.half_height, 0.0]))


def _add_solid(body: mujoco.MjsBody, kind: mujoco.mjtGeom, size: Array) -> None:
    body.add_geom(USUAL.default, type=kind, size=size, contype=EVERYTHING, conaffinity=EVERYTHING)


def _adjacent(model: mujoco.MjModel) -> set[tuple[int, int]]:
    """Return the pairs of neighbours in the chain of links; links that are fixed to each other count as one.

    The tray and the objects have no neighbours, because they can collide with the last but one link.
    """
    links = [i for i in range(model.nbody) if not str(model.body(i).name).startswith(PREFIX)]
    carrier = model.body_weldid[model.body_parentid[model.body_weldid]]
    return {
        (one, other)
        for one in links
        for other in links
        if one < other and carrier[other] == model.body_weldid[one] and _carries(model, one, other)
    }


def _mount(model: mujoco.MjModel, carrier: int) -> int:
    """Return the body that the tray is mounted on: the tool, or the next body before it that has a shape."""
    body = int(model.body_parentid[carrier])
    while not model.body_geomnum[body] and model.body_weldid[body] == model.body_weldid[carrier] and body:
        body = int(model.body_parentid[body])
    return body


def _carries(model: mujoco.MjModel, body: int, child: int) -> bool:
    """Return whether `body` moves, or stands still and is an ancestor of `child`."""
    ancestors = {0}
    while child:
        child = int(model.body_parentid[child])
        ancestors.add(child)
    return bool(model.body_weldid[body]) or body in ancestors


def _shown(name: str) -> str:
    return name.removeprefix(PREFIX)


def first_touch(robot: Robot, q: Array, rail: RailConfig) -> Collision | None:
    """Find the first posture in which a body overlaps a rail.

    The hand that rests on the rail and its parent body may touch it. Every geom counts, even one that collides with
    nothing else.

    Args:
        robot: walking robot whose hand rests on the rail.
        q: coordinates (T, n).
        rail: the rail.
    """
    spec, quaternion, (middle, axes, half) = robot.spec.copy(), np.zeros(4), rail_box(rail)
    mujoco.mju_mat2Quat(quaternion, axes.ravel())
    box = mujoco.mjtGeom.mjGEOM_BOX
    spec.worldbody.add_geom(USUAL.default, type=box, name=RAIL, size=half, pos=middle, quat=quaternion)
    model = spec.compile()
    data, bar = mujoco.MjData(model), model.geom(RAIL).id
    hand = int(model.site(rail.contact).bodyid[0])
    allowed = {0, hand, int(model.body_parentid[hand])}
    near = model.geom_rbound + model.geom_rbound[bar]
    for t, qt in enumerate(q):
        data.qpos[:] = qt
        mujoco.mj_kinematics(model, data)
        away = np.linalg.norm(data.geom_xpos - data.geom_xpos[bar], axis=1)
        for geom in np.flatnonzero(away < near):
            body = int(model.geom_bodyid[geom])
            gap = 0.0 if body in allowed else mujoco.mj_geomDistance(model, data, bar, int(geom), 1.0, None)
            if gap < -TOUCH:
                return Collision(t, (model.body(body).name, "the rail"), -gap)
    return None
