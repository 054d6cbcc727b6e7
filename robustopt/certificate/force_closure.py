"""Whether contact forces in exact Coulomb cones balance a wrench, and how far from the limit it is.

K blocks balance when forces exist in the cones of all contact points whose wrenches sum to what the blocks require, w,
shape (6 K,). All such sums form a convex cone C.

The gauge of a wrench rest + move, seen from a wrench `rest` inside the cone, is

    gamma = min {g >= 0: g rest + move in C},

1 at the limit, |f_t| / (mu f_z) for a block that slides, and the share of its way to the edge of the patch that the
centre of pressure has gone for a block that tips. It is a second-order cone program,

    min g  s.t.  sum_i A_i f_i - g rest = move,  f_i in the cone of point i,
    max -y move  s.t.  A_i^T y in the (self-dual) cone of point i,  y rest <= 1,

solved by a primal-dual interior-point method with Nesterov and Todd's scaling and Mehrotra's predictor and corrector.
The iterates y are feasible throughout, so each bounds gamma from below; forces that balance bound it from above.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from robustopt.certificate.contact_points import Array, Contacts, Flags, Indices, even_pressure, simply_held

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

REGULAR = 1e-14
"""Smallest pivot of the normal equations as a share of their trace: a patch that is a line or a point has no stiffness
in some directions."""

CHUNK = 1024
"""Programs solved together: few enough for the cache, enough to hide the cost of an array operation."""


@dataclass(frozen=True)
class Gauge:
    """Solutions of T programs.

    value: (T,) gamma, from forces that balance, infinite where there are none; lower: (T,) bound from below;
    y: (6 K, T) the limit that is nearest, y w >= 0 for all w in the cone
    """

    value: Array
    lower: Array
    y: Array


def gauge(contacts: Contacts, rest: Array, move: Array, good_enough: Array | float = 0.0, gap: float = GAP) -> Gauge:
    """Smallest g with g rest + move in the cone, both (6 K, T), to within `gap`; any g <= good_enough (T,) will do.

    Wrenches and lengths of order 1 are best: divide forces by the weight and lengths by the size of the patch.
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
    """Gauges (T,) of programs that rounding errors keep from balancing to the last digits.

    g rest + move - r is balanced, r the wrench that is left over, and h rest + r for the gauge h of r; so
    (g + h) rest + move is balanced too. h is in proportion to the length of r, which is small.
    """
    size = programs.left_over_size[lost]
    direction = programs.left_over[:, lost] / np.maximum(size, 1e-300)
    return np.asarray(programs.reached[lost] + size * gauge(contacts, rest, direction, gap=NEARLY).value)


def gauge_from_rest(
    contacts: Contacts, rest: Array, move: Array, good_enough: Array | float = 0.0, gap: float = GAP
) -> Gauge:
    """`gauge`, but seen from an even pressure where the contacts cannot hold `rest`.

    Either way the value is at most 1 exactly where forces balance rest + move.
    """
    held = simply_held(contacts, rest)
    even = np.zeros_like(rest)
    doubtful = np.flatnonzero(~held)
    if len(doubtful):
        even[:, doubtful] = even_pressure(contacts[doubtful], len(doubtful))
        at_rest = gauge(contacts[doubtful], even[:, doubtful], (rest - even)[:, doubtful], 1.0)
        held[doubtful] = at_rest.value <= 1.0 + GAP
    return gauge(contacts, np.where(held, rest, even), np.where(held, move, rest + move - even), good_enough, gap)


class _InteriorPoint:
    """State of the iteration for the T programs that are not solved yet.

    force, slack: (3, n, T) coordinates of the forces and the dual cones' slacks; g, slack_g: (T,) the last variable and
    its slack 1 - y rest; y: (6 K, T); index: (T,) which programs of the caller these are; reached, left_over: g and the
    wrench that is not balanced, of the best iterate, (T,) and (6 K, T)
    """

    def __init__(self, contacts: Contacts, rest: Array, move: Array, enough: Array, gap: float) -> None:
        self.contacts, self.rest, self.move, self.enough, self.gap = contacts, rest, move, enough, gap
        count, points = rest.shape[-1], contacts.mu.shape[0]
        level = contacts.levels()
        up = level @ rest[2::6]
        pressing = up > 0.0
        up = np.where(pressing, up, 1.0)
        self.y = np.zeros_like(rest)
        self.y[2::6] = 0.5 * level[:, None] / up
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
        """Iterate until all programs are solved; `value`, `lower` (T,) and `direction` (6 K, T) are their solutions.

        A program at the end of its numerical precision may break down; its best iterate counts.
        """
        with np.errstate(all="ignore"):
            for _ in range(MOST_ITERATIONS):
                if len(self.index):
                    self._bracket()
                if len(self.index):
                    self._iterate()
        return self

    def _bracket(self) -> None:
        """Slacks, bounds and residual of the iterate; puts aside the programs that are solved or hopeless."""
        self.slack = self.contacts.seen(self.y)
        self.slack_g = 1.0 - (self.rest * self.y).sum(axis=0)
        lower = -(self.move * self.y).sum(axis=0)
        self.residual = self.move + self.g * self.rest - self.contacts.pressed(self.force)
        self.product = self.g * self.slack_g + (self.force * self.slack).sum(axis=(0, 1))
        unbalanced = self._unbalanced()
        enough = (unbalanced < GAP * (1.0 + self.g)) & (self.g <= self.enough)
        error = np.maximum(unbalanced, self.g - lower) / (1.0 + self.g)
        better = enough | (error < self.error)
        found = self.index[better]
        self.value[found] = np.where(enough | (error < max(self.gap, ROUGH_GAP)), self.g, np.inf)[better]
        self.direction[:, found] = self.y[:, better]
        self.reached[found], self.left_over[:, found] = self.g[better], self.residual[:, better]
        self.left_over_size[found] = np.sqrt((self.residual[:, better] ** 2).sum(axis=0))
        self.lower[self.index] = np.maximum(self.lower[self.index], lower)
        interior = (_square(self.force) > 0.0).all(axis=0) & (_square(self.slack) > 0.0).all(axis=0)
        stuck = ~(interior & (self.slack_g > 0.0)) | (error > 100.0 * self.error) | ~np.isfinite(error)
        self.error = np.minimum(self.error, error)
        self._keep(~(enough | (error < self.gap) | (lower > MOST) | stuck))

    def _unbalanced(self) -> Array:
        """Length of the residual, what friction must balance measured in units of the lowest friction, (T,)."""
        rows = (self.residual**2).reshape(-1, 6, len(self.index)).sum(axis=0)
        friction = np.minimum(self.contacts.mu.min(axis=0), 1.0)
        return np.asarray(np.sqrt(rows[2:5].sum(axis=0) + (rows[0] + rows[1] + rows[5]) / friction**2))

    def _keep(self, chosen: Flags) -> None:
        """Drop the programs that are not `chosen`."""
        if chosen.all():
            return
        keep = np.flatnonzero(chosen)
        self.contacts = self.contacts[keep]
        self.rest, self.move, self.residual = self.rest[:, keep], self.move[:, keep], self.residual[:, keep]
        self.force, self.slack, self.y = self.force[..., keep], self.slack[..., keep], self.y[:, keep]
        self.g, self.slack_g, self.product = self.g[keep], self.slack_g[keep], self.product[keep]
        self.enough, self.error, self.index = self.enough[keep], self.error[keep], self.index[keep]

    def _iterate(self) -> None:
        """One predictor and one corrector."""
        root, scaled_g = np.sqrt(self.g / self.slack_g), np.sqrt(self.g * self.slack_g)
        scaling = _Scaling(self.force, self.slack)
        scaled = scaling(self.slack)
        factor = self._factor(scaling, root)
        predictor = self._step(factor, scaling, scaled, scaled_g, -scaled, -scaled_g)
        target = predictor.target(self.product, scaled, scaled_g) * self.product / (1 + self.force.shape[1])
        right = _divide(scaled, target, predictor.force, predictor.slack)
        right_g = (target - predictor.g * predictor.slack_g) / scaled_g - scaled_g
        step = self._step(factor, scaling, scaled, scaled_g, right, right_g)
        force_step = np.minimum(1.0, BACK_OFF * step.longest_force)
        y_step = np.minimum(1.0, BACK_OFF * step.longest_slack)
        self.force += force_step * scaling(step.force)
        self.g = self.g + force_step * root * step.g
        self.y = self.y - y_step * step.y

    def _factor(self, scaling: _Scaling, root: Array) -> Array:
        """Cholesky factor of sum_i A_i W_i^2 A_i^T + (g / slack_g) rest rest^T, (6 K, 6 K, T)."""
        scaled_rest = root * self.rest
        matrix = scaled_rest[:, None] * scaled_rest
        columns = scaling.matrix()
        for face in self.contacts.faces:
            wrenches = self.contacts.wrenches(face, columns[:, :, face.first : face.last])
            wrenches = wrenches.reshape(6, -1, wrenches.shape[-1])
            stiffness = np.stack([(row * wrenches).sum(axis=1) for row in wrenches])
            a, b = slice(6 * face.above, 6 * face.above + 6), slice(6 * face.below, 6 * face.below + 6)
            matrix[a, a] += stiffness
            if face.below >= 0:
                matrix[b, b] += stiffness
                matrix[a, b] -= stiffness
                matrix[b, a] -= stiffness
        return _cholesky(matrix)

    def _step(
        self, factor: Array, scaling: _Scaling, scaled: Array, scaled_g: Array, right: Array, right_g: Array
    ) -> _Step:
        """Newton step for the right-hand sides `right` (3, n, T) and `right_g` (T,) of the scaled complementarity."""
        root = np.sqrt(self.g / self.slack_g)
        load = self.residual - self.contacts.pressed(scaling(right)) + self.rest * (root * right_g)
        y = _solve(factor, load)
        slack = -scaling(self.contacts.seen(y))
        slack_g = root * (self.rest * y).sum(axis=0)
        return _Step(y, right - slack, slack, right_g - slack_g, slack_g, scaled, scaled_g)


class _Scaling:
    """Nesterov and Todd's scaling W of each cone: W^-1 force = W slack."""

    def __init__(self, force: Array, slack: Array) -> None:
        force_size, slack_size = np.sqrt(_square(force)), np.sqrt(_square(slack))
        force, slack = force / force_size, slack / slack_size
        w = force + slack * np.array([1.0, -1.0, -1.0])[:, None, None]
        self.w = w / np.sqrt(2.0 * (1.0 + (force * slack).sum(axis=0)))
        self.eta = np.sqrt(force_size / slack_size)

    def __call__(self, c: Array) -> Array:
        """W c, (3, n, T)."""
        w0, w1, w2 = self.w
        along = w1 * c[1] + w2 * c[2]
        factor = c[0] + along / (1.0 + w0)
        out = np.empty(c.shape)
        out[0] = w0 * c[0] + along
        out[1] = c[1] + w1 * factor
        out[2] = c[2] + w2 * factor
        out *= self.eta
        return out

    def matrix(self) -> Array:
        """W itself, (3, 3, n, T)."""
        w0, w1, w2 = self.w * self.eta
        lean = self.w / (1.0 + self.w[0])
        return np.stack(
            [
                np.stack([w0, w1, w2]),
                np.stack([w1, self.eta + lean[1] * w1, lean[1] * w2]),
                np.stack([w2, lean[2] * w1, self.eta + lean[2] * w2]),
            ]
        )


class _Step:
    """Scaled Newton step and how long it may be, as multiples of itself, (T,)."""

    def __init__(
        self, y: Array, force: Array, slack: Array, g: Array, slack_g: Array, scaled: Array, scaled_g: Array
    ) -> None:
        self.y, self.force, self.slack, self.g, self.slack_g = y, force, slack, g, slack_g
        self.longest_force = np.minimum(_reach(scaled, force).min(axis=0), _ray(scaled_g, g))
        self.longest_slack = np.minimum(_reach(scaled, slack).min(axis=0), _ray(scaled_g, slack_g))

    def target(self, product: Array, scaled: Array, scaled_g: Array) -> Array:
        """Share of the complementarity that the corrector aims at (Mehrotra's rule), (T,)."""
        a, b = np.minimum(1.0, self.longest_force), np.minimum(1.0, self.longest_slack)
        left = ((scaled + a * self.force) * (scaled + b * self.slack)).sum(axis=(0, 1))
        left += (scaled_g + a * self.g) * (scaled_g + b * self.slack_g)
        return np.asarray((np.maximum(left, 0.0) / product) ** 3)


def _square(c: Array) -> Array:
    """c_0^2 - c_1^2 - c_2^2, positive inside the cone."""
    return np.asarray(c[0] ** 2 - c[1] ** 2 - c[2] ** 2)


def _ray(value: Array, step: Array) -> Array:
    """Longest step that keeps a positive value positive."""
    return np.where(step < 0.0, -value / step, np.inf)


def _reach(c: Array, d: Array) -> Array:
    """Largest a with c + a d in the cone, for c inside it, (n, T)."""
    square = _square(d)
    cross = c[0] * d[0] - c[1] * d[1] - c[2] * d[2]
    inside = np.maximum(_square(c), 0.0)
    root = np.sqrt(np.maximum(cross**2 - square * inside, 0.0))
    reach = np.where(cross < 0.0, inside / (root - cross), np.where(square < 0.0, (cross + root) / -square, np.inf))
    return np.where((square >= 0.0) & (d[0] >= 0.0), np.inf, reach)


def _divide(scaled: Array, target: Array, force: Array, slack: Array) -> Array:
    """Solution q of scaled o q = target e - scaled o scaled - force o slack, o the product of the cone's algebra."""
    c0, c1, c2 = scaled
    r0 = target - (scaled * scaled + force * slack).sum(axis=0)
    r1 = -2.0 * c0 * c1 - force[0] * slack[1] - force[1] * slack[0]
    r2 = -2.0 * c0 * c2 - force[0] * slack[2] - force[2] * slack[0]
    q0 = (c0 * r0 - c1 * r1 - c2 * r2) / _square(scaled)
    return np.stack([q0, (r1 - c1 * q0) / c0, (r2 - c2 * q0) / c0])


def _cholesky(matrix: Array) -> Array:
    """Lower Cholesky factor of symmetric matrices (d, d, T), in their place."""
    smallest = REGULAR * np.trace(matrix)
    for j in range(len(matrix)):
        pivot = np.sqrt(np.maximum(matrix[j, j], smallest))
        matrix[j, j] = pivot
        matrix[j + 1 :, j] /= pivot
        for k in range(j + 1, len(matrix)):
            matrix[k:, k] -= matrix[k:, j] * matrix[k, j]
    return matrix


def _solve(factor: Array, right: Array) -> Array:
    """Solution of L L^T x = right, (d, T)."""
    x = right.copy()
    for i in range(len(x)):
        x[i] /= factor[i, i]
        x[i + 1 :] -= factor[i + 1 :, i] * x[i]
    for i in reversed(range(len(x))):
        x[i] /= factor[i, i]
        x[:i] -= factor[i, :i] * x[i]
    return x
