"""Confidence intervals over pairs by resampling them, or whole groups of them."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from torchreg.errors import at_least, expect
from torchreg.seeds import generator_of

Statistic = Callable[[Tensor], Tensor]
"""From (..., N) values to (...) of their mean, median or the like."""


class Interval(NamedTuple):
    """A statistic of some pairs, and how far it might move with other pairs of the kind."""

    value: float
    low: float
    high: float


def mean(values: Tensor) -> Tensor:
    """The mean over the last dimension."""
    return values.mean(dim=-1)


def median(values: Tensor) -> Tensor:
    """The median over the last dimension, the mean of the two in the middle where their number is even."""
    ordered: Tensor = values.sort(dim=-1).values
    count = values.shape[-1]
    return (ordered[..., (count - 1) // 2] + ordered[..., count // 2]) / 2


def bootstrap(
    values: Sequence[float],
    statistic: Statistic = mean,
    *,
    level: float = 0.95,
    resamples: int = 10_000,
    seed: int = 0,
) -> Interval:
    """The percentile bootstrap: draw as many pairs with replacement, again and again.

    Efron, Bootstrap methods: another look at the jackknife, 1979, doi:10.1214/aos/1176344552. Where all pairs have
    one value, the interval is that value, which tells nothing about pairs of another kind.

    Args:
        values: one per pair, at least one.
        statistic: of the values.
        level: share of resamples within the interval, above 0 and below 1.
        resamples: how many are drawn.
        seed: of the draws; the same values, seed and level give the same interval.

    Raises:
        ValueError: no values, or a number out of its range.

    Example:
        >>> bootstrap([1.0, 1.0, 1.0])
        Interval(value=1.0, low=1.0, high=1.0)
    """
    whole = _whole(values)
    low, high = _ends(statistic(whole[_drawn(len(whole), resamples, seed)]), level)
    return Interval(float(statistic(whole)), low, high)


def bootstrap_of_groups(
    values: Sequence[float],
    groups: Sequence[Hashable],
    *,
    level: float = 0.95,
    resamples: int = 10_000,
    seed: int = 0,
) -> Interval:
    """As ``bootstrap`` of the mean over all pairs, but groups are drawn, each with all of its pairs.

    Pairs of one scene succeed and fail together, so the pairs of few scenes tell less than as many of different ones.

    Args:
        values: one per pair, at least one.
        groups: of every pair, such as its scene. Of a single group the interval is one value, which tells nothing.
        level: as for ``bootstrap``.
        resamples: likewise.
        seed: likewise.

    Raises:
        ValueError: no values, another number of groups, or a number out of its range.

    Example:
        >>> bootstrap_of_groups([1.0, 0.0, 0.5, 0.5], ["a", "a", "b", "b"])
        Interval(value=0.5, low=0.5, high=0.5)
    """
    whole = _whole(values)
    expect(len(groups) == len(values), "groups", f"one per value ({len(values)})", len(groups))
    numbers = {group: number for number, group in enumerate(dict.fromkeys(groups))}
    of_value = torch.tensor([numbers[group] for group in groups])
    sums, counts = (
        torch.zeros(len(numbers), dtype=torch.float64).index_add_(0, of_value, each)
        for each in (whole, torch.ones_like(whole))
    )
    drawn = _drawn(len(numbers), resamples, seed)
    low, high = _ends(sums[drawn].sum(dim=1) / counts[drawn].sum(dim=1), level)
    return Interval(float(whole.mean()), low, high)


def _whole(values: Sequence[float]) -> Tensor:
    expect(len(values) > 0, "values", "at least one", values)
    return torch.tensor(list(values), dtype=torch.float64)


def _drawn(count: int, resamples: int, seed: int) -> Tensor:
    """(resamples, count) numbers below ``count``, drawn with replacement."""
    at_least(resamples, "resamples", 1)
    return torch.randint(count, (resamples, count), generator=generator_of(seed))


def _ends(statistics: Tensor, level: float) -> tuple[float, float]:
    """Both ends of the middle ``level`` of the statistics of all resamples."""
    expect(0 < level < 1, "level", "a number above 0 and below 1", level)
    low, high = statistics.quantile(torch.tensor([(1 - level) / 2, (1 + level) / 2], dtype=torch.float64)).tolist()
    return low, high
