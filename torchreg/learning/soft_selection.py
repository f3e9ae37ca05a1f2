"""Differentiable RANSAC: all hypotheses weighted softly, instead of the best one picked.

Differentiable sample consensus (Brachmann et al., CVPR 2017, arXiv:1611.05705): minimal samples are solved in closed
form, inliers are counted by a sigmoid, the counts become a distribution over hypotheses by a softmax, and the
training loss is the expected loss under it (Eq. 8 there), or the loss of one hypothesis drawn from it.

    score_h = sum_i w_i sigmoid((threshold - |R_h p_i + t_h - q_i|) / softness) / sum_i w_i
    P(h)    = softmax_h(score_h / temperature)
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torchreg.entry import entry
from torchreg.errors import expect, expect_dtype, expect_shape, positive
from torchreg.geometry.kabsch import kabsch
from torchreg.geometry.numerics.lengths import safe_length


class SoftSelection(NamedTuple):
    """Hypotheses of one pair with the probability of choosing each.

    Attributes:
        T_target_source: (H, 4, 4), between the frames of the points.
        score: (H,) in [0, 1], the soft share of inliers by weight.
        probability: (H,), sums to one.
        log_probability: (H,).

    Example:
        >>> import torch, torchreg as tr
        >>> points = torch.rand(20, 3)
        >>> selection = tr.learning.select_softly(points, points, torch.randint(20, (8, 3)), inlier_threshold=0.1)
        >>> selection.probability.sum().round()
        tensor(1.)
    """

    T_target_source: Tensor
    score: Tensor
    probability: Tensor
    log_probability: Tensor


class DrawnHypothesis(NamedTuple):
    """One hypothesis drawn by its probability.

    Attributes:
        hypothesis: () int64, its index.
        T_target_source: (4, 4).
        log_probability: (), of drawing it.

    Example:
        >>> import torch, torchreg as tr
        >>> points = torch.rand(20, 3)
        >>> selection = tr.learning.select_softly(points, points, torch.randint(20, (8, 3)), inlier_threshold=0.1)
        >>> drawn = tr.learning.draw_hypothesis(selection)
        >>> 0 <= int(drawn.hypothesis) < 8
        True
    """

    hypothesis: Tensor
    T_target_source: Tensor
    log_probability: Tensor


@entry
def select_softly(
    source: Tensor,
    target: Tensor,
    samples: Tensor,
    *,
    inlier_threshold: float,
    softness: float | None = None,
    temperature: float = 0.05,
    weights: Tensor | None = None,
) -> SoftSelection:
    """Solve samples and weigh the hypotheses by their soft inliers.

    Args:
        source: (M, 3) meters, the source points of the correspondences.
        target: (M, 3) meters, their partners.
        samples: (H, S) int64 rows of correspondences, as from ``draw_samples``.
        inlier_threshold: meters.
        softness: meters over which an inlier becomes an outlier; ``None``: a fifth of the threshold.
        temperature: difference in inlier share that matters; towards zero the best hypothesis takes all.
        weights: (M,) at least 0, of the correspondences in the score; ``None``: all alike. Only their ratios matter.

    Returns:
        All hypotheses, always finite: a sample that does not determine the rotation gets one of the best. Gradients
        flow to points and weights, from transforms and probabilities; memory grows with H M.

    Raises:
        ValueError: shapes or dtypes do not fit, no samples, or numbers that are not positive.

    Example:
        >>> import torch
        >>> points = torch.rand(20, 3, dtype=torch.float64)
        >>> samples = tr.learning.draw_samples(torch.zeros(20), 8, generator=torch.Generator().manual_seed(0))
        >>> chosen = select_softly(points, points + 1, samples.rows, inlier_threshold=0.1)
        >>> chosen.T_target_source.shape, bool((chosen.score > 0.99).all())
        (torch.Size([8, 4, 4]), True)
    """
    expect_shape(source, "source", ("M", 3))
    expect_shape(target, "target", (len(source), 3))
    expect_shape(samples, "samples", ("H", "S"))
    expect_dtype(samples, "samples", torch.int64)
    expect(len(samples) > 0, "samples", "at least one", samples)
    positive(inlier_threshold, "inlier_threshold")
    positive(temperature, "temperature")
    softness = positive(inlier_threshold / 5 if softness is None else softness, "softness")
    if weights is None:
        weights = torch.ones_like(source[:, 0])
    expect_shape(weights, "weights", (len(source),))
    T = kabsch(source[samples], target[samples])  # (H, 4, 4)
    moved = source @ T[:, :3, :3].transpose(1, 2) + T[:, None, :3, 3]  # (H, M, 3)
    inlier = torch.sigmoid((inlier_threshold - safe_length(moved - target)) / softness)  # (H, M)
    total = weights.sum()
    some = total > 0
    score = inlier @ torch.where(some, weights / torch.where(some, total, 1), 0)
    log_probability = (score / temperature).log_softmax(dim=0)
    return SoftSelection(T, score, log_probability.exp(), log_probability)


@entry
def expected_loss(selection: SoftSelection, losses: Tensor) -> Tensor:
    """The expectation of a loss over the choice of a hypothesis.

    Args:
        selection: H hypotheses.
        losses: (H,) of each, such as ``pose_loss(selection.T_target_source, T_true).total``.

    Returns:
        (). Gradients flow into the hypotheses and into their probabilities.

    Raises:
        ValueError: shapes do not fit.

    Example:
        >>> import torch, torchreg as tr
        >>> points = torch.rand(20, 3)
        >>> selection = tr.learning.select_softly(points, points, torch.randint(20, (8, 3)), inlier_threshold=0.1)
        >>> tr.learning.expected_loss(selection, torch.ones(8)).round()
        tensor(1.)
    """
    expect_shape(losses, "losses", (len(selection.probability),))
    return (selection.probability * losses).sum()


@entry
def draw_hypothesis(selection: SoftSelection, *, generator: torch.Generator | None = None) -> DrawnHypothesis:
    """Draw one hypothesis by its probability, as a run does; ``score_function_loss`` learns from such draws.

    Args:
        selection: H hypotheses.
        generator: of the draw; on its own device, wherever the hypotheses are.

    Returns:
        The hypothesis. Gradients flow from the transform to the points, from the log-probability to points and
        weights.

    Example:
        >>> import torch, torchreg as tr
        >>> points = torch.rand(20, 3)
        >>> samples = torch.randint(20, (8, 3))
        >>> selection = tr.learning.select_softly(points, points, samples, inlier_threshold=0.1)
        >>> tr.learning.draw_hypothesis(selection, generator=torch.Generator().manual_seed(0)).T_target_source.shape
        torch.Size([4, 4])
    """
    probability = selection.probability.detach()
    device = probability.device if generator is None else generator.device
    # as an index of one element: a bare number would be read back to the host
    one = torch.multinomial(probability.to(device), 1, generator=generator).to(probability.device)  # (1,)
    T, log_probability = (
        part.index_select(0, one)[0] for part in (selection.T_target_source, selection.log_probability)
    )
    return DrawnHypothesis(one[0], T, log_probability)
