"""The search for the best hypothesis of one pair: sample -> prune -> solve -> score -> refine."""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

from torchreg.ransac.minimal import sample_fits, solve_samples
from torchreg.ransac.prune import similar_edges, spans_plane
from torchreg.ransac.refine import Scored, best_first, optimize, score
from torchreg.ransac.sampling import sample_rounds
from torchreg.ransac.scoring import correspondence_vectors, propose_counts
from torchreg.types import RansacOptions

FINALISTS = 64
"""Hypotheses that are scored exactly, those with the most proposed inliers."""

OPTIMIZED = 8
"""Of those, how many are refitted to their inliers."""


class Found(NamedTuple):
    """The outcome of a search.

    Attributes:
        best: the winner alone (H = 1), or ``None`` when no hypothesis passed the tests.
        drawn: samples drawn.
        kept: samples that passed the edge-length test.
        scored: hypotheses whose sample fits within the threshold.
    """

    best: Scored | None
    drawn: int
    kept: int
    scored: int


def search(source: Tensor, target: Tensor, options: RansacOptions, seed: int) -> Found:
    """Find the hypothesis with the most inliers.

    Args:
        source: (3, M) float64, centered, meters.
        target: (3, M) float64, centered.
        options: what to draw and accept.
        seed: of this pair.
    """
    count = source.shape[1]
    dtype = _proposal_dtype(source, target, options.inlier_threshold)
    p, q = source.to(dtype), target.to(dtype)
    vectors = correspondence_vectors(p, q)
    pool = _Pool(source.device)
    drawn = kept = scored = best_count = 0
    for samples in sample_rounds(count, options.sample_size, options.hypotheses, seed, source.device):
        drawn += len(samples)
        sample_p, sample_q = p[:, samples.t()], q[:, samples.t()]  # (3, S, R)
        similar = similar_edges(sample_p, sample_q, options.edge_similarity).nonzero()[:, 0]
        kept += len(similar)
        sample_p, sample_q = sample_p[..., similar], sample_q[..., similar]
        solvable = spans_plane(sample_p) & spans_plane(sample_q)
        rotation, translation = solve_samples(sample_p, sample_q)
        fits = sample_fits(sample_p, sample_q, rotation, translation, options.inlier_threshold) & solvable
        passed = fits.nonzero()[:, 0]
        if len(passed) == 0:
            continue
        rotation, translation = rotation[..., passed], translation[..., passed]
        proposed = propose_counts(rotation, translation, vectors, options.inlier_threshold)
        pool.add(rotation, translation, proposed, first=scored)
        scored += len(passed)
        if options.confidence < 1:
            leader = score(*pool.leader(), source, target, options.inlier_threshold)
            best_count = max(best_count, int(leader.support))
            if drawn >= _hypotheses_needed(best_count / count, options.sample_size, options.confidence):
                break
    if scored == 0:
        return Found(None, drawn, kept, 0)
    finalists = score(*pool.all(), source, target, options.inlier_threshold)
    finalists = finalists.take(best_first(finalists)[:OPTIMIZED])
    finalists = optimize(finalists, source, target, options.inlier_threshold, options.local_optimization)
    return Found(finalists.take(best_first(finalists)[:1]), drawn, kept, scored)


class _Pool:
    """The hypotheses with the most proposed inliers so far, ties to the earlier one."""

    def __init__(self, device: torch.device) -> None:
        self.rotation = torch.empty(3, 3, 0, dtype=torch.float64, device=device)
        self.translation = torch.empty(3, 0, dtype=torch.float64, device=device)
        self.key = torch.empty(0, dtype=torch.int64, device=device)

    def add(self, rotation: Tensor, translation: Tensor, proposed: Tensor, first: int) -> None:
        """Enter hypotheses (3, 3, H), (3, H) with proposed counts (H,), numbered from ``first``."""
        number = torch.arange(first, first + len(proposed), device=proposed.device)
        key = proposed.long() * (1 << 40) - number  # distinct, so that the choice of the largest is one only
        keep = key.topk(min(FINALISTS, len(key))).indices
        rotation = torch.cat([self.rotation, rotation[..., keep].double()], dim=-1)
        translation = torch.cat([self.translation, translation[..., keep].double()], dim=-1)
        key = torch.cat([self.key, key[keep]])
        top = key.topk(min(FINALISTS, len(key))).indices
        self.rotation, self.translation, self.key = rotation[..., top], translation[..., top], key[top]

    def all(self) -> tuple[Tensor, Tensor]:
        """Rotations (3, 3, F), made orthonormal to float64, and translations (3, F), best first."""
        return _orthonormal(self.rotation), self.translation

    def leader(self) -> tuple[Tensor, Tensor]:
        """The first of them."""
        return _orthonormal(self.rotation[..., :1]), self.translation[..., :1]


def _orthonormal(rotation: Tensor) -> Tensor:
    """The nearest rotations to (3, 3, F) matrices that are rotations up to the rounding of a proposal."""
    u, _, vh = torch.linalg.svd(rotation.permute(2, 0, 1))
    nearest: Tensor = u @ vh
    return nearest.permute(1, 2, 0)


def _proposal_dtype(source: Tensor, target: Tensor, threshold: float) -> torch.dtype:
    """float32 where its rounding of |R p + t - q|^2 stays far below the squared threshold, else float64."""
    reach = float(torch.maximum(source.abs().amax(), target.abs().amax()))
    rounding = 12 * (3 * reach * reach) * torch.finfo(torch.float32).eps
    return torch.float32 if rounding < 0.1 * threshold * threshold else torch.float64


def _hypotheses_needed(inlier_ratio: float, size: int, confidence: float) -> float:
    """Samples to draw until an all-inlier one is among them with this confidence (Fischler and Bolles, 1981)."""
    good = inlier_ratio**size
    if good <= 0:
        return math.inf
    return 0.0 if good >= 1 else math.log(1 - confidence) / math.log1p(-good)
