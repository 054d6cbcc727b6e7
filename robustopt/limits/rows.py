"""Row families: what each limit demands of (u, x) at every grid point, with all uncertain parameters still open.

Joint acceleration is affine in (u, x). Contact and joint torque are families over the wrenches of the bodies, which
the polygons cut with (see `polygons`). Joint torque has a viscous part D q' sqrt(x), which is replaced by its tangent
at a reference x_r, D q' (sqrt(x_r) / 2 + x / (2 sqrt(x_r))). Where friction hurts, the tangent is an upper bound of a
concave function, hence sound; where it helps, it is not, so a plan counts as solved only once its exact torque has
been checked. Both are exact at x_r, and the reference follows the plan until they agree. Without a reference the
chord over [0, x_top] stands in: a first guess, which is final where no torque row binds.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from robustopt.compiled import compiled
from robustopt.limits import polygons
from robustopt.limits.contact import ContactSystem
from robustopt.limits.polygons import Family, Loads, Polygons
from robustopt.limits.uncertainty import Body, regressor, spin_regressor
from robustopt.robot import Dynamics, JointLimits

Array = np.ndarray

DIRECTION_TOLERANCE = 1e-9
"""A joint slower than this part of the fastest joint's rate counts as at rest: dry friction takes both signs."""

BLOCK = 1000
"""Grid points whose wrenches are put together at once: larger arrays cost the system more than the work on them."""

SLOWEST_REFERENCE = 1e-12
"""Smallest x, as a part of what joint velocity allows, about which viscous torque is linearised: the tangent of a root
is ever steeper towards 0, and here its error is below a millionth of the viscous torque at full speed."""


@dataclass(frozen=True)
class PathMotion:
    """Motion of arm and tray along the path at P grid points, per u, x and joint acceleration error.

    q1, q2: q', q'' (P, n); arm: dynamics of the arm alone; regressors: wrench per inertial parameter, tray frame about
    the tray's origin, (P, 3 + n, 6, 10), second index u, x, 1 and the acceleration error of each joint
    """

    q1: Array
    q2: Array
    arm: Dynamics
    regressors: Array


def path_motion(q1: Array, q2: Array, arm: Dynamics) -> PathMotion:
    points, joints = q1.shape
    carrier = arm.carrier
    assert carrier is not None
    J = carrier.jacobian
    linear, angular = np.zeros((points, 3 + joints, 3)), np.zeros((points, 3 + joints, 3))
    per_u = np.einsum("pij,pj->pi", J, q1)
    per_x = np.einsum("pij,pj->pi", J, q2) + carrier.bias
    linear[:, 0], linear[:, 1], linear[:, 2] = per_u[:, :3], per_x[:, :3], -carrier.gravity
    angular[:, 0], angular[:, 1] = per_u[:, 3:], per_x[:, 3:]
    linear[:, 3:], angular[:, 3:] = np.swapaxes(J[:, :3], 1, 2), np.swapaxes(J[:, 3:], 1, 2)
    regressors = regressor(linear, angular)
    regressors[:, 1] += spin_regressor(per_u[:, 3:])
    return PathMotion(q1, q2, arm, regressors)


@dataclass(frozen=True, eq=False)
class BodyWrenches:
    """Wrenches that a body of unit mass needs along a path, tray frame about the tray's origin.

    wrenches: (K, P, C, 6) of its K sets of inertial parameters, per u, x, 1 and, if C > 3, acceleration error of each
    joint; kind: (K,) what each set is: 0 the body itself, 1 an interval term, 2 a remainder
    """

    wrenches: Array
    kind: Array


def body_wrenches(motion: PathMotion, body: Body, erring: bool) -> BodyWrenches:
    """The wrenches of a body, with those of joint acceleration errors or without."""
    steps = body.linear[np.any(body.linear != 0, axis=1)]
    squares = body.remainder[np.any(body.remainder != 0, axis=1)]
    parameters = np.vstack([body.psi, steps, squares])
    columns = motion.regressors.shape[1] if erring else 3
    wrenches = np.zeros((len(parameters), len(motion.regressors), columns, 6))
    _multiply(motion.regressors, parameters, wrenches)
    return BodyWrenches(wrenches, np.repeat(np.arange(3), [1, len(steps), len(squares)]))


@compiled(fastmath={"contract", "reassoc"})
def _multiply(regressors, parameters, out):
    """out[k, i, c] = regressors[i, c] parameters[k]."""
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
) -> Loads:
    """Loads of stacked objects, each of which carries the bodies listed for it.

    about: the point that the moments of each object are about, (3,); at centres of mass the remainders are
    small; middle, radius: of the joint acceleration error (n,) [rad/s^2]
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
    points, d = parts[0].wrenches.shape[1], 6 * len(loads)
    spread = len(erring) > 0 and bool((kind > 0).any())
    remainder_group = np.r_[group[kind == 2], np.unique(group[kind > 0])] if spread else group[kind == 2]
    result = Loads(
        nominal=np.zeros((points, d, len(groups), 3)),
        terms=np.zeros((points, d, int((kind == 1).sum()), 3)),
        group=group[kind == 1],
        constant=np.zeros((points, d, len(groups) * len(erring))),
        constant_group=np.repeat(np.arange(len(groups)), len(erring)),
        remainder=np.zeros((points, d, len(remainder_group), 3)),
        remainder_group=remainder_group,
        lowest=np.array([1.0] + [body.mass[0] for body in uncertain]),
        highest=np.array([1.0] + [body.mass[1] for body in uncertain]),
    )
    places = np.array(about, dtype=float).reshape(-1, 3)
    for first in range(0, points, BLOCK):
        some = slice(first, first + BLOCK)
        wrenches = np.concatenate([part.wrenches[:, some] for part in parts])
        _fill(result.at(some), wrenches, mass, group, kind, carries, places, middle, radius, erring)
    return result


@compiled()
def _fill(loads, wrenches, mass, group, kind, carries, about, middle, radius, erring):
    """Fill loads (see `body_loads`) with wrenches per unit of mass (K, P, C, 6), grid point by point.

    mass: (K,); carries: which objects carry each set, (K, objects); about: points of the objects' moments (objects, 3)
    """
    nominal, terms, constant, remainder = loads.nominal, loads.terms, loads.constant, loads.remainder
    points, used = wrenches.shape[1], wrenches.shape[2]
    shifted = middle.any()
    origin, w = np.zeros((used, 6)), np.zeros((used, 6))
    spread = remainder.shape[2] > (kind == 2).sum()
    spread_slot, last = np.zeros(len(loads.lowest), np.int64), (kind == 2).sum()
    for g in range(len(loads.lowest)):
        spread_slot[g] = last
        for k in range(len(kind)):
            if group[k] == g and kind[k] > 0:
                last += 1
                break
    for i in range(points):
        term, rest = 0, 0
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
                            remainder[i, row, rest, c] = w[c, r]
                    for n in range(len(erring)):
                        part = w[3 + erring[n], r] * radius[erring[n]]
                        if kind[k] == 0:
                            constant[i, row, group[k] * len(erring) + n] += part
                        elif spread:
                            remainder[i, row, spread_slot[group[k]], 2] += abs(part)
            term, rest = term + (kind[k] == 1), rest + (kind[k] == 2)


@compiled()
def _move(wrenches, about, block, count, out):
    """The first wrenches about the origin (n, 6) as wrenches about the point of a block."""
    x, y, z = about[block, 0], about[block, 1], about[block, 2]
    for c in range(count):
        fx, fy, fz = wrenches[c, 0], wrenches[c, 1], wrenches[c, 2]
        out[c, 0], out[c, 1], out[c, 2] = fx, fy, fz
        out[c, 3] = wrenches[c, 3] - (y * fz - z * fy)
        out[c, 4] = wrenches[c, 4] - (z * fx - x * fz)
        out[c, 5] = wrenches[c, 5] - (x * fy - y * fx)


@dataclass(frozen=True)
class ContactFamily:
    """A contact system and its loads along the path.

    weight: what the facets of the system are divided by, the weight that it carries in all [N]
    first, last: grid points at which the contact exists, both included; to the end of the grid if `last` is negative
    """

    system: ContactSystem
    loads: Loads
    weight: float
    first: int = 0
    last: int = -1

    def holds_at(self, points: Array) -> Array:
        """Which of the grid points (M,) the contact exists at, (M,)."""
        return (points >= self.first) & ((points <= self.last) | (self.last < 0))

    def wrench(self, points: Array, u: Array, x: Array) -> Array:
        """Required wrenches with every parameter at the middle of its interval, stacked, (M, d) [N, N m].

        points: (M,) grid point of each; u, x: (M,)
        """
        coefficients = self.loads.middle()[points]
        return coefficients[:, :, 0] * u[:, None] + coefficients[:, :, 1] * x[:, None] + coefficients[:, :, 2]


@dataclass(frozen=True)
class TorqueFamily:
    """Joint torque, rows divided by their limits: first +tau_j, then -tau_j.

    B: rows over the payload's wrench (P, 2n, 6); base: arm, dry friction and limit (P, 2n, 3); base_terms: acceleration
    error of the arm's own inertia (P, 2n, n_c); viscous: coefficient of sqrt(x) (P, 2n)
    """

    B: Array
    loads: Loads
    base: Array
    base_terms: Array
    viscous: Array

    def carrying(self, payload: Loads, base_terms: Array) -> TorqueFamily:
        """The same limits with another payload, and other acceleration errors about the same middle."""
        return replace(self, loads=payload, base_terms=base_terms)

    def family(self, reference: Array, x_top: Array, used: Array, names: Array) -> Family:
        """The rows that are used, (2n,), with the viscous part linearised about a reference (P,), and their names."""
        B, base, base_terms = self.B, self.base_at(reference, x_top), self.base_terms
        if not used.all():
            B, base, base_terms = (np.ascontiguousarray(part[:, used]) for part in (B, base, base_terms))
        return Family(B, self.loads, base, base_terms, names[used])

    def cut(self, outline: Polygons, reference: Array, x_top: Array, used: Array, names: Array) -> Polygons:
        """Polygons cut with the rows that are used, (2n,), each of the names (2n,)."""
        return polygons.cut(outline, self.family(reference, x_top, used, names))

    def base_at(self, reference: Array, x_top: Array) -> Array:
        """Affine base rows with the viscous part linearised, (P, 2n, 3); reference (P,), nan for none."""
        base = self.base.copy()
        if np.isnan(reference).all():
            base[:, :, 1] += self.viscous / np.sqrt(x_top)[:, None]
            return base
        slowest = np.maximum(reference, SLOWEST_REFERENCE * x_top)
        root = np.sqrt(np.where(reference > 0, slowest, np.nan))[:, None]
        tangent, chord = np.isfinite(root), np.isnan(reference)[:, None]
        base[:, :, 1] += np.where(
            tangent, self.viscous / (2 * root), np.where(chord, self.viscous / np.sqrt(x_top)[:, None], 0.0)
        )
        base[:, :, 2] += np.where(tangent, self.viscous * root / 2, 0.0)
        return base

    def nominal(self, joint: int) -> tuple[Array, Array]:
        """Torque of a joint as a fraction of its limit: coefficients of (u, x, 1), (P, 3), and of sqrt(x), (P,).

        The mean of a joint's two rows drops the limit and keeps what changes its sign with the torque.
        """
        n = self.B.shape[1] // 2
        rows = np.einsum("pfd,pdk->pfk", self.B, self.loads.middle()) + self.base
        return 0.5 * (rows[:, joint] - rows[:, n + joint]), self.viscous[:, joint]

    def excess(self, u: Array, x: Array, points: Array) -> Array:
        """Largest torque over all uncertain parameters, as a fraction of the limit, minus 1; exact viscous part.

        u, x: (M,); points: (M,) grid point of each; returns (M, 2n)
        """
        family = Family(self.B, self.loads, self.base, self.base_terms, np.arange(self.B.shape[1]))
        return polygons.evaluate(family, points, u, x) + self.viscous[points] * np.sqrt(np.maximum(x, 0.0))[:, None]


def both(array: Array) -> Array:
    """The values of all joints (P, n, ...) for the rows of +tau, then for those of -tau, (P, 2n, ...)."""
    return np.concatenate([array, array], axis=1)


def torque_family(motion: PathMotion, limits: JointLimits, loads: Loads, middle: Array, radius: Array) -> TorqueFamily:
    """Joint torque limits with a payload; middle, radius: of the joint acceleration error (n,) [rad/s^2]."""
    points, joints = motion.q1.shape
    arm, limit = motion.arm, np.r_[limits.torque, limits.torque]
    assert arm.carrier is not None
    sign = np.r_[np.ones(joints), -np.ones(joints)]
    B = both(np.swapaxes(arm.carrier.jacobian, 1, 2)) * (sign / limit)[:, None]
    moving = np.abs(motion.q1) > DIRECTION_TOLERANCE * np.abs(motion.q1).max(axis=1, keepdims=True)
    direction = np.where(_changes_sign(motion.q1) | ~moving, np.nan, np.sign(motion.q1))
    resisting = np.where(np.isnan(both(direction)), 1.0, both(direction) * sign)
    base = np.stack([both(part) * sign for part in (arm.force_u, arm.force_x, arm.force_0)], axis=2)
    base[:, :, 2] += both(arm.mass_matrix @ middle) * sign + both(np.tile(limits.dry_friction, (points, 1))) * resisting
    base /= limit[:, None]
    base[:, :, 2] -= 1.0
    viscous = both(limits.viscous_friction * motion.q1) * (sign / limit)
    return TorqueFamily(B, loads, base, own_inertia_terms(motion, limits, loads, radius), viscous)


def own_inertia_terms(motion: PathMotion, limits: JointLimits, loads: Loads, radius: Array) -> Array:
    """What each constant interval term of a payload's loads adds to the torque rows by the arm's own inertia,
    (P, 2n, n_c)."""
    erring, n = np.flatnonzero(radius), motion.q1.shape[1]
    terms = np.zeros((len(motion.q1), 2 * n, len(loads.constant_group)))
    terms[:, :n, : len(erring)] = motion.arm.mass_matrix[:, :, erring] * radius[erring] / limits.torque[:, None]
    terms[:, n:] = -terms[:, :n]
    return terms


def _changes_sign(q1: Array) -> Array:
    """Whether q' of a joint changes its sign towards a neighbouring grid point, (P, n)."""
    flips = np.sign(q1[1:]) != np.sign(q1[:-1])
    result = np.zeros(q1.shape, dtype=bool)
    result[1:] |= flips
    result[:-1] |= flips
    return result


class JointMotion(Protocol):
    """Motion of the joints along a path: q', q'' (P, n)."""

    @property
    def q1(self) -> Array: ...

    @property
    def q2(self) -> Array: ...


def acceleration_rows(motion: JointMotion, limits: JointLimits, middle: Array, radius: Array) -> Array:
    """+-(q' u + q'' x + middle) + radius <= limit, divided by the limit, (P, 2n, 3)."""
    rows = np.stack([motion.q1, motion.q2, np.broadcast_to(middle, motion.q1.shape)], axis=2)
    rows = np.concatenate([rows, -rows], axis=1)
    rows[:, :, 2] += np.r_[radius, radius]
    rows /= np.r_[limits.acceleration, limits.acceleration][:, None]
    rows[:, :, 2] -= 1.0
    return rows


def evaluate(B: Array, loads: Loads, base: Array, base_terms: Array, u: Array, x: Array) -> Array:
    """Values of a row family at (u, x) with every parameter at its worst, (M, F): the formula of `polygons`, in numpy.

    B: (M, F, d) or (F, d); loads at M points; base (M, F, 3) or (0, 0, 3); base_terms (M, F, n_c) or (0, 0, 0)
    """
    point = np.stack([u, x, np.ones_like(u)], axis=1)
    nominal = B @ np.einsum("mdgk,mk->mdg", loads.nominal, point)
    terms = B @ np.einsum("mdnk,mk->mdn", loads.terms, point)
    constant = B @ loads.constant + (base_terms if base_terms.size else 0.0)
    remainder = np.abs(B) @ np.abs(np.einsum("mdnk,mk->mdn", loads.remainder, point))
    values = np.einsum("mfk,mk->mf", base, point) if base.size else 0.0
    for g, (lowest, highest) in enumerate(zip(loads.lowest, loads.highest, strict=True)):
        v = nominal[..., g] + np.abs(terms[..., loads.group == g]).sum(axis=-1)
        v = v + np.abs(constant[..., loads.constant_group == g]).sum(axis=-1)
        v = v + remainder[..., loads.remainder_group == g].sum(axis=-1)
        values = values + np.where(v > 0, highest, lowest) * v
    return np.asarray(values)


def worst_wrench(loads: Loads, y: Array, u: Array, x: Array) -> Array:
    """The wrench inside the box of the parameters that a direction y likes least: the argument of `evaluate`, (M, d).

    y: (M, d); loads at M points; u, x: (M,)
    """
    point = np.stack([u, x, np.ones_like(u)], axis=1)
    nominal = np.einsum("mdgk,mk->mdg", loads.nominal, point)
    terms = np.einsum("mdnk,mk->mdn", loads.terms, point)
    sizes = np.abs(np.einsum("mdnk,mk->mdn", loads.remainder, point))
    total = np.zeros_like(y)
    for g, (lowest, highest) in enumerate(zip(loads.lowest, loads.highest, strict=True)):
        w = nominal[..., g]
        for swing in (terms[..., loads.group == g], loads.constant[..., loads.constant_group == g]):
            w = w + np.einsum("mdn,mn->md", swing, np.sign(np.einsum("md,mdn->mn", y, swing)))
        w = w + np.sign(y) * sizes[..., loads.remainder_group == g].sum(axis=-1)
        total += np.where(np.einsum("md,md->m", y, w) > 0, highest, lowest)[:, None] * w
    return total
