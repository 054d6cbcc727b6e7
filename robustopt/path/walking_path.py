"""Path of a robot on its feet: footsteps turned into coordinates q(s) by inverse kinematics.

The pelvis stays upright at its height; its place in the plane and the twelve joints of the legs follow from the centre
of mass and the poses of the two soles, fourteen equations for as many unknowns, solved by Newton's method along the
path. Waist and arms keep the posture of the model.
"""

from __future__ import annotations

import numpy as np
from scipy.interpolate import make_interp_spline

from robustopt.config import Config
from robustopt.errors import PathError
from robustopt.path import Path
from robustopt.path.footsteps import Footsteps, footsteps
from robustopt.robot.walker import Walker

Array = np.ndarray

POINTS_PER_PHASE = 60
"""Inverse kinematics per phase: the soles of standing feet stay within micrometres of their places in between."""

ACCURACY = 1e-11
"""Error of a solution [m and rad]."""

ITERATIONS = 40
LONGEST_STEP = 0.3
"""Longest step of an iteration [rad or m]: the linearisation does not reach further."""

LIMIT_TOLERANCE = 1e-6
"""How far a joint may be beyond its limit [rad]: rounding."""

POINTS_PER_CHECK = 10
"""Points in each interval between two solutions at which the joint limits are checked."""


class WalkingPath(Path):
    """q(s) of a walking robot: one piece, C4; `footsteps` says when which foot stands where.

    `switches` (2 K,): s at which a foot lifts or lands; the robot does not stop there.
    """

    def __init__(self, steps: Footsteps, s: Array, q: Array) -> None:
        borders = np.linspace(0.0, 1.0, steps.phases + 1)
        super().__init__([make_interp_spline(s, q, k=5)], np.array([0.0, 1.0]), borders, "path.steps")
        self.footsteps = steps
        self.stances = steps.stances
        self.switches = borders[1:-1]

    def label(self, s: float) -> str:
        """Where `s` is, e.g. "during steps[0], right foot in the air, at 40 %"."""
        phase = min(int(s * self.footsteps.phases), self.footsteps.phases - 1)
        share = f"at {100 * (s * self.footsteps.phases - phase):.0f} %"
        step = phase // 2
        if phase % 2:
            return f"during steps[{step}], {self.footsteps.swings[step].replace('_', ' ')} in the air, {share}"
        count = len(self.footsteps.swings)
        if step == 0:
            return f"before steps[0], on both feet, {share}"
        if step == count:
            return f"after steps[{count - 1}], on both feet, {share}"
        return f"between steps[{step - 1}] and steps[{step}], on both feet, {share}"


def build_walking_path(config: Config, walker: Walker) -> WalkingPath:
    """The path of the configuration. Raises PathError where the legs are too short or a joint leaves its range."""
    steps = footsteps(config)
    s = np.linspace(0.0, 1.0, POINTS_PER_PHASE * steps.phases + 1)
    q = np.empty((len(s), walker.n))
    guess = walker.posture.copy()
    guess[:2] = steps.com(0.0)
    for i, si in enumerate(s):
        guess, error = _solve(walker, steps, float(si), guess)
        if error > ACCURACY:
            raise PathError(_unreachable(steps, float(si)), key=_key(steps, float(si)))
        q[i] = guess
    path = WalkingPath(steps, s, q)
    _require_limits(path, walker, s)
    if config.robot.collision.check:
        _require_no_collision(path, walker, s)
    return path


def _solve(walker: Walker, steps: Footsteps, s: float, q: Array) -> tuple[Array, float]:
    """q (n,) near the given one with the centre of mass and the soles in their places at s, and the error left."""
    soles, com = steps.soles(s), steps.com(s)
    legs = np.concatenate([walker.leg_joints[name] for name in walker.feet])
    free = np.concatenate([[0, 1], legs])
    q = q.copy()
    place = np.array([soles[name] for name in walker.feet])
    for _ in range(ITERATIONS):
        center, com_jacobian, position, rotation, jacobians = walker.feet_and_com(q)
        tilt = np.stack([rotation[:, 1, 2] - rotation[:, 2, 1], rotation[:, 2, 0] - rotation[:, 0, 2],
                         rotation[:, 0, 1] - rotation[:, 1, 0]], axis=1)  # fmt: skip
        feet = np.concatenate([place - position, 0.5 * tilt], axis=1)
        error = np.concatenate([com - center[:2], feet.ravel()])
        size = float(np.abs(error).max())
        if size < ACCURACY:
            break
        J = np.concatenate([com_jacobian[:2], jacobians.reshape(-1, walker.n)])[:, free]
        step, *_ = np.linalg.lstsq(J, error) if size > 1e-3 else (np.linalg.solve(J, error),)
        q[free] += step * min(1.0, LONGEST_STEP / max(float(np.abs(step).max()), LONGEST_STEP))
    return q, size


def _key(steps: Footsteps, s: float) -> str:
    phase = min(int(s * steps.phases), steps.phases - 1)
    return "path.start" if phase == 0 else f"path.steps[{min((phase - 1) // 2, len(steps.swings) - 1)}]"


def _unreachable(steps: Footsteps, s: float) -> str:
    return (
        f"the legs do not reach both feet at s = {s:.3f}; expected a shorter or narrower step, or a lower "
        "path.pelvis_height"
    )


def _require_no_collision(path: WalkingPath, walker: Walker, s: Array) -> None:
    """Raise PathError where bodies that can touch each other do, such as the legs."""
    found = walker.first_collision(path(s))
    if found is not None:
        index, (first, second), depth = found
        raise PathError(
            f"{path.label(float(s[index]))}: {first} and {second} collide, {1000 * depth:.1f} mm deep; expected feet "
            "further apart, or robot.collision.check: false",
            key=_key(path.footsteps, float(s[index])),
        )


def _require_limits(path: WalkingPath, walker: Walker, s: Array) -> None:
    """Raise PathError where a joint is furthest beyond its range, along the whole path."""
    fine = np.linspace(0.0, 1.0, POINTS_PER_CHECK * (len(s) - 1) + 1)
    q = path(fine)
    beyond = np.maximum(walker.limits.lower - q, q - walker.limits.upper)
    worst, joint = np.unravel_index(int(np.argmax(beyond)), beyond.shape)
    if beyond[worst, joint] <= LIMIT_TOLERANCE:
        return
    value, upper = q[worst, joint], walker.limits.upper[joint]
    limit = upper if value > upper else walker.limits.lower[joint]
    raise PathError(
        f"{path.label(float(fine[worst]))}: {walker.joint_names[joint]} would be at {value:.3f} rad, beyond its limit "
        f"of {limit:.3f} rad; expected a shorter step, another path.pelvis_height, or another place of the feet",
        key=_key(path.footsteps, float(fine[worst])),
    )
