"""The simulated world as a MuJoCo model: arm with its controller, tray fixed to the tool, objects as free bodies.

Every interface has a contact pair of its own with its own coefficient of friction, because MuJoCo gives a contact of
two shapes the larger of their frictions. Contacts are elliptic cones with a stiffness set by the time step; with
these settings blocks slip and tip within 1 % of Coulomb's law and creep less than 0.1 mm/s (tests/test_fidelity.py).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations
from typing import NamedTuple

import mujoco
import numpy as np

from robustopt.config import Config, FailureConfig, ObjectConfig
from robustopt.errors import ConfigError
from robustopt.geometry import RESOLUTION, rotation
from robustopt.robot import Robot, load_robot
from robustopt.robot.model_file import USUAL
from robustopt.robot.preparation import CARRIER_SITE
from robustopt.scene.placement import CARRIER, TRAY, Placement, half_height, placements, supports
from robustopt.simulation.controller import WITH_TORQUE, Gains, JointLayout, Reference, computed_torque, controls
from robustopt.simulation.outcome import Criterion, Motion, motion_of_object, object_criteria, object_motion
from robustopt.simulation.simulation import Record, joint_velocities
from robustopt.simulation.truth import TrueBody, World, believed_world

Array = np.ndarray

PREFIX = "robustopt_"
"""Keeps the names of the tray and the objects apart from those of the robot's bodies."""
SOLREF_STEPS = 2.0
"""Time constant of a contact in time steps: the smallest that MuJoCo holds to be stable. Contacts drift by what the
support accelerates meanwhile, so a longer one lets objects creep on a curved path."""
SOLIMP = (0.95, 0.95, 0.001, 0.5, 2.0)
IMPEDANCE_RATIO = 10.0
"""Friction is this much stiffer than the normal direction, so that objects do not creep."""
TOLERANCE, ITERATIONS = 1e-10, 100
DISTANCE, AZIMUTH, ELEVATION = 0.6, 215.0, -18.0
"""Place of the camera: from the tray's path plus its length [m], about the vertical and above the horizon [deg]."""
ROUND_CORNERS = 16
"""MuJoCo touches with a round face as if it were a regular polygon of so many corners, up to four of them at a time."""
ROUND_GROWTH = 1.009
"""A round base is two such polygons turned against each other, this much wider: by half of what their 32 corners fall
short of the circle, and by what the load loses as it spreads over several (measured, see tests/test_fidelity.py)."""


class View(NamedTuple):
    """Place of a camera: the point it looks at (3,) and its distance from there [m], about the vertical and above the
    horizon [deg]."""

    lookat: Array
    distance: float
    azimuth: float
    elevation: float


@dataclass(frozen=True)
class Interface:
    """An object on a support: where its relative pose is in the sensor data, and the pose it is placed in.

    position: of the object's centre in the frame of the support (3,) [m]; yaw: turn against it [rad]; corners: points
    of its base whose movement is slip, from the object's centre (k, 3) [m]; radius: of a round base [m]; top: height of
    the support's upper face above its centre [m]
    """

    object: str
    support: str
    sensor: int
    position: Array
    yaw: float
    corners: Array
    radius: float | None
    top: float


@dataclass(frozen=True)
class Layout(JointLayout):
    """Where things are in the arrays of a compiled scene; bodies: of the tray and of each object.

    objects: first index in qpos of each object
    """

    objects: Mapping[str, int]
    interfaces: tuple[Interface, ...]


class SceneBuilder:
    """The world of a robot with a tray (see `scenes.Scene`); all models of one builder have the same layout."""

    driven = slice(None)
    pushed = "tray"

    def __init__(self, config: Config, gains: Gains, timestep: float) -> None:
        # The world has joint friction whether or not the planner counts it.
        frictional = config.model_copy(update={"robot": config.robot.model_copy(update={"joint_friction": True})})
        self._config = config
        self.robot: Robot = load_robot(frictional)
        self._placed = placements(config)
        self._gains = gains
        self.believed = believed_world(config)
        self.joint_names, self.torque_limit = self.robot.joint_names, self.robot.limits.torque
        self._base = self._with_arm(timestep)

    def model(self, world: World, sky: bool = False) -> mujoco.MjModel:
        """The compiled world; `sky`: with a light background, for pictures."""
        spec = self._base.copy()
        if sky:
            add_sky(spec)
        self._add_tray(spec, world)
        for name in self._placed:
            body = self._add_object(spec.worldbody, name, world, np.zeros(3), _quaternion(0.0))
            body.add_freejoint(name=PREFIX + name)
        self._add_pairs(spec, world)
        self._add_sensors(spec)
        return compiled(spec)

    def rigid(self) -> mujoco.MjModel:
        """Arm with tray and objects fixed to it, as the planner believes them to be: for the torque of a motion."""
        spec = self._base.copy()
        for item in list(spec.actuators):
            spec.delete(item)
        for joint in spec.joints:
            joint.actgravcomp = False
        tray = self._add_tray(spec, self.believed)
        for name, placement in self._placed.items():
            self._add_object(tray, name, self.believed, placement.position, _quaternion(placement.yaw))
        return spec.compile()

    def layout(self, model: mujoco.MjModel) -> Layout:
        """Where things are in a model of this builder."""
        names = self.robot.joint_names
        free = {name: model.joint(PREFIX + name) for name in self._placed}
        bodies = {name: model.body(PREFIX + name).id for name in ("tray", *self._placed)}
        actuators = [model.actuator(PREFIX + name).id for name in names]
        return Layout(
            joints=np.array([model.joint(name).qposadr[0] for name in names]),
            dofs=np.array([model.joint(name).dofadr[0] for name in names]),
            control=model.actuator_ctrladr[actuators],
            objects={name: int(joint.qposadr[0]) for name, joint in free.items()},
            bodies=bodies,
            interfaces=tuple(self._interfaces(model)),
        )

    def start(self, layout: Layout, q: Array, size: int) -> Array:
        """qpos (size,) of the arm at joint positions q (n,), with the objects in their places on the tray."""
        qpos = np.zeros(size)
        qpos[layout.joints] = q
        position, frame = (item[0] for item in self.robot.carrier_pose(q[None]))
        tray = np.zeros(4)
        mujoco.mju_mat2Quat(tray, frame.ravel())
        for name, placement in self._placed.items():
            at = layout.objects[name]
            qpos[at : at + 3] = position + frame @ placement.position
            mujoco.mju_mulQuat(qpos[at + 3 : at + 7], tray, _quaternion(placement.yaw))
        return qpos

    def controls(self, model: mujoco.MjModel, layout: Layout, planned: Reference) -> Array:
        """Control inputs at every time step, (N, nu)."""
        torque = computed_torque(self.rigid(), planned) if self._gains.inputs == WITH_TORQUE else None
        return controls(model, layout, planned, torque)

    def velocities(self, layout: Layout, record: Record, i: int) -> Array:
        """Joint velocities of a trial, (N + 1, n)."""
        return joint_velocities(record, layout.dofs, i)

    def motions(self, layout: Layout, planned: Reference, record: Record, i: int) -> dict[str, Motion]:
        """Movement of every object against what it stands on."""
        found: dict[str, list[Motion]] = {}
        for item in layout.interfaces:
            found.setdefault(item.object, []).append(object_motion(item, record.sensors[i]))
        return {name: motion_of_object(motions) for name, motions in found.items()}

    def criteria(self, failure: FailureConfig) -> dict[str, tuple[Criterion, ...]]:
        """How every object fails."""
        return dict.fromkeys(self._config.objects, object_criteria(failure))

    def view(self, layout: Layout, qpos: Array) -> View:
        """A camera that sees the whole path of the tray."""
        tray, _ = self.robot.carrier_pose(qpos[::100][:, layout.joints])
        return View(tray.mean(axis=0), DISTANCE + float(np.ptp(tray, axis=0).max()), AZIMUTH, ELEVATION)

    # Parts of the specification ---------------------------------------------------------------------------

    def _with_arm(self, timestep: float) -> mujoco.MjSpec:
        spec, limits, gains = self.robot.spec.copy(), self.robot.limits, self._gains
        _set_options(spec, timestep)
        for pair in [*spec.pairs, *spec.excludes]:
            spec.delete(pair)
        for geom in spec.geoms:
            geom.contype = geom.conaffinity = 0
        for body in spec.bodies[1:]:
            body.gravcomp = 1.0
        for i, name in enumerate(self.robot.joint_names):
            joint = spec.joint(name)
            joint.actfrclimited, joint.actfrcrange = True, [-limits.torque[i], limits.torque[i]]
            joint.actgravcomp = True
            unit = np.pi / 180 if spec.compiler.degree and self.robot.hinges[i] else 1.0
            if np.any(joint.range):  # files can be put together of parts with units of their own
                end = int(np.argmax(np.abs(joint.range)))
                unit = self.robot.ranges[i, end] / joint.range[end]
            joint.range, joint.margin = np.array([limits.lower[i], limits.upper[i]]) / unit, 0.0
            joint.limited = bool(np.isfinite(joint.range).all())
            joint.frictionloss = limits.dry_friction[i]
            joint.damping = _first(joint.damping, limits.viscous_friction[i])
            actuator = spec.add_actuator(
                USUAL.default, name=PREFIX + name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT
            )
            actuator.set_to_pid(kp=gains.kp[i], kv=gains.kd[i], ki=gains.ki[i], ctrlspec=gains.inputs)
        return spec

    def _add_tray(self, spec: mujoco.MjSpec, world: World) -> mujoco.MjsBody:
        site, size = spec.site(CARRIER_SITE), np.array(self._config.carried_tray.size) / 2
        body = site.parent.add_body(name=PREFIX + "tray", pos=site.pos, quat=site.quat)
        set_inertia(body, world.bodies["tray"])
        # The controller compensates the weight that the planner believes, not the true one.
        body.gravcomp = self.believed.bodies["tray"].mass / world.bodies["tray"].mass
        body.add_geom(
            name=PREFIX + "tray", type=mujoco.mjtGeom.mjGEOM_BOX, size=size, rgba=(0.3, 0.3, 0.35, 1.0), **_PASSIVE
        )
        return body

    def _add_object(
        self, parent: mujoco.MjsBody, name: str, world: World, position: Array, quaternion: Array
    ) -> mujoco.MjsBody:
        shape, truth = self._config.objects[name], world.bodies[name]
        body = parent.add_body(name=PREFIX + name, pos=position, quat=quaternion)
        set_inertia(body, truth)
        colour = _COLOURS[list(self._config.objects).index(name) % len(_COLOURS)]
        body.add_geom(name=PREFIX + name, rgba=(*colour, 1.0), **_shape(shape, 0.0), **_PASSIVE)
        for base, turn in _bases(name, shape).items():
            size = _shape(shape, truth.inset, ROUND_GROWTH)
            body.add_geom(name=base, quat=_quaternion(turn), rgba=_HIDDEN, **size, **_PASSIVE)
        if shape.radius is not None:
            wide = _shape(shape, 0.0, ROUND_GROWTH / np.cos(np.pi / ROUND_CORNERS))
            body.add_geom(name=_top(name), rgba=_HIDDEN, **wide, **_PASSIVE)
        return body

    def _add_pairs(self, spec: mujoco.MjSpec, world: World) -> None:
        """Contacts: each object's base on its supports, and the shapes of all others with each other."""
        for lower, upper in combinations(("tray", *self._placed), 2):
            resting = lower in supports(self._config.objects[upper])
            mu = max(world.friction[upper], 0.0 if resting else world.friction.get(lower, 0.0))
            ones = _bases(upper, self._config.objects[upper]) if resting else [PREFIX + upper]
            other = _top(lower) if resting and self._stands_within(upper, lower) else PREFIX + lower
            for one in ones:
                spec.add_pair(
                    USUAL.default,
                    geomname1=one,
                    geomname2=other,
                    condim=3,
                    friction=[mu, mu, 0.0, 0.0, 0.0],
                    solref=[SOLREF_STEPS * spec.option.timestep, 1.0],
                    solimp=SOLIMP,
                )

    def _stands_within(self, upper: str, lower: str) -> bool:
        """Whether an object stands within the face of a round one, whose polygon then must not bound the contact."""
        radius = self._config.objects[lower].radius if lower != "tray" else None
        if radius is None:
            return False
        shape, step = self._config.objects[upper], self._placed[upper].position - self._placed[lower].position
        reach = shape.radius if shape.radius is not None else 0.5 * np.hypot(*np.array(shape.size)[:2])
        return bool(np.hypot(*step[:2]) + reach <= radius + RESOLUTION)

    def _add_sensors(self, spec: mujoco.MjSpec) -> None:
        kinds, body = mujoco.mjtSensor, mujoco.mjtObj.mjOBJ_XBODY
        for name, support in self._resting():
            for kind in (kinds.mjSENS_FRAMEPOS, kinds.mjSENS_FRAMEQUAT):
                spec.add_sensor(
                    name=f"{PREFIX}{name}_{support}_{kind.name}", type=kind, objtype=body, objname=PREFIX + name,
                    reftype=body, refname=PREFIX + support,
                )  # fmt: skip

    def _resting(self) -> list[tuple[str, str]]:
        return [(name, support) for name in self._placed for support in supports(self._config.objects[name])]

    def _interfaces(self, model: mujoco.MjModel) -> list[Interface]:
        tray = Placement(np.zeros(3), np.eye(3), self._config.carried_tray.size[2] / 2, TRAY, CARRIER, np.zeros(3), 0.0)
        found = []
        for name, support in self._resting():
            upper, lower = self._placed[name], self._placed.get(support, tray)
            step = upper.position - lower.position
            position = np.r_[rotation(-lower.yaw) @ step[:2], step[2]]
            sensor = model.sensor(f"{PREFIX}{name}_{support}_mjSENS_FRAMEPOS").adr[0]
            shape, yaw = self._config.objects[name], upper.yaw - lower.yaw
            corners = _base_corners(shape)
            found.append(Interface(name, support, int(sensor), position, yaw, corners, shape.radius, lower.half_height))
        return found


_PASSIVE = {"default": USUAL.default, "contype": 0, "conaffinity": 0}
_HIDDEN = (0.0, 0.0, 0.0, 0.0)
_SKY = (0.93, 0.95, 0.97)
_COLOURS = ((0.85, 0.45, 0.25), (0.25, 0.5, 0.85), (0.35, 0.65, 0.35), (0.8, 0.7, 0.3))


def compiled(spec: mujoco.MjSpec) -> mujoco.MjModel:
    """The model of a true world; bodies that no inertia can be of are a ConfigError."""
    try:
        return spec.compile()
    except ValueError as error:
        message = f"no such body can be: {' '.join(str(error).split())}".replace(PREFIX, "")
        raise ConfigError(message, key="execution.truth") from error


def add_sky(spec: mujoco.MjSpec) -> None:
    """A light background, for pictures."""
    kind, gradient = mujoco.mjtTexture.mjTEXTURE_SKYBOX, mujoco.mjtBuiltin.mjBUILTIN_GRADIENT
    spec.add_texture(type=kind, builtin=gradient, rgb1=_SKY, rgb2=_SKY, width=8, height=48)


def _bases(name: str, shape: ObjectConfig) -> dict[str, float]:
    """Names of the geoms that an object stands on, and how far each is turned [rad]."""
    base = {f"{PREFIX}{name}_base": 0.0}
    return base if shape.radius is None else base | {f"{PREFIX}{name}_turned": np.pi / ROUND_CORNERS}


def _top(name: str) -> str:
    return f"{PREFIX}{name}_top"


def _set_options(spec: mujoco.MjSpec, timestep: float) -> None:
    option = spec.option
    option.timestep = timestep
    option.integrator = mujoco.mjtIntegrator.mjINT_EULER
    option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    option.solver = mujoco.mjtSolver.mjSOL_NEWTON
    option.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
    option.impratio = IMPEDANCE_RATIO
    option.tolerance, option.iterations, option.noslip_iterations = TOLERANCE, ITERATIONS, 0
    option.disableflags, option.enableflags = int(mujoco.mjtDisableBit.mjDSBL_AUTORESET), 0


def set_inertia(body: mujoco.MjsBody, truth: TrueBody) -> None:
    """Give a body its true mass, centre of mass and inertia."""
    body.explicitinertial = True
    body.mass, body.ipos = truth.mass, truth.center_of_mass
    i = truth.inertia
    body.fullinertia = [i[0, 0], i[1, 1], i[2, 2], i[0, 1], i[0, 2], i[1, 2]]


def _shape(shape: ObjectConfig, inset: float, growth: float = 1.0) -> dict[str, object]:
    """Type and size of a geom, smaller by an inset on every side; a round one is wider by a factor."""
    h = half_height(shape)
    if shape.size is not None:
        return {"type": mujoco.mjtGeom.mjGEOM_BOX, "size": [shape.size[0] / 2 - inset, shape.size[1] / 2 - inset, h]}
    assert shape.radius is not None, "checked when the configuration was read"
    return {"type": mujoco.mjtGeom.mjGEOM_CYLINDER, "size": [growth * (shape.radius - inset), h, 0.0]}


def _base_corners(shape: ObjectConfig) -> Array:
    """Points of the base whose movement is slip: the corners of a box, the centre of a round base, (k, 3)."""
    h = half_height(shape)
    if shape.size is None:
        return np.array([[0.0, 0.0, -h]])
    x, y = shape.size[0] / 2, shape.size[1] / 2
    return np.array([[sx * x, sy * y, -h] for sx in (-1, 1) for sy in (-1, 1)])


def _quaternion(yaw: float) -> Array:
    return np.array([np.cos(yaw / 2), 0.0, 0.0, np.sin(yaw / 2)])


def _first(values: Array | float, value: float) -> Array | float:
    """A coefficient, or a polynomial whose first coefficient it is, with `value` in its place."""
    if np.ndim(values) == 0:
        return value
    result = np.zeros_like(values)
    result[0] = value
    return result
