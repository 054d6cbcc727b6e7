"""Bounds of the values of rows, compiled: few rows are evaluated, because most are known to hold.

|B_f| sum_k |W_gk| bounds the interval terms of a row, so its bound costs two products instead of one per term. Similar
rows are neighbours, so the least and the largest entries of a block of them bound them all, and few blocks are looked
into. Blocks of blocks are bounded likewise, up to a single one. Bounds change no result: they only tell which rows may
be violated.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from robustopt.arrays import Array, Indices
from robustopt.compiled import compiled, compiled_inner, merged
from robustopt.limits.row_values import own_part

BLOCK = 16
"""Rows that are bounded together, and blocks that are: a look at 15,000 facets is 80 bounds and the few blocks that may
bind."""


class Blocks(NamedTuple):
    """Blocks of rows, blocks of these blocks, and so on up to a single one; or a single block of all rows, not made.

    Block m of level 0 consists of K = `BLOCK` rows from K m on, and block m of another level of as many blocks of the
    level below; zeros stand for missing ones. The levels are stored one after the other.

    Attributes:
        made: whether the rows are in blocks.
        first: index of the first block of each level among all blocks (levels,); of a single level if not made.
        least: index of the least entries of these blocks among the entries (levels,).
        entries: least and largest entries of each block in turn, or only one of both if it consists of rows, (S, d, K).
        sizes: largest sizes of the entries of each block (M, d, K).
        reach: sum_k |W_gk| at (u, x), and the like of second moments and products, (G, d), or (0, d) for no intervals.
        fixed: part of the reach that depends on neither u nor x (P, G, d).
        own_reach: largest share of the interval terms in each row by itself (P, F, G), or (0, 0, 0) for none.
        weights: largest size of the factor of each column (C,).
        bounds: bounds of the blocks of a block, or of its rows, at each level (levels, K), or of all rows (1, F).
        value: work array (K,).
    """

    made: bool
    first: Indices
    least: Indices
    entries: Array
    sizes: Array
    reach: Array
    fixed: Array
    own_reach: Array
    weights: Array
    bounds: Array
    value: Array


def row_blocks(rows):
    """Return rows in blocks, if they are many, the same at all grid points, and have no own part."""
    (_, F, d), G = rows.B.shape, len(rows.lowest)
    made = rows.B.shape[0] == 1 and rows.base.shape[0] == 0 and F > BLOCK
    first, least, entries, sizes = _levels(rows.B[0] if made else np.zeros((0, d)))
    intervals = len(rows.group) > G or len(rows.constant_group)
    fixed, own_reach, weights = _reach(rows)
    return Blocks(
        made, first[:-1], least[:-1], entries, sizes, np.zeros((G if intervals else 0, d)), fixed, own_reach, weights,
        np.zeros((len(first) - 1, BLOCK) if made else (1, F)), np.zeros(BLOCK),
    )  # fmt: skip


def _levels(rows):
    """Return the indices of the first block and entries of each level and of one more, entries and sizes of all."""
    count, counts = len(rows), []
    while count > 1:
        count = -(-count // BLOCK)
        counts.append(count)
    first, least = np.cumsum([0, *counts]), np.cumsum([0, *counts[:1], *(2 * count for count in counts[1:])])
    entries, sizes = np.zeros((least[-1], rows.shape[1], BLOCK)), np.zeros((first[-1], rows.shape[1], BLOCK))
    _fill(len(rows), first, least, rows.copy(), rows.copy(), entries, sizes)
    return first, least, entries, sizes


@compiled(_nrt=False)
def _fill(count, first, least, low, high, entries, sizes):
    """Fill the levels of blocks; low and high hold the rows, and then the least and largest entries of each block."""
    for level in range(len(first) - 1):
        for r in range(count):
            m, k = r // BLOCK, r % BLOCK
            place = least[level] + (m if level == 0 else 2 * m)
            for j in range(low.shape[1]):
                a, b = low[r, j], high[r, j]
                entries[place, j, k], sizes[first[level] + m, j, k] = a, max(-a, b)
                if level > 0:
                    entries[place + 1, j, k] = b
                low[m, j], high[m, j] = (a, b) if k == 0 else (min(low[m, j], a), max(high[m, j], b))
        count = (count + BLOCK - 1) // BLOCK


def _reach(rows):
    """Return the parts of the reach that depend on neither u nor x, and the largest factors; see `Blocks`."""
    (P, d, C, _), G = rows.wrenches.shape, len(rows.lowest)
    weights = np.ones(C)
    six = rows.usual.reshape(-1, 6)
    largest = np.hstack([np.maximum(np.abs(six[:, :3]), np.abs(1.0 - six[:, :3])), 1.0 + np.abs(six[:, 3:])])
    weights[C - len(rows.usual) :] = largest.ravel()
    fixed, own_reach = np.zeros((P, G, d)), np.zeros((*rows.base_terms.shape[:2], G if len(rows.base_terms) else 0))
    for g in range(G):
        own = rows.constant_group == g
        fixed[:, g] = np.abs(rows.constant[:, :, own]).sum(axis=2)
        if len(rows.base_terms):
            own_reach[:, :, g] = np.abs(rows.base_terms[:, :, own]).sum(axis=2)
        if len(rows.changes):
            varying = np.flatnonzero(rows.group[G:] == g) + G
            fixed[:, g] += np.abs(rows.changes[:, :, varying]).sum(axis=3) @ weights[varying]
    return fixed, own_reach, weights


@merged
def find_reach(rows, i, wrenches, blocks):
    """Set the reach at grid point i and (u, x), whose wrenches have been found."""
    reach, fixed, weights = blocks.reach, blocks.fixed, blocks.weights
    for g in range(reach.shape[0]):
        for j in range(reach.shape[1]):
            reach[g, j] = fixed[i, g, j]
    for k in range(reach.shape[0], len(weights)):
        for j in range(reach.shape[1]):
            reach[rows.group[k], j] += abs(wrenches[k, j]) * weights[k]


@merged
def find_bounds(rows, b, i, u, x, wrenches, blocks, level, m):
    """Set the bounds of a level to those of the blocks or rows of its block m, at grid point i and (u, x)."""
    if blocks.made:
        upper = 1 if level > 0 else 0
        block_bounds(
            blocks.entries, blocks.sizes, blocks.least[level] + (1 + upper) * m, upper, blocks.first[level] + m,
            wrenches, blocks.reach, rows.lowest, rows.highest, blocks.bounds, level, blocks.value,
        )  # fmt: skip
    else:
        row_bounds(
            rows.B, b, rows.base, blocks.own_reach, i, u, x, wrenches, blocks.reach, rows.lowest, rows.highest,
            blocks.bounds,
        )  # fmt: skip


@compiled_inner(fastmath={"contract"}, forceinline=True)
def block_bounds(entries, sizes, least, upper, m, central, reach, lowest, highest, bounds, level, value):
    """Set bounds[level, k] to a bound of every row's value with entries from entries[least, :, k] on.

    The largest entries are entries[least + upper, :, k], and sizes[m, :, k] the largest sizes. For single rows the
    bound is their value, but for rounding, if only masses have intervals.
    """
    for k in range(BLOCK):
        bounds[level, k] = 0.0
    for g in range(len(lowest)):
        low, high = lowest[g], highest[g]
        if entries.shape[1] == 6:
            _set_six(entries, sizes, least, upper, m, central, reach, g, value)
        else:
            _set_any(entries, sizes, least, upper, m, central, reach, g, value)
        for k in range(BLOCK):
            bounds[level, k] += value[k] * (high if value[k] > 0.0 else low)


@compiled_inner(fastmath={"contract"}, forceinline=True)
def _set_six(entries, sizes, least, upper, m, central, reach, g, value):
    """Set the bounds for the bodies of group g per unit of mass, of rows with six entries: their products in one go."""
    w0, w1, w2 = central[g, 0], central[g, 1], central[g, 2]
    w3, w4, w5 = central[g, 3], central[g, 4], central[g, 5]
    e0, e1, e2 = least + upper * (w0 > 0.0), least + upper * (w1 > 0.0), least + upper * (w2 > 0.0)
    e3, e4, e5 = least + upper * (w3 > 0.0), least + upper * (w4 > 0.0), least + upper * (w5 > 0.0)
    if len(reach):
        r0, r1, r2, r3, r4, r5 = reach[g, 0], reach[g, 1], reach[g, 2], reach[g, 3], reach[g, 4], reach[g, 5]
        for k in range(BLOCK):
            v = w0 * entries[e0, 0, k] + w1 * entries[e1, 1, k] + w2 * entries[e2, 2, k]
            v += w3 * entries[e3, 3, k] + w4 * entries[e4, 4, k] + w5 * entries[e5, 5, k]
            v += r0 * sizes[m, 0, k] + r1 * sizes[m, 1, k] + r2 * sizes[m, 2, k]
            value[k] = v + r3 * sizes[m, 3, k] + r4 * sizes[m, 4, k] + r5 * sizes[m, 5, k]
    else:
        for k in range(BLOCK):
            v = w0 * entries[e0, 0, k] + w1 * entries[e1, 1, k] + w2 * entries[e2, 2, k]
            value[k] = v + w3 * entries[e3, 3, k] + w4 * entries[e4, 4, k] + w5 * entries[e5, 5, k]


@compiled_inner(fastmath={"contract"}, forceinline=True)
def _set_any(entries, sizes, least, upper, m, central, reach, g, value):
    """Set the bounds for the bodies of group g per unit of mass, of rows with any number of entries."""
    for k in range(BLOCK):
        value[k] = 0.0
    for j in range(entries.shape[1]):
        w = central[g, j]
        e = least + upper * (w > 0.0)
        for k in range(BLOCK):
            value[k] += w * entries[e, j, k]
        if len(reach):
            r = reach[g, j]
            for k in range(BLOCK):
                value[k] += r * sizes[m, j, k]


@compiled_inner(fastmath={"contract"}, forceinline=True)
def row_bounds(B, b, base, own_reach, i, u, x, central, reach, lowest, highest, bounds):
    """Set bounds[0, f] to a bound of the value of row B[b, f] at grid point i and (u, x).

    It is the value, but for rounding, if only masses have intervals.
    """
    for f in range(bounds.shape[1]):
        bounds[0, f] = own_part(base, i, f, u, x)
        for g in range(len(lowest)):
            v = own_reach[i, f, g] if len(own_reach) else 0.0
            if len(reach):
                for j in range(B.shape[2]):
                    v += B[b, f, j] * central[g, j] + abs(B[b, f, j]) * reach[g, j]
            else:
                for j in range(B.shape[2]):
                    v += B[b, f, j] * central[g, j]
            bounds[0, f] += v * (highest[g] if v > 0.0 else lowest[g])
