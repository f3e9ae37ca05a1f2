"""How many correspondences a hypothesis brings together: a proposal by one matrix product, the decision exact.

    |R p + t - q|^2 = |p|^2 + |q|^2 + |t|^2 + 2 (R^T t).p - 2 t.q - 2 q^T R p

is |t|^2 plus the inner product of 16 numbers of the hypothesis and 16 of the correspondence. So counting the
inliers of H hypotheses over M correspondences is one (H, 16) x (16, M) product and a comparison per tile. Its
rounding depends on the machine's product routine; which hypothesis wins is settled by ``residuals``, made of
elementwise float64 operations, for the few with the most proposed inliers.
"""

from __future__ import annotations

import torch
from torch import Tensor

_TILE_ELEMENTS = 1 << 18  # 1 MB of float32 per tile: product, comparison and count stay in the cache


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
    step = max(1, _TILE_ELEMENTS // max(1, width))
    buffer = vectors.new_empty(min(step, len(vectors)), width)
    for begin in range(0, len(vectors), step):
        rows = slice(begin, min(begin + step, len(vectors)))
        tile = torch.mm(vectors[rows], correspondences, out=buffer[: rows.stop - begin])
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
