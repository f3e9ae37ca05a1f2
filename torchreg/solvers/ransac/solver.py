"""RANSAC: sample -> prune -> solve -> count (Fischler and Bolles, Comm. ACM 24(6), 1981, doi:10.1145/358669.358692)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor

from torchreg.arguments import checked_record
from torchreg.entry import entry
from torchreg.errors import at_least, fraction
from torchreg.solvers.points import MatchedPoints, base_seed
from torchreg.solvers.ransac.edges import Edges
from torchreg.solvers.ransac.samples import sample_fits, sample_rounds, solve_samples, spans_plane
from torchreg.solvers.result import solve
from torchreg.solvers.scoring import orthonormal, residuals
from torchreg.solvers.solver import Hypotheses, Solver
from torchreg.types import Clouds, Correspondences, RegistrationResult


@checked_record
@dataclass(frozen=True, kw_only=True)
class RansacOptions(Solver):
    """How hypotheses are drawn, tested and accepted. The defaults are the paper's (section 4.1), but for ``scoring``.

    Attributes:
        hypotheses: how many minimal samples are drawn at most.
        confidence: drawing stops once a better sample would have been drawn with this probability, which follows from
            the count of inliers alone, whatever the ``scoring``; 1.0 draws all of them.
        edge_similarity: in [0, 1]; a sample stays when each edge's length in the one cloud is at least
            this fraction of its length in the other.
        sample_size: correspondences in a minimal sample, at least 3.
        inlier_threshold, local_optimization, scoring: as every ``Solver``'s.

    Example:
        >>> import torchreg as tr
        >>> tr.RansacOptions(inlier_threshold=0.05, hypotheses=50_000).confidence
        0.999
    """

    name: ClassVar[str] = "ransac"

    hypotheses: int = 600_000
    confidence: float = 0.999
    edge_similarity: float = 0.9
    sample_size: int = 3

    def __post_init__(self) -> None:
        super().__post_init__()
        at_least(self.hypotheses, "hypotheses", 1)
        fraction(self.confidence, "confidence")
        fraction(self.edge_similarity, "edge_similarity", zero=True)
        at_least(self.sample_size, "sample_size", 3)

    @property
    def least_matches(self) -> int:
        """The matches of a minimal sample."""
        return self.sample_size

    def tests(self, scored: int) -> float:
        """The hypotheses scored: samples are drawn blindly."""
        return scored

    def propose(self, points: MatchedPoints) -> Hypotheses:
        """The transforms of the samples drawn that fit their own sample within the threshold."""
        threshold, count = self.inlier_threshold, points.source.shape[1]
        hypotheses = Hypotheses(points, threshold)
        p, q = hypotheses.source, hypotheses.target
        edges = Edges(p, q, self.edge_similarity, threshold)
        best_count, leading = 0, -1  # inliers of a leader, and the proposed count of the last one
        for samples in sample_rounds(count, self.sample_size, self.hypotheses, points.seed, p.device):
            hypotheses.drawn += len(samples)
            similar, samples = edges.sift(samples)
            hypotheses.kept += similar
            sample_p, sample_q = _columns(p, samples), _columns(q, samples)  # (3, S, K)
            solvable = spans_plane(torch.stack([sample_p, sample_q], dim=2)).all(dim=0)
            rotation, translation = solve_samples(sample_p, sample_q)
            fits = sample_fits(sample_p, sample_q, rotation, translation, threshold) & solvable
            passed = fits.nonzero()[:, 0]
            if len(passed) == 0:
                continue
            proposed = hypotheses.add(rotation[..., passed], translation[:, passed])
            if self.confidence < 1:
                highest = int(proposed.amax())
                if highest > leading:  # else the leader has been scored already
                    leading = highest
                    turned, moved = (part.double() for part in hypotheses.best(1))
                    square = residuals(orthonormal(turned), moved, points.source, points.target)
                    best_count = max(best_count, int((square < threshold * threshold).sum()))
                if hypotheses.drawn >= _hypotheses_needed(best_count / count, self.sample_size, self.confidence):
                    break
        hypotheses.explanation = (
            f"of {hypotheses.drawn} samples {hypotheses.kept} passed the edge-length test, "
            f"and none fits within {threshold:g} m"
        )
        return hypotheses


@entry
def ransac(
    source: Clouds,
    target: Clouds,
    matches: Correspondences,
    options: RansacOptions | Sequence[RansacOptions] | None = None,
    *,
    generator: torch.Generator | None = None,
) -> RegistrationResult:
    """The transform that brings the most correspondences together, of every pair.

    Args:
        source: B clouds.
        target: B clouds.
        matches: correspondences between them, global rows.
        options: for all pairs, or one per pair; ``None`` for the paper's.
        generator: gives one seed for the call; ``None`` is a fixed one. Each pair draws by a seed made from that one
            and its correspondences, so its result is bit for bit the same in any batch, at any place in it, and with
            any number of threads.

    Returns:
        RegistrationResult. A pair with too few matches, or without a hypothesis, has ``success`` false and says why.
        No gradients.

    Raises:
        ValueError: the numbers of pairs differ, or a correspondence names a row outside its pair's clouds.

    Example:
        >>> import torch, torchreg as tr
        >>> made = tr.synthetic.match_problem(500, 0.8)
        >>> result = tr.ransac(made.source, made.target, made.matches, generator=torch.Generator().manual_seed(0))
        >>> float(tr.metrics.rte(made.T_target_source, result.T_target_source)) < 0.05
        True
    """
    return solve(source, target, matches, RansacOptions() if options is None else options, base_seed(generator))


def _columns(points: Tensor, samples: Tensor) -> Tensor:
    """Coordinates (3, S, K) of samples (K, S)."""
    return points.index_select(1, samples.t().flatten()).view(3, samples.shape[1], -1)


def _hypotheses_needed(inlier_ratio: float, size: int, confidence: float) -> float:
    """Samples to draw until an all-inlier one is among them with this confidence (Fischler and Bolles, 1981)."""
    good = inlier_ratio**size
    if good <= 0:
        return math.inf
    return 0.0 if good >= 1 else math.log(1 - confidence) / math.log1p(-good)
