"""Contact systems: held bodies and contacts whose forces must be found together.

The required wrenches of the held bodies of a system, stacked, and the forces that press them against the tool must lie
in a cone. If an object hangs on one contact alone, everything that it carries loads this contact, and the cone has
explicit rows. A bridge and its supports form a cycle in the contact graph: their forces are statically indeterminate,
so they are one system, and programs share the wrench (`solvers.force_program`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from robustopt.arrays import Array, Flags, Indices
from robustopt.config import Config
from robustopt.errors import ConfigError
from robustopt.limits.cones import COARSE_EDGES, FINE_EDGES, about_point, tipping_rows
from robustopt.limits.facets import MOST_CORNERS
from robustopt.limits.laws import ContactLaw, Link, links
from robustopt.limits.names import LimitKind, LimitName
from robustopt.scene.patches import Law, Patch, patches
from robustopt.scene.placement import supports

SLIPS, TIPS, TWIST = range(3)
"""Index of the name of the rows of a single contact: those that bound slip, tipping or peel, and the twist."""

SAMPLE = 128
"""One of so many rows of a fine cone is imposed at first: with fewer of them there are more rounds."""


@dataclass(frozen=True, eq=False)
class ContactSystem:
    """Held bodies whose contact forces must be found together.

    Attributes:
        objects: the held bodies; their wrenches are stacked.
        loads: per held body the bodies whose weight and inertia it must carry, itself included.
        pressed: the object that each force presses against the tool, once per cup; the forces follow the wrenches, so
            the system has d = 6 * len(objects) + len(pressed) coordinates.
        points: per held body the reference point of its moments, carrier frame (3,) [m].
        generators: edges of all friction cones and vacuums (d, k); their cone is what the contacts can supply.
        edges_of_friction: whether each generator is a friction edge (k,).
        facets: rows of the cone and of the twist, facets @ w <= 0, (F, d).
        complete: whether the rows describe the whole cone; else programs over the generators find more.
        kinds: index of the name of each row (F,).
        names: limits that the system imposes; the first two are for rows that slip and rows that tip, a third one is
            for the twist.
        edges: number of friction edges per contact point, which are neighbours among the generators.
        contacts: names of the contacts.
        transform: coordinates that the generators supply per coordinate of the system (d', d), None for the same.
    """

    objects: tuple[str, ...]
    loads: tuple[tuple[str, ...], ...]
    pressed: tuple[str, ...]
    points: tuple[Array, ...]
    generators: Array
    edges_of_friction: Flags
    facets: Array
    complete: bool
    kinds: Indices
    names: tuple[LimitName, ...]
    edges: int
    contacts: tuple[str, ...]
    transform: Array | None = None

    @property
    def dimension(self) -> int:
        """Return the number d of coordinates."""
        return 6 * len(self.objects) + len(self.pressed)

    @property
    def interior(self) -> Array:
        """Return a point well inside the cone: equal forces along all generators, of unit mean, (d,)."""
        return np.asarray(self.generators.mean(axis=1))

    @property
    def bounds_twist(self) -> bool:
        """Return whether some of the rows bound the twist, which no program over the generators knows of."""
        return bool((self.kinds == TWIST).any())

    @property
    def fine(self) -> bool:
        """Return whether the system has so many rows that solvers impose only those that a plan violates."""
        return self.edges == FINE_EDGES

    @property
    def sample(self) -> Indices:
        """Return the rows that are imposed at first: all, or those of tipping and few others of a fine cone."""
        if not self.fine:
            return np.arange(len(self.facets))
        return np.flatnonzero((self.kinds == TIPS) | (np.arange(len(self.facets)) % SAMPLE == 0))

    def about(self, points: Sequence[Array]) -> ContactSystem:
        """Return the same system with the moments of each held body about another point (3,) [m]."""
        moved, facets = self.generators.copy(), self.facets.copy()
        transform = None if self.transform is None else self.transform.copy()
        for k, (new, old) in enumerate(zip(points, self.points, strict=True)):
            block = slice(6 * k, 6 * k + 6)
            facets[:, block] = facets[:, block] @ about_point(old - new)
            if transform is None:
                moved[block] = about_point(new - old) @ moved[block]
            else:
                transform[:, block] = transform[:, block] @ about_point(old - new)
        return replace(self, points=tuple(points), generators=moved, facets=facets, transform=transform)

    def kind_of(self, rows: Array) -> Indices:
        """Return the index of the name of each row of the cone (F, d) that a program has found, (F,)."""
        if len(set(self.names[:2])) == 1 or not len(rows):
            return np.zeros(len(rows), dtype=np.intp)
        edges = self.generators[:, self.edges_of_friction]
        return np.asarray(tipping_rows(rows, edges, self.edges).astype(np.intp))


def object_systems(
    config: Config,
    friction: Mapping[str, float],
    shift: Mapping[str, float],
    laws: Mapping[str, ContactLaw] | None = None,
    twisted: frozenset[str] = frozenset(),
) -> tuple[ContactSystem, ...]:
    """Return the contact systems of the objects of a configuration, moments about the carrier's origin.

    Args:
        config: the configuration.
        friction: coefficient of friction of each contact by its name.
        shift: largest distance of each contact point from its nominal position along x and y, by contact [m].
        laws: laws of a user, by the name of the contact.
        twisted: objects whose pressure is prescribed by default, see `turning`.

    Raises:
        ConfigError: the pressure of an object is fixed that shares its load with others.
    """
    found = []
    for group in _groups(config):
        own = [patch for patch in patches(config, twisted) if patch.object in group]
        edges = _edges(config, own, laws or {})
        found.append(_system(config, group, links(own, friction, edges, shift, laws), edges))
    return tuple(found)


def coarse_edges(config: Config) -> int:
    """Return the number of edges of the friction cones of all contacts but those that fine cones suit.

    Args:
        config: the configuration.
    """
    return COARSE_EDGES if config.contact.cone_edges == "auto" else config.contact.cone_edges


def _edges(config: Config, own: Sequence[Patch], laws: Mapping[str, ContactLaw]) -> int:
    """Return the number of edges of the friction cones of some patches that form a contact system."""
    first, *others = own
    free = first.law is Law.FRICTION and first.name not in laws and not first.fixed
    fine = config.contact.cone_edges == "auto" and free and len(first.polygon) <= MOST_CORNERS and not others
    return FINE_EDGES if fine else coarse_edges(config)


# The contact graph ----------------------------------------------------------------------------------------


def carried(config: Config, name: str) -> tuple[str, ...]:
    """Return the object and everything that stands on it, directly or not, in the order of the configuration."""
    above = {name}
    while True:
        more = {other for other in config.objects if above & set(supports(config.objects[other]))} | above
        if more == above:
            return tuple(other for other in config.objects if other in above)
        above = more


def stands_alone(config: Config, name: str) -> bool:
    """Return whether an object and everything that it carries hang on the one contact of this object alone."""
    if len(supports(config.objects[name])) > 1:
        return False
    above = set(carried(config, name))
    return all(set(supports(config.objects[other])) <= above for other in above - {name})


def _groups(config: Config) -> list[tuple[str, ...]]:
    """Return the groups of objects whose contact forces must be found together: single ones, and cycles."""
    trees = [name for name in config.objects if stands_alone(config, name)]
    groups: list[set[str]] = []
    for name in config.objects:
        if name in trees:
            continue
        linked = {name} | {
            other for other in supports(config.objects[name]) if other in config.objects and other not in trees
        }
        touching = [group for group in groups if group & linked]
        groups = [group for group in groups if not group & linked] + [linked.union(*touching)]
    cycles = [tuple(name for name in config.objects if name in group) for group in groups]
    return [(name,) for name in trees] + cycles


def _loads(config: Config, name: str, group: tuple[str, ...]) -> tuple[str, ...]:
    """Return the bodies that one object of a group carries, without other members of the group."""
    if len(group) == 1:
        return carried(config, name)
    direct = [other for other in config.objects if supports(config.objects[other]) == (name,) and other not in group]
    above = {body for other in direct for body in carried(config, other)}
    return tuple(body for body in config.objects if body == name or body in above)


# Systems --------------------------------------------------------------------------------------------------


def system_of(link: Link, load: tuple[str, ...], edges: int) -> ContactSystem:
    """Return the system of an object with a single contact.

    Args:
        link: the contact.
        load: names of the bodies that it carries, the object included.
        edges: number of edges of each friction cone.
    """
    facets, kinds = _explicit(link)
    return ContactSystem(
        objects=(link.object,), loads=(load,), pressed=(link.object,) * link.forces, points=(np.zeros(3),),
        generators=link.generators, edges_of_friction=np.arange(link.generators.shape[1]) < link.edges_of_friction,
        facets=facets, complete=link.complete, kinds=kinds, names=link.names, edges=edges,
        contacts=tuple(patch.name for patch in link.patches),
    )  # fmt: skip


def _system(config: Config, group: tuple[str, ...], own: Sequence[Link], edges: int) -> ContactSystem:
    if len(own) == 1:
        return system_of(own[0], _loads(config, group[0], group), edges)
    _require_free(group, own)
    return ContactSystem(
        objects=group,
        loads=tuple(_loads(config, name, group) for name in group),
        pressed=(),
        points=tuple(np.zeros(3) for _ in group),
        generators=np.hstack([_placed(link, group) for link in own]),
        edges_of_friction=np.concatenate([np.arange(len(link.generators.T)) < link.edges_of_friction for link in own]),
        facets=np.zeros((0, 6 * len(group))),
        complete=False,
        kinds=np.zeros(0, dtype=np.intp),
        names=(_balance(group, own),),
        edges=edges,
        contacts=tuple(patch.name for link in own for patch in link.patches),
    )


def _require_free(group: tuple[str, ...], own: Sequence[Link]) -> None:
    for link in own:
        if link.patches[0].fixed:
            others = ", ".join(name for name in group if name != link.object)
            shares = f"it and {others} share their load" if others else "its two supports share its load"
            raise ConfigError(
                f"found fixed, but {shares}; expected free: only the pressure of a contact that bears a known load can "
                "be prescribed",
                key=f"objects.{link.object}.pressure",
            )


def _placed(link: Link, group: tuple[str, ...]) -> Array:
    """Return the generators of a contact in the stacked coordinates of a group; they act on the support too."""
    column = np.zeros((6 * len(group), link.generators.shape[1]))
    row = 6 * group.index(link.object)
    column[row : row + 6] = link.generators
    support = link.patches[0].support
    if support in group:
        row = 6 * group.index(support)
        column[row : row + 6] = -link.generators
    return column


def _explicit(link: Link) -> tuple[Array, Indices]:
    """Return the rows of a single contact, and the index of the name of each."""
    twist = link.twist.reshape(-1, len(link.generators))
    kinds = np.concatenate([link.tips.astype(np.intp), np.full(len(twist), TWIST, dtype=np.intp)])
    return np.vstack([link.rows, twist]), kinds


def _balance(group: tuple[str, ...], own: Sequence[Link]) -> LimitName:
    """Return the name of the limit of a cycle: the contacts of its bridges must balance them."""
    below = {name: [link.patches[0].support for link in own if link.object == name] for name in group}
    first, *others = [name for name in group if len(below[name]) > 1]
    more = "".join(f" and balance of {name} on {' and '.join(below[name])}" for name in others)
    return LimitName(LimitKind.BALANCE, first, " and ".join(below[first]) + more)
