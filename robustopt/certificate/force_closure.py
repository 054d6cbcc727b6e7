"""Force closure on exact Coulomb cones: whether contact forces balance a wrench, and how far it is from the limit.

K blocks balance if the cones of all contact points contain forces whose wrenches sum to the required wrench w (6 K,)
and whose closing forces have the given values. All such sums form a convex cone C.

The gauge of rest + move, with rows `rest` inside the cone as the reference, is

    gamma = min {g >= 0: g rest + move in C}.

It is 1 at the limit and |f_t| / (mu f_z) for a block that slides. For a block that tips it is the distance of the
centre of pressure from its place at rest, as a share of the distance to the edge of the patch. The gauge is the optimum
of a second-order cone program and of its dual,

    min g  s.t.  sum_i A_i f_i - g rest = move,  f_i in the cone of point i,
    max -y move  s.t.  A_i^T y in the (self-dual) cone of point i,  y rest <= 1,

which a primal-dual interior-point method solves, with Nesterov-Todd scaling and Mehrotra's predictor and corrector. All
iterates y are feasible, so each bounds gamma from below; forces that balance bound it from above.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from robustopt.arrays import Array, Flags, Indices
from robustopt.certificate.cone_algebra import Scaling, cholesky, divide, ray, reach, solve, square
from robustopt.certificate.contact_points import Contacts, even_pressure

GAP = 1e-8
"""Width of the bracket of gamma, and residual as a share of the wrench, at which a program is solved: a hundredth of
the violation that a certificate accepts, and above the rounding errors of the normal equations (about 1e-9).
"""

ROUGH_GAP = 2e-7
"""The same for a program whose accuracy is limited by rounding errors, for example because of degenerate patches."""

NEARLY = 1e-4
"""Residual, as a share of the wrench, that is accepted if rounding errors end a program early; a second program
balances it.
"""

MOST_ITERATIONS = 60
"""Largest number of iterations; ten are usual."""

MOST = 1e4
"""A gauge above this counts as infinite: g rest + move lies outside the cone for every g."""

BACK_OFF = 0.99
"""Length of a step, as a share of the distance to the boundary of the cones."""

CHUNK = 1024
"""Number of programs that are solved together: few enough for the cache, enough to hide the overhead of array
operations.
"""


@dataclass(frozen=True)
class Gauge:
    """Solutions of T programs.

    Attributes:
        value: gamma, from forces that balance; infinite if there are none (T,).
        lower: lower bound of gamma (T,).
        y: the nearest limit, y w >= 0 for all w in the cone (rows, T).
    """

    value: Array
    lower: Array
    y: Array


def gauge(contacts: Contacts, rest: Array, move: Array, good_enough: Array | float = 0.0, gap: float = GAP) -> Gauge:
    """Return the smallest g with g rest + move in the cone, to within `gap`.

    The accuracy is best if forces are divided by the weight and lengths by the size of the patch.

    Args:
        contacts: contact points of T programs.
        rest: reference (rows, T).
        move: rows that the motion adds (rows, T).
        good_enough: gauge below which the search may stop (T,).
        gap: accuracy.
    """
    count = rest.shape[-1]
    enough = np.broadcast_to(np.asarray(good_enough, dtype=float), (count,))
    value, lower, y = np.empty(count), np.empty(count), np.empty(rest.shape)
    for begin in range(0, count, CHUNK):
        part = slice(begin, begin + CHUNK)
        programs = _InteriorPoint(contacts[part], rest[:, part], move[:, part], enough[part], gap).solve()
        value[part], lower[part], y[:, part] = programs.value, programs.lower, programs.direction
        lost = np.flatnonzero(np.isinf(programs.value) & (programs.left_over_size < NEARLY))
        if len(lost) and gap < NEARLY:
            value[part][lost] = _with_left_over(contacts[part][lost], rest[:, part][:, lost], programs, lost)
    return Gauge(value, lower, y)


def _with_left_over(contacts: Contacts, rest: Array, programs: _InteriorPoint, lost: Indices) -> Array:
    """Return the gauges (T,) of programs that rounding errors keep from balancing to the last digits.

    Let r be the residual wrench. Forces balance g rest + move - r, and with the gauge h of r they balance h rest + r,
    so they balance (g + h) rest + move. h is proportional to the length of r, which is small.
    """
    size = programs.left_over_size[lost]
    direction = programs.left_over[:, lost] / np.maximum(size, 1e-300)
    return np.asarray(programs.reached[lost] + size * gauge(contacts, rest, direction, gap=NEARLY).value)


def seen_from(contacts: Contacts, held: Flags, rest: Array, move: Array) -> tuple[Array, Array]:
    """Return `rest` and `move`, with an even pressure as the reference in place of any `rest` that is not held."""
    if held.all():
        return rest, move
    even = even_pressure(contacts, rest.shape[-1])
    return np.where(held, rest, even), np.where(held, move, rest + move - even)


class _InteriorPoint:
    """State of the iteration for the T programs that are not solved yet.

    Attributes:
        force: coordinates of the forces (3, n, T).
        slack: slacks of the dual cones (3, n, T).
        g: the last variable of the primal program (T,).
        slack_g: its slack, 1 - y rest (T,).
        y: variables of the dual program (rows, T).
        index: index of each program among those of the caller (T,).
        reached: g of the best iterate (T,).
        left_over: residual of the best iterate (rows, T).
    """

    def __init__(self, contacts: Contacts, rest: Array, move: Array, enough: Array, gap: float) -> None:
        self.contacts, self.rest, self.move, self.enough, self.gap = contacts, rest, move, enough, gap
        count, points = rest.shape[-1], contacts.mu.shape[0]
        up = contacts.inside @ rest
        pressing = up > 0.0
        up = np.where(pressing, up, 1.0)
        self.y = 0.5 * contacts.inside[:, None] / up
        self.force = np.zeros((3, points, count))
        self.force[0] = up / points
        self.slack, self.residual = np.empty_like(self.force), np.empty_like(rest)
        self.g, self.slack_g, self.product = np.ones(count), np.empty(count), np.empty(count)
        self.index = np.arange(count)
        self.value = np.full(count, np.inf)
        self.lower = np.where(pressing, 0.0, np.inf)
        self.error = np.full(count, np.inf)
        self.direction = self.y.copy()
        self.reached, self.left_over = np.full(count, np.inf), np.zeros_like(rest)
        self.left_over_size = np.full(count, np.inf)
        self._keep(pressing)

    def solve(self) -> _InteriorPoint:
        """Iterate until all programs are solved.

        The solutions are `value`, `lower` (T,) and `direction` (rows, T). A program may break down at the limit of
        numerical precision; then its best iterate is the solution.
        """
        with np.errstate(all="ignore"):
            for _ in range(MOST_ITERATIONS):
                if len(self.index):
                    self._bracket()
                if len(self.index):
                    self._iterate()
        return self

    def _bracket(self) -> None:
        """Update slacks, bounds and residual of the iterate; put aside the programs that are solved or cannot be."""
        self.slack = self.contacts.seen(self.y)
        self.slack_g = 1.0 - (self.rest * self.y).sum(axis=0)
        lower = -(self.move * self.y).sum(axis=0)
        self.residual = self.move + self.g * self.rest - self.contacts.pressed(self.force)
        self.product = self.g * self.slack_g + (self.force * self.slack).sum(axis=(0, 1))
        unbalanced, g = self._unbalanced(), self.g
        enough = (unbalanced < GAP * (1.0 + g)) & (g <= self.enough)
        error = np.maximum(unbalanced, g - lower) / (1.0 + g)
        better = enough | (error < self.error)
        found = self.index[better]
        self.value[found] = np.where(enough | (error < max(self.gap, ROUGH_GAP)), g, np.inf)[better]
        self.direction[:, found] = self.y[:, better]
        self.reached[found], self.left_over[:, found] = g[better], self.residual[:, better]
        self.left_over_size[found] = np.sqrt((self.residual[:, better] ** 2).sum(axis=0))
        self.lower[self.index] = np.maximum(self.lower[self.index], lower)
        interior = (square(self.force) > 0.0).all(axis=0) & (square(self.slack) > 0.0).all(axis=0)
        stuck = ~(interior & (self.slack_g > 0.0)) | (error > 100.0 * self.error) | ~np.isfinite(error)
        self.error = np.minimum(self.error, error)
        self._keep(~(enough | (error < self.gap) | (lower > MOST) | stuck))

    def _unbalanced(self) -> Array:
        """Return the length (T,) of the residual, with the friction rows in units of the lowest friction."""
        wrenches = 6 * (1 + max(face.above for face in self.contacts.faces))
        rows = (self.residual[:wrenches] ** 2).reshape(-1, 6, len(self.index)).sum(axis=0)
        friction = np.minimum(self.contacts.mu.min(axis=0), 1.0)
        plain = rows[2:5].sum(axis=0) + (self.residual[wrenches:] ** 2).sum(axis=0)
        return np.asarray(np.sqrt(plain + (rows[0] + rows[1] + rows[5]) / friction**2))

    def _keep(self, chosen: Flags) -> None:
        """Keep only the `chosen` programs."""
        if chosen.all():
            return
        keep = np.flatnonzero(chosen)
        self.contacts = self.contacts[keep]
        self.rest, self.move, self.residual = self.rest[:, keep], self.move[:, keep], self.residual[:, keep]
        self.force, self.slack, self.y = self.force[..., keep], self.slack[..., keep], self.y[:, keep]
        self.g, self.slack_g, self.product = self.g[keep], self.slack_g[keep], self.product[keep]
        self.enough, self.error, self.index = self.enough[keep], self.error[keep], self.index[keep]

    def _iterate(self) -> None:
        """Take one predictor and one corrector step."""
        root, scaled_g = np.sqrt(self.g / self.slack_g), np.sqrt(self.g * self.slack_g)
        scaling = Scaling(self.force, self.slack)
        scaled = scaling(self.slack)
        factor = self._factor(scaling, root)
        predictor = self._step(factor, scaling, scaled, scaled_g, -scaled, -scaled_g)
        target = predictor.target(self.product, scaled, scaled_g) * self.product / (1 + self.force.shape[1])
        right = divide(scaled, target, predictor.force, predictor.slack)
        right_g = (target - predictor.g * predictor.slack_g) / scaled_g - scaled_g
        step = self._step(factor, scaling, scaled, scaled_g, right, right_g)
        force_step = np.minimum(1.0, BACK_OFF * step.longest_force)
        y_step = np.minimum(1.0, BACK_OFF * step.longest_slack)
        self.force += force_step * scaling(step.force)
        self.g = self.g + force_step * root * step.g
        self.y = self.y - y_step * step.y

    def _factor(self, scaling: Scaling, root: Array) -> Array:
        """Return the Cholesky factor of sum_i A_i W_i^2 A_i^T + (g / slack_g) rest rest^T, (rows, rows, T)."""
        scaled_rest = root * self.rest
        return cholesky(scaled_rest[:, None] * scaled_rest + self.contacts.stiffness(scaling.matrix()))

    def _step(
        self, factor: Array, scaling: Scaling, scaled: Array, scaled_g: Array, right: Array, right_g: Array
    ) -> _Step:
        """Return the Newton step for right-hand sides of the scaled complementarity, (3, n, T) and (T,)."""
        root = np.sqrt(self.g / self.slack_g)
        lacking = self.residual - self.contacts.pressed(scaling(right)) + self.rest * (root * right_g)
        y = solve(factor, lacking)
        slack = -scaling(self.contacts.seen(y))
        slack_g = root * (self.rest * y).sum(axis=0)
        return _Step(y, right - slack, slack, right_g - slack_g, slack_g, scaled, scaled_g)


class _Step:
    """Scaled Newton step and how long it may be, as multiples of itself, (T,)."""

    def __init__(
        self, y: Array, force: Array, slack: Array, g: Array, slack_g: Array, scaled: Array, scaled_g: Array
    ) -> None:
        self.y, self.force, self.slack, self.g, self.slack_g = y, force, slack, g, slack_g
        self.longest_force = np.minimum(reach(scaled, force).min(axis=0), ray(scaled_g, g))
        self.longest_slack = np.minimum(reach(scaled, slack).min(axis=0), ray(scaled_g, slack_g))

    def target(self, product: Array, scaled: Array, scaled_g: Array) -> Array:
        """Return the share of the complementarity that the corrector aims at (Mehrotra's rule), (T,)."""
        a, b = np.minimum(1.0, self.longest_force), np.minimum(1.0, self.longest_slack)
        left = ((scaled + a * self.force) * (scaled + b * self.slack)).sum(axis=(0, 1))
        left += (scaled_g + a * self.g) * (scaled_g + b * self.slack_g)
        return np.asarray((np.maximum(left, 0.0) / product) ** 3)
