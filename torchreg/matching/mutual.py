"""Mutual nearest neighbors in feature space (the paper, section 4.1)."""

from __future__ import annotations

import torch
from torch import Tensor

from torchreg.errors import expect, fraction
from torchreg.matching.nearest import feature_nearest
from torchreg.types import Correspondences, Features
from torchreg.types.packing import offsets_of, spans


def match_mutual(source: Features, target: Features, *, ratio: float | None = None) -> Correspondences:
    """Pairs of points each of which is the other's nearest in feature space.

    Args:
        source: features of B clouds.
        target: features of B clouds, of the same width.
        ratio: keep a match only when its distance is below this fraction of the distance to the second
            nearest target (Lowe, IJCV 60(2), 2004, doi:10.1023/B:VISI.0000029664.99615.94); ``None``: keep all.

    Returns:
        Correspondences, ascending by source row; ``score`` is the feature distance. Exact: what a brute-force
        search in float64 finds, ties to the lower row; the same for any batch and number of threads. Rows that
        are not valid are never matched. No gradients.

    Raises:
        ValueError: different numbers of clouds, widths or dtypes, or a ratio outside (0, 1].
    """
    expect(len(source) == len(target), "target", f"{len(source)} clouds, as the source has", len(target))
    expect(
        source.values.shape[1] == target.values.shape[1] and source.values.dtype == target.values.dtype,
        "target",
        f"features of width {source.values.shape[1]}, {source.values.dtype}",
        target.values,
    )
    if ratio is not None:
        fraction(ratio, "ratio")
    parts = [
        _match_pair(source, target, i, k, ratio)
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
    source: Features, target: Features, source_rows: tuple[int, int], target_rows: tuple[int, int], ratio: float | None
) -> tuple[Tensor, Tensor, Tensor]:
    """Global source rows, global target rows and feature distances of one pair."""
    of_source, of_target = _usable(source, *source_rows), _usable(target, *target_rows)
    left, right = source.values[of_source], target.values[of_target]
    if len(left) == 0 or len(right) == 0:
        return of_source[:0], of_target[:0], left.new_zeros(0)
    forth = feature_nearest(left, right, exact_second=ratio is not None)
    keep = forth.contended
    if ratio is not None:
        keep = keep & (forth.distance < ratio * forth.second)
    rows = keep.nonzero()[:, 0]
    # back from the targets of those rows alone: the others cannot be mutual
    wanted, number = forth.row[rows].unique(return_inverse=True)
    if len(rows) == 0:
        return of_source[:0], of_target[:0], left.new_zeros(0)
    back = feature_nearest(right[wanted], left).row
    kept = rows[back[number] == rows]
    return of_source[kept], of_target[forth.row[kept]], forth.distance[kept].to(left.dtype)


def _usable(features: Features, begin: int, end: int) -> Tensor:
    return begin + features.valid[begin:end].nonzero()[:, 0]
