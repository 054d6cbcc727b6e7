"""Acceleration errors as sufficient statistics, and the error interval that they give (paper eq. 9)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import sqrt

Values = tuple[float, ...]


@dataclass(frozen=True)
class Moments:
    """Count, sum and sum of squares of the actual minus the planned joint acceleration, over samples of the motion.

    Attributes:
        count: number of samples per joint.
        total: sum for each joint, (n,) [rad/s^2]; empty without samples.
        squares: sum of squares for each joint, (n,) [(rad/s^2)^2]; empty without samples.
    """

    count: int = 0
    total: Values = ()
    squares: Values = ()

    @staticmethod
    def of_means(count: int, mean: Sequence[float], mean_square: Sequence[float]) -> Moments:
        """Return the moments of samples with a given mean and mean square.

        Args:
            count: number of samples per joint.
            mean: mean for each joint, (n,) [rad/s^2].
            mean_square: mean of the squares for each joint, (n,) [(rad/s^2)^2].

        Returns:
            The moments; empty for no samples.
        """
        if count == 0:
            return Moments()
        return Moments(count, tuple(count * value for value in mean), tuple(count * value for value in mean_square))

    def __add__(self, other: Moments) -> Moments:
        """Return the moments of both sets of samples together."""
        if not self.count:
            return other
        if not other.count:
            return self
        return Moments(
            self.count + other.count,
            tuple(a + b for a, b in zip(self.total, other.total, strict=True)),
            tuple(a + b for a, b in zip(self.squares, other.squares, strict=True)),
        )

    @property
    def mean(self) -> Values:
        """Mean U of the samples, (n,) [rad/s^2]; empty without samples."""
        return tuple(value / self.count for value in self.total)

    @property
    def deviation(self) -> Values:
        """Maximum-likelihood standard deviation Delta about U, (n,) [rad/s^2]; empty without samples."""
        means = zip(self.squares, self.mean, strict=True)
        return tuple(sqrt(max(square / self.count - mean * mean, 0.0)) for square, mean in means)


@dataclass(frozen=True)
class ErrorInterval:
    """Joint acceleration errors that a plan is robust to: share [U - K Delta, U + K Delta] (paper eq. 9 for share = 1).

    Attributes:
        mean: U, (n,) [rad/s^2]; empty if no error is known, which stands for an error of 0.
        deviation: Delta, (n,) [rad/s^2]; empty like `mean`.
        K: number of standard deviations.
        share: planned part of the interval; less than 1 if there is no plan for the whole interval.
    """

    mean: Values = ()
    deviation: Values = ()
    K: float = 0.0
    share: float = 1.0

    @property
    def middle(self) -> Values:
        """Middle of the interval, share U, (n,) [rad/s^2]."""
        return tuple(self.share * value for value in self.mean)

    @property
    def half_width(self) -> Values:
        """Half of its width, share K Delta, (n,) [rad/s^2]."""
        return tuple(self.share * self.K * value for value in self.deviation)

    @property
    def is_zero(self) -> bool:
        """Whether the interval holds the error 0 alone."""
        return not any(self.middle) and not any(self.half_width)


def interval_of(moments: Moments, K: float) -> ErrorInterval:
    """Return the interval [U - K Delta, U + K Delta] of samples.

    Args:
        moments: the samples.
        K: number of standard deviations.

    Returns:
        The whole interval.
    """
    return ErrorInterval(moments.mean, moments.deviation, K)


def endpoint_change(old: ErrorInterval, new: ErrorInterval) -> float:
    """Return the largest distance by which an end of any joint's interval moves.

    Args:
        old: the interval before.
        new: the interval after.

    Returns:
        A distance [rad/s^2]; an empty interval counts as [0, 0].
    """
    size = max(len(old.mean), len(new.mean))
    zeros = (0.0,) * size
    old_middle, old_width = old.middle or zeros, old.half_width or zeros
    new_middle, new_width = new.middle or zeros, new.half_width or zeros
    moves = (
        max(abs(m1 - w1 - m0 + w0), abs(m1 + w1 - m0 - w0))
        for m0, w0, m1, w1 in zip(old_middle, old_width, new_middle, new_width, strict=True)
    )
    return max(moves, default=0.0)


SHARES = (1.0, 0.5, 0.25, 0.125, 0.0)
"""Shares of an error interval that are planned for in turn, until there is a plan (our choice)."""


def shrunk(interval: ErrorInterval | None) -> ErrorInterval | None:
    """Return an error interval with the next smaller share.

    A learner calls this function if there is no plan for the interval. Lower friction would only make the task harder,
    so the learner halves the interval, down to the problem without errors, and lets executions decide whether the
    smaller interval is enough (our choice; the paper does not treat this case).

    Args:
        interval: the interval that was planned for.

    Returns:
        The smaller interval; None if the given one is zero already.
    """
    if interval is None or interval.is_zero:
        return None
    share = next(value for value in SHARES if value < interval.share)
    return ErrorInterval(interval.mean, interval.deviation, interval.K, share)
