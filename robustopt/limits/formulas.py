"""Rows with every uncertain quantity at its worst, in numpy; `cutting` has the same formula, compiled."""

from __future__ import annotations

import numpy as np

from robustopt.arrays import Array
from robustopt.limits.polygons import RequiredWrench


def evaluate(B: Array, loads: RequiredWrench, base: Array, base_terms: Array, u: Array, x: Array) -> Array:
    """Return the values of rows at (u, x) with every uncertain quantity at its worst, by the formula of `polygons`.

    Args:
        B: rows (M, F, d) or (F, d).
        loads: required wrenches at M points.
        base: affine part of each row (M, F, 3), or (0, 0, 3) for none.
        base_terms: contribution of each constant interval term to a row (M, F, n_c), or (0, 0, 0) for none.
        u: sdd (M,).
        x: sd^2 (M,).

    Returns:
        Values (M, F).
    """
    point = np.stack([u, x, np.ones_like(u)], axis=1)
    nominal = B @ np.einsum("mdgk,mk->mdg", loads.nominal, point)
    terms = B @ np.einsum("mdnk,mk->mdn", loads.terms, point)
    constant = B @ loads.constant + (base_terms if base_terms.size else 0.0)
    remainder = np.abs(B) @ np.abs(np.einsum("mdnk,mk->mdn", loads.remainder, point))
    values = np.einsum("mfk,mk->mf", base, point) if base.size else 0.0
    for g, (lowest, highest) in enumerate(zip(loads.lowest, loads.highest, strict=True)):
        v = nominal[..., g] + np.abs(terms[..., loads.group == g]).sum(axis=-1)
        v = v + np.abs(constant[..., loads.constant_group == g]).sum(axis=-1)
        v = v + remainder[..., loads.remainder_group == g].sum(axis=-1)
        values = values + np.where(v > 0, highest, lowest) * v
    return np.asarray(values)


def worst_wrench(loads: RequiredWrench, y: Array, u: Array, x: Array) -> Array:
    """Return the wrench at which a row is worst over the box of the uncertain quantities; `evaluate` returns its value.

    Args:
        loads: required wrenches at M points.
        y: a row at each (M, d).
        u: sdd (M,).
        x: sd^2 (M,).

    Returns:
        Wrenches (M, d).
    """
    point = np.stack([u, x, np.ones_like(u)], axis=1)
    nominal = np.einsum("mdgk,mk->mdg", loads.nominal, point)
    terms = np.einsum("mdnk,mk->mdn", loads.terms, point)
    sizes = np.abs(np.einsum("mdnk,mk->mdn", loads.remainder, point))
    total = np.zeros_like(y)
    for g, (lowest, highest) in enumerate(zip(loads.lowest, loads.highest, strict=True)):
        w = nominal[..., g]
        for swing in (terms[..., loads.group == g], loads.constant[..., loads.constant_group == g]):
            w = w + np.einsum("mdn,mn->md", swing, np.sign(np.einsum("md,mdn->mn", y, swing)))
        w = w + np.sign(y) * sizes[..., loads.remainder_group == g].sum(axis=-1)
        total += np.where(np.einsum("md,md->m", y, w) > 0, highest, lowest)[:, None] * w
    return total
