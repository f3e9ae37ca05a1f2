"""Poses after ICP, where that speaks for them."""

from __future__ import annotations

import torch

from torchreg.refinement import IcpOptions, Pairing, refine_pairs
from torchreg.types import Clouds
from torchreg.types.packing import offsets_of
from torchreg.verification.side import Side
from torchreg.verification.weigh import Scales, Weighed, weigh, weighed_together

_ICP_POINTS = 600


class Finer:
    """ICP for all poses of a group of pairs at once."""

    def __init__(self, scales: Scales, iterations: int) -> None:
        """On the clouds of ``scales``, with so many iterations at most."""
        self._scales = scales
        self._source, self._target = _thinned(scales.source), _whole(scales.target)
        self._options = [
            IcpOptions(kind="point_to_plane", max_distance=threshold, iterations=iterations)
            for threshold in scales.threshold.tolist()
        ]

    def refined(self, found: Weighed) -> Weighed:
        """The poses after ICP, each as it was where that speaks less for it."""
        pairs = found.poses.pair.tolist()
        tried = refine_pairs(
            self._source,
            self._target,
            Pairing(pairs, pairs),
            found.poses.matrices(),
            [self._options[pair] for pair in pairs],
        )
        after = weigh(self._scales, found.poses.moved(tried.T_target_source))
        rows = torch.arange(len(pairs), device=found.odds.device)
        better = after.odds > found.odds
        return weighed_together([found, after]).take(torch.where(better, rows + len(pairs), rows))


def _thinned(side: Side) -> Clouds:
    """The points of each source that move, evenly along their order."""
    device = side.all_points.device
    counts = [min(_ICP_POINTS, number) for number in side.points_of]
    rows = [
        torch.arange(count, device=device) * number // count + first
        for count, number, first in zip(counts, side.points_of, side.first, strict=True)
    ]
    return Clouds(points=side.all_points[:, torch.cat(rows)].t().contiguous(), offsets=offsets_of(counts))


def _whole(side: Side) -> Clouds:
    """All points of each target, with their normals."""
    normals = None if side.all_normals is None else side.all_normals.t().contiguous()
    return Clouds(points=side.all_points.t().contiguous(), offsets=offsets_of(side.points_of), normals=normals)
