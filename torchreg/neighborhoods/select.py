"""The K smallest of every row by (value, index), exactly, whatever the order in which candidates come."""

from __future__ import annotations

import torch
from torch import Tensor

from torchreg.neighborhoods.distances import sort_rows


def k_smallest(values: Tensor, index: Tensor, count: int) -> tuple[Tensor, Tensor]:
    """Select the ``count`` smallest of every row and put them in order.

    ``torch.topk`` leaves open which of equal values it takes, so it only finds the last value that is in;
    a second selection then takes all below it and, of those equal to it, the smallest indexes.

    Args:
        values: (R, W), W >= count; infinite where there is no candidate.
        index: (R, W) int64, 0 and above.
        count: K.

    Returns:
        values and index, (R, K) each, ascending by (value, index).
    """
    last = values.topk(count, dim=1, largest=False).values[:, -1:]
    rank = index.where(values == last, torch.iinfo(torch.int64).max).masked_fill_(values < last, -1)
    taken = rank.topk(count, dim=1, largest=False).indices
    return sort_rows(values.gather(1, taken), index.gather(1, taken))
