"""How cost grows: the slope of its logarithm over that of a size."""

from __future__ import annotations

import math
from collections.abc import Sequence
from statistics import fmean

from torchreg.errors import expect


def slope(sizes: Sequence[float], costs: Sequence[float]) -> float:
    """The exponent p of the power law cost ~ size^p that fits best (least squares over logarithms).

    Args:
        sizes: above 0, at least two different ones.
        costs: above 0, one per size.

    Example:
        >>> round(slope([1, 10, 100], [2, 20, 200]), 6)
        1.0
    """
    expect(len(sizes) == len(costs), "costs", f"one per size ({len(sizes)})", len(costs))
    expect(len(set(sizes)) > 1, "sizes", "at least two different ones", sizes)
    x, y = [math.log(size) for size in sizes], [math.log(cost) for cost in costs]
    mx, my = fmean(x), fmean(y)
    return sum((a - mx) * (b - my) for a, b in zip(x, y, strict=True)) / sum((a - mx) ** 2 for a in x)
