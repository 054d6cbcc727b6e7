"""Contact points with exact Coulomb cones: the wrenches that forces at them exert on blocks.

A force f at a contact point p with normal z is possible if |(f_x, f_y)| <= mu f_z. Its coordinates are c = (f_z, f_x /
mu, f_y / mu), so its cone is |(c_1, c_2)| <= c_0. The force acts with + on the block above the point and with - on the
block below. A wrench is force then moment about the origin of the points.

The rows of a program are the wrenches of K blocks, stacked (6 K), then one row per closing force, the sum of the normal
forces at a driven finger. Many programs are solved at once; the last axis T of the arrays counts them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import linprog

from robustopt.arrays import Array, Flags, Indices

CENTERED = 1e-9
"""Distance, in units of the points, by which the centre of an explicit pressure may be wrong because of rounding
errors.
"""

EDGES = 16
"""Number of edges of the pyramids around the cones in the search for a direction inside the dual cones."""


@dataclass(frozen=True, eq=False)
class Face:
    """Contact points between a block and another block or the ground.

    Attributes:
        first: index of the first contact point.
        last: index after the last contact point.
        above: the block that the forces act on with +.
        below: the block that the forces act on with -; -1 for the ground.
        axes: axes of the face as columns, its normal last (3, 3); None for the axes of the wrenches.
        closing: index of the closing force that the normal forces of the face sum to; -1 for none.
    """

    first: int
    last: int
    above: int
    below: int = -1
    axes: Array | None = None
    closing: int = -1

    @property
    def part(self) -> slice:
        """Return the points of the face among all points."""
        return slice(self.first, self.last)


@dataclass(frozen=True, eq=False)
class Contacts:
    """Contact points of K blocks in T programs.

    Attributes:
        faces: contacts of the blocks; each block comes after all blocks that support it.
        point: contact points (3, n, T), in any unit of length; the axis T has length 1 if all programs share them.
        mu: coefficients of friction (n, T).
        inside: direction strictly inside the dual cones of all points (rows,), see `inner_direction`.
    """

    faces: tuple[Face, ...]
    point: Array
    mu: Array
    inside: Array

    @property
    def rows(self) -> int:
        """Return the number of rows."""
        return len(self.inside)

    def __getitem__(self, chosen: slice | Indices) -> Contacts:
        """Return the contacts of some of the programs."""
        point = self.point if self.point.shape[-1] == 1 else self.point[..., chosen]
        mu = self.mu if self.mu.shape[-1] == 1 else self.mu[..., chosen]
        return replace(self, point=point, mu=mu)

    def closing(self, face: Face) -> int:
        """Return the row of the closing force of a face that has one."""
        return 6 * (1 + max(other.above for other in self.faces)) + face.closing

    @property
    def matrix(self) -> Array:
        """Return A: the rows per force coordinate at each point, (rows, 3, n, T or 1)."""
        unit = np.broadcast_to(
            np.eye(3)[:, :, None, None], (3, 3, *np.broadcast_shapes(self.mu.shape, self.point.shape[1:]))
        )
        out = np.zeros((self.rows, *unit.shape[1:]))
        for face in self.faces:
            part = face.part
            wrench = self.wrenches(face, unit[:, :, part])
            _at(out, face.above)[:, :, part] += wrench
            if face.below >= 0:
                _at(out, face.below)[:, :, part] -= wrench
            if face.closing >= 0:
                out[self.closing(face), :, part] += unit[0, :, part]
        return out

    def seen(self, y: Array) -> Array:
        """Return A_i^T y: the rows y (rows, T) as functionals of the force coordinates at each point, (3, n, T)."""
        out = np.empty((3, self.mu.shape[0], y.shape[-1]))
        for face in self.faces:
            part = face.part
            (px, py, pz), mu = self.point[:, part], self.mu[part]
            fx, fy, fz, mx, my, mz = _at(y, face.above) if face.below < 0 else _at(y, face.above) - _at(y, face.below)
            seen = fx + my * pz - mz * py, fy + mz * px - mx * pz, fz + mx * py - my * px
            if face.axes is not None:
                seen = tuple(np.einsum("i,inT->nT", axis, np.stack(seen)) for axis in face.axes.T)
            out[0, part], out[1, part], out[2, part] = seen[2], mu * seen[0], mu * seen[1]
            if face.closing >= 0:
                out[0, part] += y[self.closing(face)]
        return out

    def wrenches(self, face: Face, c: Array) -> Array:
        """Return the wrench of a force c (3, ..., n_face, T) at each point of a face, (6, ..., n_face, T)."""
        (px, py, pz), mu = self.point[:, face.part], self.mu[face.part]
        out = np.empty((6, *c.shape[1:]))
        fx, fy, fz = np.multiply(mu, c[1], out=out[0]), np.multiply(mu, c[2], out=out[1]), c[0]
        out[2] = fz
        if face.axes is not None:
            out[:3] = np.einsum("ij,j...->i...", face.axes, out[:3])
            fx, fy, fz = out[:3]
        out[3] = py * fz - pz * fy
        out[4] = pz * fx - px * fz
        out[5] = px * fy - py * fx
        return out

    def columns(self, face: Face, c: Array) -> Array:
        """Return `wrenches` for c (3, 3, n_face, T), followed by the row of the closing force if there is one."""
        wrenches = self.wrenches(face, c)
        return wrenches if face.closing < 0 else np.concatenate([wrenches, c[:1]])

    def stiffness(self, columns: Array) -> Array:
        """Return sum_i A_i C_i C_i^T A_i^T, (rows, rows, T), for matrices C_i of force coordinates, (3, 3, n, T)."""
        matrix = np.zeros((self.rows, self.rows, columns.shape[-1]))
        for face in self.faces:
            own = self.columns(face, columns[:, :, face.part])
            own = own.reshape(len(own), -1, own.shape[-1])
            stiffness = np.stack([(row * own).sum(axis=1) for row in own])
            places = [(slice(6 * face.above, 6 * face.above + 6), slice(0, 6), 1.0)]
            if face.below >= 0:
                places.append((slice(6 * face.below, 6 * face.below + 6), slice(0, 6), -1.0))
            if face.closing >= 0:
                row = self.closing(face)
                places.append((slice(row, row + 1), slice(6, 7), 1.0))
            for a, part_a, sign_a in places:
                for b, part_b, sign_b in places:
                    matrix[a, b] += sign_a * sign_b * stiffness[part_a, part_b]
        return matrix

    def pressed(self, c: Array) -> Array:
        """Return sum_i A_i c_i, the rows that forces c (3, n, T) exert, (rows, T)."""
        out = np.zeros((self.rows, c.shape[-1]))
        for face in self.faces:
            own = c[:, face.part]
            wrench = self.wrenches(face, own).sum(axis=1)
            _at(out, face.above)[:] += wrench
            if face.below >= 0:
                _at(out, face.below)[:] -= wrench
            if face.closing >= 0:
                out[self.closing(face)] += own[0].sum(axis=0)
        return out


def _at(y: Array, block: int) -> Array:
    return y[6 * block : 6 * block + 6]


def inner_direction(faces: Sequence[Face], friction: Sequence[float]) -> Array:
    """Return a direction (rows,) strictly inside the dual cones of the points of all faces.

    It is the shortest direction without moments along which each force on the edge of a cone has a component of at
    least 1.

    Args:
        faces: the faces.
        friction: largest coefficient of friction of each face.

    Raises:
        ValueError: contacts can press against each other with any force, so there is no such direction.
    """
    blocks, closings = 1 + max(face.above for face in faces), 1 + max(face.closing for face in faces)
    angle, rows = 2.0 * np.pi * np.arange(EDGES) / EDGES, []
    for face, mu in zip(faces, friction, strict=True):
        across = mu / np.cos(np.pi / EDGES)
        edges = np.column_stack([across * np.cos(angle), across * np.sin(angle), np.ones(EDGES)])
        row = np.zeros((EDGES, 3 * blocks + closings))
        row[:, 3 * face.above : 3 * face.above + 3] = edges if face.axes is None else edges @ face.axes.T
        if face.below >= 0:
            row[:, 3 * face.below : 3 * face.below + 3] = -row[:, 3 * face.above : 3 * face.above + 3]
        if face.closing >= 0:
            row[:, 3 * blocks + face.closing] = 1.0
        rows.append(row)
    found = np.vstack(rows)
    cost = np.ones(2 * found.shape[1])
    answer = linprog(cost, A_ub=-np.hstack([found, -found]), b_ub=-np.ones(len(found)), method="highs")
    if answer.x is None:
        raise ValueError("contacts can press against each other with any force: their cones span all directions")
    inner = answer.x[: found.shape[1]] - answer.x[found.shape[1] :]
    force = inner[: 3 * blocks].reshape(blocks, 3)
    return np.concatenate([np.hstack([force, np.zeros((blocks, 3))]).ravel(), inner[3 * blocks :]])


def single_block(points: Array, mu: float) -> Contacts:
    """Return the contacts of one block on the ground at `points` (n, 3)."""
    points = np.asarray(points, dtype=float)
    faces = (Face(0, len(points), 0),)
    return Contacts(faces, points.T[:, :, None].copy(), np.full((len(points), 1), mu), inner_direction(faces, [mu]))


def even_pressure(contacts: Contacts, programs: int) -> Array:
    """Return the rows of equal normal forces at all points that sum to 1, (rows, programs)."""
    c = np.zeros((3, contacts.mu.shape[0], programs))
    c[0] = 1.0 / c.shape[1]
    return contacts.pressed(c)


def least_forces(contacts: Contacts, rows: Array) -> Array:
    """Return the forces (3, n, T) nearest to an even pressure of the same size that exert rows (rows, T)."""
    points, programs = contacts.mu.shape[0], rows.shape[-1]
    c = np.zeros((3, points, programs))
    even = contacts.inside @ even_pressure(contacts, programs)
    c[0] = np.maximum(contacts.inside @ rows / even, 0.0) / points
    unit = np.broadcast_to(np.eye(3)[:, :, None, None], (3, 3, points, programs))
    matrix = np.moveaxis(contacts.stiffness(unit), -1, 0)
    lacking = rows - contacts.pressed(c)
    y = np.asarray(np.linalg.solve(matrix, lacking.T[:, :, None])[:, :, 0].T, dtype=float)
    return c + contacts.seen(y)


def simply_held(contacts: Contacts, wrench: Array) -> Flags:
    """Return whether explicit forces balance a wrench (6, T) on one block on the ground.

    The points must be the corners of a convex polygon, counter-clockwise, in the plane z = 0. The normal force is
    divided among them by the Wachspress coordinates l_i of its centre of pressure c, which are positive inside the
    polygon: l_i ~ area(p_{i-1}, p_i, p_{i+1}) / (area(c, p_{i-1}, p_i) area(c, p_i, p_{i+1})). The friction force at
    every point is the same share t of its normal force, plus a part that supplies the moment: a rotation about c, or a
    part across t that grows in proportion to the position along t. This condition is sufficient, not necessary, and ten
    times faster to evaluate than a search for forces.
    """
    held = np.zeros(wrench.shape[1], dtype=bool)
    if len(contacts.faces) > 1 or contacts.mu.shape[0] < 3 or np.any(contacts.point[2]):
        return held
    left = np.flatnonzero(wrench[2] > 0.0)
    for part in _polygons(contacts.mu.shape[0]):
        own, rows = (contacts, wrench) if len(left) == len(held) else (contacts[left], wrench[:, left])
        fx, fy, fz, mx, my, mz = rows
        center = -my / fz, mx / fz
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            share = _wachspress(own.point[:2, part], *center)
            found = spread_holds(own.point[:2, part], own.mu[part], share, (fx / fz, fy / fz), mz / fz, center)
        held[left] = found
        left = left[~found]
        if not len(left):
            break
    return held


def _polygons(points: int) -> list[slice]:
    """Return all points, and for many points first some polygons of four or five of them.

    Fewer points take less time. A displacement of its points can make a round face non-convex, but polygons of a few of
    its points stay convex.
    """
    step = points // 4
    return [slice(first, None, step) for first in range(step)] * (points > 8) + [slice(None)]


def _wachspress(point: Array, cx: Array, cy: Array) -> Array:
    """Return the shares (n, ...) of a force at (cx, cy) among the corners of a polygon (2, n, ...); nan outside."""
    px, py = point
    n = len(px)
    ex, ey = (np.stack([values[(i + 1) % n] - values[i] for i in range(n)]) for values in (px, py))
    area = (px - cx) * ey - (py - cy) * ex
    share = np.stack([(ex[i - 1] * ey[i] - ey[i - 1] * ex[i]) / (area[i - 1] * area[i]) for i in range(n)])
    share /= share.sum(axis=0)
    return np.where((area > 0.0).all(axis=0), share, np.nan)


def spread_holds(
    point: Array, mu: Array, share: Array, friction: tuple[Array, Array], moment: Array, center: tuple[Array, Array]
) -> Flags:
    """Return whether a unit normal force with given shares allows a friction force and a moment about the normal.

    Args:
        point: contact points in their plane (2, n, ...).
        mu: coefficients of friction (n, ...).
        share: shares of the normal force (n, ...), which sum to 1.
        friction: the two components of the friction force, (...) each.
        moment: moment about the normal at the origin (...).
        center: the two coordinates of the centre of pressure, (...) each.
    """
    (tx, ty), (cx, cy) = friction, center
    rx, ry = point[0] - cx, point[1] - cy
    possible = np.abs((share * rx).sum(axis=0)) + np.abs((share * ry).sum(axis=0)) < CENTERED
    possible &= (share >= 0.0).all(axis=0)
    if not np.any(possible):
        return np.asarray(possible)
    twist, limit = moment - cx * ty + cy * tx, mu**2
    size = tx * tx + ty * ty
    across, square = rx * ty - ry * tx, rx * rx + ry * ry
    turn = twist / (share * square).sum(axis=0)
    turned = (size + 2.0 * turn * across + turn * turn * square <= limit).all(axis=0)
    along = (rx * tx + ry * ty) ** 2
    lean = twist / (share * along).sum(axis=0)
    leaned = (size * (1.0 + lean * lean * along) <= limit).all(axis=0)
    return np.asarray(possible & (turned | leaned))
