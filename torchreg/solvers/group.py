"""The matched points of a group of pairs, each about their means."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from torchreg.geometry.numerics.sums import row_sums
from torchreg.solvers.points import MatchedPoints, PairPoints
from torchreg.solvers.seeds import pair_seeds
from torchreg.types import Clouds, Correspondences


class Group(NamedTuple):
    """Several pairs.

    Attributes:
        points: about the means of the matched points.
        source_center: (B, 3) float64, those means, meters.
        target_center: (B, 3) float64, likewise.
        seeds: of each pair.
    """

    points: PairPoints
    source_center: Tensor
    target_center: Tensor
    seeds: tuple[int, ...]

    def pair(self, place: int) -> MatchedPoints:
        """One of them, as a solver takes it."""
        own = slice(0, self.points.counts[place])
        source, target = (side[:, place, own].contiguous() for side in (self.points.source, self.points.target))
        return MatchedPoints(source, target, self.seeds[place])

    def take(self, places: Sequence[int]) -> Group:
        """Some of them, in this order."""
        index = torch.tensor(places, device=self.source_center.device)
        seeds = tuple(self.seeds[place] for place in places)
        return Group(self.points.take(places), self.source_center[index], self.target_center[index], seeds)


def gather_group(
    source: Clouds,
    target: Clouds,
    matches: Correspondences,
    members: Sequence[int],
    thresholds: Sequence[float],
    seed: int,
) -> Group:
    """The group of the pairs ``members``, each with a match at least, thresholds in meters and the call's seed."""
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
        center = row_sums(wide) / valid.sum(dim=1)  # (3, B)
        first = clouds.offsets[index].to(device)[:, None]
        sides.append((torch.where(valid, wide - center[..., None], 0.0), center.t(), (rows - first)[valid]))
    (p, source_center, rows_p), (q, target_center, rows_q) = sides
    points = PairPoints(p, q, valid, tuple(counts), tuple(thresholds))
    return Group(points, source_center, target_center, tuple(pair_seeds(seed, rows_p, rows_q, counts)))
