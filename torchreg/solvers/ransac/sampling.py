"""Minimal samples, drawn the same for a pair wherever it stands."""

from __future__ import annotations

from collections.abc import Iterator

import torch
from torch import Tensor

FIRST_ROUND = 1 << 12
"""Hypotheses drawn at first, so that easy pairs stop soon; every round draws twice as many as the one before."""

LARGEST_ROUND = 1 << 15
"""Until so many; constants, since the stream of draws depends on them."""


def sample_rounds(count: int, size: int, total: int, seed: int, device: torch.device) -> Iterator[Tensor]:
    """Yield samples (R, size) int64 in [0, count), with replacement, until ``total`` are drawn."""
    generator = torch.Generator().manual_seed(seed)
    number, begin = FIRST_ROUND, 0
    while begin < total:
        drawn = torch.randint(count, (min(number, total - begin), size), generator=generator)
        yield drawn.to(device)
        begin, number = begin + number, min(2 * number, LARGEST_ROUND)
