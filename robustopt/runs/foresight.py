"""Forecast of executions for a learner by physics: what the plans of a task require of every interface (ours)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from robustopt.arrays import Array
from robustopt.config import Config, ExecutionConfig, LearnedParameter, LearningConfig
from robustopt.config.document import split_key
from robustopt.config.per_name import value_of
from robustopt.errors import ConfigError
from robustopt.geometry import half_planes
from robustopt.learning.foresight import SLIDES, STEPS, TIPS, Mechanism
from robustopt.learning.survival import base_needed, friction_needed
from robustopt.limits.systems import carried
from robustopt.limits.uncertainty import bodies
from robustopt.scene.patches import Law, Patch, patches
from robustopt.scene.placement import supports
from robustopt.solvers import Plan, Status
from robustopt.solvers.batch import BatchPlanner
from robustopt.solvers.trajectory import Trajectory

KEYS = (("contact", "friction"), ("uncertainty", "contact_points"))
"""Parameters whose effect on an execution is known."""

LEAST_PART = 0.02
"""Smallest fraction of a base that is treated as nonzero."""


LEAST_FRICTION = 0.05
"""Conservative end of a search for friction whose interval begins at 0."""

MOST_INSET = 0.25
"""Part of the smallest base by which contact points may lie further inside than configured."""


def usual_parameters(config: Config) -> tuple[LearnedParameter, ...]:
    """Return what `physics` learns if the task names nothing: the friction of all contacts, and their contact points.

    Args:
        config: the task.

    Raises:
        ConfigError: the interval of friction is too low.
    """
    low, high = (config.learning or LearningConfig()).friction
    if high <= LEAST_FRICTION:
        expected = f"an upper end above {LEAST_FRICTION:g}, from which physics searches"
        raise ConfigError(f"found [{low:g}, {high:g}]; expected {expected}", key="learning.friction")
    halves = [_edges(patch.polygon)[2].min() for patch in patches(config)]
    inset = float(f"{MOST_INSET * min(halves, default=0.0):.2g}")
    friction = LearnedParameter(key="contact.friction", optimistic=high, conservative=max(low, LEAST_FRICTION))
    if inset == 0.0:
        return (friction,)
    return friction, LearnedParameter(key="uncertainty.contact_points", optimistic=0.0, conservative=inset)


def _edges(polygon: Array) -> tuple[Array, Array, Array]:
    """Return the normals (E, 2), the middle (2,) and the distances (E,) of the edges of a base from it [m]."""
    normals, offsets = half_planes(polygon)
    middle = polygon.mean(axis=0)
    return normals, middle, offsets - normals @ middle


@dataclass(frozen=True, eq=False)
class _Interface:
    """An object on its support: its patch, and the inertial parameters of all that it carries (10,)."""

    patch: Patch
    phi: Array

    @cached_property
    def edges(self) -> tuple[Array, Array, Array]:
        """Return the normals (E, 2), the middle (2,) and the distances (E,) of the edges of the base from it [m]."""
        return _edges(self.patch.polygon)

    @property
    def height(self) -> float:
        """Return the height of the centre of mass above the base [m]."""
        return float((self.phi[1:4] / self.phi[0] - self.patch.origin) @ self.patch.axes[:, 2])

    def inertia(self) -> Array:
        """Return the moment of inertia about each edge of the base (E,) [kg m^2]."""
        xx, yy, zz, xy, xz, yz = self.phi[4:]
        center = self.phi[1:4] / self.phi[0]
        about = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        about = about - self.phi[0] * (center @ center * np.eye(3) - np.outer(center, center))
        normals, _, apothems = self.edges
        along = np.column_stack([-normals[:, 1], normals[:, 0]]) @ self.patch.axes[:, :2].T
        return np.einsum("ei,ij,ej->e", along, about, along) + self.phi[0] * (apothems**2 + self.height**2)


class PlannedForesight:
    """Forecast by the plans of a task whose objects each stand on one support."""

    def __init__(self, config: Config, keys: Sequence[str]) -> None:
        """Make the forecast.

        Args:
            config: the task.
            keys: of the parameters.

        Raises:
            ConfigError: an object does not stand on one support, or the effect of a parameter is not known.
        """
        for key in keys:
            if split_key(key)[:2] not in KEYS:
                known = " and ".join(".".join(parts) for parts in KEYS)
                raise ConfigError(
                    f"found {key}; `physics` knows {known} alone: use bnb-informed", key="learning.parameters"
                )
        self._keys, self._batch = tuple(map(split_key, keys)), BatchPlanner(config, workers=1)
        self._config = self._batch.config
        named = {patch.object: patch for patch in patches(config) if patch.law is Law.FRICTION}
        others = [name for name, item in config.objects.items() if name not in named or len(supports(item)) > 1]
        if others or config.path.steps is not None:
            found = f"{others[0]}, which does not stand on one support alone" if others else "a robot that walks"
            raise ConfigError(
                f"found physics with {found}; expected objects on the tray and on each other: bnb-informed learns the "
                "learning.parameters of other tasks",
                key="learning.algorithm",
            )
        every = bodies(config)
        self._interfaces = [
            _Interface(named[name], np.sum([every[other].nominal for other in carried(config, name)], axis=0))
            for name in config.objects
        ]

    @property
    def mechanisms(self) -> tuple[Mechanism, ...]:
        """Return sliding and tipping of every object."""
        return tuple(Mechanism(item.patch.object, kinds) for item in self._interfaces for kinds in (SLIDES, TIPS))

    def strengths(self, values: Array) -> Array:
        """Return the friction and the remaining part of the base of every object (m, 2 objects)."""
        found = np.zeros((len(values), 2 * len(self._interfaces)))
        for i, item in enumerate(self._interfaces):
            name, object_ = item.patch.name, item.patch.object
            nominal = value_of(self._config.contact.friction, (name, object_), np.nan)
            mu = self._value(KEYS[0], (name, object_), values, nominal)
            moved = self._value(KEYS[1], (name, object_), values, 0.0)
            found[:, 2 * i] = np.log(np.maximum(mu, 1e-3))
            found[:, 2 * i + 1] = np.log(np.maximum(1.0 - moved / item.edges[2].min(), LEAST_PART))
        return found

    def _value(self, section: tuple[str, str], names: tuple[str, str], values: Array, nominal: float) -> Array:
        """Return a quantity in each world: the value of the parameter that names it, or else the nominal one."""
        own = [j for j, key in enumerate(self._keys) if key[:2] == section and key[2:3] and key[2] in names]
        given = getattr(getattr(self._config, section[0]), section[1])
        named = isinstance(given, Mapping) and any(name in given for name in names)
        whole = (section,) if named else (section, (*section, "default"))
        chosen = own or [j for j, key in enumerate(self._keys) if key in whole]
        return values[:, chosen[0]] if chosen else np.full(len(values), nominal)

    def needed(self, values: Array) -> Array:
        """Return the friction and the part of the base that each plan needs up to each time."""
        names = [".".join(map(str, key)) for key in self._keys]
        plans = self._batch.plans([dict(zip(names, row, strict=True)) for row in values.tolist()])
        found = np.full((len(plans), STEPS + 1, 2 * len(self._interfaces)), np.nan)
        solved = [i for i, plan in enumerate(plans) if plan.status is Status.SOLVED]
        if solved:
            found[solved] = self._needed([plans[i] for i in solved])
        return found

    def _needed(self, plans: Sequence[Plan]) -> Array:
        failure = (self._config.execution or ExecutionConfig()).failure
        step = np.array([plan.duration for plan in plans]) / STEPS
        columns = []
        for item in self._interfaces:
            force, moment = self._wrenches(item, plans)
            normals, middle, apothems = item.edges
            mass = item.phi[0]
            columns.append(friction_needed(force[..., :2] / mass, force[..., 2] / mass, step, failure.slip))
            leaning = np.stack([-moment[..., 1], moment[..., 0]], axis=-1) - force[..., 2:] * middle
            columns.append(
                base_needed(
                    leaning @ normals.T, force[..., 2], apothems, item.height, item.inertia(), step, failure.tilt
                )
            )
        return np.stack(columns, axis=-1)

    def _wrenches(self, item: _Interface, plans: Sequence[Plan]) -> tuple[Array, Array]:
        """Return the force (plans, STEPS + 1, 3) and the moment about the origin of a patch that it must supply."""
        track, patch = self._batch.track, item.patch
        at_points = track.motion.wrench_map[:, :3] @ item.phi
        force, moment = at_points[..., :3], at_points[..., 3:]
        per = np.concatenate([force @ patch.axes, (moment - np.cross(patch.origin, force)) @ patch.axes], axis=2)
        found = []
        for plan in plans:
            trajectory = Trajectory.from_plan(plan)
            t = np.linspace(0.0, trajectory.duration, STEPS + 1)
            samples = trajectory.sample(t)
            i = np.clip(np.searchsorted(trajectory.times, t, side="right") - 1, 0, len(track.s) - 2)
            ds = track.s[i + 1] - track.s[i]
            share = np.clip(np.divide(samples.s - track.s[i], ds, out=np.zeros_like(ds), where=ds > 0), 0.0, 1.0)
            between = per[i] + share[:, None, None] * (per[i + 1] - per[i])
            states = np.column_stack([samples.sdd, samples.sd**2, np.ones(len(t))])
            found.append(np.einsum("tc,tcw->tw", states, between))
        wrench = np.array(found)
        return wrench[..., :3], wrench[..., 3:]
