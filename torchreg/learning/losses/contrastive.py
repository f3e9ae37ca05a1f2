"""InfoNCE: the true partner of a feature against all others (van den Oord et al. 2018, arXiv:1807.03748, Eq. 4)."""

from __future__ import annotations

import torch
from torch import Tensor

from torchreg.errors import expect_dtype, expect_shape, positive


def info_nce(
    source_features: Tensor,
    target_features: Tensor,
    partner: Tensor,
    *,
    ignored: Tensor | None = None,
    temperature: float = 0.07,
) -> Tensor:
    """Cross-entropy of choosing each source row's true partner among all target rows by similarity.

    The mean over rows i with a partner of -log(exp(s_ij / temperature) / sum_k exp(s_ik / temperature)), with
    s_ik = source_i . target_k and j the partner. Features are taken as they are; unit rows make s the cosine. It
    knows one direction; call it again with the roles swapped for the other.

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
