"""The matched points of one pair, and of several pairs side by side, padded to the longest."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor


class MatchedPoints(NamedTuple):
    """The correspondences of one pair, as a solver takes them.

    Attributes:
        source: (3, M) float64, meters, about the mean of the matched points.
        target: (3, M) float64, likewise.
        seed: of this pair, made from the call's seed and the correspondences.
    """

    source: Tensor
    target: Tensor
    seed: int


class PairPoints(NamedTuple):
    """Correspondences of B pairs.

    Attributes:
        source: (3, B, M) float64, meters; zeros behind the last of a pair.
        target: (3, B, M) float64, likewise.
        valid: (B, M) bool, where a correspondence stands.
        counts: how many each pair has.
        thresholds: meters, of an inlier, of each pair.
    """

    source: Tensor
    target: Tensor
    valid: Tensor
    counts: tuple[int, ...]
    thresholds: tuple[float, ...]

    def take(self, places: Sequence[int]) -> PairPoints:
        """Some of the pairs, in this order."""
        if list(places) == list(range(len(self.counts))):
            return self
        index = torch.tensor(places, device=self.valid.device)
        counts = tuple(self.counts[place] for place in places)
        thresholds = tuple(self.thresholds[place] for place in places)
        widest = slice(0, max(counts))
        padded = (self.source[:, index, widest], self.target[:, index, widest], self.valid[index, widest])
        return PairPoints(*padded, counts, thresholds)

    def squared_thresholds(self) -> Tensor:
        """(B,) float64, square meters."""
        return self.source.new_tensor([threshold * threshold for threshold in self.thresholds])


def first_of_each(pair: Tensor) -> Tensor:
    """(H,) bool: where another pair begins in ascending numbers (H,)."""
    return torch.cat([torch.ones_like(pair[:1], dtype=torch.bool), pair[1:] != pair[:-1]])


def ranks(pair: Tensor) -> Tensor:
    """(H,) int64: the place of each within its pair; ``pair`` (H,) ascends."""
    places = torch.arange(len(pair), device=pair.device)
    return places - torch.where(first_of_each(pair), places, 0).cummax(dim=0).values
