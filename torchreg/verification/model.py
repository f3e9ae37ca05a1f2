"""From evidence to log-odds, and from the log-odds of all candidates to probabilities.

At most one of the distinct candidates of a pair is right, and perhaps none. With log-odds s_i of each against "none",

    P(i) = exp(s_i) / (1 + sum_j exp(s_j)),

a conditional logit with an outside option (McFadden, 1974). So two poses that the clouds speak for alike share the
probability between them, and neither comes out as certain. The log-odds are linear in a few numbers of the evidence;
their weights were fitted by bench/verdict.py.
"""

from __future__ import annotations

import torch
from torch import Tensor

from torchreg.verification.evidence import Evidence

PRIOR = {
    "one": -6.0,
    "overlap": 1.5,
    "closeness": 3.0,
    "normals": 3.0,
    "colors": 2.5,
    "colored": -1.5,
    "strength": 1.0,
    "conflict": -1.5,
    "seen": 0.5,
    "surprise": 1.0,
}
"""Weights set by hand: what the fit starts from and is held to."""

MODEL = {
    "one": (-3.80, 1.00),
    "overlap": (1.52, -1.26),
    "closeness": (3.05, 0.83),
    "normals": (3.05, 0.90),
    "colors": (2.54, 1.34),
    "colored": (-1.76, 1.00),
    "strength": (1.07, -1.63),
    "conflict": (-1.75, 0.04),
    "seen": (0.47, 1.00),
    "surprise": (1.40, 2.80),
}
"""Of every term, its weight and its mean over right poses (of those that have colors, viewpoints)."""


def terms(evidence: Evidence, surprise: Tensor) -> Tensor:
    """The numbers (H, 10) that the log-odds weigh, in the order of ``MODEL``.

    Each is bounded where more of it says no more: beyond an overlap of 0.3, say, a pose is not the likelier.

    Args:
        evidence: of H poses.
        surprise: (H,) of their matches, powers of ten.
    """
    colored, seen = ~torch.isnan(evidence.colors), ~torch.isnan(evidence.conflict)
    columns = {
        "one": torch.ones_like(evidence.overlap),
        "overlap": torch.log(evidence.overlap.clamp(0.02, 0.3)),
        "closeness": evidence.closeness,
        "normals": evidence.normals.nan_to_num(),
        "colors": torch.atanh(evidence.colors.nan_to_num().clamp(-0.5, 0.9)),
        "colored": colored.double(),
        "strength": torch.log(evidence.strength.clamp(0.03, 0.2)),
        "conflict": torch.log1p(evidence.conflict.nan_to_num().clamp(max=0.1) / 0.01),
        "seen": seen.double(),
        "surprise": torch.log1p(surprise.clamp(max=20.0)),
    }
    return torch.stack([columns[name] for name in MODEL], dim=1)


def log_odds(evidence: Evidence, surprise: Tensor) -> Tensor:
    """(H,) log-odds of each pose against none being right."""
    weights = torch.tensor([weight for weight, _ in MODEL.values()], dtype=torch.float64, device=surprise.device)
    return (terms(evidence, surprise) * weights).sum(dim=1)


def probabilities(odds: Tensor) -> Tensor:
    """(H,) of distinct poses with log-odds (H,)."""
    top = odds.amax().clamp(min=0) if len(odds) > 0 else odds.new_zeros(())
    weight = torch.exp(odds - top)
    return weight / (weight.sum() + torch.exp(-top))


def probability_alone(odds: Tensor) -> Tensor:
    """What the probability would be without rivals."""
    return torch.sigmoid(odds)
