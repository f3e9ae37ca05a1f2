"""Where the soft partner of every source point is: the mean of the target points by confidence."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torchreg.errors import expect, expect_shape
from torchreg.types import SoftCorrespondences
from torchreg.types.packing import spans


class SoftTargets(NamedTuple):
    """One expected partner per source point of a packed batch.

    Attributes:
        points: (P, 3) meters, in the frame of the target points given; zeros where the weight is 0.
        weights: (P,) the confidence that the point has a partner at all: the sum of its row.
    """

    points: Tensor
    weights: Tensor


def soft_targets(matches: SoftCorrespondences, target: Tensor) -> SoftTargets:
    """The expected position of every source point's partner.

    Args:
        matches: of B pairs.
        target: (Q, 3) points of the packed target clouds, such as ``Clouds.points``.

    Returns:
        q_i = sum_j C_ij q_j / w_i and w_i = sum_j C_ij. As minimizing sum_ij C_ij |R p_i + t - q_j|^2 and minimizing
        sum_i w_i |R p_i + t - q_i|^2 differ by a constant alone, ``kabsch`` with these is the least-squares pose over
        all pairs. Gradients flow to confidences and points; they are zero where a weight is 0.

    Raises:
        ValueError: another number of points than the matches have targets.

    Example:
        >>> import torch
        >>> both = SoftCorrespondences((torch.tensor([[0.2, 0.2]]),), torch.tensor([0, 1]), torch.tensor([0, 2]))
        >>> soft_targets(both, torch.tensor([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]])).points
        tensor([[0.5000, 0.0000, 0.0000]])
    """
    expect_shape(target, "target", ("Q", 3))
    expected = int(matches.target_offsets[-1])
    expect(len(target) == expected, "target", f"{expected} points, as the matches have", target)
    parts = [
        expected_targets(confidence, target[k:m])
        for confidence, (k, m) in zip(matches.confidence, spans(matches.target_offsets), strict=True)
    ]
    points = torch.cat([target[:0], *(part.points for part in parts)])
    return SoftTargets(points, torch.cat([target[:0, 0], *(part.weights for part in parts)]))


def expected_targets(confidence: Tensor, target: Tensor) -> SoftTargets:
    """The same from confidences (..., N, M) and points (..., M, 3): points (..., N, 3), weights (..., N)."""
    weights = confidence.sum(dim=-1)
    some = weights > torch.finfo(weights.dtype).tiny ** 0.5  # whose reciprocal squared is finite
    share = torch.where(some, 1 / torch.where(some, weights, 1), 0)
    return SoftTargets(confidence @ target * share[..., None], torch.where(some, weights, 0))
