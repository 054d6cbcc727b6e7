"""Twist of a hold with prescribed pressure: the largest moment about the normal that friction resists.

A hold is what bears a block: cups, two pads, or the support that the block stands on. If the load twists it, the normal
forces N_i at its contact points p_i are not free. They follow from the wrench of the hold: for lips and bases as
elastic normal forces (least squares, which may be below 0), for pads as equal normal forces on each pad. Friction then
balances the twist (f_x, f_y, m_z) about the centre of the hold if

    slack(y) = sum_i mu_i N_i |y_xy + y_z (-p_iy, p_ix)| - y (f_x, f_y, m_z) >= 0  for all y in R^3.

Here y is the rate of a rotation about some point, or of a translation. The slack is linear in the *effort* e of the
hold: its wrench about the centre, in patch axes, followed by the closing force (7,). So the possible efforts form a
convex cone, and each y with a negative slack is a cut that excludes the wrench at hand.

Negative normal forces reduce the slack. They count with the friction polygon of the planner, so that no plan fails only
because of the difference between a polygon and its circle.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from robustopt.arrays import Array, Flags, Indices
from robustopt.certificate.contact_points import Contacts, Face, spread_holds
from robustopt.certificate.twist_search import largest_ratio

DIRECTIONS = 160
"""Number of rates of motion that are evaluated before the search; neighbours are a quarter of a radian apart."""

CLEAR = 0.8
"""Share of the gauge of interest below which a hold is not searched further after all directions have been
evaluated.
"""

PLANE = [0, 1, 5]
"""Indices of the twist in an effort."""


@dataclass(frozen=True, eq=False)
class Hold:
    """Lips, two pads of a gripper, or the base of a block, with prescribed pressure, in T programs (or 1 for all).

    Attributes:
        faces: its faces, the driven one first.
        plane: contact points in the plane of the hold, about its centre (2, k, T).
        mu: coefficients of friction (k, T).
        pressure: normal forces per effort (k, 7, T).
        turn: matrix from a wrench on its block to the wrench about its centre, in patch axes (6, 6).
        polygon: factor on friction at points with a negative normal force.
    """

    faces: tuple[Face, ...]
    plane: Array
    mu: Array
    pressure: Array
    turn: Array
    polygon: float

    def __getitem__(self, chosen: slice | Indices) -> Hold:
        """Return the hold in some of the programs."""
        plane, mu, pressure = (
            values if values.shape[-1] == 1 else values[..., chosen] for values in (self.plane, self.mu, self.pressure)
        )
        return replace(self, plane=plane, mu=mu, pressure=pressure)

    def effort(self, contacts: Contacts, rows: Array) -> Array:
        """Return the effort (7, T) for the rows (rows, T) that its block requires."""
        face = self.faces[0]
        closing = rows[contacts.closing(face)] if face.closing >= 0 else np.zeros(rows.shape[1:])
        wrench = rows[6 * face.above : 6 * face.above + 6]
        return np.concatenate([np.tensordot(self.turn, wrench, axes=1), closing[None]])

    def rows(self, contacts: Contacts, cut: Array) -> Array:
        """Return a cut of the effort (7, T) as a cut of the rows, (rows, T)."""
        face = self.faces[0]
        out = np.zeros((contacts.rows, cut.shape[-1]))
        out[6 * face.above : 6 * face.above + 6] = self.turn.T @ cut[:6]
        if face.closing >= 0:
            out[contacts.closing(face)] = cut[6]
        return out

    def normals(self, effort: Array) -> Array:
        """Return the normal forces (k, ...) of efforts (7, ...)."""
        return np.einsum("ke...,e...->k...", self.pressure, effort)

    def strength(self, effort: Array) -> Array:
        """Return the friction (k, T) per normal force, for the signs of the normal forces of efforts (7, T)."""
        return np.asarray(self.mu * np.where(self.normals(effort) < 0.0, self.polygon, 1.0))

    def speeds(self, y: Array) -> Array:
        """Return the speed |y_xy + y_z (-p_iy, p_ix)| of each point, (k, T), for rates y (3, T)."""
        px, py = self.plane
        return np.hypot(y[0] - y[2] * py, y[1] + y[2] * px)

    def cut(self, y: Array, strength: Array) -> Array:
        """Return the derivative of the slack with respect to the effort, (7, T), for rates y (3, T)."""
        weights = strength * self.speeds(y)
        out = np.einsum("ket,kt->et", self.pressure, weights)
        out[PLANE] -= y
        return out


def elastic_pressure(plane: Array) -> Array:
    """Return the elastic normal forces per effort, (k, 7, ...), at points (2, k, ...): the least squares that balance.

    About the mean of the points, they are even for the force and linear in the place for the moments.
    """
    middle = plane.mean(axis=1)
    x, y = plane - middle[:, None]
    xx, xy, yy = (x * x).sum(axis=0), (x * y).sum(axis=0), (y * y).sum(axis=0)
    spread = xx * yy - xy * xy
    out = np.zeros((len(x), 7, *x.shape[1:]))
    out[:, 3] = (xx * y - xy * x) / spread
    out[:, 4] = (xy * y - yy * x) / spread
    out[:, 2] = 1.0 / len(x) - middle[1] * out[:, 3] + middle[0] * out[:, 4]
    return out


def pad_pressure(driven: int, fixed: int) -> Array:
    """Return the normal forces per effort, (k, 7, 1), of two pads with the given numbers of points.

    The points of the driven pad come first. Its normal forces sum to the closing force. Those of the fixed pad sum to
    the closing force less the component of the wrench along the driven normal.
    """
    out = np.zeros((driven + fixed, 7, 1))
    out[:driven, 6] = 1.0 / driven
    out[driven:, 6], out[driven:, 2] = 1.0 / fixed, -1.0 / fixed
    return out


def twist_gauge(hold: Hold, rest: Array, move: Array, good_enough: Array | float = -np.inf) -> tuple[Array, Array]:
    """Return the smallest g (T,) for which g rest + move has no negative slack, and the y (3, T) with zero slack.

    g is infinite if `rest` has a negative slack. Gauges below `CLEAR` times `good_enough` are approximate.

    Args:
        hold: the hold in T programs.
        rest: reference, an effort (7, T).
        move: effort that the motion adds (7, T).
        good_enough: gauge of interest (T,).
    """
    strength = hold.strength(rest + move)
    normals = strength * np.stack([hold.normals(rest), hold.normals(move)])
    interest = np.broadcast_to(CLEAR * np.asarray(good_enough, dtype=float), rest.shape[-1:])
    arrays = hold.plane.T, normals.T, np.stack([rest[PLANE], move[PLANE]]).T, _sphere().T, interest
    value, y = largest_ratio(*(np.array(array, order="C") for array in arrays))
    return value, y.T


def _sphere() -> Array:
    """Return unit rates (3, D), evenly distributed over the sphere."""
    k = np.arange(DIRECTIONS) + 0.5
    z, turn = 1.0 - 2.0 * k / DIRECTIONS, np.pi * (1.0 + np.sqrt(5.0)) * k
    across = np.sqrt(1.0 - z * z)
    return np.asarray(np.stack([across * np.cos(turn), across * np.sin(turn), z]))


def spread_evenly(hold: Hold, effort: Array) -> Flags:
    """Return whether explicit friction forces at the prescribed pressure balance an effort (7, ...).

    As in `spread_holds`, this is sufficient, not necessary. It requires normal forces that are nowhere negative.
    """
    normals = hold.normals(effort)
    total = normals.sum(axis=0)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        share = normals / total
        fx, fy, mz = effort[PLANE] / total
        center = tuple((share * axis).sum(axis=0) for axis in hold.plane)
        held = spread_holds(hold.plane, hold.mu, share, (fx, fy), mz, (center[0], center[1]))
    return np.asarray(held & (total > 0.0))
