"""The path of a walking robot: footsteps turned into coordinates q(s) by inverse kinematics.

The pelvis stays upright at its height. Its place in the plane and the twelve joints of the legs follow from the centre
of mass and the poses of the two soles: fourteen equations with fourteen unknowns, solved by Newton's method along the
path. A hand on a rail adds the pose of its palm and the joints of its arm. An arm of more than six joints can move with
its hand in place. Along the path it moves as little as possible, drawn towards the posture of the model (our choice).
Waist and free arms keep that posture.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.interpolate import make_interp_spline

from robustopt.arrays import Array
from robustopt.config import HANDS, Config, RailConfig
from robustopt.errors import PathError
from robustopt.path.collision import CollisionCheck, first_touch
from robustopt.path.footsteps import Footsteps, footsteps
from robustopt.path.path import Path
from robustopt.path.reach import limit_sentence
from robustopt.robot import Robot

POINTS_PER_PHASE = 60
"""Inverse kinematics per phase: the soles of standing feet stay within micrometres of their places in between."""

ACCURACY = 1e-11
"""Error of a solution [m and rad]."""

ITERATIONS = 40
LONGEST_STEP = 0.3
"""Longest step of an iteration [rad or m]: the linearisation does not reach further."""

LIMIT_TOLERANCE = 1e-6
"""Largest distance of a joint beyond its limit [rad]: rounding."""

POINTS_PER_CHECK = 10
"""Points in each interval between two solutions at which the joint limits are checked."""

PULL = 0.05
"""Share of the way to the posture of the model that a redundant arm goes from one solution to the next."""

STARTS, SETTLING = 16, 20
"""Number of postures of an arm from which its posture at the start is sought, and of steps in which it settles."""

SAME_POSTURE = 1e-2
"""Two settled postures that are this close to each other are the same [rad or m]."""

SETTLING_PULL = 0.5
"""Share of the way to the posture of the model that an arm goes in each settling step."""


def walking_path(config: Config, robot: Robot) -> Path:
    """Build the path of a walking robot.

    Args:
        config: the configuration, with `path.steps`.
        robot: the walking robot.

    Raises:
        PathError: a foothold or the rail is out of reach, a joint leaves its range, or bodies collide.
    """
    steps = footsteps(config)
    s = np.linspace(0.0, 1.0, POINTS_PER_PHASE * steps.phases + 1)
    ends, borders = np.array([0.0, 1.0]), np.linspace(0.0, 1.0, steps.phases + 1)
    failures = []
    for start in _starts(config, robot, steps):
        try:
            q = _followed(robot, steps, s, start)
            path = Path([make_interp_spline(s, q, k=5)], ends, borders, "path.steps", steps)
            _require_limits(path, steps, robot, s)
        except PathError as error:
            failures.append(error)
        else:
            break
    else:
        raise failures[0]
    if config.robot.collision.check:
        _require_no_collision(path, steps, config, robot, s)
        if config.path.rail is not None:
            _require_no_touch(path, robot, s, config.path.rail)
    return path


def _followed(robot: Robot, steps: Footsteps, s: Array, start: Array) -> Array:
    """Solve for q (P, n) at the positions s (P,), one after the other, starting near `start` (n,)."""
    q = np.empty((len(s), robot.n))
    guess = start
    for i, si in enumerate(s):
        guess, errors = _solve(robot, steps, float(si), guess, PULL if i else 0.0)
        if max(errors.values()) > ACCURACY:
            lost = max(errors, key=lambda name: errors[name])
            raise PathError(*_unreachable(steps, float(si), lost))
        q[i] = guess
    return q


def _starts(config: Config, robot: Robot, steps: Footsteps) -> Iterator[Array]:
    """Yield postures (n,) near which the path may start.

    The first is the posture of the model. With a hand on a rail others follow, because an arm may reach the rail in
    several ways.
    """
    posture = robot.posture.copy()
    posture[:2] = steps.com(0.0)
    if config.path.rail is None:
        yield posture
        return
    arm, rng = robot.limbs[config.path.rail.contact], np.random.default_rng(0)
    lower, upper = robot.limits.lower[arm], robot.limits.upper[arm]
    low, high = np.clip(lower, -np.pi, np.pi), np.clip(upper, -np.pi, np.pi)
    known: list[Array] = []
    for k in range(STARTS):
        q = posture.copy()
        if k:
            q[arm] = low + (high - low) * rng.random(len(arm))
        for _ in range(SETTLING):
            q, _ = _solve(robot, steps, 0.0, q, SETTLING_PULL, iterations=1)
        q, errors = _solve(robot, steps, 0.0, q)
        usable = max(errors.values()) <= ACCURACY and bool(np.all((q[arm] >= lower) & (q[arm] <= upper)))
        if k == 0 or (usable and all(np.abs(q - other).max() > SAME_POSTURE for other in known)):
            known.append(q)
            yield q


def _solve(
    robot: Robot, steps: Footsteps, s: float, q: Array, pull: float = 0.0, iterations: int = ITERATIONS
) -> tuple[Array, dict[str, float]]:
    """Put the centre of mass and all contacts in their places at s by Newton's method.

    Args:
        robot: the robot.
        steps: its footsteps.
        s: position along the path.
        q: coordinates to start from (n,).
        pull: share of the distance to the posture of the model that a redundant arm moves.
        iterations: largest number of steps.

    Returns:
        q (n,) after the last step, and the remaining errors by contact and `com` [m and rad].
    """
    places, com = steps.at(s), steps.com(s)
    wanted = [places[name] for name in robot.contacts]
    limbs = list(robot.limbs.values())
    free = np.concatenate([[0, 1], *limbs])
    redundant = len(free) > 2 + 6 * len(wanted)
    q = q.copy()
    place, back = np.array([item.position for item in wanted]), np.array([item.axes.T for item in wanted])
    for k in range(iterations):
        center, com_jacobian, position, rotation, jacobians = robot.contacts_and_com(q)
        turn = rotation @ back
        poses = np.concatenate([place - position, 0.5 * _tilt(turn)], axis=1)
        error = np.concatenate([com - center[:2], poses.ravel()])
        size = float(np.abs(error).max())
        pulled = redundant and pull > 0.0 and k == 0
        if size < ACCURACY and not pulled:
            break
        J = np.concatenate([com_jacobian[:2], jacobians.reshape(-1, robot.n)])[:, free]
        if redundant or size > 1e-3:
            step, *_ = np.linalg.lstsq(J, error)
        else:
            step = np.linalg.solve(J, error)
        if pulled:  # the last limb is the arm; in the null space of J it moves without its hand
            wish = pull * (robot.posture - q)[free]
            wish[: -len(limbs[-1])] = 0.0
            step = step + wish - np.linalg.lstsq(J, J @ wish)[0]
        q[free] += step * min(1.0, LONGEST_STEP / max(float(np.abs(step).max()), LONGEST_STEP))
    flipped = np.einsum("kii->k", turn) < 1.0  # the small-angle tilt vanishes at half a turn too
    left = np.where(flipped, np.pi, np.abs(poses).max(axis=1))
    return q, dict(zip(robot.contacts, left.tolist(), strict=True)) | {"com": float(np.abs(error[:2]).max())}


def _tilt(turn: Array) -> Array:
    """Return twice the small rotation vectors (k, 3) that undo the rotations `turn` (k, 3, 3)."""
    return np.stack(
        [turn[:, 1, 2] - turn[:, 2, 1], turn[:, 2, 0] - turn[:, 0, 2], turn[:, 0, 1] - turn[:, 1, 0]], axis=1
    )


def _key(steps: Footsteps, s: float) -> str:
    """Return the key of the start or of the step to which a position on the path belongs."""
    phase = min(int(s * steps.phases), steps.phases - 1)
    return "path.start" if phase == 0 else f"path.steps[{min((phase - 1) // 2, len(steps.swings) - 1)}]"


def _unreachable(steps: Footsteps, s: float, lost: str) -> tuple[str, str]:
    """Return a message about the contact `lost`, which is out of reach at s, and the key to change."""
    if lost in HANDS:
        message = (
            f"{steps.label(s)}: the {_words(lost)} does not reach its place on the rail; expected a rail that is "
            "nearer to the walk, another height of it, or another direction of its normal"
        )
        return message, "path.rail.at"
    message = f"the legs do not reach both feet at s = {s:.3f}; expected a shorter or narrower step, or a lower "
    return message + "path.pelvis_height", _key(steps, s)


def _words(name: str) -> str:
    return name.replace("_", " ")


def _require_no_collision(path: Path, steps: Footsteps, config: Config, robot: Robot, s: Array) -> None:
    """Check that no two bodies collide, such as the legs."""
    found = CollisionCheck(config, robot).first(path(s))
    if found is not None:
        first, second = found.bodies
        raise PathError(
            f"{path.label(float(s[found.index]))}: {first} and {second} collide, {1000 * found.depth:.1f} mm deep; "
            f"expected feet further apart, or, if they may touch, [{first}, {second}] in robot.collision.exclude",
            key=_key(steps, float(s[found.index])),
        )


def _require_no_touch(path: Path, robot: Robot, s: Array, rail: RailConfig) -> None:
    """Check that the robot does not run into the rail that its hand is on."""
    found = first_touch(robot, path(s), rail)
    if found is not None:
        body, bar = found.bodies
        raise PathError(
            f"{path.label(float(s[found.index]))}: {body} and {bar} collide, {1000 * found.depth:.1f} mm deep; "
            "expected another place of the rail, a shorter one, or robot.collision.check: false",
            key="path.rail.at",
        )


def _require_limits(path: Path, steps: Footsteps, robot: Robot, s: Array) -> None:
    """Check that all joints stay within their ranges along the whole path."""
    fine = np.linspace(0.0, 1.0, POINTS_PER_CHECK * (len(s) - 1) + 1)
    q = path(fine)
    beyond = np.maximum(robot.limits.lower - q, q - robot.limits.upper)
    worst, joint = np.unravel_index(int(np.argmax(beyond)), beyond.shape)
    if beyond[worst, joint] <= LIMIT_TOLERANCE:
        return
    of_hand = any(joint in robot.limbs[name] for name in robot.limbs if name in HANDS)
    remedy = "a shorter step, another path.pelvis_height, or another place of the feet"
    raise PathError(
        f"{path.label(float(fine[worst]))}: {limit_sentence(robot, q[worst])}; expected "
        f"{'another place of the rail' if of_hand else remedy}",
        key="path.rail.at" if of_hand else _key(steps, float(fine[worst])),
    )
