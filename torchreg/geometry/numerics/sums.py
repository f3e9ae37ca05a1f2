"""Sums in one order of addition, which any processor, any language and any width of vectors can keep.

Entry k of a row is added to lane k mod L, entry by entry. Then the lanes are folded by halves: the upper half is added
to the lower one until one lane is left. With a lane for every entry all of the sum is by halves, with one lane entries
are added one after another.

The order follows from the places of the entries alone. Zeros behind the last one change nothing, so rows of different
lengths may stand side by side, filled up with zeros; and where most entries are zero, only the others need to be
visited. Every step is an elementwise addition, which rounds the same on any device and in any lane of a vector.
Compiled kernels add in the same order (``native/src/sums.hpp``).
"""

from __future__ import annotations

import torch
from torch import Tensor

NEIGHBOR_LANES = 16
"""Of sums over the slots of a neighborhood, or the bins of a histogram, which kernels add up side by side."""

SAMPLE_LANES = 64
"""Of sums over the points of samples, most of which may have no partner."""


def lane_sums(values: Tensor, lanes: int | None = None, dim: int = -1) -> Tensor:
    """The sums of floating-point values over one dimension, of any length; the dtype stays, and gradients flow.

    Args:
        values: of any shape.
        lanes: a power of two: few where a kernel adds them up side by side, or where most entries are zero. ``None``
            stands for as many as there are entries, which takes torch the fewest operations.
        dim: the dimension that is summed over.
    """
    dim %= values.ndim
    count = values.shape[dim]
    if count == 0:
        return values.sum(dim=dim)
    if lanes is not None and count > lanes:
        total = values.narrow(dim, 0, lanes).clone()
        for begin in range(lanes, count, lanes):
            part = values.narrow(dim, begin, min(lanes, count - begin))
            total.narrow(dim, 0, part.shape[dim]).add_(part)
        values, count = total, lanes
    while count > 1:
        half = 1 << ((count - 1).bit_length() - 1)
        folded = values.narrow(dim, 0, count - half) + values.narrow(dim, half, count - half)
        if count < 2 * half:
            folded = torch.cat([folded, values.narrow(dim, count - half, 2 * half - count)], dim=dim)
        values, count = folded, half
    return values.select(dim, 0) + 0.0  # a sum of negative zeros is zero, with zeros behind and without
