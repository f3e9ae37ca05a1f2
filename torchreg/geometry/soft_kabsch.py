"""The rigid transform that best aligns two sets of points over all of their pairs, each with a weight.

    minimize  sum_ij C_ij |R p_i + t - q_j|^2

Only sums over the pairs count: with rows r_i = sum_j C_ij, columns c_j = sum_i C_ij and W = sum_ij C_ij the means are
P^T r / W and Q^T c / W, the covariance (P - mean)^T C (Q - mean) / W. ``kabsch`` on expected partners
(``matching.soft.soft_targets``) minimizes the same, but divides by every row's r_i; here only W is divided by.

``robust_kabsch`` weighs the pairs by Geman and McClure's function of their distance r and solves again, in rounds,

    C_ij (s^2 / (s^2 + r_ij^2))^2,    r_ij = |R p_i + t - q_j|,

with s falling geometrically from the root mean square distance of the first pose to the scale asked for: so the first
rounds see a smooth cost with few minima (graduated non-convexity; Yang et al., RA-L 5(2), 2020,
doi:10.1109/LRA.2020.2965893).
"""

from __future__ import annotations

import torch
from torch import Tensor
from torch.utils.checkpoint import checkpoint

from torchreg.errors import at_least, expect, positive
from torchreg.geometry.kabsch import from_moments
from torchreg.geometry.numerics.derivatives import derivative_wanted, transformed
from torchreg.geometry.numerics.lengths import safe_sqrt


def soft_kabsch(source: Tensor, target: Tensor, confidence: Tensor) -> Tensor:
    """T_target_source (..., 4, 4) of least squares over all pairs of points (..., N, 3) and (..., M, 3), meters.

    ``confidence`` (..., N, M), at least 0, is the weight of every pair. The dtype is that of ``source``; as of
    ``kabsch``, one of the best where the pairs do not determine the rotation. Gradients flow to all inputs, of second
    order too, finite everywhere. Raises ``ValueError`` where shapes do not fit.
    """
    expect(source.ndim >= 2 and source.shape[-1] == 3, "source", "(..., N, 3)", source)
    lead = tuple(source.shape[:-2])
    fits = target.ndim == source.ndim and tuple(target.shape[:-2]) == lead and target.shape[-1] == 3
    expect(fits, "target", "(" + "".join(f"{size}, " for size in lead) + "M, 3)", target)
    shape = (*lead, source.shape[-2], target.shape[-2])
    expect(confidence.shape == shape, "confidence", f"{shape}", confidence)
    # relative to the largest weight, held fixed: scaling all weights changes nothing, and no square of one underflows
    largest = confidence.detach().flatten(-2).amax(dim=-1) if confidence.numel() else confidence.sum((-1, -2))
    confidence = confidence * _reciprocal(largest)[..., None, None]
    rows, columns = confidence.sum(dim=-1), confidence.sum(dim=-2)
    share = _reciprocal(rows.sum(dim=-1))[..., None]
    source_mean = (rows[..., None] * source).sum(dim=-2) * share
    target_mean = (columns[..., None] * target).sum(dim=-2) * share
    apart = confidence @ (target - target_mean[..., None, :])  # (..., N, 3)
    covariance = (source - source_mean[..., None, :]).transpose(-1, -2) @ apart
    return from_moments(source_mean, target_mean, covariance * share[..., None])


def robust_kabsch(
    source: Tensor, target: Tensor, confidence: Tensor, *, scale: float | Tensor, rounds: int = 5
) -> Tensor:
    """T_target_source (..., 4, 4) over all pairs of points, as ``soft_kabsch``, where most of them may be wrong.

    ``confidence`` weighs pairs before their distance is known; those that lie far apart after a round's pose count less
    in the next, a quarter in the last round at a distance of ``scale``, meters above 0, a number or (...). Each of the
    ``rounds`` of weighing and solving after the first pose costs about N M operations. Where fewer right than wrong
    pairs agree, the pose may be any local minimum. Gradients flow to all inputs through all rounds, of second order
    too, finite everywhere; the backward pass computes rounds again, so memory stays that of one. Raises ``ValueError``
    where shapes do not fit or numbers are out of their range.
    """
    at_least(rounds, "rounds", 1)
    T = soft_kabsch(source, target, confidence)
    if isinstance(scale, Tensor):
        expect(scale.shape == T.shape[:-2], "scale", f"a number or {tuple(T.shape[:-2])}", scale)
        last = scale.to(T)
    else:
        last = torch.full(T.shape[:-2], positive(scale, "scale"), dtype=T.dtype, device=T.device)
    first = torch.maximum(_spread(T, source, target, confidence), last)
    inputs = source, target, confidence
    recomputed = derivative_wanted(*inputs) and not any(map(transformed, inputs))
    for k in range(1, rounds + 1):
        width = last * (first / last) ** (1 - k / rounds)
        if recomputed:
            T = checkpoint(_solve_again, T, width, *inputs, use_reentrant=False, preserve_rng_state=False)
        else:
            T = _solve_again(T, width, *inputs)
    return T


def _solve_again(T: Tensor, width: Tensor, source: Tensor, target: Tensor, confidence: Tensor) -> Tensor:
    apart = _squared_distances(T, source, target)
    square = (width * width)[..., None, None]
    # times one number for all pairs, which changes nothing but keeps the weights of far ones from underflow
    least = apart.detach().flatten(-2).amin(dim=-1)[..., None, None] if apart.numel() else square
    near = (square + least).detach() / (square + apart)
    return soft_kabsch(source, target, confidence * (near * near))


def _spread(T: Tensor, source: Tensor, target: Tensor, confidence: Tensor) -> Tensor:
    """The root mean square distance (...) of all pairs after a pose."""
    square = (confidence * _squared_distances(T, source, target)).sum(dim=(-1, -2))
    return safe_sqrt(square * _reciprocal(confidence.sum(dim=(-1, -2))))


def _squared_distances(T: Tensor, source: Tensor, target: Tensor) -> Tensor:
    """(..., N, M) square meters, from differences, which keep the digits that a matrix product would lose."""
    moved = source @ T[..., :3, :3].transpose(-1, -2) + T[..., None, :3, 3]
    x, y, z = (moved[..., :, None, i] - target[..., None, :, i] for i in range(3))
    return x * x + y * y + z * z


def _reciprocal(weight: Tensor) -> Tensor:
    """1 / weight, and 0 where the weight is so close to 0 that gradients would not stay finite."""
    some = weight > torch.finfo(weight.dtype).tiny ** 0.75
    return torch.where(some, 1 / torch.where(some, weight, 1), 0)
