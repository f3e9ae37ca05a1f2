"""Whether a correspondence is right, as a probability: binary cross-entropy in which both classes weigh the same."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn.functional import softplus

from torchreg.errors import expect, expect_dtype, expect_floating


def inlier_probability_loss(logits: Tensor, is_inlier: Tensor) -> Tensor:
    """Balanced binary cross-entropy of inlier logits.

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
    missed = torch.where(is_inlier, softplus(-logits), 0).sum() / inliers.clamp(min=1)
    believed = torch.where(is_inlier, 0, softplus(logits)).sum() / outliers.clamp(min=1)
    classes = (inliers > 0).to(logits.dtype) + (outliers > 0).to(logits.dtype)
    return (missed + believed) / classes.clamp(min=1)
