"""The matched points of pairs about their means: of one pair, as a solver takes them, and of several side by side.

Every pair has a seed made from that of the call and its correspondences, so that it draws the same in any batch.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from torchreg.errors import expect
from torchreg.geometry.numerics.sums import lane_sums
from torchreg.types import Clouds, Correspondences

_MASK = (1 << 64) - 1


class MatchedPoints(NamedTuple):
    """The correspondences of one pair, as a solver takes them.

    Attributes:
        source: (3, M) float64, meters, about the mean of the matched points.
        target: (3, M) float64, likewise.
        score: (M,) as ``Correspondences.score``: the smaller, the better.
        seed: of this pair, made from the call's seed and the correspondences.

    Example:
        >>> import torch
        >>> from torchreg.solvers import MatchedPoints
        >>> points = torch.rand(3, 20, dtype=torch.float64)  # axes first
        >>> MatchedPoints(source=points, target=points, score=torch.zeros(20), seed=0).source.shape
        torch.Size([3, 20])
    """

    source: Tensor
    target: Tensor
    score: Tensor
    seed: int


class PairPoints(NamedTuple):
    """The correspondences of B pairs side by side, padded to the longest."""

    source: Tensor  # (3, B, M) float64, meters, about each pair's mean; zeros behind the last of a pair
    target: Tensor  # as source
    valid: Tensor  # (B, M) bool, false behind the last correspondence of a pair
    score: Tensor  # (B, M) of the correspondences
    counts: tuple[int, ...]  # correspondences of each pair
    thresholds: tuple[float, ...]  # inlier threshold of each pair, meters
    source_center: Tensor  # (B, 3) float64, the means, meters
    target_center: Tensor  # as source_center
    seeds: tuple[int, ...]  # of each pair

    def pair(self, place: int) -> MatchedPoints:
        """One of the pairs, as a solver takes it."""
        filled = slice(0, self.counts[place])
        source, target = (side[:, place, filled].contiguous() for side in (self.source, self.target))
        return MatchedPoints(source, target, self.score[place, filled], self.seeds[place])

    def take(self, places: Sequence[int]) -> PairPoints:
        """Some of the pairs, in this order."""
        if list(places) == list(range(len(self.counts))):
            return self
        index = torch.tensor(places, device=self.valid.device)
        counts, seeds = (tuple(values[place] for place in places) for values in (self.counts, self.seeds))
        thresholds = tuple(self.thresholds[place] for place in places)
        widest = slice(0, max(counts))
        source, target = self.source[:, index, widest], self.target[:, index, widest]
        padded = (source, target, self.valid[index, widest], self.score[index, widest])
        return PairPoints(*padded, counts, thresholds, self.source_center[index], self.target_center[index], seeds)

    def squared_thresholds(self) -> Tensor:
        """(B,) float64, square meters."""
        return self.source.new_tensor([threshold * threshold for threshold in self.thresholds])

    def kernel_arguments(self) -> tuple[Tensor, Tensor, Tensor, int, int]:
        """The points as compiled kernels take them: both sides, which are valid, and how many pairs and columns."""
        sides = (self.source.contiguous(), self.target.contiguous(), self.valid.contiguous())
        return (*sides, len(self.counts), self.valid.shape[1])


def gather_points(
    source: Clouds,
    target: Clouds,
    matches: Correspondences,
    members: Sequence[int],
    thresholds: Sequence[float],
    seed: int,
) -> PairPoints:
    """The matched points of the pairs ``members``, each with a match at least; ``seed`` is the call's."""
    device = source.device
    index = torch.tensor(members)
    begin, end = matches.offsets[index], matches.offsets[index + 1]
    counts = (end - begin).tolist()
    width = torch.arange(max(counts))
    valid = (width < (end - begin)[:, None]).to(device)  # (B, M)
    place = torch.where(width < (end - begin)[:, None], begin[:, None] + width, 0).to(device)  # (B, M)
    sides = []
    for clouds, rows in ((source, matches.source[place]), (target, matches.target[place])):
        wide = torch.where(valid, clouds.points[rows].double().permute(2, 0, 1).contiguous(), 0.0)  # (3, B, M)
        center = lane_sums(wide) / valid.sum(dim=1)  # (3, B)
        first = clouds.offsets[index].to(device)[:, None]
        sides.append((torch.where(valid, wide - center[..., None], 0.0), center.t(), (rows - first)[valid]))
    (p, source_center, rows_p), (q, target_center, rows_q) = sides
    seeds = tuple(pair_seeds(seed, rows_p, rows_q, counts))
    padded = (p, q, valid, matches.score[place])
    return PairPoints(*padded, tuple(counts), tuple(thresholds), source_center, target_center, seeds)


def first_of_each(pair: Tensor) -> Tensor:
    """(H,) bool: where another pair begins in ascending numbers (H,)."""
    return torch.cat([torch.ones_like(pair[:1], dtype=torch.bool), pair[1:] != pair[:-1]])


def ranks(pair: Tensor) -> Tensor:
    """(H,) int64: the place of each within its pair; ``pair`` (H,) ascends."""
    places = torch.arange(len(pair), device=pair.device)
    return places - torch.where(first_of_each(pair), places, 0).cummax(dim=0).values


def base_seed(generator: torch.Generator | None) -> int:
    """One number from a generator, advancing it; 0 for ``None``. The global generator is left alone.

    Example:
        >>> from torchreg.solvers import base_seed
        >>> base_seed(None)
        0
    """
    if generator is None:
        return 0
    drawn = torch.randint(2**62, (1,), generator=generator, device=generator.device)
    return int(drawn.item())


def pair_seeds(seed: int, source: Tensor, target: Tensor, counts: Sequence[int]) -> list[int]:
    """A seed for every pair, from ``seed``, that of the call, and its correspondences.

    ``source`` and ``target`` (M,) are the rows of one pair after another's, counted from the first of their clouds;
    ``counts`` are those of every pair.
    """
    expect(source.shape == target.shape, "target", f"{tuple(source.shape)}", target)
    lengths = torch.tensor(counts, dtype=torch.int64, device=source.device)
    ends = lengths.cumsum(dim=0)
    place = torch.arange(1, len(source) + 1, device=source.device)
    place -= (ends - lengths).repeat_interleave(lengths)
    # sums of int64 wrap around and are exact in any order; so are differences of such sums
    hashes = (source * 0x9E3779B1 + target * 0x85EBCA77 + 1) * (place * 0xC2B2AE3D + 0x27D4EB2F)
    total = torch.nn.functional.pad(hashes.cumsum(dim=0), (1, 0))
    sums: list[int] = (total[ends] - total[ends - lengths]).tolist()
    return [_mix((_mix(seed) + number + count) & _MASK) >> 1 for number, count in zip(sums, counts, strict=True)]


def _mix(value: int) -> int:
    """SplitMix64's finalizer: every bit of the input moves every bit of the output."""
    value = (value + 0x9E3779B97F4A7C15) & _MASK
    value = ((value ^ (value >> 30)) * 0xBF58476D1CE4E5B9) & _MASK
    value = ((value ^ (value >> 27)) * 0x94D049BB133111EB) & _MASK
    return value ^ (value >> 31)
