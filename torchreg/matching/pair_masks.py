"""Which pairs of rows take part in a soft matching, and what is asked of its arguments."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torchreg.errors import expect, expect_dtype, expect_floating


class Masks(NamedTuple):
    """Who takes part.

    Attributes:
        source: (..., N) bool.
        target: (..., M) bool.
        pair: (..., N, M) bool, both.
    """

    source: Tensor
    target: Tensor
    pair: Tensor


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
        ValueError: several elements.
    """
    if isinstance(value, Tensor):
        expect(value.numel() == 1, name, "one number", value)
        return value.reshape(()).to(like)
    return torch.full((), value, dtype=like.dtype, device=like.device)


def _mask(valid: Tensor | None, name: str, like: Tensor, shape: torch.Size) -> Tensor:
    if valid is None:
        return torch.ones(shape, dtype=torch.bool, device=like.device)
    expect(valid.shape == shape, name, f"{tuple(shape)}", valid)
    expect_dtype(valid, name, torch.bool)
    return valid
