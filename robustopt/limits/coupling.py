"""Columns of a family, and rows whose columns change with the acceleration error, at their worst, compiled.

The value of a row is a convex function of the acceleration error e, because it is a maximum over all other parameters
of functions that are linear in e. So its maximum is at a corner of the box of e, and with e at a corner all others
follow from signs. The corners are enumerated one error after the other, in the order of a Gray code (our choice). If
more than `MOST_ERRORS` coordinates have an error, those with the smallest effect on the columns are bounded one by one
instead.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from robustopt.arrays import Array, Flags, Indices
from robustopt.compiled import compiled_inner, merged

MOST_ERRORS = 8
"""Number of acceleration errors whose corners are enumerated: 256 corners."""


class Columns(NamedTuple):
    """A family as the compiled functions take it: C columns are the G nominal wrenches, n terms and 6 m moments.

    Attributes:
        B: coefficients of the load (1, F, d) or (P, F, d).
        base: affine part of each row that does not depend on the load (P, F, 3), or (0, 0, 3).
        base_terms: contribution of each constant interval term to a row beside its load (P, F, n_c), or (0, 0, 0).
        wrenches: the columns, coefficients of (u, x, 1) last (P, d, C, 3).
        group: group of each column (C,).
        changes: change of each column by each acceleration error (P, d, C, E); E = 0 if no column but the nominal
            wrench of a single group changes.
        constant: interval terms that depend on neither u nor x (P, d, n_c), first the changes of nominal wrenches.
        constant_group: group of each of them (n_c,).
        usual: nominal second moments (6 m,).
        round: whether the first two axes of each body are those of a disc (m,).
        lowest: smallest mass factor of each group (G,).
        highest: largest mass factor of each group (G,).
    """

    B: Array
    base: Array
    base_terms: Array
    wrenches: Array
    group: Indices
    changes: Array
    constant: Array
    constant_group: Indices
    usual: Array
    round: Flags
    lowest: Array
    highest: Array


class RowWork(NamedTuple):
    """Work arrays for the values of rows.

    Attributes:
        wrenches: the columns at (u, x), (C, d).
        products: a row times each column, nominal ones with everything constant, (C,).
        values: values of the groups (G,).
        margins: bound of the share of the constant interval terms and changes in each row (F, G).
        known: grid point that the margins of each row are of (F,).
        factors: worst factor of each column: 1, signs, second moments less the usual ones (C,).
        fixed: share of the acceleration error, at its worst, and of other constants in a row (G,).
        changes: change of the products by each acceleration error (C, E).
        central: products of the nominal wrenches without acceleration errors (G,).
        chosen: acceleration errors in the order of their effect (E,).
        effect: size of the effect of each error (E,).
        error: current error (E,).
        goal: error to go to (E,).
        worst: worst error found so far (E,).
        both: changes of the second moments of a body by an error, and by its opposite (12,).
    """

    wrenches: Array
    products: Array
    values: Array
    margins: Array
    known: Indices
    factors: Array
    fixed: Array
    changes: Array
    central: Array
    chosen: Indices
    effect: Array
    error: Array
    goal: Array
    worst: Array
    both: Array


def columns_of(family):
    """Return a family as the compiled functions take it."""
    wrench = family.wrench
    (P, d, G, _), (_, _, K, E) = wrench.nominal.shape, wrench.products.shape
    if E and (K or G > 1):
        shaken = wrench.constant[:, :, : G * E].reshape(P, d, G, E)
        changes = np.concatenate([shaken, wrench.products], axis=2)
    else:
        changes = np.zeros((0, 0, 0, 0))
    wrenches = np.concatenate([wrench.nominal, wrench.terms, wrench.moments], axis=2) if K else wrench.nominal
    return Columns(
        family.B, family.base, family.base_terms, np.ascontiguousarray(wrenches),
        np.concatenate([np.arange(G), wrench.group, np.repeat(wrench.moment_group, 6)]), changes,
        wrench.constant, wrench.constant_group, wrench.usual, wrench.round, wrench.lowest, wrench.highest,
    )  # fmt: skip


def row_work(rows):
    """Return the work arrays for the values of some rows."""
    (_, F, d), C, G, E = rows.B.shape, len(rows.group), len(rows.lowest), rows.changes.shape[3]
    return RowWork(
        np.zeros((C, d)), np.zeros(C), np.zeros(G), np.zeros((F, G)), np.full(F, -1), np.ones(C), np.zeros(G),
        np.zeros((C, E)), np.zeros(G), np.zeros(E, np.int64), np.zeros(E), np.zeros(E), np.zeros(E), np.zeros(E),
        np.zeros(12),
    )  # fmt: skip


@merged
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


@compiled_inner()
def _find_moments(y, first, usual, m, is_round, weights):
    """Set weights[first : first + 6] to the moments of body m at which `support` has its value, less the usual ones."""
    rx, ry, rz = _shares(y, first)
    along_x = 1.0 if rx > 0.0 and not (is_round and rx < ry) else 0.0
    along_y = 1.0 if ry > 0.0 and not (is_round and rx >= ry) else 0.0
    along_z = 1.0 if rz > 0.0 else 0.0
    weights[first], weights[first + 1], weights[first + 2] = along_x, along_y, along_z
    weights[first + 3], weights[first + 4] = 0.5 * (along_x + along_y), 0.5 * (along_x + along_z)
    weights[first + 5] = 0.5 * (along_y + along_z)
    for q in range(6):
        weight = weights[first + q]
        weights[first + q] = (-weight if q > 2 and not y[first + q] >= 0.0 else weight) - usual[6 * m + q]


@merged
def value_of(products, group, usual, is_round, lowest, highest, values, total):
    """Return a total plus the value of a row for its products with the columns; set the values of the groups."""
    G = len(values)
    terms = len(group) - len(usual)
    for g in range(G):
        values[g] = products[g]
    for k in range(G, terms):
        values[group[k]] += abs(products[k])
    for m in range(len(is_round)):
        values[group[terms + 6 * m]] += support(products, terms + 6 * m, usual, m, is_round[m])
    for g in range(G):
        total += values[g] * (highest[g] if values[g] > 0.0 else lowest[g])
    return total


@merged
def find_factors(rows, work):
    """Set the factors of interval terms and second moments to the worst for the products of a row."""
    products, factors, G = work.products, work.factors, len(rows.lowest)
    terms = len(factors) - len(rows.usual)
    for k in range(G, terms):
        factors[k] = -1.0 if products[k] < 0.0 else 1.0
    for m in range(len(rows.round)):
        _find_moments(products, terms + 6 * m, rows.usual, m, rows.round[m], factors)


@merged
def find_changes(rows, b, f, i, out):
    """Set out (C, E) to the change of the product of row B[b, f] with each column, by each acceleration error."""
    B, changes, base_terms, G = rows.B, rows.changes, rows.base_terms, len(rows.lowest)
    for k in range(out.shape[0]):
        for e in range(out.shape[1]):
            out[k, e] = 0.0
    for j in range(B.shape[2]):
        weight = B[b, f, j]
        if weight != 0.0:
            for k in range(out.shape[0]):
                for e in range(out.shape[1]):
                    out[k, e] += weight * changes[i, j, k, e]
    if base_terms.shape[0]:
        for g in range(G):
            for e in range(out.shape[1]):
                out[g, e] += base_terms[i, f, g * out.shape[1] + e]


@compiled_inner()
def add_largest_changes(changes, e, G, group, usual, is_round, both, out):
    """Add to out (G,) how much the interval terms and second moments of each group can grow by error e alone.

    both: work array (12,)
    """
    terms = len(group) - len(usual)
    for k in range(G, terms):
        out[group[k]] += abs(changes[k, e])
    for m in range(len(is_round)):
        most = -np.inf
        for q in range(6):
            both[q] = changes[terms + 6 * m + q, e]
            both[6 + q] = -both[q]
        for sign in range(2):
            most = max(most, support(both, 6 * sign, usual, m, is_round[m]))
        out[group[terms + 6 * m]] += most


@compiled_inner()
def exact_value(rows, b, f, i, work):
    """Set factors and fixed to the worst for row B[b, f] at grid point i, and return its value without its own part.

    The wrenches at (u, x) have been found.
    """
    find_changes(rows, b, f, i, work.changes)
    _find_products(rows, b, f, i, work)
    count = _choose_errors(rows, work)
    chosen, goal, worst, largest, value = work.chosen, work.goal, work.worst, 0.0, 0.0
    for e in range(len(goal)):
        goal[e] = work.error[e] = worst[e] = 0.0
    corners = 1 << count
    for step in range(corners + 1):
        if step == 0:
            for k in range(count):
                goal[chosen[k]] = 1.0
        elif step < corners:
            k = 0
            while not (step >> k) & 1:
                k += 1
            goal[chosen[k]] = -goal[chosen[k]]
        else:  # back to the worst corner
            for k in range(count):
                goal[chosen[k]] = worst[chosen[k]]
        _go_to_goal(count, work)
        value = value_of(work.products, rows.group, rows.usual, rows.round, rows.lowest, rows.highest, work.values, 0.0)
        if step == 0 or (step < corners and value > largest):
            largest = value
            for k in range(count):
                worst[chosen[k]] = goal[chosen[k]]
    find_factors(rows, work)
    _find_fixed(rows.group, work)
    return value


@merged
def _find_products(rows, b, f, i, work):
    """Set the products of a row without acceleration errors, but with the other constants."""
    B, wrenches, products, E = rows.B, work.wrenches, work.products, rows.changes.shape[3]
    for k in range(len(products)):
        product = 0.0
        for j in range(B.shape[2]):
            product += B[b, f, j] * wrenches[k, j]
        products[k] = product
    for g in range(len(work.central)):
        work.central[g] = products[g]
    for k in range(len(rows.lowest) * E, len(rows.constant_group)):
        product = rows.base_terms[i, f, k] if rows.base_terms.shape[0] else 0.0
        for j in range(B.shape[2]):
            product += B[b, f, j] * rows.constant[i, j, k]
        products[rows.constant_group[k]] += abs(product)


@merged
def _choose_errors(rows, work):
    """Choose the errors to enumerate, add the effect of the others to the products, and return how many are chosen."""
    chosen, effect, changes = work.chosen, work.effect, work.changes
    G, E = len(rows.lowest), len(effect)
    for e in range(E):
        chosen[e] = e
        effect[e] = 0.0
        for k in range(0 if G > 1 else 1, len(changes)):
            effect[e] += abs(changes[k, e])
    count = min(E, MOST_ERRORS)
    for k in range(count if count < E else 0):  # the largest effects come first
        for e in range(k + 1, E):
            if effect[chosen[e]] > effect[chosen[k]]:
                chosen[k], chosen[e] = chosen[e], chosen[k]
    for k in range(count, E):
        for g in range(G):
            work.products[g] += abs(changes[g, chosen[k]])
        add_largest_changes(changes, chosen[k], G, rows.group, rows.usual, rows.round, work.both, work.products)
    return count


@merged
def _go_to_goal(count, work):
    """Change the enumerated errors, and the products with them, to the goal."""
    error, changes, products = work.error, work.changes, work.products
    for c in range(count):
        e = work.chosen[c]
        change = work.goal[e] - error[e]
        if change != 0.0:
            error[e] += change
            for k in range(len(products)):
                products[k] += change * changes[k, e]


@merged
def _find_fixed(group, work):
    """Set the share of the current error and of other constants in a row, for factors that were found."""
    fixed, products, changes, factors, error = work.fixed, work.products, work.changes, work.factors, work.error
    G = len(fixed)
    for g in range(G):
        fixed[g] = products[g] - work.central[g]
    for k in range(G, len(products)):
        for e in range(len(error)):
            fixed[group[k]] += factors[k] * error[e] * changes[k, e]
