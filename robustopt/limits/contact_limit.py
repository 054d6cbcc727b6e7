"""Limits of a contact system along the path."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from robustopt.arrays import Array, Flags, Indices
from robustopt.limits.names import LimitName
from robustopt.limits.polygons import Polygons, RequiredWrench, cut_affine, cut_part, evaluate, facet_family, worst
from robustopt.limits.systems import SLIPS, TIPS, TWIST, ContactSystem

NO_BASE, NO_TERMS = np.zeros((0, 0, 3)), np.zeros((0, 0, 0))


@dataclass(frozen=True, eq=False)
class ContactLimit:
    """A contact system and its required wrenches along the path, with the rows that are imposed on them.

    Attributes:
        system: the contact system.
        loads: required wrenches of the system.
        weight: weight that the system carries; rows are fractions of it [N].
        facets: the rows that are imposed, as fractions of the weight (F, d).
        kinds: index of the name of each row (F,).
        first: first grid point at which the contact exists.
        last: last grid point at which it exists; negative for the end of the grid.
        cuts: rows a u + b x + c <= 0 of single grid points, from rows of a fine cone that plans violated (P, k, 3).
    """

    system: ContactSystem
    loads: RequiredWrench
    weight: float
    facets: Array
    kinds: Indices
    first: int = 0
    last: int = -1
    cuts: Array = field(default_factory=lambda: np.zeros((0, 0, 3)))

    @classmethod
    def of(
        cls, system: ContactSystem, loads: RequiredWrench, weight: float, first: int = 0, last: int = -1
    ) -> ContactLimit:
        """Return the limit with the explicit rows of a system: all of them, or a sample of those of fine cones.

        Args:
            system: the contact system.
            loads: required wrenches of the system.
            weight: weight that the system carries [N].
            first: first grid point at which the contact exists.
            last: last grid point at which it exists; negative for the end of the grid.
        """
        chosen = system.sample
        return cls(system, loads, weight, system.facets[chosen] / weight, system.kinds[chosen], first, last)

    @property
    def names(self) -> tuple[LimitName, ...]:
        """Return the names of the system's limits."""
        return self.system.names

    def with_facets(self, facets: Array, kinds: Indices | None = None) -> ContactLimit:
        """Return the limit with other rows in place of its own.

        Args:
            facets: the rows, as fractions of the weight (F, d).
            kinds: index of the name of each row (F,); by default the system classifies them.
        """
        return replace(self, facets=facets, kinds=self.system.kind_of(facets) if kinds is None else kinds)

    def with_more(self, facets: Array, kinds: Indices) -> ContactLimit:
        """Return the limit with further rows.

        Args:
            facets: the rows, as fractions of the weight (F, d).
            kinds: index of the name of each row (F,).
        """
        return self.with_facets(np.concatenate([self.facets, facets]), np.concatenate([self.kinds, kinds]))

    def with_cuts(self, points: Indices, u: Array, x: Array, most: float) -> ContactLimit | None:
        """Return the limit with cuts by the rows of its system that some (u, x) violate most, None if none is violated.

        Args:
            points: grid point of each, every point at most twice (M,).
            u: sdd (M,).
            x: sd^2 (M,).
            most: violation that is accepted, as a fraction of the weight.
        """
        family = facet_family(self.system.facets / self.weight, self.loads, self.system.kinds)
        values, pieces = worst(family, points, u, x)
        violated = np.flatnonzero((values > most) & self.holds_at(points))
        if not len(violated):
            return None
        first = np.unique(points[violated], return_index=True)[1]
        cuts = np.zeros((len(self.loads.nominal), 2, 3))
        cuts[:, :, 2] = -1.0
        for column, chosen in enumerate((violated[first], np.delete(violated, first))):
            cuts[points[chosen], column] = pieces[chosen]
        return replace(self, cuts=np.concatenate([self.cuts, cuts], axis=1) if len(self.cuts) else cuts)

    def with_all_facets(self) -> ContactLimit:
        """Return the limit with all explicit rows of its system; a solver may have added only the violated ones."""
        if not self.system.complete or len(self.system.facets) <= len(self.facets):
            return self
        return self.with_facets(self.system.facets / self.weight, self.system.kinds)

    def cut(self, polygons: Polygons, index: Indices, used: Flags) -> Polygons:
        """Return the polygons cut with the rows; see `Limit`.

        If some rows bound the twist, tipping and peel are cut before slip, and slip before twist. At a wrench that
        several of them bound equally, the first one gives its name to the edge: a pull-off is called peel, and a slip
        without twist is called slip.

        Args:
            polygons: feasible polygons so far.
            index: number of each name in the problem.
            used: which of the names count.
        """
        every = np.ones(len(self.kinds), dtype=bool)
        for rows in [self.kinds == kind for kind in (TIPS, SLIPS, TWIST)] if len(self.names) > 2 else [every]:
            chosen = used[self.kinds] & rows
            family = facet_family(self.facets[chosen], self.loads, index[self.kinds[chosen]])
            polygons = cut_part(polygons, family, self.first, self.last)
        if len(self.cuts) and used[SLIPS]:
            polygons = cut_affine(polygons, self.cuts, np.full(self.cuts.shape[1], index[SLIPS]))
        return polygons

    def excess(self, u: Array, x: Array, points: Indices) -> Array:
        """Return the largest excess of the rows of each name, as a fraction of `capacity`; see `Limit`.

        Args:
            u: sdd (M,).
            x: sd^2 (M,).
            points: grid point of each (M,).
        """
        values = evaluate(facet_family(self.facets, self.loads, self.kinds), points, u, x)
        most = np.full((len(points), len(self.names)), -np.inf)
        for k in range(len(self.names)):
            most[:, k] = values[:, self.kinds == k].max(axis=1, initial=-np.inf)
        return np.where(self.holds_at(points)[:, None], most * (self.weight / self.capacity), -np.inf)

    def tips(self, u: Array, x: Array, points: Indices, tolerance: float) -> Flags:
        """Return whether a row of the system that bounds tipping or peeling binds, (M,).

        Args:
            u: sdd (M,).
            x: sd^2 (M,).
            points: grid point of each (M,).
            tolerance: fraction of the weight within which a row binds.
        """
        rows = self.system.facets[self.system.kinds == TIPS] / self.weight
        values = evaluate(facet_family(rows, self.loads, np.zeros(len(rows), dtype=np.int64)), points, u, x)
        return np.asarray(values.max(axis=1, initial=-np.inf) > -tolerance) & self.holds_at(points)

    @property
    def capacity(self) -> float:
        """Return the normal force that the contact has to offer [N]: the forces that press, or else the weight."""
        pressing = self.loads.nominal[0, 6 * len(self.system.objects) :, :, 2].sum()
        return float(pressing) if pressing > 0.0 else self.weight

    def holds_at(self, points: Indices) -> Flags:
        """Return whether the contact exists at grid points, (M,).

        Args:
            points: the grid points (M,).
        """
        return np.asarray((points >= self.first) & ((points <= self.last) | (self.last < 0)))

    def wrench(self, points: Indices, u: Array, x: Array) -> Array:
        """Return the required wrenches with every uncertain quantity at the middle of its interval.

        Args:
            points: grid points (M,).
            u: sdd (M,).
            x: sd^2 (M,).

        Returns:
            Stacked wrenches (M, d) [N, N m].
        """
        coefficients = self.loads.middle()[points]
        return coefficients[:, :, 0] * u[:, None] + coefficients[:, :, 1] * x[:, None] + coefficients[:, :, 2]
