"""Twist of a hold whose pressure is prescribed: how much of it friction resists.

The normal forces N_i at the contact points p_i of a lip or of two pads are not free where the load twists the hold.
They follow from the hold's wrench: of a lip those of an elastic one (least squares, also below 0), of two pads equal
ones on each. Friction then balances the twist (f_x, f_y, m_z) about the centre of the hold if

    slack(y) = sum_i mu_i N_i |y_xy + y_z (-p_iy, p_ix)| - y (f_x, f_y, m_z) >= 0  for all y in R^3,

y the rate of a rotation about some point, or of a translation. The slack is linear in the hold's *effort* e: its
wrench about the centre, patch axes, and the closing force behind it, (7,). So the efforts that are possible form a
convex cone, and each y with a slack below 0 is a cut that keeps the wrench at hand out of it.

Pressure below 0 takes from the others. It counts with the friction polygon that the planner has, so that no plan fails
for the difference between a polygon and its circle.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from robustopt.arrays import Array, Flags, Indices
from robustopt.certificate.contact_points import Contacts, Face, spread_holds

DIRECTIONS = 160
"""Rates of motion that are looked at before the search: a quarter of a radian from one to the next."""

STEPS = (0.2, 0.2, 0.1, 0.1, 0.05, 0.05, 0.02, 0.02, 0.008, 0.003, 0.001)
"""The search steps this far to all sides: first over the distance of two directions. In 99.7 % of random twists the
ratio then is right to 1e-6, in all to 1e-5."""

FARTHEST = 3.0
"""The top of a parabola is believed up to this many steps away."""

SIDES = 8

CLEAR = 0.8
"""Share of the gauge of interest below which a hold is left alone after a look at all directions."""

CHUNK = 1024
"""Programs that are looked at together, see `force_closure.CHUNK`."""

PLANE = [0, 1, 5]
"""Places of the twist in an effort."""


@dataclass(frozen=True, eq=False)
class Hold:
    """A lip, or the two pads of a gripper, with prescribed pressure; T programs, or 1 for all.

    faces: its faces, the driven one first
    plane: (2, k, T) its contact points in the plane of the hold, about its centre
    mu: (k, T) coefficients of friction
    pressure: (k, 7, T) normal forces per effort
    turn: (6, 6) from a wrench on its block to that about its centre, patch axes
    polygon: factor of the friction that pressure below 0 takes away
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
        """Return a cut (7, T) per row, (rows, T)."""
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
        """Return the friction (k, T) per normal force, for the signs that these have with efforts (7, T)."""
        return np.asarray(self.mu * np.where(self.normals(effort) < 0.0, self.polygon, 1.0))

    def speeds(self, y: Array) -> Array:
        """Return the speed |y_xy + y_z (-p_iy, p_ix)| of each point, (k, D, T), for rates y (3, D, T)."""
        px, py = self.plane[:, :, None]
        return np.hypot(y[0] - y[2] * py, y[1] + y[2] * px)

    def cut(self, y: Array, strength: Array) -> Array:
        """Return the slack per effort, (7, T), of rates y (3, T)."""
        weights = strength * self.speeds(y[:, None])[:, 0]
        out = np.einsum("ket,kt->et", self.pressure, weights)
        out[PLANE] -= y
        return out


def lip_pressure(plane: Array) -> Array:
    """Return the elastic normal forces per effort, (k, 7, ...), of a lip with points (2, k, ...): B^T (B B^T)^-1."""
    x, y = plane
    rows = np.moveaxis(np.stack([np.ones_like(x), y, -x]), (0, 1), (-2, -1))
    spread = np.linalg.solve(rows @ np.swapaxes(rows, -1, -2), rows)
    out = np.zeros((len(x), 7, *x.shape[1:]))
    out[:, 2:5] = np.moveaxis(spread, (-1, -2), (0, 1))
    return out


def pad_pressure(driven: int, fixed: int) -> Array:
    """Return the normal forces per effort, (k, 7, 1), of two pads with so many points, those of the driven one first.

    The driven pad has the closing force. The fixed one has this less the part of the wrench along the driven normal.
    """
    out = np.zeros((driven + fixed, 7, 1))
    out[:driven, 6] = 1.0 / driven
    out[driven:, 6], out[driven:, 2] = 1.0 / fixed, -1.0 / fixed
    return out


def twist_gauge(hold: Hold, rest: Array, move: Array, good_enough: Array | float = -np.inf) -> tuple[Array, Array]:
    """Return the smallest g (T,) at which the slack of g rest + move is nowhere below 0, and the y (3, T) it is 0 for.

    g is infinite if the slack of `rest` is. Gauges below `CLEAR` times the one that is good enough are rough.

    Args:
        hold: the hold in T programs.
        rest: effort (7, T) seen from here.
        move: effort (7, T).
        good_enough: (T,) gauge of interest.
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
    """Return the largest ratio (T,) over rates y (3, D, T) and its rate (3, T)."""
    value = _ratio(hold.speeds(y), normals, twists, y)
    best = np.argmax(value, axis=0)[None]
    rates = np.take_along_axis(np.broadcast_to(y, (3, *value.shape)), best[None], axis=1)[:, 0]
    return np.take_along_axis(value, best, axis=0)[0], rates


def _climb(hold: Hold, normals: Array, twists: Array, y: Array, worst: Array) -> tuple[Array, Array]:
    """Return the largest ratio near rates y (3, T), and its rate, by eight sides and the top of a parabola there."""
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
    """Return the place (2, T) of the top of a parabola, in steps, from its rise to eight sides (8, T)."""
    wave = [np.where(np.isfinite(rise), rise, 0.0) * part for part in (1.0, np.cos(angle), np.sin(angle))]
    total, along, across = (part.sum(axis=0) for part in wave)
    even = [(wave[0] * part).sum(axis=0) for part in (np.cos(2.0 * angle), np.sin(2.0 * angle))]
    a, b, c = 0.25 * total + 0.5 * even[0], 0.5 * even[1], 0.25 * total - 0.5 * even[0]
    with np.errstate(divide="ignore", invalid="ignore"):
        place = 0.25 * np.stack([b * across - c * along, b * along - a * across]) / (a * c - b * b)
    peaked = (a < 0.0) & (a * c > b * b) & (np.abs(place).max(axis=0) < FARTHEST)
    return np.where(peaked, place, 0.0)


def _ratio(speeds: Array, normals: Array, twists: Array, y: Array) -> Array:
    """Return -slack(move) / slack(rest), (D, T), infinite where the slack of rest is not positive."""
    if speeds.shape[-1] == 1:
        resisted, used = (np.tensordot(a[..., 0], b, (0, 1)) for a, b in ((speeds, normals), (y, twists)))
        rest, move = np.moveaxis(resisted - used, 1, 0)
    else:
        rest, move = np.einsum("kdt,akt->adt", speeds, normals) - np.einsum("cdt,act->adt", y, twists)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(rest > 0.0, -move / rest, np.inf)


def _sphere() -> Array:
    """Return rates (3, D, 1) of length 1, evenly over the sphere."""
    k = np.arange(DIRECTIONS) + 0.5
    z, turn = 1.0 - 2.0 * k / DIRECTIONS, np.pi * (1.0 + np.sqrt(5.0)) * k
    across = np.sqrt(1.0 - z * z)
    return np.asarray(np.stack([across * np.cos(turn), across * np.sin(turn), z])[:, :, None])


def _about_points(plane: Array) -> Array:
    """Return the rotations (3, 2 k, T) about the contact points (2, k, T), both ways: there the slack has a kink."""
    px, py = plane
    about = np.stack([py, -px, np.ones_like(px)])
    return np.concatenate([about, -about], axis=1)


def spread_evenly(hold: Hold, effort: Array) -> Flags:
    """Return whether a simple choice of friction at the prescribed pressure balances an effort (7, ...).

    See `spread_holds`: sufficient, not necessary, and only for pressure that is nowhere below 0.
    """
    normals = hold.normals(effort)
    total = normals.sum(axis=0)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        share = normals / total
        fx, fy, mz = effort[PLANE] / total
        center = tuple((share * axis).sum(axis=0) for axis in hold.plane)
        held = spread_holds(hold.plane, hold.mu, share, (fx, fy), mz, (center[0], center[1]))
    return np.asarray(held & (total > 0.0))
