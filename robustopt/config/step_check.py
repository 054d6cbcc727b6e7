"""Checks of the steps of a walking robot."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from robustopt.config.document import Finding, Key
from robustopt.config.model import FEET, Config
from robustopt.config.path_model import RailConfig, StanceConfig
from robustopt.config.per_name import value_of
from robustopt.config.section import Pose
from robustopt.geometry import RESOLUTION, common_direction

POINTS_PER_PHASE = 8
"""Smallest number of grid intervals per phase of a path with steps, in which feet lift and land at grid points."""

PARALLEL = 1e-3
"""Sine of the angle between two directions below which they count as parallel (our choice)."""


def check_steps(config: Config) -> Iterator[Finding]:
    """Yield the mistakes in the steps of a walking robot, and keys that require path.steps.

    Args:
        config: the configuration.
    """
    if config.path.steps is None:
        yield from _without_steps(config)
        return
    yield from _beside_steps(config)
    yield from _steps(config)
    if config.path.rail is not None:
        yield from _rail(config, config.path.rail)


def _without_steps(config: Config) -> Iterator[Finding]:
    if isinstance(config.path.start, StanceConfig):
        yield ("path", "start"), "found the positions of feet; expected joint positions, or path.steps too"
    if config.path.rail is not None:
        yield ("path", "rail"), "not allowed without path.steps: only a walking robot has a hand on a rail"
    if config.uncertainty.base_acceleration != 0.0:
        yield ("uncertainty", "base_acceleration"), "not allowed without path.steps: it is for walking robots"
    if len(config.robot.tools) > 1:
        yield ("robot", "tool"), "found several hands; expected one tool: only a walking robot holds a tray with hands"


def _beside_steps(config: Config) -> Iterator[Finding]:
    if config.robot.locked:
        yield ("robot", "locked"), "not allowed with path.steps: a walking robot has no locked joints"
    if config.path.blend > 0:
        yield ("path", "blend"), "not allowed with path.steps: it rounds the corners of tray_poses or tool_poses"
    if config.robot.base != Pose():
        yield ("robot", "base"), "not allowed with path.steps: path.start gives the place of a walking robot"
    execution = config.execution
    if execution is not None and execution.controller.feedforward == "gravity":
        message = "found gravity with path.steps; expected computed_torque: without it a walking robot falls"
        yield ("execution", "controller", "feedforward"), message
    least, points = POINTS_PER_PHASE * (2 * len(config.path.steps or ()) + 1), config.solver.collocation_points
    if points != "auto" and points < least:
        yield ("solver", "collocation_points"), f"found {points}; expected at least {least} for this number of steps"
    if config.solver.cost == "effort":
        message = (
            "found effort with path.steps; expected time or smoothness: the feet share the torques in more than one way"
        )
        yield ("solver", "cost"), message
    if len(np.atleast_1d(config.uncertainty.base_acceleration)) not in (1, 6):
        found = f"found {len(np.atleast_1d(config.uncertainty.base_acceleration))} values; expected one, or six: "
        yield ("uncertainty", "base_acceleration"), found + "along x, y, z and about z, y, x"


def _steps(config: Config) -> Iterator[Finding]:
    steps, start = config.path.steps, config.path.start
    assert steps is not None
    if not steps:
        yield ("path", "steps"), "found no steps; expected at least one, such as {foot: right, to: [0.2, -0.16]}"
    if not isinstance(start, StanceConfig):
        found = "missing" if start is None else "found joint positions"
        yield ("path", "start"), f"{found}; expected the positions of the feet: {{left: [0, 0.16], right: [0, -0.16]}}"
        return
    standing = {"left": start.left, "right": start.right}
    if standing["left"][1] <= standing["right"][1]:
        yield ("path", "start"), "the left foot is not to the left of the right foot; expected a larger y"
        return
    for k, step in enumerate(steps):
        if k and step.foot == steps[k - 1].foot:
            message = f"found {step.foot} as in the step before; expected alternating feet: merge the two steps"
            yield ("path", "steps", k, "foot"), message
        if np.linalg.norm(np.subtract(step.to, standing[step.foot])) <= RESOLUTION:
            yield ("path", "steps", k, "to"), f"the {step.foot} foot stands there already; expected another position"
        standing[step.foot] = step.to
        if standing["left"][1] <= standing["right"][1]:
            yield ("path", "steps", k, "to"), "the feet would cross; expected the left foot to the left of the right"
            return


def _rail(config: Config, rail: RailConfig) -> Iterator[Finding]:
    key: Key = ("path", "rail")
    if rail.at[2] <= 0.0:
        yield (*key, "at"), f"found a height of {rail.at[2]:g} m; expected a position above the floor"
    normal, along = np.array(rail.normal), np.array(rail.along)
    for name, vector in (("normal", normal), ("along", along)):
        if np.linalg.norm(vector) < RESOLUTION:
            yield (*key, name), f"found {vector.tolist()}, which has no direction; expected three numbers, not all zero"
            return
    normal, along = normal / np.linalg.norm(normal), along / np.linalg.norm(along)
    if np.linalg.norm(np.cross(normal, along)) < PARALLEL:
        yield (*key, "along"), "found the direction of the normal; expected one along the rail"
    if rail.length < rail.size[0]:
        yield (*key, "length"), f"found {rail.length:g} m; expected at least {rail.size[0]:g} m, the palm's length"
    most = [_most_friction(config, name) for name in (*FEET, rail.contact)]
    if common_direction([np.array([0.0, 0.0, 1.0])] * 2 + [normal], most) is None:
        message = (
            f"found {list(rail.normal)}; with friction up to {max(most[:2]):g} and {most[2]:g} the feet and the hand "
            "could press against each other with any force; expected a normal that points up more, or less friction"
        )
        yield (*key, "normal"), message


def _most_friction(config: Config, name: str) -> float:
    """Return the largest coefficient of friction that the configuration gives a contact."""
    own = (value_of(config.contact.friction, (name,), None), value_of(config.uncertainty.friction, (name,), None))
    return max((float(np.max(value)) for value in own if value is not None), default=0.0)
