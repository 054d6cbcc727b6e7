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
from robustopt.compiled import compiled_inner, merged
from robustopt.limits.row_values import own_part

BLOCK = 16
"""Rows that are bounded together, and blocks that are: a look at 15,000 facets is 80 bounds and the few blocks that may
bind."""


class Blocks(NamedTuple):
    """Blocks of rows, blocks of these blocks, and so on up to a single one; or a single block of all rows, not made.

    Block m of a level consists of the K = `BLOCK` blocks of the next level, or rows, from K m on; zeros stand for
    missing ones. The levels are stored one after the other, the single block first.

    Attributes:
        made: whether the rows are in blocks.
        first: index of the first block of each level among all blocks (levels,); of a single level if not made.
        least: index of the least entries of these blocks among the entries (levels,).
        entries: least and largest entries of each block in turn, or only one of both if it consists of rows, (S, d, K).
        sizes: largest sizes of the entries of each block (M, d, K).
        reach: sum_k |W_gk| at (u, x), and the like of second moments and products, (G, d), or (0, d) for no intervals.
        fixed: part of the reach that depends on neither u nor x (G, d).
        own_reach: largest share of the interval terms in each row by itself (F, G), or (0, G) for none.
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
    bounds: Array
    value: Array


def row_blocks(family):
    """Return the rows of a family in blocks, if they are many, the same at all grid points, and have no own part."""
    B, wrench, base_terms = family.B, family.wrench, family.base_terms
    (_, F, d), G = B.shape, len(wrench.lowest)
    made = B.shape[0] == 1 and family.base.shape[0] == 0 and F > BLOCK
    levels = _levels(B[0]) if made else []
    counts = [len(lowest) for lowest, _ in levels]
    entries = [np.stack(level, axis=1).reshape(-1, d, BLOCK) for level in levels[:-1]] + [low for low, _ in levels[-1:]]
    sizes = [np.maximum(-low, high) for low, high in levels]
    intervals = len(wrench.group) + len(wrench.usual) + len(wrench.constant_group)
    return Blocks(
        made, np.cumsum([0, *counts[:-1]]), np.cumsum([0, *(2 * count for count in counts[:-1])]),
        np.concatenate([np.zeros((0, d, BLOCK)), *entries]), np.concatenate([np.zeros((0, d, BLOCK)), *sizes]),
        np.zeros((G if intervals else 0, d)), np.zeros((G, d)), np.zeros((F if len(base_terms) else 0, G)),
        np.zeros((len(levels), BLOCK) if made else (1, F)), np.zeros(BLOCK),
    )  # fmt: skip


def _levels(rows):
    """Return the least and the largest entries in the blocks of each level (M, d, K), the single block first."""
    low, high, levels = rows, rows, []
    while not levels or len(levels[0][0]) > 1:
        room = np.zeros((2, -(-len(low) // BLOCK) * BLOCK, rows.shape[1]))
        room[0, : len(low)], room[1, : len(low)] = low, high
        levels.insert(0, room.reshape(2, -1, BLOCK, rows.shape[1]).transpose(0, 1, 3, 2))
        starts = np.arange(0, len(low), BLOCK)
        low, high = np.minimum.reduceat(low, starts), np.maximum.reduceat(high, starts)
    return levels


@merged
def find_bounds(family, b, i, u, x, central, blocks, level, m):
    """Set the bounds of level `level` to those of the blocks or rows of its block m, at grid point i and (u, x).

    central: W_g0 at (u, x), (G, d)
    """
    lowest, highest = family.wrench.lowest, family.wrench.highest
    if blocks.made:
        last = level == len(blocks.first) - 1
        least, upper = (blocks.least[level] + m, 0) if last else (blocks.least[level] + 2 * m, 1)
        block_bounds(
            blocks.entries, blocks.sizes, least, upper, blocks.first[level] + m,
            central, blocks.reach, lowest, highest, blocks.bounds, level, blocks.value,
        )  # fmt: skip
    else:
        row_bounds(
            family.B, b, family.base, blocks.own_reach, i, u, x, central, blocks.reach, lowest, highest, blocks.bounds
        )


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
    for k in range(BLOCK):
        v = w0 * entries[e0, 0, k] + w1 * entries[e1, 1, k] + w2 * entries[e2, 2, k]
        value[k] = v + w3 * entries[e3, 3, k] + w4 * entries[e4, 4, k] + w5 * entries[e5, 5, k]
    if len(reach):
        r0, r1, r2, r3, r4, r5 = reach[g, 0], reach[g, 1], reach[g, 2], reach[g, 3], reach[g, 4], reach[g, 5]
        for k in range(BLOCK):
            v = r0 * sizes[m, 0, k] + r1 * sizes[m, 1, k] + r2 * sizes[m, 2, k]
            value[k] += v + r3 * sizes[m, 3, k] + r4 * sizes[m, 4, k] + r5 * sizes[m, 5, k]


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
            v = own_reach[f, g] if len(own_reach) else 0.0
            if len(reach):
                for j in range(B.shape[2]):
                    v += B[b, f, j] * central[g, j] + abs(B[b, f, j]) * reach[g, j]
            else:
                for j in range(B.shape[2]):
                    v += B[b, f, j] * central[g, j]
            bounds[0, f] += v * (highest[g] if v > 0.0 else lowest[g])
