"""Limits of a robot on its feet: the same families of rows as those of an arm with a tray.

The load W (n,) is the generalised force that the motion needs (see `walker`), affine in (u, x): first the wrench that
the contacts must exert, then the joint torques without them. An acceleration error e adds M e; the mass and the centre
of mass of a body enter through its ten inertial parameters (see `uncertainty`), as the force that J^T makes of the
body's wrench. On one foot alone its wrench is known, and a joint's torque is a row over W. Several contacts, both feet
or a hand on a rail too, share the load: rows over W are found by programs where a plan needs them
(`timescaling.sharing`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from robustopt.config import BASE_COORDINATES as BASE
from robustopt.config import Config
from robustopt.limits.polygons import Family, Loads, Polygons, cut
from robustopt.limits.rows import ContactFamily, evaluate
from robustopt.limits.stances import eroded_sole, stance_system
from robustopt.limits.uncertainty import Body, contact_shift, friction, regressor, spin_regressor, uncertain_body
from robustopt.path import Path
from robustopt.robot import BodyMotion, Dynamics, Robot

Array = np.ndarray

STANDARD_GRAVITY = 9.81
"""Turns a mass into the weight that rows are a fraction of [m/s^2]."""


@dataclass(frozen=True, eq=False)
class WalkMotion:
    """Motion along the path at P grid points: q, q', q'' (P, n), and the inverse dynamics."""

    q: Array
    q1: Array
    q2: Array
    dynamics: Dynamics


@dataclass(frozen=True, eq=False)
class SharedRow:
    """A row over W at one grid point that joint torques demand of a load which several contacts share.

    row: (n,), constant: with row @ W + constant <= 0; joint: the one that it is named after
    """

    point: int
    row: Array
    constant: float
    joint: int


@dataclass(frozen=True, eq=False)
class StandingTorque:
    """Joint torques of a robot on its feet, rows divided by their limits: first +tau_j, then -tau_j, the base without.

    B: rows over the load (P, 2n, n), 0 where they depend on how contacts share it; known: which do not (P, n); loads:
    W; contacts: of each stance; standing: index of the stance at each grid point (P,), that of fewer contacts at a
    switch; dynamics, limit: of the joints (n,) [N m]; soles: contact points of each contact around its middle that the
    planner counts on (k, 2) [m]; rows: found so far for loads that are shared
    """

    B: Array
    known: Array
    loads: Loads
    contacts: tuple[ContactFamily, ...]
    standing: Array
    dynamics: Dynamics
    limit: Array
    soles: Mapping[str, Array]
    rows: tuple[SharedRow, ...] = ()

    @property
    def viscous(self) -> Array:
        """There is none, (P, 2n)."""
        return np.zeros(self.B.shape[:2])

    def cut(self, outline: Polygons, reference: Array, x_top: Array, used: Array, names: Array) -> Polygons:
        """Polygons cut with the rows of the joints that are used, (2n,), each of the names (2n,)."""
        base = np.zeros((*self.B.shape[:2], 3))
        base[:, :, 2] = -1.0
        chosen = used & np.tile(np.isfinite(self.limit), 2)
        family = Family(
            np.ascontiguousarray(self.B[:, chosen]), self.loads, np.ascontiguousarray(base[:, chosen]),
            np.zeros((0, 0, 0)), names[chosen],
        )  # fmt: skip
        outline = cut(outline, family)
        rows = [row for row in self.rows if used[row.joint]]
        return cut(outline, self._shared(rows, names)) if rows else outline

    def _shared(self, rows: Sequence[SharedRow], names: Array) -> Family:
        """Rows that each hold at one grid point as a family, in as few columns as one name and point need."""
        slots: dict[tuple[int, int], int] = {}
        columns: dict[tuple[int, int], int] = {}
        place = []
        for row in rows:
            slot = slots.get((row.point, row.joint), 0)
            slots[row.point, row.joint] = slot + 1
            place.append(columns.setdefault((row.joint, slot), len(columns)))
        points, n = len(self.B), self.B.shape[2]
        B, base = np.zeros((points, len(columns), n)), np.zeros((points, len(columns), 3))
        base[:, :, 2] = -1.0
        for row, column in zip(rows, place, strict=True):
            B[row.point, column] = row.row
            base[row.point, column, 2] = row.constant
        return Family(B, self.loads, base, np.zeros((0, 0, 0)), np.array([names[joint] for joint, _ in columns]))

    def parts(self, stance: int) -> dict[str, slice]:
        """Which generators of a stance are those of each of its contacts."""
        system = self.contacts[stance].system
        parts, first = {}, 0
        for name in system.interfaces:
            count = len(self.soles[name]) * system.edges
            parts[name] = slice(first, first + count)
            first += count
        return parts

    def with_rows(self, rows: Sequence[SharedRow]) -> StandingTorque:
        """The same with more rows."""
        return replace(self, rows=(*self.rows, *rows))

    def excess(self, u: Array, x: Array, points: Array) -> Array:
        """Largest torque over all uncertain parameters as a fraction of the limit, minus 1, (M, 2n); nan where
        contacts share the load. u, x: (M,); points: (M,) grid point of each."""
        none = np.zeros((0, 0, 0))
        values = evaluate(self.B[points], self.loads.at(points), none, none, u, x) - 1.0
        return np.where(np.tile(self.known[points], 2), values, np.nan)


def walk_motion(walker: Robot, q: Array, q1: Array, q2: Array) -> WalkMotion:
    """Motion along a path at P grid points: q, q', q'' (P, n)."""
    return WalkMotion(q, q1, q2, walker.dynamics(q, q1, q2))


def walking_families(
    config: Config, walker: Robot, path: Path, s: Array, motion: WalkMotion, loads: Loads
) -> tuple[tuple[ContactFamily, ...], StandingTorque]:
    """Contacts and joint torques along the grid.

    s: (P,) grid points, which hold the path's switches; loads: W (see `walking_loads`)
    """
    on_base = loads._replace(
        **{name: np.ascontiguousarray(getattr(loads, name)[:, :BASE]) for name in ("nominal", "terms", "constant")},
        remainder=np.ascontiguousarray(loads.remainder[:, :BASE]),
    )
    coefficients, shift = friction(config), contact_shift(config)
    soles = {name: eroded_sole(sole.points, shift[name], name) for name, sole in walker.contacts.items()}
    borders = np.searchsorted(s, np.concatenate([[0.0], path.switches, [1.0]])).tolist()
    weight = STANDARD_GRAVITY * walker.mass
    systems = [stance_system(stance, soles, coefficients, config.contact.cone_edges) for stance in path.stances]
    contacts = tuple(
        ContactFamily(system, on_base, weight, first, last)
        for system, first, last in zip(systems, borders[:-1], borders[1:], strict=True)
    )
    standing = np.zeros(len(s), dtype=np.intp)
    for k in sorted(range(len(contacts)), key=lambda k: -len(path.stances[k].contacts)):
        standing[contacts[k].first : contacts[k].last + 1] = k
    return contacts, _torque(walker, motion.dynamics, loads, contacts, standing, soles)


def _torque(
    walker: Robot,
    dynamics: Dynamics,
    loads: Loads,
    contacts: tuple[ContactFamily, ...],
    standing: Array,
    soles: Mapping[str, Array],
) -> StandingTorque:
    points, n = dynamics.force_u.shape
    rows = np.zeros((points, n, n))
    known = np.ones((points, n), dtype=bool)
    rows[:, BASE:, BASE:] = np.eye(n - BASE)
    for k, family in enumerate(contacts):
        at, names = standing == k, family.system.interfaces
        for name in names:
            chain = walker.chains[name]
            if len(names) == 1:
                pull = np.swapaxes(dynamics.contact_jacobians[name][at][:, :, chain], 1, 2)
                rows[np.ix_(np.flatnonzero(at), chain, np.arange(BASE))] = -pull
            else:
                known[np.ix_(np.flatnonzero(at), chain)] = False
    rows *= known[:, :, None]
    limit = walker.limits.torque
    B = np.concatenate([rows, -rows], axis=1) / np.r_[limit, limit][:, None]
    return StandingTorque(B, known, loads, contacts, standing, dynamics, limit, soles)


# The load -------------------------------------------------------------------------------------------------


def walking_loads(config: Config, walker: Robot, motion: WalkMotion, error: tuple[Array, Array]) -> Loads:
    """W with its interval terms: the acceleration error, and bodies whose mass or centre of mass is uncertain.

    error: middle and half-width of the acceleration error, (n,) each
    """
    dynamics, (middle, radius) = motion.dynamics, error
    erring = np.flatnonzero(radius)
    per_error = np.swapaxes(dynamics.mass_matrix[:, :, erring], 1, 2)
    nominal = np.stack([dynamics.force_u, dynamics.force_x, dynamics.force_0], axis=2)
    nominal[:, :, 2] += dynamics.mass_matrix @ middle
    groups, shaken = [nominal], [per_error]
    parts: list[tuple[int, Array]] = []
    remainders: list[tuple[int, Array]] = []
    lowest, highest = [1.0], [1.0]
    for name in sorted({*config.uncertainty.center_of_mass, *config.uncertainty.mass}):
        body, own = _uncertain(config, walker, name)
        moving = walker.body_motion(name, motion.q, motion.q1, motion.q2)
        certain = body.mass[0] == body.mass[1]
        steps = body.linear[np.any(body.linear != 0, axis=1)]
        squares = body.remainder[np.any(body.remainder != 0, axis=1)]
        factor = body.mass[0] if certain else 1.0
        forces, shakes = _forces(moving, factor * np.vstack([body.psi, steps, squares]), erring, middle)
        believed, shake = _forces(moving, own[None], erring, middle)
        group = 0 if certain else len(groups)
        groups[0], shaken[0] = groups[0] - believed[0], shaken[0] - shake[0]
        if certain:
            groups[0], shaken[0] = groups[0] + forces[0], shaken[0] + shakes[0]
        else:
            groups, shaken = [*groups, forces[0]], [*shaken, shakes[0]]
            lowest, highest = [*lowest, body.mass[0]], [*highest, body.mass[1]]
        parts += [(group, term) for term in forces[1 : 1 + len(steps)]]
        remainders += [(group, term) for term in forces[1 + len(steps) :]]
        if len(erring):
            bound = np.einsum("kpen,e->pn", np.abs(shakes[1:]), radius[erring])
            remainders.append((group, np.stack([np.zeros_like(bound), np.zeros_like(bound), bound], axis=2)))
    points, n = dynamics.force_u.shape
    constant = [np.swapaxes(shake * radius[erring, None], 1, 2) for shake in shaken]
    return Loads(
        nominal=np.ascontiguousarray(np.stack(groups, axis=2)),
        terms=_stacked([term for _, term in parts], (points, n)),
        group=np.array([g for g, _ in parts], dtype=np.int64),
        constant=np.ascontiguousarray(np.concatenate(constant, axis=2)),
        constant_group=np.repeat(np.arange(len(groups)), len(erring)),
        remainder=_stacked([term for _, term in remainders], (points, n)),
        remainder_group=np.array([g for g, _ in remainders], dtype=np.int64),
        lowest=np.array(lowest),
        highest=np.array(highest),
    )


def _stacked(terms: Sequence[Array], shape: tuple[int, int]) -> Array:
    if not terms:
        return np.zeros((*shape, 0, 3))
    return np.ascontiguousarray(np.stack(terms, axis=2))


def _uncertain(config: Config, walker: Robot, name: str) -> tuple[Body, Array]:
    """A body with its intervals, and its inertial parameters in the model, (10,)."""
    mass, center, inertia = walker.inertia_of(name)
    interval = config.uncertainty.mass.get(name, (mass, mass))
    reach: Mapping[str, tuple[float, float, float]] = config.uncertainty.center_of_mass
    body = uncertain_body(name, interval, center, inertia / mass, np.diag(reach.get(name, (0.0, 0.0, 0.0))))
    as_in_model = uncertain_body(name, (mass, mass), center, inertia / mass, np.zeros((3, 3)))
    return body, as_in_model.nominal


def _forces(moving: BodyMotion, parameters: Array, erring: Array, middle: Array) -> tuple[Array, Array]:
    """Generalised forces of a body for K sets of its inertial parameters (K, 10).

    Coefficients of u, x, 1 (K, P, n, 3) with the acceleration error at its middle, and per acceleration error
    (K, P, E, n).
    """
    columns = np.r_[erring, np.flatnonzero(middle)]
    jacobian = np.swapaxes(moving.jacobian[:, :, columns], 1, 2)
    none = np.zeros_like(moving.linear_u)[:, None]
    linear = np.concatenate([np.stack([moving.linear_u, moving.linear_x, moving.linear_0], 1), jacobian[..., :3]], 1)
    angular = np.concatenate([np.stack([moving.angular_u, moving.angular_x], 1), none, jacobian[..., 3:]], 1)
    Y = regressor(linear, angular)
    Y[:, 1] += spin_regressor(moving.spin)
    wrenches = np.einsum("pcij,kj->kpci", Y, parameters)
    forces = wrenches @ np.swapaxes(moving.to_force, 1, 2)
    per_unit, shakes = np.swapaxes(forces[:, :, :3], 2, 3).copy(), forces[:, :, 3 : 3 + len(erring)]
    shift = middle[np.flatnonzero(middle)]
    per_unit[..., 2] += np.einsum("kpen,e->kpn", forces[:, :, 3 + len(erring) :], shift)
    return per_unit, shakes
