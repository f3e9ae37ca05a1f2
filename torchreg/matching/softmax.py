r"""Dual softmax: the confidence of a pair is how much each of its points prefers the other to all others.

    C_ij = exp(s_ij) / sum_k exp(s_ik)  x  exp(s_ij) / sum_k exp(s_kj)

Soft mutual nearest neighbors (Rocco et al., NeurIPS 2018, arXiv:1810.10510; Sun et al., CVPR 2021,
doi:10.1109/CVPR46437.2021.00881, Eq. 2). A dustbin joins both sums as one more partner that every point may prefer.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torchreg.errors import expect, expect_dtype, expect_floating, finite


def dual_softmax(
    scores: Tensor,
    *,
    dustbin: float | Tensor | None = None,
    source_valid: Tensor | None = None,
    target_valid: Tensor | None = None,
) -> Tensor:
    """Confidences (..., N, M) in [0, 1] from scores, by a softmax over rows times a softmax over columns.

    Scores (..., N, M) are the larger the more alike, divided by a temperature already. ``dustbin`` is the score of
    having no partner, a number or a tensor of one element; with ``None`` every point has to prefer some partner. Rows
    and columns that do not take part by ``source_valid`` (..., N) and ``target_valid`` (..., M), bool, are zero,
    whatever stands there (NaN too); with ``None`` all take part. Rows and columns sum to 1 at most. As scores grow,
    entries of mutual best pairs go to 1 and all others to 0. Gradients flow to scores and dustbin, of any order, finite
    for equal and for huge scores and for empty sides. Raises ``ValueError`` where shapes or dtypes do not fit.
    """
    masks = score_masks(scores, source_valid, target_valid)
    no_partner = None if dustbin is None else one_number(dustbin, "dustbin", scores)
    if scores.numel() == 0:
        return scores
    logits = torch.where(masks.pair, scores, 0)
    by_row = _log_softmax(logits, masks.target[..., None, :], no_partner, -1)
    by_column = _log_softmax(logits, masks.source[..., :, None], no_partner, -2)
    return torch.where(masks.pair, by_row + by_column, -torch.inf).exp()


class Masks(NamedTuple):
    """Rows and columns that take part."""

    source: Tensor  # (..., N) bool
    target: Tensor  # (..., M) bool
    pair: Tensor  # (..., N, M) bool, both


def score_masks(scores: Tensor, source_valid: Tensor | None, target_valid: Tensor | None) -> Masks:
    """The masks of scores (..., N, M), all true where none are given, after a check of all three.

    Raises:
        ValueError: shapes or dtypes do not fit.
    """
    expect_floating(scores, "scores")
    expect(scores.ndim >= 2, "scores", "(..., N, M)", scores)
    source = _mask(source_valid, "source_valid", scores, scores.shape[:-1])
    target = _mask(target_valid, "target_valid", scores, scores.shape[:-2] + scores.shape[-1:])
    return Masks(source, target, source[..., :, None] & target[..., None, :])


def one_number(value: float | Tensor, name: str, like: Tensor) -> Tensor:
    """A number or a tensor of one element as () of the dtype and device of ``like``; gradients flow on.

    Raises:
        ValueError: several elements, or a number that is not finite.
    """
    if isinstance(value, Tensor):
        expect(value.numel() == 1, name, "one number", value)
        return value.reshape(()).to(like)
    return torch.full((), finite(value, name), dtype=like.dtype, device=like.device)


def _log_softmax(logits: Tensor, counted: Tensor, dustbin: Tensor | None, dim: int) -> Tensor:
    """Logits less the logarithm of a sum along ``dim`` over the entries counted, and the dustbin."""
    # where nothing counts everything does, so that no sum is empty; the caller masks such entries
    counted = counted | ~counted.any(dim=dim, keepdim=True)
    total = logits.masked_fill(~counted, -torch.inf).logsumexp(dim=dim, keepdim=True)
    if dustbin is not None:
        total = torch.logaddexp(total, dustbin)
    return logits - total


def _mask(valid: Tensor | None, name: str, like: Tensor, shape: torch.Size) -> Tensor:
    if valid is None:
        return torch.ones(shape, dtype=torch.bool, device=like.device)
    expect(valid.shape == shape, name, f"{tuple(shape)}", valid)
    expect_dtype(valid, name, torch.bool)
    return valid
