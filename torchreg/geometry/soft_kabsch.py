"""The rigid transform that best aligns two sets of points all of whose pairs count, each with its own weight.

    minimize  sum_ij C_ij |R p_i + t - q_j|^2

Only sums over the pairs count: with rows r_i = sum_j C_ij, columns c_j = sum_i C_ij and W = sum_ij C_ij the means are
P^T r / W and Q^T c / W, the covariance (P - mean)^T C (Q - mean) / W. ``kabsch`` on expected partners
(``matching.soft.soft_targets``) minimizes the same, but divides by every row's r_i; here only W is divided by.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torchreg.errors import expect
from torchreg.geometry.kabsch import from_moments


def soft_kabsch(source: Tensor, target: Tensor, confidence: Tensor) -> Tensor:
    """Least-squares rigid transforms over all pairs of points, batched.

    Args:
        source: (..., N, 3) meters.
        target: (..., M, 3) meters.
        confidence: (..., N, M), at least 0: the weight of every pair.

    Returns:
        T_target_source (..., 4, 4) of the dtype of ``source``, as of ``kabsch``: one of the best where the pairs leave
        the rotation open. Gradients flow to all inputs, twice if wanted, finite everywhere.

    Raises:
        ValueError: shapes do not fit.

    Example:
        >>> import torch
        >>> p = torch.rand(10, 3, dtype=torch.float64)
        >>> T = soft_kabsch(p, p.flip(0) + 1, torch.eye(10, dtype=torch.float64).flip(0))
        >>> torch.allclose(T[:3, 3], torch.ones(3, dtype=torch.float64))
        True
    """
    expect(source.ndim >= 2 and source.shape[-1] == 3, "source", "(..., N, 3)", source)
    lead = tuple(source.shape[:-2])
    fits = target.ndim == source.ndim and tuple(target.shape[:-2]) == lead and target.shape[-1] == 3
    expect(fits, "target", "(" + "".join(f"{size}, " for size in lead) + "M, 3)", target)
    shape = (*lead, source.shape[-2], target.shape[-2])
    expect(confidence.shape == shape, "confidence", f"{shape}", confidence)
    return from_moments(*soft_moments(source, target, confidence))


class Moments(NamedTuple):
    """What the best transform depends on.

    Attributes:
        source_mean: (..., 3).
        target_mean: (..., 3).
        covariance: (..., 3, 3), source by target.
    """

    source_mean: Tensor
    target_mean: Tensor
    covariance: Tensor


def soft_moments(source: Tensor, target: Tensor, confidence: Tensor) -> Moments:
    """What ``from_moments`` takes, from the arguments of ``soft_kabsch``. Gradients flow."""
    # about the largest weight, held fixed: scaling all weights changes nothing, and no square of one underflows
    share = reciprocal(confidence.detach().flatten(-2).amax(dim=-1) if confidence.numel() else confidence.sum((-1, -2)))
    confidence = confidence * share[..., None, None]
    rows, columns = confidence.sum(dim=-1), confidence.sum(dim=-2)
    share = reciprocal(rows.sum(dim=-1))[..., None]
    source_mean = (rows[..., None] * source).sum(dim=-2) * share
    target_mean = (columns[..., None] * target).sum(dim=-2) * share
    apart = confidence @ (target - target_mean[..., None, :])  # (..., N, 3)
    covariance = (source - source_mean[..., None, :]).transpose(-1, -2) @ apart
    return Moments(source_mean, target_mean, covariance * share[..., None])


def reciprocal(weight: Tensor) -> Tensor:
    """1 / weight, and 0 where the weight is so near 0 that gradients would not stay finite."""
    some = weight > torch.finfo(weight.dtype).tiny ** 0.75
    return torch.where(some, 1 / torch.where(some, weight, 1), 0)
