"""The limits of the joint torques.

A joint's torque is a row over required wrenches: over the wrench of all objects for an arm, J^T w; over the generalised
force of the motion for a legged robot, less J^T of the wrench of its contact if there is only one. Several contacts
share the wrench: rows for the joints between them are found by programs (`solvers.sharing`).

Joint friction adds a viscous part D q' sqrt(x), which is replaced by its tangent at a reference x_r,
D q' (sqrt(x_r) / 2 + x / (2 sqrt(x_r))) (our choice). If friction resists the motor, the tangent is an upper bound of a
concave function, hence sound. If friction helps, it is not, so a plan counts as solved only once its exact torque has
been checked. The tangent is exact at x_r, and the reference follows the plan until the two agree. Without a reference
the chord over [0, x_top] is used: a first guess, which is final if no torque row binds.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import NamedTuple

import numpy as np

from robustopt.arrays import Array, Flags, Indices
from robustopt.limits import polygons
from robustopt.limits.contact_limit import ContactLimit
from robustopt.limits.motion import PathMotion
from robustopt.limits.names import LimitName
from robustopt.limits.polygons import Family, Polygons, RequiredWrench
from robustopt.limits.torque_sharing import SharedRow, Sharing, always
from robustopt.robot import JointLimits

DIRECTION_TOLERANCE = 1e-9
"""A joint slower than this fraction of the fastest joint counts as at rest: its dry friction takes both signs."""

SLOWEST_REFERENCE = 1e-12
"""Smallest x, as a fraction of the largest that the joint velocities allow, about which viscous torque is linearised.
The tangent of a root gets ever steeper towards 0; here its error is below a millionth of the viscous torque at full
speed."""


class TorqueRows(NamedTuple):
    """The rows of the joint torques, those of +tau first.

    Attributes:
        B: rows over the required wrench (P, 2n, d); 0 for torques that depend on how contacts share it.
        base: affine part of the rows: links, dry friction and limit (P, 2n, 3).
        viscous: coefficient of sqrt(x) (P, 2n).
    """

    B: Array
    base: Array
    viscous: Array


@dataclass(frozen=True, eq=False)
class TorqueLimit:
    """The limits of the joint torques. Rows are divided by their limits; those of +tau come first, then those of -tau.

    Rows of joints without a limit hold their torques (see `torque_scale`) and count for nothing. If no joint has a
    limit, the rows are made only for those who ask for torques.

    Attributes:
        names: names of the limits (n,).
        made_rows: function that returns the rows, and makes them in its first call.
        loads: the required wrench.
        base_terms: contribution of each constant interval term of the wrench to a row (P, 2n, n_c), or (0, 0, 0) for
            none.
        limited: which rows have a finite limit (2n,).
        x_top: largest x that the joint velocities allow (P,).
        reference: x about which the viscous torque is linearised (P,), nan for none.
        sharing: sharing of the wrench between environment contacts.
    """

    names: tuple[LimitName, ...]
    made_rows: Callable[[], TorqueRows]
    loads: RequiredWrench
    base_terms: Array
    limited: Flags
    x_top: Array
    reference: Array
    sharing: Sharing

    @property
    def load_rows(self) -> Array:
        """Return the rows over the required wrench (P, 2n, d)."""
        return self.made_rows().B

    @property
    def base(self) -> Array:
        """Return the affine part of the rows (P, 2n, 3)."""
        return self.made_rows().base

    @property
    def viscous(self) -> Array:
        """Return the coefficient of sqrt(x) in the rows (P, 2n)."""
        return self.made_rows().viscous

    def carrying(self, payload: RequiredWrench, base_terms: Array) -> TorqueLimit:
        """Return the same limits with another payload and other half-widths of the acceleration error.

        Args:
            payload: required wrench of the payload.
            base_terms: contribution of each constant interval term to a row (P, 2n, n_c).
        """
        return replace(self, loads=payload, base_terms=base_terms, sharing=replace(self.sharing, loads=payload))

    def with_reference(self, reference: Array) -> TorqueLimit:
        """Return the same limits with the viscous torque linearised about another x.

        Args:
            reference: the x (P,), nan for none.
        """
        return replace(self, reference=reference)

    def with_rows(self, rows: Sequence[SharedRow]) -> TorqueLimit:
        """Return the same limits with further rows of shared wrenches.

        Args:
            rows: the rows.
        """
        return replace(self, sharing=replace(self.sharing, rows=(*self.sharing.rows, *rows)))

    def cut(self, outline: Polygons, index: Indices, used: Flags) -> Polygons:
        """Return the polygons cut with the rows; see `Limit`.

        Args:
            outline: feasible polygons so far.
            index: number of each name in the problem (n,).
            used: which of the names count (n,).
        """
        chosen = np.tile(used, 2) & self.limited
        if not chosen.any() and not self.sharing.rows:
            return outline
        B, base, terms = self.load_rows, self.base_at(self.reference, self.x_top), self.base_terms
        if not chosen.all():
            B, base = B[:, chosen], np.ascontiguousarray(base[:, chosen])
            terms = np.ascontiguousarray(terms[:, chosen]) if terms.size else terms
        family = Family(np.ascontiguousarray(B), self.loads, base, terms, np.tile(index, 2)[chosen])
        outline = polygons.cut(outline, family)
        shared = self.sharing.family(used, index)
        return outline if shared is None else polygons.cut(outline, shared)

    def base_at(self, reference: Array, x_top: Array) -> Array:
        """Return the affine part of the rows with the viscous torque linearised, (P, 2n, 3).

        The tangent at the reference, or the chord over [0, x_top] without one (our choice); see the head of the module.

        Args:
            reference: x about which the viscous torque is linearised (P,), nan for none.
            x_top: largest x that the joint velocities allow (P,).
        """
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
        """Return the torque of a joint as a fraction of its limit.

        In half the difference of a joint's two rows the limit cancels.

        Args:
            joint: index of the joint.

        Returns:
            Coefficients of (u, x, 1) (P, 3), and of sqrt(x) (P,).
        """
        n = self.load_rows.shape[1] // 2
        rows = np.einsum("pfd,pdk->pfk", self.load_rows, self.loads.middle()) + self.base
        return 0.5 * (rows[:, joint] - rows[:, n + joint]), self.viscous[:, joint]

    def torques(self, u: Array, x: Array) -> Array:
        """Return the nominal torques at the grid points as fractions of the limits, joint friction included, (P, n).

        Args:
            u: sdd (P,).
            x: sd^2 (P,).
        """
        columns = []
        for joint in range(self.load_rows.shape[1] // 2):
            coefficients, viscous = self.nominal(joint)
            affine = coefficients[:, 0] * u + coefficients[:, 1] * x + coefficients[:, 2]
            columns.append(affine + viscous * np.sqrt(np.maximum(x, 0.0)))
        return np.stack(columns, axis=1)

    def sides(self, u: Array, x: Array, points: Indices) -> Array:
        """Return the excess of +tau and of -tau over its limit with the exact viscous torque, (M, 2n); see `excess`.

        Args:
            u: sdd (M,).
            x: sd^2 (M,).
            points: grid point of each (M,).
        """
        B = np.ascontiguousarray(self.load_rows)
        family = Family(B, self.loads, self.base, self.base_terms, np.arange(B.shape[1]))
        values = polygons.evaluate(family, points, u, x)
        values += self.viscous[points] * np.sqrt(np.maximum(x, 0.0))[:, None]
        return np.where(np.tile(self.sharing.known[points], 2), values, np.nan)

    def excess(self, u: Array, x: Array, points: Indices) -> Array:
        """Return the largest torque over all uncertain quantities as a fraction of its limit, minus 1; see `Limit`.

        Args:
            u: sdd (M,).
            x: sd^2 (M,).
            points: grid point of each (M,).
        """
        n = self.load_rows.shape[1] // 2
        values = np.where(self.limited, self.sides(u, x, points), -1.0)
        return np.maximum(values[:, :n], values[:, n:])

    def exceeds(self, most: float, u: Array, x: Array, points: Indices, used: Flags) -> bool:
        """Return whether the excess of a torque is above a bound anywhere; rows far below it are not evaluated.

        Args:
            most: the bound, a fraction of the limit.
            u: sdd (M,).
            x: sd^2 at the grid point (M,).
            points: grid point of each (M,).
            used: which of the names count (n,).
        """
        rows, chosen = self.made_rows(), np.tile(used, 2) & self.limited
        base, speed = rows.base.copy(), np.zeros(len(rows.base))
        speed[points] = np.sqrt(np.maximum(x, 0.0))
        base[:, :, 2] += rows.viscous * speed[:, None] - most
        B, base, terms = (part if chosen.all() or not part.size else np.ascontiguousarray(part[:, chosen])
                          for part in (rows.B, base, self.base_terms))  # fmt: skip
        family = Family(np.ascontiguousarray(B), self.loads, base, terms, np.arange(B.shape[1]))
        values, _ = polygons.worst(family, points, u, x)
        return bool(values.any())


def torque_scale(limit: Array) -> Array:
    """Return the torques by which rows are divided: the limits, and 1 N m or 1 N for joints without one.

    Args:
        limit: largest torque of each joint (n,) [N m or N].
    """
    return np.where(np.isfinite(limit), limit, 1.0)


def payload_torque(
    motion: PathMotion, names: tuple[LimitName, ...], limits: JointLimits, loads: RequiredWrench,
    error: tuple[Array, Array], x_top: Array,
) -> TorqueLimit:  # fmt: skip
    """Return the torque limits of an arm that carries a payload.

    Args:
        motion: motion along the path.
        names: names of the limits (n,).
        limits: limits of the joints.
        loads: required wrench of the payload about the carrier's origin (P, 6, ...).
        error: middle and half-width of the acceleration error, (n,) each.
        x_top: largest x that the joint velocities allow (P,).
    """
    points, joints = motion.q1.shape
    made_rows = cache(lambda: _payload_rows(motion, limits, error[0]))
    terms = own_inertia_terms(motion, limits, loads, error[1])
    none, known = np.full(points, np.nan), np.ones((points, joints), dtype=bool)
    sharing = Sharing(loads, known, (), np.zeros(points, dtype=np.intp), motion, limits.torque, {})
    limited = np.isfinite(np.tile(limits.torque, 2))
    return TorqueLimit(names, made_rows, loads, terms, limited, x_top, none, sharing)


def _payload_rows(motion: PathMotion, limits: JointLimits, middle: Array) -> TorqueRows:
    """Return the rows of the joint torques of an arm, for the middle of the acceleration error (n,)."""
    points, joints = motion.q1.shape
    scale = torque_scale(limits.torque)
    arm, limit = motion.dynamics, np.r_[scale, scale]
    sign = np.r_[np.ones(joints), -np.ones(joints)]
    B = _both(np.swapaxes(motion.carrier.jacobian, 1, 2)) * (sign / limit)[:, None]
    moving = np.abs(motion.q1) > DIRECTION_TOLERANCE * np.abs(motion.q1).max(axis=1, keepdims=True)
    direction = np.where(_changes_sign(motion.q1) | ~moving, np.nan, np.sign(motion.q1))
    resisting = np.where(np.isnan(_both(direction)), 1.0, _both(direction) * sign)
    base = np.stack([_both(part) * sign for part in (arm.force_u, arm.force_x, arm.force_0)], axis=2)
    base[:, :, 2] += (
        _both(arm.mass_matrix @ middle) * sign + _both(np.tile(limits.dry_friction, (points, 1))) * resisting
    )
    base /= limit[:, None]
    base[:, :, 2] -= 1.0
    return TorqueRows(B, base, _both(limits.viscous_friction * motion.q1) * (sign / limit))


def _both(array: Array) -> Array:
    """Return the values of all joints (P, n, ...) for the rows of +tau, then for those of -tau, (P, 2n, ...)."""
    return np.concatenate([array, array], axis=1)


def own_inertia_terms(motion: PathMotion, limits: JointLimits, loads: RequiredWrench, radius: Array) -> Array:
    """Return the contribution of the inertia of the links to the constant interval terms of the rows, (P, 2n, n_c).

    Args:
        motion: motion along the path.
        limits: limits of the joints.
        loads: required wrench of the payload.
        radius: half-width of the acceleration error (n,) [rad/s^2 or m/s^2].
    """
    erring, n = np.flatnonzero(radius), motion.q1.shape[1]
    terms = np.zeros((len(motion.q1), 2 * n, len(loads.constant_group)))
    if not len(erring):
        return terms
    terms[:, :n, : len(erring)] = motion.dynamics.mass_matrix[:, :, erring] * radius[erring]
    terms[:, :n] /= torque_scale(limits.torque)[:, None]
    terms[:, n:] = -terms[:, :n]
    return terms


def _changes_sign(q1: Array) -> Flags:
    """Return whether q' of a joint changes its sign towards a neighbouring grid point, (P, n)."""
    flips = np.sign(q1[1:]) != np.sign(q1[:-1])
    result = np.zeros(q1.shape, dtype=bool)
    result[1:] |= flips
    result[:-1] |= flips
    return result


def legged_torque(
    motion: PathMotion, names: tuple[LimitName, ...], limit: Array, chains: Mapping[str, Indices], base: int,
    loads: RequiredWrench, contacts: tuple[ContactLimit, ...], standing: Indices, soles: Mapping[str, Array],
    x_top: Array,
) -> TorqueLimit:  # fmt: skip
    """Return the torque limits of a legged robot.

    Args:
        motion: motion along the path.
        names: names of the limits (n,).
        limit: largest torque of each coordinate (n,) [N m].
        chains: joints between the base and each contact.
        base: number of base coordinates.
        loads: generalised force of the motion (P, n, ...).
        contacts: limit of each stance.
        standing: index of the stance of each grid point (P,).
        soles: contact points of each contact (k, 2) [m].
        x_top: largest x that the joint velocities allow (P,).
    """
    points, n = motion.q1.shape
    rows, known = np.zeros((points, n, n)), np.ones((points, n), dtype=bool)
    rows[:, base:, base:] = np.eye(n - base)
    for k, family in enumerate(contacts):
        at, contact_names = np.flatnonzero(standing == k), family.system.contacts
        for name in contact_names:
            chain = chains[name]
            if len(contact_names) == 1:
                pull = np.swapaxes(motion.dynamics.contact_jacobians[name][at][:, :, chain], 1, 2)
                rows[np.ix_(at, chain, np.arange(base))] = -pull
            else:
                known[np.ix_(at, chain)] = False
    rows *= known[:, :, None]
    B = np.concatenate([rows, -rows], axis=1) / np.r_[limit, limit][:, None]
    made = TorqueRows(B, always(points, 2 * n), np.zeros((points, 2 * n)))
    sharing = Sharing(loads, known, contacts, standing, motion, limit, soles)
    limited = np.tile(np.isfinite(limit), 2)
    none = np.full(points, np.nan)
    return TorqueLimit(names, lambda: made, loads, np.zeros((0, 0, 0)), limited, x_top, none, sharing)
