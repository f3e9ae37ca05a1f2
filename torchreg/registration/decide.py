"""From the poses that the recipes proposed to the result: the solver's best, or the choice on the clouds."""

from __future__ import annotations

from collections.abc import Sequence

from torchreg.registration.described import DescribedClouds
from torchreg.registration.options import RegistrationOptions
from torchreg.registration.stopwatch import stage
from torchreg.solvers import result_of_poses
from torchreg.types import RegistrationResult
from torchreg.verification import WORK, PairLengths, ProposedPoses
from torchreg.verification.verify import verify


@stage("decision")
def decide(
    source: DescribedClouds,
    target: DescribedClouds,
    proposed: Sequence[ProposedPoses],
    options: Sequence[RegistrationOptions],
) -> RegistrationResult:
    """The best pose of every pair and the verdict on it."""
    first = options[0]
    if first.effort == "plain":
        solvers = [option.solver for option in options]
        return result_of_poses(source.cloud, target.cloud, proposed[0].matches, proposed[0].poses, solvers)
    lengths = [
        PairLengths(option.inlier_threshold, max(spacings))
        for option, *spacings in zip(options, source.spacing, target.spacing, strict=True)
    ]
    return verify(source.cloud, target.cloud, proposed, lengths, WORK[first.effort])
