"""Circle loss: every pair pulls as hard as it is wrong (Sun et al., CVPR 2020, arXiv:2002.10857).

In the form for point features of Huang et al. (PREDATOR, CVPR 2021, arXiv:2011.13005): distances d of features
in place of similarities, positives P and negatives N by distance in space, and for every row that has both

    L = log(1 + sum_P exp(s b_p (d - m_p)) sum_N exp(s b_n (m_n - d))) / s,   b_p = [d - m_p]+,   b_n = [m_n - d]+.
"""

from __future__ import annotations

import torch
from torch import Tensor

from torchreg.errors import expect, expect_shape, positive
from torchreg.geometry.numerics.lengths import safe_length, safe_sqrt
from torchreg.geometry.se3 import apply


def true_distances(source: Tensor, target: Tensor, T_target_source: Tensor) -> Tensor:
    """How far points lie apart under the true transform: what makes a positive or a negative of a pair.

    Args:
        source: (N, 3) meters.
        target: (M, 3) meters.
        T_target_source: (4, 4), true, between the frames of these points (without origins).

    Returns:
        (N, M) meters. No gradients.

    Example:
        >>> import torch
        >>> true_distances(torch.zeros(1, 3), torch.tensor([[3.0, 4.0, 0.0]]), torch.eye(4))
        tensor([[5.]])
    """
    expect_shape(source, "source", ("N", 3))
    expect_shape(target, "target", ("M", 3))
    with torch.no_grad():
        moved = apply(T_target_source.to(source.dtype), source)
        return safe_length(moved[:, None] - target[None])


def circle_loss(
    source_features: Tensor,
    target_features: Tensor,
    distances: Tensor,
    *,
    positive_radius: float,
    negative_radius: float,
    positive_margin: float = 0.1,
    negative_margin: float = 1.4,
    scale: float = 16.0,
) -> Tensor:
    """Features of the same place nearer than one margin, of other places farther than the other.

    Rows of the source and rows of the target are averaged each, over those that have positives and negatives, and
    the two means averaged. Pairs between the radii count for nothing. The weights b are part of what is
    differentiated here; implementations that hold them fixed have half the gradient of the exponents.

    Args:
        source_features: (N, D), unit rows for the default margins (whose distances lie in [0, 2]).
        target_features: (M, D).
        distances: (N, M) meters between places, as from ``true_distances``.
        positive_radius: meters; nearer pairs are the same place.
        negative_radius: meters, at least ``positive_radius``; farther pairs are other places.
        positive_margin: distance of features below which a positive is near enough.
        negative_margin: distance of features above which a negative is far enough.
        scale: sharpness s; larger looks at the worst pairs only.

    Returns:
        () of the dtype of the features; zero with zero gradients where no row has both. Gradients flow to both sets
        of features.

    Raises:
        ValueError: shapes do not fit, radii out of order, or a number that is not positive.

    Example:
        >>> import torch
        >>> features, places = torch.eye(3), torch.tensor([[0.0], [5.0], [9.0]]) * torch.ones(3)
        >>> loss = circle_loss(
        ...     features, features, true_distances(places, places, torch.eye(4)), positive_radius=0.1, negative_radius=1
        ... )
        >>> bool(loss < 0.15)
        True
    """
    expect_shape(source_features, "source_features", ("N", "D"))
    expect_shape(target_features, "target_features", ("M", source_features.shape[1]))
    expect_shape(distances, "distances", (len(source_features), len(target_features)))
    positive(positive_radius, "positive_radius")
    expect(negative_radius >= positive_radius, "negative_radius", f"at least {positive_radius}", negative_radius)
    positive(scale, "scale")
    same, other = distances < positive_radius, distances > negative_radius
    apart = _feature_distances(source_features, target_features)
    pull = scale * (apart - positive_margin).clamp(min=0).square()
    push = scale * (negative_margin - apart).clamp(min=0).square()
    sides = [_side(pull, push, same, other), _side(pull.t(), push.t(), same.t(), other.t())]
    return (sides[0] + sides[1]) / (2 * scale)


def _side(pull: Tensor, push: Tensor, same: Tensor, other: Tensor) -> Tensor:
    """The mean over rows with positives and negatives of log(1 + sum exp(pull) sum exp(push))."""
    if pull.shape[1] == 0:
        return pull.sum()
    counted = same.any(dim=1) & other.any(dim=1)

    def together(exponent: Tensor, mask: Tensor) -> Tensor:
        # a row that does not count keeps its exponents: no sum is empty
        return exponent.masked_fill(~mask & counted[:, None], -torch.inf).logsumexp(dim=1)

    loss = torch.nn.functional.softplus(together(pull, same) + together(push, other))
    return torch.where(counted, loss, 0).sum() / counted.sum().clamp(min=1)


def _feature_distances(source: Tensor, target: Tensor) -> Tensor:
    """(N, M), by one matrix product."""
    lengths = (source * source).sum(dim=1)[:, None] + (target * target).sum(dim=1)[None]
    return safe_sqrt(lengths - 2 * source @ target.t())
