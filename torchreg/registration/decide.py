"""From the poses that the recipes proposed to the result: the solver's best, or the choice on the clouds."""

from __future__ import annotations

from collections.abc import Sequence

from torchreg.solvers import collect
from torchreg.solvers.compatibility import judged as judged_sets
from torchreg.solvers.ransac import judged as judged_samples
from torchreg.types import Clouds, RegistrationOptions, RegistrationResult
from torchreg.verification import WORK, PairLengths, ProposedPoses
from torchreg.verification.verify import verify


def decide(
    source: Clouds,
    target: Clouds,
    spacings: tuple[Sequence[float], Sequence[float]],
    proposed: Sequence[ProposedPoses],
    options: Sequence[RegistrationOptions],
) -> RegistrationResult:
    """The best pose of every pair and the verdict on it; ``spacings`` are those of both sides' points, meters."""
    first = options[0]
    if first.effort == "plain":
        poses = proposed[0].poses
        if first.solver == "ransac":
            judged = judged_samples([option.ransac for option in options], poses)
        else:
            judged = judged_sets([option.ransac.inlier_threshold for option in options])
        return collect(source, target, proposed[0].matches, poses, judged)
    lengths = [
        PairLengths(option.ransac.inlier_threshold, max(apart))
        for option, apart in zip(options, zip(*spacings, strict=True), strict=True)
    ]
    return verify(source, target, proposed, lengths, WORK[first.effort])
