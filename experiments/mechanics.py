"""What the objects of a configuration need, by Newton and Euler, body by body: an oracle for the rows of a problem.

Nothing here is shared with the package but the configuration, where the objects stand, and the joint path.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from scipy.spatial.transform import Rotation

from robustopt.config import Config
from robustopt.limits import TimeScalingProblem
from robustopt.scene.placement import placements

STEP = 2e-4
"""Time step of the finite differences [s]: errors of 1e-7 of the accelerations met here."""


@dataclass(frozen=True)
class Draw:
    """Values of uncertain parameters: factor of each mass, shift of each centre of mass, joint acceleration error."""

    mass: Mapping[str, float]
    shift: Mapping[str, np.ndarray]
    error: np.ndarray


@dataclass(frozen=True)
class Motion:
    """Acceleration of the tray's origin less gravity, angular acceleration and velocity, tray frame, (3,) each."""

    linear: np.ndarray
    angular: np.ndarray
    omega: np.ndarray


def tray_motion(problem: TimeScalingProblem, point: int, u: float, x: float, error: np.ndarray) -> Motion:
    """Motion of the tray at a grid point by finite differences in time, plus what a joint acceleration error adds."""
    s, piece, robot = problem.s[point], problem.piece[[point]], problem.robot
    # a Taylor step in the joints, because s may not go beyond the ends of a piece
    q, q1, q2 = (problem.path.evaluate(np.array([s]), piece, order)[0] for order in range(3))
    velocity, acceleration = q1 * np.sqrt(x), q1 * u + q2 * x + error
    times = np.array([-STEP, 0.0, STEP])
    positions, rotations = robot.carrier_pose(q + np.outer(times, velocity) + 0.5 * np.outer(times**2, acceleration))
    linear = (positions[0] - 2 * positions[1] + positions[2]) / STEP**2
    before, after = (Rotation.from_matrix(rotations[k] @ rotations[1].T).as_rotvec() for k in (0, 2))
    into_tray = rotations[1].T
    gravity = np.array(problem.config.gravity)
    return Motion(
        into_tray @ (linear - gravity),
        into_tray @ (before + after) / STEP**2,
        into_tray @ (after - before) / (2 * STEP),
    )


def inertia(config: Config, name: str) -> np.ndarray:
    body = config.tray if name == "tray" else config.objects[name]
    if body.inertia is not None:
        values = [*body.inertia, 0.0, 0.0, 0.0][:6]
        xx, yy, zz, xy, xz, yz = values
        return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    if body.size is not None:
        x, y, z = body.size
        return body.mass / 12 * np.diag([y * y + z * z, x * x + z * z, x * x + y * y])
    side = body.mass * (body.radius**2 / 4 + body.height**2 / 12)
    return np.diag([side, side, body.mass * body.radius**2 / 2])


def required_wrench(config: Config, names: Sequence[str], draw: Draw, motion: Motion, about: np.ndarray) -> np.ndarray:
    """Wrench that must act on the named bodies together, tray frame, moments about a point (3,), shape (6,)."""
    placed = placements(config)
    total = np.zeros(6)
    for name in names:
        body = config.tray if name == "tray" else config.objects[name]
        origin = np.zeros(3) if name == "tray" else placed[name].position
        turn = Rotation.from_euler("z", 0.0 if name == "tray" else placed[name].yaw).as_matrix()
        r = origin + turn @ (np.array(body.center_of_mass) + draw.shift.get(name, np.zeros(3)))
        factor = draw.mass.get(name, 1.0)
        I = factor * turn @ inertia(config, name) @ turn.T  # noqa: E741
        alpha, omega = motion.angular, motion.omega
        force = factor * body.mass * (motion.linear + np.cross(alpha, r) + np.cross(omega, np.cross(omega, r)))
        moment = I @ alpha + np.cross(omega, I @ omega)
        total += np.r_[force, moment + np.cross(r - about, force)]
    return total


def nominal(problem: TimeScalingProblem) -> Draw:
    error = problem.config.uncertainty.joint_acceleration
    mean = np.broadcast_to(0.0 if error is None else np.asarray(error.mean), problem.robot.n)
    return Draw({}, {}, mean)


def box(problem: TimeScalingProblem) -> list[tuple[str, str, int, float, float]]:
    """The uncertain numbers of a problem: kind, body, index, lowest and highest value."""
    config, found = problem.config, []
    for name, (low, high) in config.uncertainty.mass.items():
        mass = config.tray.mass if name == "tray" else config.objects[name].mass
        found.append(("mass", name, 0, low / mass, high / mass))
    for name, sizes in config.uncertainty.center_of_mass.items():
        found += [("shift", name, k, -size, size) for k, size in enumerate(sizes) if size > 0]
    error = config.uncertainty.joint_acceleration
    if error is not None:
        mean = np.broadcast_to(error.mean, problem.robot.n)
        radius = error.K * np.broadcast_to(error.deviation, problem.robot.n)
        found += [("error", "", k, mean[k] - radius[k], mean[k] + radius[k]) for k in np.flatnonzero(radius)]
    return found


def draw_of(problem: TimeScalingProblem, shares: Sequence[float]) -> Draw:
    """The draw at shares (0 to 1) of the intervals of `box`."""
    mass: dict[str, float] = {}
    shift: dict[str, np.ndarray] = {}
    error = np.array(nominal(problem).error)
    for (kind, name, k, low, high), share in zip(box(problem), shares, strict=True):
        value = low + share * (high - low)
        if kind == "mass":
            mass[name] = value
        elif kind == "shift":
            shift.setdefault(name, np.zeros(3))[k] = value
        else:
            error[k] = value
    return Draw(mass, shift, error)


def corners(problem: TimeScalingProblem) -> Iterator[Draw]:
    for shares in product((0.0, 1.0), repeat=len(box(problem))):
        yield draw_of(problem, shares)


def random_draws(problem: TimeScalingProblem, count: int, rng: np.random.Generator) -> Iterator[Draw]:
    """Draws from the box, half of them corners, where the worst usually is."""
    size = len(box(problem))
    for k in range(count):
        yield draw_of(problem, rng.uniform(size=size) if k % 2 else rng.integers(2, size=size).astype(float))
