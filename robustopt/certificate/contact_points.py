"""Contact points with exact Coulomb cones: what forces at them exert on the blocks that they carry.

A force f at a contact point p (normal z) is possible if |(f_x, f_y)| <= mu f_z. Its coordinates are
(f_z, f_x / mu, f_y / mu), in which its cone is |(c_1, c_2)| <= c_0; where a face has axes of its own, x, y and z are
these. It acts with + on the block above the point and
with - on the block below. Wrenches are force then moment about the origin of the points, those of K blocks stacked,
(6 K, ...). Many programs are treated at once, as arrays whose last axis, T, counts them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]
Indices = NDArray[np.intp]

CENTERED = 1e-9
"""Distance, in units of the points, by which explicit pressure may miss its centre: rounding errors."""


@dataclass(frozen=True, eq=False)
class Face:
    """Contact points `first` to `last` (excluded) press on block `above` from block `below`, -1 for the ground.

    axes: of the face as columns (3, 3), its normal last; those of the wrenches without. The normals of all faces and
    the forces in their cones must have a positive part along z.
    """

    first: int
    last: int
    above: int
    below: int
    axes: Array | None = None


@dataclass(frozen=True)
class Contacts:
    """Contact points of K blocks in T programs.

    faces: who stands on whom; a block comes after all that it stands on
    point: (3, n, T) contact points, [m] or any other unit of length; an axis T of length 1 is for all programs
    mu: (n, T) coefficients of friction
    """

    faces: tuple[Face, ...]
    point: Array
    mu: Array

    @property
    def blocks(self) -> int:
        return 1 + max(face.above for face in self.faces)

    def __getitem__(self, chosen: slice | Indices) -> Contacts:
        """The contacts of some of the programs."""
        point = self.point if self.point.shape[-1] == 1 else self.point[..., chosen]
        mu = self.mu if self.mu.shape[-1] == 1 else self.mu[..., chosen]
        return Contacts(self.faces, point, mu)

    def seen(self, y: Array) -> Array:
        """A_i^T y, the part of y (6 K, T) that a force at point i sees, in the coordinates of forces, (3, n, T)."""
        out = np.empty((3, self.mu.shape[0], y.shape[-1]))
        for face in self.faces:
            part = slice(face.first, face.last)
            (px, py, pz), mu = self.point[:, part], self.mu[part]
            fx, fy, fz, mx, my, mz = _at(y, face.above) if face.below < 0 else _at(y, face.above) - _at(y, face.below)
            seen = fx + my * pz - mz * py, fy + mz * px - mx * pz, fz + mx * py - my * px
            if face.axes is not None:
                seen = tuple(np.einsum("i,inT->nT", axis, np.stack(seen)) for axis in face.axes.T)
            out[0, part], out[1, part], out[2, part] = seen[2], mu * seen[0], mu * seen[1]
        return out

    def wrenches(self, face: Face, c: Array) -> Array:
        """Wrench of the forces with coordinates c (3, ..., n_face, T) at each point of a face, (6, ..., n_face, T)."""
        part = slice(face.first, face.last)
        (px, py, pz), mu = self.point[:, part], self.mu[part]
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

    def pressed(self, c: Array) -> Array:
        """sum_i A_i c_i, what forces with coordinates c (3, n, T) exert on the blocks, (6 K, T)."""
        out = np.zeros((6 * self.blocks, c.shape[-1]))
        for face in self.faces:
            wrench = self.wrenches(face, c[:, face.first : face.last]).sum(axis=1)
            _at(out, face.above)[:] += wrench
            if face.below >= 0:
                _at(out, face.below)[:] -= wrench
        return out

    def levels(self) -> Array:
        """Heights of the blocks, (K,): 1 on the ground, at least 1 more than every block that is stood on."""
        level = np.ones(self.blocks)
        for face in sorted(self.faces, key=lambda face: face.above):
            if face.below >= 0:
                level[face.above] = max(level[face.above], 1.0 + level[face.below])
        return level


def _at(y: Array, block: int) -> Array:
    return y[6 * block : 6 * block + 6]


def single_block(points: Array, mu: float) -> Contacts:
    """Contacts of one block on the ground at `points` (n, 3)."""
    points = np.asarray(points, dtype=float)
    return Contacts((Face(0, len(points), 0, -1),), points.T[:, :, None].copy(), np.full((len(points), 1), mu))


def even_pressure(contacts: Contacts, programs: int) -> Array:
    """Wrenches on the blocks of equal normal forces, 1 in sum, at all points, (6 K, programs)."""
    c = np.zeros((3, contacts.mu.shape[0], programs))
    c[0] = 1.0 / c.shape[1]
    return contacts.pressed(c)


def simply_held(contacts: Contacts, wrench: Array) -> Flags:
    """Whether one simple choice of forces balances a wrench (6, ...) on one block on the ground.

    The points must be the corners of a convex polygon, counter-clockwise, in the plane z = 0. They share the load in
    Wachspress's coordinates l_i of its centre of pressure c, which are positive inside the polygon:
    l_i ~ area(p_{i-1}, p_i, p_{i+1}) / (area(c, p_{i-1}, p_i) area(c, p_i, p_{i+1})). Friction is the same share t of
    the pressure at all points, plus what makes the moment: a turn about c, or a part across t proportional to the
    place along t. Explicit forces: sufficient, not necessary, and a hundred times quicker than a search for them. Any
    axes may follow, if those of contacts and wrench broadcast.
    """
    if contacts.blocks > 1 or contacts.mu.shape[0] < 3 or np.any(contacts.point[2]):
        return np.zeros(wrench.shape[1:], dtype=bool)
    fx, fy, fz, mx, my, mz = wrench
    held = np.asarray(fz < 0.0)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        for part in _polygons(contacts.mu.shape[0]):
            chosen = contacts.point[:2, part], contacts.mu[part]
            held = held | _wachspress_holds(*chosen, fx / fz, fy / fz, -my / fz, mx / fz, mz / fz)
            if held.all():
                break
    return np.asarray((fz > 0.0) & held)


def _polygons(points: int) -> list[slice]:
    """All points, and if they are many also some polygons of four or five of them.

    What is round is not convex any more once its points have been displaced, but a few of them still are.
    """
    step = points // 4
    return [slice(None)] + [slice(first, None, step) for first in range(step)] * (points > 8)


def _wachspress_holds(point: Array, mu: Array, tx: Array, ty: Array, cx: Array, cy: Array, mz: Array) -> Flags:
    """`simply_held` for a unit load with friction (tx, ty), centre of pressure (cx, cy) and moment mz."""
    px, py = point
    n = len(px)
    ex, ey = (np.stack([values[(i + 1) % n] - values[i] for i in range(n)]) for values in (px, py))
    rx, ry = px - cx, py - cy
    area = rx * ey - ry * ex
    inside = (area > 0.0).all(axis=0)
    share = np.stack([(ex[i - 1] * ey[i] - ey[i - 1] * ex[i]) / (area[i - 1] * area[i]) for i in range(n)])
    share /= share.sum(axis=0)
    centered = np.abs((share * rx).sum(axis=0)) + np.abs((share * ry).sum(axis=0)) < CENTERED
    if not np.any(inside & centered):
        return np.asarray(inside & centered)
    twist, limit = mz - cx * ty + cy * tx, mu**2
    size = tx * tx + ty * ty
    across, square = rx * ty - ry * tx, rx * rx + ry * ry
    turn = twist / (share * square).sum(axis=0)
    turned = (size + 2.0 * turn * across + turn * turn * square <= limit).all(axis=0)
    along = (rx * tx + ry * ty) ** 2
    lean = twist / (share * along).sum(axis=0)
    leaned = (size * (1.0 + lean * lean * along) <= limit).all(axis=0)
    return np.asarray(inside & centered & (share >= 0.0).all(axis=0) & (turned | leaned))
