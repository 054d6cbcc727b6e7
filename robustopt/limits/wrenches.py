"""Required wrenches of the objects, which their contacts must supply, as functions of the uncertain quantities."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from robustopt.arrays import Array
from robustopt.compiled import compiled, merged
from robustopt.limits.bodies import Body
from robustopt.limits.motion import PathMotion
from robustopt.limits.polygons import RequiredWrench

BLOCK = 1000
"""Number of grid points processed at once: the allocation of larger arrays costs more than the work on them."""


def no_wrench(points: int, dimension: int) -> RequiredWrench:
    """Return a required wrench of zero.

    Args:
        points: number P of grid points.
        dimension: number d of coordinates of the wrench.
    """
    none = np.zeros((points, dimension, 0, 3))
    group = np.zeros(0, dtype=np.int64)
    return RequiredWrench(
        np.zeros((points, dimension, 1, 3)), none, group, none, group, np.zeros(0), np.zeros(0, dtype=bool),
        np.zeros((points, dimension, 0)), group, np.zeros((points, dimension, 0, 0)), np.ones(1), np.ones(1),
    )  # fmt: skip


@dataclass(frozen=True, eq=False)
class BodyWrenches:
    """Required wrenches of a body of unit mass along a path, about the carrier's origin, carrier axes.

    Attributes:
        wrenches: of K sets of inertial parameters, per u, x, 1 and, if C > 3, acceleration error of each coordinate
            (K, P, C, 6).
        kind: 0 for the body itself, 1 for an interval term, 2 for a second moment (K,).
    """

    wrenches: Array
    kind: Array


def body_wrenches(motion: PathMotion, body: Body, erring: bool) -> BodyWrenches:
    """Return the required wrenches of a body along a path.

    Args:
        motion: motion along the path.
        body: the body.
        erring: whether to include the wrenches of acceleration errors.
    """
    parameters = np.vstack([body.psi, body.linear, body.moments])
    columns = motion.wrench_map.shape[1] if erring else 3
    wrenches = np.zeros((len(parameters), len(motion.wrench_map), columns, 6))
    _multiply(motion.wrench_map, parameters, wrenches)
    return BodyWrenches(wrenches, np.repeat(np.arange(3), [1, len(body.linear), len(body.moments)]))


@compiled(fastmath={"contract", "reassoc"}, _nrt=False)
def _multiply(regressors, parameters, out):
    """Compute out[k, i, c] = regressors[i, c] parameters[k]."""
    for k in range(out.shape[0]):
        for i in range(out.shape[1]):
            for c in range(out.shape[2]):
                for r in range(6):
                    product = 0.0
                    for m in range(10):
                        product += regressors[i, c, r, m] * parameters[k, m]
                    out[k, i, c, r] = product


def body_loads(
    loads: Sequence[Sequence[Body]],
    about: Sequence[Array],
    middle: Array,
    radius: Array,
    wrenches_of: Callable[[Body], BodyWrenches],
) -> RequiredWrench:
    """Return the required wrenches of stacked objects, each of which carries the bodies listed for it.

    Args:
        loads: for each object the bodies that it carries, itself included.
        about: reference point of the moments of each object (3,) [m]; near centres of mass the products are small.
        middle: middle of the acceleration error (n,) [rad/s^2 or m/s^2].
        radius: half-width of the acceleration error (n,) [rad/s^2 or m/s^2].
        wrenches_of: function that returns the required wrenches of a body.
    """
    listed = {body.name: body for row in loads for body in row}
    certain = [body for body in listed.values() if body.mass[0] == body.mass[1]]
    uncertain = [body for body in listed.values() if body.mass[0] < body.mass[1]]
    groups = [[(body, body.mass[0]) for body in certain]] + [[(body, 1.0)] for body in uncertain]
    erring = np.flatnonzero(radius)
    members = [(body, mass, g) for g, group in enumerate(groups) for body, mass in group]
    parts = [wrenches_of(body) for body, _, _ in members]
    kind = np.concatenate([part.kind for part in parts])
    lengths = [len(part.kind) for part in parts]
    mass, group = (np.repeat([member[k] for member in members], lengths) for k in (1, 2))
    carries = np.repeat([[body in row for row in loads] for body, _, _ in members], lengths, axis=0)
    points, d, varying = parts[0].wrenches.shape[1], 6 * len(loads), int((kind > 0).sum())
    moments = [(body, g) for body, _, g in members if len(body.moments)]
    result = RequiredWrench(
        nominal=np.zeros((points, d, len(groups), 3)),
        terms=np.zeros((points, d, int((kind == 1).sum()), 3)),
        group=group[kind == 1],
        moments=np.zeros((points, d, int((kind == 2).sum()), 3)),
        moment_group=np.array([g for _, g in moments], dtype=np.int64),
        usual=np.concatenate([np.zeros(0), *(body.usual for body, _ in moments)]),
        round=np.array([body.round for body, _ in moments], dtype=bool),
        constant=np.zeros((points, d, len(groups) * len(erring))),
        constant_group=np.repeat(np.arange(len(groups)), len(erring)),
        products=np.zeros((points, d, varying, len(erring))),
        lowest=np.array([1.0] + [body.mass[0] for body in uncertain]),
        highest=np.array([1.0] + [body.mass[1] for body in uncertain]),
    )
    places = np.array(about, dtype=float).reshape(-1, 3)
    for first in range(0, points, BLOCK):
        some = slice(first, first + BLOCK)
        wrenches = np.concatenate([part.wrenches[:, some] for part in parts])
        _fill(
            result.at(some), wrenches, mass, group, kind, carries, places, middle, radius, erring, bool(middle.any()),
            *np.zeros((2, wrenches.shape[2], 6)),
        )  # fmt: skip
    return result


@compiled(_nrt=False)
def _fill(loads, wrenches, mass, group, kind, carries, about, middle, radius, erring, shifted, origin, w):
    """Fill the result of `body_loads` with wrenches per unit of mass (K, P, C, 6), grid point by point.

    mass: (K,); carries: which objects carry each set (K, objects); about: reference points (objects, 3); shifted:
    whether the middle of the acceleration error is not zero; origin, w: work arrays (C, 6)
    """
    nominal, terms, moments, constant, products = (
        loads.nominal,
        loads.terms,
        loads.moments,
        loads.constant,
        loads.products,
    )
    points, used = wrenches.shape[1], wrenches.shape[2]
    for i in range(points):
        term, moment = 0, 0
        for k in range(len(kind)):
            for c in range(used):
                for r in range(6):
                    origin[c, r] = mass[k] * wrenches[k, i, c, r]
            for block in range(carries.shape[1]):
                if not carries[k, block]:
                    continue
                _move(origin, about, block, used, w)
                if shifted:
                    for e in range(len(middle)):
                        for r in range(6):
                            w[2, r] += middle[e] * w[3 + e, r]
                for r in range(6):
                    row = 6 * block + r
                    for c in range(3):
                        if kind[k] == 0:
                            nominal[i, row, group[k], c] += w[c, r]
                        elif kind[k] == 1:
                            terms[i, row, term, c] = w[c, r]
                        else:
                            moments[i, row, moment, c] = w[c, r]
                    for n in range(len(erring)):
                        part = w[3 + erring[n], r] * radius[erring[n]]
                        if kind[k] == 0:
                            constant[i, row, group[k] * len(erring) + n] += part
                        elif kind[k] == 1:
                            products[i, row, term, n] = part
                        else:
                            products[i, row, terms.shape[2] + moment, n] = part
            term, moment = term + (kind[k] == 1), moment + (kind[k] == 2)


@merged
def _move(wrenches, about, block, count, out):
    """Turn the first wrenches about the origin (n, 6) into wrenches about the point of a block."""
    x, y, z = about[block, 0], about[block, 1], about[block, 2]
    for c in range(count):
        fx, fy, fz = wrenches[c, 0], wrenches[c, 1], wrenches[c, 2]
        out[c, 0], out[c, 1], out[c, 2] = fx, fy, fz
        out[c, 3] = wrenches[c, 3] - (y * fz - z * fy)
        out[c, 4] = wrenches[c, 4] - (z * fx - x * fz)
        out[c, 5] = wrenches[c, 5] - (x * fy - y * fx)


# Forces that press objects against the tool ----------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Finger:
    """The driven finger of a gripper: a mass that moves along the closing axis, accelerated by the closing force.

    Attributes:
        mass: mass of the finger [kg].
        point: centre of its pad, carrier frame (3,) [m].
        direction: closing direction, carrier frame (3,).
    """

    mass: float
    point: Array
    direction: Array


def with_forces(
    loads: RequiredWrench,
    forces: Sequence[tuple[float, float]],
    fingers: Sequence[Finger | None],
    motion: PathMotion,
    error: tuple[Array, Array],
) -> RequiredWrench:
    """Return required wrenches with the forces that press objects against the tool as additional coordinates.

    The driven finger takes the force m (a - g) along its closing axis, so the part receives less by this force.

    Args:
        loads: required wrenches (P, d, ...).
        forces: lowest and highest value of each of the k forces that counts [N].
        fingers: finger of each force, None for a vacuum or a finger without mass.
        motion: motion along the path.
        error: middle and half-width of the acceleration error, (n,) each.

    Returns:
        Required wrenches with d + k coordinates.
    """
    d, more = loads.nominal.shape[1], [(0, 0), (0, len(forces)), (0, 0), (0, 0)]
    nominal, constant = np.pad(loads.nominal, more), np.pad(loads.constant, more[:3])
    swings = np.zeros((len(constant), d + len(forces), 0))
    for j, ((low, high), finger) in enumerate(zip(forces, fingers, strict=True)):
        nominal[:, d + j, 0, 2] = 0.5 * (low + high)
        if high > low:
            swings = np.pad(swings, [(0, 0), (0, 0), (0, 1)])
            swings[:, d + j, -1] = 0.5 * (high - low)
        if finger is not None:
            taken, shaken = _finger_force(finger, motion, error)
            nominal[:, d + j, 0] -= taken
            constant[:, d + j, : shaken.shape[1]] -= shaken
    return loads._replace(
        nominal=nominal,
        terms=np.pad(loads.terms, more),
        moments=np.pad(loads.moments, more),
        constant=np.concatenate([constant, swings], axis=2),
        constant_group=np.r_[loads.constant_group, np.zeros(swings.shape[2], dtype=loads.constant_group.dtype)],
        products=np.pad(loads.products, more),
    )


def _finger_force(finger: Finger, motion: PathMotion, error: tuple[Array, Array]) -> tuple[Array, Array]:
    """Return the force that a finger takes, per u, x and 1 (P, 3), and per acceleration error (P, erring)."""
    (middle, radius), r = error, finger.point
    moments = np.array([*(r @ r - r * r), -r[0] * r[1], -r[0] * r[2], -r[1] * r[2]])
    parameters = finger.mass * np.concatenate([[1.0], r, moments])
    along = (motion.wrench_map[:, :, :3] @ parameters) @ finger.direction
    taken = along[:, :3].copy()
    taken[:, 2] += along[:, 3:] @ middle
    erring = np.flatnonzero(radius)
    return taken, along[:, 3 + erring] * radius[erring]
