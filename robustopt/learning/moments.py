"""Acceleration errors as sufficient statistics, and the interval that they give (paper eq. 9)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import sqrt

Values = tuple[float, ...]


@dataclass(frozen=True)
class Moments:
    """Count, sum and sum of squares of the executed minus the planned joint acceleration, over samples of motion.

    count: samples per joint; total, squares: one value per joint, (n,) [rad/s^2] and [(rad/s^2)^2]; empty tuples
    where there is no sample
    """

    count: int = 0
    total: Values = ()
    squares: Values = ()

    @staticmethod
    def of_means(count: int, mean: Sequence[float], mean_square: Sequence[float]) -> Moments:
        """Moments of `count` samples per joint with this mean and mean square, (n,) each."""
        if count == 0:
            return Moments()
        return Moments(count, tuple(count * value for value in mean), tuple(count * value for value in mean_square))

    def __add__(self, other: Moments) -> Moments:
        """The moments of both sets of samples together."""
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
        """U, (n,) [rad/s^2]; empty without a sample."""
        return tuple(value / self.count for value in self.total)

    @property
    def deviation(self) -> Values:
        """Delta, the maximum-likelihood deviation of all samples about U, (n,) [rad/s^2]; empty without a sample."""
        means = zip(self.squares, self.mean, strict=True)
        return tuple(sqrt(max(square / self.count - mean * mean, 0.0)) for square, mean in means)


@dataclass(frozen=True)
class ErrorInterval:
    """The joint acceleration error a plan survives: [U - w, U + w] with w = share K Delta (paper eq. 9, share = 1).

    mean, deviation: U and Delta, (n,) [rad/s^2], empty where no error is known, which is an error of 0; share: part of
    U and of K Delta that is planned for, less than 1 where the whole leaves no plan
    """

    mean: Values = ()
    deviation: Values = ()
    K: float = 0.0
    share: float = 1.0

    @property
    def middle(self) -> Values:
        """share U, (n,) [rad/s^2]."""
        return tuple(self.share * value for value in self.mean)

    @property
    def half_width(self) -> Values:
        """share K Delta, (n,) [rad/s^2]."""
        return tuple(self.share * self.K * value for value in self.deviation)

    @property
    def is_zero(self) -> bool:
        return not any(self.middle) and not any(self.half_width)


def interval_of(moments: Moments, K: float) -> ErrorInterval:
    """[U - K Delta, U + K Delta] of the samples."""
    return ErrorInterval(moments.mean, moments.deviation, K)


def endpoint_change(old: ErrorInterval, new: ErrorInterval) -> float:
    """Largest distance by which an endpoint of any joint's interval moves [rad/s^2]; no interval is [0, 0]."""
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
"""Parts of a learned interval that are tried in turn where the whole of it leaves no plan (our choice)."""


def shrunk(interval: ErrorInterval | None) -> ErrorInterval | None:
    """The interval with the next smaller share; None where nothing is left to give up.

    A robust problem without a solution asks too much. Less friction only asks for more, so the interval is given up in
    halves, down to the problem without errors. What the smaller interval is worth, executions decide (our choice; the
    paper says nothing of it).
    """
    if interval is None or interval.is_zero:
        return None
    share = next(value for value in SHARES if value < interval.share)
    return ErrorInterval(interval.mean, interval.deviation, interval.K, share)
