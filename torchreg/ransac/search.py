"""The search for the best hypotheses of one pair: sample -> prune -> solve -> count."""

from __future__ import annotations

import math

from torchreg.hypotheses import Found, MatchedPoints, Proposals, proposal_dtype
from torchreg.hypotheses.proposals import orthonormal
from torchreg.hypotheses.scoring import correspondence_vectors, propose_counts, residuals
from torchreg.ransac.minimal import sample_fits, solve_samples
from torchreg.ransac.prune import similar_edges, spans_plane
from torchreg.ransac.sampling import sample_rounds
from torchreg.types import RansacOptions


def search(points: MatchedPoints, options: RansacOptions) -> Found:
    """Find the hypotheses with the most inliers.

    Args:
        points: of one pair.
        options: what to draw and accept.
    """
    source, target, threshold = points.source, points.target, options.inlier_threshold
    count = source.shape[1]
    dtype = proposal_dtype(source, target, threshold)
    p, q = source.to(dtype), target.to(dtype)
    vectors = correspondence_vectors(p, q)
    proposals = Proposals(source.device, dtype)
    drawn = kept = best_count = 0
    for samples in sample_rounds(count, options.sample_size, options.hypotheses, points.seed, source.device):
        drawn += len(samples)
        sample_p, sample_q = p[:, samples.t()], q[:, samples.t()]  # (3, S, R)
        similar = similar_edges(sample_p, sample_q, options.edge_similarity).nonzero()[:, 0]
        kept += len(similar)
        sample_p, sample_q = sample_p[..., similar], sample_q[..., similar]
        solvable = spans_plane(sample_p) & spans_plane(sample_q)
        rotation, translation = solve_samples(sample_p, sample_q)
        fits = sample_fits(sample_p, sample_q, rotation, translation, threshold) & solvable
        passed = fits.nonzero()[:, 0]
        if len(passed) == 0:
            continue
        rotation, translation = rotation[..., passed], translation[..., passed]
        proposals.add(rotation, translation, propose_counts(rotation, translation, vectors, threshold))
        if options.confidence < 1:
            turned, moved = (part.double() for part in proposals.best(1))
            square = residuals(orthonormal(turned), moved, source, target)
            best_count = max(best_count, int((square < threshold * threshold).sum()))
            if drawn >= _hypotheses_needed(best_count / count, options.sample_size, options.confidence):
                break
    if proposals.total == 0:
        reason = (
            f"no hypothesis left: of {drawn} samples {kept} passed the edge-length test, "
            f"and none fits within {threshold:g} m"
        )
        return Found(None, drawn, kept, 0, reason)
    return Found(proposals, drawn, kept, proposals.total, "")


def _hypotheses_needed(inlier_ratio: float, size: int, confidence: float) -> float:
    """Samples to draw until an all-inlier one is among them with this confidence (Fischler and Bolles, 1981)."""
    good = inlier_ratio**size
    if good <= 0:
        return math.inf
    return 0.0 if good >= 1 else math.log(1 - confidence) / math.log1p(-good)
