"""Rows with every uncertain quantity at its worst, in numpy; `cutting` has the same formula, compiled."""

from __future__ import annotations

from itertools import product

import numpy as np

from robustopt.arrays import Array
from robustopt.limits.coupling import MOST_ERRORS
from robustopt.limits.polygons import RequiredWrench


def evaluate(B: Array, loads: RequiredWrench, base: Array, base_terms: Array, u: Array, x: Array) -> Array:
    """Return bounds of the values of rows at (u, x) with every uncertain quantity at its worst.

    They are the values by the formula of `polygons` if no term and at most one group depends on the acceleration error.

    Args:
        B: rows (M, F, d) or (F, d).
        loads: required wrenches at M points.
        base: affine part of each row (M, F, 3), or (0, 0, 3) for none.
        base_terms: contribution of each constant interval term to a row (M, F, n_c), or (0, 0, 0) for none.
        u: sdd (M,).
        x: sd^2 (M,).

    Returns:
        Bounds (M, F).
    """
    point = np.stack([u, x, np.ones_like(u)], axis=1)
    nominal = B @ np.einsum("mdgk,mk->mdg", loads.nominal, point)
    terms = np.abs(B @ np.einsum("mdnk,mk->mdn", loads.terms, point))
    moments = _support(B @ np.einsum("mdnk,mk->mdn", loads.moments, point), loads)
    constant = B @ loads.constant + (base_terms if base_terms.size else 0.0)
    n = len(loads.group)
    for e in range(loads.products.shape[3]):
        change = B @ loads.products[..., e]
        terms = terms + np.abs(change[..., :n])
        moments = moments + np.maximum(_support(change[..., n:], loads), _support(-change[..., n:], loads))
    values = np.einsum("mfk,mk->mf", base, point) if base.size else 0.0
    for g, (lowest, highest) in enumerate(zip(loads.lowest, loads.highest, strict=True)):
        v = nominal[..., g] + terms[..., loads.group == g].sum(axis=-1)
        v = v + np.abs(constant[..., loads.constant_group == g]).sum(axis=-1)
        v = v + moments[..., loads.moment_group == g].sum(axis=-1)
        values = values + np.where(v > 0, highest, lowest) * v
    return np.asarray(values)


def worst_wrench(loads: RequiredWrench, y: Array, u: Array, x: Array) -> Array:
    """Return the wrench at which a row is worst over the box of the uncertain quantities.

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
    terms = np.einsum("mdnk,mk->mdn", np.concatenate([loads.terms, loads.moments], axis=2), point)
    errors, groups = loads.products.shape[3], len(loads.lowest)
    free = loads.constant[:, :, groups * errors :], loads.constant_group[groups * errors :]
    if not (errors and (terms.shape[2] or groups > 1)):
        free = loads.constant, loads.constant_group
        return _worst_at(loads, y, nominal, terms, *free)
    shaken = loads.constant[:, :, : groups * errors].reshape(*nominal.shape, errors)
    effect = np.einsum("md,mdge->me", y, shaken)
    largest = np.argsort(-np.abs(np.einsum("md,mdke->mke", y, loads.products)).sum(axis=(0, 1)), kind="stable")
    worst, best = np.zeros_like(y), np.full(len(y), -np.inf)
    for corner in product((1.0, -1.0), repeat=min(errors, MOST_ERRORS)):
        error = np.where(effect < 0.0, -1.0, 1.0)
        error[:, largest[: len(corner)]] = corner
        changed = nominal + np.einsum("mdge,me->mdg", shaken, error)
        varied = terms + np.einsum("mdke,me->mdk", loads.products, error)
        found = _worst_at(loads, y, changed, varied, *free)
        value = np.einsum("md,md->m", y, found)
        better = value > best
        worst[better], best[better] = found[better], value[better]
    return worst


def _worst_at(
    loads: RequiredWrench, y: Array, nominal: Array, terms: Array, constant: Array, constant_group: Array
) -> Array:
    """Return the worst wrenches (M, d) for wrenches (M, d, ...) that do not depend on each other."""
    n, total = len(loads.group), np.zeros_like(y)
    weights = _worst_moments(np.einsum("md,mdn->mn", y, terms[..., n:]), loads)
    moment_group = np.repeat(loads.moment_group, 6)
    for g, (lowest, highest) in enumerate(zip(loads.lowest, loads.highest, strict=True)):
        w = nominal[..., g]
        for swing in (terms[..., :n][..., loads.group == g], constant[..., constant_group == g]):
            w = w + np.einsum("mdn,mn->md", swing, np.sign(np.einsum("md,mdn->mn", y, swing)))
        own = moment_group == g
        w = w + np.einsum("mdn,mn->md", terms[..., n:][..., own], weights[:, own])
        total += np.where(np.einsum("md,md->m", y, w) > 0, highest, lowest)[:, None] * w
    return total


def _shares(y: Array) -> Array:
    """Return the coefficients r_a of the second moments (..., m, 3) for their values y (..., 6 m)."""
    six = y.reshape(*y.shape[:-1], y.shape[-1] // 6, 6)
    xy, xz, yz = np.moveaxis(0.5 * np.abs(six[..., 3:]), -1, 0)
    return six[..., :3] + np.stack([xy + xz, xy + yz, xz + yz], axis=-1)


def _support(y: Array, loads: RequiredWrench) -> Array:
    """Return the largest sum (..., m) of values y (..., 6 m) times the second moments less the usual ones."""
    shares = np.maximum(_shares(y), 0.0)
    plane = np.where(loads.round, shares[..., :2].max(axis=-1), shares[..., :2].sum(axis=-1))
    usual = (y * loads.usual).reshape(*y.shape[:-1], y.shape[-1] // 6, 6).sum(axis=-1)
    return np.asarray(plane + shares[..., 2] - usual)


def _worst_moments(y: Array, loads: RequiredWrench) -> Array:
    """Return the second moments less the usual ones (..., 6 m) at which `_support` has its value."""
    six, shares = y.reshape(*y.shape[:-1], y.shape[-1] // 6, 6), _shares(y)
    squares = np.where(shares > 0.0, 1.0, 0.0)
    both = loads.round & (squares[..., 0] > 0.0) & (squares[..., 1] > 0.0)
    first = shares[..., 0] >= shares[..., 1]
    squares[..., 0] = np.where(both & ~first, 0.0, squares[..., 0])
    squares[..., 1] = np.where(both & first, 0.0, squares[..., 1])
    pairs = 0.5 * np.stack([squares[..., a] + squares[..., b] for a, b in ((0, 1), (0, 2), (1, 2))], axis=-1)
    moments = np.concatenate([squares, np.where(six[..., 3:] >= 0.0, pairs, -pairs)], axis=-1)
    return np.asarray(moments.reshape(y.shape) - loads.usual)
