"""The sharing of the wrench between several environment contacts, and the torque rows that hold for each of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from robustopt.arrays import Array, Flags, Indices
from robustopt.limits.contact_limit import ContactLimit
from robustopt.limits.motion import PathMotion
from robustopt.limits.polygons import Family, RequiredWrench


@dataclass(frozen=True, eq=False)
class SharedRow:
    """A row over the generalised force at one grid point that holds for every sharing of the wrench between contacts.

    Attributes:
        point: the grid point.
        row: coefficients (n,).
        constant: constant of row @ W + constant <= 0.
        joint: index of the joint that the row is named after.
    """

    point: int
    row: Array
    constant: float
    joint: int


@dataclass(frozen=True, eq=False)
class Sharing:
    """Dependence of the torques of a robot on its environment contacts.

    Attributes:
        loads: the required wrench: of the payload, or with environment contacts the generalised force of the motion.
        known: whether a joint torque is independent of how the contacts share the wrench (P, n).
        contacts: limit of each stance.
        standing: index of the stance of each grid point (P,); at a switch, of the stance with fewer contacts.
        motion: motion along the path.
        limit: largest torque of each coordinate (n,) [N m].
        soles: certain contact points of each contact, about its centre (k, 2) [m].
        rows: rows found so far.
    """

    loads: RequiredWrench
    known: Flags
    contacts: tuple[ContactLimit, ...]
    standing: Indices
    motion: PathMotion
    limit: Array
    soles: Mapping[str, Array]
    rows: tuple[SharedRow, ...] = ()

    def parts(self, stance: int) -> dict[str, slice]:
        """Return the generators of each contact of a stance, as slices by contact.

        Args:
            stance: index of the stance.
        """
        system = self.contacts[stance].system
        parts, first = {}, 0
        for name in system.contacts:
            count = len(self.soles[name]) * system.edges
            parts[name] = slice(first, first + count)
            first += count
        return parts

    def family(self, used: Flags, index: Indices) -> Family | None:
        """Return the rows found so far as a family with as few columns as possible; None without a row.

        Args:
            used: whether the limit of each joint counts (n,).
            index: number of the name of each joint's limit (n,).
        """
        rows = [row for row in self.rows if used[row.joint]]
        if not rows:
            return None
        slots: dict[tuple[int, int], int] = {}
        columns: dict[tuple[int, int], int] = {}
        place = []
        for row in rows:
            slot = slots.get((row.point, row.joint), 0)
            slots[row.point, row.joint] = slot + 1
            place.append(columns.setdefault((row.joint, slot), len(columns)))
        B, base = np.zeros((len(self.known), len(columns), len(self.limit))), always(len(self.known), len(columns))
        for row, column in zip(rows, place, strict=True):
            B[row.point, column] = row.row
            base[row.point, column, 2] = row.constant
        return Family(B, self.loads, base, np.zeros((0, 0, 0)), np.array([index[joint] for joint, _ in columns]))


def always(points: int, count: int) -> Array:
    """Return affine rows that always hold, (P, F, 3).

    Args:
        points: number of grid points P.
        count: number of rows F.
    """
    rows = np.zeros((points, count, 3))
    rows[:, :, 2] = -1.0
    return rows
