"""Force closure on exact Coulomb cones: do contact forces balance a wrench, and how far from the limit is it?

K blocks balance if forces exist in the cones of all contact points whose wrenches sum to the required wrench w, (6 K,),
and whose closing forces are as given. All such sums form a convex cone C.

The gauge of rest + move, seen from rows `rest` inside the cone, is

    gamma = min {g >= 0: g rest + move in C},

1 at the limit, |f_t| / (mu f_z) for a block that slides, and the share of its way to the edge of the patch that the
centre of pressure has gone for a block that tips. It is a second-order cone program,

    min g  s.t.  sum_i A_i f_i - g rest = move,  f_i in the cone of point i,
    max -y move  s.t.  A_i^T y in the (self-dual) cone of point i,  y rest <= 1,

solved by a primal-dual interior-point method with Nesterov and Todd's scaling and Mehrotra's predictor and corrector.
The iterates y are feasible throughout, so each bounds gamma from below; forces that balance bound it from above. A cut
adds a row, a variable z >= 0 that it must equal, and y <= 0 for it. The multiplier g and all z are the *levels* here.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from robustopt.arrays import Array, Flags, Indices
from robustopt.certificate.cone_algebra import Scaling, cholesky, divide, ray, reach, solve, square
from robustopt.certificate.contact_points import Contacts, even_pressure

GAP = 1e-8
"""Width of the bracket of gamma, and unbalanced share of the wrench, at which a program is solved: a hundredth of the
violation that a certificate forgives, and above the rounding errors of the normal equations (about 1e-9)."""

ROUGH_GAP = 2e-7
"""The same for a program that rounding errors keep from improving, as with degenerate patches."""

NEARLY = 1e-4
"""Share of the wrench that may be left over where rounding errors end a program early; a second program balances it."""

MOST_ITERATIONS = 60
"""Ten are usual."""

MOST = 1e4
"""A gauge above this counts as infinite: what is to be balanced lies outside the cone for every g."""

BACK_OFF = 0.99
"""Share of the way to the boundary of the cones that a step takes."""

CHUNK = 1024
"""Programs solved together: few enough for the cache, enough to hide the cost of an array operation."""


@dataclass(frozen=True)
class Gauge:
    """Solutions of T programs.

    value: (T,) gamma, from forces that balance, infinite if there are none
    lower: (T,) bound from below
    y: (rows, T) the limit that is nearest: y w >= 0 for all w in the cone
    force: (3, n, T) coordinates of the forces
    """

    value: Array
    lower: Array
    y: Array
    force: Array


def gauge(contacts: Contacts, rest: Array, move: Array, good_enough: Array | float = 0.0, gap: float = GAP) -> Gauge:
    """Return the smallest g with g rest + move in the cone, to within `gap`.

    Forces divided by the weight and lengths divided by the size of the patch are best.

    Args:
        contacts: contact points of T programs.
        rest: (rows, T) seen from here.
        move: (rows, T).
        good_enough: (T,) any g up to this one will do.
        gap: accuracy.
    """
    count = rest.shape[-1]
    enough = np.broadcast_to(np.asarray(good_enough, dtype=float), (count,))
    value, lower, force = np.empty(count), np.empty(count), np.empty((3, contacts.mu.shape[0], count))
    rest, move = _with_cuts(contacts, rest), _with_cuts(contacts, move)
    y = np.empty(rest.shape)
    for begin in range(0, count, CHUNK):
        part = slice(begin, begin + CHUNK)
        programs = _InteriorPoint(contacts[part], rest[:, part], move[:, part], enough[part], gap).solve()
        value[part], lower[part], y[:, part] = programs.value, programs.lower, programs.direction
        force[..., part] = programs.best
        lost = np.flatnonzero(np.isinf(programs.value) & (programs.left_over_size < NEARLY))
        if len(lost) and gap < NEARLY:
            value[part][lost] = _with_left_over(contacts[part][lost], rest[:, part][:, lost], programs, lost)
    return Gauge(value, lower, y[: contacts.rows], force)


def _with_cuts(contacts: Contacts, rows: Array) -> Array:
    """Return rows with those of the cuts behind them, 0 if there are none yet."""
    total = contacts.rows + (0 if contacts.cuts is None else len(contacts.cuts))
    return np.concatenate([rows, np.zeros((total - len(rows), rows.shape[-1]))]) if total > len(rows) else rows


def _with_left_over(contacts: Contacts, rest: Array, programs: _InteriorPoint, lost: Indices) -> Array:
    """Return the gauges (T,) of programs that rounding errors keep from balancing to the last digits.

    g rest + move - r is balanced, r the wrench that is left over, and h rest + r for the gauge h of r; so
    (g + h) rest + move is balanced too. h is in proportion to the length of r, which is small.
    """
    size = programs.left_over_size[lost]
    direction = programs.left_over[:, lost] / np.maximum(size, 1e-300)
    return np.asarray(programs.reached[lost] + size * gauge(contacts, rest, direction, gap=NEARLY).value)


def seen_from(contacts: Contacts, held: Flags, rest: Array, move: Array) -> tuple[Array, Array]:
    """Return `rest` and `move`, but with an even pressure for `rest` if that is not held."""
    if held.all():
        return rest, move
    even = even_pressure(contacts, rest.shape[-1])
    return np.where(held, rest, even), np.where(held, move, rest + move - even)


class _InteriorPoint:
    """State of the iteration for the T programs that are not solved yet.

    force, slack: (3, n, T) coordinates of the forces and the dual cones' slacks; level, slack_level: (1 + C, T) g and
    the values of the cuts, and their slacks 1 - y rest and -y; y: (rows, T); index: (T,) which programs of the caller
    these are; reached, left_over, best: g, the wrench that is not balanced and the forces of the best iterate, (T,),
    (rows, T) and (3, n, T)
    """

    def __init__(self, contacts: Contacts, rest: Array, move: Array, enough: Array, gap: float) -> None:
        self.contacts, self.rest, self.move, self.enough, self.gap = contacts, rest, move, enough, gap
        count, points = rest.shape[-1], contacts.mu.shape[0]
        up = contacts.inside @ rest[: contacts.rows]
        pressing = up > 0.0
        up = np.where(pressing, up, 1.0)
        self.y = np.zeros_like(rest)
        self.y[: contacts.rows] = 0.5 * contacts.inside[:, None] / up
        self.force = np.zeros((3, points, count))
        self.force[0] = up / points
        self.level = np.ones((1, count))
        if contacts.cuts is not None:
            self._open_cuts(contacts.cuts, up)
        self.slack, self.residual = np.empty_like(self.force), np.empty_like(rest)
        self.slack_level, self.product = np.empty_like(self.level), np.empty(count)
        self.index = np.arange(count)
        self.value = np.full(count, np.inf)
        self.lower = np.where(pressing, 0.0, np.inf)
        self.error = np.full(count, np.inf)
        self.direction, self.best = self.y.copy(), self.force.copy()
        self.reached, self.left_over = np.full(count, np.inf), np.zeros_like(rest)
        self.left_over_size = np.full(count, np.inf)
        self._keep(pressing)

    def _open_cuts(self, cuts: Array, up: Array) -> None:
        """Start the cuts: positive values, and y so little below 0 that it stays inside the dual cones."""
        seen = self.contacts.seen(self.y)
        room = seen[0] - np.sqrt(seen[1] ** 2 + seen[2] ** 2)
        size = np.sqrt((cuts**2).sum(axis=1)).sum(axis=0)
        self.y[self.contacts.rows :] = -0.25 * (room / np.maximum(size, 1e-300)).min(axis=0)
        self.level = np.concatenate([self.level, np.repeat(up[None], len(cuts), axis=0)])

    def solve(self) -> _InteriorPoint:
        """Iterate until all programs are solved; `value`, `lower` (T,) and `direction` (rows, T) are their solutions.

        A program at the end of its numerical precision may break down; its best iterate counts.
        """
        with np.errstate(all="ignore"):
            for _ in range(MOST_ITERATIONS):
                if len(self.index):
                    self._bracket()
                if len(self.index):
                    self._iterate()
        return self

    def _along(self, level: Array) -> Array:
        """Return the rows of g rest and of the values of the cuts, (rows, T), for levels (1 + C, T)."""
        out = self.rest * level[0]
        if len(level) > 1:
            out[self.contacts.rows :] += level[1:]
        return out

    def _onto(self, y: Array) -> Array:
        """Return y rest and y of the cuts, (1 + C, T), for y (rows, T)."""
        along = (self.rest * y).sum(axis=0)[None]
        return along if self.contacts.cuts is None else np.concatenate([along, y[self.contacts.rows :]])

    def _bracket(self) -> None:
        """Update slacks, bounds and residual of the iterate; put aside the programs that are solved or hopeless."""
        self.slack = self.contacts.seen(self.y)
        self.slack_level = -self._onto(self.y)
        self.slack_level[0] += 1.0
        lower = -(self.move * self.y).sum(axis=0)
        self.residual = self.move + self._along(self.level) - self.contacts.pressed(self.force)
        self.product = (self.level * self.slack_level).sum(axis=0) + (self.force * self.slack).sum(axis=(0, 1))
        unbalanced, g = self._unbalanced(), self.level[0]
        enough = (unbalanced < GAP * (1.0 + g)) & (g <= self.enough)
        error = np.maximum(unbalanced, g - lower) / (1.0 + g)
        better = enough | (error < self.error)
        found = self.index[better]
        self.value[found] = np.where(enough | (error < max(self.gap, ROUGH_GAP)), g, np.inf)[better]
        self.direction[:, found], self.best[..., found] = self.y[:, better], self.force[..., better]
        self.reached[found], self.left_over[:, found] = g[better], self.residual[:, better]
        self.left_over_size[found] = np.sqrt((self.residual[:, better] ** 2).sum(axis=0))
        self.lower[self.index] = np.maximum(self.lower[self.index], lower)
        interior = (square(self.force) > 0.0).all(axis=0) & (square(self.slack) > 0.0).all(axis=0)
        interior &= (self.slack_level > 0.0).all(axis=0)
        stuck = ~interior | (error > 100.0 * self.error) | ~np.isfinite(error)
        self.error = np.minimum(self.error, error)
        self._keep(~(enough | (error < self.gap) | (lower > MOST) | stuck))

    def _unbalanced(self) -> Array:
        """Return the length (T,) of the residual, rows of friction in units of the lowest friction."""
        wrenches = 6 * (1 + max(face.above for face in self.contacts.faces))
        rows = (self.residual[:wrenches] ** 2).reshape(-1, 6, len(self.index)).sum(axis=0)
        friction = np.minimum(self.contacts.mu.min(axis=0), 1.0)
        plain = rows[2:5].sum(axis=0) + (self.residual[wrenches:] ** 2).sum(axis=0)
        return np.asarray(np.sqrt(plain + (rows[0] + rows[1] + rows[5]) / friction**2))

    def _keep(self, chosen: Flags) -> None:
        """Drop the programs that are not `chosen`."""
        if chosen.all():
            return
        keep = np.flatnonzero(chosen)
        self.contacts = self.contacts[keep]
        self.rest, self.move, self.residual = self.rest[:, keep], self.move[:, keep], self.residual[:, keep]
        self.force, self.slack, self.y = self.force[..., keep], self.slack[..., keep], self.y[:, keep]
        self.level, self.slack_level = self.level[:, keep], self.slack_level[:, keep]
        self.enough, self.error, self.index = self.enough[keep], self.error[keep], self.index[keep]
        self.product = self.product[keep]

    def _iterate(self) -> None:
        """Take one predictor and one corrector."""
        root, scaled_level = np.sqrt(self.level / self.slack_level), np.sqrt(self.level * self.slack_level)
        scaling = Scaling(self.force, self.slack)
        scaled = scaling(self.slack)
        factor = self._factor(scaling, root)
        predictor = self._step(factor, scaling, scaled, scaled_level, -scaled, -scaled_level)
        order = self.force.shape[1] + len(self.level)
        target = predictor.target(self.product, scaled, scaled_level) * self.product / order
        right = divide(scaled, target, predictor.force, predictor.slack)
        right_level = (target - predictor.level * predictor.slack_level) / scaled_level - scaled_level
        step = self._step(factor, scaling, scaled, scaled_level, right, right_level)
        force_step = np.minimum(1.0, BACK_OFF * step.longest_force)
        y_step = np.minimum(1.0, BACK_OFF * step.longest_slack)
        self.force += force_step * scaling(step.force)
        self.level = self.level + force_step * root * step.level
        self.y = self.y - y_step * step.y

    def _factor(self, scaling: Scaling, root: Array) -> Array:
        """Return the Cholesky factor of sum_i A_i W_i^2 A_i^T and the same of the levels, (rows, rows, T)."""
        scaled_rest = root[0] * self.rest
        matrix = scaled_rest[:, None] * scaled_rest
        cuts = np.arange(self.contacts.rows, len(matrix))
        matrix[cuts, cuts] += root[1:] ** 2
        return cholesky(matrix + self.contacts.stiffness(scaling.matrix()))

    def _step(
        self, factor: Array, scaling: Scaling, scaled: Array, scaled_level: Array, right: Array, right_level: Array
    ) -> _Step:
        """Return the Newton step for right-hand sides of the scaled complementarity, (3, n, T) and (1 + C, T)."""
        root = np.sqrt(self.level / self.slack_level)
        lacking = self.residual - self.contacts.pressed(scaling(right)) + self._along(root * right_level)
        y = solve(factor, lacking)
        slack = -scaling(self.contacts.seen(y))
        slack_level = root * self._onto(y)
        return _Step(y, right - slack, slack, right_level - slack_level, slack_level, scaled, scaled_level)


class _Step:
    """Scaled Newton step and how long it may be, as multiples of itself, (T,)."""

    def __init__(
        self, y: Array, force: Array, slack: Array, level: Array, slack_level: Array, scaled: Array, scaled_level: Array
    ) -> None:
        self.y, self.force, self.slack, self.level, self.slack_level = y, force, slack, level, slack_level
        self.longest_force = np.minimum(reach(scaled, force).min(axis=0), ray(scaled_level, level).min(axis=0))
        self.longest_slack = np.minimum(reach(scaled, slack).min(axis=0), ray(scaled_level, slack_level).min(axis=0))

    def target(self, product: Array, scaled: Array, scaled_level: Array) -> Array:
        """Return the share of the complementarity that the corrector aims at (Mehrotra's rule), (T,)."""
        a, b = np.minimum(1.0, self.longest_force), np.minimum(1.0, self.longest_slack)
        left = ((scaled + a * self.force) * (scaled + b * self.slack)).sum(axis=(0, 1))
        left += ((scaled_level + a * self.level) * (scaled_level + b * self.slack_level)).sum(axis=0)
        return np.asarray((np.maximum(left, 0.0) / product) ** 3)
