"""From the poses that the recipes proposed to the result: the solver's best, or the choice on the clouds."""

from __future__ import annotations

import math
from collections.abc import Sequence

from torchreg.compatibility import judged as judged_sets
from torchreg.hypotheses import collect
from torchreg.ransac import judged as judged_samples
from torchreg.registration.describe import Described
from torchreg.types import Clouds, Neighborhoods, RegistrationOptions, RegistrationResult, StageCounts
from torchreg.types.packing import spans
from torchreg.verification import Care, Lengths, Proposed, proposals_of, verify

CARE = {
    "fast": Care(poses=6, sample=600, refined=1, iterations=5, accepted=0.75),
    "balanced": Care(poses=10, sample=1000, refined=3, iterations=10),
    "thorough": Care(poses=16, sample=1500, refined=8, iterations=20),
}
"""How closely candidates are looked at, by effort; points far apart tell less, so that fast asks for more."""

_SPACING_NEIGHBOR = 4


def decide(
    source: Clouds,
    target: Clouds,
    near: tuple[Neighborhoods, Neighborhoods],
    proposed: Sequence[Proposed],
    options: Sequence[RegistrationOptions],
) -> RegistrationResult:
    """The best pose of every pair and the verdict on it; ``near`` are the neighborhoods of both sides."""
    first = options[0]
    if first.effort == "plain":
        poses = proposed[0].poses
        if first.solver == "ransac":
            judged = judged_samples([option.ransac for option in options], poses)
        else:
            judged = judged_sets([option.ransac.inlier_threshold for option in options])
        return collect(source, target, proposed[0].matches, poses, judged)
    spacings = zip(_spacings(source, near[0]), _spacings(target, near[1]), strict=True)
    lengths = [
        Lengths(option.ransac.inlier_threshold, max(apart)) for option, apart in zip(options, spacings, strict=True)
    ]
    return verify(source, target, proposed, lengths, CARE[first.effort])


def stage_counts(
    given: tuple[Clouds, Clouds],
    used: tuple[Clouds, Clouds],
    described: tuple[Described, Described],
    proposed: Sequence[Proposed],
) -> tuple[StageCounts, ...]:
    """What each stage of every pair had."""
    valid = [
        [int(part["fpfh"].valid[begin:end].sum()) for begin, end in spans(part["fpfh"].offsets)] for part in described
    ]
    return tuple(
        StageCounts(
            given=(given[0].lengths[b], given[1].lengths[b]),
            points=(used[0].lengths[b], used[1].lengths[b]),
            described=(valid[0][b], valid[1][b]),
            proposals=proposals_of(proposed, b),
        )
        for b in range(len(given[0]))
    )


def _spacings(cloud: Clouds, near: Neighborhoods) -> list[float]:
    """Median distance to the fourth nearest other point of every cloud, meters, of the points that have as many."""
    found = []
    slot = min(_SPACING_NEIGHBOR, near.index.shape[1] - 1)
    for begin, end in spans(cloud.offsets):
        square = near.sq_distance[begin:end, slot][near.valid[begin:end, slot]]
        median = float(square.double().sqrt().median()) if len(square) > 0 else math.nan
        found.append(median if median > 0 else 1e-9)
    return found
