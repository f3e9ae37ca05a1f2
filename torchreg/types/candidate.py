"""The poses that were weighed for one pair, and the counts of each stage of its run."""

from __future__ import annotations

from typing import NamedTuple

from torch import Tensor

from torchreg.types.loading import loadable


@loadable
class Candidate(NamedTuple):
    """One pose that was weighed on the clouds. A figure without data to compute it from is NaN.

    Attributes:
        origin: features and solver that proposed it, such as "fpfh + contrast, compatibility", or "slide" or "turn"
            for a probe of the verdict.
        T_target_source: (4, 4) float64, meters, origins included.
        support: matches that it brings within the inlier threshold, of the proposal whose agreement with it is the
            least likely by chance.
        matches: how many matches that proposal had.
        surprise: -log10 of the probability that as many unrelated matches agree.
        overlap: share of points with a partner nearer than the threshold, mean over both directions.
        closeness: mean over those partners of 1 - (distance / threshold)^2.
        normals: mean cosine between the normals of partners.
        colors: correlation of the colors of partners.
        strength: in [0, 1], how evenly the surfaces of partners constrain the pose; near 0 it slides.
        conflict: of the points at or before a surface that the other scanner saw, the share before it.
        misses: of the points near the other scan, the share without a partner.
        features: agreement of the descriptors of geometry of partners, 1 where they are the same, about 0 by chance.
        color_features: agreement of the descriptors of color of partners, likewise.
        log_odds: of being right against no candidate being right (natural logarithm).
        probability: of being right, among all candidates of the pair.

    Example:
        >>> import torchreg as tr
        >>> pair = tr.datasets.mall(seed=1, angular_step=3.0)
        >>> best = tr.register(pair.source, pair.target, effort="fast").candidates[0][0]
        >>> best.T_target_source.shape, 0.0 <= best.probability <= 1.0
        (torch.Size([4, 4]), True)
    """

    origin: str
    T_target_source: Tensor
    support: int
    matches: int
    surprise: float
    overlap: float
    closeness: float
    normals: float
    colors: float
    strength: float
    conflict: float
    misses: float
    features: float
    color_features: float
    log_odds: float
    probability: float


@loadable
class Proposal(NamedTuple):
    """The search with one set of features and one solver.

    Attributes:
        origin: features and solver in words, as in ``Candidate.origin``.
        matches: correspondences.
        drawn: hypotheses (RANSAC: samples; compatibility: seeds).
        kept: of those, how many passed the first test.
        scored: how many were scored on all matches.
        poses: distinct poses handed on.
        support: inliers of the best of them.

    Example:
        >>> import torchreg as tr
        >>> pair = tr.datasets.mall(seed=1, angular_step=3.0)
        >>> proposals = tr.register(pair.source, pair.target, effort="fast").stages[0].proposals
        >>> proposals[0].matches > 0
        True
    """

    origin: str
    matches: int
    drawn: int
    kept: int
    scored: int
    poses: int
    support: int


@loadable
class StageCounts(NamedTuple):
    """The counts of each stage of one pair, (source, target) where there are two numbers.

    Attributes:
        given: points of the clouds as given.
        points: points after downsampling.
        described: points with a valid feature, of the first set of features.
        proposals: of every set of features and solver.

    Example:
        >>> import torchreg as tr
        >>> pair = tr.datasets.mall(seed=1, angular_step=3.0)
        >>> counts = tr.register(pair.source, pair.target, effort="fast").stages[0]
        >>> counts.given == (len(pair.source.points), len(pair.target.points))
        True
    """

    given: tuple[int, int]
    points: tuple[int, int]
    described: tuple[int, int]
    proposals: tuple[Proposal, ...]
