"""Contact systems: held bodies and contacts whose forces must be found together.

The held bodies are the objects and, with environment contacts, the floating base. If the wrench of an object reaches
the carrier through one support or one hold, the object and all that it carries form a system of their own. A bridge,
its supports and all objects that share them are one system. The base is a system in every stance.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from robustopt.arrays import Array, Indices
from robustopt.certificate.contact_points import Contacts, Face, inner_direction
from robustopt.certificate.twist import Hold, elastic_pressure, pad_pressure
from robustopt.geometry import contact_axes, rotation
from robustopt.limits.names import LimitName
from robustopt.scene.patches import Law, Patch

FLAT = 1e-12
"""Coordinates of contact points smaller than this are rounding errors, in units of the system's length."""


@dataclass(frozen=True, eq=False)
class Load:
    """Bodies whose wrenches enter a system through the same matrix.

    Attributes:
        bodies: indices of the bodies.
        matrix: rows of the system per wrench about the origin of the bodies' frame (rows, 6).
    """

    bodies: tuple[int, ...]
    matrix: Array


@dataclass(frozen=True, eq=False)
class Pressure:
    """Place of a hold with prescribed pressure: the base of a block, the cups of a part, or two pads, the driven first.

    Attributes:
        centre: centre of the hold, in system units (3,).
        axes: axes as columns, the driven normal last (3, 3).
    """

    centre: Array
    axes: Array


@dataclass(frozen=True, eq=False)
class System:
    """Held bodies whose contact forces must be found together.

    Rows are as in `contact_points`: wrenches of the blocks in the axes of the system about its reference, in its units
    of length and force, then closing forces.

    Attributes:
        name: name of the limit.
        contacts: index of the contact of each face.
        faces: faces of the contact points.
        friction: index of the contact of each contact point (n,).
        points: index of the displacement of each contact point (n,).
        point: contact points without displacement (3, n).
        turn: change of the contact points per displacement (3, 2, n).
        loads: required wrenches of the bodies.
        pull: required rows per vacuum, closing or internal force (rows, I + 1).
        inside: see `contact_points.inner_direction` (rows,).
        held: whether the block is held only by cups or pads.
        hold: prescribed pressure of the hold that all faces form; None for free pressure.
        at: indices of the instants at which the floating base is the block; None if it is not.
        polygon: factor of friction, see `twist.Hold`.
    """

    name: LimitName
    contacts: tuple[int, ...]
    faces: tuple[Face, ...]
    friction: Indices
    points: Indices
    point: Array
    turn: Array
    loads: tuple[Load, ...]
    pull: Array
    inside: Array
    held: bool
    hold: Pressure | None
    at: Indices | None
    polygon: float

    @property
    def simple(self) -> bool:
        """Return whether a single face holds a single block, for which there is a quick test."""
        return len(self.faces) == 1 and self.faces[0].closing < 0

    @property
    def known(self) -> bool:
        """Return whether a single hold or support carries a single block, so that its wrench is known."""
        return len(self.faces) == 1 or self.held

    def contact_points(self, friction: Array, shift: Array) -> Contacts:
        """Return the contacts for T sets of frictions (I, T) and displacements (2, Q, T) [m]."""
        point, own = self.point[..., None], shift[:, self.points]
        if np.any(own):
            point = point + np.einsum("ijq,jqt->iqt", self.turn, own)
        return Contacts(self.faces, point, friction[self.friction], self.inside)

    def hold_of(self, contacts: Contacts) -> Hold:
        """Return the hold for the values of the contacts."""
        own = self.hold
        assert own is not None
        away = contacts.point - own.centre.reshape(3, *[1] * (contacts.point.ndim - 1))
        plane = np.einsum("ij,i...->j...", own.axes[:, :2], away)
        elastic = self.faces[0].closing < 0
        pressure = (
            elastic_pressure(plane) if elastic else pad_pressure(*(face.last - face.first for face in self.faces))
        )
        return Hold(self.faces, plane, contacts.mu, pressure, wrench_map(own.axes, own.centre), self.polygon)


def wrench_map(axes: Array, reference: Array, force: float = 1.0, length: float = 1.0) -> Array:
    """Return the matrix (6, 6) from a wrench to the same wrench in other axes, about another reference, in other units.

    Args:
        axes: the new axes as columns (3, 3).
        reference: the new reference (3,).
        force: the new unit of force.
        length: the new unit of length.
    """
    x, y, z = reference
    arm = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    out = np.zeros((6, 6))
    out[:3, :3], out[3:, :3], out[3:, 3:] = axes.T / force, -axes.T @ arm / (force * length), axes.T / (force * length)
    return out


@dataclass(frozen=True, eq=False)
class Placed:
    """A patch in a system.

    Attributes:
        patch: the patch.
        contact: index of the contact.
        first: index of the first displacement.
        above: block above the patch.
        below: block below the patch; -1 for the ground.
        friction: largest coefficient of friction.
    """

    patch: Patch
    contact: int
    first: int
    above: int
    below: int
    friction: float


@dataclass(frozen=True, eq=False)
class Scale:
    """Axes, reference and units of a system, relative to the frame of its bodies.

    Attributes:
        axes: axes as columns (3, 3).
        reference: reference of the wrenches (3,) [m].
        force: unit of force [N].
        length: unit of length [m].
    """

    axes: Array
    reference: Array
    force: float
    length: float

    @property
    def unit(self) -> Array:
        """Return the matrix (6, 6) from a wrench about the origin of the frame to one of the system."""
        return wrench_map(self.axes, self.reference, self.force, self.length)

    def place(self, position: Array) -> Array:
        """Return a position (..., 3) in the coordinates of the system."""
        return np.asarray((position - self.reference) @ self.axes / self.length)

    def points(self, patch: Patch) -> tuple[Array, Array]:
        """Return the contact points (3, k) of a patch and their change per displacement (3, 2, k)."""
        turn = self.axes.T @ patch.axes[:, :2] @ rotation(patch.turn) / self.length
        point = self.place(patch.points).T
        for values in (point, turn):
            values[np.abs(values) < FLAT] = 0.0
        return point, np.repeat(turn[:, :, None], point.shape[1], axis=2)

    def axes_of(self, patch: Patch) -> Array | None:
        """Return the axes of a patch in the system; None if its normal is the z axis."""
        turned = self.axes.T @ patch.axes
        return None if np.allclose(turned[:, 2], [0.0, 0.0, 1.0], rtol=0.0, atol=FLAT) else turned


def scale_of(placed: Sequence[Placed], force: float, sole: float | None = None) -> Scale:
    """Return the scale of a system.

    Its z axis is the common normal of its patches. If the normals differ, it is a direction in which all forces of the
    patches have a positive component.

    Args:
        placed: the patches.
        force: unit of force [N].
        sole: unit of length [m], with the centre of all patches as the reference; without it the contact points extend
            from -1 to 1.
    """
    free = [item for item in placed if item.patch.law is not Law.DRIVEN_PAD]
    normals = [item.patch.axes[:, 2] for item in free]
    axes = free[0].patch.axes
    if any(not np.array_equal(normal, normals[0]) for normal in normals):
        faces = [Face(0, 0, 0, -1, item.patch.axes) for item in free]
        along = inner_direction(faces, [item.friction for item in free])[:3]
        axes = contact_axes(along, np.eye(3)[int(np.argmin(np.abs(along)))])
    if sole is not None:
        return Scale(axes, np.mean([item.patch.origin for item in placed], axis=0), force, sole)
    corners = np.concatenate([item.patch.points for item in placed]) @ axes
    middle = 0.5 * (corners.min(axis=0) + corners.max(axis=0))
    return Scale(axes, axes @ middle, force, float(np.abs(corners - middle).max()))


def make_system(
    name: LimitName,
    placed: Sequence[Placed],
    blocks: Sequence[tuple[int, ...]],
    fingers: Mapping[int, int],
    scale: Scale,
    forces: int,
    polygon: float,
    at: Indices | None = None,
) -> System:
    """Return a system.

    Args:
        name: name of the limit.
        placed: its patches.
        blocks: indices of the bodies of each block.
        fingers: by contact, index of the body of the driven finger, if it has a mass.
        scale: its axes and units.
        forces: number of vacuum, closing and internal forces.
        polygon: factor of friction, see `twist.Hold`.
        at: indices of the instants at which the floating base is the block; None if it is not.
    """
    faces = _faces(placed, scale)
    rows = 6 * len(blocks) + sum(face.closing >= 0 for face in faces)
    loads, pull = [], np.zeros((rows, forces))
    for k, bodies in enumerate(blocks):
        loads.append(Load(bodies, np.zeros((rows, 6))))
        loads[k].matrix[6 * k : 6 * k + 6] = scale.unit
    for item, face in zip(placed, faces, strict=True):
        normal, closing = item.patch.axes[:, 2], 6 * len(blocks) + face.closing
        if item.patch.law is Law.SUCTION:
            wrench = np.concatenate([normal, np.cross(item.patch.origin, normal)])
            pull[6 * item.above : 6 * item.above + 6, item.contact] = scale.unit @ wrench
        elif item.patch.law is Law.DRIVEN_PAD:
            pull[closing, item.contact] = 1.0 / scale.force
            if item.contact in fingers:
                loads.append(Load((fingers[item.contact],), np.zeros((rows, 6))))
                loads[-1].matrix[closing, :3] = -normal / scale.force
    point, turn = zip(*(scale.points(item.patch) for item in placed), strict=True)
    sizes = [len(item.patch.polygon) for item in placed]
    return System(
        name=name,
        contacts=tuple(item.contact for item in placed),
        faces=faces,
        friction=np.repeat([item.contact for item in placed], sizes),
        points=np.concatenate([item.first + np.arange(size) for item, size in zip(placed, sizes, strict=True)]),
        point=np.concatenate(point, axis=1),
        turn=np.concatenate(turn, axis=2),
        loads=tuple(loads),
        pull=pull,
        inside=inner_direction(faces, [item.friction for item in placed]),
        held=placed[0].patch.law is not Law.FRICTION,
        hold=_hold(placed, scale),
        at=at,
        polygon=polygon,
    )


def _faces(placed: Sequence[Placed], scale: Scale) -> tuple[Face, ...]:
    faces, first, closing = [], 0, 0
    for item in placed:
        last, driven = first + len(item.patch.polygon), item.patch.law is Law.DRIVEN_PAD
        faces.append(Face(first, last, item.above, item.below, scale.axes_of(item.patch), closing if driven else -1))
        first, closing = last, closing + driven
    return tuple(faces)


def _hold(placed: Sequence[Placed], scale: Scale) -> Pressure | None:
    """Return the hold that all patches of a system form, if its pressure is prescribed."""
    if not placed[0].patch.fixed:
        return None
    centre = np.mean([scale.place(item.patch.origin) for item in placed], axis=0)
    return Pressure(centre, scale.axes.T @ placed[0].patch.axes)
