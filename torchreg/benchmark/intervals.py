"""Confidence intervals over pairs by the bootstrap (Efron, 1979, doi:10.1214/aos/1176344552)."""

from __future__ import annotations

from collections.abc import Sequence
from statistics import fmean
from typing import NamedTuple

import torch

from torchreg.errors import at_least, expect, fraction


class Interval(NamedTuple):
    """A mean with its percentile interval.

    Attributes:
        mean: of the values.
        low: lower end.
        high: upper end.
    """

    mean: float
    low: float
    high: float


def bootstrap(values: Sequence[float], *, level: float = 0.95, draws: int = 10_000, seed: int = 0) -> Interval:
    """The mean of values over pairs, with the percentile interval of resampled means.

    Args:
        values: one per pair, at least one.
        level: of confidence, in (0, 1].
        draws: resamples.
        seed: of the resampling.

    Example:
        >>> bootstrap([1.0, 1.0, 1.0])
        Interval(mean=1.0, low=1.0, high=1.0)
    """
    expect(len(values) > 0, "values", "at least one", values)
    fraction(level, "level")
    at_least(draws, "draws", 1)
    sample = torch.tensor(list(values), dtype=torch.float64)
    rows = torch.randint(len(sample), (draws, len(sample)), generator=torch.Generator().manual_seed(seed))
    means = sample[rows].mean(dim=1).sort().values
    tail = (1 - level) / 2
    low, high = (float(means[min(draws - 1, int(part * draws))]) for part in (tail, 1 - tail))
    return Interval(fmean(values), low, high)
