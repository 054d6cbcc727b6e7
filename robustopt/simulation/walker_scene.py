"""The simulated world of a robot on its feet: its model with true parameters on a level floor, under its controller.

The contacts of the feet are those of the model file, a few spheres under each, with the true friction of that foot. A
hand on a rail gets spheres at the corners of its contact patch, and the rail is a box that nothing else touches. What
slips, loses contact or falls, see `footing`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from robustopt.config import BASE_COORDINATES as BASE
from robustopt.config import FEET, Config, FailureConfig, RailConfig, TruthConfig
from robustopt.errors import ConfigError
from robustopt.path.footsteps import Place, footsteps
from robustopt.robot import Robot, load_robot
from robustopt.robot.model_file import USUAL
from robustopt.scene.rail import rail_box
from robustopt.simulation.controller import Gains, JointLayout, Reference, controls
from robustopt.simulation.footing import MeasuredContact, contact_motion, stands, trunk_motion, turning
from robustopt.simulation.outcome import Criterion, Motion, Status
from robustopt.simulation.scene import PREFIX, View, add_sky, compiled, set_inertia
from robustopt.simulation.simulation import Record, joint_velocities
from robustopt.simulation.truth import TrueBody, World, believed_friction

Array = np.ndarray

FLOOR, RAIL = PREFIX + "floor", PREFIX + "rail"

PALM_SPHERE = 0.01
"""Radius of the contact spheres of a hand [m]."""

SOLREF, SOLIMP = (0.005, 1.0), (0.95, 0.99, 0.001, 0.5, 2.0)
"""Stiffness of a hand's contacts: as that of the feet of the shipped humanoid."""

DISTANCE, AZIMUTH, ELEVATION = 3.2, 110.0, -14.0
"""Place of the camera: from the middle of the walk, in heights of the pelvis and with the length of the walk on top;
about the vertical and above the horizon [deg]; on the side of the hand that is on a rail, else on the right."""

FALLEN, ON_RAIL, ON_FLOOR = 1 << 20, 1 << 21, 1 << 22
"""Contact bits of all that touches the floor only when the robot has fallen, everything but the feet, of the hand that
rests on a rail, and of the contact points of the feet, whatever bits the model file gives them and other geoms."""
OWN = FALLEN | ON_RAIL | ON_FLOOR
"""All of them, which are taken from the geoms of the model file."""

CONTACT_FIELDS = (mujoco.mjtConDataField.mjCONDATA_FORCE, mujoco.mjtConDataField.mjCONDATA_TORQUE,
                  mujoco.mjtConDataField.mjCONDATA_POS)  # fmt: skip
NET_FORCE = 3
"""MuJoCo's number for the sum of all contact forces of a sensor."""


@dataclass(frozen=True)
class WalkerLayout(JointLayout):
    """Where things are in the arrays of a compiled scene; bodies: all of the robot.

    contacts: first index in the sensor data of each contact: pose of its site (3 + 4), then force, moment and place of
    its force on the floor or the rail (3 + 3 + 3), all in the world
    """

    contacts: Mapping[str, int]


class WalkerScene:
    """The world of a robot on its feet (see `scenes.Scene`); its coordinates are those of `walker`."""

    driven = slice(BASE, None)

    def __init__(self, config: Config, gains: Gains, timestep: float) -> None:
        self.walker: Robot = load_robot(config)
        self.joint_names = self.walker.joint_names[BASE:]
        self.torque_limit = self.walker.limits.torque[BASE:]
        self._truth = (config.execution.truth if config.execution is not None else None) or TruthConfig()
        steps = footsteps(config)
        self._stands, self._places = stands(steps.stances, list(self.walker.contacts)), steps.places
        self._base = self._with_controller(config, gains, timestep)
        self.pushed = self._base.joints[0].parent.name
        self.believed = World(believed_friction(config), self._named_bodies())

    def model(self, world: World, sky: bool = False) -> mujoco.MjModel:
        """The compiled world; `sky`: with a light background, for pictures."""
        spec = self._base.copy()
        if sky:
            add_sky(spec)
            _add_floor_for_pictures(spec, self._places, self.walker)
            _add_posts_for_pictures(spec)
        for name, body in world.bodies.items():
            set_inertia(spec.body(name), body)
        for name, mu in world.friction.items():
            for sphere in _spheres(spec, name):
                sphere.friction = [mu, *sphere.friction[1:]]
        return compiled(spec)

    def layout(self, model: mujoco.MjModel) -> WalkerLayout:
        """Where things are in a model of this scene."""
        joints = [model.joint(name) for name in self.joint_names]
        actuators = [model.actuator(PREFIX + name).id for name in self.joint_names]
        return WalkerLayout(
            joints=np.array([joint.qposadr[0] for joint in joints]),
            dofs=np.array([joint.dofadr[0] for joint in joints]),
            control=model.actuator_ctrladr[actuators],
            bodies={model.body(k).name: k for k in range(1, model.nbody)},
            contacts={
                name: int(model.sensor(f"{PREFIX}{name}_mjSENS_FRAMEPOS").adr[0]) for name in self.walker.contacts
            },
        )

    def start(self, layout: WalkerLayout, q: Array, size: int) -> Array:
        """qpos (size,) at coordinates q (n,), but as high that the lowest contact point of a foot touches the floor."""
        qpos = self.walker.qpos(q[None])[0]
        points = self.walker.contact_points(q[None])
        qpos[2] -= min(float(points[foot][..., 2].min()) for foot in FEET)
        return qpos

    def controls(self, model: mujoco.MjModel, layout: WalkerLayout, planned: Reference) -> Array:
        """Control inputs at every time step, (N, nu)."""
        assert planned.torque is not None, "a robot on its feet is executed with the torque of its plan"
        joints = Reference(planned.t, planned.s, planned.q[:, BASE:], planned.qd[:, BASE:], planned.qdd, planned.moving)
        return controls(model, layout, joints, planned.torque[:, BASE:])

    def velocities(self, layout: WalkerLayout, record: Record, i: int) -> Array:
        """Rates of the coordinates of a trial, (N + 1, n): the base's, then the joints'."""
        qpos = np.vstack([record.start_qpos[i, : BASE + 1], record.qpos[i, :, : BASE + 1]])
        qvel = np.vstack([record.start_qvel[i, :BASE], record.qvel[i, :, :BASE]])
        return np.column_stack(
            [qvel[:, :3], turning(qpos[:, 3:], qvel[:, 3:]), joint_velocities(record, layout.dofs, i)]
        )

    def motions(self, layout: WalkerLayout, planned: Reference, record: Record, i: int) -> dict[str, Motion]:
        """Movement of both feet while they stand, of a hand on its rail, and of the trunk against the plan."""
        motions = {
            name: contact_motion(
                self.walker.contacts[name].points, self._stands[name], planned.s, record.sensors[i][:, at : at + 7]
            )
            for name, at in layout.contacts.items()
        }
        qpos = np.vstack([record.start_qpos[i, : BASE + 1], record.qpos[i, :-1, : BASE + 1]])
        return motions | {self.pushed: trunk_motion(planned.q[:, 2], qpos)}

    def contacts(self, layout: WalkerLayout, record: Record, i: int) -> dict[str, MeasuredContact]:
        """What the floor does to each foot, and the rail to a hand, in a trial."""
        found = {}
        for name, at in layout.contacts.items():
            force, moment, point = np.split(record.sensors[i][:, at + 7 : at + 16].copy(), 3, axis=1)
            plane = self._stands[name][0].place
            # The sensor has what the contact does to the floor or the rail.
            found[name] = MeasuredContact.of(plane, -force, -moment, point, self._base.option.timestep)
        return found

    def criteria(self, failure: FailureConfig) -> dict[str, tuple[Criterion, ...]]:
        """Feet and hands slip, a hand leaves its rail, the trunk falls."""
        slips = (Criterion(Status.SLIPPED, "slip", failure.foot_slip),)
        leaves = (*slips, Criterion(Status.LOST_CONTACT, "lift", failure.hand_lift))
        drop = failure.trunk_drop * float(self.walker.posture[2])
        falls = (Criterion(Status.FELL, "tilt", failure.trunk_tilt), Criterion(Status.FELL, "drop", drop))
        contacts = {name: slips if name in FEET else leaves for name in self.walker.contacts}
        return contacts | {self.pushed: falls}

    def view(self, layout: WalkerLayout, qpos: Array) -> View:
        """A camera that sees the whole way of the robot."""
        feet = np.array([[standing[foot].position[:2] for foot in FEET] for standing in self._places])
        height, way = float(self.walker.posture[2]), float(np.ptp(feet.mean(axis=1), axis=0).max())
        azimuth = -AZIMUTH if "left_hand" in self.walker.contacts else AZIMUTH
        return View(np.append(feet.mean(axis=(0, 1)), height), DISTANCE * height + way, azimuth, ELEVATION)

    # Parts of the specification ---------------------------------------------------------------------------

    def _with_controller(self, config: Config, gains: Gains, timestep: float) -> mujoco.MjSpec:
        spec = self.walker.world_spec.copy()
        _set_options(spec, timestep)
        spec.option.gravity = config.gravity
        for body in spec.bodies[1:]:
            body.gravcomp = 0.0  # that of a model would carry the robot from outside, and plans know nothing of it
        for i, name in enumerate(self.joint_names):
            joint, limit = spec.joint(name), self.torque_limit[i]
            joint.actfrclimited, joint.actfrcrange = bool(np.isfinite(limit)), [-limit, limit]
            actuator = spec.add_actuator(
                USUAL.default, name=PREFIX + name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT
            )
            actuator.set_to_pid(kp=gains.kp[i], kv=gains.kd[i], ki=gains.ki[i], ctrlspec=gains.inputs)
        spec.worldbody.add_geom(
            name=FLOOR, type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0.0, 0.0, 0.05], contype=0,
            conaffinity=ON_FLOOR | FALLEN,
        )  # fmt: skip
        on_feet = {spec.site(foot).parent.name for foot in FEET}
        for geom in spec.geoms:
            on_foot = geom.parent.name in on_feet
            if geom.name != FLOOR and not (on_foot and geom.type == mujoco.mjtGeom.mjGEOM_SPHERE):
                geom.contype, geom.conaffinity = geom.contype & ~OWN, geom.conaffinity & ~OWN
                geom.contype |= 0 if on_foot else FALLEN
        if config.path.rail is not None:
            _add_rail(spec, config.path.rail)
        for name, sole in self.walker.contacts.items():
            origin, axes = self.walker.site_frame(name)
            if name not in FEET:
                _add_palm(spec, name, origin + (sole.points + np.array([0.0, 0.0, PALM_SPHERE])) @ axes.T)
            _inset(spec, name, axes, self._truth.contact_inset.get(name, 0.0))
            for sphere in _spheres(spec, name):
                sphere.condim, sphere.priority = 3, 1
                if name in FEET:
                    sphere.contype, sphere.conaffinity = ON_FLOOR, 0
            _add_sensors(spec, name, FLOOR if name in FEET else RAIL)
        return spec

    def _named_bodies(self) -> dict[str, TrueBody]:
        """Bodies of the model that the truth says something about, as the model has them."""
        truth, varied, names = self._truth, self._truth.variation, self.walker.body_names
        given: Sequence[tuple[str, Mapping[str, object]]] = (
            ("mass", truth.mass), ("center_of_mass", truth.center_of_mass), ("inertia", truth.inertia),
            ("variation.mass", varied.mass), ("variation.center_of_mass", varied.center_of_mass),
        )  # fmt: skip
        for key, values in given:
            for name in values:
                if name not in names:
                    known = ", ".join(names)
                    message = f"the robot has no body {name} with a mass; expected one of {known}"
                    raise ConfigError(message, key=f"execution.truth.{key}.{name}")
        named = [name for name in names if any(name in values for _, values in given)]
        return {name: TrueBody(*self.walker.inertia_of(name)) for name in named}


def _set_options(spec: mujoco.MjSpec, timestep: float) -> None:
    """Contacts as the model file has them; cones, solver and integrator as the fidelity of the task needs them."""
    option = spec.option
    option.timestep = timestep
    option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    option.solver = mujoco.mjtSolver.mjSOL_NEWTON
    option.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
    option.impratio = IMPEDANCE_RATIO
    option.iterations, option.noslip_iterations = ITERATIONS, 0
    option.disableflags, option.enableflags = int(mujoco.mjtDisableBit.mjDSBL_AUTORESET), 0


IMPEDANCE_RATIO = 20.0
"""Friction is this much stiffer than the normal direction, so that standing feet do not creep."""
ITERATIONS = 50


def _add_palm(spec: mujoco.MjSpec, hand: str, centers: Array) -> None:
    """Contact spheres of a hand, their centres (k, 3) in the frame of its body."""
    for k, center in enumerate(centers):
        spec.site(hand).parent.add_geom(
            name=f"{PREFIX}{hand}_{k}", type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[PALM_SPHERE, 0.0, 0.0], mass=0.0,
            pos=center, contype=ON_RAIL, conaffinity=0, solref=SOLREF, solimp=SOLIMP, rgba=(0.2, 0.2, 0.22, 1.0),
        )  # fmt: skip


def _add_rail(spec: mujoco.MjSpec, rail: RailConfig) -> None:
    """A rail, which only the palm touches."""
    quaternion, (middle, axes, half) = np.zeros(4), rail_box(rail)
    mujoco.mju_mat2Quat(quaternion, axes.ravel())
    spec.worldbody.add_geom(
        name=RAIL, type=mujoco.mjtGeom.mjGEOM_BOX, size=half, pos=middle, quat=quaternion, contype=0,
        conaffinity=ON_RAIL, rgba=(0.55, 0.5, 0.45, 1.0),
    )  # fmt: skip


def _spheres(spec: mujoco.MjSpec, contact: str) -> list[mujoco.MjsGeom]:
    """Spheres of a foot that can touch the floor, or of a hand that can touch its rail."""
    sphere = mujoco.mjtGeom.mjGEOM_SPHERE
    geoms = [geom for geom in spec.site(contact).parent.geoms if geom.type == sphere]
    return [geom for geom in geoms if (geom.contype | geom.conaffinity if contact in FEET else geom.contype & ON_RAIL)]


def _inset(spec: mujoco.MjSpec, contact: str, axes: Array, inset: float) -> None:
    """Move the contact points of a foot or hand towards their middle along x and y of its site, axes (3, 3)."""
    spheres = _spheres(spec, contact)
    middle = np.mean([sphere.pos for sphere in spheres], axis=0)
    for sphere in spheres:
        away = (sphere.pos - middle) @ axes
        if np.any(np.abs(away[:2]) < inset):
            raise ConfigError(
                f"found {inset:g} m, which leaves nothing of {contact}", key=f"execution.truth.contact_inset.{contact}"
            )
        sphere.pos = sphere.pos - axes @ (inset * np.append(np.sign(away[:2]), 0.0))


def _add_sensors(spec: mujoco.MjSpec, contact: str, ground: str) -> None:
    """Sensors of the pose of a foot or hand, and of its force on the geom that it rests on."""
    kinds, objects = mujoco.mjtSensor, mujoco.mjtObj
    for kind in (kinds.mjSENS_FRAMEPOS, kinds.mjSENS_FRAMEQUAT):
        spec.add_sensor(name=f"{PREFIX}{contact}_{kind.name}", type=kind, objtype=objects.mjOBJ_SITE, objname=contact)
    fields = sum(1 << int(field) for field in CONTACT_FIELDS)
    spec.add_sensor(
        name=f"{PREFIX}{contact}_contact", type=kinds.mjSENS_CONTACT, objtype=objects.mjOBJ_BODY,
        objname=spec.site(contact).parent.name, reftype=objects.mjOBJ_GEOM, refname=ground,
        intprm=[fields, NET_FORCE, 1],
    )  # fmt: skip


def _add_floor_for_pictures(spec: mujoco.MjSpec, places: Sequence[Mapping[str, Place]], walker: Robot) -> None:
    """A floor with tiles, and footprints where the feet are to stand, so that slips can be seen."""
    pattern = spec.add_texture(
        name=FLOOR, type=mujoco.mjtTexture.mjTEXTURE_2D, builtin=mujoco.mjtBuiltin.mjBUILTIN_CHECKER,
        rgb1=(0.97, 0.97, 0.97), rgb2=(0.9, 0.91, 0.92), width=128, height=128,
    )  # fmt: skip
    material = spec.add_material(name=FLOOR, texrepeat=[5.0, 5.0], texuniform=True, emission=0.5)
    material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = pattern.name
    floor = spec.geom(FLOOR)
    floor.material, floor.rgba = FLOOR, (1.0, 1.0, 1.0, 1.0)
    for k, standing in enumerate(places):
        pale = 0.35 * (len(places) - 1 - k) / max(len(places) - 1, 1)
        for name in FEET:
            points = walker.contacts[name].points[:, :2]
            middle = standing[name].position[:2] + 0.5 * (points.min(axis=0) + points.max(axis=0))
            spec.worldbody.add_geom(
                type=mujoco.mjtGeom.mjGEOM_BOX, size=[*(0.5 * np.ptp(points, axis=0) - 0.01), 1e-3], pos=[*middle, 0.0],
                rgba=(0.45 + pale, 0.85, 0.55 + pale, 1.0), contype=0, conaffinity=0, mass=0.0,
            )  # fmt: skip


def _add_posts_for_pictures(spec: mujoco.MjSpec) -> None:
    """Posts under the ends of a rail, if there is one."""
    for rail in [geom for geom in spec.geoms if geom.name == RAIL]:
        axes = np.zeros(9)
        mujoco.mju_quat2Mat(axes, np.asarray(rail.quat, dtype=float))
        for side in (-1.0, 1.0):
            top = rail.pos + side * 0.95 * rail.size[0] * axes.reshape(3, 3)[:, 0]
            if top[2] > 0.0:
                spec.worldbody.add_geom(
                    type=mujoco.mjtGeom.mjGEOM_CAPSULE, fromto=[*top, *top[:2], 0.0], size=[0.01, 0.0, 0.0],
                    rgba=rail.rgba, contype=0, conaffinity=0, mass=0.0,
                )  # fmt: skip
