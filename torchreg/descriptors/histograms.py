"""Histograms over neighborhoods: votes as integer counts, and the distance-weighted sum of Eq. (2) and (4).

Counts are integers, so that no order of addition shows in the result; the weighted sum adds the neighbors of a
row one after another, in the row's own order.
"""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn.functional import embedding_bag

from torchreg.geometry.numerics.chunks import row_chunks
from torchreg.geometry.numerics.sums import NEIGHBOR_LANES, lane_sums
from torchreg.native import call, native, rows
from torchreg.types import Neighborhoods


def count_votes(bins: Tensor, votes: Tensor, size: int) -> Tensor:
    """Sum votes (R, K), integers (exact) or floats, per row and bin: (R, size).

    ``bins`` (R, K) int64 are in [0, size).
    """
    return votes.new_zeros(bins.shape[0], size).scatter_add_(1, bins, votes)


def inverse_square_weights(sq_distance: Tensor, counted: Tensor) -> Tensor:
    """1/d^2 (R, K) where ``counted`` and d > 0, else 0; never infinite or NaN.

    A point lies at distance 0 from itself, so ``counted`` may include it.
    """
    usable = (sq_distance > 0).logical_and_(counted)
    return sq_distance.clamp(min=_least(sq_distance)).reciprocal_().mul_(usable)


def weighted_sum(table: Tensor, index: Tensor, weights: Tensor) -> Tensor:
    """Sum the histograms of neighbors: (R, D) with sum_k weights[r, k] table[index[r, k]].

    ``table`` is (P, D), ``index`` and ``weights`` are (R, K), the latter of the dtype of ``table``. Gradients flow to
    table and weights.
    """
    if table.dtype == torch.float32 or index.numel() == 0:
        return embedding_bag(index, table, per_sample_weights=weights, mode="sum")
    parts = []
    for part in row_chunks(index.shape[0], index.shape[1] * table.shape[1], 1 << 20):
        gathered = table[index[part]] * weights[part][..., None]  # (r, K, D)
        parts.append(gathered.sum(dim=1))
    return torch.cat(parts)


def add_weighted_neighbors(histograms: Tensor, near: Neighborhoods, bins: int, *, keep_own: bool = True) -> Tensor:
    """Eq. (2) and (4): the neighbors' histograms by inverse squared distance, scaled to 100 each, plus a point's own.

    ``histograms`` (P, blocks x bins) are in percent; without ``keep_own`` those of the neighbors alone are returned.
    """
    if _has_kernel(histograms, near):
        return _sums_compiled(histograms, near, bins, keep_own)
    out = torch.empty_like(histograms)
    for part in row_chunks(histograms.shape[0], near.max_neighbors):
        weights = inverse_square_weights(near.sq_distance[part], near.valid[part]).to(histograms.dtype)
        blocks = weighted_sum(histograms, near.index[part], weights).view(-1, histograms.shape[1] // bins, bins)
        total = lane_sums(blocks, NEIGHBOR_LANES)[..., None]
        scale = torch.where(total > 0, 100 / torch.where(total > 0, total, torch.ones_like(total)), 0)
        result = (blocks * scale).view(-1, histograms.shape[1])
        out[part] = result + histograms[part] if keep_own else result
    return out


def neighbor_votes(index: Tensor, valid: Tensor, rows: slice) -> Tensor:
    """(R, K) bool: the valid slots of these rows that hold another point than the query itself."""
    query = torch.arange(rows.start, rows.stop, device=index.device)[:, None]
    return valid[rows] & (index[rows] != query)


def _least(sq_distance: Tensor) -> float:
    """Far below any squared distance between points, and such that sums of reciprocals stay finite."""
    return float(torch.finfo(sq_distance.dtype).tiny ** 0.75)


def _has_kernel(histograms: Tensor, near: Neighborhoods) -> bool:
    """Float32 where ``embedding_bag`` adds by fused multiply-adds, as the kernel does."""
    if histograms.dtype != torch.float32 or near.sq_distance.dtype != torch.float32 or histograms.requires_grad:
        return False
    fused = torch.backends.cpu.get_cpu_capability() in ("AVX2", "AVX512")
    return fused and native(histograms, near.index, near.valid, near.sq_distance)


def _sums_compiled(histograms: Tensor, near: Neighborhoods, bins: int, keep_own: bool) -> Tensor:
    """As ``add_weighted_neighbors``."""
    histograms, out = histograms.contiguous(), torch.empty_like(histograms, memory_format=torch.contiguous_format)
    slots = *rows(near.index), *rows(near.valid), *rows(near.sq_distance)
    sizes = len(histograms), near.max_neighbors, histograms.shape[1], bins
    call("add_weighted_neighbors", histograms, *slots, *sizes, int(keep_own), _least(near.sq_distance), out)
    return out
