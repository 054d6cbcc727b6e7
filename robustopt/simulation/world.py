"""The simulated world of a task: the controlled robot, floor and rail, and everything that the robot carries."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from robustopt.arrays import Array
from robustopt.config import FEET, Config, FailureConfig
from robustopt.errors import ConfigError
from robustopt.robot import load_robot
from robustopt.scene.patches import Law
from robustopt.scene.placement import TRAY, placements
from robustopt.simulation import ground, holding, objects
from robustopt.simulation.controller import Gains, JointLayout, Reference
from robustopt.simulation.drives import add_drives, frictional_limits, release
from robustopt.simulation.interfaces import Interface, Trunk, combined
from robustopt.simulation.outcome import Criterion, Motion
from robustopt.simulation.parameters import Parameters, nominal_parameters
from robustopt.simulation.physics import PREFIX, physics_of, quaternion, set_inertia, set_options
from robustopt.simulation.simulation import Record, velocities

APART = 1e-5
"""Time before and after the start at which positions are compared for velocities [s], which are accurate to 1e-10."""


@dataclass(frozen=True)
class Layout(JointLayout):
    """Indices in the arrays of a compiled world.

    Attributes:
        bodies: number of each body on which a force can act, by name.
        objects: first index in qpos of each object.
        interfaces: contacts, and the floating base, whose motion decides whether a trial succeeds.
    """

    bodies: Mapping[str, int]
    objects: Mapping[str, int]
    interfaces: tuple[Interface, ...]

    def motions(self, planned: Reference, record: Record, i: int) -> dict[str, Motion]:
        """Return the movement of each object, environment contact and floating base in a trial, by name.

        Args:
            planned: reference of the controllers.
            record: record of a chunk of trials.
            i: index of the trial in the record.
        """
        found: dict[str, list[Motion]] = {}
        for item in self.interfaces:
            found.setdefault(item.name, []).append(item.motion(planned, record, i))
        return {name: combined(motions) for name, motions in found.items()}

    def criteria(self, failure: FailureConfig) -> dict[str, tuple[Criterion, ...]]:
        """Return the ways in which each object, environment contact and floating base fails, by name.

        Args:
            failure: criteria of failure.
        """
        return {item.name: item.criteria(failure) for item in self.interfaces}

    def against(self) -> dict[str, str]:
        """Return what each object, environment contact and floating base is in contact with, by name."""
        found: dict[str, list[str]] = {}
        for item in self.interfaces:
            found.setdefault(item.name, []).append(item.against)
        return {name: " and ".join(others) for name, others in found.items()}


class World:
    """The simulated world of a task; all its models have the same layout.

    Attributes:
        config: the configuration.
        robot: the robot, n coordinates.
        driven: the m coordinates with a motor.
        joint_names: names of these (m,).
        torque_limit: torque limits of these (m,) [N m or N].
        pushed: name of the body on which a random force acts if the configuration names none.
        nominal: nominal parameters.
    """

    def __init__(self, config: Config, gains: Gains, timestep: float) -> None:
        self.config, self.robot = config, load_robot(config)
        self.driven = self.robot.motors
        self.joint_names = self.robot.joint_names[self.driven]
        self.torque_limit = self.robot.limits.torque[self.driven]
        self.nominal = nominal_parameters(config, self.robot)
        self._holds = holding.holds_of(config, self.robot.hands)
        self._physics = physics_of(self.robot.base, bool(self._holds))
        self._spec = self._with_robot(gains, timestep)
        free = [joint.parent.name for joint in self._spec.joints if joint.type == mujoco.mjtJoint.mjJNT_FREE]
        self._trunk = [Trunk(name, float(self.robot.posture[2])) for name in free]
        self.pushed = next(iter([*free, *self.nominal.bodies, self.robot.body_names[-1]]))

    # Models -----------------------------------------------------------------------------------------------

    def spec(self, parameters: Parameters) -> mujoco.MjSpec:
        """Return the specification of the world.

        Args:
            parameters: its actual parameters.

        Raises:
            ConfigError: an inset leaves nothing of a contact.
        """
        spec = self._spec.copy()
        for name, body in parameters.bodies.items():
            if name not in (TRAY, *self.config.objects):
                set_inertia(spec.body(name), body)
                spec.body(name).gravcomp = self._compensated(name, parameters)
        ground.set_contacts(spec, self.robot, parameters)
        if self.robot.has_carrier:
            add_load(spec, self.config, parameters, self._holds, self._compensated(TRAY, parameters))
        return spec

    def model(self, parameters: Parameters) -> mujoco.MjModel:
        """Return the compiled world.

        Args:
            parameters: its actual parameters.

        Raises:
            ConfigError: an inset leaves nothing of a contact, or MuJoCo refuses the parameters of a body.
        """
        try:
            return self.spec(parameters).compile()
        except ValueError as error:
            reason = " ".join(str(error).split()).replace(PREFIX, "")
            raise ConfigError(f"MuJoCo refuses the actual world: {reason}", key="execution.truth") from error

    def rigid(self) -> mujoco.MjModel:
        """Compile the robot with its nominal load fixed to it, for the torque of a motion."""
        spec = self._spec.copy()
        for item in list(spec.actuators):
            spec.delete(item)
        for joint in spec.joints:
            joint.actgravcomp = False
        tool = objects.add_carrier(spec, self.config, self.nominal, self._physics.compensated)
        for name, place in placements(self.config).items():
            objects.add_object(tool, self.config, name, self.nominal, place.position, objects.orientation(place))
        for hold in self._holds:
            for patch in hold.patches:
                if patch.law is Law.DRIVEN_PAD:
                    holding.add_finger(tool, patch, hold.finger_mass)
        return spec.compile()

    def layout(self, model: mujoco.MjModel) -> Layout:
        """Return the indices in the arrays of a model of this world.

        Args:
            model: the compiled model.
        """
        joints = [model.joint(name) for name in self.joint_names]
        tray = {} if self.config.tray is None else {TRAY: model.body(objects.CARRIER).id}
        return Layout(
            joints=np.array([joint.qposadr[0] for joint in joints]),
            dofs=np.array([joint.dofadr[0] for joint in joints]),
            control=model.actuator_ctrladr[[model.actuator(PREFIX + name).id for name in self.joint_names]],
            bodies={
                **{name: k for k in range(1, model.nbody) if not (name := model.body(k).name).startswith(PREFIX)},
                **tray,
                **{name: model.body(PREFIX + name).id for name in self.config.objects},
            },
            objects=positions_of(self.config, model),
            interfaces=(
                *objects.standing(self.config, model),
                *holding.held(self._holds, model),
                *ground.grounded(self.config, self.robot, model),
                *self._trunk,
            ),
        )

    def _with_robot(self, gains: Gains, timestep: float) -> mujoco.MjSpec:
        spec = self.robot.world_spec.copy()
        set_options(spec, self._physics, timestep)
        add_drives(spec, self.robot, frictional_limits(self.config, self.robot), gains, self._physics.compensated)
        if self.robot.contacts:
            ground.add_ground(spec, self.robot, self.config.path.rail)
        else:
            release(spec)
        holding.add_hands(spec, self.robot)
        return spec

    def _compensated(self, name: str, parameters: Parameters) -> float:
        """Return the fraction of the actual weight of a body that the controller compensates: its nominal weight."""
        if name not in parameters.bodies:
            return 0.0
        return self._physics.compensated * (self.nominal.bodies[name].mass / parameters.bodies[name].mass)

    # Trials -----------------------------------------------------------------------------------------------

    def start(self, layout: Layout, q: Array, size: int) -> Array:
        """Return the positions of the robot with all objects in their places, (size,).

        A walking robot is placed at the height at which the lowest contact point of its feet touches the floor.

        Args:
            layout: layout of the model.
            q: coordinates of the robot (n,) [rad or m].
            size: number of positions of the model.
        """
        q, qpos = q.copy(), np.zeros(size)
        height = [points[..., 2].min() for name, points in self.robot.contact_points(q[None]).items() if name in FEET]
        q[2 : self.robot.base // 2] -= min(height, default=0.0)
        own = self.robot.qpos(q[None])[0]
        base = len(own) - len(layout.joints)
        qpos[:base], qpos[layout.joints] = own[:base], own[base:]
        if layout.objects:
            position, frame = (item[0] for item in self.robot.carrier_pose(q[None]))
            place_load(self.config, qpos, layout.objects, position, frame)
        return qpos

    def start_velocity(self, layout: Layout, q: Array, qd: Array, model: mujoco.MjModel) -> Array:
        """Return the velocities of the robot with all objects moving with it as one rigid body, (nv,).

        Args:
            layout: layout of the model.
            q: coordinates of the robot (n,) [rad or m].
            qd: their rates (n,) [rad/s or m/s].
            model: the model.
        """
        qvel, before, after = (
            np.zeros(model.nv),
            *(self.start(layout, q + side * APART * qd, model.nq) for side in (-1.0, 1.0)),
        )
        mujoco.mj_differentiatePos(model, qvel, 2.0 * APART, before, after)
        return qvel

    def velocities(self, layout: Layout, record: Record, i: int) -> Array:
        """Return the rates of the coordinates in a trial, before each step and after the last, (N + 1, n).

        Args:
            layout: layout of the model.
            record: record of a chunk of trials.
            i: index of the trial in the record.
        """
        of_base = [trunk.rates(record, i) for trunk in self._trunk]
        return np.column_stack([*of_base, velocities(record, i, layout.dofs)])


# The load -------------------------------------------------------------------------------------------------


def add_load(
    spec: mujoco.MjSpec, config: Config, parameters: Parameters, holds: Sequence[holding.Hold], compensated: float
) -> None:
    """Add the tray, the objects as free bodies, and the cups and pads that hold some of them.

    Args:
        spec: specification of the world, which is changed.
        config: the configuration.
        parameters: actual parameters.
        holds: the cups and pads.
        compensated: fraction of the tray's weight that the controller compensates.

    Raises:
        ConfigError: an inset leaves nothing of a lip or pad.
    """
    objects.add_carrier(spec, config, parameters, compensated)
    for name in placements(config):
        body = objects.add_object(spec.worldbody, config, name, parameters, np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]))
        body.add_freejoint(name=PREFIX + name)
    objects.add_contacts(spec, config, parameters)
    objects.add_pose_sensors(spec, config)
    for hold in holds:
        holding.add_hold(spec, hold, parameters)


def positions_of(config: Config, model: mujoco.MjModel) -> dict[str, int]:
    """Return the first index in qpos of each free object, and of a tray that several hands hold.

    Args:
        config: the configuration.
        model: compiled model of the world.
    """
    free = [TRAY] if config.tray is not None and config.tray.hands is not None else []
    return {name: int(model.joint(PREFIX + name).qposadr[0]) for name in (*free, *placements(config))}


def place_load(config: Config, qpos: Array, at: Mapping[str, int], position: Array, frame: Array) -> None:
    """Put the objects in their places in qpos.

    Args:
        config: the configuration.
        qpos: positions of the model, which are changed.
        at: first index in qpos of each object.
        position: origin of the carrier frame in the world (3,) [m].
        frame: axes of the carrier frame in the world as columns (3, 3).
    """
    turn, placed = quaternion(frame), placements(config)
    for name, k in at.items():
        if name == TRAY:
            qpos[k : k + 3], qpos[k + 3 : k + 7] = position, turn
        else:
            qpos[k : k + 3] = position + frame @ placed[name].position
            mujoco.mju_mulQuat(qpos[k + 3 : k + 7], turn, objects.orientation(placed[name]))
