"""Sums of rows in 64 lanes: an order of addition that any processor, any language and any width of vectors can keep.

Place i is added to lane i mod 64, one after another; then the upper half of the lanes is added to the lower half until
one is left. Zeros behind the last entry change nothing, so rows of different lengths may stand side by side, filled up
with zeros; and where most entries are zero, only the others need to be visited.
"""

from __future__ import annotations

import torch
from torch import Tensor

LANES = 64


def lane_sums(values: Tensor, dim: int = -1) -> Tensor:
    """The sums of values over one dimension, whose length is a multiple of 64, at least 64."""
    dim %= values.ndim
    lanes = values.unflatten(dim, (-1, LANES))
    total = torch.zeros_like(lanes.select(dim, 0))
    for part in lanes.unbind(dim):
        total += part
    width = LANES
    while width > 1:
        width //= 2
        total = total.narrow(dim, 0, width) + total.narrow(dim, width, width)
    return total.squeeze(dim)
