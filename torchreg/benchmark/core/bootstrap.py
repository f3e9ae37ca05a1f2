"""Confidence intervals over pairs by resampling them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
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
    expect(len(values) > 0, "values", "at least one", values)
    expect(0 < level < 1, "level", "a number above 0 and below 1", level)
    at_least(resamples, "resamples", 1)
    whole = torch.tensor(list(values), dtype=torch.float64)
    generator = generator_of(seed)
    drawn = torch.randint(len(whole), (resamples, len(whole)), generator=generator)
    tails = torch.tensor([(1 - level) / 2, (1 + level) / 2], dtype=torch.float64)
    low, high = statistic(whole[drawn]).quantile(tails).tolist()
    return Interval(float(statistic(whole)), low, high)
