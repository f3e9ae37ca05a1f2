"""The search for the best hypotheses of pairs: sample -> prune -> solve -> count."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import torch
from torch import Tensor

from torchreg.solvers import Found, MatchedPoints, Proposals, proposal_dtype
from torchreg.solvers.proposals import orthonormal
from torchreg.solvers.ransac.edges import Edges
from torchreg.solvers.ransac.minimal import sample_fits, solve_samples
from torchreg.solvers.ransac.prune import spans_plane
from torchreg.solvers.ransac.sampling import sample_rounds
from torchreg.solvers.scoring import correspondence_vectors, propose_counts, residuals
from torchreg.types import Failure, RansacOptions


def search(points: Sequence[MatchedPoints], options: Sequence[RansacOptions]) -> Iterator[Found]:
    """Find the hypotheses with the most inliers, of every pair, one after another.

    Args:
        points: of each pair.
        options: what to draw and accept, for each.
    """
    for own, option in zip(points, options, strict=True):
        yield _search(own, option)


def _search(points: MatchedPoints, options: RansacOptions) -> Found:
    source, target, threshold = points.source, points.target, options.inlier_threshold
    count = source.shape[1]
    dtype = proposal_dtype(source, target, threshold)
    p, q = source.to(dtype), target.to(dtype)
    vectors = correspondence_vectors(p, q)
    edges = Edges(p, q, options.edge_similarity, threshold)
    proposals = Proposals(source.device, dtype)
    drawn = kept = best_count = 0
    leading = -1  # proposed count
    for samples in sample_rounds(count, options.sample_size, options.hypotheses, points.seed, source.device):
        drawn += len(samples)
        similar, samples = edges.sift(samples)
        kept += similar
        sample_p, sample_q = _columns(p, samples), _columns(q, samples)  # (3, S, K)
        solvable = spans_plane(torch.stack([sample_p, sample_q], dim=2)).all(dim=0)
        rotation, translation = solve_samples(sample_p, sample_q)
        fits = sample_fits(sample_p, sample_q, rotation, translation, threshold) & solvable
        passed = fits.nonzero()[:, 0]
        if len(passed) == 0:
            continue
        rotation, translation = rotation[..., passed], translation[..., passed]
        proposed = propose_counts(rotation, translation, vectors, threshold)
        proposals.add(rotation, translation, proposed)
        if options.confidence < 1:
            highest = int(proposed.amax())
            if highest > leading:  # else the leader is the one that has been scored
                leading = highest
                turned, moved = (part.double() for part in proposals.best(1))
                square = residuals(orthonormal(turned), moved, source, target)
                best_count = max(best_count, int((square < threshold * threshold).sum()))
            if drawn >= _hypotheses_needed(best_count / count, options.sample_size, options.confidence):
                break
    if proposals.total == 0:
        text = (
            f"no hypothesis left: of {drawn} samples {kept} passed the edge-length test, "
            f"and none fits within {threshold:g} m"
        )
        return Found(None, drawn, kept, 0, Failure("no hypothesis", text, {"drawn": drawn, "kept": kept}))
    return Found(proposals, drawn, kept, proposals.total, None)


def _columns(points: Tensor, samples: Tensor) -> Tensor:
    """Coordinates (3, S, K) of samples (K, S)."""
    return points.index_select(1, samples.t().flatten()).view(3, samples.shape[1], -1)


def _hypotheses_needed(inlier_ratio: float, size: int, confidence: float) -> float:
    """Samples to draw until an all-inlier one is among them with this confidence (Fischler and Bolles, 1981)."""
    good = inlier_ratio**size
    if good <= 0:
        return math.inf
    return 0.0 if good >= 1 else math.log(1 - confidence) / math.log1p(-good)
