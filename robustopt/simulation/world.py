"""The simulated world of a task: its robot under the controller, floor and rail, and everything the robot carries."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import mujoco
import numpy as np

from robustopt.arrays import Array
from robustopt.config import FEET, Config, FailureConfig
from robustopt.errors import ConfigError
from robustopt.robot import load_robot
from robustopt.scene.placement import TRAY
from robustopt.simulation.controller import Gains, JointLayout, Reference
from robustopt.simulation.drives import add_drives, frictional_limits, release
from robustopt.simulation.ground import add_ground, grounded, set_contacts
from robustopt.simulation.holding import held
from robustopt.simulation.interfaces import Grounded, Interface, MeasuredContact, Trunk, base_rates, combined
from robustopt.simulation.load import add_load, fix_load, place_load, positions_of
from robustopt.simulation.objects import CARRIER, standing
from robustopt.simulation.outcome import Criterion, Motion
from robustopt.simulation.parameters import Parameters, nominal_parameters
from robustopt.simulation.physics import PREFIX, physics_of, set_inertia, set_options
from robustopt.simulation.pictures import add_scenery
from robustopt.simulation.simulation import Record, velocities


@dataclass(frozen=True)
class Layout(JointLayout):
    """Indices in the arrays of a compiled world.

    Attributes:
        bodies: number of each body on which a force can act, by name.
        objects: first index in qpos of each object.
        interfaces: contacts, and the floating base, whose motion decides about a trial.
    """

    bodies: Mapping[str, int]
    objects: Mapping[str, int]
    interfaces: tuple[Interface, ...]


class World:
    """The simulated world of a task; all models of one world have the same layout.

    Attributes:
        config: the task.
        robot: its robot, n coordinates.
        joint_names: joints with a motor (m,).
        torque_limit: their largest torque (m,) [N m or N].
        driven: coordinates with a motor.
        pushed: body on which a random force acts if the configuration names none.
        nominal: parameters of the planner.
    """

    def __init__(self, config: Config, gains: Gains, timestep: float) -> None:
        self.config, self.robot = config, load_robot(config)
        self.driven = self.robot.motors
        self.joint_names = self.robot.joint_names[self.driven]
        self.torque_limit = self.robot.limits.torque[self.driven]
        self.nominal = nominal_parameters(config, self.robot)
        holds = any(body.held_by is not None for body in config.objects.values())
        self._physics = physics_of(self.robot.base, holds)
        self._spec = self._with_robot(gains, timestep)
        self._trunk = tuple(self._trunks())
        tray = [] if config.tray is None else [TRAY]
        known = [*(trunk.name for trunk in self._trunk), *tray, *config.objects, self.robot.body_names[-1]]
        self.pushed = known[0]

    # Models -----------------------------------------------------------------------------------------------

    def model(self, parameters: Parameters, scenery: bool = False) -> mujoco.MjModel:
        """Compile the world with these parameters; scenery: with light and floor for pictures.

        Raises:
            ConfigError: no body can have these parameters.
        """
        spec = self._spec.copy()
        if scenery:
            add_scenery(spec, self.config, self.robot)
        self._set_robot(spec, parameters)
        if self.robot.has_carrier:
            add_load(spec, self.config, parameters, self._compensated(TRAY, parameters))
        return _compiled(spec)

    def rigid(self) -> mujoco.MjModel:
        """Compile the robot with its nominal load fixed to it, for the torque of a motion."""
        spec = self._spec.copy()
        for item in list(spec.actuators):
            spec.delete(item)
        for joint in spec.joints:
            joint.actgravcomp = False
        fix_load(spec, self.config, self.nominal, self._physics.compensated)
        return spec.compile()

    def layout(self, model: mujoco.MjModel) -> Layout:
        """Return the indices in the arrays of a model of this world."""
        actuators = [model.actuator(PREFIX + name).id for name in self.joint_names]
        tray = {} if self.config.tray is None else {TRAY: model.body(CARRIER).id}
        carried = {name: model.body(PREFIX + name).id for name in self.config.objects}
        return Layout(
            joints=np.array([model.joint(name).qposadr[0] for name in self.joint_names]),
            dofs=np.array([model.joint(name).dofadr[0] for name in self.joint_names]),
            control=model.actuator_ctrladr[actuators],
            bodies={model.body(k).name: k for k in range(1, model.nbody)} | tray | carried,
            objects=positions_of(self.config, model),
            interfaces=(
                *standing(self.config, model),
                *held(self.config, model),
                *grounded(self.config, self.robot, model),
                *self._trunk,
            ),
        )

    # Trials -----------------------------------------------------------------------------------------------

    def start(self, layout: Layout, q: Array, size: int) -> Array:
        """Return qpos (size,) of the robot at coordinates q (n,) with all objects in their places.

        A walking robot is put at the height at which the lowest contact point of a foot touches the floor.
        """
        q, qpos = q.copy(), np.zeros(size)
        if self.robot.contacts:
            points = self.robot.contact_points(q[None])
            q[2] -= min(float(points[foot][..., 2].min()) for foot in FEET)
        own = self.robot.qpos(q[None])[0]
        base = len(own) - len(layout.joints)
        qpos[:base], qpos[layout.joints] = own[:base], own[base:]
        if layout.objects:
            position, frame = (item[0] for item in self.robot.carrier_pose(q[None]))
            place_load(self.config, qpos, layout.objects, position, frame)
        return qpos

    def velocities(self, layout: Layout, record: Record, i: int) -> Array:
        """Return the rates of the coordinates in a trial, before each step and after the last, (N + 1, n)."""
        joints = velocities(record, i, layout.dofs)
        return np.column_stack([base_rates(record, i), joints]) if self.robot.base else joints

    def motions(self, layout: Layout, planned: Reference, record: Record, i: int) -> dict[str, Motion]:
        """Return the movement of each object, environment contact and floating base in a trial, by name."""
        found: dict[str, list[Motion]] = {}
        for item in layout.interfaces:
            found.setdefault(item.name, []).append(item.motion(planned, record, i))
        return {name: combined(motions) for name, motions in found.items()}

    def criteria(self, layout: Layout, failure: FailureConfig) -> dict[str, tuple[Criterion, ...]]:
        """Return the ways in which each of them fails, by name."""
        return {item.name: item.criteria(failure) for item in layout.interfaces}

    def contacts(self, layout: Layout, record: Record, i: int) -> dict[str, MeasuredContact]:
        """Return the forces of floor and rail on the robot in a trial, by contact."""
        found = [item for item in layout.interfaces if isinstance(item, Grounded)]
        return {item.name: item.measured(record, i, self._spec.option.timestep) for item in found}

    # Parts ------------------------------------------------------------------------------------------------

    def _with_robot(self, gains: Gains, timestep: float) -> mujoco.MjSpec:
        spec = self.robot.world_spec.copy()
        set_options(spec, self._physics, timestep)
        if not self.robot.contacts:
            release(spec)
        limits = frictional_limits(self.config, self.robot)
        add_drives(spec, self.robot, limits, gains, self._physics.compensated)
        if self.robot.contacts:
            add_ground(spec, self.robot, self.config.path.rail)
        return spec

    def _trunks(self) -> list[Trunk]:
        """List the floating base, if there is one."""
        free = [joint.parent.name for joint in self._spec.joints if joint.type == mujoco.mjtJoint.mjJNT_FREE]
        return [Trunk(name, float(self.robot.posture[2])) for name in free]

    def _set_robot(self, spec: mujoco.MjSpec, parameters: Parameters) -> None:
        for name in parameters.bodies:
            if name in self.robot.body_names and name not in (TRAY, *self.config.objects):
                set_inertia(spec.body(name), parameters.bodies[name])
                spec.body(name).gravcomp = self._compensated(name, parameters)
        set_contacts(spec, self.robot, parameters)

    def _compensated(self, name: str, parameters: Parameters) -> float:
        """Return the part of the actual weight of a body that the controller takes off: its nominal weight."""
        if name not in parameters.bodies:
            return 0.0
        return self._physics.compensated * (self.nominal.bodies[name].mass / parameters.bodies[name].mass)


def _compiled(spec: mujoco.MjSpec) -> mujoco.MjModel:
    """Compile an actual world; refuse impossible bodies."""
    try:
        return spec.compile()
    except ValueError as error:
        reason = " ".join(str(error).split()).replace(PREFIX, "")
        raise ConfigError(f"MuJoCo refuses the actual world: {reason}", key="execution.truth") from error
