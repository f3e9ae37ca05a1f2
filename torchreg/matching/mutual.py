"""Mutual nearest neighbors in feature space (the paper, section 4.1)."""

from __future__ import annotations

import torch
from torch import Tensor

from torchreg.errors import at_least, expect, fraction
from torchreg.matching.nearest import feature_nearest
from torchreg.matching.order import lexicographic
from torchreg.matching.rivals import candidate_pairs
from torchreg.types import Correspondences, Features
from torchreg.types.packing import offsets_of, spans


def match_mutual(
    source: Features, target: Features, *, ratio: float | None = None, neighbors: int = 1
) -> Correspondences:
    """Pairs of points each of which is among the other's nearest in feature space.

    Args:
        source: features of B clouds, finite where valid.
        target: the same, of the same width.
        ratio: keep a match only when its distance is below this fraction of the distance to the second
            nearest target (Lowe, IJCV 60(2), 2004, doi:10.1023/B:VISI.0000029664.99615.94); ``None``: keep all.
        neighbors: a match (i, j) stands when j is among the ``neighbors`` nearest targets of i, and i among the
            ``neighbors`` nearest sources of j. Above 1 a point may have several matches.

    Returns:
        Correspondences, ascending by source row, then by target row; ``score`` is the feature distance. Exact:
        what a brute-force search in float64 finds, ties to the lower row; the same for any batch and number of
        threads. Rows that are not valid are never matched. No gradients.

    Raises:
        ValueError: different numbers of clouds, widths or dtypes, a ratio outside (0, 1], ``neighbors`` below 1, or
            a ratio and ``neighbors`` above 1: a second nearest that is as good would be a match of its own.
    """
    expect(len(source) == len(target), "target", f"{len(source)} clouds, as the source has", len(target))
    expect(
        source.values.shape[1] == target.values.shape[1] and source.values.dtype == target.values.dtype,
        "target",
        f"features of width {source.values.shape[1]}, {source.values.dtype}",
        target.values,
    )
    at_least(neighbors, "neighbors", 1)
    if ratio is not None:
        fraction(ratio, "ratio")
        expect(neighbors == 1, "neighbors", "1 beside a ratio", neighbors)
    parts = [
        _match_pair(source, target, i, k, ratio, neighbors)
        for i, k in zip(spans(source.offsets), spans(target.offsets), strict=True)
    ]
    empty = torch.zeros(0, dtype=torch.int64, device=source.values.device)
    return Correspondences(
        source=torch.cat([empty, *(part[0] for part in parts)]),
        target=torch.cat([empty, *(part[1] for part in parts)]),
        offsets=offsets_of(len(part[0]) for part in parts),
        score=torch.cat([source.values.new_zeros(0), *(part[2] for part in parts)]),
    )


def _match_pair(
    source: Features,
    target: Features,
    source_rows: tuple[int, int],
    target_rows: tuple[int, int],
    ratio: float | None,
    neighbors: int,
) -> tuple[Tensor, Tensor, Tensor]:
    """Global source rows, global target rows and feature distances of one pair."""
    of_source, of_target = _usable(source, *source_rows), _usable(target, *target_rows)
    left, right = source.values.index_select(0, of_source), target.values.index_select(0, of_target)
    if len(left) == 0 or len(right) == 0:
        return of_source[:0], of_target[:0], left.new_zeros(0)
    forth = feature_nearest(left, right, neighbors if ratio is None else 2)
    pairs = candidate_pairs(forth, neighbors)
    stands = pairs.stands
    if ratio is not None and len(right) > 1:
        passes = forth.distance[:, 0] < ratio * forth.distance[:, 1]
        stands, pairs = stands & passes, pairs._replace(open=pairs.open & passes)
    doubtful = pairs.open.nonzero()[:, 0]
    if len(doubtful) > 0:
        # back from the targets of those pairs alone
        wanted, number = pairs.target[doubtful].unique(return_inverse=True)
        back = feature_nearest(right[wanted], left, neighbors).row[number]
        stands[doubtful] = (back == pairs.source[doubtful, None]).any(dim=1)
    i, j = pairs.source[stands], pairs.target[stands]
    order = lexicographic(j, i)
    i, j = i[order], j[order]
    return of_source[i], of_target[j], pairs.distance[stands][order].to(left.dtype)


def _usable(features: Features, begin: int, end: int) -> Tensor:
    return begin + features.valid[begin:end].nonzero()[:, 0]
