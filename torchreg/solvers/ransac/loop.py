"""RANSAC over every pair of a batch (Fischler and Bolles, Comm. ACM 24(6), 1981, doi:10.1145/358669.358692)."""

from __future__ import annotations

from collections.abc import Sequence

import torch

from torchreg.solvers import Judged, PairPoses, base_seed, collect, one_per_pair, poses_of_pairs
from torchreg.solvers.ransac.search import search
from torchreg.types import Clouds, Correspondences, RansacOptions, RegistrationResult


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
        generator: gives one seed for the call; ``None`` is a fixed one. Each pair draws from a generator of its
            own, made from that seed and the pair's correspondences, so its result is bit for bit the same in
            any batch, at any place in it, and with any number of threads.

    Returns:
        RegistrationResult. A pair with too few matches, or on which no hypothesis stands, has ``success``
        false and says why. No gradients.

    Raises:
        ValueError: the numbers of pairs differ, or a correspondence names a row outside its pair's clouds.
    """
    per_pair = one_per_pair(options, RansacOptions(), len(matches))
    poses = ransac_poses(source, target, matches, per_pair, base_seed(generator))
    return collect(source, target, matches, poses, judged(per_pair, poses))


def ransac_poses(
    source: Clouds, target: Clouds, matches: Correspondences, options: Sequence[RansacOptions], seed: int
) -> list[PairPoses]:
    """The distinct poses of every pair, best first; arguments as ``ransac``'s, with options one per pair."""
    least = [option.sample_size for option in options]
    return poses_of_pairs(source, target, matches, search, options, least=least, seed=seed)


def judged(options: Sequence[RansacOptions], poses: Sequence[PairPoses]) -> list[Judged]:
    """What the verdict on the poses of every pair needs to know."""
    return [
        Judged(option.inlier_threshold, option.sample_size, pair.scored)
        for option, pair in zip(options, poses, strict=True)
    ]
