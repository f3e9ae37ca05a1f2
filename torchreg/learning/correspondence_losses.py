"""Losses of features and of correspondences: the circle loss, InfoNCE, and the probability of being an inlier."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn.functional import softplus

from torchreg.entry import entry
from torchreg.errors import expect, expect_dtype, expect_floating, expect_shape, positive
from torchreg.geometry.numerics.lengths import safe_length, safe_sqrt
from torchreg.geometry.se3 import apply


@entry
def true_distances(source: Tensor, target: Tensor, T_target_source: Tensor) -> Tensor:
    """Distances of points under the true transform, which tell positives from negatives.

    Args:
        source: (N, 3) meters.
        target: (M, 3) meters.
        T_target_source: (4, 4), true, between the frames of these points. The truth of a pair of clouds includes their
            origins: there, give the points of ``torchreg.transform(clouds, T_target_source)``, plus its origin minus
            that of the target, and the identity.

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


@entry
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
    """Circle loss: every pair pulls as hard as it is wrong (Sun et al., CVPR 2020, arXiv:2002.10857).

    Features of the same place shall be nearer than one margin, those of other places farther than another. In the
    form for point features of Huang et al. (PREDATOR, CVPR 2021, arXiv:2011.13005): distances d of features in place
    of similarities, positives P and negatives N by distance in space, and for every row that has both

        L = log(1 + sum_P exp(s b_p (d - m_p)) sum_N exp(s b_n (m_n - d))) / s,   b_p = [d - m_p]+,   b_n = [m_n - d]+.

    Rows of the source and rows of the target are averaged each, over those that have positives and negatives, and
    the two means averaged. Pairs between the radii do not count. The weights b are part of what is
    differentiated here; implementations that hold them fixed have half the gradient of the exponents.

    Args:
        source_features: (N, D), unit rows for the default margins (whose distances lie in [0, 2]).
        target_features: (M, D).
        distances: (N, M) meters between places, as from ``true_distances``.
        positive_radius: meters; nearer pairs are the same place.
        negative_radius: meters, at least ``positive_radius``; farther pairs are other places.
        positive_margin: distance of features below which a positive is near enough.
        negative_margin: distance of features above which a negative is far enough.
        scale: sharpness s; larger counts the worst pairs only.

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


@entry
def info_nce(
    source_features: Tensor,
    target_features: Tensor,
    partner: Tensor,
    *,
    ignored: Tensor | None = None,
    temperature: float = 0.07,
) -> Tensor:
    """InfoNCE: cross-entropy of choosing each source row's true partner among all target rows by similarity.

    Van den Oord et al. 2018, arXiv:1807.03748, Eq. 4: the mean over rows i with a partner j of
    -log(exp(s_ij / temperature) / sum_k exp(s_ik / temperature)), with s_ik = source_i . target_k. Features are not
    normalized; unit rows make s the cosine. This is one direction; call it again with the roles swapped for the other.

    Args:
        source_features: (N, D).
        target_features: (M, D).
        partner: (N,) int64, the row of the target that is the same place, or -1 where there is none: such rows do
            not count.
        ignored: (N, M) bool, rows that are no partner but too near the true place to count as wrong (``None``: no
            such rows). The partner itself always counts.
        temperature: how much similarity makes a difference; smaller punishes the hardest negatives more.

    Returns:
        () of the dtype of the features; zero with zero gradients where no row has a partner. Gradients flow to both
        sets of features.

    Raises:
        ValueError: shapes or dtypes do not fit, or the temperature is not positive.

    Example:
        >>> import torch
        >>> features = torch.eye(4)
        >>> bool(info_nce(features, features, torch.arange(4)) < 1e-4)
        True
    """
    expect_shape(source_features, "source_features", ("N", "D"))
    expect_shape(target_features, "target_features", ("M", source_features.shape[1]))
    rows, columns = len(source_features), len(target_features)
    expect_shape(partner, "partner", (rows,))
    expect_dtype(partner, "partner", torch.int64)
    positive(temperature, "temperature")
    if ignored is not None:
        expect_shape(ignored, "ignored", (rows, columns))
        expect_dtype(ignored, "ignored", torch.bool)
    if rows == 0 or columns == 0:
        return (source_features.sum() + target_features.sum()) * 0
    logits = source_features @ target_features.t() / temperature  # (N, M)
    has_partner = partner >= 0
    column = torch.where(has_partner, partner, 0)[:, None]  # (N, 1)
    if ignored is not None:
        # every row keeps one column at least, so that no sum of exponentials is empty
        left_out = ignored & (torch.arange(columns, device=partner.device) != column)
        logits = logits.masked_fill(left_out, -torch.inf)
    loss = logits.logsumexp(dim=1) - logits.gather(1, column)[:, 0]
    return torch.where(has_partner, loss, 0).sum() / has_partner.sum().clamp(min=1)


@entry
def inlier_probability_loss(logits: Tensor, is_inlier: Tensor) -> Tensor:
    """Binary cross-entropy of inlier logits, in which both classes weigh the same.

    Among putative matches one in ten may be right, and then a constant "wrong" has a small plain cross-entropy. So
    the mean over the inliers and the mean over the outliers are averaged (Yi et al., CVPR 2018,
    arXiv:1711.05971); where one class is absent, the other stands alone.

    Args:
        logits: (...) log-odds of being an inlier, any shape.
        is_inlier: (...) bool, the truth.

    Returns:
        () of the dtype of the logits; zero for no correspondences. Finite for any finite logits. Gradients flow to
        the logits.

    Raises:
        ValueError: shapes or dtypes do not fit.

    Example:
        >>> import torch
        >>> inlier_probability_loss(torch.zeros(5), torch.tensor([True, False, False, False, False]))
        tensor(0.6931)
    """
    expect_floating(logits, "logits")
    expect(is_inlier.shape == logits.shape, "is_inlier", f"{tuple(logits.shape)}", is_inlier)
    expect_dtype(is_inlier, "is_inlier", torch.bool)
    inliers, outliers = is_inlier.sum(), (~is_inlier).sum()
    inlier_loss = torch.where(is_inlier, softplus(-logits), 0).sum() / inliers.clamp(min=1)
    outlier_loss = torch.where(is_inlier, 0, softplus(logits)).sum() / outliers.clamp(min=1)
    classes = (inliers > 0).to(logits.dtype) + (outliers > 0).to(logits.dtype)
    return (inlier_loss + outlier_loss) / classes.clamp(min=1)


def _side(pull: Tensor, push: Tensor, same: Tensor, other: Tensor) -> Tensor:
    """The mean over rows with positives and negatives of log(1 + sum exp(pull) sum exp(push))."""
    if pull.shape[1] == 0:
        return pull.sum()
    counted = same.any(dim=1) & other.any(dim=1)

    def log_sum(exponent: Tensor, mask: Tensor) -> Tensor:
        # a row that does not count keeps its exponents: no sum is empty
        return exponent.masked_fill(~mask & counted[:, None], -torch.inf).logsumexp(dim=1)

    loss = softplus(log_sum(pull, same) + log_sum(push, other))
    return torch.where(counted, loss, 0).sum() / counted.sum().clamp(min=1)


def _feature_distances(source: Tensor, target: Tensor) -> Tensor:
    """(N, M), by one matrix product."""
    lengths = (source * source).sum(dim=1)[:, None] + (target * target).sum(dim=1)[None]
    return safe_sqrt(lengths - 2 * source @ target.t())
