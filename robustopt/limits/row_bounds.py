"""Bounds of the values of rows, compiled: few rows are evaluated, because most are known to hold.

|B_f| sum_k |W_gk| bounds the interval terms of a row, so its bound costs two products instead of one per term. Similar
rows are neighbours, so the least and the largest entries of a block of them bound them all, and few blocks are looked
into. Blocks of blocks are bounded likewise. Bounds change no result: they only tell which rows may be violated.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from robustopt.arrays import Array
from robustopt.compiled import compiled, compiled_inner
from robustopt.limits.row_values import own_part

BLOCK = 16
"""Rows that are bounded together, and blocks that are: a look at 15,000 facets is 58 bounds and the few blocks that may
bind."""


class Blocks(NamedTuple):
    """Rows in blocks of K rows, L parts of K blocks, and room for bounds; or a single block of all rows, not made.

    Attributes:
        made: whether the rows are in blocks.
        entries: rows block by block, padded with zeros (L K, 1, d, K).
        sizes: sizes of the entries (L K, d, K).
        extremes: least and largest entries of each block, part by part (L, 2, d, K).
        extreme_sizes: largest sizes of each block (L, d, K).
        outermost: least and largest entries of each part (1, 2, d, L).
        outermost_sizes: largest sizes of each part (1, d, L).
        reach: sum_k |W_gk| at (u, x), and the like of second moments and products, (G, d), or (0, d) for no intervals.
        fixed: part of the reach that depends on neither u nor x (G, d).
        own_reach: largest share of the interval terms in each row by itself (F, G), or (0, G) for none.
        of_parts: bounds of the parts (L,); infinite for the single one.
        of_blocks: bounds of the blocks of a part (K,); infinite for the single one.
        of_rows: bounds of the rows of a block (K,).
        value: work array (max(K, L),).
    """

    made: bool
    entries: Array
    sizes: Array
    extremes: Array
    extreme_sizes: Array
    outermost: Array
    outermost_sizes: Array
    reach: Array
    fixed: Array
    own_reach: Array
    of_parts: Array
    of_blocks: Array
    of_rows: Array
    value: Array


@compiled()
def row_blocks(family):
    """Return the rows of a family in blocks, if they are many, the same at all grid points, and have no own part."""
    B, wrench, base_terms = family.B, family.wrench, family.base_terms
    (_, F, d), G = B.shape, len(wrench.lowest)
    made = B.shape[0] == 1 and family.base.shape[0] == 0 and F > BLOCK
    K, L = (BLOCK, (F + BLOCK * BLOCK - 1) // (BLOCK * BLOCK)) if made else (F, 1)
    M = L * BLOCK if made else 1
    intervals = len(wrench.group) + len(wrench.usual) + len(wrench.constant_group)
    entries, sizes = np.zeros((M, 1, d, BLOCK)), np.zeros((M, d, BLOCK))
    extremes, extreme_sizes = np.zeros((L, 2, d, BLOCK)), np.zeros((L, d, BLOCK))
    outermost, outermost_sizes = np.zeros((1, 2, d, L)), np.zeros((1, d, L))
    if made:
        _fill(B, entries, sizes, extremes, extreme_sizes)
        _fill_outermost(extremes, outermost, outermost_sizes)
    return Blocks(
        made, entries, sizes, extremes, extreme_sizes, outermost, outermost_sizes,
        np.zeros((G if intervals else 0, d)), np.zeros((G, d)), np.zeros((F if len(base_terms) else 0, G)),
        np.full(L, np.inf), np.full(BLOCK if made else 1, np.inf), np.zeros(K), np.zeros(max(K, L)),
    )  # fmt: skip


@compiled_inner()
def _fill(B, entries, sizes, extremes, extreme_sizes):
    F = B.shape[1]
    for m in range((F + BLOCK - 1) // BLOCK):
        part, k = m // BLOCK, m % BLOCK
        for j in range(B.shape[2]):
            low = high = B[0, m * BLOCK, j]
            for r in range(min(BLOCK, F - m * BLOCK)):
                entry = B[0, m * BLOCK + r, j]
                entries[m, 0, j, r], sizes[m, j, r] = entry, abs(entry)
                low, high = min(low, entry), max(high, entry)
            extremes[part, 0, j, k], extremes[part, 1, j, k], extreme_sizes[part, j, k] = low, high, max(-low, high)


@compiled_inner()
def _fill_outermost(extremes, outermost, outermost_sizes):
    for part in range(len(extremes)):
        for j in range(extremes.shape[2]):
            low, high = extremes[part, 0, j, 0], extremes[part, 1, j, 0]
            for k in range(1, BLOCK):
                low, high = min(low, extremes[part, 0, j, k]), max(high, extremes[part, 1, j, k])
            outermost[0, 0, j, part], outermost[0, 1, j, part] = low, high
            outermost_sizes[0, j, part] = max(-low, high)


@compiled_inner(fastmath={"contract"}, forceinline=True)
def block_bounds(entries, sizes, m, central, reach, lowest, highest, out, value):
    """Set out[k] to a bound of every row's value, with entries between entries[m, 0, :, k] and entries[m, -1, :, k].

    For single rows the bound is their value, but for rounding, if only masses have intervals.

    Args:
        entries: entries (M, 1 or 2, d, K).
        sizes: bounds of their sizes (M, d, K).
        m: block.
        central: W_g0 (G, d).
        reach: as of `Blocks`.
        lowest: smallest mass factors (G,).
        highest: largest mass factors (G,).
        out: the bounds (K,).
        value: work array (K,).
    """
    for k in range(len(out)):
        out[k] = 0.0
    for g in range(len(lowest)):
        if entries.shape[2] == 6:
            _add_six(entries, sizes, m, central, reach, g, lowest[g], highest[g], out)
        else:
            _add_any(entries, sizes, m, central, reach, g, lowest[g], highest[g], out, value)


@compiled_inner(fastmath={"contract"}, forceinline=True)
def _add_six(entries, sizes, m, central, reach, g, low, high, out):
    """Add the bounds for the bodies of group g to those of rows with six entries, whose products are written out."""
    upper = entries.shape[1] - 1
    w0, w1, w2 = central[g, 0], central[g, 1], central[g, 2]
    w3, w4, w5 = central[g, 3], central[g, 4], central[g, 5]
    e0, e1, e2 = upper * (w0 > 0.0), upper * (w1 > 0.0), upper * (w2 > 0.0)
    e3, e4, e5 = upper * (w3 > 0.0), upper * (w4 > 0.0), upper * (w5 > 0.0)
    if len(reach):
        r0, r1, r2, r3, r4, r5 = reach[g, 0], reach[g, 1], reach[g, 2], reach[g, 3], reach[g, 4], reach[g, 5]
        for k in range(len(out)):
            v = w0 * entries[m, e0, 0, k] + w1 * entries[m, e1, 1, k] + w2 * entries[m, e2, 2, k]
            v += w3 * entries[m, e3, 3, k] + w4 * entries[m, e4, 4, k] + w5 * entries[m, e5, 5, k]
            v += r0 * sizes[m, 0, k] + r1 * sizes[m, 1, k] + r2 * sizes[m, 2, k]
            v += r3 * sizes[m, 3, k] + r4 * sizes[m, 4, k] + r5 * sizes[m, 5, k]
            out[k] += v * (high if v > 0.0 else low)
    else:
        for k in range(len(out)):
            v = w0 * entries[m, e0, 0, k] + w1 * entries[m, e1, 1, k] + w2 * entries[m, e2, 2, k]
            v += w3 * entries[m, e3, 3, k] + w4 * entries[m, e4, 4, k] + w5 * entries[m, e5, 5, k]
            out[k] += v * (high if v > 0.0 else low)


@compiled_inner(fastmath={"contract"}, forceinline=True)
def _add_any(entries, sizes, m, central, reach, g, low, high, out, value):
    """Add the bounds for the bodies of group g to those of rows with any number of entries; value: work array (K,)."""
    upper = entries.shape[1] - 1
    for k in range(len(out)):
        value[k] = 0.0
    for j in range(entries.shape[2]):
        w = central[g, j]
        e = upper * (w > 0.0)
        for k in range(len(out)):
            value[k] += w * entries[m, e, j, k]
        if len(reach):
            r = reach[g, j]
            for k in range(len(out)):
                value[k] += r * sizes[m, j, k]
    for k in range(len(out)):
        out[k] += value[k] * (high if value[k] > 0.0 else low)


@compiled_inner(fastmath={"contract"}, forceinline=True)
def row_bounds(B, b, base, own_reach, i, u, x, central, reach, lowest, highest, out):
    """Set out[f] to a bound of the value of row B[b, f] at grid point i and (u, x).

    It is the value, but for rounding, if only masses have intervals. Arguments as of `block_bounds`.
    """
    for f in range(len(out)):
        out[f] = own_part(base, i, f, u, x)
        for g in range(len(lowest)):
            v = own_reach[f, g] if len(own_reach) else 0.0
            if len(reach):
                for j in range(B.shape[2]):
                    v += B[b, f, j] * central[g, j] + abs(B[b, f, j]) * reach[g, j]
            else:
                for j in range(B.shape[2]):
                    v += B[b, f, j] * central[g, j]
            out[f] += v * (highest[g] if v > 0.0 else lowest[g])


@compiled_inner(forceinline=True)
def next_above(values, k, threshold):
    """Return the first index from k on of a value above a threshold; the number of values if there is none."""
    while k < len(values) and values[k] <= threshold:
        k += 1
    return k
