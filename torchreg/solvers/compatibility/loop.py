"""Registration of every pair of a batch by the compatibility of its correspondences."""

from __future__ import annotations

import math
from collections.abc import Sequence

from torchreg.solvers import Judged, PairPoses, collect, one_per_pair, poses_of_pairs
from torchreg.solvers.compatibility.solve import LEAST, solve
from torchreg.types import Clouds, CompatibilityOptions, Correspondences, RegistrationResult


def compatibility(
    source: Clouds,
    target: Clouds,
    matches: Correspondences,
    options: CompatibilityOptions | Sequence[CompatibilityOptions] | None = None,
) -> RegistrationResult:
    """The transform that brings the most correspondences together, of every pair, found without samples.

    Every correspondence is the seed of a consensus set: of those that keep their distances to it, the ones that
    share the most partners with it (SC2-PCR: Chen et al., CVPR 2022, doi:10.1109/CVPR52688.2022.01287). The set
    gives a transform, and the transforms are scored on all correspondences, as ``ransac`` scores its own. Nothing
    is drawn at random: the result is bit for bit the same in any batch and with any number of threads.

    Args:
        source: B clouds.
        target: B clouds.
        matches: correspondences between them, global rows.
        options: for all pairs, or one per pair; ``None`` for the defaults.

    Returns:
        RegistrationResult; ``hypotheses`` counts seeds, seeds with partners enough, and transforms scored. A pair
        with too few matches, or on which no transform stands, has ``success`` false and says why. No gradients.

    Raises:
        ValueError: the numbers of pairs differ, or a correspondence names a row outside its pair's clouds.
    """
    per_pair = one_per_pair(options, CompatibilityOptions(), len(matches))
    poses = compatibility_poses(source, target, matches, per_pair)
    return collect(source, target, matches, poses, judged([option.inlier_threshold for option in per_pair]))


def compatibility_poses(
    source: Clouds, target: Clouds, matches: Correspondences, options: Sequence[CompatibilityOptions]
) -> list[PairPoses]:
    """The distinct poses of every pair, best first; arguments as ``compatibility``'s, with options one per pair."""
    return poses_of_pairs(source, target, matches, solve, options, least=[LEAST] * len(matches))


def judged(thresholds: Sequence[float]) -> list[Judged]:
    """What the verdict on the poses of every pair needs to know, from the inlier thresholds in meters.

    A consensus set is the choice among all samples of its pair, so the verdict counts them all.
    """
    return [Judged(threshold, LEAST, math.inf) for threshold in thresholds]
