"""Sums by halves: the second half of a row is added to the first, until one number is left.

The order follows from the places of the numbers alone. Zeros behind the last one change nothing, so rows of different
lengths stand side by side. Every step is one elementwise addition, which rounds the same on any device and in any lane
of a vector, and the rounding grows with the logarithm of the length.
"""

from __future__ import annotations

import torch
from torch import Tensor


def halved(values: Tensor) -> Tensor:
    """Sums (...) of rows (..., K), of any length; zero where K = 0."""
    width = halving_width(values.shape[-1])
    values = torch.nn.functional.pad(values, (0, width - values.shape[-1]))
    while width > 1:
        width //= 2
        values = values[..., :width] + values[..., width:]
    return values[..., 0] + 0.0  # a sum of negative zeros is zero, with zeros behind and without


def halving_width(count: int) -> int:
    """The power of two that rows of at most ``count`` numbers are filled up to."""
    return 1 << max(0, count - 1).bit_length()
