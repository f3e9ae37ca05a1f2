"""Histograms of several numbers at once whose votes pass linearly from cell to cell.

The shares of a vote are those of ``soft.votes`` in every dimension, multiplied: in two dimensions a vote is shared among
four cells, in three among eight.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

from torch import Tensor

from torchreg.descriptors.soft.votes import Shares


def grid_votes(shares: Sequence[Shares], votes: Tensor, bins: Sequence[int]) -> Tensor:
    """Histograms (R, product of ``bins``) of votes (R, K); the last dimension moves fastest.

    Gradients flow to shares and votes. A row sums to the sum of its votes.
    """
    size = 1
    for count in bins:
        size *= count
    counts = votes.new_zeros(votes.shape[0], size)
    for corner in product((False, True), repeat=len(shares)):
        cell, vote = votes.new_zeros((), dtype=shares[0].lower.dtype), votes
        for share, count, upper in zip(shares, bins, corner, strict=True):
            cell = cell * count + (share.upper if upper else share.lower)
            vote = vote * (share.share if upper else 1 - share.share)
        counts = counts.scatter_add(1, cell, vote)
    return counts
