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

DIRECTIONS = 160
"""Number of rates of motion that are evaluated before the search; neighbours are a quarter of a radian apart."""

STEPS = (0.2, 0.2, 0.1, 0.1, 0.05, 0.05, 0.02, 0.02, 0.008, 0.003, 0.001)
"""Lengths of the search's steps to all sides; the first ones cover the distance between two directions. The ratio is
then right to 1e-6 in 99.7 % of random twists, and to 1e-5 in all of them.
"""

FARTHEST = 3.0
"""Largest distance, in steps, at which the top of a parabola is used."""

SIDES = 8

CLEAR = 0.8
"""Share of the gauge of interest below which a hold is not searched further after all directions have been
evaluated.
"""

CHUNK = 1024
"""Number of programs that are solved together, see `force_closure.CHUNK`."""

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
        """Return the speed |y_xy + y_z (-p_iy, p_ix)| of each point, (k, D, T), for rates y (3, D, T)."""
        px, py = self.plane[:, :, None]
        return np.hypot(y[0] - y[2] * py, y[1] + y[2] * px)

    def cut(self, y: Array, strength: Array) -> Array:
        """Return the derivative of the slack with respect to the effort, (7, T), for rates y (3, T)."""
        weights = strength * self.speeds(y[:, None])[:, 0]
        out = np.einsum("ket,kt->et", self.pressure, weights)
        out[PLANE] -= y
        return out


def elastic_pressure(plane: Array) -> Array:
    """Return the elastic normal forces per effort, (k, 7, ...), at points (2, k, ...): B^T (B B^T)^-1."""
    x, y = plane
    rows = np.moveaxis(np.stack([np.ones_like(x), y, -x]), (0, 1), (-2, -1))
    spread = np.linalg.solve(rows @ np.swapaxes(rows, -1, -2), rows)
    out = np.zeros((len(x), 7, *x.shape[1:]))
    out[:, 2:5] = np.moveaxis(spread, (-1, -2), (0, 1))
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
    enough = np.broadcast_to(np.asarray(good_enough, dtype=float), rest.shape[-1:])
    value, y = np.empty(rest.shape[-1]), np.empty((3, rest.shape[-1]))
    for begin in range(0, len(value), CHUNK):
        part = slice(begin, begin + CHUNK)
        value[part], y[:, part] = _chunk_gauge(hold[part], rest[:, part], move[:, part], enough[part])
    return value, y


def _chunk_gauge(hold: Hold, rest: Array, move: Array, enough: Array) -> tuple[Array, Array]:
    strength = hold.strength(rest + move)
    normals = strength * np.stack([hold.normals(rest), hold.normals(move)])
    twists = np.stack([rest[PLANE], move[PLANE]])
    worst, y = _best(hold, normals, twists, _sphere())
    near = np.flatnonzero((worst > CLEAR * enough) & (worst < np.inf))
    if len(near):
        worst[near], y[:, near] = _climb(hold[near], normals[..., near], twists[..., near], y[:, near], worst[near])
    about_point, rates = _best(hold, normals, twists, _about_points(hold.plane))
    return np.maximum(np.maximum(worst, about_point), 0.0), np.where(about_point > worst, rates, y)


def _best(hold: Hold, normals: Array, twists: Array, y: Array) -> tuple[Array, Array]:
    """Return the largest ratio (T,) over rates y (3, D, T), and the rate at which it occurs (3, T)."""
    value = _ratio(hold.speeds(y), normals, twists, y)
    best = np.argmax(value, axis=0)[None]
    rates = np.take_along_axis(np.broadcast_to(y, (3, *value.shape)), best[None], axis=1)[:, 0]
    return np.take_along_axis(value, best, axis=0)[0], rates


def _climb(hold: Hold, normals: Array, twists: Array, y: Array, worst: Array) -> tuple[Array, Array]:
    """Return the largest ratio near rates y (3, T), and its rate, from eight neighbours and the top of a parabola."""
    angle = 2.0 * np.pi * np.arange(SIDES) / SIDES
    side = np.stack([np.cos(angle), np.sin(angle)])[:, :, None]
    for step in STEPS:
        first = np.cross(y, np.eye(3)[np.argmin(np.abs(y), axis=0)].T, axis=0)
        first /= np.linalg.norm(first, axis=0)
        second = np.cross(y, first, axis=0)

        def moved(by: Array, y: Array = y, first: Array = first, second: Array = second) -> Array:
            tried = y[:, None] + first[:, None] * by[0] + second[:, None] * by[1]
            return np.asarray(tried / np.linalg.norm(tried, axis=0))

        tried = moved(step * side)
        value = _ratio(hold.speeds(tried), normals, twists, tried)
        top = moved(step * _top(value - worst, angle[:, None])[:, None])
        tried = np.concatenate([tried, top, y[:, None]], axis=1)
        value = np.concatenate([value, _ratio(hold.speeds(top), normals, twists, top), worst[None]])
        best = np.argmax(value, axis=0)[None]
        worst, y = np.take_along_axis(value, best, 0)[0], np.take_along_axis(tried, best[None], 1)[:, 0]
    return worst, y


def _top(rise: Array, angle: Array) -> Array:
    """Return the top (2, T) of a parabola, in steps, from the rise to eight neighbours (8, T)."""
    wave = [np.where(np.isfinite(rise), rise, 0.0) * part for part in (1.0, np.cos(angle), np.sin(angle))]
    total, along, across = (part.sum(axis=0) for part in wave)
    even = [(wave[0] * part).sum(axis=0) for part in (np.cos(2.0 * angle), np.sin(2.0 * angle))]
    a, b, c = 0.25 * total + 0.5 * even[0], 0.5 * even[1], 0.25 * total - 0.5 * even[0]
    with np.errstate(divide="ignore", invalid="ignore"):
        place = 0.25 * np.stack([b * across - c * along, b * along - a * across]) / (a * c - b * b)
    peaked = (a < 0.0) & (a * c > b * b) & (np.abs(place).max(axis=0) < FARTHEST)
    return np.where(peaked, place, 0.0)


def _ratio(speeds: Array, normals: Array, twists: Array, y: Array) -> Array:
    """Return -slack(move) / slack(rest), (D, T); infinite unless the slack of rest is positive."""
    if speeds.shape[-1] == 1:
        resisted, used = (np.tensordot(a[..., 0], b, (0, 1)) for a, b in ((speeds, normals), (y, twists)))
        rest, move = np.moveaxis(resisted - used, 1, 0)
    else:
        rest, move = np.einsum("kdt,akt->adt", speeds, normals) - np.einsum("cdt,act->adt", y, twists)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(rest > 0.0, -move / rest, np.inf)


def _sphere() -> Array:
    """Return unit rates (3, D, 1), evenly distributed over the sphere."""
    k = np.arange(DIRECTIONS) + 0.5
    z, turn = 1.0 - 2.0 * k / DIRECTIONS, np.pi * (1.0 + np.sqrt(5.0)) * k
    across = np.sqrt(1.0 - z * z)
    return np.asarray(np.stack([across * np.cos(turn), across * np.sin(turn), z])[:, :, None])


def _about_points(plane: Array) -> Array:
    """Return the rotations (3, 2 k, T) about the contact points (2, k, T), both ways; the slack has kinks there."""
    px, py = plane
    about = np.stack([py, -px, np.ones_like(px)])
    return np.concatenate([about, -about], axis=1)


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
