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
from robustopt.compiled import compiled, compiled_inner

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
    worst: Array
    both: Array


@compiled()
def coupled_work(wrench):
    """Return the work arrays for the rows over some required wrenches."""
    G, E, K = len(wrench.lowest), wrench.products.shape[3], wrench.products.shape[2]
    return Coupled(
        np.zeros(K), np.zeros((K, E)), np.zeros((G, E)), np.zeros(G), np.zeros(G), np.zeros(G), np.zeros(E, np.int64),
        np.zeros(E), np.zeros(E), np.zeros(E), np.zeros(12),
    )  # fmt: skip


@compiled_inner(forceinline=True)
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


@compiled_inner(forceinline=True)
def _shares(y, first):
    """Return the coefficients of T_xx, T_yy and T_zz if every T_ab is half their sum, with the sign of its own."""
    xy, xz, yz = 0.5 * abs(y[first + 3]), 0.5 * abs(y[first + 4]), 0.5 * abs(y[first + 5])
    return y[first] + xy + xz, y[first + 1] + xy + yz, y[first + 2] + xz + yz


@compiled_inner(forceinline=True)
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


@compiled_inner()
def find_product_bounds(family, b, f, i, work):
    """Add to the margins of row B[b, f] at grid point i how much its terms can grow by each acceleration error."""
    _find_row(family, b, f, i, work)
    here = work.coupled
    here.rest[:] = 0.0
    for e in range(len(here.error)):
        add_product_bounds(family.wrench, here, e, here.rest)
    for g in range(len(here.rest)):
        work.margins[f, g] += here.rest[g]


@compiled_inner()
def coupled_value(family, b, f, i, work):
    """Set signs, weights and fixed of a `RowWork` to the worst for row B[b, f] at grid point i, and return its value.

    The wrenches at (u, x) have been found; the affine part of the row is not added.
    """
    wrench, here = family.wrench, work.coupled
    n, K, E = len(wrench.group), wrench.products.shape[2], wrench.products.shape[3]
    _find_row(family, b, f, i, work)
    count = _choose_errors(wrench, here)
    for e in range(E):
        here.error[e] = here.worst[e] = 0.0
    for k in range(count):
        _step(here, here.chosen[k], 1.0, K)
    largest = _value(wrench, here, n)
    _copy(here.error, here.worst)
    for step in range(1, 1 << count):
        k = 0
        while not (step >> k) & 1:
            k += 1
        e = here.chosen[k]
        _step(here, e, -2.0 * here.error[e], K)
        value = _value(wrench, here, n)
        if value > largest:
            largest = value
            _copy(here.error, here.worst)
    for k in range(count):
        e = here.chosen[k]
        _step(here, e, here.worst[e] - here.error[e], K)
    largest = _value(wrench, here, n)
    _set_worst(wrench, here, n, work)
    return largest


@compiled_inner()
def _find_row(family, b, f, i, work):
    """Set terms, products, own and rest of a row without acceleration errors."""
    B, wrench, base_terms, here = family.B, family.wrench, family.base_terms, work.coupled
    n, (_, d, K, E) = len(wrench.group), wrench.products.shape
    G = len(wrench.lowest)
    here.central[:] = 0.0
    here.terms[:] = 0.0
    here.products[:] = 0.0
    here.own[:] = 0.0
    for j in range(d):
        weight = B[b, f, j]
        if weight == 0.0:
            continue
        for k in range(K):
            here.terms[k] += weight * (work.swings[k, j] if k < n else work.moments[k - n, j])
            for e in range(E):
                here.products[k, e] += weight * wrench.products[i, j, k, e]
        for g in range(G):
            here.central[g] += weight * work.central[g, j]
            for e in range(E):
                here.own[g, e] += weight * wrench.constant[i, j, g * E + e]
    _copy(here.central, here.rest)
    if base_terms.shape[0]:
        for g in range(G):
            for e in range(E):
                here.own[g, e] += base_terms[i, f, g * E + e]
    for k in range(G * E, len(wrench.constant_group)):
        product = base_terms[i, f, k] if base_terms.shape[0] else 0.0
        for j in range(d):
            product += B[b, f, j] * wrench.constant[i, j, k]
        here.rest[wrench.constant_group[k]] += abs(product)


@compiled_inner()
def _choose_errors(wrench, here):
    """Choose the errors to enumerate, bound the effect of the others in `rest`, and return how many are chosen."""
    G, (_, _, K, E) = len(wrench.lowest), wrench.products.shape
    for e in range(E):
        here.chosen[e] = e
        here.effect[e] = 0.0
        for k in range(K):
            here.effect[e] += abs(here.products[k, e])
        if G > 1:
            for g in range(G):
                here.effect[e] += abs(here.own[g, e])
    if E <= MOST_ERRORS:
        return E
    for k in range(MOST_ERRORS):  # the largest effects come first
        for e in range(k + 1, E):
            if here.effect[here.chosen[e]] > here.effect[here.chosen[k]]:
                here.chosen[k], here.chosen[e] = here.chosen[e], here.chosen[k]
    for k in range(MOST_ERRORS, E):
        for g in range(G):
            here.rest[g] += abs(here.own[g, here.chosen[k]])
        add_product_bounds(wrench, here, here.chosen[k], here.rest)
    return MOST_ERRORS


@compiled_inner()
def add_product_bounds(wrench, here, e, out):
    """Add to out (G,) how much the terms and second moments of each group can grow by error e alone."""
    n, products = len(wrench.group), here.products
    for k in range(n):
        out[wrench.group[k]] += abs(products[k, e])
    for m in range(len(wrench.moment_group)):
        for sign in range(2):
            for q in range(6):
                here.both[6 * sign + q] = (1 - 2 * sign) * products[n + 6 * m + q, e]
        more = support(here.both, 0, wrench.usual, m, wrench.round[m])
        less = support(here.both, 6, wrench.usual, m, wrench.round[m])
        out[wrench.moment_group[m]] += max(more, less)


@compiled_inner(forceinline=True)
def _copy(source, target):
    for k in range(len(source)):
        target[k] = source[k]


@compiled_inner(forceinline=True)
def _step(here, e, change, K):
    """Change error e, and all that depends on it except for the values of the groups."""
    here.error[e] += change
    for k in range(K):
        here.terms[k] += change * here.products[k, e]
    for g in range(len(here.rest)):
        here.rest[g] += change * here.own[g, e]


@compiled_inner(forceinline=True)
def _value(wrench, here, n):
    """Return the value of the row at the current error, and set those of its groups."""
    values, terms = here.values, here.terms
    _copy(here.rest, values)
    for k in range(n):
        values[wrench.group[k]] += abs(terms[k])
    for m in range(len(wrench.moment_group)):
        values[wrench.moment_group[m]] += support(terms, n + 6 * m, wrench.usual, m, wrench.round[m])
    total = 0.0
    for g in range(len(values)):
        total += values[g] * (wrench.highest[g] if values[g] > 0.0 else wrench.lowest[g])
    return total


@compiled_inner()
def _set_worst(wrench, here, n, work):
    """Set signs, weights and fixed of a `RowWork` to those at the current error."""
    terms, products = here.terms, here.products
    for g in range(len(work.fixed)):
        work.fixed[g] = here.rest[g] - here.central[g]
    for k in range(n):
        work.signs[k] = -1.0 if terms[k] < 0.0 else 1.0
    for m in range(len(wrench.moment_group)):
        set_moments(terms, n + 6 * m, wrench.usual, m, wrench.round[m], work.weights)
    for k in range(len(terms)):
        weight = work.signs[k] if k < n else work.weights[k - n]
        g = wrench.group[k] if k < n else wrench.moment_group[(k - n) // 6]
        for e in range(len(here.error)):
            work.fixed[g] += weight * here.error[e] * products[k, e]
