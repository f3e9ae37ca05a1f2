"""What a solver is given and what it hands back, for one pair; and a pair's poses in the frames of its clouds."""

from __future__ import annotations

from typing import NamedTuple

from torch import Tensor

from torchreg.hypotheses.refine import Scored


class MatchedPoints(NamedTuple):
    """The correspondences of one pair, as a solver takes them.

    Attributes:
        source: (3, M) float64, meters, about the mean of the matched points.
        target: (3, M) float64, likewise.
        seed: of this pair, made from the call's seed and the correspondences.
    """

    source: Tensor
    target: Tensor
    seed: int


class Found(NamedTuple):
    """The outcome of a solver.

    Attributes:
        poses: distinct poses, best first; ``None`` when there is none.
        drawn: hypotheses begun: samples drawn, or seeds.
        kept: those that passed the first test: of edge lengths, or of having partners enough.
        scored: poses scored on all correspondences.
        reason: why there is no pose, else empty.
    """

    poses: Scored | None
    drawn: int
    kept: int
    scored: int
    reason: str


class PairPoses(NamedTuple):
    """The poses of one pair, best first and distinct; H = 0 beside a reason.

    A pose takes ``source.points`` to ``target.points``: x_target = R x_source + t, origins left out.

    Attributes:
        rotation: (H, 3, 3) float64.
        translation: (H, 3) float64, meters.
        inliers: (H, M) bool over the pair's correspondences.
        support: (H,) int64, number of inliers.
        error: (H,) float64, sum of squared residuals of the inliers, square meters.
        drawn: hypotheses begun.
        kept: those that passed the first test.
        scored: poses scored on all correspondences.
        reason: why there is no pose, else empty.
    """

    rotation: Tensor
    translation: Tensor
    inliers: Tensor
    support: Tensor
    error: Tensor
    drawn: int
    kept: int
    scored: int
    reason: str
