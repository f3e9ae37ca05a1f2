"""The best pose over pairs most of which may be wrong: pairs far apart after the last pose count less in the next.

Every round weighs the pairs of ``soft_kabsch`` by Geman and McClure's function of their distance r and solves again,

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
from torchreg.geometry.numerics.derivatives import derivative_wanted, transformed
from torchreg.geometry.numerics.lengths import safe_sqrt
from torchreg.geometry.soft_kabsch import reciprocal, soft_kabsch


def robust_kabsch(
    source: Tensor, target: Tensor, confidence: Tensor, *, scale: float | Tensor, rounds: int = 5
) -> Tensor:
    """Rigid transforms over all pairs of points, robust against wrong ones, batched.

    Args:
        source: (..., N, 3) meters.
        target: (..., M, 3) meters.
        confidence: (..., N, M), at least 0: the weight of every pair before its distance is known.
        scale: meters, above 0, a number or (...): a pair this far apart counts a quarter in the last round.
        rounds: of weighing and solving after the first pose; each costs about N M.

    Returns:
        T_target_source (..., 4, 4) of the dtype of ``source``. Where fewer right than wrong pairs agree it may be any
        local minimum. Gradients flow to all inputs through all rounds, twice if wanted, finite everywhere; rounds
        are computed again on the way back, so memory stays that of one.

    Raises:
        ValueError: shapes do not fit, or numbers out of their range.

    Example:
        >>> import torch
        >>> p = torch.rand(10, 3, dtype=torch.float64)
        >>> T = robust_kabsch(p, p + 1, 0.1 + torch.eye(10, dtype=torch.float64), scale=0.01)
        >>> torch.allclose(T[:3, 3], torch.ones(3, dtype=torch.float64), atol=1e-3)
        True
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
    again = derivative_wanted(*inputs) and not any(map(transformed, inputs))
    for k in range(1, rounds + 1):
        width = last * (first / last) ** (1 - k / rounds)
        if again:
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
    return safe_sqrt(square * reciprocal(confidence.sum(dim=(-1, -2))))


def _squared_distances(T: Tensor, source: Tensor, target: Tensor) -> Tensor:
    """(..., N, M) square meters, from differences, which keep the digits that a matrix product would lose."""
    moved = source @ T[..., :3, :3].transpose(-1, -2) + T[..., None, :3, 3]
    x, y, z = (moved[..., :, None, i] - target[..., None, :, i] for i in range(3))
    return x * x + y * y + z * z
