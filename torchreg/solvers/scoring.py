"""How many correspondences a hypothesis brings together: a proposal by one matrix product, the decision exact.

    |R p + t - q|^2 = |p|^2 + |q|^2 + |t|^2 + 2 (R^T t).p - 2 t.q - 2 q^T R p

is |t|^2 plus the inner product of 16 numbers of the hypothesis and 16 of the correspondence. So counting the
inliers of H hypotheses over M correspondences is one (H, 16) x (16, M) product and a comparison per tile. Its
rounding depends on the machine's product routine; which hypothesis wins is settled by ``residuals``, made of
elementwise float64 operations, for the few with the most proposed inliers.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor

from torchreg.geometry.best_rotation import best_rotation
from torchreg.geometry.numerics.chunks import row_chunks
from torchreg.geometry.numerics.sums import lane_sums
from torchreg.native import call, native
from torchreg.solvers.points import PairPoints

_TILE_ELEMENTS = 1 << 18  # 1 MB of float32 per tile: product, comparison and count stay in the cache
_SCORE_ELEMENTS = 1 << 16  # half a megabyte of float64 a temporary: they stay in the cache


def proposal_dtype(source: Tensor, target: Tensor, threshold: float) -> torch.dtype:
    """float32 where its rounding of |R p + t - q|^2 stays far below the squared threshold, else float64."""
    reach = float(torch.maximum(source.abs().amax(), target.abs().amax()))
    rounding = 12 * (3 * reach * reach) * torch.finfo(torch.float32).eps
    return torch.float32 if rounding < 0.1 * threshold * threshold else torch.float64


def correspondence_vectors(source: Tensor, target: Tensor) -> Tensor:
    """(16, M) of correspondences (3, M) and (3, M)."""
    products = (target[:, None] * source[None]).reshape(9, -1)
    lengths = (source * source).sum(dim=0) + (target * target).sum(dim=0)
    return torch.cat([products, source, target, lengths[None]])


def hypothesis_vectors(rotation: Tensor, translation: Tensor) -> Tensor:
    """(H, 16) of rotations (3, 3, H) and translations (3, H)."""
    back = (rotation * translation[:, None]).sum(dim=0)  # R^T t, (3, H)
    ones = torch.ones_like(translation[:1])
    return torch.cat([-2 * rotation.reshape(9, -1), 2 * back, -2 * translation, ones]).t().contiguous()


def propose_counts(rotation: Tensor, translation: Tensor, correspondences: Tensor, threshold: float) -> Tensor:
    """Approximate inlier counts (H,) of hypotheses over correspondence vectors (16, M)."""
    vectors = hypothesis_vectors(rotation, translation)
    limit = threshold * threshold - (translation * translation).sum(dim=0)[:, None]  # (H, 1)
    count = torch.empty(len(vectors), dtype=vectors.dtype, device=vectors.device)
    width = correspondences.shape[1]
    tiles = list(row_chunks(len(vectors), width, _TILE_ELEMENTS))
    buffer = vectors.new_empty(tiles[0].stop if tiles else 0, width)
    for rows in tiles:
        tile = torch.mm(vectors[rows], correspondences, out=buffer[: rows.stop - rows.start])
        torch.sum(tile.lt_(limit[rows]), dim=1, out=count[rows])
    return count


def residuals(rotation: Tensor, translation: Tensor, source: Tensor, target: Tensor) -> Tensor:
    """Squared distances (H, M) of hypotheses (3, 3, H), (3, H) over correspondences, elementwise.

    The correspondences are (3, M) twice, the same for all hypotheses, or (3, H, M), those of each.
    """
    square = None
    for i in range(3):
        moved = rotation[i, 0, :, None] * source[0]
        moved += rotation[i, 1, :, None] * source[1]
        moved += rotation[i, 2, :, None] * source[2]
        moved += translation[i, :, None]
        moved -= target[i]
        moved *= moved
        square = moved if square is None else square.add_(moved)
    assert square is not None
    return square


def orthonormal(rotation: Tensor) -> Tensor:
    """The nearest rotations to (3, 3, F) matrices that are rotations up to the rounding of a proposal."""
    return best_rotation(rotation.transpose(0, 1))


Quality = Callable[[Tensor, Tensor, Tensor], Tensor]
"""From support (H,), error (H,) and squared threshold (H,) to quality (H,)."""


def by_count(support: Tensor, error: Tensor, limit: Tensor) -> Tensor:
    """The number of inliers (RANSAC)."""
    return support.double()


def by_msac(support: Tensor, error: Tensor, limit: Tensor) -> Tensor:
    """The sum of 1 - (residual / threshold)^2 over the inliers: a close one counts for more than one at the threshold.

    MSAC: Torr and Zisserman, CVIU 78(1), 2000, doi:10.1006/cviu.1999.0832.
    """
    return support.double() - error / limit


QUALITIES: dict[str, Quality] = {"count": by_count, "msac": by_msac}
"""Qualities by which hypotheses are compared, by the name in a solver's ``scoring``."""

ERROR_SHARES: dict[Quality, float] = {by_count: 0.0, by_msac: 1.0}
"""The qualities that compiled kernels know: the support less this share of error / squared threshold."""


class Scored(NamedTuple):
    """Hypotheses in float64 with exact scores."""

    rotation: Tensor  # (3, 3, H)
    translation: Tensor  # (3, H)
    pair: Tensor  # (H,) int64, whose hypothesis it is
    inliers: Tensor  # (H, M) bool, M being that of the longest pair
    support: Tensor  # (H,) int64, the number of inliers
    error: Tensor  # (H,) sum of squared residuals of the inliers, square meters
    quality: Tensor  # (H,) float64, the higher, the better

    def take(self, index: Tensor) -> Scored:
        """The hypotheses ``index`` (K,), in that order."""
        return Scored(*(part[..., index] for part in self[:2]), *(part[index] for part in self[2:]))

    def join(self, other: Scored) -> Scored:
        """Of every pair these hypotheses, and then the others."""
        first = [torch.cat(parts, dim=-1) for parts in zip(self[:2], other[:2], strict=True)]
        both = Scored(*first, *(torch.cat(parts) for parts in zip(self[2:], other[2:], strict=True)))
        return both.take(both.pair.sort(stable=True).indices)

    def put(self, index: Tensor, other: Scored) -> None:
        """Overwrite the hypotheses at the places ``index`` (K,) by K others."""
        for mine, new in zip(self[:2], other[:2], strict=True):
            mine.index_copy_(-1, index, new)
        for mine, new in zip(self[2:], other[2:], strict=True):
            mine.index_copy_(0, index, new)

    def best_first(self) -> Tensor:
        """Order (H,) by pair, then by quality, then by error, then by place."""
        order = self.error.sort(stable=True).indices
        order = order[self.quality[order].sort(descending=True, stable=True).indices]
        return order[self.pair[order].sort(stable=True).indices]


def score(
    rotation: Tensor, translation: Tensor, pair: Tensor, points: PairPoints, quality: Quality = by_count
) -> Scored:
    """Score hypotheses of the pairs ``pair`` (H,) exactly: residual below the threshold, summed in a fixed order."""
    limit = points.squared_thresholds()[pair]
    if native(rotation, translation, pair, *points.kernel_arguments()[:3]):
        inliers, support, error = _score_compiled(rotation, translation, pair, points, limit)
        return Scored(rotation, translation, pair, inliers, support, error, quality(support, error, limit))
    columns = points.source.shape[2]
    inliers = points.valid.new_empty(len(pair), columns)
    error = torch.empty_like(limit)
    for rows in row_chunks(len(pair), columns, _SCORE_ELEMENTS):
        numbers = pair[rows]
        near = (points.source[:, 0], points.target[:, 0])  # one pair's points need no copy
        if len(points.counts) > 1:
            near = (points.source.index_select(1, numbers), points.target.index_select(1, numbers))
        square = residuals(rotation[..., rows], translation[:, rows], *near)
        inside = (square < limit[rows, None]).logical_and_(points.valid[numbers])
        inliers[rows] = inside
        error[rows] = lane_sums(square.masked_fill_(inside.logical_not_(), 0.0))
    support = inliers.sum(dim=1)
    return Scored(rotation, translation, pair, inliers, support, error, quality(support, error, limit))


def _score_compiled(
    rotation: Tensor, translation: Tensor, pair: Tensor, points: PairPoints, limit: Tensor
) -> tuple[Tensor, Tensor, Tensor]:
    """Inliers, support and error."""
    inliers = torch.empty(len(pair), points.source.shape[2], dtype=torch.bool)
    support, error = torch.empty_like(pair), torch.empty_like(limit)
    poses = (rotation.contiguous(), translation.contiguous(), pair.contiguous(), limit, len(pair))
    call("score_poses", *poses, *points.kernel_arguments(), inliers, support, error)
    return inliers, support, error
