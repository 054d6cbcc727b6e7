"""Rows whose interval terms and second moments depend on the acceleration error, at their worst, compiled.

The value of a row is a convex function of the acceleration error e, because it is a maximum over all other parameters
of functions that are linear in e. So its maximum is at a corner of the box of e, and with e at a corner all others
follow from signs. The corners are enumerated one error after the other, in the order of a Gray code (our choice). If
more than `MOST_ERRORS` coordinates have an error, those with the smallest effect on terms and moments are bounded one
by one instead.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from robustopt.arrays import Array, Indices
from robustopt.compiled import compiled_inner, merged

MOST_ERRORS = 8
"""Number of acceleration errors whose corners are enumerated: 256 corners."""


class Coupled(NamedTuple):
    """Work arrays for one row at one grid point and (u, x).

    Attributes:
        terms: value of each interval term, then of each second moment, at the current error (K,).
        products: their change per error (K, E).
        own: value of the nominal wrench of each group per error (G, E).
        central: values of the nominal wrenches of the groups without errors (G,).
        rest: these values with the current error and all constants (G,).
        values: values of the groups at the current error (G,).
        chosen: enumerated errors, the ones with the largest effect (E,).
        effect: size of the effect of each error (E,).
        error: current error (E,).
        goal: error to go to (E,).
        worst: worst error found so far (E,).
        both: changes of the second moments of a body by an error, and by its opposite (12,).
    """

    terms: Array
    products: Array
    own: Array
    central: Array
    rest: Array
    values: Array
    chosen: Indices
    effect: Array
    error: Array
    goal: Array
    worst: Array
    both: Array


def coupled_work(wrench):
    """Return the work arrays for the rows over some required wrenches."""
    G, (_, _, K, E) = len(wrench.lowest), wrench.products.shape
    return Coupled(
        np.zeros(K), np.zeros((K, E)), np.zeros((G, E)), np.zeros(G), np.zeros(G), np.zeros(G), np.zeros(E, np.int64),
        np.zeros(E), np.zeros(E), np.zeros(E), np.zeros(E), np.zeros(12),
    )  # fmt: skip


@merged
def is_coupled(wrench):
    """Return whether anything but the nominal wrench of a single group depends on an acceleration error."""
    return wrench.products.shape[3] > 0 and (wrench.products.shape[2] > 0 or len(wrench.lowest) > 1)


@compiled_inner(forceinline=True)
def support(y, first, usual, m, is_round):
    """Return the largest sum of y[first : first + 6] times the second moments of body m less the usual ones."""
    rx, ry, rz = _shares(y, first)
    central = 0.0
    for q in range(6):
        central += usual[6 * m + q] * y[first + q]
    plane = max(0.0, rx, ry) if is_round else max(0.0, rx) + max(0.0, ry)
    return plane + max(0.0, rz) - central


@merged
def _shares(y, first):
    """Return the coefficients of T_xx, T_yy and T_zz if every T_ab is half their sum, with the sign of its own."""
    xy, xz, yz = 0.5 * abs(y[first + 3]), 0.5 * abs(y[first + 4]), 0.5 * abs(y[first + 5])
    return y[first] + xy + xz, y[first + 1] + xy + yz, y[first + 2] + xz + yz


@merged
def largest_weight(usual, q):
    """Return the largest size of second moment q of all bodies less its usual value."""
    return 1.0 + abs(usual[q]) if q % 6 > 2 else max(abs(usual[q]), abs(1.0 - usual[q]))


@compiled_inner()
def set_moments(y, first, usual, m, is_round, weights):
    """Set weights[6 m : 6 m + 6] to the second moments at which `support` has its value, less the usual ones."""
    rx, ry, rz = _shares(y, first)
    along_x = 1.0 if rx > 0.0 and not (is_round and rx < ry) else 0.0
    along_y = 1.0 if ry > 0.0 and not (is_round and rx >= ry) else 0.0
    along_z = 1.0 if rz > 0.0 else 0.0
    weights[6 * m], weights[6 * m + 1], weights[6 * m + 2] = along_x, along_y, along_z
    weights[6 * m + 3] = 0.5 * (along_x + along_y) * (1.0 if y[first + 3] >= 0.0 else -1.0)
    weights[6 * m + 4] = 0.5 * (along_x + along_z) * (1.0 if y[first + 4] >= 0.0 else -1.0)
    weights[6 * m + 5] = 0.5 * (along_y + along_z) * (1.0 if y[first + 5] >= 0.0 else -1.0)
    for q in range(6):
        weights[6 * m + q] -= usual[6 * m + q]


@merged
def add_all_product_bounds(B, b, f, i, wrench, here, out):
    """Add to out (F, G) how much the terms of row B[b, f] at grid point i can grow by each acceleration error."""
    _find_products(B, b, f, i, wrench, here)
    rest = here.rest
    _fill(rest, 0.0)
    for e in range(len(here.error)):
        _add_product_bounds(
            here.products, e, wrench.group, wrench.moment_group, wrench.usual, wrench.round, here.both, rest
        )
    for g in range(len(rest)):
        out[f, g] += rest[g]


@compiled_inner()
def coupled_value(B, base_terms, wrench, b, f, i, work):
    """Set signs, weights and fixed of a `RowWork` to the worst for row B[b, f] at grid point i, and return its value.

    The wrenches at (u, x) have been found; the affine part of the row is not added.
    """
    here = work.coupled
    _find_products(B, b, f, i, wrench, here)
    _find_row(B, base_terms, b, f, i, wrench, work, here)
    count = _choose_errors(wrench, here)
    goal, worst, largest, value = here.goal, here.worst, 0.0, 0.0
    _fill(here.error, 0.0)
    _fill(goal, 0.0)
    corners = 1 << count
    for step in range(corners + 1):  # at last back to the worst corner
        if step == 0:
            for k in range(count):
                goal[here.chosen[k]] = 1.0
        elif step < corners:
            k = 0
            while not (step >> k) & 1:
                k += 1
            goal[here.chosen[k]] = -goal[here.chosen[k]]
        else:
            _copy(worst, goal)
        value = _value_at_goal(wrench, here, count)
        if step == 0 or (step < corners and value > largest):
            largest = value
            _copy(goal, worst)
    _set_worst(wrench, here, work)
    return value


@merged
def _find_products(B, b, f, i, wrench, here):
    """Set the products of row B[b, f] at grid point i."""
    found, products = here.products, wrench.products
    for k in range(products.shape[2]):
        for e in range(products.shape[3]):
            found[k, e] = 0.0
    for j in range(products.shape[1]):
        weight = B[b, f, j]
        if weight != 0.0:
            for k in range(products.shape[2]):
                for e in range(products.shape[3]):
                    found[k, e] += weight * products[i, j, k, e]


@merged
def _find_row(B, base_terms, b, f, i, wrench, work, here):
    """Set terms, own and rest of a row without acceleration errors."""
    n, K, G, E = len(wrench.group), len(here.terms), len(here.central), len(here.error)
    terms, central, rest, own = here.terms, here.central, here.rest, here.own
    _fill(terms, 0.0)
    for g in range(G):
        central[g] = 0.0
        for e in range(E):
            own[g, e] = 0.0
    for j in range(B.shape[2]):
        weight = B[b, f, j]
        if weight == 0.0:
            continue
        for k in range(K):
            terms[k] += weight * (work.swings[k, j] if k < n else work.moments[k - n, j])
        for g in range(G):
            central[g] += weight * work.central[g, j]
            for e in range(E):
                own[g, e] += weight * wrench.constant[i, j, g * E + e]
    _copy(central, rest)
    if base_terms.shape[0]:
        for g in range(G):
            for e in range(E):
                own[g, e] += base_terms[i, f, g * E + e]
    for k in range(G * E, len(wrench.constant_group)):
        product = base_terms[i, f, k] if base_terms.shape[0] else 0.0
        for j in range(B.shape[2]):
            product += B[b, f, j] * wrench.constant[i, j, k]
        rest[wrench.constant_group[k]] += abs(product)


@merged
def _choose_errors(wrench, here):
    """Choose the errors to enumerate, bound the effect of the others in `rest`, and return how many are chosen."""
    chosen, effect, products, own, rest = here.chosen, here.effect, here.products, here.own, here.rest
    K, E, G = len(here.terms), len(here.error), len(rest)
    for e in range(E):
        chosen[e] = e
        effect[e] = 0.0
        for k in range(K):
            effect[e] += abs(products[k, e])
        if G > 1:
            for g in range(G):
                effect[e] += abs(own[g, e])
    if E <= MOST_ERRORS:
        return E
    for k in range(MOST_ERRORS):  # the largest effects come first
        for e in range(k + 1, E):
            if effect[chosen[e]] > effect[chosen[k]]:
                chosen[k], chosen[e] = chosen[e], chosen[k]
    for k in range(MOST_ERRORS, E):
        e = chosen[k]
        for g in range(G):
            rest[g] += abs(own[g, e])
        _add_product_bounds(products, e, wrench.group, wrench.moment_group, wrench.usual, wrench.round, here.both, rest)
    return MOST_ERRORS


@compiled_inner()
def _add_product_bounds(products, e, group, moment_group, usual, is_round, both, out):
    """Add to out (G,) how much the terms and second moments of each group can grow by error e alone.

    both: work array (12,)
    """
    n = len(group)
    for k in range(n):
        out[group[k]] += abs(products[k, e])
    for m in range(len(moment_group)):
        for q in range(6):
            both[q] = products[n + 6 * m + q, e]
            both[6 + q] = -products[n + 6 * m + q, e]
        most = -np.inf
        for sign in range(2):
            most = max(most, support(both, 6 * sign, usual, m, is_round[m]))
        out[moment_group[m]] += most


@merged
def _fill(values, value):
    for k in range(len(values)):
        values[k] = value


@merged
def _copy(source, target):
    for k in range(len(source)):
        target[k] = source[k]


@merged
def _value_at_goal(wrench, here, count):
    """Go to the error that is the goal, and return the value of the row there; so many errors are enumerated."""
    error, goal, terms, products, own, rest = here.error, here.goal, here.terms, here.products, here.own, here.rest
    values, group, moment_group = here.values, wrench.group, wrench.moment_group
    for c in range(count):
        e = here.chosen[c]
        change = goal[e] - error[e]
        if change != 0.0:
            error[e] += change
            for k in range(len(terms)):
                terms[k] += change * products[k, e]
            for g in range(len(rest)):
                rest[g] += change * own[g, e]
    _copy(rest, values)
    for k in range(len(group)):
        values[group[k]] += abs(terms[k])
    for m in range(len(moment_group)):
        first = len(group) + 6 * m
        values[moment_group[m]] += support(terms, first, wrench.usual, m, wrench.round[m])
    total = 0.0
    for g in range(len(values)):
        total += values[g] * (wrench.highest[g] if values[g] > 0.0 else wrench.lowest[g])
    return total


@merged
def _set_worst(wrench, here, work):
    """Set signs, weights and fixed of a `RowWork` to those at the current error."""
    terms, products, fixed, signs, weights = here.terms, here.products, work.fixed, work.signs, work.weights
    n = len(wrench.group)
    for g in range(len(fixed)):
        fixed[g] = here.rest[g] - here.central[g]
    for k in range(n):
        signs[k] = -1.0 if terms[k] < 0.0 else 1.0
    for m in range(len(wrench.moment_group)):
        set_moments(terms, n + 6 * m, wrench.usual, m, wrench.round[m], weights)
    for k in range(len(terms)):
        weight = signs[k] if k < n else weights[k - n]
        g = wrench.group[k] if k < n else wrench.moment_group[(k - n) // 6]
        for e in range(len(here.error)):
            fixed[g] += weight * here.error[e] * products[k, e]
