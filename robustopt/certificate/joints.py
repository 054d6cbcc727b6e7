"""Utilisation of the joint limits: position, velocity, acceleration with its error, torque with load and friction."""

from __future__ import annotations

import numpy as np

from robustopt.certificate.contact_points import Array
from robustopt.certificate.loads import Functional, Load, Tray, at_lowest, body_loads, tray_motion
from robustopt.certificate.motion import Motion
from robustopt.certificate.scene import Parameters, Scene
from robustopt.certificate.tally import Found, Tally


def check_kinematics(scene: Scene, motion: Motion, tally: Tally) -> None:
    """Position, velocity and acceleration; the acceleration with the worse end of its error."""
    low, high = scene.lower.error[:, None] * motion.free, scene.upper.error[:, None] * motion.free
    above, below = motion.acceleration + high, motion.acceleration + low
    acceleration = np.maximum(above, -below) / motion.limits.acceleration[:, None]
    chosen = np.where(above > -below, scene.upper.error[:, None], scene.lower.error[:, None])
    velocity = np.abs(motion.velocity) / motion.limits.velocity[:, None]
    for kind, utilisation in (("position", _position(motion)), ("velocity", velocity), ("acceleration", acceleration)):
        for j, joint in enumerate(scene.joints):
            for t in tally.peaks(utilisation[j]):
                parameters: dict[str, object] = {}
                if kind == "acceleration" and (scene.lower.error[j] or scene.upper.error[j]):
                    parameters = {"joint_acceleration": {joint: float(chosen[j, t])}}
                name = f"{joint} {kind}"
                tally.add(name, Found(float(utilisation[j, t]), t, name, parameters))
        tally.tests += utilisation.size


def _position(motion: Motion) -> Array:
    """Distance from the middle of the range as a share of its half; 0 for a joint without limits, (n, T).

    With one limit only there is no range: 1 plus the distance beyond the limit [rad or m], at least 0.
    """
    low, high = motion.limits.lower[:, None], motion.limits.upper[:, None]
    both = np.isfinite(low) & np.isfinite(high)
    bottom, top = np.where(both, low, -1.0), np.where(both, high, 1.0)
    middle, half = 0.5 * (bottom + top), 0.5 * (top - bottom)
    beyond = np.maximum(motion.position - high, low - motion.position)
    return np.where(both, np.abs(motion.position - middle) / half, np.maximum(0.0, 1.0 + beyond))


def torques(motion: Motion, tray_load: Load, error: Array) -> Array:
    """Joint torque for the wrench on all carried bodies and an acceleration error (n, ...): (n, ...) [N m].

    Joints that do not move count with their dry friction on the worse side.
    """
    wrench = tray_load[0] + tray_load[1]
    torque = []
    for joint in range(len(error)):
        value = motion.torque[joint] + sum(motion.jacobian[k, joint] * wrench[k] for k in range(6))
        for other, shaking in enumerate(error):
            if np.any(shaking):
                value = value + motion.mass_matrix[joint, other] * motion.free * shaking
        torque.append(value + motion.sticking[joint] * np.where(value < 0.0, -1.0, 1.0))
    return np.stack(torque)


def torque_utilisation(scene: Scene, motion: Motion, tray: Tray, values: Parameters) -> Array:
    """|torque| / limit for parameters that broadcast against the instants, (n, ...)."""
    return load_utilisation(motion, body_loads(scene, tray, values), values.error)


def load_utilisation(motion: Motion, loads: list[Load], error: Array) -> Array:
    """|torque| / limit for the wrenches on all bodies, (n, ...)."""
    rest, move = loads[0]
    for more in loads[1:]:
        rest, move = rest + more[0], move + more[1]
    torque = np.abs(torques(motion, (rest, move), error))
    return np.asarray(torque / motion.limits.torque.reshape(-1, *[1] * (torque.ndim - 1)))


def check_torque(scene: Scene, motion: Motion, start: Parameters, tally: Tally) -> None:
    """Torque at the ends of the intervals that are worst for each joint and sign, at every instant.

    The torque of a joint is a linear function of the wrenches on the bodies and of the acceleration error, so the ends
    are found exactly but for the product of the two.
    """
    for j, joint in enumerate(scene.joints):
        for sign in (1.0, -1.0):
            values = start
            if scene.uncertain:
                goal = Functional(-sign * motion.jacobian[:3, j], -sign * motion.jacobian[3:, j])
                goals = [(b, goal) for b in range(len(scene.bodies))]
                values = at_lowest(scene, motion, start, goals, -sign * motion.mass_matrix[j])
            utilisation = torque_utilisation(scene, motion, tray_motion(motion, values.error), values)[j]
            for t in tally.peaks(utilisation):
                name = f"{joint} torque"
                tally.add(name, Found(float(utilisation[t]), t, name, scene.describe(values.at(t), None)))
            tally.tests += utilisation.size
