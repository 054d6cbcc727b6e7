"""Part of a world that one contact system depends on, so that the effort for a system does not grow with the others."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from robustopt.arrays import Indices
from robustopt.certificate.bodies import Parameters
from robustopt.certificate.loads import Load
from robustopt.certificate.systems import System
from robustopt.certificate.world import World


@dataclass(frozen=True, eq=False)
class Part:
    """Bodies, contacts and contact points of a contact system, as indices in the whole world.

    Attributes:
        bodies: the bodies.
        contacts: the contacts.
        points: the displacements of contact points.
    """

    bodies: Indices
    contacts: Indices
    points: Indices

    def values(self, values: Parameters) -> Parameters:
        """Return the parameters of the part, for those of the whole world."""
        return Parameters(
            mass=values.mass[self.bodies],
            com=values.com[self.bodies],
            inertia=values.inertia[self.bodies],
            friction=values.friction[self.contacts],
            force=values.force[np.append(self.contacts, -1)],
            shift=values.shift[:, self.points],
            error=values.error,
        )

    def loads(self, loads: Sequence[Load]) -> list[Load]:
        """Return the loads of the part's bodies, for those of all bodies."""
        return [loads[b] for b in self.bodies]

    def world(self, world: World, system: System) -> World:
        """Return the part as a world with a single contact system.

        Args:
            world: the whole world.
            system: the contact system.
        """
        contacts, first = [], 0
        for contact in (world.contacts[i] for i in self.contacts):
            contacts.append(replace(contact, first=first, last=first + contact.last - contact.first))
            first = contacts[-1].last
        own = replace(
            system,
            contacts=tuple(np.searchsorted(self.contacts, system.contacts).tolist()),
            friction=np.searchsorted(self.contacts, system.friction),
            points=np.searchsorted(self.points, system.points),
            loads=tuple(
                replace(load, bodies=tuple(np.searchsorted(self.bodies, load.bodies).tolist())) for load in system.loads
            ),
            pull=system.pull[:, np.append(self.contacts, -1)],
        )
        return replace(
            world,
            bodies=tuple(world.bodies[b] for b in self.bodies),
            contacts=tuple(contacts),
            systems=(own,),
            nominal=self.values(world.nominal),
            lower=self.values(world.lower),
            upper=self.values(world.upper),
        )


def part_of(world: World, system: System) -> Part:
    """Return the part of a world that a contact system depends on.

    Args:
        world: the whole world.
        system: the contact system.
    """
    contacts = np.unique(system.contacts)
    points = [np.arange(world.contacts[i].first, world.contacts[i].last) for i in contacts]
    bodies = np.array(sorted({b for load in system.loads for b in load.bodies}), dtype=np.intp)
    return Part(bodies, contacts, np.concatenate(points))
