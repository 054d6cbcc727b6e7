"""Slacks, excesses and multipliers of the limits in the interior-point method for jerk-limited timings, compiled.

Each limit g >= 0 has a slack s with a multiplier. If limits may be exceeded, it is g + e >= 0, and the cost of the
excess e >= 0 is so high that e = 0 wherever this is possible. Then any timing will do as the first one, and limits are
in conflict if e > 0 at the end. The cost bounds the multiplier; what is left to it is the multiplier of e. In the
Newton matrix, e changes the slack of a limit to s + dual e / (bound - dual), and leaves the bands as they are.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from robustopt.arrays import Array
from robustopt.compiled import compiled_inner
from robustopt.solvers.jerk_matrix import off_rows


class Slacks(NamedTuple):
    """Slacks and multipliers of the limits, (m,) each.

    Attributes:
        slack: slack s of each limit, g + over = s.
        dual: its multiplier.
        over: excess e of each limit, 0 if none may be exceeded.
        bound: cost of the excess, which bounds the multiplier; infinite if no limit may be exceeded.
        d_slack, d_dual, d_over: their steps.
    """

    slack: Array
    dual: Array
    over: Array
    bound: Array
    d_slack: Array
    d_dual: Array
    d_over: Array


@compiled_inner(error_model="numpy")
def centre(program, work, limits, products, pairs, penalty):
    """Set slacks, multipliers and excesses at the current timing to pairs of equal products with a given sum."""
    total, each = work.dt.sum(), products / pairs
    for k in range(len(limits.slack)):
        if not np.isinf(penalty):
            unit = 1.0 if k < len(program.line_point) else work.dt[work.point[k] + 1]
            bound = penalty * total / unit
            g = bound * work.g[k]
            root = np.sqrt(4.0 * each * each + g * g) + abs(g)
            # both solve each / over + each / slack = bound, without cancellation
            larger, smaller = 2.0 * each + root, 2.0 * each + 4.0 * each * each / root
            limits.slack[k] = 0.5 * (larger if g > 0.0 else smaller) / bound
            limits.over[k] = 0.5 * (smaller if g > 0.0 else larger) / bound
            limits.bound[k] = bound
        limits.dual[k] = products / (pairs * limits.slack[k])


@compiled_inner(error_model="numpy")
def state(program, z, work, limits, right):
    """Return the sum of the products of slacks and multipliers, and the largest error of the equations."""
    products = 0.0
    for k in range(len(limits.slack)):
        products += limits.slack[k] * limits.dual[k]
    wrong = off_rows(program, z, work, right)
    for k in range(len(limits.slack)):
        unit = 1.0 if k < len(program.line_point) else work.dt[work.point[k] + 1]
        wrong = max(wrong, abs(work.g[k] + limits.over[k] - limits.slack[k]) / unit)
        if limits.over[k] > 0.0:
            products += limits.over[k] * (limits.bound[k] - limits.dual[k])
    return products, wrong


@compiled_inner(error_model="numpy")
def longest_of_limits(limits, primal, other):
    """Return the parts of a step, at most as given, after which the first slack or excess, or multiplier, is 0."""
    for k in range(len(limits.slack)):
        if limits.d_slack[k] < 0.0:
            primal = min(primal, -limits.slack[k] / limits.d_slack[k])
        if limits.d_dual[k] < 0.0:
            other = min(other, -limits.dual[k] / limits.d_dual[k])
        if limits.over[k] == 0.0:
            continue
        if limits.d_over[k] < 0.0:
            primal = min(primal, -limits.over[k] / limits.d_over[k])
        if limits.d_dual[k] > 0.0:
            other = min(other, (limits.bound[k] - limits.dual[k]) / limits.d_dual[k])
    return primal, other


@compiled_inner(error_model="numpy")
def left_gap(limits, primal, other):
    """Return the sum of the products after parts of a step."""
    left = 0.0
    for k in range(len(limits.slack)):
        dual = limits.dual[k] + other * limits.d_dual[k]
        left += (limits.slack[k] + primal * limits.d_slack[k]) * dual
        if limits.over[k] > 0.0:
            left += (limits.over[k] + primal * limits.d_over[k]) * (limits.bound[k] - dual)
    return left
