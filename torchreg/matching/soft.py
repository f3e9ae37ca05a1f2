"""Soft matching of features: confidences for all pairs of points, where ``match_mutual`` says yes or no.

Alike are features that lie close, s_ij = -|f_i - g_j|^2 / temperature, so that the confident pairs of a dual softmax
at a low temperature are the mutual nearest neighbors.
"""

from __future__ import annotations

from functools import partial

import torch
from torch import Tensor

from torchreg.errors import at_least, expect, one_of, positive
from torchreg.matching.dual_softmax import dual_softmax
from torchreg.matching.pair_masks import one_number
from torchreg.matching.sinkhorn import sinkhorn
from torchreg.types import Features, SoftCorrespondences
from torchreg.types.packing import spans

METHODS = ("dual_softmax", "sinkhorn")


def soft_match(
    source: Features,
    target: Features,
    *,
    method: str = "dual_softmax",
    temperature: float | Tensor = 0.01,
    dustbin: float | Tensor | None = None,
    iterations: int = 50,
) -> SoftCorrespondences:
    """How far every pair of points is the same place, by features alone.

    Args:
        source: features of B clouds, finite where valid.
        target: the same, of the same width.
        method: ``"dual_softmax"`` or ``"sinkhorn"`` (optimal transport), as the functions of these names.
        temperature: of squared distances of features, above 0: a number, or a tensor of one element. (Two rows of
            ``fuse`` without negative values lie at most 2 apart per block, in squares.)
        dustbin: minus the squared distance from which on a point has rather no partner than that one, a number or a
            tensor of one element; ``None``: no dustbin, which Sinkhorn does not do without.
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
    expect(len(source) == len(target), "target", f"{len(source)} clouds, as the source has", len(target))
    expect(
        source.values.shape[1] == target.values.shape[1] and source.values.dtype == target.values.dtype,
        "target",
        f"features of width {source.values.shape[1]}, {source.values.dtype}",
        target.values,
    )
    one_of(method, "method", METHODS)
    expect(method == "dual_softmax" or dustbin is not None, "dustbin", "a number with Sinkhorn", dustbin)
    at_least(iterations, "iterations", 1)
    if not isinstance(temperature, Tensor):
        positive(temperature, "temperature")
    scale = one_number(temperature, "temperature", source.values)
    none = None if dustbin is None else one_number(dustbin, "dustbin", source.values) / scale
    solve = dual_softmax if none is None else partial(dual_softmax, dustbin=none)
    if method == "sinkhorn" and none is not None:
        solve = partial(sinkhorn, dustbin=none, iterations=iterations)
    confidence = []
    for (i, j), (k, m) in zip(spans(source.offsets), spans(target.offsets), strict=True):
        masks = source.valid[i:j], target.valid[k:m]
        distance = squared_distances(source.values[i:j], target.values[k:m], *masks)
        confidence.append(solve(-distance / scale, source_valid=masks[0], target_valid=masks[1]))
    return SoftCorrespondences(tuple(confidence), source.offsets, target.offsets)


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
