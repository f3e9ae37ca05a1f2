"""Minimal samples drawn by learned weights, and the gradient that learns the weights from the losses of the samples.

Drawing has no derivative, but its expectation has one: grad E[L] = E[L grad log p] + E[grad L] (Williams, 1992,
doi:10.1007/BF00992696). NG-RANSAC learns its sampling weights in this way (Brachmann and Rother, ICCV 2019,
arXiv:1905.04132, Eq. 5).
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torchreg.entry import entry
from torchreg.errors import at_least, expect, expect_floating, expect_shape
from torchreg.geometry.numerics.chunks import row_chunks

_LEAST = -600.0  # logarithm of the share of correspondences that are drawn only where nothing else is left
_DRAW_ELEMENTS = 1 << 22  # a constant: the stream of draws depends on it


class Samples(NamedTuple):
    """Minimal samples of the correspondences of one pair.

    Attributes:
        rows: (H, S) int64, of correspondences, all different within a sample, in the order drawn.
        log_probability: (H,) of drawing each in this order, with gradients to the logits.

    Example:
        >>> import torch, torchreg as tr
        >>> drawn = tr.learning.draw_samples(torch.ones(20), 8, generator=torch.Generator().manual_seed(0))
        >>> drawn.rows.shape
        torch.Size([8, 3])
    """

    rows: Tensor
    log_probability: Tensor


@entry
def draw_samples(
    logits: Tensor, hypotheses: int, *, sample_size: int = 3, generator: torch.Generator | None = None
) -> Samples:
    """Draw samples without replacement, one correspondence after another by its weight among those that are left.

    All are drawn at once: the largest S of logits with Gumbel noise are such a sample (Kool et al., ICML 2019,
    arXiv:1903.06059), and log p = sum_k (l_k - log sum of exp(l) over what was left at the k-th draw).

    Args:
        logits: (M,) logarithms of weights, up to a constant; ``weights.log()`` does. A correspondence of -inf is
            drawn only where nothing else is left.
        hypotheses: number of samples H.
        sample_size: correspondences per sample S, at least 3.
        generator: of the draws; on its own device, wherever the logits are.

    Returns:
        Samples. The same generator state gives the same ones. Gradients flow from the log-probabilities to the
        logits; they are finite also where a few correspondences hold all the weight.

    Raises:
        ValueError: fewer correspondences than a sample needs, or numbers out of range.

    Example:
        >>> import torch
        >>> sure = torch.tensor([0.0, 0.0, 0.0, -torch.inf])
        >>> samples = draw_samples(sure, 5, generator=torch.Generator().manual_seed(0))
        >>> bool((samples.rows < 3).all()), samples.log_probability.exp()  # one of 6 orders each
        (True, tensor([0.1667, 0.1667, 0.1667, 0.1667, 0.1667]))
    """
    expect_shape(logits, "logits", ("M",))
    expect_floating(logits, "logits")
    at_least(hypotheses, "hypotheses", 1)
    at_least(sample_size, "sample_size", 3)
    expect(len(logits) >= sample_size, "logits", f"at least {sample_size} correspondences", logits)
    device = logits.device if generator is None else generator.device
    drawn = []
    for piece in row_chunks(hypotheses, len(logits), _DRAW_ELEMENTS):
        noise = torch.empty(piece.stop - piece.start, len(logits), dtype=logits.dtype, device=device)
        noise.exponential_(generator=generator)
        drawn.append((logits.detach() - noise.to(logits.device).log()).topk(sample_size, dim=1).indices)
    rows = torch.cat(drawn)
    log_share = logits.double().log_softmax(dim=0).clamp(min=_LEAST)  # (M,)
    chosen = log_share[rows]  # (H, S)
    return Samples(rows, (chosen - _log_left(log_share, rows)).sum(dim=1).to(logits.dtype))


def _log_left(log_share: Tensor, rows: Tensor) -> Tensor:
    """(H, S): the logarithm of what was left at every draw, without cancellation.

    One minus the shares drawn loses all digits where few weights dominate. So the S - 1 heaviest are kept apart from
    the sum of the others: as long as a draw took one of the others, one of the heaviest is left that outweighs it.
    """
    heavy = log_share.detach().topk(rows.shape[1] - 1).indices  # (S - 1,)
    others = log_share.index_fill(0, heavy, -torch.inf).logsumexp(dim=0)  # ()
    is_heavy = rows[..., None] == heavy  # (H, S, S - 1): the draw that took it
    taken = is_heavy.cumsum(dim=1) - is_heavy.to(torch.int64)  # before this draw
    heavy_left = torch.where(taken == 0, log_share[heavy].exp(), 0).sum(dim=2)
    light = torch.where(is_heavy.any(dim=2), 0, log_share[rows].exp())
    light_taken = light.cumsum(dim=1) - light
    some = (taken == 0).any(dim=2)
    together = torch.where(some, others.exp() - light_taken + heavy_left, 1).log()
    return torch.where(some, together, others)


@entry
def score_function_loss(losses: Tensor, log_probability: Tensor) -> Tensor:
    """The mean of losses of random draws, with the gradient of its expectation.

    Its value is the mean. Its gradient has two parts: that of the losses themselves, and (L_i - b_i) grad log p_i,
    which makes draws of less loss more likely. The baseline b_i, the mean of the other losses, removes most of the
    noise and does not change the expectation.

    Args:
        losses: (N,) of N independent draws: of samples, or of whole runs, with or without gradient.
        log_probability: (N,) of these draws, as from ``draw_samples`` (for a run of several samples: their sum).

    Returns:
        (), with gradients to both.

    Raises:
        ValueError: shapes do not fit, or fewer than 2 draws, which have no baseline.

    Example:
        >>> import torch
        >>> logits = torch.zeros(5, requires_grad=True)
        >>> samples = draw_samples(logits, 500, generator=torch.Generator().manual_seed(0))
        >>> losses = (samples.rows == 0).any(dim=1).float()  # correspondence 0 is a bad one
        >>> score_function_loss(losses, samples.log_probability).backward()
        >>> bool(logits.grad[0] > 0), bool((logits.grad[1:] < 0).all())
        (True, True)
    """
    expect_shape(losses, "losses", ("N",))
    expect_shape(log_probability, "log_probability", (len(losses),))
    expect(len(losses) >= 2, "losses", "at least 2 draws", losses)
    fixed = losses.detach()
    advantage = fixed - (fixed.sum() - fixed) / (len(losses) - 1)
    return (losses + advantage * (log_probability - log_probability.detach())).mean()
