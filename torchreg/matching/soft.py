"""Soft matching of features: a confidence for every pair of points, where ``match_mutual`` decides.

The score of a pair is s_ij = -|f_i - g_j|^2 / temperature, so that the confident pairs of a dual softmax at a low
temperature are the mutual nearest neighbors.
"""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import torch
from torch import Tensor

from torchreg.entry import entry
from torchreg.errors import at_least, expect, expect_shape, one_of, positive
from torchreg.matching.mutual import expect_comparable
from torchreg.matching.softmax import dual_softmax, one_number
from torchreg.matching.transport import sinkhorn
from torchreg.types import Features, SoftCorrespondences
from torchreg.types.packing import spans

METHODS = ("dual_softmax", "sinkhorn")


@entry
def soft_match(
    source: Features,
    target: Features,
    *,
    method: str = "dual_softmax",
    temperature: float | Tensor = 0.01,
    dustbin: float | Tensor | None = None,
    iterations: int = 50,
) -> SoftCorrespondences:
    """The confidence of every pair of points that both are the same place, by features alone.

    Args:
        source: features of B clouds, finite where valid.
        target: the same, of the same width.
        method: ``"dual_softmax"`` or ``"sinkhorn"`` (optimal transport), as the functions of these names.
        temperature: of squared distances of features, above 0: a number, or a tensor of one element. (Two rows of
            ``fuse`` without negative values lie at most 2 apart per block, in squares.)
        dustbin: minus the squared distance beyond which a point rather has no partner, a number or a tensor of one
            element; ``None``: no dustbin, which Sinkhorn cannot do without.
        iterations: of Sinkhorn; dual softmax has none.

    Returns:
        SoftCorrespondences; memory grows with N M. Rows that are not valid have confidence zero, whatever stands in
        them. Gradients flow to features, temperature and dustbin, of any order.

    Raises:
        ValueError: different numbers of clouds, widths or dtypes, an unknown method, Sinkhorn without a dustbin, or a
            number out of its range.

    Example:
        >>> import torch
        >>> rows = Features(torch.eye(3), torch.tensor([0, 3]), (("any", 3),), torch.tensor([True, True, False]))
        >>> soft_match(rows, rows).confidence[0].round(decimals=2)
        tensor([[1., 0., 0.],
                [0., 1., 0.],
                [0., 0., 0.]])
    """
    expect_comparable(source, target)
    one_of(method, "method", METHODS)
    expect(method == "dual_softmax" or dustbin is not None, "dustbin", "a number with Sinkhorn", dustbin)
    at_least(iterations, "iterations", 1)
    if not isinstance(temperature, Tensor):
        positive(temperature, "temperature")
    scale = one_number(temperature, "temperature", source.values)
    no_partner = None if dustbin is None else one_number(dustbin, "dustbin", source.values) / scale
    confidences = partial(dual_softmax, dustbin=no_partner)
    if method == "sinkhorn" and no_partner is not None:
        confidences = partial(sinkhorn, dustbin=no_partner, iterations=iterations)
    rows = (spans(side.offsets, side.values.shape[0]) for side in (source, target))
    confidence = []
    for (i, j), (k, m) in zip(*rows, strict=True):
        masks = source.valid[i:j], target.valid[k:m]
        distance = squared_distances(source.values[i:j], target.values[k:m], *masks)
        confidence.append(confidences(-distance / scale, source_valid=masks[0], target_valid=masks[1]))
    return SoftCorrespondences(tuple(confidence), source.offsets, target.offsets)


class SoftTargets(NamedTuple):
    """One expected partner per source point of a packed batch."""

    points: Tensor  # (P, 3) meters, in the frame of the target points given; zeros where the weight is 0
    weights: Tensor  # (P,) the confidence that the point has a partner at all: the sum of its row


def soft_targets(matches: SoftCorrespondences, target: Tensor) -> SoftTargets:
    """The expected partner of every source point among the points ``target`` (Q, 3) of the packed target clouds.

    q_i = sum_j C_ij q_j / w_i and w_i = sum_j C_ij. As minimizing sum_ij C_ij |R p_i + t - q_j|^2 and minimizing
    sum_i w_i |R p_i + t - q_i|^2 differ by a constant alone, ``kabsch`` with these is the least-squares pose over all
    pairs. Gradients flow to confidences and points; they are zero where a weight is 0. Raises ``ValueError`` where the
    number of points is not that of the matches' targets.
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


def squared_distances(source: Tensor, target: Tensor, source_valid: Tensor, target_valid: Tensor) -> Tensor:
    """Squared Euclidean distances (N, M) of rows (N, D) and (M, D), by one matrix product.

    Rows that are not valid count as some finite row, whatever stands in them, and get gradient zero. Rounding leaves
    some 1e-7 of the rows' squared distance to their mean in float32, below 0 too. Gradients flow, of any order.
    """
    # where before the product: a gradient of zero times a NaN would be one
    source = torch.where(source_valid[:, None], source, 0)
    target = torch.where(target_valid[:, None], target, 0)
    center = (target.detach().sum(dim=0) / target_valid.sum().clamp(min=1)).to(target)
    source, target = source - center, target - center
    squares = (source * source).sum(dim=1)[:, None] + (target * target).sum(dim=1)
    return squares - 2 * source @ target.t()
